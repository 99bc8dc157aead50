"""Real fleets on a wall clock."""

from __future__ import annotations

import json
import signal
from itertools import pairwise
from pathlib import Path
from textwrap import dedent

import pytest
from hand import Hand
from in_process_runs import recorded
from live import LiveRun

from fleet.addons.pictures.answer_times import punctuality
from fleet.addons.pictures.runs import NothingToDraw, View, load
from fleet.addons.studies.explanation.what_if import what_if
from fleet.errors import FleetError
from fleet.execution.connection import RemoteError
from fleet.repeat.verify import verify
from fleet.result.file import read_result
from fleet.result.result import Status
from netem.clock import Clock

SLEEPER = """
    from time import sleep

    class Sleeper:
        signals = ()

        def __init__(self, config):
            pass

        def step(self, sample):
            if sample.tick % 10 == 5:
                sleep(0.08)
            return (0.0, 0.0, 0.0), {}
"""


def test_a_real_run_is_on_time_and_lockstep_or_says_why_not(tmp_path: Path) -> None:
    words = ["paper", "duration=500 ms", "checks={ledger: balanced, middleware_loss: {at_most: 0}}"]
    found = recorded(tmp_path, *words, in_process=False, clock=Clock.REAL, speed=0.5, max_missed=1.0)
    same = recorded(tmp_path, *words)
    assert (found.status, found.reason) == (Status.PASS, "")
    measured = found.timing
    assert measured is not None
    assert measured.label in ("on time", "degraded")
    assert found.digest == same.digest or measured.label == "degraded"
    assert (measured.label == "on time") == (measured.reasons == [])
    assert all(row.asked == 50 for row in measured.vehicles.values())
    assert measured.netem.hop.count + measured.netem.unread == 30
    assert measured.netem.links["1->2"].injected.p50_ms == 10.0
    assert read_result(found.directory) == found
    (run,) = load([found.directory])
    figure = punctuality([run], View())
    assert [text.get_text() for text in figure.legends[0].get_texts()][:4] == ["UUV 1", "UUV 2", "UUV 3", "UUV 4"]
    shares = figure.axes[0].lines[0].get_ydata()
    assert shares[0] == 1.0
    assert all(a >= b > 0 for a, b in pairwise(shares))
    (run,) = load([same.directory])
    with pytest.raises(NothingToDraw, match="lockstep"):
        punctuality([run], View())
    for refused in (verify, lambda log: what_if(log, 3)):
        with pytest.raises(FleetError, match="--clock real"):
            refused(found.directory)


@pytest.mark.slow
def test_an_agent_too_slow_for_its_ticks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sleeper.py").write_text(dedent(SLEEPER))
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ["paper", "duration=2 s", "checks={}", "per_vehicle={2: {controller: 'sleeper:Sleeper'}}"]
    found = recorded(tmp_path, *words, in_process=False, clock=Clock.REAL, speed=1.0)
    assert found.status is Status.CHECK_FAILED
    assert found.timing is not None
    row = found.timing.vehicles["2"]
    # Twenty times it sleeps, and each time seven more ticks go by; fewer where the machine stops the world, too.
    assert row.missed >= 20 * 3
    assert row.response.max_ms >= 80.0
    assert "agent 2 missed" in found.checks[-1].found


@pytest.mark.slow
def test_a_suspended_agent_does_not_hold_the_others(tmp_path: Path) -> None:
    """It is named, nobody waits for it, and it is among them again when it goes on."""
    arguments = ["--clock", "real", "--speed", "2", "--duration", "8 s", "--max-missed", "1"]
    with LiveRun(tmp_path, "paper", *arguments, "--set", "profile=hardened", "--set", "checks={}") as run:
        run.until_running(3.0)  # sooner its vehicle would not survive an old command for long
        hand, agent = Hand(tmp_path), run.role("agent 2")
        with pytest.raises(RemoteError, match="keeps the pace"):
            hand.clock("speed", 4.0)
        agent.suspend()
        hand.until(hand.now() + 2.0)
        agent.resume()
        assert run.status() == 0, run.printed
        assert "agent 2 was silent for" in run.said
    notes = [note for note in json.loads((run.directory / "result.json").read_text())["notes"] if "vehicle 2" in note]
    assert ["has not answered for 100 ticks" in note for note in notes[:1]] == [True], notes
    assert ["its agent answers again" in note for note in notes[1:]] == [True], notes


@pytest.mark.slow
def test_a_run_that_is_ended_early_says_how_everyone_kept_up(tmp_path: Path) -> None:
    with LiveRun(tmp_path, "paper", "--clock", "real", "--duration", "60 s", "--set", "checks={}") as run:
        run.until_running().send(signal.SIGINT, group=True)
        assert run.status() == 130
        assert "clock: real, 1 x, a tick every 10 ms" in run.said
    result = json.loads((run.directory / "result.json").read_text())
    assert all(100 <= row["asked"] < 6000 for row in result["timing"]["vehicles"].values())
