"""Checks on what the protocols promise."""

from __future__ import annotations

from math import dist, inf
from typing import Any, Literal

from fleet.checks.api import Facts, Failure, Margin, NotJudged, Tick, Vehicle, seconds
from fleet.checks.sides import ReachableGroups
from fleet.protocols.bidder import rounds_needed
from fleet.protocols.bundle_auction import places_of


class NoConflict:
    """No two living vehicles claim one place for longer than the auction needs."""

    def __init__(self, facts: Facts, places: Any, bundle: int, round: str = "100 ms") -> None:
        """`round`: the longest time until a neighbour has heard what was decided. Raises ValueError: some vehicle can
        never hear of another one."""
        count = len(places_of(places))
        rounds = rounds_needed(count, facts.vehicles, bundle, _diameter(facts))
        self._within = (rounds + 1) * seconds(round)  # one more: what is decided waits for the next round
        self._count = count
        self._since: dict[int, float] = {}  # since when each place has had a conflict [s]
        self._longest = 0.0
        self._at = facts.begin  # when the longest conflict was so long [s]

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
        """`reach`: how near a vehicle must have been, by its true position [m]. `by`: until when; the end of the
        run."""
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
                raise ValueError(f"what {facts.called([start])} says never reaches all others")
            found |= more
            hops += 1
        most = max(most, hops)
    return most


class TrueMean:
    """Every average is that of what the vehicles on its side have measured."""

    def __init__(self, facts: Facts, *, below: float = 0.01, within: str = "10 s") -> None:
        """`below`: the greatest error of an average [degC]. `within`: the time allowed after the start, and after every
        change of the links. If one of a ring fails, the sides stay, but both its ends take back what they gave."""
        self._below, self._within = below, seconds(within)
        self._facts = facts
        self._sides = ReachableGroups(facts)
        self._found = ""
        self._worst: tuple[float, float] | None = None  # by how much an average was off [degC], when [s]

    def step(self, tick: Tick) -> Failure | None:
        """Compare the averages with the mean, on every side."""
        self._sides.update(tick)
        if tick.t - max(self._sides.since, self._sides.links_since) < self._within:
            return None
        worst = 0.0
        for side in self._sides.groups:
            measured = [tick.vehicles[i - 1]["control.measured"] for i in side]
            averages = [tick.vehicles[i - 1]["control.average"] for i in side]
            if None in measured or None in averages:
                return None
            mean = sum(measured) / len(side)
            off = [average - mean for average in averages]
            if self._worst is None or max(map(abs, off)) > self._worst[0]:
                self._worst = max(map(abs, off)), tick.t
            if max(map(abs, off)) >= self._below:
                those = tuple(i for i, each in zip(side, off, strict=True) if abs(each) >= self._below)
                text = f"the mean of {self._facts.called(side)} is {mean:.6g} degC"
                text += ", and their averages are off by up to"
                values = {"mean [degC]": mean, "sum of all errors [degC]": sum(off)}
                return Failure(f"{text} {max(off, key=abs):.3g} degC", those, values)
            worst = max(worst, *map(abs, off))
        self._found = f"off by {worst:.2g} degC at most at {tick.t:g} s"
        return None

    def verdict(self) -> str | NotJudged:
        """How far off the averages were last."""
        return self._found or NotJudged("no sample: the links changed again, or the run ended, before it was judged")

    def margin(self) -> Margin | None:
        """How much farther off an average could have been."""
        return None if self._worst is None else Margin(self._below - self._worst[0], "degC", self._worst[1])


