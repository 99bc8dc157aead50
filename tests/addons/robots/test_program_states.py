"""The programs of a run as the console knows them: what was told happens at its time, and is judged; none starts."""

from __future__ import annotations

import json
from math import isnan
from pathlib import Path
from time import monotonic_ns
from types import SimpleNamespace
from typing import Any

import pytest
from known_programs import Known

from fleet.addons.robots.programs import ProgramChange
from fleet.addons.robots.relay_run import RelayRun
from fleet.errors import RunBroken
from netem.relay_messages import Watched, WatchedMessage

SIGNALS = {
    "x": {"line": "(?P<value>.*)"}, "n": {"message": "a/{node}", "count": "yes"}, "j": {"message": "b", "json": ""},
}  # fmt: skip


def one(folder: Path, **sections: Any) -> Known:
    programs = {"m1": {"run": "a"}, "m1/nav": {"run": "b"}, "m2": {"run": "c"}}
    found = Known(folder, programs=programs, signals=SIGNALS, **sections)
    found.runs("m1", "m1/nav", "m2")
    return found


def lives(found: Known) -> list[ProgramChange]:
    """The lives that have ended and begun since this was asked last, as frames have them."""
    told = [*found.changes]
    found.changes.clear()
    return told


def words(values: tuple[float, ...] | None) -> str:
    return "" if values is None else " ".join("-" if isnan(value) else f"{value:g}" for value in values)


def test_what_is_told_happens_at_its_time_whoever_tells_it(tmp_path: Path) -> None:
    """Lines come from the keeper, and messages from the relay. What is not finite is nothing said."""
    found = one(tmp_path)
    assert found.watched[:3] == [Watched(1, "a/m1"), Watched(1, "b"), Watched(2, "a/m2")]
    found.say(30, told="m1", signal=0, value=7.0)
    found.see([WatchedMessage(0, 10, "a/m1"), WatchedMessage(0, 40, "a/m1"), WatchedMessage(1, 20, "b", b"2.5")])
    found.say(50, told="m1", signal=0, value=float("inf"))
    found.see([WatchedMessage(1, 45, "b", b"broken"), WatchedMessage(1, 46, "b", b"[broken")])
    seen = [(found.advance(at), words(found.values(1)))[1] for at in (9, 10, 20, 39, 40, 50)]
    assert seen == ["- 0 -", "- 1 -", "- 1 2.5", "7 1 2.5", "7 2 2.5", "- 2 2.5"]
    assert words(found.values(2)) == "- 0 -"
    (said,) = found.shown  # once, however often it comes
    assert said.startswith("m1: signal j: b: is not json: ")


def test_a_number_of_lines_or_messages_begins_with_none(tmp_path: Path) -> None:
    """`errors below 1` failed in a run without an error: it had no value yet. Each life counts anew."""
    signals = {"errors": {"line": "error", "count": "yes"}, "n": {"message": "a", "count": "yes"}, "x": SIGNALS["x"]}
    found = Known(tmp_path, programs={"m1": {"run": "a"}}, signals=signals)
    assert words(found.values(2)) == "0 0 -"  # nobody starts its programs
    found.runs("m1")
    found.say(2000, told="m1", signal=0, value=1.0)
    found.see([WatchedMessage(0, 2001, "a")])
    found.advance(2001)
    assert words(found.values(1)) == "1 1 -"
    for at, said in ((2002, "killed"), (2003, "started"), (2004, "ready")):
        found.say(at, **{said: "m1", "pid": 5})
    found.advance(2004)
    assert words(found.values(1)) == "0 0 -"


def test_a_node_has_no_sample_while_one_of_its_programs_is_not_ready(tmp_path: Path) -> None:
    """It has said nothing when it comes back; the other node is not concerned."""
    found = one(tmp_path)
    found.say(10, told="m1", signal=0, value=7.0)
    found.say(20, killed="m1/nav")
    found.say(30, started="m1/nav", pid=5)
    found.say(40, ready="m1/nav")
    seen = [(found.advance(at), words(found.values(1)), found.gone)[1:] for at in (10, 20, 30, 40)]
    assert seen == [("7 0 -", []), ("", [1]), ("", []), ("- 0 -", [])]
    assert words(found.values(2)) == "- 0 -" and not lives(found)


