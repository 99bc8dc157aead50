"""Vehicles kept apart in whole runs: columns that cross over a bad network, and a cylinder on the course."""

from __future__ import annotations

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from repository import ROOT

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.whole_run import run
from fleet.result.result import Status
from fleet.scenario.loading import parse_scenario

# Drawn by docs/examples/keep_apart_crossings.py. Without a limit of the vertical velocity vehicles tumble in the first.
CROSSINGS = (0, 53, 99, 107, 149, 151)

CYLINDER = """\
title: A cylinder lies on the course
vehicles: 1
duration: 60 s
reference: {start: 0 0 10 m, velocity: 0.7 0 0 m/s}
formation: {offsets: [0 0 0 m]}
graph: {shape: complete}
initial: {scatter: 0 m, surge: 0.7 m/s, around: reference}
profile: hardened
guidance: {rho_lo: 0.2 -1 -0.4 m/s, rho_hi: 1.4 1 0.4 m/s}
network: {period: 100 ms}
keep_apart: {distance: 3 m, obstacles: [{at: 20 0 m, radius: 2 m}]}
"""


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, {"network.links": "{}"}, {"keep_apart": "null"}], ids=["lossy", "good", "off"])
def test_columns_cross_and_keep_their_distance(changes: dict[str, str]) -> None:
    """Over 30 % of loss and 300 ms of delay, over a good network; and not without the section."""
    result = run("crossing", set={**changes, "log": "none"})
    failed = {verdict.check for verdict in result.checks if not verdict.passed}
    assert failed == ({"min_separation"} if "keep_apart" in changes else set()), result.checks


@pytest.fixture(scope="module")
def crossings() -> Any:
    spec = spec_from_file_location("keep_apart_crossings", ROOT / "docs/examples/keep_apart_crossings.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("number", CROSSINGS)
def test_in_crossings_that_are_drawn_nobody_tumbles_and_the_distance_holds(number: int, crossings: Any) -> None:
    found = crossings.crossed(number)
    assert found.tumbles == 0
    assert found.steepest < 80.0
    assert found.least > 3.0


def test_a_vehicle_goes_round_a_cylinder_on_its_course(tmp_path: Path) -> None:
    result = execute(parse_scenario(CYLINDER, "cylinder.yaml"), Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, result.checks
    log = fleet.open_log(result.directory)
    state, guidance = log["uuv/1/state"], log["uuv/1/guidance"]
    assert np.hypot(state.x - 20.0, state.y).min() > 2.0
    assert state.x[-1] > 35.0, "it is past the cylinder"
    assert abs(state.y[-1]) < 0.5, "and on its course again"
    assert guidance.keep_apart_active.max() == 1.0
    assert guidance.keep_apart_infeasible[-1] == 0.0


@pytest.mark.once
@pytest.mark.parametrize("changes", [{}, *slow({"keep_apart": "null"})], ids=["on", "off"])
def test_the_page_s_own_scenario_and_check(
    changes: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "docs/guide/keep-apart.md").read_text("utf-8")
    for name, text in re.findall(r"```(?:python|yaml)\n# (\w+\.\w+)\n(.*?)```", page, re.S):
        (tmp_path / name).write_text(text, "utf-8")
    monkeypatch.chdir(tmp_path)
    result = run("pile.yaml", set={**changes, "log": "none"})
    failed = {verdict.check for verdict in result.checks if not verdict.passed}
    assert failed == ({"Outside"} if changes else set()), result.checks
    assert {"Outside", "min_separation"} <= {verdict.check for verdict in result.checks}