class AtMostOneLeader:
    """No two vehicles lead at the same time.

    The agents report whether they lead. A suspended agent reports nothing. With `per="fleet"` it counts as leader until
    its clock shows the time `leads_until` [s] of its last report. Without this signal it counts until it goes on. With
    `per="side"` it does not count, since it belongs to no side.
    """

    def __init__(self, facts: Facts, *, per: Literal["fleet", "side"] = "fleet", grace: str = "0 s") -> None:
        """Make the check.

        Args:
            facts: the facts about the scenario.
            per: `fleet`: one leader in the whole fleet; `side`: one on each side of a partition.
            grace: for this time after the start, and after every change of the sides, there may be more leaders.
        """
        if per not in ("fleet", "side"):
            raise ValueError(f"per: expected fleet or side, got {per!r:.40}")
        self._facts, self._per_side, self._grace = facts, per == "side", seconds(grace)
        self._sides = ReachableGroups(facts)
        self._until: dict[int, float] = {}  # true time [s] until which a vehicle leads, as it reported last
        self._most = 0
        self._tick_s = facts.tick
        self._led: dict[tuple[int, ...], tuple[int, float]] = {}  # the last leader of each side, and when it led [s]
        self._gap = facts.duration - facts.begin, facts.begin  # the shortest between two leaders [s], and when

    def step(self, tick: Tick) -> Failure | None:
        """Count the leaders."""
        self._sides.update(tick)
        leaders = [vehicle.id for vehicle in tick.vehicles if self._leads(vehicle, tick.t)]
        groups = self._sides.groups if self._per_side else (tuple(vehicle.id for vehicle in tick.vehicles),)
        for group in groups:
            of_these = tuple(i for i in leaders if i in group)
            self._most = max(self._most, len(of_these))
            if of_these and tick.t - self._sides.since >= self._grace:
                before, at = self._led.get(group, (of_these[0], -inf))
                if of_these != (before,):
                    gap = tick.t - at if len(of_these) == 1 else -self._tick_s
                    self._gap = min(self._gap, (gap, tick.t))
                self._led[group] = of_these[0], tick.t
            if len(of_these) > 1 and tick.t - self._sides.since >= self._grace:
                where = f"of the side {_show(group, self._facts)} " if self._per_side else ""
                silent = _show(tuple(i for i in of_these if i in self._sides.suspended), self._facts)
                more = f"; {silent} by its last report, since it is suspended" if silent else ""
                return Failure(f"{len(of_these)} vehicles {where}lead at once{more}", of_these)
        return None

    def verdict(self) -> str:
        """How many led at once, also within the grace."""
        return f"{self._most} at once at most" + (" on a side, with the grace" if self._grace else "")

    def margin(self) -> Margin:
        """The shortest time without a leader between two leaders."""
        return Margin(self._gap[0], "s", self._gap[1])

    def _leads(self, vehicle: Vehicle, t: float) -> bool:
        """Whether a vehicle leads at `t` [s]; remembers what it reports for when it is suspended."""
        leads = vehicle["control.leads"]
        if not vehicle.alive or leads == 0.0:
            self._until.pop(vehicle.id, None)  # a later life remembers nothing
        elif leads is not None:
            try:
                until = vehicle["control.leads_until"]
            except LookupError:  # a protocol without leases
                until = None
            self._until[vehicle.id] = inf if until is None else until - _ahead(vehicle)
            return bool(leads == 1.0)
        return vehicle.id in self._sides.suspended and t < self._until.get(vehicle.id, -inf)


class AgreeAfterHeal:
    """All vehicles of a side name the same leader, which leads."""

    def __init__(self, facts: Facts, *, within: str, quorum: Literal["fleet", "side"] = "fleet") -> None:
        """`within`: the time after the start, and after every change of the sides, such as a heal or the death of a
        vehicle. After it they must agree, until the next change. `quorum`: as that of the agents; with `fleet`, sides
        of half the fleet or less must agree that there is no leader."""
        if quorum not in ("fleet", "side"):
            raise ValueError(f"quorum: expected fleet or side, got {quorum!r:.40}")
        self._within, self._of_fleet = seconds(within), quorum == "fleet"
        self._facts = facts
        self._sides = ReachableGroups(facts)
        self._agreed_since: float | None = None  # the change [s] after which they have agreed; None: they do not
        self._longest = 0.0  # the longest time from a change to the agreement [s]
        self._waited = 0.0, facts.begin  # the longest time after a change without agreement [s], and until when

    def step(self, tick: Tick) -> Failure | None:
        """Compare what they name."""
        self._sides.update(tick)
        elapsed = tick.t - self._sides.since
        for side in self._sides.groups:
            named = [tick.vehicles[i - 1]["control.leader"] for i in side]
            if None in named:  # the log has no sample of it at this tick
                return None
            if len(set(named)) == 1 and self._may_be(int(named[0]), side, tick):
                continue
            self._waited = max(self._waited, (elapsed, tick.t))
            if elapsed < self._within:
                self._agreed_since = None
                return None
            said = ", ".join(
                f"{self._facts.name(i)} names {self._leader(int(n))}" for i, n in zip(side, named, strict=True)
            )
            return Failure(f"no leader is agreed on {elapsed:.4g} s after the sides changed: {said}", side)
        if self._agreed_since != self._sides.since:
            self._agreed_since = self._sides.since
            self._longest = max(self._longest, elapsed)
        return None

    def verdict(self) -> str | NotJudged:
        """How long it took to agree."""
        if self._agreed_since is None:
            return NotJudged("there was no agreement when the run ended, too early to judge it")
        return f"agreed {self._longest:.4g} s after a change at the latest"

    def margin(self) -> Margin:
        """How much longer they could have disagreed after a change."""
        return Margin(self._within - self._waited[0], "s", self._waited[1])

    def _leader(self, number: int) -> str:
        """Whom a vehicle names; a program may name a number that no vehicle has."""
        if not number:
            return "nobody"
        return self._facts.name(number) if 0 < number <= self._facts.vehicles else str(number)

    def _may_be(self, leader: int, side: tuple[int, ...], tick: Tick) -> bool:
        """Whether it is right that a side names this leader; 0: none."""
        if leader:
            return leader in side and tick.vehicles[leader - 1]["control.leads"] == 1.0
        return self._of_fleet and 2 * len(side) <= self._facts.vehicles


def _ahead(vehicle: Vehicle) -> float:
    """By how much the clock of a vehicle is ahead [s]."""
    try:
        return vehicle["clock.error"] or 0.0
    except LookupError:  # the scenario sets no clock
        return 0.0


def _show(vehicles: tuple[int, ...], facts: Facts) -> str:
    return ", ".join(map(facts.name, vehicles))
