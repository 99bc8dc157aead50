"""The filter of `docs/examples/central_filter.py`, with which localisers are compared."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from in_process_runs import Alone, log_of
from repository import ROOT

from fleet.logs.open_log import open_log
from fleet.scenario.loading import load_scenario

sys.path.insert(0, str(ROOT / "docs" / "examples"))
from central_filter import central

FEW = ("duration=13 s", "checks={}", "log={every: 5 ticks, state: 1 tick}")
SILENT = ("agent=null", "network.acoustic.ranging=null", "network.payload=full")


@pytest.mark.parametrize("changes", [SILENT, ()], ids=["no ranges", "ranges"])
def test_without_ranges_it_is_the_navigators_of_all_vehicles(changes: tuple[str, ...], alone: Alone) -> None:
    log, scenario = open_log(log_of(alone("navigation-aid", *FEW, *changes))), load_scenario("navigation-aid", FEW)
    found = central(log, scenario)
    own = np.stack([log[f"uuv/{i}/belief"].off[10::10, :2] for i in range(1, 5)], axis=1)
    same = abs(found.off[: len(own)] - own).max() < 1e-6
    assert (same, len(found.nis) > 3) == ((True, False) if changes else (False, True))
    assert found.nees[: len(own)].mean() < 5.0
