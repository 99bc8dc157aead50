"""The operator of a running fleet: what `fleet status|inject|heal|clock|stop` and pages ask of the console.

A fault that is injected acts from the first tick on that is not granted yet, so no process has started it. The answer
says which time that is. The fault is logged like a scripted one, so the run can be printed as a scenario and run again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from time import monotonic
from typing import Any

from msgspec.structs import asdict

from fleet.analysis.verdicts import standing
from fleet.execution.clock import LiveClock
from fleet.execution.fault_request import BROKEN, RefusedError, check_fault
from fleet.execution.live_status import event_rows, link_rows, vehicle_rows
from fleet.execution.runner import Fleet
from fleet.recorder.journal import Journal
from fleet.scenario.faults.kind import Kill, Part
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.sections.fault_entry import entry_of, words_of
from fleet.scenario.sections.timeline import acts, begin_and_end, parts, with_end
from netem.clock import Clock
from netem.faults import NetFault
from netem.wire.messages import WorldFault

JUDGE_EVERY_S = 0.5  # at most, whoever asks
JUDGE_SHARE = 0.01  # share of the console's time
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
    _entries: dict[str, str] = field(default_factory=dict)  # by id of the fault
    _checks: list[dict[str, Any]] = field(default_factory=list)  # as they stood when they were judged last
    _judge_next: float = 0.0  # [s] of the monotonic clock

    def __post_init__(self) -> None:
        self.faults = list(self.scenario.faults.parts)
        self._entries = {event.fault: event.entry for event in self.scenario.faults.events}

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
                    return {"at_s": self._seconds(max(0, self.journal.framed))}
                case other:
                    raise RefusedError(f"there is no operation {other!r:.40}")
        except RefusedError as error:
            return {"error": str(error), "status": error.status}

    def _status(self, *, every: bool) -> dict[str, Any]:
        total = self.journal.ledger.total()
        dead = self.fleet.vehicles_without_agent()
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
            "gone": [self.scenario.vehicle_name(i) for i in dead] if self.scenario.nodes else [],
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
        section = check_fault(entry, tick, self.scenario)
        name = section.id or next(n for n in map("live-{}".format, count(1)) if n not in self._entries)
        if name in self._entries:
            raise RefusedError(f"there is a fault {name} already")
        end = self.add(section, name)
        times = {"from_s": self._seconds(tick), "to_s": self._seconds(end), "until_healed": section.for_ is None}
        return {"id": name, "what": words_of(self._entries[name], self.scenario.nodes), **times}

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
        self._entries[name] = entry_of(section)
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
        # A kill that begins right there may have ended a process already.
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
            found[fault.id] = self._row(fault.id, self._entries[fault.id], fault.begin, fault.end, state)
        for event in self.journal.deaths.values():
            found[event.fault] = self._row(event.fault, event.entry, event.tick, None, "active")
        return list(found.values())

    def _row(self, name: str, entry: str, begin: int, end: int | None, state: str) -> dict[str, Any]:
        last = self.scenario.ticks
        to_s = self._seconds(last if end is None else min(end, last))
        times = {"from_s": self._seconds(begin), "to_s": to_s, "until_healed": end is None}
        what = words_of(entry, self.scenario.nodes)
        return {"id": name, "what": what, "entry": entry, **times, "state": state, "active": state == "active"}

    def _seconds(self, tick: int) -> float:
        return tick * self.scenario.tick_ns / 1e9
