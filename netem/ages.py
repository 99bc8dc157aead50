"""Age of information: per directed link, how old the newest that has arrived is, at every tick.

| symbol | meaning | unit |
|---|---|---|
| t | a tick that was started, from 0 to the end of the run, without it | tick |
| U(t) | newest tick of sending among what the link delivered whole up to t; 0 before there is any | tick |
| Delta(t) | t - U(t), the age | tick |

Delta is the age of S. Kaul, R. Yates, M. Gruteser, "Real-time status: How often should one update?", INFOCOM 2012: a
sawtooth that grows by one per tick and drops when something newer arrives. Three kinds of packet do not lower it: a
late one behind something newer, a copy, and a payload that the link corrupted (the agent refuses it by its CRC). At the
start no vehicle has heard of another, so the age counts from tick 0: a link that never delivers is as old as the run.
It belongs to the link, not to an agent's memory: it also grows at a receiver, or of a sender, that is dead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from netem.cause import Cause
from netem.condition import Link
from netem.wire.messages import Fate


@dataclass(slots=True)
class InformationAge:
    """The age on one link, counted tick by tick, each tooth in closed form.

    The class keeps the edges of a histogram (between two edges every age occurred equally often), and the peaks that no
    later peak reaches. Its memory therefore grows with the number of different ages, not with the length of the run.
    """

    heard: int = 0  # U
    first: int = 0  # ticks before it are not counted
    counted: int = 0  # ticks below it are in what follows
    total: int = 0  # sum of their ages
    edges: Counter[int] = field(default_factory=Counter)  # age: by how many more ticks had it than the age below it
    peaks: list[tuple[int, int]] = field(default_factory=list)  # (tick, age): later, lower

    def hear(self, sent_tick: int, due_tick: int) -> None:
        """Something was delivered; deliveries come in order of `due_tick`."""
        if sent_tick > self.heard:
            self.count(due_tick)
            self.heard = sent_tick

    def count(self, until: int) -> None:
        first, last = self.counted - self.heard, until - 1 - self.heard
        if last < first:
            return
        self.counted = until
        self.total += (first + last) * (last - first + 1) // 2
        self.edges[first] += 1
        self.edges[last + 1] -= 1
        while self.peaks and self.peaks[-1][1] <= last:
            self.peaks.pop()
        self.peaks.append((until - 1, last))

    def oldest(self, after: int = 0) -> tuple[int, int] | None:
        """The largest age of the counted ticks from `after` on, and the last tick that had it."""
        return next(((age, tick) for tick, age in self.peaks if tick >= after), None)


class Ages:
    """The ages on all links, from final fates in the order of the journal."""

    def __init__(self, links: Iterable[Link], *, from_first_packet: bool = False) -> None:
        """Begin at tick 0.

        Args:
            links: all links of the run.
            from_first_packet: the age of a link counts from its first packet, and not from tick 0, because programs of
                others need not send over each link, or from the beginning.
        """
        self.links: dict[Link, InformationAge] = {link: InformationAge() for link in sorted(links)}
        self._silent = set(self.links) if from_first_packet else set()  # links whose age does not count yet

    def settle(self, fate: Fate) -> None:
        """Take a final fate.

        Raises:
            KeyError: it names a link that does not exist.
        """
        if self._silent and (link := (fate.src, fate.dst)) in self._silent:
            self._silent.discard(link)
            self.links[link] = InformationAge(fate.sent_tick, fate.sent_tick, fate.sent_tick)
        if fate.cause == Cause.DELIVERED and not fate.corrupted:
            self.links[fate.src, fate.dst].hear(fate.sent_tick, fate.due_tick)

    def begin(self, tick: int, before: Ages) -> None:
        """Count from a tick on, with the messages that another count had heard by then."""
        for link, age in before.links.items():
            self.links[link] = InformationAge(age.heard, tick, tick)

    def count(self, until: int) -> None:
        """Count the ticks below `until`; every fate that was final before it has been taken."""
        for link, age in self.links.items():
            if link not in self._silent:
                age.count(until)

    @property
    def begun(self) -> list[Link]:
        """The links whose age counts."""
        return [link for link in self.links if link not in self._silent]

    def oldest(self, after: int, links: Iterable[Link]) -> tuple[int, Link, int] | None:
        """Find the largest age.

        Args:
            after: ticks before it do not count.
            links: those that are looked at.

        Returns:
            The age [ticks], its link and the last tick that had it; None if no tick was counted there.
        """
        found: tuple[int, Link, int] | None = None
        for link in links:
            peak = self.links[link].oldest(after)
            if peak is not None and (found is None or peak[0] > found[0]):
                found = peak[0], link, peak[1]
        return found

    def summary(
        self, tick_ns: int, name: Callable[[Link], str] = "{0[0]}->{0[1]}".format
    ) -> dict[str, dict[str, float]]:
        """Mean, 95th percentile and maximum [s] over the counted ticks, per link by `name`, and of all links as `*`."""
        counted = {name(link): age for link, age in self.links.items() if age.counted > age.first}
        if not counted:
            return {}
        rows = {name: _row(age.total, age.counted - age.first, age.edges, tick_ns) for name, age in counted.items()}
        edges: Counter[int] = Counter()
        for age in counted.values():
            edges.update(age.edges)
        total = sum(age.total for age in counted.values())
        ticks = sum(age.counted - age.first for age in counted.values())
        return {"*": _row(total, ticks, edges, tick_ns)} | rows


def _row(total: int, ticks: int, edges: Counter[int], tick_ns: int) -> dict[str, float]:
    return {
        "mean_s": total * tick_ns / ticks / 1e9,
        "p95_s": percentile(edges, ticks, 95) * tick_ns / 1e9,
        "max_s": (max(edges) - 1) * tick_ns / 1e9,
    }


def percentile(edges: Counter[int], ticks: int, percent: int) -> int:
    """The least age that at least `percent` of the ticks did not exceed (the nearest rank)."""
    rank = -(-ticks * percent // 100)
    begin = below = often = 0
    for edge, change in sorted(edges.items()):
        here = (edge - begin) * often
        if below + here >= rank:
            break
        begin, below, often = edge, below + here, often + change
    return begin - 1 - (below - rank) // often
