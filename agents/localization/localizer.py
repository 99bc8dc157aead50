"""Where a vehicle is, by its own navigator and by ranges to others that say where they are.

It holds a horizontal position with its covariance; the depth is that of the pressure sensor. Between two samples the
position moves by the velocity that the navigator believes, and the covariance grows by as much as the navigator's did.
That is on the safe side: of an error that lasts, such as that of the heading, the growth includes what is common to the
way before. When the navigator becomes surer than this estimate, for instance by a fix, its estimate is taken over as a
whole, which is consistent whatever was fused before. So a vehicle that hears no other has its navigator's position.

| method | what is used | as |
|---|---|---|
| `aid` | messages of vehicles that had a fix of late and used no ranges (Bahr, Leonard and Fallon 2009) | independent |
| `naive` | all messages | independent, which they are not: a vehicle that has used my position tells me mine again |
| `consistent` | all messages | of unknown correlation: covariance intersection |

A range is of a past tick, and the sender's position of another one. The own position then is the present one minus the
way since, from the localiser's history. The sender's position is carried on by its velocity.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from agents.config import AgentConfig, LocalizationParams
from agents.errors import PayloadError
from agents.laws.kinematics import earth_velocity
from agents.localization.mirror_image import MirrorImage, PlaceEstimate
from agents.localization.payload import LocatedMessage, decode, is_located
from agents.localization.range_fusion import Covariance, Fused, fuse_range, grown
from agents.payload import StateMessage
from netem.wire.messages import Delivery, Nav
from world.signal import Signal
from world.vectors import Vec3

_HISTORY_S = 60.0  # a range that is older is of no use
_FRESH_S = 60.0  # a vehicle whose last fix is older is no aid
_FIX_GAIN = 0.005  # by this share a fix lessens the navigator's variance; its other sensors take longer
# Many small fixes keep the navigator's variance as it is, and the share of each goes to 0. Without any fix the variance
# grows: at t seconds by 2 s / t.
_SPAN_S, _STEADY = 30.0, 1.01
_DRIFT_MPS = 0.05  # by which a sender's velocity is off, until the range is measured: an assumption
_NOTHING: Covariance = (0.0, 0.0, 0.0)


class Navigated:
    """A vehicle is where its navigator says; what it hears of others moves it nowhere."""

    def locate(self, nav: Nav) -> Nav:
        return nav

    def absorb(self, nav: Nav, deliveries: Sequence[Delivery]) -> Nav:
        return nav

    def telemetry(self) -> tuple[float, ...]:
        return ()


class Localizer(Navigated):
    """The estimate of one vehicle. Call `locate` at every sample, and `absorb` with what has come."""

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
        self._tick: int | None = None  # tick of the last sample
        self._place = (0.0, 0.0)
        self._covariance: Covariance = _NOTHING
        self._depth = 0.0
        self._own: Covariance = _NOTHING  # the navigator's covariance
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self._way = (0.0, 0.0)  # since the start
        self._history: deque[tuple[int, float, float]] = deque()  # tick, and the way until then
        self._fixed: int | None = None  # tick of the last fix
        self._span: tuple[int, float] | None = None  # its first tick, and the least variance of the navigator in it
        self._alone = True  # no range is in the estimate
        self.mirror: MirrorImage | None = None  # None: the scenario does not ask for it
        if config.localization is not None and config.localization.mirror:
            self.mirror = MirrorImage()
        self._navigator: tuple[float, float] = (0.0, 0.0)  # what the navigator believes alone
        self.used = 0
        self.refused = 0
        self._nis_sum = 0.0  # sum of the NIS of the ranges used

    def locate(self, nav: Nav) -> Nav:
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
        """The covariance of north and east [m^2], with that the place may be the mirror image of the true one."""
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
        self.locate(nav)
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
        return self.locate(nav)

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
        since = (ranged + ahead - state.sent_tick) * self._tick_s  # the clocks may differ by milliseconds
        other = state.position[0] + since * state.velocity[0], state.position[1] + since * state.velocity[1]
        back = self._way[0] - then[1], self._way[1] - then[2]
        variance = (delivery.range_sd_m or 0.0) ** 2 + (_DRIFT_MPS * since) ** 2
        deeper = self._depth - state.position[2] - since * state.velocity[2]
        ranged_m = delivery.range_m

        def fuse(own: PlaceEstimate) -> Fused | None:
            """Use the range from where the vehicle then was, if it is here now."""
            place = own.place[0] - back[0], own.place[1] - back[1]
            independent = method != "consistent"
            return fuse_range(place, own.covariance, other, message.covariance, deeper, ranged_m, variance, independent)

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
            self.mirror.on_range(
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
