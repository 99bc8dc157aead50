"""A swarm of faults: the seed draws the kinds that are on, and the beginning, length, strength and target of each
fault.

`draw` gives faults as a nemesis thinks of them, `to_sections` gives them as a scenario writes them. Between the two
they can be changed: shifted, stretched, aimed elsewhere, strengthened, left out. Each draw is a function of (seed,
number of the fault, what is drawn), so a change of one fault changes no other draw.

* Kinds: each is on with probability 1/2; if none is, one of them. (A. Groce et al., "Swarm testing", ISSTA 2012: to
  leave features out finds more than to have all of them in every test.)
* Beginnings: a Poisson process. Its mean is drawn, too, from a twentieth to a half of the time that there is.
* Length: log-uniform, from one round to half of the run. It is at most 5 s if the vehicle goes on with its last command
meanwhile, because with any protocol the vehicle may tumble then.
* Flapping is one more kind: if it is on, every third fault comes and goes two to eight times within its length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import log
from typing import Any, NamedTuple

from fleet.scenario.faults.kind import FleetFaultKind, LinkFaultKind, Strength, interpolate
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.faults.of_links import DownFault, PartitionFault
from fleet.scenario.faults.partitions import DRAWN_PARTITIONS, partition
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.schema.nemesis import CONDITIONS, Aim, NemesisPick, NemesisSection
from fleet.scenario.sections.graph import neighbours, reachable
from fleet.scenario.sections.nemesis_targets import (
    NemesisTargets,
    Pair,
    available,
    bridges,
    free_name,
    hubs,
    last_slot,
    leader,
    remaining_pairs,
)
from netem.condition import Condition
from netem.draws import bits, uniform
from netem.grammar import print_condition
from netem.link_selector import Selector, select

PURPOSE = "nemesis swarm"
MOST = 5000  # faults that are drawn
MOST_CONDITIONS = 16  # links that keep their own condition below a fault; of more links it has one for all
_MOST_HELD_NS = 5_000_000_000
_NETWORK = ("partition", "down", "loss", "delay", "rate", "mute", "deaf", "slow", "pause", "kill")
_IDEAL = ("freeze", "off", "stuck", "bias", "noise", "dropout")
_ON, _MEAN, _GAP, _LENGTH, _KIND, _AIM, _STRENGTH, _FLAP, _PIECES, _TARGET, _TURN, _FORM = range(12)  # what is drawn


class DrawnFault(NamedTuple):
    """A fault before it has a target."""

    number: int  # from 1; what is drawn of its target goes by it
    pick: NemesisPick  # the kind of the fault, or the fault as the scenario gives it
    at: int  # ns
    lasts: int  # ns
    aim: Aim = "any"
    strength: float = 0.5  # 0 is mild, 1 is strong
    pieces: int = 1  # more: it flaps, and comes so often within its time


def picks_of(nemesis: NemesisSection, targets: NemesisTargets) -> list[NemesisPick]:
    """The kinds that may be drawn: the given ones, or every kind that fits the scenario.

    A fleet without links keeps its own.
    """
    if nemesis.pick is not None:
        kinds = nemesis.pick
    else:
        names = list(_IDEAL if targets.spec.network.ideal else _NETWORK)
        names += ["clock"] * bool(targets.clocks) + ["dvl", "compass"] * bool(targets.navigators)
        names += ["fix"] * bool(targets.fixed)
        kinds = [NemesisPick.model_validate({"drawn": name}) for name in names]
    return [pick for pick in kinds if targets.links or not of_links(pick)]


def of_links(pick: NemesisPick) -> bool:
    """Whether a pick by name needs links."""
    return pick.drawn in CONDITIONS or isinstance(KINDS.get(pick.drawn or ""), LinkFaultKind | PartitionFault)


def span(nemesis: NemesisSection, targets: NemesisTargets) -> tuple[int, int]:
    """From when on faults begin, and when the last has ended [ns]."""
    duration, tick = targets.spec.duration, targets.spec.tick
    until = 3 * duration // 4 // tick * tick if nemesis.until is None else min(nemesis.until, duration)
    return nemesis.start or 0, until


def draw(nemesis: NemesisSection, targets: NemesisTargets, until: int | None = None) -> list[DrawnFault]:
    """The faults that the scenario's seed draws, in order of time.

    `until`: when all have ended [ns]; None: as the nemesis says.
    """
    seed, tick = targets.spec.seed, targets.spec.tick
    picks = picks_of(nemesis, targets)
    on = [pick for k, pick in enumerate(picks) if uniform(seed, PURPOSE, k, _ON) < 0.5]
    if not on and picks:
        on = [picks[bits(seed, PURPOSE, -1, _ON) % len(picks)]]
    flaps = uniform(seed, PURPOSE, -2, _ON) < 0.5
    start, end = span(nemesis, targets)
    end = end if until is None else until
    mean = nemesis.mean or (end - start) / 20.0 * 10.0 ** uniform(seed, PURPOSE, 0, _MEAN)
    wanted, offered = nemesis.aims, available(targets)
    aimed = [aim for aim in offered if wanted is None or aim in wanted] or ["any"]
    faults: list[DrawnFault] = []
    at, number = float(start), 0
    while on and number <= MOST:
        number += 1
        at -= mean * log(1.0 - uniform(seed, PURPOSE, number, _GAP))
        begin = int(at) // tick * tick
        least = max(tick, min(targets.round_ns, end - begin))
        if begin + least > end:
            break
        longest = max(targets.spec.duration / 2.0, least)
        lasts = least * (longest / least) ** uniform(seed, PURPOSE, number, _LENGTH)
        pick = on[bits(seed, PURPOSE, number, _KIND) % len(on)]
        kind = KINDS.get(pick.drawn or "")
        most = end - begin if kind is None or not kind.holds_command else max(least, _MOST_HELD_NS // tick * tick)
        faults.append(
            DrawnFault(
                number,
                pick,
                begin,
                min(max(least, int(lasts) // tick * tick), most, end - begin),
                aimed[bits(seed, PURPOSE, number, _AIM) % len(aimed)],
                uniform(seed, PURPOSE, number, _STRENGTH),
                2 + bits(seed, PURPOSE, number, _PIECES) % 7
                if flaps and uniform(seed, PURPOSE, number, _FLAP) < 1.0 / 3.0
                else 1,
            )
        )
    return faults


def to_sections(drawn: Iterable[DrawnFault], targets: NemesisTargets) -> list[FaultSection]:
    """The faults of a scenario that some drawn ones are, in order of time; aims look at those before them.

    A fault that finds no target, such as a bridge where nothing is one, is drawn at any.
    """
    taken = {fault.id for fault in targets.spec.faults}
    faults: list[FaultSection] = []
    past = _Past(targets)
    for one in sorted(drawn, key=lambda fault: (fault.at, fault.number)):
        pieces = list(_times(one, targets))
        body, cut, silent = _body(one, pieces[0][1], targets, past)
        for piece, (at, lasts) in enumerate(pieces, start=1):
            name = free_name(f"nemesis-{one.number}" + (f"-{piece}" if one.pieces > 1 else ""), taken)
            taken.add(name)
            faults.append(FaultSection.model_validate({"id": name, "at": f"{at} ns", "for": f"{lasts} ns", **body}))
        past.add(one, cut, silent)
    return sorted(faults, key=lambda fault: fault.at)


def _times(one: DrawnFault, targets: NemesisTargets) -> Iterator[tuple[int, int]]:
    """When each piece of a fault begins, and their common length [ns]: a round or more, as the pause behind each."""
    pieces = min(one.pieces, max(1, (one.lasts // targets.round_ns + 1) // 2))
    length = one.lasts // (2 * pieces - 1) // targets.spec.tick * targets.spec.tick
    for piece in range(pieces):
        yield one.at + 2 * piece * length, length


class _Past:
    """The links and vehicles that the faults written by now have cut and silenced."""

    def __init__(self, targets: NemesisTargets) -> None:
        self.pairs = targets.pairs
        self._cut: list[tuple[int, set[Pair]]] = []  # until when, which
        self._silent: list[tuple[int, int]] = []  # until when, who

    def add(self, one: DrawnFault, cut: set[Pair], silent: set[int]) -> None:
        end = one.at + one.lasts
        self._cut += [(end, cut)] if cut else []
        self._silent += [(end, i) for i in sorted(silent)]

    def remaining_pairs(self, at: int) -> frozenset[Pair]:
        """The pairs that no fault cuts or silences at a time."""
        cut = {pair for end, pairs in self._cut if end > at for pair in pairs}
        return remaining_pairs(self.pairs, cut, {i for end, i in self._silent if end > at})

    def speaker(self, at: int) -> int | None:
        """The vehicle that began to speak last after a silence; None: no vehicle was silent."""
        back = [(end, i) for end, i in self._silent if end <= at]
        return max(back)[1] if back else None


def _body(
    one: DrawnFault, lasts: int, targets: NemesisTargets, past: _Past
) -> tuple[dict[str, Any], set[Pair], set[int]]:
    """The body of a fault with its length [ns], the pairs that it cuts, and the vehicles that it silences."""
    word = one.pick.drawn
    if word is None:
        return one.pick.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True), set(), set()
    strength = Strength(one.strength, _turn(one, targets), targets.round_ns, targets.spec.tick, lasts)
    if word in CONDITIONS:
        return {"link": link_fault(word, _links(one, targets, past), targets, strength)}, set(), set()
    kind, cut, silent = KINDS[word], set[Pair](), set[int]()
    match kind:
        case PartitionFault():
            target = _partition(one, targets, past)
            name = f"nemesis-{one.number}"
            links = partition(target, targets.spec.vehicles, targets.spec.seed, name, targets.links)
            cut = {(min(link), max(link)) for link in links}
        case LinkFaultKind():
            selector = _links(one, targets, past)
            target = str(selector)
            if isinstance(kind, DownFault):
                cut = {(min(link), max(link)) for link in select(selector, targets.links)}
        case FleetFaultKind():
            target = ""
        case _:
            who = _vehicle(one, targets, past)
            target, silent = str(who), {who} if kind.silences else silent
    return {word: kind.of_strength(target, strength)}, cut, silent


def _turn(one: DrawnFault, targets: NemesisTargets) -> float:
    return uniform(targets.spec.seed, PURPOSE, one.number, _TURN)


def _choose(one: DrawnFault, targets: NemesisTargets, what: int, count: int) -> int:
    return bits(targets.spec.seed, PURPOSE, one.number, what) % count


def _aimed_vehicle(one: DrawnFault, targets: NemesisTargets, past: _Past) -> int | None:
    """The vehicle that a fault is aimed at; None: any."""
    match one.aim:
        case "leader":
            return leader(targets)
        case "hub":
            most = hubs(targets)
            return most[_choose(one, targets, _TARGET, len(most))]
        case "speaker":
            return past.speaker(one.at) or last_slot(targets)
    return None


def _bridge(one: DrawnFault, targets: NemesisTargets, past: _Past) -> Pair | None:
    found = bridges(past.remaining_pairs(one.at)) if one.aim == "bridge" else ()
    return found[_choose(one, targets, _TARGET, len(found))] if found else None


def _vehicle(one: DrawnFault, targets: NemesisTargets, past: _Past) -> int:
    """The vehicle of a fault, among those with the part that the fault breaks."""
    has = {"clock": targets.clocks, "dead reckoning": targets.navigators, "fixes": targets.fixed}
    some = has.get(KINDS[one.pick.drawn or ""].needs) or tuple(range(1, targets.spec.vehicles + 1))
    who = _aimed_vehicle(one, targets, past)
    if who is None and (pair := _bridge(one, targets, past)) is not None:
        who = pair[_choose(one, targets, _FORM, 2)]
    return who if who in some else some[_choose(one, targets, _TARGET, len(some))]


def _links(one: DrawnFault, targets: NemesisTargets, past: _Past) -> Selector:
    """The links of a fault: both links of a pair, one of them, all links of a vehicle, or all links."""
    form = _choose(one, targets, _FORM, 4)
    who = _aimed_vehicle(one, targets, past)
    if who is not None and any(who in link for link in targets.links):
        ways = [Selector(who, None), Selector(None, who), Selector(None, who, both=True)]
        there = [way for way in ways if select(way, targets.links)]
        return there[form % len(there)]
    if one.aim == "any" and form == 3 and one.pick.drawn != "down":
        return Selector(None, None)
    pair = _bridge(one, targets, past) or past.pairs[_choose(one, targets, _TARGET, len(past.pairs))]
    if form == 0 and one.aim == "any":
        ways = [Selector(*link) for link in (pair, pair[::-1]) if link in targets.links]
        return ways[_choose(one, targets, _TURN, len(ways))]
    return Selector(*pair, both=True)


def _partition(one: DrawnFault, targets: NemesisTargets, past: _Past) -> str:
    """The partition of a fault, as a scenario writes it; it cuts a link."""
    spec, name = targets.spec, f"nemesis-{one.number}"
    who = _aimed_vehicle(one, targets, past)
    if who is not None and any(who in link for link in targets.links):
        return f"isolate:{who}"
    if (pair := _bridge(one, targets, past)) is not None:
        there = reachable([pair[0]], neighbours(past.remaining_pairs(one.at) - {pair}))
        rest = [i for i in range(1, spec.vehicles + 1) if i not in there]
        if rest:
            return " / ".join(",".join(map(str, group)) for group in (sorted(there), rest))
    among = ("halves",) if one.pieces > 1 else ("halves", *DRAWN_PARTITIONS)  # each piece would cut something else
    ways = [way for way in among if partition(way, spec.vehicles, spec.seed, name, targets.links)]
    return ways[_choose(one, targets, _TARGET, len(ways))] if ways else f"isolate:{targets.links[0][0]}"


def condition(kind: str, own: Condition, strength: Strength) -> Condition:
    """The condition of a link with a fault of loss, delay or rate over its own.

    Its strength is one number from 0 (mild) to 1 (strong), on a logarithmic scale; the other kinds of faults have
    their own scale in `fleet.scenario.faults`.

    | condition | from | to |
    |---|---|---|
    | loss | 5 % | 100 %, over the link's own condition |
    | delay | a fifth of a round | 50 rounds more, with a quarter of it as jitter |
    | rate | 20 kbit/s | 200 bit/s |
    """
    match kind:
        case "loss":
            return replace(own, loss=max(own.loss, strength.between(0.05, 1.0)), loss_model=None)
        case "delay":
            late = strength.later_ns
            return replace(own, delay_ns=own.delay_ns + late, jitter_ns=max(own.jitter_ns, late // 4))
    rate = round(interpolate(200.0, 20_000.0, 1.0 - strength.size))
    return replace(own, rate_bit_s=min(own.rate_bit_s or rate, rate))


def link_fault(kind: str, selector: Selector, targets: NemesisTargets, strength: Strength) -> dict[str, str]:
    """A fault of links: each over the link's own condition, where that is one and the links are few."""
    links = select(selector, targets.links)
    each = {link: condition(kind, targets.conditions.get(link, Condition()), strength) for link in links}
    if len(set(each.values())) == 1:
        return {str(selector): print_condition(next(iter(each.values())))}
    if len(each) <= MOST_CONDITIONS:
        return {f"{a}->{b}": print_condition(one) for (a, b), one in each.items()}
    return {str(selector): print_condition(condition(kind, Condition(), strength))}
