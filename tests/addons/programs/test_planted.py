"""Defects that are planted in programs: a search finds each, and the least run that it found fails for this reason."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent
from typing import NamedTuple

import pytest
from repository import ROOT
from tool import invoke

import fleet

EXAMPLES = ROOT / "docs/examples"
MEMBERS = r"""
    name: member
    title: member.py in simulated time
    vehicles: 3
    moored: true
    tick: 10 ms
    duration: 20 s
    graph: {shape: ring}
    network: {period: 10 ms, links: {"*": delay 40ms 20ms loss 20%}}
    agent:
      program: member.py
      arguments: ["{zenoh}", "{id}", "3", "1"]
      signals: {leader: {line: '[\d.]+ (?P<value>\d+)$'}}
    nemesis: {mode: episodes, unit: 1 s}
    checks: {"one_leader:OneLeader": {}}
"""
ONE_LEADER = '''
    """At most one member leads at a time, by what each says of itself."""

    from fleet.checks.api import Facts, Failure, Tick


    class OneLeader:
        def __init__(self, facts: Facts) -> None:
            """No number is needed."""

        def step(self, tick: Tick) -> Failure | None:
            leads = tuple(each.id for each in tick.vehicles if each["control.leader"] == each.id)
            return Failure(f"{leads} lead at the same time", leads) if len(leads) > 1 else None
'''


class Planted(NamedTuple):
    """A defect, and the least run that a search has found for it."""

    program: str
    sound: str  # what stands in the program ...
    defect: str  # ... and what stands there with the defect
    check: str  # it fails
    least: tuple[str, ...]  # changes of the scenario
    search: tuple[str, ...] = ()  # what a search is asked for
    found: int = 1  # the first seed that a search found

    def write(self, folder: Path, planted: bool = True) -> str:
        """Write the program, with the defect or without, and its scenario; returns the scenario's name."""
        source = EXAMPLES / self.program
        text = source.read_text("utf-8")
        assert text.count(self.sound) == 1
        (folder / source.name).write_text(text.replace(self.sound, self.defect) if planted else text, "utf-8")
        own = source.with_suffix(".yaml")
        scenario = own.read_text("utf-8") if own.exists() else dedent(MEMBERS)
        (folder / own.name).write_text(scenario, "utf-8")
        (folder / "one_leader.py").write_text(dedent(ONE_LEADER).strip() + "\n", "utf-8")
        return own.name


_SET = "        self.voted, self.until = (asker, number), now + LEASE_S\n"
_SAY = '        await self.say(f"votes for {asker}")\n'
DEFECTS = {
    "an expired grant counts": Planted(
        "election_stack/member.py", " if now < record[2])", ")", "OneLeader",
        ("seed=3", "duration=9 s", "nemesis=null", 'faults=[{at: 7.33 s, for: 990 ms, partition: "1 / 2,3"}]'),
        found=3,
    ),
    "a lease is forgotten after a restart": Planted(
        "election_stack/member.py", "self.silent_until = now + lease_s", "self.silent_until = now", "OneLeader",
        (
            "seed=1885", "duration=2.81 s", "nemesis=null",
            'faults=[{at: 1.75 s, for: 500 ms, partition: "3 / 1,2"}, {at: 2.25 s, for: 1.75 s, partition: "2,3 / 1"}, '
            '{at: 2.25 s, for: 10 ms, kill: "2"}]',
        ),
        ("--set", "nemesis={mode: episodes, unit: 1 s, pick: [partition, kill]}"), found=95,
    ),
    "a vote is given twice while a line is printed": Planted(
        "sonar_lease/sonar.py", _SET + _SAY, _SAY + _SET, "one-at-a-time",
        ("seed=14", "duration=1.12 s", "nemesis=null"), found=14,
    ),
    "a vote is freed by an older number": Planted(
        "sonar_lease/sonar.py", "self.voted == (other, number)", "self.voted[0] == other", "one-at-a-time",
        ("seed=2", "duration=2.3 s", "nemesis=null"),
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def failed(name: str, *changes: str) -> list[str]:
    return [verdict.check for verdict in fleet.run(name, set=changes).checks if verdict.failed]


@pytest.mark.parametrize("defect", DEFECTS.values(), ids=DEFECTS)
def test_the_least_run_fails_with_the_defect_only(defect: Planted, tmp_path: Path) -> None:
    assert failed(defect.write(tmp_path), *defect.least) == [defect.check]
    assert failed(defect.write(tmp_path, planted=False), *defect.least) == []


@pytest.mark.slow
@pytest.mark.timeout(1200)  # a machine half as fast as usual took 570 s for the longest
@pytest.mark.parametrize("defect", DEFECTS.values(), ids=DEFECTS)
def test_a_search_finds_the_defect_and_nothing_without_it(defect: Planted, tmp_path: Path) -> None:
    asked = ("--check", defect.check, "--workers", 1, "--quiet", *defect.search)
    first = f"seed={max(1, defect.found - 19)}"
    found = invoke("search", defect.write(tmp_path), *asked, "--budget", 20, "--set", first)
    assert found.exit_code == 1, found.output
    assert f"Then {defect.check} fails" in found.stdout
    name = defect.write(tmp_path, planted=False)
    sound = invoke("search", name, *asked, "--budget", 20, "--set", first, "--out", "sound.yaml")
    assert sound.exit_code == 0, sound.output
    assert f"none of 20 runs fails the check {defect.check}" in sound.stdout
