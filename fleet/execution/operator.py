"""The operator of a running fleet: what `fleet status|inject|heal|clock|stop` and pages ask of the console.

A fault that is injected acts from the first tick on that is not granted yet, so no process has started it. The answer
says which time that is. The fault is logged like a scripted one, so the run can be printed as a scenario and run again.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from math import inf, isfinite
from time import monotonic
from typing import Any, Protocol

from msgspec.structs import asdict
from pydantic import ValidationError

from fleet.analysis.verdicts import standing
from fleet.errors import FleetError
from fleet.execution.clock import LiveClock
from fleet.recorder.journal import Journal
from fleet.recorder.metrics import SETTLE_M, Series
from fleet.recorder.settling import below_from, least_s, stayed
from fleet.scenario.faults.kind import Kill, Part
from fleet.scenario.faults.kinds import OF_ROBOTS
from fleet.scenario.rules.faults import fault_problems
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.sections.node_names import numbered_values
from fleet.scenario.sections.timeline import acts, begin_and_end, parts, with_end, words
from fleet.scenario.sections.triggers import read_entry
from fleet.scenario.sections.vehicle_events import vehicle_events
from netem.clock import Clock
from netem.faults import NetFault
from netem.wire.messages import WorldFault

# --- fault request: one that is to begin in a run that goes on: checked by the rules of scenarios


BROKEN = 3  # the status of a refusal for which the asker can do nothing


class RefusedError(FleetError):
    """A request that cannot be carried out. `status` is 2 when something else should have been asked for, 3 when the
    run cannot do it now.
    """

    def __init__(self, text: str, status: int = 2) -> None:
        super().__init__(text)
        self.status = status


def checked_fault(entry: Any, tick: int, scenario: Scenario) -> FaultSection:
    """The fault that an entry of a scenario's `faults` without `at` describes, beginning at a tick. Raises RefusedError
    if it is none, or none for this scenario; the text says what is wrong.
    """
    if not isinstance(entry, dict) or "at" in entry:
        raise RefusedError("expected a fault without `at`, because it begins now")
    try:
        entry = numbered_values(entry, scenario.nodes)
    except KeyError as error:
        nodes = ", ".join(scenario.nodes)
        raise RefusedError(f"there is no node {error.args[0]}; the nodes are {nodes}") from None
    try:
        section = read_entry(entry | {"at": f"{tick * scenario.tick_ns} ns"})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        said = str(first.get("ctx", {}).get("message", first["msg"]))
        hint = first.get("ctx", {}).get("hint", "")
        where = ".".join(str(step) for step in first["loc"] if step != "[key]")
        raise RefusedError(f"{where}: {said[:1].lower()}{said[1:]}{f'; {hint}' if hint else ''}") from None
    if scenario.nodes and section.kind.name not in OF_ROBOTS:
        raise RefusedError(f"{section.kind.name} concerns vehicles of ours; known: {', '.join(sorted(OF_ROBOTS))}")
    problem = next(fault_problems(section, scenario.spec, scenario.graph.links), None)
    if problem is not None:
        raise RefusedError(str(problem))
    conditions = section.values.values() if section.kind.name == "link" else ()
    if any(condition.seed is not None for condition in conditions):
        raise RefusedError("a seed belongs in a scenario, because a link keeps its draws during a run")
    return section


# --- fleet


class Fleet(Protocol):
    """A running fleet: what an operator asks of it, and changes in it. `Supervisor` and `InProcess` are such fleets."""

    @property
    def granted(self) -> int:
        """The grant: a tick. Earlier ticks may have begun."""

    @property
    def waiting(self) -> str:
        """The processes that the run waits for, in words. Empty: the run moves."""

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        """Replace netem's faults; False: it did not answer, and nothing was changed."""

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        """Replace the world's faults before the first tick that is not granted yet."""

    def without_agent(self) -> list[int]:
        """The vehicles that have no agent now."""

    def end_agents(self, kill: Kill) -> None:
        """End agents because the operator asks for it."""

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        """Start vehicle i's agent again at a tick; it has been missing since tick `begin` (None: whenever)."""


# --- live status: how the vehicles and the links of a live run are doing: what `fleet status` shows of them
# Nothing of it is kept while the run goes on: it is computed when somebody asks, and for the worst rows only.


WORST_VEHICLES, WORST_LINKS = 10, 5
MOST_ROWS = 500  # of each kind in one answer, also when all are asked for


