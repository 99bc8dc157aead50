"""The effect of one directed link on one packet, in the order of Linux' sch_netem.

duplicate, lose, corrupt, drop at the queue's limit, and then either reorder (send at once) or delay and rate-limit.
`docs/background/kernel.md` lists where we differ from the kernel.

A rule returns an outcome and moves no time: the caller (`netem.medium`) owns ticks and queues. Every draw is keyed by
(seed, purpose, link, sequence number, copy), so that changing one link, or one value of a link, never shifts another
draw. A link remembers correlations, loss states and its queue between packets, as plain values.

| symbol | meaning | source |
|---|---|---|
| x_n = (1 - rho) u_n + rho x_(n-1) | correlated random number, u_n uniform in [0, 1) | get_crandom |
| delay = mu + sigma t(q) | t: quantile, uniform, normal, Pareto, or 1/4 normal + 3/4 Pareto | tabledist |
| q = x, with a correlation q = 2^20 x mod 1 | place in the table | tabledist: 32 bits modulo 4096 |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from statistics import NormalDist
from struct import Struct
from typing import NamedTuple

from netem.cause import Cause
from netem.condition import Condition, FourState, GilbertElliott, Link
from netem.draws import bits, pack_numbers, unit

GOOD, BAD = 0, 1  # the states of Gilbert and Elliott

# iproute2's tables for Pareto: shape 3, shifted to mean 0, scaled by 4/3 and cut at 32767 / 8192.
_PARETO_SHAPE, _PARETO_MEAN, _PARETO_SCALE, _PARETO_MOST = 3.0, 1.5, 4.0 / 3.0, 32767.0 / 8192.0
_PLACES = 2**20  # a number of 32 bits modulo a table of 4096 entries: where it lies within 1 / 2^20
_NORMAL = NormalDist()
_TINY = 2.0**-53
_ONE, _TWO = Struct("<q").pack, Struct("<2q").pack  # as `pack_numbers`


class LossState(IntEnum):
    """A state of the four-state model, by its number in tc-netem(8)."""

    GAP = 1
    BURST = 2
    LOST_IN_BURST = 3
    LOST_ALONE = 4


class LinkOutcome(NamedTuple):
    """The result for a packet that enters a link: its delay and its payload, or the cause of its loss."""

    delay_ns: int
    cause: Cause | None  # None: it is not lost
    payload: bytes
    corrupted: bool


@dataclass(slots=True)
class LinkMemory:
    last: dict[str, float] = field(default_factory=dict)  # the last correlated number of each purpose
    loss_model: str = ""  # whose `loss_state` is
    loss_state: int = 0  # GOOD, or 0 for the four-state model's first GAP
    since_reordered: int = 0  # packets since the last one that was sent at once
    leaving_ns: list[int] = field(default_factory=list)  # when each packet in the queue leaves, ascending


class LinkModel:
    """One directed link: its condition, which may change at any time, and what it remembers."""

    __slots__ = ("_key", "_link", "_seed", "_seed_in_use", "_state", "_used", "condition")

    def __init__(self, condition: Condition, seed: int, link: Link) -> None:
        self.condition = condition  # the link's own
        self._seed = seed
        self._link = link
        self._state = LinkMemory()
        self._seed_in_use = seed
        self._key = pack_numbers(seed, *link)  # the beginning of the key of all draws
        self._use(condition)

    def take_over(self, before: LinkModel) -> None:
        """Go on with what another model of the same link remembers."""
        self._state = before._state

    def enter(self, now_ns: int, seq: int, payload: bytes, over: Condition | None = None) -> list[LinkOutcome]:
        """Decide on a packet. If it is both duplicated and lost, one goes on, as in the kernel.

        Args:
            now_ns: when it enters the link [ns].
            seq: its number on the link, from 0.
            payload: its bytes.
            over: the condition of a fault, in place of the link's own.

        Returns:
            The outcome of the packet, and of its duplicate if the link makes one.
        """
        c = self.condition if over is None else over
        self._use(c)
        if not c.up:
            return [LinkOutcome(0, Cause.DOWN, payload, False)]
        copies = 2 if c.duplicate and self._random("duplicate", c.duplicate_correlation, seq, 0) < c.duplicate else 1
        lost = self._lost(seq, 0)
        if copies == 1:
            return [LinkOutcome(0, Cause.LOSS, payload, False) if lost else self._queue(now_ns, seq, 0, payload)]
        # The clone enters first and is not duplicated again, but may be lost on its own.
        if lost:
            return [self._queue(now_ns, seq, 0, payload)]
        clone_lost = self._lost(seq, 1)
        clone = LinkOutcome(0, Cause.LOSS, payload, False) if clone_lost else self._queue(now_ns, seq, 1, payload)
        return [self._queue(now_ns, seq, 0, payload), clone]

    def _queue(self, now_ns: int, seq: int, copy: int, payload: bytes) -> LinkOutcome:
        c, leaving = self._used, self._state.leaving_ns
        corrupted = False
        if c.corrupt and payload and self._random("corrupt", c.corrupt_correlation, seq, copy) < c.corrupt:
            corrupted = True
            payload = self.flip_bit(payload, seq, copy)
        while leaving and leaving[0] <= now_ns:
            leaving.pop(0)
        if len(leaving) >= c.limit:
            return LinkOutcome(0, Cause.QUEUE, payload, corrupted)
        if self._reordered(seq, copy):
            self._state.since_reordered = 0
            return LinkOutcome(0, None, payload, corrupted)
        self._state.since_reordered += 1
        delay = self._delay(seq, copy)
        start = now_ns
        if c.rate_bit_s:
            if leaving:
                # The last packet in the queue is where the line gets free; waiting for it counts as delay.
                delay = max(0, delay - (leaving[-1] - now_ns))
                start = leaving[-1]
            delay += -(-(len(payload) + c.rate_overhead) * 8 * 10**9 // c.rate_bit_s)
        leaves = start + delay
        at = len(leaving)
        while at and leaving[at - 1] > leaves:
            at -= 1
        leaving.insert(at, leaves)
        return LinkOutcome(leaves - now_ns, None, payload, corrupted)

    def _reordered(self, seq: int, copy: int) -> bool:
        c = self._used
        if not c.reorder or self._state.since_reordered < c.gap - 1:
            return False
        return self._random("reorder", c.reorder_correlation, seq, copy) < c.reorder

    def _delay(self, seq: int, copy: int) -> int:
        # As in the kernel, the correlation of a delay has no effect: it looks up a delay by the low bits of the
        # smoothed number. To smooth first would narrow the delays (25 % of a normal jitter of 100 ms gives 64.8 ms). A
        # copula would keep correlation and width, but results would not carry over to a test bed with tc. Unlike in the
        # kernel, whose table ends at -4.00 and 3.52, the normal distribution is not cut: one delay in 4,000 lies
        # beyond.
        c = self._used
        if not c.jitter_ns:
            return c.delay_ns
        x = self._random("delay", c.delay_correlation, seq, copy)
        if c.delay_correlation:
            # The low bits decide, as in the kernel: they are uniform, so the delays keep their distribution.
            x = x * _PLACES % 1.0
        return max(0, c.delay_ns + round(_SHAPES[c.distribution](x) * c.jitter_ns))

    def _lost(self, seq: int, copy: int) -> bool:
        c, state = self._used, self._state
        if c.loss_model is not None and state.loss_model != type(c.loss_model).__name__:
            # A state of one model means nothing in the other.
            state.loss_model, state.loss_state = type(c.loss_model).__name__, 0
        match c.loss_model:
            case None:
                return c.loss > 0.0 and self._random("loss", c.loss_correlation, seq, copy) < c.loss
            case GilbertElliott():
                return self._gilbert_elliott(c.loss_model, seq, copy)
            case FourState():
                return self._four_state(c.loss_model, seq, copy)

    def _gilbert_elliott(self, model: GilbertElliott, seq: int, copy: int) -> bool:
        """The state moves first; what decides on the packet is the state before."""
        state = self._state
        move, fate = self._draw("loss state", seq, copy), self._draw("loss", seq, copy)
        if state.loss_state != BAD:
            state.loss_state = BAD if move < model.p else GOOD
            return fate < model.good
        state.loss_state = GOOD if move < model.r else BAD
        return fate < model.bad

    def _four_state(self, model: FourState, seq: int, copy: int) -> bool:
        """The state moves, and the packet is lost when it is one of the lost states then."""
        state, x = self._state, self._draw("loss state", seq, copy)
        match state.loss_state:
            case LossState.LOST_IN_BURST if x < model.p32:
                after = LossState.BURST
            case LossState.LOST_IN_BURST:
                after = LossState.GAP if x < model.p32 + model.p31 else LossState.LOST_IN_BURST
            case LossState.BURST:
                after = LossState.LOST_IN_BURST if x < model.p23 else LossState.BURST
            case LossState.LOST_ALONE:
                after = LossState.GAP
            case _ if x < model.p14:  # in a gap
                after = LossState.LOST_ALONE
            case _:
                after = LossState.LOST_IN_BURST if x < model.p14 + model.p13 else LossState.GAP
        state.loss_state = after
        return after in (LossState.LOST_IN_BURST, LossState.LOST_ALONE)

    def flip_bit(self, payload: bytes, seq: int, copy: int) -> bytes:
        """One bit of the payload turned over, always the same: its own inverse."""
        bit = bits(self._seed_in_use, "corrupted bit", *self._link, seq, copy) % (8 * len(payload))
        damaged = bytearray(payload)
        damaged[bit // 8] ^= 1 << bit % 8
        return bytes(damaged)

    def _random(self, purpose: str, correlation: float, seq: int, copy: int) -> float:
        u = self._draw(purpose, seq, copy)
        if not correlation:
            return u
        last = self._state.last
        before = last.get(purpose)
        if before is None:
            before = unit(self._key, f"{purpose}, first")
        last[purpose] = x = (1.0 - correlation) * u + correlation * before
        return x

    def _use(self, condition: Condition) -> None:
        self._used = condition
        # The condition of a fault must not seed the link anew.
        own = self._seed if self.condition.seed is None else self.condition.seed
        seed = own if condition.seed is None else condition.seed
        if seed != self._seed_in_use:
            self._seed_in_use, self._key = seed, pack_numbers(seed, *self._link)

    def _draw(self, purpose: str, seq: int, copy: int) -> float:
        return unit(self._key + (_TWO(seq, copy) if copy else _ONE(seq)), purpose)


def _uniform(q: float) -> float:
    return 2.0 * q - 1.0


def _normal(q: float) -> float:
    return _NORMAL.inv_cdf(min(max(q, _TINY), 1.0 - _TINY))


def _pareto(q: float) -> float:
    power: float = (1.0 - q) ** (-1.0 / _PARETO_SHAPE)
    return min((power - _PARETO_MEAN) * _PARETO_SCALE, _PARETO_MOST)


def _pareto_normal(q: float) -> float:
    """Both parts of one number, so they rise together: of two numbers the sum would spread less."""
    return 0.25 * _normal(q) + 0.75 * _pareto(q)


_SHAPES: dict[str, Callable[[float], float]] = {
    "uniform": _uniform,
    "normal": _normal,
    "pareto": _pareto,
    "paretonormal": _pareto_normal,
}
