"""The consequences of a specification: graph, reference, offsets, laws, faults; each is computed once.

The rules look at these parts while the specification may still hold mistakes, and a valid scenario is made of them.
A part that depends on a wrong value raises `UnknownValueError`: the mistake itself is reported elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, cached_property, partial
from pathlib import Path

from agents.config import Cylinder, KeepApartParams
from agents.offset import Offset
from agents.trajectory import Reference
from fleet.errors import FleetError
from fleet.quantities import vehicle_numbers
from fleet.scenario.schema.control import GuidanceSection, VehicleOverrides
from fleet.scenario.schema.keep_apart import KeepApartSection
from fleet.scenario.schema.motion import (
    REFERENCE,
)
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections import formation, graph, link_conditions, nemesis, per_vehicle, reference, timeline
from fleet.scenario.sections.acoustic import compile_acoustic, modem_values
from fleet.scenario.sections.clocks import vehicle_clock
from fleet.scenario.sections.graph import Graph
from fleet.scenario.sections.modem_files import Values, modem_of
from fleet.scenario.sections.navigation import navigation_of
from fleet.scenario.sections.nemesis_targets import NemesisTargets, instruments
from fleet.scenario.sections.per_vehicle import Control, Entries
from fleet.scenario.sections.trace_table import TraceTable, load_trace
from netem.condition import Condition, Link
from netem.link_selector import parse_selector, select
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace
from netem.modem import AcousticConfig, Modem
from netem.vehicle_clock import VehicleClock
from world.vectors import Vec3, Vec5
from world.vehicle_params import VehicleParams


class UnknownValueError(FleetError):
    """A value of the scenario cannot be computed, because another value that it depends on is wrong."""


class Parts:
    """The parts of one specification. `UnknownValueError` may come from each of them until the specification is valid.

    Args:
        spec: the specification; reading a wrong value of it raises UnknownValueError.
        folder: where the scenario's file lies; files of vehicles and modems are looked for there first.
    """

    def __init__(self, spec: ScenarioSpec, folder: Path | None = None) -> None:
        self.spec = spec
        self.folder = folder
        self._choices: dict[Entries, VehicleOverrides] = {}
        self._vehicles: dict[Entries, tuple[VehicleParams, Vec3]] = {}

    @cached_property
    def reference(self) -> Reference:
        """The reference trajectory; its length may still raise PathError."""
        section = self.spec.reference
        if any(getattr(section, key) is None for key in REFERENCE[section.shape or "line"].needed):
            raise UnknownValueError
        return reference.build(section)

    @cached_property
    def plans(self) -> tuple[Offset, ...]:
        """p_i(t) of each vehicle [m, NED]."""
        section, vehicles = self.spec.formation, self.spec.vehicles
        shapes = [section, *(section.changes or ())]
        if any((f.offsets is None) == (f.shape is None) for f in shapes):
            raise UnknownValueError
        if any(f.offsets is not None and len(f.offsets) != vehicles for f in shapes):
            raise UnknownValueError
        return formation.plans(section, vehicles)

    @cached_property
    def initial(self) -> tuple[tuple[Vec5, Vec5], ...]:
        """(eta0, nu0) of each vehicle."""
        places = tuple(plan.start for plan in self.plans)
        return formation.initial_states(self.spec.initial, places, self.reference.at(0.0), self.spec.seed)

    @cached_property
    def graph(self) -> Graph:
        """The communication graph."""
        section = self.spec.graph
        if (section.edges is None) == (section.shape is None):
            raise UnknownValueError
        if any(graph.parse_edge(text) is None for text in section.edges or ()):
            raise UnknownValueError
        # Only these two shapes depend on places and on the seed, which may be wrong.
        places = tuple(plan.start for plan in self.plans) if section.shape == "nearest" else None
        seed = self.spec.seed if section.shape == "random" else 0
        return graph.build(section, places or ((0.0, 0.0, 0.0),) * self.spec.vehicles, seed)

    @property
    def links(self) -> tuple[Link, ...]:
        """The links of the graph."""
        return self.graph.links

    @cached_property
    def conditions(self) -> dict[Link, Condition]:
        """The condition of every link that is not perfect at the start, in the order of the links."""
        given = {link: self.spec.network.links[selector].condition for link, selector in self.selectors.items()}
        return {link: c for link, c in given.items() if c is not None and c != Condition()}

    @property
    def radios(self) -> dict[int, Condition]:
        """The radio of each vehicle that has one: a rate, and a limit of its queue."""
        given = self.spec.network.radios.items()
        return {i: radio for numbers, radio in given for i in vehicle_numbers(numbers)}

    @cached_property
    def selectors(self) -> dict[Link, str]:
        """The last selector that names each link, in the order of the links; links that none names are left out."""
        last: dict[Link, str] = {}
        for selector in self.spec.network.links:
            last |= dict.fromkeys(select(parse_selector(selector), self.links), selector)
        return {link: last[link] for link in self.links if link in last}

    @cached_property
    def changing(self) -> dict[Link, LinkStates | LinkTrace]:
        """The condition of each link that changes by itself. Raises DataFileError: a trace cannot be read."""
        made = {
            selector: link_conditions.changing(selector, self.spec.network.links[selector], self.traces)
            for selector in dict.fromkeys(self.selectors.values())
        }
        found = {link: made[selector] for link, selector in self.selectors.items()}
        return {link: changing for link, changing in found.items() if changing is not None}

    @cached_property
    def traces(self) -> Callable[[str], TraceTable]:
        """The trace of some links by what the scenario names; each is read once."""
        return cache(partial(load_trace, folder=self.folder))

    @cached_property
    def modem_values(self) -> Values:
        """The values of the modem, which may make none. Raises DataFileError: its file cannot be read."""
        assert self.spec.network.acoustic is not None
        return modem_values(self.spec.network.acoustic, self.folder)

    @cached_property
    def modem(self) -> Modem:
        """The modem, if its values make one. Raises DataFileError: its file cannot be read."""
        return modem_of(self.modem_values)

    @cached_property
    def acoustic(self) -> AcousticConfig | None:
        """The acoustic channel; None without one. Raises DataFileError: a modem's file cannot be read."""
        spec, section = self.spec, self.spec.network.acoustic
        if section is None:
            return None
        others = {
            i: modem_of(modem_values(other, self.folder))
            for numbers, other in section.modems.items()
            for i in vehicle_numbers(numbers)
        }
        return compile_acoustic(
            section, self.modem, spec.network.payload, spec.vehicles, spec.tick, others, self.folder
        )

    @cached_property
    def _named(self) -> dict[str, frozenset[int]]:
        return {entry: frozenset(vehicle_numbers(entry)) for entry in self.spec.per_vehicle}

    def entries(self, i: int) -> Entries:
        """The keys of `per_vehicle` that name vehicle i; none name 0, a vehicle that has nothing of its own."""
        return tuple(entry for entry, vehicles in self._named.items() if i in vehicles)

    def choice(self, entries: Entries) -> VehicleOverrides:
        """Every section that may be per vehicle, as it holds for the vehicles that these entries name."""
        if entries not in self._choices:
            self._choices[entries] = per_vehicle.merge_overrides(self.spec, entries)
        return self._choices[entries]

    def choices(self) -> Iterator[tuple[Entries, VehicleOverrides]]:
        """Entries and choice, once for all vehicles that the same entries name; first without any entry.

        Of a moored fleet only what some vehicle runs counts: none of our laws is there to be right or wrong.
        """
        first = 1 if self.spec.moored else 0
        for entries in dict.fromkeys(self.entries(i) for i in range(first, self.spec.vehicles + 1)):
            yield entries, self.choice(entries)

    def guidance(self) -> Iterator[tuple[Entries, str, GuidanceSection, str]]:
        """(entries, law, section, profile) of the choices that certainly give a guidance law a vehicle."""
        for entries, choice in self.choices():
            names = per_vehicle.law_names(choice)
            if names is not None and choice.whole_agent is None:
                assert choice.guidance is not None and choice.profile is not None
                yield entries, names[0], choice.guidance, choice.profile

    def vehicle(self, entries: Entries) -> tuple[VehicleParams, Vec3]:
        """Parameters and limits [N, N m, N m] of the vehicles that these entries name.

        Raises DataFileError: their model cannot be read.
        """
        if entries not in self._vehicles:
            section = self.choice(entries).vehicle
            assert section is not None
            self._vehicles[entries] = per_vehicle.vehicle(section, self.folder)
        return self._vehicles[entries]

    @cached_property
    def controls(self) -> tuple[Control, ...]:
        """The vehicle, laws and parameters of each vehicle. Raises DataFileError: a model cannot be read."""
        tick, apart = self.spec.tick, keep_apart_params(self.spec.keep_apart)
        made = {
            e: per_vehicle.control(choice, tick, self.vehicle(e), apart, navigation_of(choice.navigation, self.folder))
            for e, choice in self.choices()
        }
        return tuple(made[self.entries(i)] for i in range(1, self.spec.vehicles + 1))

    @cached_property
    def clocks(self) -> dict[int, VehicleClock]:
        """The clocks of the vehicles that have one in the scenario."""
        given = ((i, self.choice(self.entries(i)).clock) for i in range(1, self.spec.vehicles + 1))
        return {i: vehicle_clock(clock, self.spec.seed, i) for i, clock in given if clock is not None}

    @cached_property
    def targets(self) -> NemesisTargets:
        """The parts of the scenario that a nemesis acts on."""
        nemesis = self.spec.nemesis
        if nemesis is not None and nemesis.mode is None and (nemesis.every is None or nemesis.for_ is None):
            raise UnknownValueError
        has = {i: instruments(self.choice(self.entries(i))) for i in range(1, self.spec.vehicles + 1)}
        clocks, navigators, fixed = (tuple(i for i, each in has.items() if each[k]) for k in range(3))
        return NemesisTargets(self.spec, self.links, self.conditions, clocks, navigators, fixed)

    @cached_property
    def explicit(self) -> ScenarioSpec:
        """The specification with the faults that its nemesis draws written out after its own."""
        return self.spec if self.spec.nemesis is None else nemesis.explicit(self.targets)

    @cached_property
    def faults(self) -> timeline.FaultPlan:
        """Every fault, for the cores; the faults must be valid."""
        return timeline.plan(self.explicit, self.links)


def keep_apart_params(section: KeepApartSection | None) -> KeepApartParams | None:
    """Its parameters in SI units; None without the section."""
    if section is None:
        return None
    return KeepApartParams(
        distance=section.distance,
        obstacles=tuple(Cylinder(*obstacle.at, obstacle.radius) for obstacle in section.obstacles),
        gain=section.gain,
        lag_s=section.lag / 1e9,
        slew=section.slew,
        acceleration=section.acceleration,
        speed=section.speed,
        climb=section.climb,
        age_cap_s=section.age_cap / 1e9,
    )
