"""A run kept in memory is the run that would be logged."""

from __future__ import annotations

import numpy as np
import pytest

from fleet.execution.clock import WINDOW_NS
from fleet.execution.in_memory import record
from fleet.scenario.loading import load_scenario

SHORT = ["duration=4 s", "checks={}"]


@pytest.mark.parametrize("every", [1, 80])
def test_a_scenario_that_logs_more_rarely_than_the_window_of_the_clock(every: int) -> None:
    """Or the clock would wait for a frame that is never due: 80 ticks are 0.8 s, the window is 0.5 s."""
    scenario = load_scenario("paper", [*SHORT, f"log={{every: {every} ticks}}"])
    if every > 1:
        assert every * scenario.tick_ns > WINDOW_NS
    found = record(scenario)
    assert found.broken == ""
    step = 0.8 if every > 1 else 0.01
    assert found.t == pytest.approx(np.arange(0.0, 4.0 + step / 2, step))
    assert found["eta"].shape == (len(found.t), 4, 5)
    assert np.isfinite(found["eta"]).all()
    assert found["tau"].shape == (len(found.t), 4, 3)


def test_samples_that_are_kept_are_those_of_every_tick() -> None:
    every = record(load_scenario("paper", SHORT))
    rarely = record(load_scenario("paper", [*SHORT, "log={every: 80 ticks}"]))
    for name in ("eta", "nu", "e", "formation"):
        assert np.array_equal(rarely[name], every[name][::80])