def test_a_program_that_has_done_its_work_is_not_gone(tmp_path: Path) -> None:
    """Its node keeps what it has told; with another status than 0 it has failed, with its last lines."""
    found = one(tmp_path, checks={"programs": {"m1": "done", "m2": "done"}})
    found.say(2000, told="m1", signal=0, value=7.0)
    for name, code in (("m1", 0), ("m1/nav", 0), ("m2", 3)):
        found.say(3000, ended=name, code=code, tail=["last words"])
    found.advance(3000)
    assert (words(found.values(1)), words(found.values(2)), found.gone) == ("7 0 -", "", [2])
    assert lives(found) == [ProgramChange(3000, 2)]
    verdict = found.verdict(sent=True)
    assert verdict is not None and verdict.failed
    assert verdict.found == 'm2 exited with status 3 at 0.00 s: "last words"'
    assert found.deaths() == {2: ["m2 exited with status 3 at 0.00 s", "last words"]}
    found.say(4000, started="m2", pid=6)  # the operator heals it
    found.advance(4000)
    assert lives(found) == [ProgramChange(4000, 2, begins=True)]


def test_of_a_program_that_ends_a_few_lines_are_shown(tmp_path: Path) -> None:
    """And where the others are: three that died filled the screen."""
    found = one(tmp_path)
    found.say(2000, ended="m2", code=1, tail=[f"line {n}" for n in range(12)])
    found.advance(2000)
    (said,) = found.shown
    assert said.splitlines() == [
        "m2 exited with status 1 at t = 0.00 s", f"last lines of {tmp_path}/log/m2.log:",
        "  line 9", "  line 10", "  line 11",
    ]  # fmt: skip


def test_a_signal_that_nobody_has_told_leaves_a_note(tmp_path: Path) -> None:
    """Whatever it is told by. What one of its nodes has told was spoken, also if it was no number for a time."""
    signals = SIGNALS | {"k": {"of": "m2", "message": "c/{node}", "json": "a"}, "e": {"line": "error", "count": "yes"}}
    found = Known(tmp_path, programs={"m*": {"run": "a"}}, signals=signals)
    assert found.silent() == [
        "signal x: no line of m1, m2 had a number", "signal j: no message on b of m1, m2 had a number",
        "signal k: no message on c/{node} of m2 had a number",
    ]  # fmt: skip
    found.runs("m1", "m2")
    found.say(2000, told="m2", signal=0, value=1.0)
    found.advance(2000)
    assert [note.partition(":")[0] for note in found.silent()] == ["signal j", "signal k"]


def test_what_ends_after_the_run_is_no_failure(tmp_path: Path) -> None:
    found = one(tmp_path)
    found.ends_at(5000)
    found.say(5000, ended="m1", code=-15, tail=[])
    found.advance(6000)
    verdict = found.verdict(sent=True)
    assert verdict is not None and (verdict.passed, verdict.found) == (True, "all 3")


def test_of_many_that_failed_four_are_named(tmp_path: Path) -> None:
    programs = {f"m1/p{n}": {"run": "a"} for n in range(6)}
    found = Known(tmp_path, programs=programs)
    found.runs(*programs)
    for name in programs:
        found.say(2000, ended=name, code=1, tail=[])
    found.advance(2000)
    verdict = found.verdict(sent=True)
    assert verdict is not None
    assert (verdict.found.count("exited"), verdict.found[-11:], verdict.value) == (4, " and 2 more", 6)


def test_nothing_begins_before_all_are_ready(tmp_path: Path) -> None:
    """One that ends breaks the run with its last lines, unless this was all that it had to do."""
    ready = {"within": "1 ms", "line": "x"}
    programs = {"m1": {"run": "a"}, "m2": {"run": "b", "ready": ready}}
    found = Known(tmp_path, programs=programs, checks={"programs": {"m1": "done"}})
    assert found.unready() == ["m1", "m2"]
    found.say(0, started="m1", pid=1)
    found.say(1, ended="m1", code=0, tail=[])
    found.say(1, started="m2", pid=2)
    found.advance(2)
    with pytest.raises(RunBroken, match=r"m2 was not ready within 0\.001 s") as late:
        found.unready()
    assert late.value.lines[1:] == ["  (nothing printed)"]
    found.say(3, ready="m2")
    found.advance(3)
    assert found.unready() == []
    found.say(4, ended="m2", code=2, tail=["a", "b"])
    found.advance(4)
    with pytest.raises(RunBroken, match="m2 exited with status 2 before the run began") as ended:
        found.unready()
    assert ended.value.lines[1:] == ["  a", "  b"]


