"""Draws of episodes. An episode has a few faults in the protocol's own unit of time, and then time to recover.

| what | how it is drawn |
|---|---|
| episode | three units with faults and three without, one to four times in a run |
| kinds | each is on in a run with probability 1/2; if none is, one of them |
| faults | one (30 %), two (40 %) or three (30 %) in an episode |
| begin | in one of the three units, on its eighths; or when the fault before begins or ends |
| length | one round, half a unit, a unit less or more one round, two or three units; at most to the end of the three |
| target | one vehicle, a minority, a majority, all but one; a side of the last partition, perhaps but for one vehicle |
| | or with one more; those of the fault before |

In the last episode of a run every fourth partition and kill lasts to the end of the run; but kills leave one vehicle
that lives, or is started again. If partitions may be drawn, in
a third of the episodes all faults cut off one vehicle each. For these the chance of a pattern is known (`chance`): its
faults, in any order, must get the right vehicles and units. (C. Dragoi and others, "Testing consensus implementations
using communication closure", OOPSLA 2020, has the bound for a uniform choice of process and round.)

Another third are *splits*: half of the fleet is cut off from the others. In 60 % of the splits a vehicle changes sides
within a unit. In 75 % of these a short fault of another kind befalls this vehicle at that moment. In all other splits
a fault of another kind begins within a unit of the last partition. Its target is the vehicle that changed sides, one
vehicle of the half, any vehicle, or the whole half.

With `watch` a fault in three waits until an agent reports something else in one of these signals, or more than a
number (`control.leads above 0`): its target is then this agent, or all others. It waits for a unit at most, and lasts a
unit at most.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from math import factorial
from typing import Any, NamedTuple

from fleet.quantities import show_time
from fleet.scenario.faults.partitions import partition
from fleet.scenario.schema.control import AgentSection
from fleet.scenario.schema.faults import FaultSection, TriggerSection
from fleet.scenario.schema.nemesis import NemesisSection
from fleet.scenario.sections.nemesis_targets import NemesisTargets, free_name
from netem.draws import bits, uniform

PURPOSE = "nemesis episodes"
UNITS, QUIET = 3, 3  # units of an episode with faults, and then without
MOST_EPISODES = 4
MOST_FAULTS = 3  # faults in one episode
SHARES = {1: 0.3, 2: 0.4, 3: 0.3}  # number of faults: share of the episodes
_FOR_GOOD = ("partition", "kill")  # kinds that may last to the end of the run
KINDS = ("partition", "kill", "pause", "mute", "deaf", "hold", "duplicate")
PARAMETERS = ("lease_s", "forget_after_s", "silence_s")  # of agents: after such a time something is over
_ROUNDS = 10  # length of a unit if no parameter states one
_ISOLATED = 1.0 / 3.0  # share of the episodes in which each fault cuts off one vehicle
_SPLIT = 1.0 / 3.0  # share of the episodes in which the fleet is in two halves
_MOVING = 0.6  # share of the splits in which a vehicle changes sides
_AT_ONCE = 0.75  # share of these in which something befalls it at that moment: three right faults are the rarest
_ON, _COUNT, _ISOLATES, _KIND, _UNIT, _EIGHTH, _LENGTH, _TARGET, _WHO, _FORM = range(10)
_GOOD, _WATCH, _WAIT, _NTH, _THEN, _MOVES = range(10, 16)
_LINK = _WAIT  # whatever waits has links of its own
_PURPOSES = 16
_OF_EPISODE = 10  # numbers of draws that an episode may use


class EpisodePlan(NamedTuple):
    """When the episodes of a run are [ns]."""

    unit: int
    origin: str  # what states the unit
    begins: tuple[int, ...]


def unit(nemesis: NemesisSection, targets: NemesisTargets) -> tuple[int, str]:
    """The protocol's unit of time [ns], in whole rounds, and what states it."""
    spec, round_ns = targets.spec, targets.round_ns
    found, origin = _ROUNDS * round_ns, f"{_ROUNDS} rounds"
    parameters = spec.agent.parameters if isinstance(spec.agent, AgentSection) else None
    if nemesis.unit is not None:
        found, origin = nemesis.unit, "nemesis.unit"
    elif key := next((key for key in PARAMETERS if isinstance((parameters or {}).get(key), int | float)), ""):
        found, origin = round(float((parameters or {})[key]) * 1e9), f"agent.parameters.{key}"
    elif spec.neighbours.drop_after:
        found, origin = spec.neighbours.drop_after, "neighbours.drop_after"
    return max(2, round(found / round_ns)) * round_ns, origin


