"""The transmissions in the water ("in the air", as engineers say): who hears whom, and which receptions succeed."""

from __future__ import annotations

from math import sqrt

from netem.cause import Cause
from netem.draws import uniform
from netem.endpoint import UNKNOWN, Level
from netem.medium import Place
from netem.modem import AcousticConfig
from netem.modem_frame import size_on_air
from netem.propagation import decibels, fading_gain_db, power
from netem.station import ANSWER, REPLY, REQUEST, Burst, Reception

SNR, CAPTURE = "snr", "capture"  # purposes of draws
# Short packets have draws of their own, in the place of SNR.
_SHORT = {ANSWER: "acknowledgement", REQUEST: "range request", REPLY: "range reply"}


class Air:
    """The transmissions of a run that can still be heard, and the places between which they travel."""

    def __init__(self, acoustic: AcousticConfig, seed: int, tick_ns: int) -> None:
        self.places: dict[int, Place] = {}  # the last that is known of each vehicle
        self.bursts: list[Burst] = []  # sorted by (start, src)
        self._acoustic = acoustic
        self._seed = seed
        self._tick_ns = tick_ns

    def range_m(self, src: int, dst: int) -> float | None:
        """The distance between two vehicles; None: one of them has never had an agent."""
        a, b = self.places.get(src), self.places.get(dst)
        return None if a is None or b is None else _distance(a, b)

    def transmit(self, src: int, start: int, airtime_ns: int) -> Burst:
        reach = self._acoustic.modem_of(src).interference_range
        away = ((i, _distance(self.places[src], place)) for i, place in sorted(self.places.items()) if i != src)
        heard = tuple((i, r, self._acoustic.delay_ns(r)) for i, r in away if r <= reach)
        burst = Burst(start, src, airtime_ns, heard)
        self.bursts.append(burst)
        return burst

    def idle_tick(self, src: int, now: int) -> int:
        """The end of all transmissions that a vehicle hears at tick `now`, as a tick; `now` if it hears none."""
        tick_ns, ends = self._tick_ns, now * self._tick_ns
        for burst in self.bursts:
            for i, _, delay in burst.heard:
                begin = burst.start_tick * tick_ns + delay
                if i == src and begin <= now * tick_ns < begin + burst.airtime_ns:
                    ends = max(ends, begin + burst.airtime_ns)
        return -(-ends // tick_ns)

    def cause(self, r: Reception) -> Cause | None:
        """The cause of the loss of a reception; None: it succeeds."""
        acoustic, sender, receiver = self._acoustic, self._acoustic.modem_of(r.src), self._acoustic.modem_of(r.dst)
        if r.range_m > sender.max_range:
            return Cause.RANGE
        others = 0.0
        for burst in self.bursts:
            begin = burst.start_tick * self._tick_ns
            if burst.src == r.dst:
                if begin < r.end_ns and r.begin_ns < begin + burst.airtime_ns:
                    return Cause.HALF_DUPLEX
            elif burst.src != r.src:
                for i, range_m, delay in burst.heard:
                    if i == r.dst and begin + delay < r.end_ns and r.begin_ns < begin + delay + burst.airtime_ns:
                        level = acoustic.received_level(range_m, acoustic.modem_of(burst.src))
                        others += power(level + self._gain(burst.src, r.dst, burst.start_tick))
        gain, start = self._gain(r.src, r.dst, r.start_tick), (r.start_tick,) if sender.tries else ()
        if others:
            share = receiver.survives(acoustic.received_level(r.range_m, sender) + gain - decibels(others))
            if share < 1.0 and uniform(self._seed, CAPTURE, r.src, r.dst, r.start_tick) >= share:
                return Cause.COLLISION
        lost = acoustic.packet_error_rate(r.range_m, size_on_air(r.payload), sender, receiver, gain)
        if lost and uniform(self._seed, _SHORT.get(r.copy, SNR), r.src, r.dst, r.seq, *start) < lost:
            return Cause.SNR
        return None

    def level(self, burst: Burst, dst: int) -> Level:
        """How strong a transmission is at a vehicle that hears it; UNKNOWN if it does not."""
        acoustic, sender, receiver = self._acoustic, self._acoustic.modem_of(burst.src), self._acoustic.modem_of(dst)
        for i, range_m, _ in burst.heard:
            if i == dst:
                gain = self._gain(burst.src, dst, burst.start_tick)
                received = acoustic.received_level(range_m, sender) + gain
                return Level(received, acoustic.snr(range_m, sender, receiver) + gain)
        return UNKNOWN

    def _gain(self, src: int, dst: int, start_tick: int) -> float:
        acoustic = self._acoustic
        if not acoustic.shadowing and acoustic.rician is None:
            return 0.0
        at = start_tick * self._tick_ns
        seed = self._seed
        return fading_gain_db(seed, src, dst, at, acoustic.shadowing, acoustic.shadowing_ns, acoustic.rician)

    def forget(self, before_ns: int) -> None:
        """Delete the transmissions that everybody has heard before a time [ns]."""
        self.bursts = sorted(burst for burst in self.bursts if self._last_ns(burst) > before_ns)

    def _last_ns(self, burst: Burst) -> int:
        farthest = max((delay for _, _, delay in burst.heard), default=0)
        return burst.start_tick * self._tick_ns + burst.airtime_ns + farthest


def _distance(a: Place, b: Place) -> float:
    return sqrt(sum((x - y) * (x - y) for x, y in zip(a, b, strict=True)))
