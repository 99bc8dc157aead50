"""The output of the commands for a live run with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from fleet.result.result import Formation
from fleet.scenario.sections.vehicle_events import VehicleEvents

RunName = Annotated[str, Meta(description="Name of the run: of its directory.")]
Directory = Annotated[str, Meta(description="The run's directory, absolute.")]
ScenarioName = Annotated[str, Meta(description="Name of the scenario.")]
At = Annotated[float, Meta(description="Simulated time [s].")]
End = Annotated[float, Meta(description="Simulated time at which the run ends [s].")]
Clock = Annotated[str, Meta(description="How the clock goes, in words: paused, as fast as it goes, 2 x real time.")]
FaultId = Annotated[str, Meta(description="The fault's id.")]
FaultWords = Annotated[str, Meta(description="The fault, as a scenario writes it.")]
From = Annotated[float, Meta(description="Simulated time at which it begins [s].")]
To = Annotated[float, Meta(description="Simulated time of its end, at the latest that of the run [s].")]
UntilHealed = Annotated[bool, Meta(description="Whether it has no end of its own but the run's.")]


class LiveRunRow(Struct):
    """One live run."""

    run: RunName
    directory: Directory
    scenario: ScenarioName
    pid: Annotated[int, Meta(description="Process number of its console.")]
    endpoint: Annotated[str, Meta(description="Endpoint of its router, as zenoh writes it.")]
    at_s: Annotated[float | None, Meta(description="Simulated time [s]; null: it did not answer.")] = None
    end_s: Annotated[float | None, Meta(description="Simulated time at which it ends [s]; null: no answer.")] = None
    clock: Annotated[str | None, Meta(description="How its clock goes, in words; null: it did not answer.")] = None
    error: Annotated[str, Meta(description="Why there is no answer; empty: there is one.")] = ""


class LiveRuns(Struct):
    """`fleet ps --json`: the live runs of this user."""

    runs: Annotated[list[LiveRunRow], Meta(description="By name.")]


class FaultRow(Struct):
    """One fault of a run."""

    id: FaultId
    what: FaultWords
    from_s: From
    to_s: To
    until_healed: UntilHealed
    state: Annotated[str, Meta(description="to come, active or over.")]


class EventCount(Struct):
    """Events of one vehicle, with their number: it tumbled or diverged."""

    what: Annotated[str, Meta(description="Which event, and which vehicle: `tumbled 3`.")]
    times: Annotated[int, Meta(description="How often it happened.")]
    first_s: Annotated[float, Meta(description="When it first began [s].")]


class EventRow(EventCount):
    """The same in a run that goes on."""

    last_s: Annotated[float, Meta(description="When it last began [s].")]
    lasts: Annotated[bool, Meta(description="Whether it still is so.")]
    id: Annotated[str, Meta(description="Id of the last one, as in the log.")]

    def __str__(self) -> str:
        """A line such as `tumbled 3: 10 times, first at 12.45 s, and still is`."""
        return f"{VehicleEvents(self.what, self.times, self.first_s)}{', and still is' if self.lasts else ''}"


class VehicleRow(Struct):
    """How one vehicle is doing."""

    vehicle: Annotated[int, Meta(description="Its number.")]
    state: Annotated[str, Meta(description="alive, diverged, or what of tumbled, no agent is true.")]
    formation_m: Annotated[float | None, Meta(description="Formation error [m].")]
    e_m: Annotated[float | None, Meta(description="Consensus error [m].")]
    settled: Annotated[bool, Meta(description="Whether the consensus error has stayed below 5 cm for long enough.")]
    oldest_s: Annotated[float | None, Meta(description="Greatest age of what it heard last of a neighbour [s].")]
    oldest_of: Annotated[int | None, Meta(description="Number of that neighbour; null: it hears of none.")]


class LinkRow(Struct):
    """How one directed link is doing, since the beginning of the run."""

    src: Annotated[int, Meta(description="The vehicle that sends.")]
    dst: Annotated[int, Meta(description="The vehicle that receives.")]
    delivered: Annotated[int, Meta(description="Packets delivered.")]
    lost: Annotated[int, Meta(description="Packets lost.")]
    lost_share: Annotated[float, Meta(description="Lost ones among those whose fate is known, 0 to 1.")]
    age_s: Annotated[float, Meta(description="Age of what was delivered last [s].")]


class RunStatus(Struct):
    """`fleet status --json`: how a live run is doing."""

    run: RunName
    directory: Directory
    scenario: ScenarioName
    at_s: At
    end_s: End
    clock: Clock
    waiting: Annotated[str, Meta(description="The waiting process and its cause, in words; empty: the run moves.")]
    formation: Annotated[Formation, Meta(description="Formation errors.")]
    delivered: Annotated[int, Meta(description="Packets delivered on all links.")]
    lost: Annotated[int, Meta(description="Packets lost on all links.")]
    faults: Annotated[
        list[FaultRow],
        Meta(description="The active ones of the scenario, injected, and of agents that died; with --all every one."),
    ]
    events: Annotated[list[EventRow], Meta(description="Events of vehicles so far, one row for each.")]
    vehicles_total: Annotated[int, Meta(description="Number of vehicles.")]
    vehicles: Annotated[list[VehicleRow], Meta(description="The worst ten by formation error; with --all up to 500.")]
    links_total: Annotated[int, Meta(description="Number of directed links.")]
    links: Annotated[list[LinkRow], Meta(description="The worst five, worst first; with --all up to 500.")]


class Injected(Struct):
    """`fleet inject --json`: the fault that was injected."""

    run: RunName
    id: FaultId
    what: FaultWords
    from_s: From
    to_s: To
    until_healed: UntilHealed


class Healed(Struct):
    """`fleet heal --json`: which faults end."""

    run: RunName
    healed: Annotated[list[str], Meta(description="Their ids.")]
    at_s: Annotated[float, Meta(description="Simulated time at which they end [s].")]


class ClockSet(Struct):
    """`fleet clock --json`: how the clock goes now."""

    run: RunName
    clock: Clock
    at_s: Annotated[float, Meta(description="Simulated time that has been granted to the run [s].")]


class Stopping(Struct):
    """`fleet stop --json`: the run ends now."""

    run: RunName
    at_s: At
