"""A valid scenario, and the configuration that each core of a run gets from it. `loading` reads one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from math import gcd
from pathlib import Path
from typing import NamedTuple

from agents.config import AgentConfig, Law, Neighbour
from agents.controllers import BUILT_IN, laws, layout, speaks
from agents.offset import Offset, OffsetChange
from agents.plugins.laws import with_whole_path
from agents.signals import SignalLayout
from fleet.quantities import vehicle_name, vehicle_numbers
from fleet.scenario.parts import Parts
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.schema.vehicle import PlantSection, VehicleSection
from fleet.scenario.sections.acoustic import inlined_modem
from fleet.scenario.sections.formation import initial_rolls
from fleet.scenario.sections.log_rates import log_every
from fleet.scenario.sections.modem_files import shipped_modems
from fleet.scenario.sections.navigation import inlined_navigation
from fleet.scenario.sections.node_signals import node_layout
from fleet.scenario.sections.per_vehicle import Control, inlined_vehicle, model_name
from fleet.scenario.sections.signals import BeliefKind
from fleet.scenario.sections.timeline import FaultInterval
from fleet.scenario.sections.triggers import trigger_lines
from fleet.scenario.sections.vehicle_files import shipped_vehicles
from fleet.scenario.text import scenario_yaml
from fleet.scenario.text.nodes import UNTIL_STOPPED_NS
from fleet.scenario.text.overrides import Override
from fleet.scenario.trust import Policy
from netem.condition import Condition, Link
from netem.config import NetemConfig
from world import disturbance
from world.config import NavNoise, PlantSetup, VehicleSetup, WorldConfig
from world.plants.classes import file_of
from world.signal import Signal
from world.vectors import minus


class Reading(NamedTuple):
    """The sources of a scenario; `loading.with_overrides` reads them once more."""

    text: str
    overrides: tuple[str | Override, ...]
    folder: Path | None  # where the scenario's file lies
    policy: Policy


class Scenario:
    """A valid scenario, equal to another with the same run and verdict. It makes each core's configuration once."""

    def __init__(self, parts: Parts, reading: Reading, source: str = "") -> None:
        """The scenario of a valid specification, from its parts. `source`: its shipped name, or its path."""
        self.spec = spec = _inline_files(parts.explicit, parts)  # the values of the file, in SI units
        self.undrawn = _inline_files(parts.spec, parts)  # with the nemesis in place of the faults that it drew
        self.reading, self.source = reading, source
        self.nodes = tuple(spec.nodes or ())  # names of robots that are not ours; empty: vehicles
        self.targets = parts.targets  # what its nemesis acts on
        self.name, self.title, self.vehicles, self.seed = spec.name, spec.title, spec.vehicles, spec.seed
        self.tick_ns, self.duration_ns, self.stall_timeout_s = spec.tick, spec.duration, spec.stall_timeout / 1e9
        self.ticks = spec.duration // spec.tick
        self.ideal = spec.network.ideal
        # m, ticks per network round; an ideal network exchanges at every tick.
        self.round_ticks = 1 if self.ideal else spec.network.period // spec.tick
        self.reference = parts.reference
        self.plans = parts.plans  # p_i(t) [m, NED]
        self.graph, self.b = parts.graph, parts.graph.b
        self.initial = parts.initial  # (eta0, nu0) of each vehicle
        self.conditions = parts.conditions  # every link that is not perfect at the start
        self.radios = parts.radios  # rate and limit of all that a vehicle sends
        self.changing = parts.changing  # what the others do whose condition changes by itself
        self.selectors = parts.selectors  # the last entry of network.links that names each link
        self.controls = parts.controls  # what each vehicle is and runs
        self.external = tuple(i for i, its in enumerate(self.controls, 1) if its.external)  # agents that others start
        self.faults = parts.faults
        self.other_laws = _others(parts.controls)  # kind and name of laws that are not built in, each name once
        self.acoustic = parts.acoustic  # None: the network is not acoustic
        self.clocks = parts.clocks  # only vehicles for which a clock is set
        # The periodic forces on every vehicle; empty: none.
        self.disturbance = disturbance.PAPER if spec.sea.disturbance == "paper" else ()
        self.exact_gains = False  # whether agents leave PIQP out: the same gains in less time, if set before the run
        self._layouts: dict[int, SignalLayout] = {}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scenario) and self._decisive == other._decisive

    @property
    def _decisive(self) -> tuple[object, ...]:
        """All that decides a run and its verdict; files that the specification names may have changed."""
        return (
            self.spec, self.reference, self.plans, self.graph, self.initial, self.conditions, self.changing,
            self.selectors, self.controls, self.faults, self.acoustic, self.clocks,
        )  # fmt: skip

    @cached_property
    def speaking(self) -> tuple[int, ...]:
        """The vehicles whose agents may have lines for the log."""
        return tuple(i for i, its in enumerate(self.controls, 1) if its.external or speaks(its))

    @property
    def ends(self) -> bool:
        """Whether it has a planned end; one with nodes may run until somebody ends it."""
        return not (self.nodes and self.duration_ns == UNTIL_STOPPED_NS)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of nodes, on either clock; (): they are vehicles, which have numbers."""
        return self.nodes or tuple(self.spec.names or ())

    def vehicle_name(self, i: int) -> str:
        """The number of a vehicle, or the name of a node."""
        return vehicle_name(i, self.names)

    def link_name(self, link: Link) -> str:
        """`1->2`, or with the names of nodes."""
        return f"{self.vehicle_name(link[0])}->{self.vehicle_name(link[1])}"

    def next_round(self, tick: int) -> int | None:
        """The first round tick after a tick; None if the run is over by then."""
        m = self.round_ticks
        after = (tick // m + 1) * m
        return after if after < self.ticks else None

    @cached_property
    def possible(self) -> dict[Link, tuple[Condition, ...]]:
        """Every condition that a link may have by itself; perfect links are left out."""
        changing = {link: tuple(dict.fromkeys(its.conditions)) for link, its in self.changing.items()}
        return {link: (condition,) for link, condition in self.conditions.items()} | changing

    @property
    def plants(self) -> dict[str, PlantSection]:
        """The plants of the vehicles by name, for each name the first."""
        return {c.plant.name: c.plant for c in reversed(self.controls) if c.plant is not None}

    @cached_property
    def log_every(self) -> dict[str, int]:
        """Ticks between two records of each topic group."""
        return log_every(self.spec)

    @cached_property
    def world_config(self) -> WorldConfig:
        """The configuration of the world. Raises PluginError: a law cannot be used."""
        spec, current = self.spec, self.spec.sea.current
        return WorldConfig(
            seed=spec.seed,
            tick_ns=spec.tick,
            ticks=self.ticks,
            round_ticks=self.round_ticks,
            substeps=spec.physics.substeps,
            vehicles=tuple(map(self._vehicle_setup, range(1, self.vehicles + 1))),
            disturbance=self.disturbance,
            current=current.mean,
            drift=(current.sigma, current.time_constant / 1e9) if any(current.sigma) else None,  # None: it is constant
            faults=self.faults.world,
            absences=self.faults.absences,
            keep_going=spec.on_death != "abort" and not self.ideal,
            noise=self.noise,
            clocks=dict(self.clocks),
            moored=bool(spec.moored),
        )

    @property
    def noise(self) -> NavNoise:
        """Standard deviations of the sensors."""
        own = self.spec.sensors
        return NavNoise(own.position_noise, own.angle_noise, own.velocity_noise, own.rate_noise)

    def _vehicle_setup(self, i: int) -> VehicleSetup:
        (eta0, nu0), control, size = self.initial[i - 1], self.controls[i - 1], self.layout(i).size
        plant = None
        if (section := control.plant) is not None:
            rolls = initial_rolls(self.spec.initial, self.vehicles)
            file = str(file_of(section.name) or "")
            plant = PlantSetup(section.name, section.parameters or {}, section.budget / 1e9, *rolls[i - 1], file)
        limit = control.tumble_limit
        if self.spec.moored:
            nu0 = (0.0, 0.0, 0.0, 0.0, 0.0)
        return VehicleSetup(i, eta0, nu0, control.vehicle, control.tau_max, limit, size, plant, control.navigation)

    def belief(self, i: int) -> BeliefKind:
        """The kind of belief that vehicle i has about its place."""
        return BeliefKind.of(self.controls[i - 1].navigation)

    def plant_signals(self, i: int) -> tuple[Signal, ...] | None:
        """The signals of vehicle i's plant; None: it has none. Raises PluginError: it cannot be used."""
        return self.controls[i - 1].plant_signals()

    def layout(self, i: int) -> SignalLayout:
        """The signals of agent i. Raises PluginError: one of its laws cannot be used."""
        if i not in self._layouts and self.nodes:
            self._layouts[i] = node_layout(self.spec, i)
        if i not in self._layouts:  # one by one: another agent's laws may be such as must not be imported
            self._layouts[i] = layout(self.agent_config(i))
        return self._layouts[i]

    def agent_config(self, i: int) -> AgentConfig:
        """The configuration of agent i, counted from 1."""
        return self._agent_configs[i - 1]

    @cached_property
    def _agent_configs(self) -> tuple[AgentConfig, ...]:
        return tuple(self._agent_config(i) for i in range(1, self.vehicles + 1))

    def _agent_config(self, i: int) -> AgentConfig:
        spec, own, control = self.spec, self.plans[i - 1], self.controls[i - 1]
        standby = self.standby_for(i)
        return AgentConfig(
            id=i,
            seed=spec.seed,
            tick_ns=spec.tick,
            round_ticks=self.round_ticks,
            offset=own,
            reference=self.reference if control.knows_reference or self.b[i - 1] or standby else None,
            reference_weight=self.b[i - 1],
            neighbours=tuple(
                Neighbour(id=j, weight=weight, offset=_difference(own, self.plans[j - 1]))
                for j, weight in self.graph.neighbours(i)
            ),
            extrapolation=control.extrapolation,
            age_cap_s=control.age_cap_s,
            drop_after_s=control.drop_after_s,
            guidance=replace(control.guidance, solver="exact") if self.exact_gains else control.guidance,
            tracking=control.tracking,
            vehicle=control.model,
            tau_max=control.tau_max,
            guidance_law=control.guidance_law,
            tracking_law=control.tracking_law,
            controller=control.controller,
            agent=control.agent and with_whole_path(control.agent),
            on_error=spec.on_controller_error,
            budget_s=spec.controller_budget / 1e9,
            codec=spec.network.payload,
            standby_for=standby,
            standby_after_s=0.0 if spec.graph.standby is None else spec.graph.standby.after / 1e9,
            keep_apart=control.keep_apart,
            localization=control.localization,
            moored=bool(spec.moored),
        )

    def standby_for(self, i: int) -> tuple[int, ...]:
        """The neighbours whose silence makes vehicle i follow the reference itself; none if it is not on standby."""
        standby = self.spec.graph.standby
        if standby is None or i not in vehicle_numbers(standby.vehicles):
            return ()
        return tuple(j for j, _ in self.graph.neighbours(i) if self.b[j - 1])

    @cached_property
    def netem_config(self) -> NetemConfig:
        """The configuration of the network."""
        return NetemConfig(
            seed=self.seed,
            tick_ns=self.tick_ns,
            round_ticks=self.round_ticks,
            vehicles=tuple(range(1, self.vehicles + 1)),
            links=self.graph.links,
            conditions=dict(self.conditions),
            changing=dict(self.changing),
            faults=self.faults.network,
            absences=self.faults.absences,
            ideal=self.ideal,
            acoustic=self.acoustic,
            clocks=dict(self.clocks),
            radios=dict(self.radios),
        )

    def to_yaml(self) -> str:
        """The record of this run: the merged scenario, with units and all faults; it loads to an equal scenario.

        With another seed it has the same faults: for that there are `loading.with_overrides` and `to_undrawn_yaml`.
        """
        return scenario_yaml.scenario_yaml(self.spec)

    def to_undrawn_yaml(self) -> str:
        """The text for other processes that make runs with other seeds: the scenario before its nemesis drew faults."""
        return scenario_yaml.scenario_yaml(self.undrawn)


