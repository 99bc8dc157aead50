"""How often each vehicle of an acoustic channel sends, and how old its state is when it is used.

With `tdma` a vehicle has a slot per frame. With `aloha` it is drawn, for any number of vehicles in this way. Everything
is in whole ticks, as the modems do it: m is a round, a an airtime, b the largest back-off, and there are n vehicles. A
transmission that starts at phase p of its round (0 <= p < m) ends at p + a. The next news comes with the next round.
So the next start is w(p) = max(a, m - p) after it, and a back-off more, uniform in 0 ... b. That is a Markov chain of
phases; pi is its stationary distribution, and E w + b/2 the mean from one start to the next.

The others do the same, each on its own. A start meets nobody if no other is less than an airtime before or after it.
Another vehicle was silent in ticks f ... l if its last start before f is followed by one after l:

    q(p) = sum_(t < f) r(t) P(back-off > l - t - w(t)),   f = p - a + 1,  l = p + a - 1,  r(t) = pi(t mod m) m / mean

and the share of starts that meet nobody is E q(p)^(n-1). With rounds no longer than an airtime there is always news,
w = a, and the sum is

    q = (b - a + 1) (b - a + 2) / ((b + 1) (2 a + b)), in continuous time (B - T)^2 / (B (B + 2 T)),   0 for b < a

which with B = 2 T (2 n - 1) is ((4 n - 3)^2 / (4 n (4 n - 2)))^(n-1) for all the others, and tends to e^-1 as n
grows. Left out: capture, and propagation, which shifts who meets whom.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from agents.offset import Offset
from fleet.scenario.schema.network import NetworkSection
from fleet.scenario.sections.acoustic import SIZES, extent_m
from netem.modem import AcousticConfig

_CELLS = 3000  # ticks of an airtime and a back-off: beyond, several ticks count as one
_STEPS = 2000
_SETTLED = 1e-12


class Talking(NamedTuple):
    """The mean from one start to the next [ticks], and the share of starts that meet no other transmission."""

    mean: float
    alone: float


@lru_cache(maxsize=16)
def talking(round_ticks: int, airtime_ticks: int, backoff_ticks: int, vehicles: int) -> Talking:
    """The long run of a vehicle among others that do the same; airtimes of a tick at least."""
    if round_ticks <= airtime_ticks:
        a, b = airtime_ticks, backoff_ticks
        silent = (b - a + 1) * (b - a + 2) / ((b + 1) * (2 * a + b)) if b >= a else 0.0
        return Talking(a + b / 2, silent ** (vehicles - 1))
    scale = -(-(airtime_ticks + backoff_ticks) // _CELLS)
    a, b, whole = (
        max(least, round(t / scale)) for t, least in ((airtime_ticks, 1), (backoff_ticks, 0), (round_ticks, 1))
    )
    m = min(whole, a + b + 1)  # the rest of a longer round is silence
    phases = np.arange(m)
    wait = np.maximum(a, m - phases)
    pi = _stationary(m, (phases + wait) % m, b)
    mean = float(pi @ wait) + b / 2
    rate = pi * m / mean
    behind = np.arange(1, max(a, m) + b + 1)
    alone = 0.0
    for p in phases[pi > 0.0]:
        first, last = p - a + 1, p + a - 1
        then = first - behind
        longer = np.clip(b - (last - then - wait[then % m]), 0, b + 1) / (b + 1)
        alone += pi[p] * min(1.0, float(rate[then % m] @ longer)) ** (vehicles - 1)
    return Talking((mean + whole - m) * scale, float(alone))


def _stationary(m: int, earliest: Any, b: int) -> Any:
    """The share of starts at each phase, when a start may be followed from `earliest` on, up to `b` later."""
    back_off = np.bincount(np.arange(b + 1) % m, minlength=m) / (b + 1)
    spectrum = np.fft.rfft(back_off)
    pi = np.full(m, 1.0 / m)
    for _ in range(_STEPS):
        ready = np.bincount(earliest, weights=pi, minlength=m)
        after = np.maximum(np.fft.irfft(np.fft.rfft(ready) * spectrum, m), 0.0)
        after /= after.sum()
        if float(np.abs(after - pi).sum()) < _SETTLED:
            return after
        pi = after
    return pi


def turn_s(network: NetworkSection, acoustic: AcousticConfig, vehicles: int, tick_ns: int) -> tuple[float, float]:
    """The mean and the longest time [s] from the start of one transmission of a vehicle to the start of its next."""
    period = network.period / 1e9
    if acoustic.mac == "tdma":
        turn = vehicles * acoustic.slot_ticks * tick_ns / 1e9
        return max(period, turn), max(period, turn)
    airtime = acoustic.modem.airtime_ns(SIZES[network.payload]) / 1e9
    backoff = acoustic.backoff_ticks * tick_ns / 1e9
    return _talking(network, acoustic, vehicles, tick_ns).mean * tick_ns / 1e9, period + airtime + backoff


def _talking(network: NetworkSection, acoustic: AcousticConfig, vehicles: int, tick_ns: int) -> Talking:
    airtime = -(-acoustic.modem.airtime_ns(SIZES[network.payload]) // tick_ns)
    return talking(network.period // tick_ns, max(1, airtime), acoustic.backoff_ticks, vehicles)


def greatest_age_s(network: NetworkSection, acoustic: AcousticConfig, plans: tuple[Offset, ...], tick_ns: int) -> float:
    """The greatest age [s] that a neighbour's state can have when it is used, if no payload is lost.

    It is the sum of: one round, the longest time between two transmissions (see `turn_s`), airtime and propagation. A
    state waits at most one round until it is sent. It is used until the next state of the same sender arrives.
    """
    airtime = acoustic.modem.airtime_ns(SIZES[network.payload]) / 1e9
    flight = extent_m(plans) / acoustic.sound_speed
    _, longest = turn_s(network, acoustic, len(plans), tick_ns)
    return network.period / 1e9 + longest + airtime + flight


def describe_turns(network: NetworkSection, acoustic: AcousticConfig, vehicles: int, tick_ns: int) -> str:
    """One line of text: the airtime, and how often each vehicle sends."""
    assert network.acoustic is not None
    size = SIZES[network.payload]
    airtime = acoustic.modem.airtime_ns(size) / 1e9
    mean, _ = turn_s(network, acoustic, vehicles, tick_ns)
    said = f"a {network.payload} payload has {size} bytes and takes {airtime:.4g} s of airtime"
    line = f"acoustic modem {network.acoustic.modem}: {said}"
    if acoustic.mac == "tdma":
        slot = acoustic.slot_ticks * tick_ns / 1e9
        return f"{line}; with slots of {slot:g} s each vehicle sends every {mean:.4g} s"
    if acoustic.mac == "csma":
        return f"{line}; each vehicle listens before it sends; alone it would send every {mean:.4g} s on average"
    alone = _talking(network, acoustic, vehicles, tick_ns).alone
    line += f"; each vehicle sends every {mean:.4g} s on average"
    return f"{line}, and {alone:.0%} of its transmissions overlap no other"
