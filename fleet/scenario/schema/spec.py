"""The schema of a scenario file: every key, its meaning, its unit, its default.

The models hold validated values in SI units (times: integer ns) and print themselves with units. The rules that
concern several keys at once are in `fleet.scenario.rules`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer

from agents.config import OnError
from fleet.quantities import describe_value
from fleet.scenario import value_types as v
from fleet.scenario.faults.of_sensors import SensorsSection
from fleet.scenario.schema.checks import ChecksSection
from fleet.scenario.schema.control import (
    AgentChoice,
    GuidanceChoice,
    GuidanceSection,
    LawChoice,
    LawSection,
    NeighboursSection,
    Profile,
    TrackingChoice,
    TrackingSection,
    VehicleOverrides,
)
from fleet.scenario.schema.faults import FaultEntry, SeaSection, TriggerSection
from fleet.scenario.schema.gateway import GatewaySection
from fleet.scenario.schema.groups import Group
from fleet.scenario.schema.keep_apart import KeepApartSection
from fleet.scenario.schema.motion import (
    FormationSection,
    GraphSection,
    InitialSection,
    ReferenceSection,
    read_initial,
    show_initial,
)
from fleet.scenario.schema.navigation import NavigationChoice
from fleet.scenario.schema.nemesis import NemesisSection
from fleet.scenario.schema.network import NetworkSection, read_network, show_network
from fleet.scenario.schema.nodes import Flag, Node, NodeName
from fleet.scenario.schema.programs import ProgramKey, ProgramSection, SignalKey, StackSignalSection
from fleet.scenario.schema.vehicle import ModelErrorSection, VehicleSection
from fleet.scenario.value_types import Section, mistake, word_for
from netem.parsing import nearest
from world.config import DEFAULT_SUBSTEPS


class AgentsSection(Section):
    """Which agents share a process; in lockstep it changes no byte of a log."""

    per_process: Literal["auto"] | Annotated[int, Field(ge=1, le=1000)] = "auto"  # by the size of the fleet


class LogSection(Section):
    """How often each group of topics is logged; every packet of every link always is. `log: none` is `none` here."""

    none: bool = False
    payloads: Flag | None = None  # nodes: also the bytes of each message
    every: v.Ticks = 1
    pose: v.Ticks | None = None
    state: v.Ticks | None = None
    nav: v.Ticks | None = None
    command: v.Ticks | None = None
    guidance: v.Ticks | None = None
    control: v.Ticks | None = None
    error: v.Ticks | None = None
    plant: v.Ticks | None = None  # what plants report
    clock: v.Ticks | None = None  # errors of clocks
    belief: v.Ticks | None = None  # for vehicles that do not know where they are
    located: v.Ticks | None = None  # for vehicles that use ranges
    transforms: v.TicksOrNever | None = None  # for all vehicles together; default: about 10 Hz; 0 ticks: never
    scene: v.TicksOrNever | None = None  # hulls, links, places for 3D viewers, about 2 Hz; 0 ticks: never
    snapshot: v.Time | None = None  # has no effect; versions up to 1.0 wrote snapshots into the log


def _read_log(value: Any) -> Any:
    """The model's form of the section, which may be one word in the file."""
    if value == "none":
        return {"none": True}
    if isinstance(value, dict) and "none" in value:
        raise mistake('write "log: none" for a run without a log, which then is nothing else')
    if isinstance(value, str):
        raise mistake(
            f'expected a mapping of rates, or "none", got {describe_value(value)}', hint=nearest(value, ["none"])
        )
    return value


def _show_log(log: LogSection) -> Any:
    """The file's form of the section."""
    values = log.model_dump(exclude_none=True)
    return "none" if values.pop("none") else values


def _title(value: Any) -> Any:
    if isinstance(value, str) and not (value.strip() and value.isprintable() and len(value) <= 200):
        raise mistake("expected one line of at most 200 printable characters")
    return value


class PhysicsSection(Section):
    """How finely the sea is integrated."""

    substeps: Annotated[int, Field(ge=1, le=100)] = DEFAULT_SUBSTEPS  # RK4 steps per tick


