"""Where a vehicle is, by its own navigator and by ranges to others that say where they are.

It holds a horizontal position with its covariance; the depth is that of the pressure sensor. Between two samples the
position moves by the velocity that the navigator believes, and the covariance grows by as much as the navigator's did.
That is on the safe side: of an error that lasts, such as that of the heading, the growth includes what is common to
the way before. When the navigator becomes surer than this estimate, for instance by a fix, its estimate is taken over
as a whole, which is consistent whatever was fused before. So a vehicle that hears nobody has its navigator's position.

| method | what is used | as |
|---|---|---|
| `aid` | messages of vehicles that had a fix of late and used no ranges (Bahr, Leonard and Fallon 2009) | independent |
| `naive` | all messages | independent, which they are not: who has used my position tells me mine as news |
| `consistent` | all messages | of unknown correlation: covariance intersection |

A range is of a past tick, and the sender's position of another one. The own position then is the present one minus the
way since, from the localiser's history. The sender's position is carried on by its velocity.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import atan2, cos, exp, hypot, sin, sqrt
from typing import NamedTuple

from agents.config import AgentConfig, LocalizationParams
from agents.errors import PayloadError
from agents.laws.kinematics import earth_velocity
from agents.localization.payload import LocatedMessage, decode, is_located
from agents.payload import StateMessage
from netem.wire.messages import Delivery, Nav
from world.signal import Signal
from world.vectors import Vec3

# --- fusion
# The own position, corrected by a measured range to another vehicle.
#
# | symbol | meaning | unit |
# |---|---|---|
# | p, P | own horizontal position and its covariance | m, m^2 |
# | q, Q | the same of the other vehicle, as its message says | m, m^2 |
# | h = sqrt(\|p - q\|^2 + dz^2) | expected range; depths are known | m |
# | H = (p - q)^T / h | its gradient with respect to p; with respect to q it is -H | 1 |
# | C = (tr(P + Q) - H (P + Q) H^T) / h | the curvature of the range, over the spread of both positions | m |
# | R = r + C^2 / 2 | variance of the range beside P and Q: that of the measurement, and of the curvature | m^2 |
# | z - h - C / 2 | innovation of a measured range z | m |
#
# The terms with C are those of the second-order extended Kalman filter (Bar-Shalom, Li and Kirubarajan 2001, ch. 10.3).
#
# *As independent* (naive): a Kalman update with S = H P H^T + H Q H^T + R.
#
# *By covariance intersection*, with any correlation between p and q (Julier and Uhlmann 1997). The noise of the range
# is independent of both, so this is split covariance intersection (Li and Nashashibi 2013):
#
#     P1 = P / w,  S = H P1 H^T + H Q H^T / (1 - w) + R,  K = P1 H^T / S,  P+ = P1 - K S K^T
#
# with the w that makes the trace of P+ least. A result that is not better than P is not used.

Covariance = tuple[float, float, float]  # of north and east: nn, ne, ee [m^2]
_LEAST_RANGE = 0.1  # m; nearer, a range has no direction
_WEIGHTS = tuple(1.0 - 2.0 ** (-0.5 * k) for k in range(1, 25))  # of the own position: 0.29 to 0.9998


class Fused(NamedTuple):
    """A position after a range."""

    north: float
    east: float
    covariance: Covariance
    nis: float  # normalised square of the innovation; chi-square with 1 degree of freedom


def fused(
    place: tuple[float, float],
    covariance: Covariance,
    other: tuple[float, float],
    other_covariance: Covariance,
    depth_m: float,
    range_m: float,
    variance: float,
    independent: bool,
) -> Fused | None:
    """Correct the own position by a measured range to another vehicle.

    Args:
        place: the own position, north and east [m].
        covariance: of the own position [m^2].
        other: the position of the other vehicle, north and east [m].
        other_covariance: of that position [m^2].
        depth_m: the difference of the depths [m].
        range_m: the measured range [m].
        variance: variance r of the measurement [m^2].
        independent: the errors of both positions are independent.

    Returns:
        The corrected position. None: the range does not help, since the vehicles are too close or no weight of the own
        position gives a smaller covariance.
    """
    dn, de = place[0] - other[0], place[1] - other[1]
    h = sqrt(dn * dn + de * de + depth_m * depth_m)
    if h < _LEAST_RANGE:
        return None
    n, e = dn / h, de / h
    across = _along(other_covariance, n, e)
    spread = covariance[0] + covariance[2] + other_covariance[0] + other_covariance[2]
    curved = (spread - _along(covariance, n, e) - across) / h
    noise = variance + 0.5 * curved * curved
    innovation = range_m - h - 0.5 * curved
    if independent or across == 0.0:
        s, gain, better = _update(covariance, n, e, across + noise)
    else:
        s, gain, better = 0.0, (0.0, 0.0), covariance
        for w in _WEIGHTS:
            nn, ne, ee = covariance
            found = _update((nn / w, ne / w, ee / w), n, e, across / (1.0 - w) + noise)
            if found[2][0] + found[2][2] < better[0] + better[2]:
                s, gain, better = found
        if s == 0.0:
            return None
    kn, ke = gain
    return Fused(place[0] + kn * innovation, place[1] + ke * innovation, better, innovation * innovation / s)


def grown(covariance: Covariance, before: Covariance, after: Covariance) -> Covariance:
    """A covariance that grows by as much as another one did, in the same directions."""
    a, b, c = after[0] - before[0], after[1] - before[1], after[2] - before[2]
    middle, radius = 0.5 * (a + c), sqrt(0.25 * (a - c) * (a - c) + b * b)
    if middle + radius <= 0.0:
        return covariance
    if middle < radius:  # it shrank in one direction: only the other counts
        share = 0.5 * (middle + radius) / radius
        a, b, c = share * (a - middle + radius), share * b, share * (c - middle + radius)
    return covariance[0] + a, covariance[1] + b, covariance[2] + c


def _along(covariance: Covariance, n: float, e: float) -> float:
    """Variance along a direction: H P H^T."""
    nn, ne, ee = covariance
    return n * n * nn + 2.0 * n * e * ne + e * e * ee


def _update(covariance: Covariance, n: float, e: float, noise: float) -> tuple[float, tuple[float, float], Covariance]:
    """S, K, and the covariance after a scalar measurement along (n, e)."""
    nn, ne, ee = covariance
    hn, he = n * nn + e * ne, n * ne + e * ee
    s = n * hn + e * he + noise
    return s, (hn / s, he / s), (nn - hn * hn / s, ne - hn * he / s, ee - he * he / s)


# --- mirror
# The mirror image of a position: ranges cannot exclude it while sender and receiver both move on straight ways.
#
# Subtract the receiver's own way from the sender's positions. If both move straight, these points lie on a line. Every
# range to a point of that line fits the true position and its mirror image across the line equally well. A filter with
# one position may therefore settle on the wrong one, with a small covariance. This module keeps both positions, and
# computes how likely each is. As soon as one of the vehicles turns, the ranges fit only one position.
#
# | symbol | meaning | unit |
# |---|---|---|
# | s, q | place of a sender, minus the own way since the start; its variance | m, m^2 |
# | l, u, v | mean of all s, direction of the line that fits them best, and their variance across it | m, 1, m^2 |
# | p, P | own place and its covariance, likewise minus the own way | m, m^2 |
# | m = l + A (p - l), A = 2 u u^T - 1 | its mirror image | m |
# | M = A P A^T + 4 (v + q) | covariance of that: ranges have fitted p to the errors of s, and not m | m^2 |
# | o = ln(Pr(p) / Pr(m)) | log odds of both | 1 |
#
# At first o is what the navigator alone says: the difference of its normalised squares at m and at p, halved. Each
# range adds half the difference of its normalised innovations squared. These are the likelihoods of a static
# multiple-model estimator (Bar-Shalom, Li and Kirubarajan 2001, ch. 11.6). The determinants of both innovations are
# nearly the same, so they are left out.

Place = tuple[float, float]  # north, east [m]
LEAST_SPREAD_M = 10.0  # of the line, as a standard deviation: with less its direction is not known
_CREDIBLE = 9.21  # chi-square with 2 degrees of freedom, 99 %: a mirror image that the navigator contradicts is none
_APART = 12.0  # standard deviations: before the estimate settles on one side, its own covariance holds both
_MOST_NIS = 40.0  # that counts of one range: it may be an outlier
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
        self._sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # of 1, n, e, nn, ne and ee of all s
        self._settled = False  # which of both it is

    @property
    def probability(self) -> float:
        """That it is the mirror image; 0: there is none."""
        return 0.0 if self.other is None else 1.0 / (1.0 + exp(max(-700.0, min(700.0, self.odds))))

    def seen(self, sender: Place, variance: float, own: PlaceEstimate, navigator: PlaceEstimate) -> None:
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


_HISTORY_S = 60.0  # a range that is older is of no use
_FRESH_S = 60.0  # a vehicle whose last fix is older is no aid
_FIX_GAIN = 0.005  # by this share a fix lessens the navigator's variance; its other sensors take longer
# But many small fixes keep it as it is, and the share of each goes to 0. Without any it grows: at t seconds by 2 s / t.
_SPAN_S, _STEADY = 30.0, 1.01
_DRIFT_MPS = 0.05  # by which a sender's velocity is off, until the range is measured: an assumption
_NOTHING: Covariance = (0.0, 0.0, 0.0)


class Navigated:
    """A vehicle is where its navigator says; what it hears of others moves it nowhere."""

    def located(self, nav: Nav) -> Nav:
        return nav

    def absorb(self, nav: Nav, deliveries: Sequence[Delivery]) -> Nav:
        return nav

    def telemetry(self) -> tuple[float, ...]:
        return ()


class Localizer(Navigated):
    """The estimate of one vehicle. Call `located` at every sample, and `absorb` with what has come."""

    signals = (
        Signal("located", "m", "its position by its navigator and by ranges, NED", 3),
        Signal("located_covariance", "m^2", "of its north and east: nn, ne, ee", 3),
        Signal("ranges_used", "1", "ranges that have changed it since the start"),
        Signal("ranges_refused", "1", "ranges that were refused since the start, because they fit too badly"),
        Signal("mirror", "1", "probability that it is the mirror image of this place; 0: there is none"),
    )
    _nis = Signal("nis", "1", "mean NIS of the ranges used since the start: about 1 if consistent; 0: none was used")

    @classmethod
    def signals_of(cls, params: LocalizationParams) -> tuple[Signal, ...]:
        """What a localiser with these parameters reports."""
        return (*cls.signals, cls._nis) if params.nis else cls.signals

    def __init__(self, config: AgentConfig) -> None:
        """Begin; without `config.localization` it has the position of the navigator, and uses no ranges."""
        self._id = config.id
        self._tick_s = config.tick_ns / 1e9
        self._round_ticks = config.round_ticks
        self._params = config.localization
        self._tick: int | None = None  # of the last sample
        self._place = (0.0, 0.0)
        self._covariance: Covariance = _NOTHING
        self._depth = 0.0
        self._own: Covariance = _NOTHING  # of the navigator
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self._way = (0.0, 0.0)  # since the start
        self._history: deque[tuple[int, float, float]] = deque()  # tick, and the way until then
        self._fixed: int | None = None  # tick of the last fix
        self._span: tuple[int, float] | None = None  # its first tick, and the least variance of the navigator in it
        self._alone = True  # no range is in the estimate
        self.mirror: MirrorImage | None = None  # without the key it is not looked for
        if config.localization is not None and config.localization.mirror:
            self.mirror = MirrorImage()
        self._navigator: tuple[float, float] = (0.0, 0.0)  # what the navigator believes alone
        self.used = 0
        self.refused = 0
        self._nis_sum = 0.0  # of the ranges used

    def located(self, nav: Nav) -> Nav:
        """The same nav with the position and covariance from all information so far; idempotent within a tick."""
        if nav.tick != self._tick:
            self._advance(nav)
        nn, ne, ee = self.covariance
        _, _, z, theta, psi = nav.eta
        own = nav.belief
        belief = (nn, ne, 0.0, 0.0, ee, 0.0, 0.0, own[7], own[8], own[9]) if own else ()
        eta = (*self._place, z, theta, psi)
        return Nav(nav.incarnation, nav.tick, eta, nav.nu, nav.roll, nav.clock_ns, belief)

    @property
    def covariance(self) -> Covariance:
        """Of north and east [m^2], with that the place may be the mirror image of the true one."""
        if self.mirror is None:
            return self._covariance
        return self.mirror.spread(self._without_way(self._place, self._covariance))

    def _without_way(self, place: tuple[float, float], covariance: Covariance) -> PlaceEstimate:
        return PlaceEstimate((place[0] - self._way[0], place[1] - self._way[1]), covariance)

    def _advance(self, nav: Nav) -> None:
        x, y, z, theta, psi = nav.eta
        u, v, w, q, r = nav.nu
        velocity = earth_velocity((x, y, z, theta, psi), (u, v, w, q, r), nav.roll[0] if nav.roll else 0.0)
        own: Covariance = (nav.belief[0], nav.belief[1], nav.belief[4]) if nav.belief else _NOTHING
        if self._tick is not None:
            span = 0.5 * (nav.tick - self._tick) * self._tick_s
            dn, de = span * (velocity[0] + self._velocity[0]), span * (velocity[1] + self._velocity[1])
            self._way = self._way[0] + dn, self._way[1] + de
            self._place = self._place[0] + dn, self._place[1] + de
            self._covariance = grown(self._covariance, self._own, own)
            if self.mirror is not None:
                self.mirror.grow(self._own, own)
        if not nav.belief or self._has_fix(nav.tick, own[0] + own[2]):
            self._fixed = nav.tick
        if self._alone or own[0] + own[2] <= self._covariance[0] + self._covariance[2]:
            self._place, self._covariance, self._alone = (x, y), own, True
            if self.mirror is not None:
                self.mirror = MirrorImage()
        self._navigator = x, y
        self._tick, self._own, self._velocity, self._depth = nav.tick, own, velocity, z
        if nav.tick % self._round_ticks == 0 or not self._history:
            self._history.append((nav.tick, *self._way))
            while (nav.tick - self._history[0][0]) * self._tick_s > _HISTORY_S:
                self._history.popleft()

    def _has_fix(self, tick: int, variance: float) -> bool:
        """Whether the navigator has had a fix, by its variance now [m^2]: it fell, or no longer grows."""
        if self._span is None or self._tick is None:
            self._span = tick, variance
            return False
        begin, least = self._span
        fell = variance < (1.0 - _FIX_GAIN) * (self._own[0] + self._own[2])
        if (tick - begin) * self._tick_s < _SPAN_S:
            self._span = begin, min(least, variance)
            return fell
        self._span = tick, variance
        return fell or variance <= _STEADY * least

    def message(self, state: StateMessage) -> LocatedMessage:
        """What to tell the others, with the position in `state`."""
        fresh = self._fixed is not None and self._tick is not None
        if fresh:
            fresh = self._alone and (self._tick - self._fixed) * self._tick_s <= _FRESH_S  # type: ignore[operator]
        return LocatedMessage(state, self.covariance, fresh)

    def absorb(self, nav: Nav, deliveries: Sequence[Delivery]) -> Nav:
        """Use the ranges that have come, and return the nav with the position from all information so far."""
        self.located(nav)
        now = nav.tick if nav.clock_ns is None else round(nav.clock_ns / (self._tick_s * 1e9))
        for delivery in deliveries if self._params is not None else ():
            if delivery.range_m is None or not is_located(delivery.payload):
                continue
            try:
                message = decode(delivery.payload)
            except PayloadError:
                continue  # counted where states are taken
            if message.state.sender == delivery.src and message.state.sent_tick <= now + 60.0 / self._tick_s:
                self._use(delivery, message, now - nav.tick)
        return self.located(nav)

    def _use(self, delivery: Delivery, message: LocatedMessage, ahead: int) -> None:
        assert delivery.range_m is not None and self._params is not None
        method = self._params.method
        ranged = delivery.range_tick
        if (method == "aid" and not message.fixed) or ranged is None:
            return
        then = next((kept for kept in reversed(self._history) if kept[0] <= ranged), None)
        if then is None:
            return
        state = message.state
        since = (ranged + ahead - state.sent_tick) * self._tick_s  # by clocks that may differ by milliseconds
        other = state.position[0] + since * state.velocity[0], state.position[1] + since * state.velocity[1]
        back = self._way[0] - then[1], self._way[1] - then[2]
        variance = (delivery.range_sd_m or 0.0) ** 2 + (_DRIFT_MPS * since) ** 2
        deeper = self._depth - state.position[2] - since * state.velocity[2]
        ranged_m = delivery.range_m

        def fuse(own: PlaceEstimate) -> Fused | None:
            """With the range from where the vehicle then was, if it is here now."""
            place = own.place[0] - back[0], own.place[1] - back[1]
            independent = method != "consistent"
            return fused(place, own.covariance, other, message.covariance, deeper, ranged_m, variance, independent)

        if self.mirror is not None:
            self._compare(fuse, back)
        found = fuse(PlaceEstimate(self._place, self._covariance))
        if found is None:
            return
        if found.nis > self._params.gate:
            self.refused += 1
            return
        self.used += 1
        self._nis_sum += found.nis
        self._alone = False
        self._place, self._covariance = (found.north + back[0], found.east + back[1]), found.covariance
        if self.mirror is not None:
            sender = other[0] - then[1], other[1] - then[2]
            own = self._without_way(self._place, self._covariance)
            self.mirror.seen(
                sender,
                message.covariance[0] + message.covariance[2],
                own,
                self._without_way(self._navigator, self._own),
            )

    def _compare(self, fuse: Callable[[PlaceEstimate], Fused | None], back: tuple[float, float]) -> None:
        """Let a range judge between the place and its mirror image, and correct the latter."""
        mirror = self.mirror
        assert self._params is not None
        if mirror is None or mirror.other is None:
            return
        (n, e), covariance = mirror.other
        found = fuse(PlaceEstimate(self._place, self._covariance))
        image = fuse(PlaceEstimate((n + self._way[0], e + self._way[1]), covariance))
        if found is None or image is None:
            return
        if mirror.judge(found.nis, image.nis):
            before = mirror.swap(self._without_way(self._place, self._covariance))
            self._place = before.place[0] + self._way[0], before.place[1] + self._way[1]
            self._covariance = before.covariance
            image = found
        if image.nis <= self._params.gate:
            mirror.other = self._without_way((image.north + back[0], image.east + back[1]), image.covariance)
        mirror.settle()

    def telemetry(self) -> tuple[float, ...]:
        """The values of `signals`; none where no ranges are used."""
        if self._params is None:
            return ()
        mirror = 0.0 if self.mirror is None else self.mirror.probability
        nis = (self._nis_sum / max(1, self.used),) if self._params.nis else ()
        return (*self._place, self._depth, *self.covariance, float(self.used), float(self.refused), mirror, *nis)
