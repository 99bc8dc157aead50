"""The ellipse that holds a vehicle with 95 %, and that the picture of the tracks has it."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone, log_of

from fleet.pictures.runs import View, load
from fleet.pictures.track import top
from fleet.scene.belief import ellipse

PLACE = (1.0, 2.0, 3.0)
SIZE = st.floats(0.01, 100.0)


@given(SIZE, SIZE, st.floats(-1.5, 1.5))
def test_its_axes_are_those_of_the_covariance(a: float, b: float, bearing: float) -> None:
    turn = np.array([[np.cos(bearing), -np.sin(bearing)], [np.sin(bearing), np.cos(bearing)]])
    p = turn @ np.diag([a * a, b * b]) @ turn.T
    found = ellipse(3, PLACE, [p[0, 0], p[0, 1], 0, 0, p[1, 1], 0, 0, 1, 0, 1])
    assert found is not None
    assert found.colour == "vehicle 3"
    around = np.array([(point.north - 1.0, point.east - 2.0) for point in found.points])
    assert np.einsum("ki,ij,kj->k", around, np.linalg.inv(p), around) == pytest.approx(5.991, rel=1e-6)
    lengths = np.linalg.norm(around, axis=1)
    assert (lengths.max(), lengths.min()) == pytest.approx((5.991**0.5 * max(a, b), 5.991**0.5 * min(a, b)), rel=1e-6)


@pytest.mark.parametrize("value", [nan, inf, -1.0, 1e300])
def test_what_is_no_covariance_is_no_ellipse(value: float) -> None:
    assert ellipse(1, PLACE, [value, 0, 0, 0, 1, 0, 0, 1, 0, 1]) is None
    assert ellipse(1, PLACE, []) is None


def test_the_tracks_show_them(alone: Alone) -> None:
    scenario = "dead-reckoning", "duration=2 s", "checks={}", "per_vehicle.2.navigation=ideal"
    (run,) = load([log_of(alone(*scenario))])
    drawn = [str(artist.get_gid()) for artist in top([run], View()).axes[0].get_children()]
    assert drawn.count("ellipse-1") == drawn.count("ellipse-4") == 5
    assert "belief-3" in drawn
    assert not [gid for gid in drawn if gid in ("ellipse-2", "belief-2")]
