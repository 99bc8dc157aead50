"""A swarm of faults: the seed draws the kinds that are on, and the beginning, length, strength and target of each
fault.

`draw` gives faults as a nemesis thinks of them, `written` gives them as a scenario writes them. Between the two they
can be changed: shifted, stretched, aimed elsewhere, strengthened, left out. Each draw is a function of (seed, number of
the fault, what is drawn), so a change of one fault changes no other draw.

* Kinds: each is on with probability 1/2; if none is, one of them. (A. Groce et al., "Swarm testing", ISSTA 2012: to
  leave features out finds more than to have all of them in every test.)
* Beginnings: a Poisson process. Its mean is drawn, too, from a twentieth to a half of the time that there is.
* Length: log-uniform, from one round to half of the run. It is at most 5 s if the vehicle goes on with its last command
meanwhile, because with any protocol the vehicle may tumble then.
* Flapping is one more kind: if it is on, every third fault comes and goes two to eight times within its length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import log
from typing import Any, NamedTuple

from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.schema.nemesis import Aim, NemesisPick, NemesisSection
from fleet.scenario.sections import aims
from fleet.scenario.sections.fault_limits import HELD, MOST_HELD_NS, SILENT
from fleet.scenario.sections.ground import Ground, Pair
from fleet.scenario.sections.partitions import DRAWN_PARTITIONS, partition
from fleet.scenario.sections.strengths import OF_LINKS, gust, link_fault, vehicle_fault
from netem.draws import bits, uniform
from netem.selectors import Selector, select

PURPOSE = "nemesis swarm"  # of the draws
MOST = 5000  # faults that are drawn
_NETWORK = ("partition", "down", "loss", "delay", "rate", "mute", "deaf", "slow", "pause", "kill")
_IDEAL = ("freeze", "off", "stuck", "bias", "noise", "dropout")
_ON, _MEAN, _GAP, _LENGTH, _KIND, _AIM, _STRENGTH, _FLAP, _PIECES, _TARGET, _TURN, _FORM = range(12)  # what is drawn


class DrawnFault(NamedTuple):
    """A fault before it has a target."""

    number: int  # from 1; what is drawn of its target goes by it
    pick: NemesisPick  # its kind, or the fault as the scenario gives it
    at: int  # ns
    lasts: int  # ns
    aim: Aim = "any"
    strength: float = 0.5  # 0 is mild, 1 is strong
    pieces: int = 1  # more: it flaps, and comes so often within its time


def draws(ground: Ground) -> list[str]:
    """The purpose of the draws of a swarm; none if the scenario has no such nemesis."""
    nemesis = ground.spec.nemesis
    return [PURPOSE] if nemesis is not None and nemesis.mode is not None else []


def picks_of(nemesis: NemesisSection, ground: Ground) -> list[NemesisPick]:
    """The kinds that may be drawn: the given ones, or every kind that fits the scenario.

    A fleet without links keeps its own.
    """
    if nemesis.pick is not None:
        kinds = nemesis.pick
    else:
        names = list(_IDEAL if ground.spec.network.ideal else _NETWORK)
        names += ["clock"] * bool(ground.clocks) + ["dvl", "compass"] * bool(ground.navigators)
        names += ["fix"] * bool(ground.fixed)
        kinds = [NemesisPick.model_validate({"drawn": name}) for name in names]
    return [pick for pick in kinds if ground.links or pick.drawn not in ("partition", "down", *OF_LINKS)]


def span(nemesis: NemesisSection, ground: Ground) -> tuple[int, int]:
    """From when on faults begin, and when the last has ended [ns]."""
    duration, tick = ground.spec.duration, ground.spec.tick
    until = 3 * duration // 4 // tick * tick if nemesis.until is None else min(nemesis.until, duration)
    return nemesis.start or 0, until


def draw(nemesis: NemesisSection, ground: Ground, until: int | None = None) -> list[DrawnFault]:
    """The faults that the scenario's seed draws, in order of time.

    Args:
        until: when all have ended [ns]; None: as the nemesis says.
    """
    seed, tick = ground.spec.seed, ground.spec.tick
    picks = picks_of(nemesis, ground)
    on = [pick for k, pick in enumerate(picks) if uniform(seed, PURPOSE, k, _ON) < 0.5]
    if not on and picks:
        on = [picks[bits(seed, PURPOSE, -1, _ON) % len(picks)]]
    flaps = uniform(seed, PURPOSE, -2, _ON) < 0.5
    start, end = span(nemesis, ground)
    end = end if until is None else until
    mean = nemesis.mean or (end - start) / 20.0 * 10.0 ** uniform(seed, PURPOSE, 0, _MEAN)
    wanted, offered = nemesis.aims, aims.available(ground)
    aimed = [aim for aim in offered if wanted is None or aim in wanted] or ["any"]
    faults: list[DrawnFault] = []
    at, number = float(start), 0
    while on and number <= MOST:
        number += 1
        at -= mean * log(1.0 - uniform(seed, PURPOSE, number, _GAP))
        begin = int(at) // tick * tick
        least = max(tick, min(ground.round_ns, end - begin))
        if begin + least > end:
            break
        longest = max(ground.spec.duration / 2.0, least)
        lasts = least * (longest / least) ** uniform(seed, PURPOSE, number, _LENGTH)
        pick = on[bits(seed, PURPOSE, number, _KIND) % len(on)]
        most = max(least, MOST_HELD_NS // tick * tick) if pick.drawn in HELD else end - begin
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


def written(drawn: Iterable[DrawnFault], ground: Ground) -> list[FaultSection]:
    """The faults of a scenario that some drawn ones are, in order of time; aims look at those before them.

    A fault that finds no target, such as a bridge where nothing is one, is drawn at any.
    """
    taken = {fault.id for fault in ground.spec.faults}
    faults: list[FaultSection] = []
    past = _Past(ground)
    for one in sorted(drawn, key=lambda fault: (fault.at, fault.number)):
        body, cut, silent = _body(one, ground, past)
        for piece, (at, lasts) in enumerate(_times(one, ground), start=1):
            name = f"nemesis-{one.number}" + (f"-{piece}" if one.pieces > 1 else "")
            while name in taken:
                name += "x"
            taken.add(name)
            if one.pick.drawn == "gust":
                body = gust(one.strength, _turn(one, ground), lasts)
            faults.append(FaultSection.model_validate({"id": name, "at": f"{at} ns", "for": f"{lasts} ns", **body}))
        past.add(one, cut, silent)
    return sorted(faults, key=lambda fault: fault.at)


def _times(one: DrawnFault, ground: Ground) -> Iterator[tuple[int, int]]:
    """When each piece of a fault begins, and how long it lasts [ns]: a round or more, as the pause behind it."""
    pieces = min(one.pieces, max(1, (one.lasts // ground.round_ns + 1) // 2))
    length = one.lasts // (2 * pieces - 1) // ground.spec.tick * ground.spec.tick
    for piece in range(pieces):
        yield one.at + 2 * piece * length, length


class _Past:
    """The links and vehicles that the faults written by now have cut and silenced."""

    def __init__(self, ground: Ground) -> None:
        self._pairs = ground.pairs
        self._cut: list[tuple[int, set[Pair]]] = []  # until when, which
        self._silent: list[tuple[int, int]] = []  # until when, who

    def add(self, one: DrawnFault, cut: set[Pair], silent: set[int]) -> None:
        end = one.at + one.lasts
        self._cut += [(end, cut)] if cut else []
        self._silent += [(end, i) for i in sorted(silent)]

    def left(self, at: int) -> frozenset[Pair]:
        """The pairs that no fault cuts or silences at a time."""
        cut = {pair for end, pairs in self._cut if end > at for pair in pairs}
        return aims.without(self._pairs, cut, {i for end, i in self._silent if end > at})

    def speaker(self, at: int) -> int | None:
        """The vehicle that began to speak last after a silence; None: no vehicle was silent."""
        back = [(end, i) for end, i in self._silent if end <= at]
        return max(back)[1] if back else None

    @property
    def pairs(self) -> list[Pair]:
        return self._pairs


def _body(one: DrawnFault, ground: Ground, past: _Past) -> tuple[dict[str, Any], set[Pair], set[int]]:
    """The body of a fault, the pairs that it cuts, and the vehicles that it silences."""
    kind = one.pick.drawn
    if kind is None:
        return one.pick.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True), set(), set()
    if kind == "partition":
        text = _partition(one, ground, past)
        cut = partition(text, ground.spec.vehicles, ground.spec.seed, f"nemesis-{one.number}", ground.links)
        return {kind: text}, {(min(link), max(link)) for link in cut}, set()
    if kind == "down" or kind in OF_LINKS:
        selector = _links(one, ground, past)
        those = select(selector, ground.links)
        if kind == "down":
            return {kind: str(selector)}, {(min(link), max(link)) for link in those}, set()
        return {"link": link_fault(kind, str(selector), those, one.strength, ground)["link"]}, set(), set()
    if kind == "gust":
        return {}, set(), set()
    who = _vehicle(one, ground, past)
    body = vehicle_fault(kind, who, one.strength, _turn(one, ground), ground)
    return body, set(), {who} if kind in SILENT else set()


def _turn(one: DrawnFault, ground: Ground) -> float:
    return uniform(ground.spec.seed, PURPOSE, one.number, _TURN)


def _among(one: DrawnFault, ground: Ground, what: int, count: int) -> int:
    return bits(ground.spec.seed, PURPOSE, one.number, what) % count


def _aimed(one: DrawnFault, ground: Ground, past: _Past) -> int | None:
    """The vehicle that a fault is aimed at; None: any."""
    match one.aim:
        case "leader":
            return aims.leader(ground)
        case "hub":
            hubs = aims.hubs(ground)
            return hubs[_among(one, ground, _TARGET, len(hubs))]
        case "speaker":
            return past.speaker(one.at) or aims.last_slot(ground)
    return None


def _bridge(one: DrawnFault, ground: Ground, past: _Past) -> Pair | None:
    found = aims.bridges(past.left(one.at)) if one.aim == "bridge" else ()
    return found[_among(one, ground, _TARGET, len(found))] if found else None


def _vehicle(one: DrawnFault, ground: Ground, past: _Past) -> int:
    """The vehicle of a fault, among those with the part that the fault breaks."""
    has = {"clock": ground.clocks, "dvl": ground.navigators, "compass": ground.navigators, "fix": ground.fixed}
    some = has.get(one.pick.drawn or "") or tuple(range(1, ground.spec.vehicles + 1))
    who = _aimed(one, ground, past)
    if who is None and (pair := _bridge(one, ground, past)) is not None:
        who = pair[_among(one, ground, _FORM, 2)]
    return who if who in some else some[_among(one, ground, _TARGET, len(some))]


def _links(one: DrawnFault, ground: Ground, past: _Past) -> Selector:
    """The links of a fault: both links of a pair, one of them, all links of a vehicle, or all links."""
    form = _among(one, ground, _FORM, 4)
    who = _aimed(one, ground, past)
    if who is not None and any(who in link for link in ground.links):
        ways = [Selector(who, None), Selector(None, who), Selector(None, who, both=True)]
        there = [way for way in ways if select(way, ground.links)]
        return there[form % len(there)]
    if one.aim == "any" and form == 3 and one.pick.drawn in OF_LINKS:
        return Selector(None, None)
    pair = _bridge(one, ground, past) or past.pairs[_among(one, ground, _TARGET, len(past.pairs))]
    if form == 0 and one.aim == "any":
        ways = [Selector(*link) for link in (pair, pair[::-1]) if link in ground.links]
        return ways[_among(one, ground, _TURN, len(ways))]
    return Selector(*pair, both=True)


def _partition(one: DrawnFault, ground: Ground, past: _Past) -> str:
    """The partition of a fault, as a scenario writes it; it cuts a link."""
    spec, name = ground.spec, f"nemesis-{one.number}"
    who = _aimed(one, ground, past)
    if who is not None and any(who in link for link in ground.links):
        return f"isolate:{who}"
    if (pair := _bridge(one, ground, past)) is not None:
        there = aims.side(pair[0], past.left(one.at) - {pair})
        rest = [i for i in range(1, spec.vehicles + 1) if i not in there]
        if rest:
            return f"{_numbers(sorted(there))} / {_numbers(rest)}"
    among = ("halves",) if one.pieces > 1 else ("halves", *DRAWN_PARTITIONS)  # each piece would cut something else
    ways = [way for way in among if partition(way, spec.vehicles, spec.seed, name, ground.links)]
    return ways[_among(one, ground, _TARGET, len(ways))] if ways else f"isolate:{ground.links[0][0]}"


def _numbers(vehicles: list[int]) -> str:
    return ",".join(map(str, vehicles))
