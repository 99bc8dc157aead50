"""Another agent with a recorded one's senses: the same to the last bit when nothing is changed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from failing_laws import failing
from failing_laws import module as module
from fault_histories import EVERYTHING
from in_process_runs import recorded
from marks import slow
from refusals import check_commands
from tool import invoke

from fleet.addons.studies.explanation.what_if import what_if
from fleet.errors import FleetError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.repeat.resume import continuation
from fleet.result.result import Status

LINKS = 'network.links={"*": delay 60ms 30ms loss 20% duplicate 20% corrupt 20%}'


def run(folder: Path, name: str, *overrides: str) -> Path:
    result = recorded(folder, name, "checks={tumbled: waived}", *overrides)
    assert result.status is Status.PASS, result.reason
    return result.directory


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("paper", ["duration=3 s", LINKS, EVERYTHING]),
        *slow(("ideal", ["duration=1 s"])),
        *slow(
            ("acoustic-80bps", ["duration=20 s", "log.every=1 tick", "faults=[{at: 8 s, for: 6 s, kill: 2}]"]),
            ("paper", ["duration=1 s", "sensors.position_noise=5 cm", "neighbours.drop_after=200 ms"]),
            ("dead-reckoning", ["duration=2 s"]),
        ),
        (
            "election",
            ["duration=2 s", "log.every=1 tick", "agent.clock={drift: {sigma: 900 ppm}, offset: -40 ms}", EVERYTHING],
        ),
    ],
    ids=["full of faults", "ideal", "acoustic", "noise", "dead reckoning", "clocks"],
)
def test_with_nothing_changed_every_command_is_that_of_the_log(name: str, overrides: list[str], tmp_path: Path) -> None:
    directory = run(tmp_path, name, *overrides)
    for agent in (1, 2, 3, 4):
        found = what_if(directory, agent)
        assert found.identical, (agent, found.first_s)
        assert len(found.t) > 50
        assert found.heard > 0


def test_another_law_commands_something_else(tmp_path: Path) -> None:
    directory = run(tmp_path, "paper", "duration=2 s")
    found = what_if(directory, 3, ["controller=bsmc"])
    assert (found.identical, found.first_s) == (False, 0.0)
    later = what_if(directory, 3, ["neighbours.extrapolate=hold"])  # hears nobody before 0.01 s
    assert later.first_s is not None
    assert 0.0 < later.first_s < 0.5
    shown = json.loads(invoke("whatif", directory, "--agent", 3, "--controller", "bsmc", "--json").stdout)
    assert shown["components"]["surge force"]["max"] == abs(found.found - found.recorded)[:, 0].max()


def test_a_law_of_the_users(module: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = run(tmp_path, "paper", "duration=1 s")
    law = module(failing(50, "raise ValueError('enough')"))
    assert not what_if(directory, 3, [f"controller={law}:Law"]).identical
    with pytest.raises(FleetError, match="agent 2, tick 50: Law raised ValueError: enough"):
        what_if(directory, 2, [f"controller={law}:Law"])
    monkeypatch.chdir(tmp_path)
    asked = invoke("whatif", directory, "--agent", 2, "--controller", f"{law}:Law")
    line = f"fleet: agent 2, tick 50: Law raised ValueError: enough ({law}.py:10)\n"
    assert (asked.exit_code, asked.stderr.endswith(line)) == (3, True), asked.stderr  # as of a run
    coasting = what_if(directory, 2, [f"controller={law}:Law", "on_controller_error=coast"])
    assert any("enough" in note for note in coasting.notes)


def test_what_cannot_be_asked_is_refused_in_words(tmp_path: Path) -> None:
    directory = run(tmp_path, "paper", "duration=1 s")
    thin = run(tmp_path, "paper", "duration=1 s", "log.nav=5 ticks")
    check_commands("repeat/what cannot be asked", {"LOG": directory, "THIN": thin, "HERE": tmp_path}, "whatif")


def test_the_picture(tmp_path: Path) -> None:
    directory = run(tmp_path, "paper", "duration=1 s", "faults=[{at: 300 ms, for: 200 ms, mute: 1}]")
    picture = tmp_path / "3.svg"
    result = invoke("whatif", directory, "--agent", 3, "--controller", "bc", "--plot", picture)
    assert result.exit_code == 0, result.output
    assert "surge force [N]" in picture.read_text()


def test_of_a_run_that_goes_on_from_another_nothing_changed_is_identical(tmp_path: Path) -> None:
    whole = run(tmp_path, "paper", "duration=3 s", LINKS)
    for overrides in ([], ["controller=bsmc"]):  # with its memory; without
        scenario, start = continuation(whole, 1_000_000_000, overrides)
        later = execute(scenario, Options(tmp_path, in_process=True, quiet=True), wiring=Wiring(start=start)).directory
        for agent in (1, 3):
            found = what_if(later, agent)
            assert (found.identical, found.first_s, len(found.t), found.notes) == (True, None, 200, [])
    other = what_if(later, 3, ["controller=nboc"])
    assert (other.first_s, other.notes) == (1.0, ["the log begins at t = 1 s; the other agent has no memory then"])


def test_a_log_that_is_not_whole_is_said_to_be(tmp_path: Path) -> None:
    log = run(tmp_path, "paper", "duration=2 s") / "run.mcap"
    assert what_if(log, 1).notes == []
    with log.open("r+b") as file:
        file.truncate(log.stat().st_size * 2 // 3)
    result = invoke("whatif", log, "--agent", 1)
    assert result.exit_code == 0 and "note  the log is NOT WHOLE: " in result.stderr, result.output