def _others(controls: Iterable[Control]) -> tuple[tuple[str, Law], ...]:
    others: dict[str, tuple[str, Law]] = {}
    for kind, law in (running for control in controls for running in laws(control).items()):
        if law.name not in BUILT_IN[kind]:
            others.setdefault(law.name, (kind, law))
    return tuple(others.values())


def _inline_files(spec: ScenarioSpec, parts: Parts) -> ScenarioSpec:
    """The same specification, with what a user's files of vehicles, modems and traces hold in place of the files."""
    folder = parts.folder

    def in_numbers(section: VehicleSection | None) -> VehicleSection | None:
        if section is None or (section.model is None and section.plant is None):
            return section
        if (model := model_name(section)) in shipped_vehicles():
            return section.model_copy(update={"model": model})
        return inlined_vehicle(section, folder)

    per_vehicle = {
        numbers: overrides.model_copy(
            update={
                "vehicle": in_numbers(overrides.vehicle),
                "navigation": inlined_navigation(overrides.navigation, folder),
            }
        )
        for numbers, overrides in spec.per_vehicle.items()
    }
    network, acoustic = spec.network, spec.network.acoustic
    if acoustic is not None:
        own = [section for section in (acoustic, *acoustic.modems.values()) if section.modem not in shipped_modems()]
        others = {n: inlined_modem(s, folder) if s in own else s for n, s in acoustic.modems.items()}
        acoustic = inlined_modem(acoustic, folder) if acoustic in own else acoustic
        if own:
            network = network.model_copy(update={"acoustic": acoustic.model_copy(update={"modems": others})})
    traced = {name: link for name, link in network.links.items() if link.trace is not None}
    if traced:
        inside = {n: s.model_copy(update={"trace": parts.traces(s.trace or "").text()}) for n, s in traced.items()}
        network = network.model_copy(update={"links": network.links | inside})
    programs = spec.programs and {
        key: section.model_copy(update={"folder": str(Path(folder or "", section.folder or "").resolve())})
        for key, section in spec.programs.items()
    }
    nodes = spec.nodes and {
        name: node.model_copy(update={"zenoh": node.zenoh and str(Path(folder or "", node.zenoh).resolve())})
        for name, node in spec.nodes.items()
    }
    compose = spec.compose and str(Path(folder or "", spec.compose).resolve())
    changes = {"vehicle": in_numbers(spec.vehicle), "navigation": inlined_navigation(spec.navigation, folder)}
    more = {"per_vehicle": per_vehicle, "network": network, "nodes": nodes, "programs": programs, "compose": compose}
    return spec.model_copy(update=changes | more)


