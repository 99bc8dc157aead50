"""Many vehicles as a band, and which of them are named."""

from __future__ import annotations

import numpy as np

from fleet.pictures.axes import outliers, spread

T = np.linspace(0.0, 10.0, 11)


def test_the_band_holds_every_sample() -> None:
    series = {i: (T, np.full(11, float(i))) for i in range(1, 12)}
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
    gap = np.where((T > 3) & (T < 6), np.nan, 1.0)
    found = spread({1: (T, gap), 2: (T, np.full(11, 3.0))})
    assert found.low.tolist() == [1.0] * 4 + [3.0] * 2 + [1.0] * 5
    assert np.isfinite(found.median).all()


def test_the_farthest_are_named_worst_first() -> None:
    series = {i: (T, np.full(11, 1.0 + 0.01 * i)) for i in range(1, 9)}
    series |= {20: (T, np.full(11, 5.0)), 21: (T, np.full(11, -9.0)), 22: (T, np.full(11, 3.0))}
    assert outliers([spread(series)], log=False) == [21, 20, 22]


def test_of_errors_only_the_large_ones_are_named() -> None:
    series = {i: (T, np.full(11, 1.0 + 0.01 * i)) for i in range(1, 9)}
    series |= {20: (T, np.full(11, 5.0)), 21: (T, np.full(11, 1e-5))}
    assert outliers([spread(series)], log=True)[0] == 20
    assert 21 not in outliers([spread(series)], log=True)
