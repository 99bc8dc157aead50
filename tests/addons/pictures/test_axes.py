"""What pictures over time have in common: windows, bands of many vehicles, and envelopes of what oscillates."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.pictures.axes import (
    BAND,
    COLUMNS,
    clip_to_window,
    outliers,
    reach,
    split_envelope,
    spread,
    vehicle_colours,
)
from fleet.palette import COLOURS


@pytest.mark.parametrize(
    ("window", "kept"),
    [
        (None, [0.0, 1.0, 2.0, np.nan, 5.0, 6.0]),
        ((0.5, 1.5), [0.0, 1.0, 2.0]),
        ((1.2, 1.4), [1.0, 2.0]),  # between two samples: the line crosses the window
        ((2.5, 4.5), [2.0, np.nan, 5.0]),
        ((5.5, 9.0), [5.0, 6.0]),
        ((7.0, 9.0), [6.0]),
    ],
)
def test_a_line_reaches_the_edges_of_a_window(window: tuple[float, float] | None, kept: list[float]) -> None:
    t = np.array([0.0, 1.0, 2.0, np.nan, 5.0, 6.0])
    found, values = clip_to_window(t, 10.0 * t, window)
    np.testing.assert_array_equal(found, kept)
    np.testing.assert_array_equal(values, 10.0 * np.array(kept))


TEN = np.linspace(0.0, 10.0, 11)


def test_the_band_holds_every_sample() -> None:
    series = {i: (TEN, np.full(11, float(i))) for i in range(1, 12)}
    found = spread(series)
    assert (found.low == 1.0).all() and (found.high == 11.0).all()
    assert (found.most_low == 2.0).all() and (found.median == 6.0).all() and (found.most_high == 10.0).all()


def test_a_short_peak_stays_within_the_band_of_many_samples() -> None:
    t = np.linspace(0.0, 100.0, 10_001)
    values = np.zeros_like(t)
    values[5000] = 7.0
    found = spread({1: (t, np.zeros_like(t)), 2: (t, values)})
    assert len(found.t) < 1000
    assert found.high.max() == 7.0 and found.low.min() == 0.0


def test_a_vehicle_without_samples_for_a_while_leaves_the_others() -> None:
    gap = np.where((TEN > 3) & (TEN < 6), np.nan, 1.0)
    found = spread({1: (TEN, gap), 2: (TEN, np.full(11, 3.0))})
    assert found.low.tolist() == [1.0] * 4 + [3.0] * 2 + [1.0] * 5
    assert np.isfinite(found.median).all()


def test_the_farthest_are_named_worst_first() -> None:
    series = {i: (TEN, np.full(11, 1.0 + 0.01 * i)) for i in range(1, 9)}
    series |= {20: (TEN, np.full(11, 5.0)), 21: (TEN, np.full(11, -9.0)), 22: (TEN, np.full(11, 3.0))}
    assert outliers([spread(series)], log=False) == [21, 20, 22]


def test_of_errors_only_the_large_ones_are_named() -> None:
    series = {i: (TEN, np.full(11, 1.0 + 0.01 * i)) for i in range(1, 9)}
    series |= {20: (TEN, np.full(11, 5.0)), 21: (TEN, np.full(11, 1e-5))}
    assert outliers([spread(series)], log=True)[0] == 20
    assert 21 not in outliers([spread(series)], log=True)


SPAN = (0.0, 60.0)
T = np.arange(0.0, 60.0, 0.01)


def test_what_oscillates_slowly_or_hardly_is_drawn_as_it_is() -> None:
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(T))
    for values in (np.sin(T), np.zeros(len(T)), np.floor(T / 5.0), T + noise, np.full(len(T), np.nan)):
        line, around = split_envelope(T, values, SPAN, reach([(T, values)]))
        assert around is None and line[0] is T and line[1] is values
    assert split_envelope(T[:5], np.array([0.0, 1.0, 0.0, 1.0, 0.0]), SPAN, 1.0)[1] is None


@pytest.mark.parametrize("log", [False, True])
def test_a_fast_oscillation_has_its_extremes_and_its_mean(log: bool) -> None:
    """From 20 s on: before, the line has every sample."""
    values = np.where(T < 20.0, 2.0, 2.0 + np.where(np.arange(len(T)) % 2, 1.0, -1.0))
    (t, drawn), around = split_envelope(T, values, SPAN, reach([(T, values)], log), log)
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
    (drawn_t, drawn), around = split_envelope(t, values, SPAN, reach([(t, values)]))
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
    (drawn_t, drawn), around = split_envelope(t, values, SPAN, reach([(t, values)]))
    assert around is not None
    (gap,) = np.flatnonzero(np.isnan(drawn_t))
    assert np.isnan(drawn[gap]) and drawn_t[gap - 1] < 31.0 and drawn_t[gap + 1] > 29.0


def test_a_vehicle_has_one_colour_in_all_pictures() -> None:
    assert [vehicle_colours([i])[i] for i in range(1, 8)] == list(COLOURS)
    found = vehicle_colours([1, 8, 15, 33])
    assert found[1] == COLOURS[0] and len(set(found.values())) == 4 and BAND not in COLOURS
