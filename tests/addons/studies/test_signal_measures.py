"""Measures of signals against the log of the same run."""

from __future__ import annotations

from math import isnan
from pathlib import Path

import numpy as np
import pytest
from small_scenario import SMALL, small

from fleet.addons.studies.plan import Plan
from fleet.addons.studies.signal_measures import (
    Samples,
    find_columns,
    measures_of_checks,
    parse_signal,
    signal_columns_of,
)
from fleet.addons.studies.spec import StudySpec
from fleet.addons.studies.summary import DEFAULT
from fleet.addons.studies.sweep import prepare
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.whole_run import run_loaded
from fleet.logs.open_log import open_log
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.overrides import SET, Override


def numbers(scenario: Scenario, *names: str) -> dict[str, float]:
    samples = Samples(scenario, names)
    run_loaded(scenario, watcher=samples)
    return samples.numbers()


@pytest.mark.parametrize("every", ["1 tick", "7 ticks"])
def test_a_measure_is_that_of_the_samples_in_the_log(tmp_path: Path, every: str) -> None:
    scenario = small(f"log={{every: {every}}}", "network.links={'*': delay 50ms loss 30%}")
    directory = execute(scenario, Options(tmp_path, in_process=True, quiet=True)).directory
    log = open_log(directory)
    topics = [{i: log[f"uuv/{i}/{group}"] for i in (1, 2, 3)} for group in ("error", "command", "guidance", "state")]
    error, command, guidance, state = topics
    late = {i: error[i].e_norm[error[i].t >= 0.5] for i in error}
    rho = {i: np.linalg.norm(guidance[i].rho, axis=1) for i in guidance}
    expected = {
        "p95 error.e_norm": max(np.percentile(error[i].e_norm, 95) for i in error),
        "max |error.e|": max(np.linalg.norm(error[i].e, axis=1).max() for i in error),
        "mean uuv/2/error.e_norm after 500 ms": late[2].mean(),
        "min command.tau_0": min(command[i].tau[:, 0].min() for i in command),
        "max |command.applied_2|": max(abs(command[i].applied[:, 2]).max() for i in command),
        "final uuv/3/state.z": state[3].z[-1],
        "rms |guidance.rho|": max(np.sqrt((rho[i] ** 2).mean()) for i in rho),
        "p50 nav.x": max(np.percentile(log[f"uuv/{i}/nav"].x, 50) for i in (1, 2, 3)),
    }
    found = numbers(scenario, *expected)
    least = found.pop("separation_min_m")
    assert found == pytest.approx(expected, rel=1e-12)
    if every == "1 tick":
        places = [np.stack([state[i].x, state[i].y, state[i].z], axis=1) for i in state]
        apart = [np.linalg.norm(places[a] - places[b], axis=1).min() for a, b in ((0, 1), (0, 2), (1, 2))]
        assert least == pytest.approx(min(apart))


def test_names_and_units_are_those_of_columns() -> None:
    texts = ["p95  control.u_err", "max |uuv/*/error.e|  after 0.5 s", "mean guidance.neighbours_heard"]
    columns = signal_columns_of(texts, [small()])
    assert [(column.name, column.unit) for column in columns] == [
        ("p95 control.u_err", "m/s"),
        ("max |error.e| after 500 ms", "m"),
        ("mean guidance.neighbours_heard", ""),
    ]
    assert find_columns(["p95 control.u_err"], columns) == columns[:1]
    assert str(parse_signal("final uuv/3/state.z")) == "final uuv/3/state.z"


def test_a_signal_that_one_point_lacks_is_missing_there() -> None:
    points = [small("controller=boc"), small()]
    (column,) = signal_columns_of(["max control.cmd_rate_0"], points)  # not of the neurodynamic law
    assert isnan(numbers(points[1], column.name)[column.name])
    assert not isnan(numbers(points[0], column.name)[column.name])


def test_a_dead_agent_reports_nothing() -> None:
    found = numbers(small("faults=[{at: 0 s, kill: 2}]"), "max uuv/2/guidance.u_cmd", "max guidance.u_cmd")
    assert isnan(found["max uuv/2/guidance.u_cmd"])
    assert not isnan(found["max guidance.u_cmd"])


CHECKED = (
    "checks={signal: [{topic: state.z, below: 6 m}, {topic: state.u, above: -1 m/s}, {topic: '|error.e|', below: 9 m}, "
    "{topic: command.tau_0, within: [-9 N, 9 N]}, {topic: error.e_norm, below: 3 m}]}"
)


def test_signals_that_checks_name_are_measured_without_asking(tmp_path: Path) -> None:
    """By how near the check they came; the errors have measures of their own already."""
    expected = ("max state.z", "min state.u", "max |error.e|", "final command.tau_0")
    assert measures_of_checks([small(CHECKED)]) == expected
    file = tmp_path / "small.yaml"
    file.write_text(SMALL, "utf-8")
    store, _ = prepare(Plan(str(file), (Override(SET, CHECKED),), seeds=(1,)), tmp_path / "s")
    assert store.record.measures == (*DEFAULT, *expected)
    assert {column.name: column.unit for column in store.record.columns}["max state.z"] == "m"
    asked = StudySpec(str(file), measures=["e_rms_m"])
    store, _ = prepare(Plan(str(file), (Override(SET, CHECKED),), seeds=(1,)), tmp_path / "t", spec=asked)
    assert store.record.measures == ("e_rms_m",)
