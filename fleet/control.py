"""The operator's hand on a running fleet: what `fleet status|inject|faults|heal|clock|stop` ask of the console.

Everything that is injected acts at the tick up to which the clock has been granted, which nobody has started yet. It
is acknowledged with that time, logged like a scripted fault, and so can be printed as a scenario and run again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import TypeAdapter, ValidationError

from fleet.clock import LiveClock
from fleet.faults import (
    ACTIONS,
    OF_THE_WORLD,
    Event,
    FaultError,
    action,
    network_faults,
    vehicles_of,
    words,
    world_fault,
)
from fleet.journal import Journal
from fleet.scenario import Scenario
from fleet.schema import FaultEntry, FaultSection
from netem.faults import NetFault
from world.faults import WorldFault

_ENTRY: TypeAdapter[FaultSection] = TypeAdapter(FaultEntry)


class RefusedError(Exception):
    """What was asked cannot be done; its text says why."""


@dataclass
class Operator:
    """Answers requests on the console's main thread."""

    scenario: Scenario
    journal: Journal
    clock: LiveClock
    tell_netem: Callable[[tuple[NetFault, ...]], bool]  # False: it did not answer
    end_agent: Callable[[int, int], None]  # vehicle, tick
    granted: Callable[[], int]
    dead: Callable[[], list[int]]
    waiting: Callable[[], str]
    stopping: bool = False
    tell_world: Callable[[tuple[WorldFault, ...]], None] = lambda _: None
    faults: list[NetFault | WorldFault] = field(default_factory=list)
    _injected: int = 0

    def __post_init__(self) -> None:
        self.faults = [*self.scenario.faults.network, *self.scenario.faults.world]

    def handle(self, request: dict[str, Any]) -> dict[str, Any]:
        """The answer to one request; a refusal is an answer, too."""
        try:
            match request.get("op"):
                case "status":
                    return self._status()
                case "inject":
                    return self._inject(request.get("fault"))
                case "faults":
                    return {"faults": self._listed()}
                case "heal":
                    return self._heal(request.get("id"))
                case "clock":
                    return self._clock(request)
                case "stop":
                    self.stopping = True
                    return {"at_s": self._seconds(self.journal.framed)}
                case other:
                    raise RefusedError(f"there is no operation {other!r}")
        except RefusedError as error:
            return {"error": str(error)}

    def _status(self) -> dict[str, Any]:
        total = self.journal.ledger.total()
        return {
            "scenario": self.scenario.name,
            "vehicles": self.scenario.vehicles,
            "at_s": self._seconds(max(0, self.journal.framed)),
            "end_s": self._seconds(self.scenario.ticks),
            "clock": self.clock.describe(),
            "formation_error_m": self.journal.metrics.formation_error,
            "delivered": total.delivered,
            "lost": sum(total.lost.values()),
            "faults": [fault for fault in self._listed() if fault["active"]],
            "dead": self.dead(),
            "waiting": self.waiting(),
        }

    def _inject(self, entry: Any) -> dict[str, Any]:
        tick = self.granted()
        if tick >= self.scenario.ticks:
            raise RefusedError("the run is about to end")
        if not isinstance(entry, dict) or "at" in entry:
            raise RefusedError("expected a fault without a time: it acts now")
        try:
            section = _ENTRY.validate_python(entry | {"at": f"{tick * self.scenario.tick_ns} ns"})
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise RefusedError(str(first.get("ctx", {}).get("message", first["msg"]))) from None
        if len([name for name in ACTIONS if getattr(section, name) is not None]) != 1:
            raise RefusedError(f"a fault does exactly one thing, one of {', '.join(ACTIONS)}")
        if section.for_ is not None and section.for_ % self.scenario.tick_ns:
            raise RefusedError(f"the duration is not a whole number of ticks of {self.scenario.tick_ns / 1e6:g} ms")
        self._injected += 1
        name = section.id or f"live-{self._injected}"
        if any(fault.id == name for fault in self.faults):
            raise RefusedError(f"there is a fault {name} already")
        self._check_vehicles(section)
        if action(section) == "kill":
            for i in vehicles_of(section):
                self.end_agent(i, tick)
        else:
            self._add(section, name, tick)
        return {"id": name, "at_s": self._seconds(tick), "what": words(section)}

    def _add(self, section: FaultSection, name: str, tick: int) -> None:
        scenario = self.scenario
        number = len(scenario.spec.faults) + self._injected
        found: list[NetFault] | list[WorldFault]
        try:
            if action(section) in OF_THE_WORLD:
                found = [world_fault(section, name, scenario.spec)]
            else:
                found = network_faults(section, name, number, scenario.spec, scenario.graph.links)
        except FaultError as error:
            raise RefusedError(f"{error.message}; {error.hint}" if error.hint else error.message) from None
        if not any(isinstance(fault, WorldFault) or fault.links or fault.vehicles for fault in found):
            raise RefusedError("the graph has no such link")
        self._replace([*self.faults, *found])
        last = scenario.ticks
        end = found[0].end
        self.journal.add_event(Event(tick, name, "begins", words(section)))
        self.journal.add_event(Event(last if end is None else min(end, last), name, "ends", words(section)))

    def _heal(self, name: Any) -> dict[str, Any]:
        tick = self.granted()
        ill = {fault.id for fault in self.faults if fault.active(tick)}
        if name is not None and name not in ill:
            known = f"active: {', '.join(sorted(ill))}" if ill else "none is active"
            raise RefusedError(f"there is no active fault {name!r}; {known}")
        healed = ill if name is None else {name}
        self._replace([replace(f, end=tick) if f.id in healed and f.active(tick) else f for f in self.faults])
        for fault in sorted(healed):
            self.journal.end_event(fault, tick)
        return {"healed": sorted(healed), "at_s": self._seconds(tick)}

    def _replace(self, faults: Sequence[NetFault | WorldFault]) -> None:
        ordered = sorted(faults, key=lambda fault: fault.begin)
        if not self.tell_netem(tuple(fault for fault in ordered if isinstance(fault, NetFault))):
            raise RefusedError("netem did not answer; nothing was changed")
        self.tell_world(tuple(fault for fault in ordered if isinstance(fault, WorldFault)))
        self.faults = ordered

    def _clock(self, request: dict[str, Any]) -> dict[str, Any]:
        match request.get("do"), request.get("value"):
            case "pause", _:
                self.clock.pause(self.granted())
            case "resume", _:
                self.clock.resume()
            case "step", int(count) if count > 0:
                self.clock.step(self.granted(), count)
            case "speed", (int() | float() | None) as speed if speed is None or speed > 0:
                self.clock.set_speed(self.granted(), None if speed is None else float(speed))
            case other:
                raise RefusedError(f"the clock knows pause, resume, step N and speed X, not {other!r}")
        return {"clock": self.clock.describe(), "at_s": self._seconds(self.granted())}

    def _check_vehicles(self, section: FaultSection) -> None:
        for i in vehicles_of(section):
            if not 1 <= i <= self.scenario.vehicles:
                raise RefusedError(f"there is no vehicle {i}: they are 1 to {self.scenario.vehicles}")

    def _listed(self) -> list[dict[str, Any]]:
        now = max(0, self.journal.framed)
        found: dict[str, dict[str, Any]] = {}
        for fault in self.faults:
            found[fault.id] = {
                "id": fault.id,
                "kind": fault.kind,
                "from_s": self._seconds(fault.begin),
                "to_s": self._seconds(self.scenario.ticks if fault.end is None else fault.end),
                "active": fault.active(now),
            }
        return list(found.values())

    def _seconds(self, tick: int) -> float:
        return tick * self.scenario.tick_ns / 1e9
