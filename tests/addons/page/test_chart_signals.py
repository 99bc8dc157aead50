"""The signals that a chart can show, from what a log declares."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_process_runs import Alone, log_of

from fleet.addons.page.chart_signals import OF_THE_FLEET, Signals, commands_of
from fleet.mcap.reader import LogReader


@pytest.fixture
def signals(alone: Alone) -> Signals:
    reader = LogReader(Path(log_of(alone("paper", "duration=1 s", "checks={}"))))
    for _ in reader.blocks():
        break  # what stands at the beginning of a log declares all, also while it is written
    return Signals(reader.channels.values(), reader.schemas)


def test_numbers_of_vehicles_and_links_are_offered_with_their_units(signals: Signals) -> None:
    units = {name: signal.unit for name, signal in signals.by_name.items()}
    assert units["uuv/4/state.psi"] == "rad"
    assert units["uuv/1/command.tau_0"] == "N" and units["uuv/1/command.tau_2"] == "N m"
    assert units["link/1-2.delay"] == "s"
    assert not [name for name in units if name.startswith(OF_THE_FLEET)]
    assert "link/1-2.fate" not in units  # a text


def test_only_what_is_followed_has_values(signals: Signals) -> None:
    assert list(signals.values("uuv/1/state", b"")) == []
    signals.follow({"uuv/1/state.x", "uuv/1/state.z", *commands_of(1)})
    assert list(signals.followed) == ["uuv/1/command", "uuv/1/state"]
    assert list(signals.values("uuv/1/state", b"")) == [("uuv/1/state.x", 0.0), ("uuv/1/state.z", 0.0)]
    with pytest.raises(KeyError, match="uuv/2/state"):
        signals.follow(["uuv/3/state.x", "uuv/2/stat.x"])
    assert list(signals.followed) == ["uuv/1/command", "uuv/1/state"]  # all or none
    signals.follow(commands_of(1))
    assert list(signals.values("uuv/1/state", b"")) == []


def test_a_damaged_message_has_no_value(signals: Signals) -> None:
    signals.follow({"uuv/1/state.x", *commands_of(1)})
    assert list(signals.values("uuv/1/state", b"\x0f\xff")) == []
    assert list(signals.values("uuv/1/command", b"")) == []


def test_units_that_cannot_be_read_are_none(alone: Alone) -> None:
    reader = LogReader(Path(log_of(alone("paper", "duration=1 s", "checks={}"))))
    for _ in reader.blocks():
        break
    for channel in reader.channels.values():
        channel.metadata["units"] = "{"
    assert {signal.unit for signal in Signals(reader.channels.values(), reader.schemas).by_name.values()} == {""}


def test_one_vehicle_s_norm_is_made_when_it_is_asked_for(signals: Signals) -> None:
    assert signals.names_of("|uuv/2/error.e|") == ["|uuv/2/error.e|"]
    with pytest.raises(KeyError, match=r"command\.tau_0"):
        signals.names_of("uuv/1/command.tau[0]")