def vehicle_rows(
    scenario: Scenario, journal: Journal, dead: Collection[int], *, every: bool = False
) -> list[dict[str, Any]]:
    """A row for each vehicle; of many, those with the greatest formation errors. In the order of their numbers."""
    series = journal.metrics.series
    worst = sorted((i for i in series if series[i].formation), key=lambda i: -badness(series[i].formation[-1]))
    ages = _oldest(scenario, journal)
    return [
        {
            "vehicle": i,
            "state": _state(i, journal, dead),
            "formation_m": series[i].formation[-1],
            "e_m": series[i].e[-1],
            "settled": _settled(scenario, journal, series[i]),
            "oldest_s": ages[i][0] * scenario.tick_ns / 1e9 if i in ages else None,
            "oldest_of": ages[i][1] if i in ages else None,
        }
        for i in sorted(worst[: MOST_ROWS if every else WORST_VEHICLES])
    ]


def link_rows(scenario: Scenario, journal: Journal, *, every: bool = False) -> list[dict[str, Any]]:
    """A row for each link, the worst ones first: what was heard last is oldest, then the greatest share is lost."""
    rows: list[dict[str, Any]] = []
    now = max(0, journal.written)
    for (src, dst), account in journal.ledger.accounts.items():
        lost = sum(account.lost.values()) - account.replaced
        settled = account.delivered + lost
        age_s = (now - journal.ages.links[src, dst].heard) * scenario.tick_ns / 1e9
        share = lost / settled if settled else 0.0
        counts = {"delivered": account.delivered, "lost": lost, "lost_share": share}
        name = scenario.link_name((src, dst))
        rows.append({"link": name, "src": src, "dst": dst, **counts, "age_s": age_s})
    rows.sort(key=lambda row: (-row["age_s"], -row["lost_share"], row["src"], row["dst"]))
    return rows[: MOST_ROWS if every else WORST_LINKS]


def event_rows(scenario: Scenario, journal: Journal) -> list[dict[str, Any]]:
    """The events of vehicles: a row for each vehicle and kind, in the order of their first occurrence."""
    events = [event for event in journal.happened if not event.is_fault]
    begun = [event for event in events if event.action == "begins"]
    ended = {event.fault for event in events if event.action == "ends"}
    last = {event.what: event for event in begun}
    return [
        {
            **asdict(row),
            "id": last[row.what].fault,
            "last_s": last[row.what].tick * scenario.tick_ns / 1e9,
            "lasts": last[row.what].fault not in ended,
        }
        for row in vehicle_events((event.what, event.tick * scenario.tick_ns / 1e9) for event in begun)
    ]


def badness(error_m: float | None) -> float:
    """By what errors are put in order: what is no number is worst."""
    return error_m if error_m is not None and isfinite(error_m) else inf


def _state(i: int, journal: Journal, dead: Collection[int]) -> str:
    if i in journal.diverged:
        return "diverged"
    words = ["tumbled"] * (i in journal.tumbled) + ["no agent"] * (i in dead)
    return ", ".join(words) or "alive"


def _settled(scenario: Scenario, journal: Journal, series: Series) -> bool:
    """Whether the consensus error has been below 5 cm for as long as the result table asks for, up to now."""
    times = journal.metrics.times
    least = least_s(scenario.disturbance, times[-1] - times[0])
    begin = max(0, bisect_left(times, times[-1] - least) - 1)  # only so much is looked at, however long the run is
    first = below_from(series.e, SETTLE_M, begin, len(times))
    return first < len(times) and stayed(times, first, len(times), least)


def _oldest(scenario: Scenario, journal: Journal) -> Mapping[int, tuple[int, int]]:
    """By vehicle: the greatest age [ticks] of its last message from a neighbour, and the number of that neighbour."""
    now = max(0, journal.written)
    found: dict[int, tuple[int, int]] = {}
    for (src, dst), age in journal.ages.links.items():
        found[dst] = max(found.get(dst, (-1, 0)), (now - age.heard, src))
    return found


JUDGE_EVERY_S = 0.5  # at most, whoever asks
JUDGE_SHARE = 0.01  # of the console's time
MOST_SPEED = 1e6  # times real time; more than any machine makes, and finite