def _difference(a: Offset, b: Offset) -> Offset:
    """a - b; both change at the same times."""
    changes = zip(a.changes, b.changes, strict=True)
    return Offset(
        minus(a.start, b.start), tuple(OffsetChange(x.begin, x.blend, minus(x.offset, y.offset)) for x, y in changes)
    )


def timeline(scenario: Scenario) -> list[FaultInterval]:
    """Each fault that is planned, in the order of their beginnings."""
    tick_s, events = scenario.tick_ns / 1e9, scenario.faults.events
    ends = {event.fault: event.tick for event in events if event.action == "ends"}
    return [
        FaultInterval(e.fault, e.tick * tick_s, ends[e.fault] * tick_s, e.what, e.entry)
        for e in events
        if e.action == "begins"
    ]


def fault_line(fault: FaultInterval) -> str:
    """A fault and its times in words."""
    return f"fault from {fault.begin:g} to {fault.end:g} s: {fault.what} (id {fault.id})"


def timeline_lines(scenario: Scenario, most: int | None = None) -> list[str]:
    """The same in words, a line each; with `most`, no more lines, and one that says how many are left out."""
    found = timeline(scenario)
    waiting = trigger_lines(scenario.spec.triggers, scenario.spec)
    lines = [fault_line(fault) for fault in found[:most]]
    more = [] if len(lines) == len(found) else [f"... and {len(found) - len(lines)} more faults"]
    return [*lines, *more, *waiting]


def frame_every(scenario: Scenario) -> int:
    """Ticks between the frames that the log needs: the greatest common divisor of its rates."""
    return gcd(*scenario.log_every.values())
