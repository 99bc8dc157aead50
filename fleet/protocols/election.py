"""Leader election with leases, flooded through neighbours.

Every vehicle sends a record of itself, and the newest record of every other that it has heard of: [vehicle, tick of the
record, candidate, tick up to which it grants that candidate a lease]. A record is fresh for one lease.

* A vehicle grants to one candidate at a time: it turns to another one only when all its earlier grants have expired.
  After its start it first listens for one lease, because a life before may have granted.
* It grants to the leader that it knows of; if there is none, to the lowest number that is fresh.
* What it grants lasts one lease from the candidate's newest record, so who is not heard leads for one lease at most.
* A vehicle leads while more than half of the voters grant to it: of the whole fleet (`quorum: fleet`), or of those
  whose records are fresh (`quorum: side`).
* The leader knows until when it leads if it hears nothing more: `leads_until`. A process that was suspended compares it
  with its clock before it acts as the leader.

docs/guide/protocols/election.md has the promises and their assumptions. Leases are those of C. Gray and D. Cheriton
("Leases", SOSP 1989). Times are those of each vehicle's own clock, and the promises hold as long as the clocks agree.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

from agents.api import AgentConfig, Delivery, FormationAgent, Nav, Signal, Telemetry, Vec3, pack
from fleet.protocols.received import is_count, valid_messages

RECORDS = "election"  # kind of its messages
NOBODY = 0


class _Record(NamedTuple):
    made: int  # tick
    candidate: int  # NOBODY: it grants nothing
    until: int  # tick from which the grant has expired


class Election:
    """Keeps the formation, and elects a leader."""

    signals = (
        Signal("leads", "1", "1 while it is the leader"),
        Signal(
            "leads_until", "s", "time by its clock until which it leads if it hears nothing more; 0: it does not lead"
        ),
        Signal("leader", "1", "number of the leader that it knows of; 0: none"),
        Signal("candidate", "1", "number of the vehicle that it grants a lease; 0: none"),
        Signal("known", "1", "vehicles that it has heard of within a lease, itself included"),
        Signal("refused", "1", "messages that were damaged or made no sense"),
    )

    def __init__(
        self, config: AgentConfig, *, vehicles: int, lease_s: float = 3.0, quorum: Literal["fleet", "side"] = "fleet"
    ) -> None:
        """`vehicles`: the number of vehicles in the fleet; they are numbered from 1. `lease_s`: the length of a grant
        and of a record [s]. `quorum`: a leader needs more than half of these: of the fleet, or of the vehicles heard of
        within a lease. With the latter each side of a partition elects its own leader."""
        if quorum not in ("fleet", "side"):
            raise ValueError(f"quorum: expected fleet or side, got {quorum!r:.40}")
        if not config.id <= vehicles:
            raise ValueError(f"vehicles: there is a vehicle {config.id}, and vehicles is {vehicles!r:.40}")
        self._id, self._vehicles, self._of_fleet = config.id, vehicles, quorum == "fleet"
        self._formation = FormationAgent(config)
        self._tick_s = config.tick_ns / 1e9
        self._lease = round(lease_s * 1e9 / config.tick_ns)  # ticks
        self._silent_until = -1  # tick from which it may grant; -1: not begun
        self._candidate, self._until = NOBODY, 0  # the candidate of the newest grant, and until when it holds
        self._others: dict[int, _Record] = {}
        self._refused = 0

    def transmit(self, nav: Nav) -> list[bytes]:
        """The formation's payload, and all records that are fresh."""
        self._grant(nav.tick)
        records = [[i, *record] for i, record in self._fresh(nav.tick).items()]
        return [*self._formation.transmit(nav), pack(RECORDS, records)]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Steer as the formation asks, take the records that arrive, and see who leads."""
        deliveries = list(deliveries)
        tau, _ = self._formation.decide(nav, deliveries)
        messages, refused = valid_messages(RECORDS, deliveries, self._is_valid)
        self._refused += refused
        for _, records in messages:
            for i, *values in records:
                if i != self._id and (i not in self._others or values[0] > self._others[i].made):
                    self._others[i] = _Record(*values)
        fresh = self._fresh(nav.tick)
        leader = self._leader(fresh, nav.tick)
        return tau, {
            "leads": float(leader == self._id),
            "leads_until": self._leads_until(fresh) * self._tick_s if leader == self._id else 0.0,
            "leader": leader,
            "candidate": self._candidate if nav.tick < self._until else NOBODY,
            "known": len(fresh),
            "refused": self._refused,
        }

    def _grant(self, tick: int) -> None:
        """Extend the grant, let it expire, or grant to another candidate."""
        if self._silent_until < 0:
            self._silent_until = tick + self._lease
        fresh = self._fresh(tick)
        leader = self._leader(fresh, tick)
        wanted = leader if leader in fresh else min(fresh)
        if tick >= self._silent_until and (wanted == self._candidate or tick >= self._until):
            self._candidate = wanted
            self._until = max(self._until, fresh[wanted].made + self._lease)

    def _fresh(self, tick: int) -> dict[int, _Record]:
        """The records of the last lease, by vehicle, its own included."""
        own = _Record(tick, self._candidate, self._until)
        others = {i: record for i, record in self._others.items() if tick < record.made + self._lease}
        return {self._id: own, **others}

    def _leader(self, fresh: dict[int, _Record], tick: int) -> int:
        """The candidate with the leases of more than half of the voters, as far as this vehicle knows."""
        votes = Counter(record.candidate for record in fresh.values() if tick < record.until)
        voters = self._vehicles if self._of_fleet else len(fresh)
        return next((i for i, count in votes.items() if i != NOBODY and 2 * count > voters), NOBODY)

    def _leads_until(self, fresh: dict[int, _Record]) -> int:
        """The end of its leadership, as a tick, if it hears nothing more. It leads now."""
        grants = sorted(record.until for record in fresh.values() if record.candidate == self._id)
        others = sorted(record.made + self._lease for i, record in fresh.items() if i != self._id)

        def leads_at(tick: int) -> bool:
            voters = self._vehicles if self._of_fleet else 1 + len(others) - bisect_right(others, tick)
            return 2 * (len(grants) - bisect_right(grants, tick)) > voters

        return next(end for end in grants if not leads_at(end))  # the lead ends at the latest with the last grant

    def _is_valid(self, values: Any, delivery: Delivery) -> bool:
        """Whether these are records of vehicles of this fleet, made by now, that grant for a lease at most.

        Three clocks matter: of the vehicle that passes a record on, of its maker, and of the maker's candidate. Each
        may be ahead of the one before, by a lease at most. Without that allowance drawn drifts of 10,000 ppm broke the
        election.
        """
        return (
            isinstance(values, list)
            and len(values) <= self._vehicles
            and all(isinstance(record, list) and len(record) == 4 for record in values)
            and all(
                is_count(i, self._vehicles)
                and i != NOBODY
                and is_count(made, delivery.sent_tick + self._lease)  # the maker's clock may be ahead of the sender's
                and is_count(candidate, self._vehicles)
                and is_count(until, made + 2 * self._lease)  # the candidate's clock may be ahead of the maker's
                for i, made, candidate, until in values
            )
        )
