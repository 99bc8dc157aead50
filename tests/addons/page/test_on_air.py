"""The page shows what modems transmit, as the channel did it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from channel_starts import channel_starts
from in_process_runs import recorded
from small_scenario import small

from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.on_air import MOST, OnAir
from fleet.addons.page.view_state import ViewState
from netem.modem import AcousticConfig


def test_every_transmission_of_the_channel_is_on_the_page(tmp_path: Path) -> None:
    with channel_starts() as starts:
        run = recorded(tmp_path, "acoustic-s2c", "duration=20 s", "checks={}")
    feed = LogFeed(run.directory / "run.mcap")
    feed.forward(20.0)
    found = sorted((src, begin) for src, begin, _ in feed.picture.history()["on_air"])
    tick_s = feed.scenario.tick_ns / 1e9
    done = sorted((src, start * tick_s) for src, start in starts)
    last = {src: max(at for i, at in done if i == src) for src, _ in done}  # it may be in flight at the end
    missing = [one for one in done if not any(src == one[0] and abs(at - one[1]) <= tick_s + 1e-9 for src, at in found)]
    assert len(found) > 20 and len(done) - len(last) <= len(found) <= len(done)
    assert set(missing) <= set(last.items())
    feed.close()


WATER = ("network.acoustic={modem: s2c}", "network.period=1 s")


def packet(number: int, **more: Any) -> Any:
    values = {"seq": number, "copy": 0, "sent": 1.0, "due": 2.0, "delay": 1.0, "fate": "delivered", "payload": b"12345"}
    return SimpleNamespace(**values | {"corrupted": False} | more)


@pytest.fixture
def on_air(acoustic: AcousticConfig) -> OnAir:
    return OnAir(acoustic, 0.01)


@pytest.fixture
def acoustic() -> AcousticConfig:
    found = small(*WATER).acoustic
    assert found is not None
    return found


def test_a_broadcast_is_one_transmission_and_what_was_never_sent_is_none(on_air: OnAir) -> None:
    for dst in (2, 3):
        on_air.packet((1, dst), packet(0), {})
    on_air.packet((1, 2), packet(1, fate="mtu"), {})
    on_air.packet((1, 2), packet(2, fate="in flight"), {})
    assert [src for src, _, _ in on_air.all] == [1]


def test_sound_that_came_from_far_began_earlier(on_air: OnAir, acoustic: AcousticConfig) -> None:
    on_air.packet((1, 2), packet(0), {1: (0.0, 0.0, 10.0), 2: (acoustic.sound_speed / 10, 0.0, 10.0)})
    on_air.packet((2, 1), packet(0), {1: (0.0, 0.0, 10.0), 2: (0.0, 0.0, 10.0)})
    (_, far, airtime), (_, near, _) = on_air.all
    assert near - far == pytest.approx(0.1)
    assert airtime == pytest.approx(acoustic.modem.airtime_ns(5) / 1e9, abs=1e-4)


@pytest.mark.parametrize("times", [{"due": float("nan")}, {"delay": float("inf")}, {"sent": float("-inf")}])
def test_a_time_that_is_no_number_is_left_out(on_air: OnAir, times: dict[str, float]) -> None:
    on_air.packet((1, 2), packet(0, fate="snr" if "due" in times else "delivered", **times), {})
    assert not on_air.all


def test_a_long_run_does_not_grow(on_air: OnAir) -> None:
    for number in range(MOST + 10):
        on_air.packet((1, 2), packet(number), {})
    assert len(on_air.all) == len(on_air.fresh) == MOST


def test_a_frame_has_what_is_new_and_history_has_all(acoustic: AcousticConfig) -> None:
    picture = ViewState(small(*WATER))
    picture.packet((1, 2), packet(0))
    assert len(picture.frame()["on_air"]) == 1 and not picture.frame()["on_air"]
    assert len(picture.history()["on_air"]) == 1
    assert "on_air" not in ViewState(small()).frame()
