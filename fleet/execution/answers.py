"""What a live run answers to the commands for it, as `--json` prints it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from fleet.result.result import Formation
from fleet.scenario.sections.vehicle_events import VehicleEvents

At = Annotated[float, Meta(description="Simulated time [s].")]
End = Annotated[float, Meta(description="Simulated time at which the run ends [s].")]
Clock = Annotated[str, Meta(description="In words: paused, as fast as it goes, 2 x real time.")]
From = Annotated[float, Meta(description="Simulated time at which it begins [s].")]
To = Annotated[float, Meta(description="Simulated time of its end, at the latest that of the run [s].")]
UntilHealed = Annotated[bool, Meta(description="Whether it has no end of its own but the run's.")]


class LiveRunRow(Struct):
    """One live run."""

    run: str
    directory: str
    scenario: str
    pid: int
    endpoint: Annotated[str, Meta(description="Of its router.")]
    at_s: Annotated[float | None, Meta(description="null: it did not answer.")] = None
    end_s: float | None = None
    clock: Annotated[str | None, Meta(description="In words.")] = None
    error: Annotated[str, Meta(description="Why there is no answer; empty: there is one.")] = ""


class FaultRow(Struct):
    """One fault of a run."""

    id: str
    what: str
    from_s: From
    to_s: To
    until_healed: UntilHealed
    state: Annotated[str, Meta(description="to come, active or over.")]
    entry: Annotated[str, Meta(description="As in a scenario's faults, in JSON, with the numbers of vehicles.")] = ""


class EventRow(VehicleEvents):
    """Events of one vehicle in a run that goes on."""

    last_s: float
    lasts: bool
    id: Annotated[str, Meta(description="Id of the last one, as in the log.")]
    entry: Annotated[str, Meta(description='As data, in JSON: `{"tumbled": "3"}`.')] = ""

    def __str__(self) -> str:
        """A line such as `tumbled 3: 10 times, first at 12.45 s, and still is`."""
        return f"{super().__str__()}{', and still is' if self.lasts else ''}"


class VehicleRow(Struct):
    """How one vehicle is doing."""

    vehicle: int
    state: Annotated[str, Meta(description="alive, diverged, or what of tumbled, no agent is true.")]
    formation_m: float | None
    e_m: float | None
    settled: Annotated[bool, Meta(description="Whether the consensus error has stayed below 5 cm for long enough.")]
    oldest_s: Annotated[float | None, Meta(description="Greatest age of what it heard last of a neighbour.")]
    oldest_of: int | None


class LinkRow(Struct):
    """How one directed link is doing, since the beginning of the run."""

    src: int
    dst: int
    delivered: int
    lost: int
    lost_share: Annotated[float, Meta(description="0 to 1.")]
    age_s: float
    link: Annotated[str, Meta(description="`1->2`, or with the names of nodes.")] = ""


class RunStatus(Struct):
    """`fleet status --json`: how a live run is doing."""

    run: str
    directory: str
    scenario: str
    at_s: At
    end_s: End
    clock: Clock
    waiting: Annotated[str, Meta(description="The waiting process and its cause, in words; empty: the run moves.")]
    formation: Formation
    delivered: int
    lost: int
    faults: Annotated[list[FaultRow], Meta(description="The active ones; with --all every one.")]
    events: list[EventRow]
    vehicles_total: int
    vehicles: Annotated[list[VehicleRow], Meta(description="The worst ten; with --all up to 500.")]
    links_total: int
    links: Annotated[list[LinkRow], Meta(description="The worst five; with --all up to 500.")]
    nodes: Annotated[list[str], Meta(description="Of `fleet netem`; else none.")] = []
    gone: Annotated[list[str], Meta(description="Nodes of which a program of the run does not run.")] = []


class Injected(Struct):
    """`fleet inject --json`: the fault that was injected."""

    run: str
    id: str
    what: str
    from_s: From
    to_s: To
    until_healed: UntilHealed


class Healed(Struct):
    """`fleet heal --json`: which faults end."""

    run: str
    healed: list[str]
    at_s: float


class ClockSet(Struct):
    """`fleet clock --json`: how the clock goes now."""

    run: str
    clock: Clock
    at_s: Annotated[float, Meta(description="Simulated time.")]


class Stopping(Struct):
    """`fleet stop --json`: the run ends now."""

    run: str
    at_s: At
