"""Places shared out among vehicles by a consensus-based bundle auction; each vehicle then visits its own.

A message of kind `bundle-auction` goes to every neighbour in every round:

| value | meaning |
|---|---|
| bids, winners | y and z, one of each per place, see `fleet.protocols.bidder` |
| heard | pairs of vehicle and tick, s |
| done | numbers of the places that have been visited, from 0 |

The score of a path is the sum of discount^(time of arrival) over its places. A place counts as visited when its vehicle
has been within `reach_m` of it; nobody bids for it any more. If there is no news of a vehicle for `silence_s`, from
itself or from others, it counts as gone. Its places are then free again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import dist, isfinite
from typing import Any

from agents.api import AgentConfig, Delivery, FormationAgent, Motion, Nav, Signal, Telemetry, Vec3, pack
from fleet.protocols.bidder import NOBODY, Bidder, News
from fleet.protocols.received import is_count, is_real, valid_messages

KIND = "bundle-auction"
MOST_PLACES = 32
_LARGEST = 1000  # number of a vehicle; this bounds what is remembered and sent, whatever a neighbour says
_FARTHEST_M = 1e6
_AHEAD_M = 0.5  # how far ahead of the vehicle the point is that it steers for


class BundleAuction:
    """Shares out places by auction and visits the places that it wins. Then it goes to its formation place."""

    signals = (
        Signal("winner", "1", "who is to visit each place, as far as it knows; 0: nobody, or visited", MOST_PLACES),
        Signal("target", "1", "number of the place that it goes to, from 1; 0: none"),
        Signal("claimed", "1", "places that it has won and not visited yet"),
        Signal("done", "1", "places that it knows to be visited"),
        Signal("released", "1", "times that it took a vehicle's tasks from it because it was silent"),
        Signal("refused", "1", "messages of this protocol that it refused"),
    )

    def __init__(
        self,
        config: AgentConfig,
        places: list[list[float]],
        bundle: int = 3,
        speed_mps: float = 0.7,
        discount: float = 0.98,
        reach_m: float = 1.5,
        silence_s: float = 5.0,
    ) -> None:
        """Make it.

        Args:
            config: the agent's own slice of the scenario.
            places: x, y, z of each [m, NED], the same for all vehicles.
            bundle: the number of places that it may claim at the same time.
            speed_mps: its speed, also for plans [m/s].
            discount: the value of a place is multiplied by this for each second until its visit.
            reach_m: a place is visited from this distance [m] on.
            silence_s: after this time [s] without news a vehicle counts as gone.

        Raises:
            ValueError: one of them is out of range.
        """
        self._places = places_of(places)
        if not (type(bundle) is int and 1 <= bundle <= MOST_PLACES):
            raise ValueError(f"bundle: expected a whole number from 1 to {MOST_PLACES}, got {bundle!r}")
        for name, value in (("speed_mps", speed_mps), ("reach_m", reach_m), ("silence_s", silence_s)):
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f"{name}: expected a number above 0, got {value!r}")
        if not 0.0 < discount < 1.0:
            raise ValueError(f"discount: expected a number between 0 and 1, got {discount!r}")
        self._config = config
        self._formation = FormationAgent(config)
        self._tick_s = config.tick_ns / 1e9
        self._speed, self._discount, self._reach = speed_mps, discount, reach_m
        self._silence_ticks = round(silence_s / self._tick_s)
        self._bidder = Bidder(config.id, len(self._places), bundle)
        self._plan: tuple[float, Vec3] | None = None  # time and place from which paths are scored; None: now, here
        self._done: set[int] = set()
        self._released = 0
        self._refused = 0

    def transmit(self, nav: Nav) -> list[bytes]:
        """The own state, and what it believes of the auction."""
        bidder = self._bidder
        heard = [[m, tick] for m, tick in bidder.heard.items()] + [[bidder.number, nav.tick]]
        return [*self._formation.transmit(nav), pack(KIND, [bidder.bids, bidder.winners, heard, sorted(self._done)])]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Take part in the auction, and go on to the next place."""
        deliveries = list(deliveries)
        news = self._hear(deliveries)
        position = _position(nav)
        self._release(nav.tick)
        self._visit(position)
        if self._plan is None:
            self._plan = nav.tick * self._tick_s, position
            news = True
        if news:  # without news the choice would be the same
            self._bidder.choose(self._score, frozenset(self._done))
        target = self._bidder.path[0] if self._bidder.path else None
        tau, _ = self._formation.decide(nav, deliveries, course=self._course(nav, position, target))
        winners = [0.0 if j in self._done else float(winner) for j, winner in enumerate(self._bidder.winners)]
        return tau, {
            "winner": [*winners, *[0.0] * (MOST_PLACES - len(winners))],
            "target": 0.0 if target is None else float(target + 1),
            "claimed": float(len(self._bidder.bundle)),
            "done": float(len(self._done)),
            "released": float(self._released),
            "refused": float(self._refused),
        }

    def _hear(self, deliveries: Iterable[Delivery]) -> bool:
        """Take in the messages of neighbours; what cannot be is refused and counted. Returns whether there were any."""
        messages, refused = valid_messages(KIND, deliveries, self._valid)
        self._refused += refused
        for delivery, (bids, winners, heard, done) in messages:
            self._bidder.hear(delivery.src, News(bids, winners, dict(heard)))
            self._close(done)
        return bool(messages)

    def _valid(self, values: Any, delivery: Delivery) -> bool:
        """Whether a message is about as many places, bids no more than one is worth, and has no news of the future.

        News has a time stamp by the clock of its own vehicle. That clock may be ahead by up to the time after which a
        vehicle is forgotten.
        """
        count = len(self._places)
        match values:
            case [[*bids], [*winners], [*heard], [*done]] if len(bids) == len(winners) == count:
                return (
                    all(is_real(bid, 1.0) and bid >= 0.0 for bid in bids)
                    and all(is_count(winner, _LARGEST) for winner in winners)
                    and all(_is_news(pair, delivery.sent_tick + self._silence_ticks) for pair in heard)
                    and [delivery.src, delivery.sent_tick] in heard
                    and all(is_count(j, count - 1) for j in done)
                )
        return False

    def _release(self, tick: int) -> None:
        """Free the tasks of vehicles without news for a long time."""
        bidder = self._bidder
        for m in set(bidder.winners) - {NOBODY, bidder.number}:
            if tick - bidder.heard.get(m, 0) > self._silence_ticks and bidder.forget(m):
                self._released += 1
                self._plan = None

    def _visit(self, position: Vec3) -> None:
        """Note the next place of the path as visited if it is near."""
        path = self._bidder.path
        if path and dist(position, self._places[path[0]]) <= self._reach:
            self._close(path[:1])

    def _close(self, done: Iterable[int]) -> None:
        """Take places that are visited out of the auction."""
        for j in done:
            self._done.add(j)
            if self._bidder.finish(j):
                self._plan = None

    def _score(self, path: Sequence[int]) -> float:
        """The value of a path: each place discounted by the time of its visit."""
        assert self._plan is not None
        t, place = self._plan
        total = 0.0
        for j in path:
            t += dist(place, self._places[j]) / self._speed
            place = self._places[j]
            total += self._discount**t
        return total

    def _course(self, nav: Nav, position: Vec3, target: int | None) -> Motion | None:
        """A point a little ahead on the way to the target; without one the own place in the formation."""
        if target is None:
            return None if self._config.reference is None else self._config.desired(nav.tick * self._tick_s)
        goal = self._places[target]
        distance = dist(position, goal)
        if distance == 0.0:
            return Motion(goal, (0.0, 0.0, 0.0))
        x, y, z = ((g - p) / distance for g, p in zip(goal, position, strict=True))
        ahead = min(_AHEAD_M, distance)
        px, py, pz = position
        return Motion(
            (px + x * ahead, py + y * ahead, pz + z * ahead), (x * self._speed, y * self._speed, z * self._speed)
        )


def _is_news(pair: Any, latest: int) -> bool:
    """Whether `pair` is the number of a vehicle and a tick up to `latest`."""
    return isinstance(pair, list) and len(pair) == 2 and is_count(pair[0], _LARGEST) and is_count(pair[1], latest)


def _position(nav: Nav) -> Vec3:
    x, y, z, _, _ = nav.eta
    return x, y, z


def places_of(given: Any) -> tuple[Vec3, ...]:
    """Places [m, NED] as a scenario gives them: a list of x, y, z. Raises ValueError: they are no such list, or too
    many."""
    if not (isinstance(given, list) and 1 <= len(given) <= MOST_PLACES):
        raise ValueError(f"places: expected a list of 1 to {MOST_PLACES} places, got {given!r:.80}")
    found: list[Vec3] = []
    for place in given:
        if not (isinstance(place, list) and len(place) == 3 and all(is_real(value, _FARTHEST_M) for value in place)):
            raise ValueError(f"places: expected x, y and z in m such as [10, 0, 5], got {place!r:.80}")
        x, y, z = place
        found.append((float(x), float(y), float(z)))
    return tuple(found)
