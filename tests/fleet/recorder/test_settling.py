"""When an error counts as settled: the answer must not depend on when the run ends."""

from __future__ import annotations

from io import StringIO
from math import exp, inf, nan, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone
from rich.console import Console as Terminal

from fleet.cli.result_table import show
from fleet.recorder.settling import least_s, settling_time
from world.config import Harmonic
from world.disturbance import PAPER

LIMIT = 0.05
STEP = 0.05

ENDS = st.integers(int(30 / STEP), int(150 / STEP))  # samples


def times(samples: int) -> list[float]:
    return [k * STEP for k in range(samples)]


@given(ENDS, st.floats(0.5, 3.0), st.floats(0.0, 2 * pi))
def test_an_error_that_keeps_crossing_its_limit_is_not_settled(n: int, omega: float, phase: float) -> None:
    """However short before the end of the run it came below for the last time."""
    e = [1.5 * LIMIT * abs(sin(0.5 * (omega * s + phase))) for s in times(n)]
    assert settling_time(times(n), e, LIMIT, [Harmonic(1.0, omega)]) is None


@given(ENDS, ENDS, st.floats(0.5, 6.0), st.floats(0.0, 0.9))
def test_what_settled_did_so_at_the_same_time_in_a_longer_run(n: int, m: int, rate: float, ripple: float) -> None:
    """The time is one of the error's, or it is too early to tell; never another one."""
    e = [2.0 * exp(-s / rate) + LIMIT * ripple * 0.5 * (1.0 + sin(s)) for s in times(max(n, m))]
    short, long = (settling_time(times(k), e[:k], LIMIT, PAPER) for k in sorted((n, m)))
    assert short is None or short == long


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([3, 2, 1, 0.5, 0.5], 3.0),
        ([3, 0.5, 2, 0.5, 0.5], 3.0),
        ([0.5] * 5, 0.0),
        ([3, 0.5, 0.5, 0.5, 1.0], None),
        ([3, 2, 2, 2, 0.5], None),  # below in the last sample only, which shows nothing
        ([0.5, nan, 0.5, 0.5, 0.5], 2.0),
        ([0.5, inf, 0.5, 0.5, 0.5], 2.0),
        ([nan] * 5, None),
    ],
)
def test_settling_time(values: list[float], expected: float | None) -> None:
    assert settling_time([0.0, 1.0, 2.0, 3.0, 4.0], values, 1.0, ()) == expected


def test_how_long_is_long_enough() -> None:
    """Two periods of the slowest force there is, and a tenth of the time, but no more than 10 s, in any case."""
    assert least_s((), 40.0) == 4.0
    assert least_s((), 3600.0) == 10.0
    assert least_s(PAPER, 60.0) == pytest.approx(4 * pi)
    assert least_s((Harmonic(1.0, 2.0), Harmonic(1.0, 0.5), Harmonic(0.0, 0.01)), 60.0) == pytest.approx(8 * pi)
    assert least_s((Harmonic(1.0, 100.0), Harmonic(1.0, 0.0)), 60.0) == 6.0


@pytest.mark.slow
def test_a_run_that_ends_just_below_the_limit_is_not_settled(made: Alone) -> None:
    """BOC in the paper's disturbance crosses 5 cm in every period, the last time 3 s before the end of a minute."""
    overrides = ["controller=boc", "sea.disturbance=paper", "checks={}", "log.every=10 ticks"]
    result = made("ideal", *overrides)
    rows = result.values["vehicles"].values()
    assert [row["settle_10pct_s"] for row in rows] == pytest.approx([7.71, 6.91, 7.05, 7.82], abs=0.11)
    assert [row["settle_5cm_s"] for row in rows] == [None] * 4
    terminal = Terminal(file=StringIO(), width=120)
    show(result, terminal)
    assert terminal.file.getvalue().count("not settled") == 4  # type: ignore[attr-defined]
