"""The mirror image of a position: ranges cannot exclude it while sender and receiver both move on straight ways.

Subtract the receiver's own way from the sender's positions. If both move straight, these points lie on a line. Every
range to a point of that line fits the true position and its mirror image across the line equally well. A filter with
one position may therefore settle on the wrong one, with a small covariance. This module keeps both positions, and
computes how likely each is. As soon as one of the vehicles turns, the ranges fit only one position.

| symbol | meaning | unit |
|---|---|---|
| s, q | place of a sender, minus the own way since the start; its variance | m, m^2 |
| l, u, v | mean of all s, direction of the line that fits them best, and their variance across it | m, 1, m^2 |
| p, P | own place and its covariance, likewise minus the own way | m, m^2 |
| m = l + A (p - l), A = 2 u u^T - 1 | its mirror image | m |
| M = A P A^T + 4 (v + q) | covariance of that: ranges have fitted p to the errors of s, and not m | m^2 |
| o = ln(Pr(p) / Pr(m)) | log odds of both | 1 |

At first o is what the navigator alone says: the difference of its normalised squares at m and at p, halved. Each
range adds half the difference of its normalised innovations squared. These are the likelihoods of a static
multiple-model estimator (Bar-Shalom, Li and Kirubarajan 2001, ch. 11.6). The determinants of both innovations are
nearly the same, so they are left out.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, sin
from typing import NamedTuple

from agents.localization.range_fusion import Covariance, grown

Place = tuple[float, float]  # north, east [m]
LEAST_SPREAD_M = 10.0  # least length of the line, as a standard deviation: the direction of a shorter one is not known
_CREDIBLE = 9.21  # chi-square with 2 degrees of freedom, 99 %: a mirror image that the navigator contradicts is none
_APART = 12.0  # standard deviations: before the estimate settles on one side, its own covariance holds both
_MOST_NIS = 40.0  # a larger NIS of one range counts as this one, since the range may be an outlier
_SWAPPED = 3.0  # log odds, 20 to 1: then the likelier one is believed
_SETTLED = 9.2  # log odds, 10 000 to 1


class PlaceEstimate(NamedTuple):
    """A place and how sure it is."""

    place: Place
    covariance: Covariance


class MirrorImage:
    """The mirror image of one estimate, as long as it is credible."""

    def __init__(self) -> None:
        self.other: PlaceEstimate | None = None
        self.odds = 0.0  # o, while there is another
        self._sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # the sums of 1, n, e, nn, ne and ee over all s
        self._settled = False  # whether it is known which of both is the place

    @property
    def probability(self) -> float:
        """That it is the mirror image; 0: there is none."""
        return 0.0 if self.other is None else 1.0 / (1.0 + exp(max(-700.0, min(700.0, self.odds))))

    def on_range(self, sender: Place, variance: float, own: PlaceEstimate, navigator: PlaceEstimate) -> None:
        """A range to a sender was used: the mirror image begins when the line is long enough, if it is credible.

        Args:
            sender: s, the sender's place minus the own way since the start [m].
            variance: variance of s, the sum of both axes [m^2].
            own: p and P, also minus the own way.
            navigator: the navigator's estimate without ranges, also minus the own way.
        """
        if self._settled or self.other is not None:
            return
        count, n, e, nn, ne, ee = self._sums
        sn, se = sender
        count, n, e = count + 1.0, n + sn, e + se
        nn, ne, ee = nn + sn * sn, ne + sn * se, ee + se * se
        self._sums = count, n, e, nn, ne, ee
        middle = n / count, e / count
        a, b, c = nn / count - middle[0] ** 2, ne / count - middle[0] * middle[1], ee / count - middle[1] ** 2
        radius = hypot(0.5 * (a - c), b)
        if 0.5 * (a + c) + radius < LEAST_SPREAD_M**2:
            return
        bearing, crooked = 0.5 * atan2(2.0 * b, a - c), max(0.0, 0.5 * (a + c) - radius)
        n, e = cos(bearing), sin(bearing)
        image = _image(own, middle, n, e, 4.0 * (crooked + variance))
        apart = hypot(image.place[0] - own.place[0], image.place[1] - own.place[1])
        nn, ne, ee = own.covariance
        across = e * e * nn - 2.0 * n * e * ne + n * n * ee
        against = distance(image.place, navigator)
        if apart * apart > _APART * _APART * across and against < _CREDIBLE:
            self.other = image
            self.odds = 0.5 * (against - distance(own.place, navigator))

    def judge(self, nis: float, other_nis: float) -> bool:
        """Weigh both positions by how well a range fits them. `nis`: normalised innovation squared of the range at the
        estimate. `other_nis`: the same at the mirror image. Returns whether the mirror image is now at least twenty
        times as likely as the estimate."""
        self.odds += 0.5 * (min(other_nis, _MOST_NIS) - min(nis, _MOST_NIS))
        return self.odds < -_SWAPPED

    def grow(self, before: Covariance, after: Covariance) -> None:
        """Increase the covariance of the mirror image as the navigator's has increased, from `before` to `after`."""
        if self.other is not None:
            self.other = PlaceEstimate(self.other.place, grown(self.other.covariance, before, after))

    def swap(self, own: PlaceEstimate) -> PlaceEstimate:
        """Take `own` as the mirror image from now on; returns what was it until now."""
        assert self.other is not None
        before, self.other, self.odds = self.other, own, -self.odds
        return before

    def settle(self) -> None:
        """End, if it is clear which of both it is."""
        if self.other is not None and abs(self.odds) > _SETTLED:
            self.other, self._settled = None, True

    def spread(self, own: PlaceEstimate) -> Covariance:
        """The mean square error of `own`, with that it may be the wrong one of both."""
        nn, ne, ee = own.covariance
        if self.other is None:
            return nn, ne, ee
        w = self.probability
        dn, de = self.other.place[0] - own.place[0], self.other.place[1] - own.place[1]
        a, b, c = self.other.covariance
        return nn + w * (dn * dn + a - nn), ne + w * (dn * de + b - ne), ee + w * (de * de + c - ee)


def distance(place: Place, estimate: PlaceEstimate) -> float:
    """How far a place is from an estimate: the normalised square, chi-square with 2 degrees of freedom."""
    nn, ne, ee = estimate.covariance
    determinant = nn * ee - ne * ne
    if not determinant > 0.0:
        return 0.0
    dn, de = place[0] - estimate.place[0], place[1] - estimate.place[1]
    return (ee * dn * dn - 2.0 * ne * dn * de + nn * de * de) / determinant


def _image(own: PlaceEstimate, on: Place, n: float, e: float, doubt: float) -> PlaceEstimate:
    """The mirror image across the line through `on` along (n, e), on each axis less sure by so much [m^2]."""
    dn, de = own.place[0] - on[0], own.place[1] - on[1]
    along = 2.0 * (dn * n + de * e)
    nn, ne, ee = own.covariance
    a, b, d = 2.0 * n * n - 1.0, 2.0 * n * e, 2.0 * e * e - 1.0
    covariance = (
        a * a * nn + 2.0 * a * b * ne + b * b * ee + doubt,
        a * b * nn + (a * d + b * b) * ne + b * d * ee,
        b * b * nn + 2.0 * b * d * ne + d * d * ee + doubt,
    )
    return PlaceEstimate((on[0] + along * n - dn, on[1] + along * e - de), covariance)
