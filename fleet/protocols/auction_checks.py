"""Checks on what the auction of places promises."""

from __future__ import annotations

from math import dist
from typing import Any

from fleet.checks.api import Facts, Failure, Margin, Tick, seconds
from fleet.protocols.bidder import rounds_needed
from fleet.protocols.bundle_auction import places_of


class NoConflict:
    """No two living vehicles claim one place for longer than the auction needs."""

    def __init__(self, facts: Facts, places: Any, bundle: int, round: str = "100 ms") -> None:
        """Make it.

        Args:
            facts: what is known of the scenario.
            places, bundle: as the agents have them.
            round: the longest time until a neighbour has heard what was decided.

        Raises:
            ValueError: some vehicle can never hear of another one.
        """
        count = len(places_of(places))
        rounds = rounds_needed(count, facts.vehicles, bundle, _diameter(facts))
        self._within = (rounds + 1) * seconds(round)  # one more: what is decided waits for the next round
        self._count = count
        self._since: dict[int, float] = {}  # by place
        self._longest = 0.0
        self._at = facts.begin  # when it was so long [s]

    def step(self, tick: Tick) -> Failure | None:
        """Look who claims what."""
        claims: dict[int, list[int]] = {}
        for vehicle in tick.vehicles:
            winners = vehicle["control.winner"] if vehicle.alive else None
            for j, winner in enumerate(winners[: self._count] if winners else ()):
                if winner == vehicle.id:
                    claims.setdefault(j, []).append(vehicle.id)
        for j in range(self._count):
            claimants = claims.get(j, [])
            if len(claimants) < 2:
                self._since.pop(j, None)
                continue
            lasts = tick.t - self._since.setdefault(j, tick.t)
            if lasts > self._longest:
                self._longest, self._at = lasts, tick.t
            if lasts > self._within:
                text = f"place {j + 1} is claimed by {len(claimants)} vehicles for more than {self._within:g} s"
                return Failure(text, tuple(claimants), {"place": j + 1.0})
        return None

    def verdict(self) -> str:
        """The longest conflict."""
        return f"a conflict lasted {self._longest:g} s at most, and {self._within:g} s are allowed"

    def margin(self) -> Margin:
        """How much longer a conflict could have lasted."""
        return Margin(self._within - self._longest, "s", self._at)


class AllVisited:
    """Every place is visited by a living vehicle in time."""

    def __init__(self, facts: Facts, places: Any, reach: float = 2.0, by: str = "") -> None:
        """Make it.

        Args:
            facts: what is known of the scenario.
            places: as the agents have them.
            reach: how near a vehicle must have been, by its true position [m].
            by: until when; the end of the run.
        """
        self._open = dict(enumerate(places_of(places), 1))
        self._count = len(self._open)
        self._reach = reach
        self._by = seconds(by) if by else facts.duration
        self._last = facts.begin
        self._tick_s = facts.tick

    def step(self, tick: Tick) -> Failure | None:
        """Look who is where."""
        for vehicle in tick.vehicles:
            if not vehicle.alive or (x := vehicle["state.x"]) is None:
                continue
            position = (x, vehicle["state.y"], vehicle["state.z"])
            for number in [n for n, place in self._open.items() if dist(place, position) <= self._reach]:
                del self._open[number]
                self._last = tick.t
        return self._late() if tick.t >= self._by else None

    def verdict(self) -> str | Failure:
        """When the last one was visited."""
        return self._late() or f"all {self._count} places, the last at {self._last:g} s"

    def margin(self) -> Margin:
        """The time that was left when the last place was visited.

        If a place was not visited, all we know is that it is below 0.
        """
        return Margin(-self._tick_s * len(self._open) if self._open else self._by - self._last, "s", self._last)

    def _late(self) -> Failure | None:
        if not self._open:
            return None
        numbers = ", ".join(map(str, self._open))
        return Failure(f"{len(self._open)} of {self._count} places not visited: {numbers}")


def _diameter(facts: Facts) -> int:
    """Hops from any vehicle to any other, at most."""
    most = 0
    for start in range(1, facts.vehicles + 1):
        found, hops = {start}, 0
        while len(found) < facts.vehicles:
            more = {b for a, b in facts.links if a in found} - found
            if not more:
                raise ValueError(f"what vehicle {start} says never reaches all others")
            found |= more
            hops += 1
        most = max(most, hops)
    return most