def test_a_time_that_programs_know_is_kept_or_the_run_breaks(tmp_path: Path) -> None:
    found = one(tmp_path)
    found._planned_ns = monotonic_ns() + 10**12  # type: ignore[assignment]
    assert found.begins(10) == found._planned_ns
    found._planned_ns = monotonic_ns() - 10**9  # type: ignore[assignment]
    with pytest.raises(RunBroken, match=r"programs were ready 1\.\d\d s after {begin_s}: give begin a longer time"):
        found.begins(10)


def test_faults_of_programs_are_told_in_times_of_the_clock(tmp_path: Path) -> None:
    """Those of the network are not; one without an end lasts."""
    faults = [
        {"at": "1 s", "for": "1 s", "kill": "m1"}, {"at": "2 s", "pause": "m1,m2"}, {"at": "1 s", "mute": "m1"},
    ]  # fmt: skip
    found = one(tmp_path, faults=faults)
    found._keeper = SimpleNamespace()  # type: ignore[assignment]
    found.plan(found._scenario.faults.parts, found._scenario.tick_ns)
    s, end = 1000 + 10**9, 1000 + 2 * 10**9
    (told,) = found.told
    assert told["dead"] == {"m1": [[s, end]]}
    assert {name: spans[0][0] for name, spans in told["paused"].items()} == {"m1": end, "m2": end}


def test_a_fault_that_is_injected_before_the_run_begins_begins_with_it() -> None:
    def granted(begin_ns: int) -> int:
        run: Any = SimpleNamespace(_begin_ns=begin_ns, _scenario=SimpleNamespace(tick_ns=1_000_000))
        return RelayRun.granted.fget(run)  # type: ignore[attr-defined,no-any-return]

    assert granted(monotonic_ns() + 10**12) == 0
    assert granted(monotonic_ns() - 10**9) >= 1000


def test_a_program_knows_where_it_runs(tmp_path: Path) -> None:
    """What it is told is filled in; the variables of others stay, and its own ones come first."""
    found = Known(
        tmp_path, programs={"m1": {"run": "a {listen} {node}", "env": {"X": "{number}", "ROS_DOMAIN_ID": 7}}}, seed=4
    )
    values = found._values_of(found.states["m1"], {"m1": "tcp/0.0.0.0:75"}, {"m1": "127.0.0.1:1101"}, 2_500_000_000)
    assert values["argv"] == ["a", "tcp/127.0.0.1:75", "m1"]
    env = values["env"]
    assert (env["X"], env["ROS_DOMAIN_ID"], env["FLEET_SEED"], env["FLEET_BEGIN_S"]) == ("1", "7", "4", "2.500")
    assert env["FLEET_MODEM"] == "127.0.0.1:1101"
    assert env["RMW_IMPLEMENTATION"] == "rmw_zenoh_cpp"
    assert json.loads((tmp_path / "zenoh-m1.json5").read_text())["connect"] == {"endpoints": ["tcp/127.0.0.1:75"]}
    alone = found._values_of(found.states["m1"], {}, {}, 0)
    assert alone["argv"] == ["a", "", "m1"] and "ZENOH_CONFIG_OVERRIDE" not in alone["env"]


def test_each_program_has_a_file_of_its_own(tmp_path: Path) -> None:
    """`m1/nav` and a node `m1-nav` shared one, and a node `relay` had that of a process of ours."""
    nodes = ("m1", "m1-nav", "relay", "keeper")
    programs = {name: {"run": "a"} for name in (*nodes, "m1/nav", "relay/nav")}
    found = Known(tmp_path, nodes={name: {} for name in nodes}, programs=programs)
    files = {found._log_of(state).name for state in found.states.values()}
    assert len(files) == len(programs) and not files & {"keeper.log", "relay.log"}