@dataclass
class Operator:
    """Answers requests, on the console's main thread."""

    scenario: Scenario
    journal: Journal
    clock: LiveClock
    fleet: Fleet
    stopping: bool = False  # the operator asked for the end of the run
    faults: list[Part] = field(default_factory=list)  # scripted and injected
    _words: dict[str, str] = field(default_factory=dict)
    _checks: list[dict[str, Any]] = field(default_factory=list)  # as they stood when they were judged last
    _judge_next: float = 0.0  # [s] of the monotonic clock

    def __post_init__(self) -> None:
        self.faults = list(self.scenario.faults.parts)
        self._words = {event.fault: event.what for event in self.scenario.faults.events}

    def handle(self, request: dict[str, Any]) -> dict[str, Any]:
        """The answer to one request; a refusal is an answer with `error`."""
        try:
            match request.get("op"):
                case "status":
                    return self._status(every=request.get("all") is True)
                case "inject":
                    return self._inject(request.get("fault"))
                case "checks":
                    return {"checks": self._standing()}
                case "faults":
                    return {"faults": self._listed(), "events": event_rows(self.scenario, self.journal)}
                case "heal":
                    return self._heal(request.get("id"))
                case "clock":
                    return self._clock(request)
                case "stop":
                    self.stopping = True
                    return {"at_s": self._seconds(self.journal.framed)}
                case other:
                    raise RefusedError(f"there is no operation {other!r:.40}")
        except RefusedError as error:
            return {"error": str(error), "status": error.status}

    def _status(self, *, every: bool) -> dict[str, Any]:
        total = self.journal.ledger.total()
        dead = self.fleet.without_agent()
        return {
            "scenario": self.scenario.name,
            "at_s": self._seconds(max(0, self.journal.framed)),
            "end_s": self._seconds(self.scenario.ticks),
            "clock": self.clock.describe(),
            "formation": asdict(self.journal.metrics.formation),
            "delivered": total.delivered,
            "lost": sum(total.lost.values()) - total.replaced,
            "faults": [fault for fault in self._listed() if every or fault["active"]],
            "events": event_rows(self.scenario, self.journal),
            "waiting": self.fleet.waiting,
            "nodes": list(self.scenario.nodes),
            "vehicles_total": 0 if self.scenario.nodes else self.scenario.vehicles,
            "vehicles": vehicle_rows(self.scenario, self.journal, dead, every=every),
            "links_total": len(self.journal.ledger.accounts),
            "links": link_rows(self.scenario, self.journal, every=every),
        }

    def _standing(self) -> list[dict[str, Any]]:
        """The checks as they stand. A run goes on meanwhile, so they are not judged for a larger share of its time."""
        now = monotonic()
        if now >= self._judge_next:
            self._checks = standing(self.scenario, self.journal)
            done = monotonic()
            self._judge_next = done + max(JUDGE_EVERY_S, (done - now) / JUDGE_SHARE)
        return self._checks

    def _inject(self, entry: Any) -> dict[str, Any]:
        tick = self.fleet.granted
        if tick >= self.scenario.ticks:
            raise RefusedError("the run is about to end", BROKEN)
        section = checked_fault(entry, tick, self.scenario)
        name = section.id or next(n for n in map("live-{}".format, count(1)) if n not in self._words)
        if name in self._words:
            raise RefusedError(f"there is a fault {name} already")
        end = self.add(section, name)
        times = {"from_s": self._seconds(tick), "to_s": self._seconds(end), "until_healed": section.for_ is None}
        return {"id": name, "what": words(section, self.scenario.nodes), **times}

    def add(self, section: FaultSection, name: str) -> int:
        """Add a fault. Returns the tick of its end. The operator may heal it earlier."""
        scenario = self.scenario
        found = parts(section, name, scenario.spec, scenario.graph.links)
        if not acts(found):
            raise RefusedError(f"this {section.kind.name} concerns no link of the graph")
        self._replace([*self.faults, *found])
        for part in found:
            if isinstance(part, Kill):
                self.journal.tell_deaths(part.absences)
                self.fleet.end_agents(part)
        self._words[name] = words(section, scenario.nodes)
        begin, end = begin_and_end(found, section, scenario.ticks, scenario.nodes)
        self.journal.add_event(begin)
        self.journal.add_event(end)
        return end.tick

    def end_faults(self) -> list[Kill]:
        """End all faults of the plan at once, and let no later one begin. Agents that died by themselves stay as they
        are. Returns the kills that do not begin now. Raises RefusedError: agents cannot begin again in time.
        """
        tick = self.fleet.granted
        later = [part for part in self.faults if part.begin >= tick]
        self._replace([part for part in self.faults if part.begin < tick])
        for part in later:
            self.journal.end_event(part.id, tick)
        if any(part.active(tick) for part in self.faults):
            self._heal(None, deaths=False)
        return [part for part in later if isinstance(part, Kill)]

    def _heal(self, name: Any, *, deaths: bool = True) -> dict[str, Any]:
        """End one fault, or all active ones, at once. Agents begin again with a round. `deaths`: also of agents that no
        fault has killed.
        """
        tick, last = self.fleet.granted, self.scenario.ticks
        lasting = [part for part in self.faults if part.active(tick)]
        dead = {event.fault: i for i, event in self.journal.deaths.items() if deaths}  # agents that no fault has killed
        healed = self._chosen(name, {part.id for part in lasting} | dead.keys())
        kills = [part for part in lasting if isinstance(part, Kill)]
        of_agents = {kill.id for kill in kills} | dead.keys()
        round_tick = self._round_of_restart(tick, [kill for kill in kills if kill.id in healed])
        if name is None and round_tick >= last:
            healed = healed - of_agents  # for them it is too late, not for the rest
        restarted = [i for fault, i in dead.items() if fault in healed]
        for kill in kills:
            if kill.id not in healed and (both := set(kill.vehicles) & set(restarted)):
                raise RefusedError(f"agent {min(both)} was killed by {kill.id}, too: heal that one first")
        acts = round_tick if healed & of_agents else tick
        if acts >= last:
            raise RefusedError("the run ends before the next round, so no agent can begin again", BROKEN)

        ends = {part: round_tick if isinstance(part, Kill) else tick for part in lasting if part.id in healed}
        self._replace([with_end(part, ends[part]) if part in ends else part for part in self.faults])
        for i in restarted:
            self.fleet.restart_agent(i, None, round_tick)
        for kill in kills:
            for i in kill.vehicles if kill in ends else ():
                self.fleet.restart_agent(i, kill.begin, round_tick)
        for fault, end in sorted({(part.id, end) for part, end in ends.items()}):
            self.journal.end_event(fault, end)
        return {"healed": sorted(healed), "at_s": self._seconds(acts)}

    def _chosen(self, name: Any, active: set[str]) -> set[str]:
        if name is None:
            return active
        if not isinstance(name, str):
            raise RefusedError("expected the id of a fault, or none for all of them")
        events = (*self.journal.tumbled.values(), *self.journal.diverged.values())
        became = {event.fault: event.what for event in events}
        if name in became:
            raise RefusedError(f"{name} is no fault but an event of the vehicle ({became[name]}), and cannot be healed")
        if name not in active:
            known = f"active: {', '.join(sorted(active))}" if active else "none is active"
            raise RefusedError(f"there is no active fault {name!r}; {known}")
        return {name}

    def _round_of_restart(self, tick: int, kills: Sequence[Kill]) -> int:
        m = self.scenario.round_ticks
        first = -(-tick // m) * m
        # Of a kill that begins right there, a process may have been ended already.
        return first + m if any(kill.begin >= first for kill in kills) else first

    def _replace(self, faults: Sequence[Part]) -> None:
        ordered = sorted(faults, key=lambda fault: fault.begin)
        if not self.fleet.set_network_faults(tuple(fault for fault in ordered if isinstance(fault, NetFault))):
            raise RefusedError("netem did not answer; nothing was changed", BROKEN)
        self.fleet.set_world_faults(tuple(fault for fault in ordered if isinstance(fault, WorldFault)))
        self.faults = ordered

    def _clock(self, request: dict[str, Any]) -> dict[str, Any]:
        if self.scenario.nodes:
            raise RefusedError("cannot hold the time: external robots run in real time")
        match request.get("do"), request.get("value"):
            case "pause", _:
                self.clock.pause(self.fleet.granted)
            case "resume", _:
                self.clock.resume()
            case "step", int(count) if count > 0:
                self.clock.step(self.fleet.granted, count)
                return {"clock": self.clock.describe(), "at_s": self._seconds(self.clock.held)}
            case "speed", _ if self.clock.clock is Clock.REAL:
                raise RefusedError("a run on a wall clock keeps the pace with which it began (fleet run --speed)")
            case "speed", (int() | float() | None) as speed if speed is None or 0 < speed <= MOST_SPEED:
                self.clock.set_speed_limit(self.fleet.granted, None if speed is None else float(speed))
            case other:
                raise RefusedError(f"the clock knows pause, resume, step N and speed X, not {other!r}")
        return {"clock": self.clock.describe(), "at_s": self._seconds(self.fleet.granted)}

    def _listed(self) -> list[dict[str, Any]]:
        """Every fault that is, was or will be active, with its state at the first tick that is not granted."""
        now = min(self.fleet.granted, self.scenario.ticks - 1)
        found: dict[str, dict[str, Any]] = {}
        for fault in self.faults:
            state = "active" if fault.active(now) else "over" if fault.begin < now else "to come"
            found[fault.id] = self._row(fault.id, self._words[fault.id], fault.begin, fault.end, state)
        for event in self.journal.deaths.values():
            found[event.fault] = self._row(event.fault, event.what, event.tick, None, "active")
        return list(found.values())

    def _row(self, name: str, what: str, begin: int, end: int | None, state: str) -> dict[str, Any]:
        last = self.scenario.ticks
        to_s = self._seconds(last if end is None else min(end, last))
        times = {"from_s": self._seconds(begin), "to_s": to_s, "until_healed": end is None}
        return {"id": name, "what": what, **times, "state": state, "active": state == "active"}

    def _seconds(self, tick: int) -> float:
        return tick * self.scenario.tick_ns / 1e9
