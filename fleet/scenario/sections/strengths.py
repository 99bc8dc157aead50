"""How strong a fault of a swarm is: one number from 0 (mild) to 1 (strong) for each kind, on a logarithmic scale.

| kind | from | to |
|---|---|---|
| loss | 5 % | 100 %, over the link's own condition |
| delay | a fifth of a round | 50 rounds more, with a quarter of it as jitter |
| rate | 20 kbit/s | 200 bit/s |
| slow | 1 tick | 5 rounds |
| clock | drift 20 ppm, step 1 ms | 2 %, 1 s; either sign |
| dvl, compass, fix | 5 % of the samples lost, or bias 2 cm/s, 1 deg, 1 m | all lost, or 0.5 m/s, 30 deg, 50 m |
| bias, noise | 0.1 m, 1 cm | 5 m, 1 m of the position |
| dropout | 10 % | 100 % |
| efficiency | 90 % | 10 % of each command |
| gust | 0.1 m/s | 1 m/s |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, sin, tau
from typing import Any

from fleet.quantities import show_time
from fleet.scenario.sections.ground import Ground
from netem.condition import Condition, Link
from netem.grammar import print_condition

OF_LINKS = frozenset({"loss", "delay", "rate"})
MOST_CONDITIONS = 16  # links that keep their own condition below a fault; of more links it has one for all


def between(low: float, high: float, strength: float) -> float:
    """The value at `strength` (0 to 1) between `low` and `high` on a logarithmic scale, rounded to three digits."""
    return float(f"{low * (high / low) ** strength:.3g}")


def condition(kind: str, own: Condition, strength: float, ground: Ground) -> Condition:
    """The condition of a link with a fault of loss, delay or rate over its own."""
    match kind:
        case "loss":
            return replace(own, loss=max(own.loss, between(0.05, 1.0, strength)), loss_model=None)
        case "delay":
            tick = ground.spec.tick
            late = max(tick, round(between(0.2, 50.0, strength) * ground.round_ns) // tick * tick)
            return replace(own, delay_ns=own.delay_ns + late, jitter_ns=max(own.jitter_ns, late // 4))
    rate = round(between(200.0, 20_000.0, 1.0 - strength))
    return replace(own, rate_bit_s=min(own.rate_bit_s or rate, rate))


def link_fault(kind: str, selector: str, links: tuple[Link, ...], strength: float, ground: Ground) -> dict[str, Any]:
    """A fault of links: each over the link's own condition, where that is one and the links are few."""
    each = {link: condition(kind, ground.conditions.get(link, Condition()), strength, ground) for link in links}
    if len(set(each.values())) == 1:
        return {"link": {selector: print_condition(next(iter(each.values())))}}
    if len(each) <= MOST_CONDITIONS:
        return {"link": {f"{a}->{b}": print_condition(one) for (a, b), one in each.items()}}
    return {"link": {selector: print_condition(condition(kind, Condition(), strength, ground))}}


def vehicle_fault(kind: str, who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
    """A fault of one vehicle.

    Args:
        turn: from 0 to 1, a draw in addition to the strength: a sign, a direction, or one of two forms.
    """
    make = _KINDS.get(kind)
    return {kind: str(who)} if make is None else {kind: make(who, strength, turn, ground)}


def _slow(who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
    most = max(2, 5 * ground.round_ns // ground.spec.tick)
    return {"vehicles": str(who), "by": f"{round(between(1, most, strength))} ticks"}


def _clock(who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
    sign = "-" if turn < 0.5 else ""
    step = round(between(1e6, 1e9, strength))
    return {"vehicles": str(who), "step": f"{sign}{show_time(step)}",
            "drift": f"{sign}{between(20, 20_000, strength):g} ppm"}  # fmt: skip


def _instrument(bias: Callable[[float, float], str], name: str = "bias") -> Callable[..., dict[str, Any]]:
    def make(who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
        if turn < 0.5:
            return {"vehicles": str(who), "lost": f"{between(5, 100, strength):g} %"}
        return {"vehicles": str(who), name: bias(strength, tau * 2.0 * (turn - 0.5))}

    return make


def _plane(low: float, high: float, unit: str, depth: str = " 0") -> Callable[[float, float], str]:
    def make(strength: float, angle: float) -> str:
        size = between(low, high, strength)
        return f"{size * cos(angle):.3f} {size * sin(angle):.3f}{depth} {unit}"

    return make


def _heading(strength: float, angle: float) -> str:
    return f"{'-' if angle < tau / 2 else ''}{between(1, 30, strength):g} deg"


def _bias(who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
    return {"vehicles": str(who), "position": _plane(0.1, 5.0, "m")(strength, tau * turn)}


def _noise(who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
    return {"vehicles": str(who), "position_noise": f"{between(0.01, 1.0, strength):g} m"}


def _dropout(who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
    return {"vehicles": str(who), "probability": f"{between(10, 100, strength):g} %"}


def _efficiency(who: int, strength: float, turn: float, ground: Ground) -> dict[str, Any]:
    share = f"{between(0.1, 0.9, 1.0 - strength):g}"
    return {"vehicles": str(who), "surge": share, "pitch": share, "yaw": share}


_KINDS: dict[str, Callable[[int, float, float, Ground], dict[str, Any]]] = {
    "slow": _slow,
    "clock": _clock,
    "dvl": _instrument(_plane(0.02, 0.5, "m/s")),
    "compass": _instrument(_heading),
    "fix": _instrument(_plane(1.0, 50.0, "m", "")),
    "bias": _bias,
    "noise": _noise,
    "dropout": _dropout,
    "efficiency": _efficiency,
}


def gust(strength: float, turn: float, lasts_ns: int) -> dict[str, Any]:
    """A current that rises and falls within the time of the fault, for all vehicles."""
    return {"gust": {"velocity": _plane(0.1, 1.0, "m/s")(strength, tau * turn), "over": show_time(lasts_ns)}}
