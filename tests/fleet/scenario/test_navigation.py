"""The section `navigation`: grades, fixes and traces, per vehicle; how mistakes are told; that a log needs no file."""

from __future__ import annotations

import os
import tomllib
from importlib import resources
from math import radians
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import check_refusals
from small_scenario import SMALL, read_back, small

from fleet.errors import ScenarioError
from fleet.scenario.loading import parse_scenario
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.navigation import NUMBERS, load_grade, shipped_grades
from fleet.scenario.sections.navigation_trace import parse_trace
from netem.fault_kinds import WorldFaultKind
from world.navigation.config import DeadReckoning, NavigationTrace, TracePoint

TRACE = "time [s], north [m], east [m], down [m], heading [deg]\n0, 0, 0, 0, 1\n0.5, 0.25, -1, 0, 2\n"


def shipped_text(name: str = "mems") -> str:
    return (resources.files("world.navigation") / f"{name}.toml").read_text("utf-8")


def test_grades_ship_and_say_where_each_number_comes_from() -> None:
    assert shipped_grades() == ["mems", "tactical"]
    for name in shipped_grades():
        values = tomllib.loads(shipped_text(name))
        assert list(values["grade"]) == [*NUMBERS]
        assert all(len(entry["source"]) > 9 for entry in values["grade"].values())
        assert values["name"] == name
    assert load_grade("mems").gyro_bias == pytest.approx(radians(3.0) / 3600.0)
    assert load_grade("mems").gyro_walk == pytest.approx(radians(0.34) / 60.0)
    assert load_grade("mems") is load_grade("mems")  # each vehicle of each run asks for it


@pytest.mark.parametrize("ideal", [(), ("navigation=ideal",)])
def test_ideal_is_how_it_was(ideal: tuple[str, ...]) -> None:
    s = small(*ideal)
    assert all(control.navigation is None for control in s.controls)
    assert ("navigation" in s.to_yaml()) == bool(ideal)
    assert "belief" not in s.log_every


def test_what_each_vehicle_has() -> None:
    usbl = "navigation={bottom: 80 m, dvl_scale: 1 %, usbl: {at: 1 2 3 m, noise_per_distance: 2 %}}"
    others = 'per_vehicle={"2": {navigation: ideal}, "3": {navigation: {grade: mems, gps: {depth: 1 m}}}}'
    s = small(usbl, others, "log.belief=5 ticks")
    first, second, third = (control.navigation for control in s.controls)
    assert isinstance(first, DeadReckoning) and isinstance(third, DeadReckoning) and second is None
    assert (first.grade.dvl_scale, first.grade.heading_rate, first.bottom, first.start) == (0.01, 10.0, 80.0, 1.0)
    (fix,) = first.fixes
    assert (fix.kind, fix.at, fix.growth, fix.period_ns, fix.loss) == ("usbl", (1.0, 2.0, 3.0), 0.02, 5 * 10**9, 0.1)
    assert third.grade == load_grade("mems")  # the scale error belonged to the grade below
    assert [source.kind for source in third.fixes] == ["gps", "usbl"]
    assert (s.log_every["belief"], s.log_every["nav"]) == (5, 1)
    read_back(s)


def test_a_log_needs_no_file(tmp_path: Path) -> None:
    """Neither of a grade of the user's nor of a trace: their content stands in the merged scenario."""
    (tmp_path / "own.toml").write_text(shipped_text().replace("value = 4.2,", "value = 5.5,"))
    (tmp_path / "nav.csv").write_text("\ufeff" + TRACE.replace("\n", "\r\n"))
    per_vehicle = 'per_vehicle={"2": {navigation: {trace: nav.csv}}}'
    s = parse_scenario(SMALL, "small.yaml", ["navigation={grade: own.toml, tilt: 1 deg}", per_vehicle], tmp_path)
    own, traced, _ = (control.navigation for control in s.controls)
    assert (own.grade.dvl_noise, own.grade.tilt) == (pytest.approx(0.055), radians(1.0))
    assert traced == NavigationTrace((TracePoint(0, 0, 0, 0, radians(1.0)), TracePoint(0.5, 0.25, -1, 0, radians(2.0))))
    for name in ("own.toml", "nav.csv"):
        (tmp_path / name).unlink()
    again = read_back(s)
    assert [control.navigation for control in again.controls] == [control.navigation for control in s.controls]


def test_mistakes_in_a_trace_have_their_line() -> None:
    cases = [
        "",
        TRACE.splitlines()[0],
        TRACE + "0.5, 0, 0, 0, 0\n",
        TRACE + "\n1, 0, 0, 0\n",
        TRACE + "1, nan, 0, 0, 0\n",
        TRACE + "1, 1e300, 0, 0, 0\n",
        TRACE + "x\n" * 30,
    ]
    check_refusals("scenario/traces of navigation", lambda text: parse_trace(text, "nav.csv"), cases)


@given(st.text(max_size=60) | st.text("0123456789.,-e \n", max_size=80).map(TRACE.__add__))
def test_any_text_is_a_trace_or_is_refused_in_words(text: str) -> None:
    try:
        points = parse_trace(text, "nav.csv")
    except DataFileError:
        return
    assert [point.t for point in points] == sorted({point.t for point in points})


def test_a_trace_that_is_no_file_or_too_long(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "long.csv").write_text(TRACE + "1, 0, 0, 0, 0\n" * 40_000)
    for name, words in (("pipe.csv", "it is a pipe, not a file"), ("long.csv", "it is larger than 0.4 MB")):
        with pytest.raises(ScenarioError, match=words):
            parse_scenario(SMALL, "small.yaml", [f"navigation.trace={name}"], tmp_path)


@pytest.mark.parametrize(
    ("entry", "values"),
    [
        ("dvl: {vehicles: 1-2, lost: 50 %, bias: 0.1 0 0 m/s}", (0.5, 0.1, 0.0, 0.0, 0.0, 0.1)),
        ("compass: {bias: 1 rad, jump: 2 rad, chance: 100 %}", (0.0, 1.0, 2.0, 1.0)),
        ("fix: {bias: 3 4 m, lost: 1 %}", (0.01, 3.0, 4.0, 0.0, 0.1)),
    ],
)
def test_faults_of_instruments(entry: str, values: tuple[float, ...]) -> None:
    s = small("navigation={gps: {}}", f"faults=[{{at: 100 ms, for: 200 ms, {entry}}}]")
    (found,) = s.world_config.faults
    assert (found.kind, found.values) == (entry.partition(":")[0], values)
    assert len(values) == WorldFaultKind(found.kind).numbers
    read_back(s)


def test_a_check_of_belief_is_read_though_the_laws_may_not_run() -> None:
    """A log of a law that is not here can still be opened."""
    more = "controller: not_here:Law\nnavigation: dead-reckoning\nchecks: {signal: {topic: belief.nees, below: 20}}\n"
    text = SMALL.replace("{period: 50 ms}", "ideal") + more
    assert parse_scenario(text, "x.yaml").belief(1)
