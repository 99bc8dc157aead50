"""Average consensus: all vehicles find the mean of what each of them has measured once.

Both agents use Metropolis weights w_ij = 1 / (1 + max(d_i, d_j)), where d is a vehicle's number of neighbours. Links go
both ways.

`NaiveAverage` adds w_ij (x_j - x_i) for each x_j that arrived. A lost or late message changes the sum of all x, so the
vehicles agree on a wrong number.

`ExactAverage` passes on value and weight (y, w), and its estimate is y / w. It sends to a neighbour the sum of all
shares since the link was opened, not just the last share. So a later message brings the content of a lost one (C. N.
Hadjicostis, N. H. Vaidya, A. D. Dominguez-Garcia, "Robust distributed average consensus via exchange of running sums",
IEEE TAC 61(6), 2016). Beyond that paper, each end of a link knows both sums: when the neighbour is silent for
`forget_after_s` it forgets them and takes back what it gave in net. So the average is that of the vehicles that are
there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from random import Random
from typing import Any

from agents.api import AgentConfig, Delivery, FormationAgent, Nav, Signal, Telemetry, Vec3, pack
from fleet.protocols.received import is_count, is_real, valid_messages

NAIVE, EXACT = "average/naive", "average/exact"  # kinds of messages
MOST = 1e6  # degC: what is larger is no measurement
_MOST_SUM = 1e15  # a sum of shares, of value or of weight
_LEAST_WEIGHT = 1e-6  # with a smaller weight the estimate stays as it is
_MOST_DEGREE = 1000
_MEASURED = Signal("measured", "degC", "temperature that it measured once")
_AVERAGE = Signal("average", "degC", "its estimate of the mean of what all measured")
_REFUSED = Signal("refused", "1", "messages that were damaged or made no sense")


class NaiveAverage:
    """Keeps the formation, and averages what happens to arrive."""

    signals = (_MEASURED, _AVERAGE, _REFUSED)

    def __init__(self, config: AgentConfig, *, value: float | None = None) -> None:
        """`value`: what it measures [degC]; None: drawn from seed and vehicle, 10 to 20."""
        self._formation = FormationAgent(config)
        self._neighbours = frozenset(neighbour.id for neighbour in config.neighbours)
        self._measured = self._average = _measurement(config, value)
        self._heard: dict[int, tuple[int, float]] = {}  # since the round before, by neighbour: its degree and average
        self._refused = 0

    def transmit(self, nav: Nav) -> list[bytes]:
        """The formation's payload, and the average after what arrived since the round before."""
        degree, own = len(self._neighbours), self._average
        for other_degree, other in self._heard.values():
            self._average += (other - own) / (1 + max(degree, other_degree))
        self._heard.clear()
        return [*self._formation.transmit(nav), pack(NAIVE, [degree, self._average])]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Steer as the formation asks, and keep what arrives."""
        deliveries = list(deliveries)
        tau, _ = self._formation.decide(nav, deliveries)
        messages, refused = valid_messages(NAIVE, deliveries, self._is_valid)
        self._refused += refused
        for delivery, (degree, average) in messages:
            self._heard[delivery.src] = (degree, average)
        return tau, {"measured": self._measured, "average": self._average, "refused": self._refused}

    def _is_valid(self, values: Any, delivery: Delivery) -> bool:
        shape = isinstance(values, list) and len(values) == 2 and delivery.src in self._neighbours
        return shape and is_count(values[0], _MOST_DEGREE) and is_real(values[1], MOST)


@dataclass(slots=True)
class _Link:
    """The knowledge of one end of a link. If `opened` differs, the end with the earlier one takes the later one."""

    opened: int  # tick; the sums begin there at 0
    heard: int = -1  # tick at which the newest message was sent; -1: none, or silent for too long
    mutual: bool = False  # whether the neighbour says that it hears this vehicle
    degree: int = 0  # degree of the neighbour
    gave_value: float = 0.0  # sum of all shares for the neighbour
    gave_weight: float = 0.0
    took_value: float = 0.0  # the neighbour's sum, as far as it is known
    took_weight: float = 0.0


class ExactAverage:
    """Keeps the formation, and averages by running sums, so that lost, late and repeated messages change nothing."""

    signals = (
        _MEASURED,
        _AVERAGE,
        Signal("weight", "1", "weight that it holds; the shares on their way hold the rest"),
        Signal("links", "1", "neighbours that it hears and that hear it"),
        _REFUSED,
    )

    def __init__(self, config: AgentConfig, *, value: float | None = None, forget_after_s: float = 2.0) -> None:
        """Make it.

        Args:
            config: the agent's own slice of the scenario.
            value: what it measures [degC]; None: drawn from seed and vehicle, 10 to 20.
            forget_after_s: a neighbour that is silent for longer does not count until it is heard again [s]. It must be
                longer than the delay and the usual pauses, or the average is seldom that of all. The default is for
                rounds of 100 ms and a loss of 60 % at most: loss^(rounds in this time) should be 1e-5 or less.
        """
        self._id = config.id
        self._formation = FormationAgent(config)
        self._measured = self._average = self._value = _measurement(config, value)
        self._weight = 1.0
        self._forget_ticks = round(forget_after_s * 1e9 / config.tick_ns)
        self._neighbours = tuple(neighbour.id for neighbour in config.neighbours)
        self._links: dict[int, _Link] = {}  # made at the first sample, which says what time it is
        self._refused = 0

    def transmit(self, nav: Nav) -> list[bytes]:
        """The formation's payload, and what each neighbour has been given in all, with another share for it."""
        self._begin(nav.tick)
        degree, value, weight = len(self._links), self._value, self._weight
        for link in self._links.values():
            if link.mutual:
                part = 1 / (1 + max(degree, link.degree))
                link.gave_value += part * value
                link.gave_weight += part * weight
                self._value -= part * value
                self._weight -= part * weight
        sums = [[j, x.opened, x.heard >= 0, x.gave_value, x.gave_weight] for j, x in self._links.items()]
        return [*self._formation.transmit(nav), pack(EXACT, [degree, sums])]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Steer as the formation asks, and take what arrives."""
        self._begin(nav.tick)
        deliveries = list(deliveries)
        tau, _ = self._formation.decide(nav, deliveries)
        messages, refused = valid_messages(EXACT, deliveries, self._is_valid)
        self._refused += refused
        for delivery, (degree, sums) in messages:
            self._absorb(delivery, degree, sums)
        for link in self._links.values():
            if 0 <= link.heard < nav.tick - self._forget_ticks:
                link.heard, link.mutual = -1, False
                self._reopen(link, nav.tick)
        if self._weight > _LEAST_WEIGHT:
            self._average = self._value / self._weight
        return tau, {
            "measured": self._measured,
            "average": self._average,
            "weight": self._weight,
            "links": sum(link.mutual for link in self._links.values()),
            "refused": self._refused,
        }

    def _begin(self, tick: int) -> None:
        """At the first sample of a life: open all links, later than any life before has."""
        if not self._links:
            self._links = {j: _Link(tick) for j in self._neighbours}

    def _absorb(self, delivery: Delivery, degree: int, sums: list[list[Any]]) -> None:
        """Take what a neighbour has given in all, unless it is known, or of a link that was opened anew since."""
        link = self._links[delivery.src]
        if delivery.sent_tick <= link.heard:
            return
        link.heard, link.degree, link.mutual = delivery.sent_tick, degree, False
        for j, opened, hears, value, weight in sums:
            if j != self._id:
                continue
            if opened > link.opened:
                self._reopen(link, opened)
            link.mutual = hears
            if opened == link.opened:
                self._value += value - link.took_value
                self._weight += weight - link.took_weight
                link.took_value, link.took_weight = value, weight

    def _reopen(self, link: _Link, tick: int) -> None:
        """Forget the sums of a link and take back what was given in net."""
        self._value += link.gave_value - link.took_value
        self._weight += link.gave_weight - link.took_weight
        link.gave_value = link.gave_weight = link.took_value = link.took_weight = 0.0
        link.opened = tick

    def _is_valid(self, values: Any, delivery: Delivery) -> bool:
        if not (isinstance(values, list) and len(values) == 2 and delivery.src in self._links):
            return False
        degree, sums = values
        return (
            is_count(degree, _MOST_DEGREE)
            and isinstance(sums, list)
            and all(isinstance(each, list) and len(each) == 5 for each in sums)
            and all(
                type(j) is int
                and is_count(opened, delivery.sent_tick + self._forget_ticks)  # a time by the clock of either end
                and isinstance(hears, bool)
                and is_real(value, _MOST_SUM)
                and is_real(weight, _MOST_SUM)
                for j, opened, hears, value, weight in sums
            )
        )


def _measurement(config: AgentConfig, value: float | None) -> float:
    """The measurement of a vehicle [degC]."""
    return Random(f"{config.seed}/average/{config.id}").uniform(10.0, 20.0) if value is None else float(value)
