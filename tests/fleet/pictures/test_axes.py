"""What pictures over time have in common."""

from __future__ import annotations

import numpy as np
import pytest

from fleet.pictures.axes import within


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
    found, values = within(t, 10.0 * t, window)
    np.testing.assert_array_equal(found, kept)
    np.testing.assert_array_equal(values, 10.0 * np.array(kept))