class ScenarioSpec(Section):
    """The whole file."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]  # also names the run directory
    title: Annotated[str, BeforeValidator(_title)]  # what it shows, in one line
    # `fleet list` reads the group in the file. It decides nothing in a run, so it is checked and forgotten.
    group: Annotated[Group | None, AfterValidator(lambda _: None), Field(exclude=True)] = None
    # Robots that are not ours, in place of vehicles; `fleet netem` serves them.
    nodes: Annotated[dict[NodeName, Node], Field(min_length=2)] | None = None
    clock: Literal["real", "simulated"] | None = None  # of nodes: simulated: their programs are agents; default: real
    names: Annotated[list[NodeName], Field(min_length=2)] | None = None  # of vehicles that were nodes
    programs: dict[ProgramKey, ProgramSection] | None = None  # of nodes: started and stopped with the run
    compose: str | None = None  # a compose file that is up during the run
    begin: v.Time | None = None  # from the time at which all programs are ready to t = 0; 0 s
    signals: dict[SignalKey, StackSignalSection] | None = None  # numbers that programs tell
    carry: list[str] | None = None  # zenoh's key expressions of what the network carries; everything
    discovery: Literal["ideal", "linked"] | None = None  # linked: tokens need a link, too
    lost_after: v.Period | None = None  # linked: time without a link after which they are withdrawn; 10 s
    header: v.NoBytes | None = None  # bytes of a packet beside its payload; default: 0
    fragments: Flag | None = None  # in water: a message longer than a packet is sent as several
    vehicles: Annotated[int, Field(ge=1, le=3000)]
    duration: v.Period
    tick: v.Period = 10_000_000  # the control period Ts
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    on_death: Literal["continue", "restart", "abort"] = "continue"  # when an agent ends that no fault kills
    stall_timeout: v.Period = 30_000_000_000  # wall time without progress that ends the run
    reference: ReferenceSection
    formation: FormationSection
    graph: GraphSection
    initial: Annotated[InitialSection, BeforeValidator(read_initial), PlainSerializer(show_initial)]
    vehicle: VehicleSection = VehicleSection.model_construct()
    sea: SeaSection = SeaSection.model_construct()
    sensors: SensorsSection = SensorsSection.model_construct()
    model_error: ModelErrorSection = ModelErrorSection.model_construct()
    agents: AgentsSection = AgentsSection.model_construct()
    moored: bool | None = None  # true: vehicles stay where they begin, and agents need not steer
    external: bool | None = None  # true: the run starts no agent
    gateway: GatewaySection | None = None  # all agents are real computers
    knows_reference: bool | None = None  # false: only the vehicles in graph.reference and graph.standby know it
    agent: AgentChoice | None = None  # in place of controller, guidance and tracking, which it may use; its clock
    controller: LawChoice = LawSection.model_construct(law="nboc")
    profile: Profile = "paper"
    guidance: GuidanceChoice = GuidanceSection.model_construct()
    tracking: TrackingChoice = TrackingSection.model_construct()
    on_controller_error: OnError = "abort"
    controller_budget: v.Time = 0  # wall time that a law of the user may take for a sample; 0: any
    neighbours: NeighboursSection = NeighboursSection.model_construct()
    keep_apart: KeepApartSection | None = None  # between guidance and tracking
    per_vehicle: dict[v.VehicleNumbers, VehicleOverrides] = {}  # "3" or "2-4, 7"; later ones over earlier ones
    network: Annotated[NetworkSection, BeforeValidator(read_network), PlainSerializer(show_network)]
    navigation: NavigationChoice | None = None  # ideal: they know where they are
    physics: PhysicsSection = PhysicsSection.model_construct()
    log: Annotated[LogSection, BeforeValidator(_read_log), PlainSerializer(_show_log)] = LogSection.model_construct()
    faults: list[FaultEntry] = []
    triggers: list[TriggerSection] = []
    # Becomes explicit faults when the scenario is read.
    nemesis: Annotated[NemesisSection, word_for("mode")] | None = None
    checks: ChecksSection = ChecksSection.model_construct()
    expect: Literal["pass", "fail"] = "pass"  # fail: the run is meant to fail a check, and exits with 0 when it does


def sections(spec: ScenarioSpec, key: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """(path of its parent, section) of a section wherever it is written: for all vehicles, and for some."""
    yield (), getattr(spec, key)
    for entry, overrides in spec.per_vehicle.items():
        if getattr(overrides, key) is not None:
            yield ("per_vehicle", entry), getattr(overrides, key)
