"""The mirror image that a straight way leaves open: where it is, how likely, and which of both is believed."""

from __future__ import annotations

from math import cos, hypot, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.localization.mirror_image import MirrorImage, PlaceEstimate, distance
from agents.localization.range_fusion import Covariance, Fused, fuse_range

TRUE, NAVIGATOR = (3.0, 25.0), PlaceEstimate((0.0, -22.0), (625.0, 0.0, 625.0))
SURE: Covariance = (0.25, 0.0, 0.25)


def with_range(own: PlaceEstimate, sender: tuple[float, float]) -> Fused:
    """The exact range from a sender to the true place."""
    range_m = hypot(TRUE[0] - sender[0], TRUE[1] - sender[1])
    found = fuse_range(own.place, own.covariance, sender, (0.01, 0.0, 0.01), 0.0, range_m, 0.25, True)
    assert found is not None
    return found


def along(mirror: MirrorImage, own: PlaceEstimate, senders: list[tuple[float, float]]) -> PlaceEstimate:
    """What is believed after ranges to these places, as the localiser brings both together."""
    for sender in senders:
        found = with_range(own, sender)
        if mirror.other is not None:
            image = with_range(mirror.other, sender)
            if mirror.judge(found.nis, image.nis):
                own, image = mirror.swap(own), found
                found = with_range(own, sender)
            mirror.other = PlaceEstimate((image.north, image.east), image.covariance)
            mirror.settle()
        own = PlaceEstimate((found.north, found.east), found.covariance)
        mirror.on_range(sender, 0.02, own, NAVIGATOR)
    return own


STRAIGHT = [(-40.0 + 4.0 * k, 0.0) for k in range(21)]
TURNED = [(40.0, 3.0 * k) for k in range(1, 14)]


def test_a_straight_way_leaves_it_open_and_a_turn_tells() -> None:
    """A filter that begins on the wrong side settles there. Its covariance with the mirror image holds the true place,
    and with the turn the true one is believed."""
    mirror = MirrorImage()
    own = along(mirror, PlaceEstimate((2.5, -24.5), (4.0, 0.0, 4.0)), STRAIGHT)
    assert own.place == pytest.approx((3.0, -25.0), abs=0.5)
    assert distance(TRUE, own) > 1000.0
    assert mirror.other is not None and mirror.other.place == pytest.approx(TRUE, abs=0.5)
    prior = 0.5 * (distance(TRUE, NAVIGATOR) - distance((3.0, -25.0), NAVIGATOR))
    assert mirror.probability == pytest.approx(1.0 / (1.0 + np.exp(prior)), rel=0.2)  # ranges say nothing
    assert distance(TRUE, PlaceEstimate(own.place, mirror.spread(own))) < 10.0
    own = along(mirror, own, TURNED)
    assert own.place == pytest.approx(TRUE, abs=0.5)
    assert mirror.other is None and mirror.probability == 0.0


def test_one_that_the_navigator_contradicts_is_none() -> None:
    mirror = MirrorImage()
    for sender in STRAIGHT:
        mirror.on_range(
            sender, 0.02, PlaceEstimate((3.0, -25.0), SURE), PlaceEstimate((0.0, -22.0), (100.0, 0.0, 100.0))
        )
    assert mirror.other is None


def test_a_crooked_way_or_a_short_one_has_no_mirror_image() -> None:
    mirror = MirrorImage()
    for sender in STRAIGHT[:5]:
        mirror.on_range(sender, 0.02, PlaceEstimate((3.0, -25.0), SURE), NAVIGATOR)
    assert mirror.other is None


@given(st.floats(-3.1, 3.1), st.floats(-50.0, 50.0), st.floats(20.0, 50.0))
def test_it_is_as_far_from_every_point_of_the_line(bearing: float, ahead: float, aside: float) -> None:
    """To the last digits, whatever the direction of the line; its covariance is turned with it."""
    n, e = cos(bearing), sin(bearing)
    own = PlaceEstimate((ahead * n - aside * e, ahead * e + aside * n), (0.3, 0.1, 0.2))
    line = [(k * n, k * e) for k in range(-20, 21, 2)]
    mirror = MirrorImage()
    for sender in line:
        mirror.on_range(sender, 0.0, own, PlaceEstimate(own.place, (1e6, 0.0, 1e6)))
    assert mirror.other is not None
    for north, east in line:
        lengths = [hypot(place[0] - north, place[1] - east) for place in (own.place, mirror.other.place)]
        assert lengths[0] == pytest.approx(lengths[1], abs=1e-6)
    before, after = (np.array([[nn, ne], [ne, ee]]) for nn, ne, ee in (own.covariance, mirror.other.covariance))
    assert np.linalg.eigvalsh(after) == pytest.approx(np.linalg.eigvalsh(before), abs=1e-6)
