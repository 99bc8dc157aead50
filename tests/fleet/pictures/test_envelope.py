"""Signals that oscillate faster than the pixels have an envelope; no other has."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.pictures.axes import COLUMNS, enveloped, reach

SPAN = (0.0, 60.0)
T = np.arange(0.0, 60.0, 0.01)


def test_what_oscillates_slowly_or_hardly_is_drawn_as_it_is() -> None:
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(T))
    for values in (np.sin(T), np.zeros(len(T)), np.floor(T / 5.0), T + noise, np.full(len(T), np.nan)):
        line, around = enveloped(T, values, SPAN, reach([(T, values)]))
        assert around is None and line[0] is T and line[1] is values
    assert enveloped(T[:5], np.array([0.0, 1.0, 0.0, 1.0, 0.0]), SPAN, 1.0)[1] is None


@pytest.mark.parametrize("log", [False, True])
def test_a_fast_oscillation_has_its_extremes_and_its_mean(log: bool) -> None:
    """From 20 s on: before, the line has every sample."""
    values = np.where(T < 20.0, 2.0, 2.0 + np.where(np.arange(len(T)) % 2, 1.0, -1.0))
    (t, drawn), around = enveloped(T, values, SPAN, reach([(T, values)], log), log)
    fast = around.t[np.isfinite(around.low)]
    assert 19.0 < fast.min() < 22.0 and fast.max() == 60.0
    assert np.nanmin(around.low) == 1.0 and np.nanmax(around.high) == 3.0
    assert (t[t < 19.0] == T[T < 19.0]).all() and (np.diff(t) > 0.0).all()
    assert drawn[t > 22.0] == pytest.approx(2.0, abs=0.3) and (t > 22.0).sum() <= COLUMNS


@given(st.lists(st.floats(-1e6, 1e6), min_size=10, max_size=3000), st.integers(0, 2**32 - 1))
def test_every_sample_is_on_the_line_or_within_the_envelope(some: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.choice(np.array(some), 5000)
    values[rng.integers(0, 5000, 5)] = np.nan
    t = np.linspace(*SPAN, 5000)
    (drawn_t, drawn), around = enveloped(t, values, SPAN, reach([(t, values)]))
    assert len(drawn_t) == len(drawn)
    if around is None:
        return
    column = np.clip(np.searchsorted(np.linspace(*SPAN, COLUMNS + 1), t, "right") - 1, 0, COLUMNS - 1)
    low, high = around.low[2 * column], around.high[2 * column]
    within = (values >= low) & (values <= high)
    assert (within | np.isin(t, drawn_t) | np.isnan(values)).all()


def test_a_gap_stays_a_gap() -> None:
    values = np.where(np.arange(len(T)) % 2, 1.0, -1.0)
    t, values = np.insert(T, 3000, np.nan), np.insert(values, 3000, np.nan)
    (drawn_t, drawn), around = enveloped(t, values, SPAN, reach([(t, values)]))
    assert around is not None
    (gap,) = np.flatnonzero(np.isnan(drawn_t))
    assert np.isnan(drawn[gap]) and drawn_t[gap - 1] < 31.0 and drawn_t[gap + 1] > 29.0
