"""Rare failures: parts of runs against whole ones, a scenario with a known answer, and what cannot be split."""

from __future__ import annotations

import json
import shlex
from contextlib import nullcontext
from functools import partial
from math import inf
from pathlib import Path
from statistics import fmean

import pytest
from marks import slow
from refusals import check_refusals, type_command
from study_engine import Here
from tool import invoke

from fleet.addons.studies.branches import Branches, Way, run_branches
from fleet.addons.studies.engine import local_engine
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import PartRow, Row
from fleet.execution.moments import reach
from fleet.execution.whole_run import run_loaded
from fleet.recorder.start import Leg, Start
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from netem.draws import salted_seed
from world.plugins.trust import trusting

SELDOM = """\
title: Two vehicles, and how old their news of each other gets
vehicles: 2
duration: 4 s
tick: 100 ms
seed: 3
reference: {start: 0 0 5 m, velocity: 0.5 0 0 m/s}
formation: {shape: line, spacing: 8 m}
graph: {shape: path, reference: all}
initial: {scatter: 0 m, around: reference}
network: {period: 100 ms, links: {"*": loss 20%}}
log: {every: 1 tick}
checks: {max_age: {below: 450 ms}, tumbled: waived}
"""


def seldom(*overrides: str) -> Scenario:
    return parse_scenario(SELDOM, "seldom", overrides)


def least(scenario: Scenario, salt: int, way: Way = (), best: float = inf) -> float:
    return part_of(scenario, salt, way, best).best


def streak(rounds: int, length: int, loss: float) -> float:
    """P(so many losses one after the other in so many rounds)."""
    states = [1.0, *[0.0] * length]
    for _ in range(rounds):
        lost = [0.0, *[p * loss for p in states[:length]]]
        lost[0] = sum(states[:length]) * (1 - loss)
        lost[length] += states[length]
        states = lost
    return states[length]


def part_of(
    scenario: Scenario, salt: int, way: Way = (), best: float = inf, level: float | None = None, check: str = "max_age"
) -> PartRow:
    (row,) = run_branches(scenario, Branches(check, way, (salt,), best, level), lambda t: None)
    assert row.part is not None
    return row.part


def test_a_part_without_salt_goes_on_as_the_run_did() -> None:
    scenario = seldom()
    whole = next(verdict for verdict in run_loaded(scenario).checks if verdict.check == "max_age")
    part = part_of(scenario, 0)
    assert part.best == whole.margin.value and part.ticks == scenario.ticks
    margin, tick = part.places[1]
    assert least(scenario, 0, ((0, tick),), margin) == part.best
    others = {least(scenario, salt, ((0, tick),), margin) for salt in range(1, 9)}
    assert len(others) > 1 and max(others) <= margin
    reached = part_of(scenario, 0, level=margin)
    assert reached.best == margin and reached.ticks < scenario.ticks


@pytest.mark.parametrize("link", ["loss 40%", *slow("delay 250 ms 40 ms loss gemodel 10% 30%")])
def test_parts_are_the_same_whoever_makes_them(link: str) -> None:
    """In copies of a worker at their moment, and one after the other in this process, which has other threads."""
    scenario = seldom("checks.max_age.below=9 s", "duration=2 s", f"network.links.*={link}")
    way = tuple((salt, place[1]) for salt, place in enumerate(part_of(scenario, 3).places[1:4], start=3))
    asked = Branches("max_age", way, (1, 2, 3, 0))
    task = Task("parts", 0, scenario.seed, "seldom", scenario.to_yaml(), inf, branches=asked)
    rows: list[Row] = []
    with local_engine(1) as engine:
        engine.make(iter([task]), rows.extend, lambda: None)
    here = run_branches(scenario, asked, lambda t: None)
    assert [one.part for one in rows[0].futures] == [one.part for one in here]
    alone = [part_of(scenario, salt, way).best for salt in asked.salts]
    assert [one.part.best for one in here if one.part is not None] == alone


def waits(scenario: Scenario, seed: int) -> list[list[int]]:
    """For the first places of a run, how many ticks each of ten branches takes to news that is a tick older."""
    return [
        [part_of(scenario, salt, ((seed, tick),), margin, margin - 0.05).ticks - tick for salt in range(1, 11)]
        for margin, tick in part_of(scenario, seed).places[1:4]
    ]