def plan(nemesis: NemesisSection, targets: NemesisTargets) -> EpisodePlan:
    """The episodes of a run; none if there is no room for one."""
    length, origin = unit(nemesis, targets)
    start = length if nemesis.start is None else nemesis.start
    until = targets.spec.duration if nemesis.until is None else min(nemesis.until, targets.spec.duration)
    count = min(MOST_EPISODES, (until - start) // ((UNITS + QUIET) * length))
    tick = targets.spec.tick
    apart = (until - start) // count // tick * tick if count > 0 else 0
    return EpisodePlan(length, origin, tuple(start + number * apart for number in range(count)))


def chance(isolations: int, vehicles: int, episodes: int) -> float:
    """The probability that some of these episodes cut off given vehicles, each in a given unit; no two are equal."""
    one = _ISOLATED * SHARES[isolations] * factorial(isolations) / (vehicles * UNITS) ** isolations
    return float(1.0 - (1.0 - one) ** episodes)


def draw(nemesis: NemesisSection, targets: NemesisTargets) -> tuple[list[FaultSection], list[TriggerSection]]:
    """The faults that the scenario's seed draws, in order of time; and those that wait for a report."""
    work = _draw_all(nemesis, targets)
    return sorted(work.faults, key=lambda fault: fault.at), work.triggers


def count_episodes(
    nemesis: NemesisSection, targets: NemesisTargets, seeds: Iterable[int]
) -> tuple[Counter[str], Counter[str]]:
    """How many episodes of each kind and how many faults of each kind some seeds draw."""
    of_episodes, of_faults = Counter[str](), Counter[str]()
    for seed in seeds:
        work = _draw_all(nemesis, targets._replace(spec=targets.spec.model_copy(update={"seed": seed})))
        of_episodes += work.of_episodes
        of_faults += work.of_faults
    return of_episodes, of_faults


def _draw_all(nemesis: NemesisSection, targets: NemesisTargets) -> _Drawn:
    picked = [pick.drawn for pick in nemesis.pick or ()] or KINDS
    among = [kind for kind in picked if kind and (targets.links or kind not in ("partition", "hold", "duplicate"))]
    draws = _Draws(targets.spec.seed)
    kinds = [kind for number, kind in enumerate(among) if draws.share(number, _ON) < 0.5]
    kinds = kinds or [among[draws.among(len(among), -1, _ON)]] * bool(among)
    planned = plan(nemesis, targets)
    work = _Drawn(nemesis, targets, draws, planned.unit, isolates="partition" in among)
    for number, begin in enumerate(planned.begins if kinds else ()):
        work.episode(number, begin, kinds, last=number == len(planned.begins) - 1)
    return work


class _Draws(NamedTuple):
    seed: int

    def share(self, number: int, what: int) -> float:
        return uniform(self.seed, PURPOSE, number, what)

    def among(self, count: int, number: int, what: int) -> int:
        return bits(self.seed, PURPOSE, number, what) % count


class _Drawn:
    """The faults drawn so far."""

    def __init__(
        self, nemesis: NemesisSection, targets: NemesisTargets, draws: _Draws, unit_ns: int, *, isolates: bool
    ) -> None:
        self._isolates = isolates
        self._nemesis, self.targets, self._draws, self._unit = nemesis, targets, draws, unit_ns
        self._taken = {fault.id for fault in targets.spec.faults} | {one.id for one in targets.spec.triggers}
        self._gone = set[int]()  # vehicles that a kill ends for good
        self.faults: list[FaultSection] = []
        self.triggers: list[TriggerSection] = []
        self.of_episodes, self.of_faults = Counter[str](), Counter[str]()  # how many of each kind

    def episode(self, number: int, begin: int, kinds: list[str], *, last: bool) -> None:
        """Draw the faults of an episode that begins at a time [ns]."""
        draws, first = self._draws, number * _OF_EPISODE
        x, count = draws.share(first, _COUNT), 1
        while count < MOST_FAULTS and x >= sum(SHARES[n] for n in range(1, count + 1)):
            count += 1
        isolates = draws.share(first, _ISOLATES) < _ISOLATED and self._isolates
        splits = self._isolates and not isolates and draws.share(first, _ISOLATES) < _ISOLATED + _SPLIT
        self.of_episodes["isolations" if isolates else "splits" if splits else "mixed"] += 1
        if splits:
            self._split(first, begin, [kind for kind in kinds if kind != "partition"])
            return
        side: list[int] = []  # one side of the partition that was drawn last
        before: list[int] = []  # the target of the fault before
        times = begin, begin  # begin and end of the fault before
        for k in range(first, first + count):
            kind = "partition" if isolates else kinds[draws.among(len(kinds), k, _KIND)]
            at = self._after(begin, 8 * draws.among(UNITS, k, _UNIT) + draws.among(8, k, _EIGHTH))
            if k > first and not isolates and draws.share(k, _THEN) < 0.5:
                at = max(begin, times[draws.among(2, k, _THEN)] // self.targets.round_ns * self.targets.round_ns)
            at = min(at, begin + UNITS * self._unit - self.targets.round_ns)
            length = self._length(k, begin + UNITS * self._unit - at)
            for_good = last and not isolates and kind in _FOR_GOOD and draws.share(k, _GOOD) < 0.25
            lasts = None if for_good else length
            waits = self._nemesis.watch and self.targets.spec.vehicles > 1 and not isolates
            if waits and draws.share(k, _WATCH) < 1.0 / 3.0:
                self._wait(k, kind, at, begin, lasts)
                continue
            who = [1 + draws.among(self.targets.spec.vehicles, k, _WHO)] if isolates else self._target(k, side, before)
            if for_good and kind == "kill":
                gone = self._gone | {*who}
                if len(gone) < self.targets.spec.vehicles:
                    self._gone = gone
                else:  # nobody would be left to judge
                    lasts = length
            times = at, at + (lasts or 0)
            if kind == "partition":
                side = who
            before = who
            self._add(k, self._body(k, kind, who), at, lasts)

    def _split(self, k: int, begin: int, kinds: list[str]) -> None:
        """Draw an episode that cuts off half of the fleet from the others."""
        draws, n, end = self._draws, self.targets.spec.vehicles, begin + UNITS * self._unit
        drawn = self._shuffled(k)
        side, who = sorted(drawn[: max(1, n // 2)]), drawn[draws.among(n, k, _NTH)]
        at, moved = self._after(begin, draws.among(8, k, _EIGHTH)), sorted({*side} ^ {who})
        moves = 0 < len(moved) < n and draws.share(k, _MOVES) < _MOVING
        if moves:
            lasts = max(self.targets.round_ns, self._after(0, 1 + draws.among(8, k, _UNIT)))
        else:
            lasts = end - at if draws.share(k, _GOOD) < 0.5 else self._length(k, end - at)
        self._add(k, self._body(k, "partition", side), at, lasts)
        if moves:
            at, k, side = at + lasts, k + 1, moved
            self._add(k, self._body(k, "partition", side), at, end - at)
        if not kinds:
            return
        k += 1
        kind = kinds[draws.among(len(kinds), k, _KIND)]
        if moves and draws.share(k, _THEN) < _AT_ONCE:
            # Not a round later: by then it has told the other side what it knew, so its empty memory does no harm.
            target = [who]
            lasts = min(max(self.targets.round_ns, self._after(0, 4 * draws.among(2, k, _LENGTH))), end - at)
        else:
            at = min(self._after(at, draws.among(8, k, _EIGHTH)), end - self.targets.round_ns)
            target = ([who] if moves else drawn[:1], drawn[:1], [who], side)[draws.among(4, k, _TARGET)]
            lasts = self._length(k, end - at)
        self._add(k, self._body(k, kind, target), at, lasts)

    def _after(self, begin: int, eighths: int) -> int:
        """The time some eighths of a unit after another one [ns], in whole ticks."""
        tick = self.targets.spec.tick
        return begin + eighths * self._unit // 8 // tick * tick

    def _shuffled(self, k: int) -> list[int]:
        """All vehicles, in a random order."""

        def place(i: int) -> tuple[float, int]:
            hundreds, rest = divmod(i - 1, 100)  # a number has room for a hundred vehicles
            return self._draws.share(100 * k + rest + 1, _WHO + _PURPOSES * hundreds), i

        return sorted(range(1, self.targets.spec.vehicles + 1), key=place)

    def _length(self, k: int, most: int) -> int:
        round_ns, whole = self.targets.round_ns, self._unit
        lengths = (round_ns, whole // 2, whole - round_ns, whole + round_ns, 2 * whole, 3 * whole)
        tick = self.targets.spec.tick
        return max(round_ns, min(lengths[self._draws.among(len(lengths), k, _LENGTH)], most) // tick * tick)

    def _target(self, k: int, side: list[int], before: list[int]) -> list[int]:
        """The vehicles of a fault. `side`: of the partition before it; `before`: of the fault before it."""
        draws, n, drawn = self._draws, self.targets.spec.vehicles, self._shuffled(k)
        some = [drawn[:1], drawn[:1], drawn[: max(1, (n - 1) // 2)], drawn[: n // 2 + 1], drawn[: max(1, n - 1)]]
        some += [one for one in (side, before) if one]
        if side:  # one vehicle changes sides
            some.append(sorted({*side} ^ {drawn[0]}) or side)
        return sorted(some[draws.among(len(some), k, _TARGET)])

    def _body(self, k: int, kind: str, who: list[int]) -> dict[str, Any]:
        """The fault of a kind with these vehicles."""
        spec, links = self.targets.spec, self.targets.links
        numbers = ",".join(map(str, who))
        match kind:
            case "partition":
                rest = ",".join(str(i) for i in range(1, spec.vehicles + 1) if i not in who)
                text = f"{numbers} / {rest}" if rest else f"isolate:{who[0]}"
                return {
                    kind: text if partition(text, spec.vehicles, spec.seed, "", links) else f"isolate:{links[0][0]}"
                }
            case "hold" | "duplicate":
                form = self._draws.among(8, k, _FORM)
                selector = self._links_of(k, who[self._draws.among(len(who), k, _NTH)], form)
                if kind == "duplicate":
                    return {kind: {"links": selector, "after": f"{self._unit} ns"}}
                return {kind: {"links": selector, "order": "reversed" if form & 2 else "sent"}}
        return {kind: numbers}

    def _links_of(self, k: int, one: int, form: int) -> str:
        """A selector of links of vehicle `one`. It selects all that go out, all that come in, or one of these."""
        links = self.targets.links
        out, into = [link for link in links if link[0] == one], [link for link in links if link[1] == one]
        if not (out or into):
            return "*"
        goes_out = bool(out) and (form & 1 or not into)
        if form & 4:
            some = out if goes_out else into
            src, dst = some[self._draws.among(len(some), k, _LINK)]
            return f"{src}->{dst}"
        return f"{one}->*" if goes_out else f"*->{one}"

    def _add(self, k: int, body: dict[str, Any], at: int, lasts: int | None) -> None:
        self.of_faults.update(body.keys())
        times = {"at": f"{at} ns"} | ({} if lasts is None else {"for": f"{lasts} ns"})
        self.faults.append(FaultSection.model_validate({"id": self._name(k), **times, **body}))

    def _wait(self, k: int, kind: str, at: int, begin: int, lasts: int | None) -> None:
        """A fault that waits a unit for a report, and is over when the episode has two quiet units left."""
        draws, round_ns, topics = self._draws, self.targets.round_ns, self._nemesis.watch or []
        form = draws.among(4, k, _FORM)
        who = "others" if form == 3 and kind != "partition" else "itself"
        self.of_faults[kind] += 1
        fault: dict[str, Any] = {kind: who}
        if kind == "partition":
            fault = {kind: "itself / others"}
        elif kind in ("hold", "duplicate"):
            links = ("itself->*", "*->itself")[form % 2]
            fault = {kind: {"links": links} | ({"after": show_time(self._unit)} if kind == "duplicate" else {})}
        waits, tick = (round_ns, 2 * round_ns, self._unit // 4, self._unit // 2), self.targets.spec.tick
        at = begin + (at - begin) // 2 // tick * tick
        topic, _, above = topics[draws.among(len(topics), k, _WATCH)].partition(" above ")
        moment = {"above": above} if above else {"changes": True}
        times = {"after": show_time(at), "before": show_time(at + self._unit)}
        wait = max(round_ns, waits[draws.among(len(waits), k, _WAIT)] // tick * tick)
        self.triggers.append(
            TriggerSection.model_validate({
                "id": self._name(k), "when": {"topic": topic.strip(), **moment, **times},
                "nth": (1, 1, 2)[draws.among(3, k, _NTH)], "wait": show_time(wait), "fault": fault,
                "for": show_time(min(self._unit, lasts or self._unit)),
            })
        )  # fmt: skip

    def _name(self, k: int) -> str:
        name = free_name(f"nemesis-{k // _OF_EPISODE + 1}-{k % _OF_EPISODE + 1}", self._taken)
        self._taken.add(name)
        return name