@pytest.mark.parametrize("link", ["delay 250 ms 40 ms loss 40%", *slow("loss 40%", "delay 250 ms loss 40%")])
def test_the_fate_of_the_next_packet_is_still_open_in_a_branch(link: str) -> None:
    """It was drawn before its moment: news got older at the next tick in all branches of a place, or in none."""
    scenario = seldom("checks.max_age.below=9 s", "duration=2 s", f"network.links.*={link}")
    found = [ticks for seed in (1, 2, 3, 4) for ticks in waits(scenario, seed)]
    at_once = [sum(wait == 1 for wait in ticks) / 10 for ticks in found]
    assert len(found) >= 8 and 0.25 < fmean(at_once) < 0.65
    assert all(0.0 < share < 1.0 for share in at_once)


def test_the_margin_of_a_moment_is_that_of_the_verdict() -> None:
    """To the last bit: a level is one of them, and is compared with the other."""
    scenario = seldom("checks.max_age.below=750 ms", "network.links.*.loss=30%")
    rows = [part_of(scenario, salt) for salt in range(1, 30)]
    found = {margin for part in rows for margin, _ in part.places}
    assert len(found) >= 6 and found <= {0.75 - age * 0.1 for age in range(20)}


LAW = """\
from agents.api import Signal


class Drunk:
    signals = (Signal("total", "1", "where it is"),)

    def __init__(self, config):
        self.at = 0

    def transmit(self, nav):
        return (b"here",)

    def decide(self, nav, deliveries):
        self.at += 1 if int(nav.eta[2] * 1e9) % 2 else -1  # a coin, of the noise of the depth
        return (0.0, 0.0, 0.0), {"total": float(self.at)}
"""


def test_a_signal_counts_once_the_moment_has_the_noise_that_made_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A branch measures anew at its first tick: what counted before would be taken back, and the estimate too low."""
    (tmp_path / "drunk.py").write_text(LAW, "utf-8")
    (tmp_path / "drunk.yaml").write_text(SELDOM, "utf-8")
    monkeypatch.chdir(tmp_path)
    check = "{signal: [{name: high, topic: control.total, vehicles: '1', below: 15.5}], tumbled: waived}"
    changes = ("agent={law: 'drunk:Drunk'}", "sensors={position_noise: 0.1 m}", f"checks={check}")
    with trusting(True):
        scenario = load_scenario(Path("drunk.yaml"), changes)
    places = [(salt, *place) for salt in (1, 2, 3) for place in part_of(scenario, salt, check="high").places]
    assert len(places) > 6
    for salt, margin, tick in places:
        life = reach(Start((Leg(scenario, tick, salt),))).run.life(1)
        assert life.core._user.at == 15.5 - margin


def test_no_salt_is_the_seed_itself() -> None:
    assert salted_seed(7, 0) == 7
    assert len({salted_seed(7, salt) for salt in range(100)}) == 100


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.addons.studies.engine.engine_of", lambda *_: nullcontext(Here()))
    monkeypatch.chdir(tmp_path)
    Path("seldom.yaml").write_text(SELDOM, "utf-8")


call = partial(invoke, "rare", "seldom.yaml")


@pytest.mark.usefixtures("here")
def test_it_finds_the_known_probability_and_goes_on() -> None:
    options = ("--check", "max_age", "--effort", "8", "--set", "duration=3 s", "--json")
    first = json.loads(call(*options, "--repeats", "1").stdout)
    result = call(*options, "--repeats", "3")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    kept = [one["probability"] for one in json.loads(Path("seldom-rare.json").read_text("utf-8"))["repeats"]]
    assert len(kept) == 3 and kept[0] == first["probability"] and fmean(kept) == found["probability"]
    answer = 1 - (1 - streak(30, 4, 0.2)) ** 2
    assert answer / 4 < found["probability"] < answer * 4
    assert call("--check", "max_age", "--repeats", "2").exit_code != 0  # the file is of another run


@pytest.mark.usefixtures("here")
def test_what_cannot_be_split_is_told() -> None:
    check_refusals("study/rare failures", lambda line: type_command("rare", "seldom.yaml", *shlex.split(line)))


@pytest.mark.usefixtures("here")
def test_where_no_repeat_gets_to_a_failure_there_is_no_upper_bound() -> None:
    """An interval from 0 to 0 would be a certainty that nobody has."""
    options = ("--check", "max_age", "--effort", "4", "--repeats", "3", "--set", "duration=600 ms")
    options += ("--set", "checks.max_age.below=30 s")
    found = json.loads(call(*options, "--json").stdout)
    assert (found["probability"], found["low"], found["high"]) == (0.0, 0.0, None)
    assert "no repeat got as far as a failure" in call(*options).stdout
