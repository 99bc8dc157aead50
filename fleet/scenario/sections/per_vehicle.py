"""Each vehicle's configuration: its data, laws and parameters, from the profile, the scenario and `per_vehicle`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import reduce
from pathlib import Path
from typing import Any

from agents.config import Extrapolation, GuidanceParams, KeepApartParams, Law, LocalizationParams, TrackingParams
from agents.controllers import CONTROLLERS, GUIDANCE, TRACKING
from agents.profiles import profile
from fleet.scenario.schema.control import (
    AgentSection,
    GuidanceSection,
    LawSection,
    TrackingSection,
    VehicleOverrides,
)
from fleet.scenario.schema.gateway import GatewaySection
from fleet.scenario.schema.navigation import NavigationSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.schema.vehicle import ModelErrorSection, PlantSection, VehicleSection
from fleet.scenario.sections.navigation import navigation_over
from fleet.scenario.sections.vehicle_files import LIMITS, PARAMETERS, load_vehicle
from fleet.scenario.value_types import Section
from world.navigation.config import Navigation
from world.plants.classes import model_of, signals_of
from world.signal import Signal
from world.tumble import LIMIT_RAD
from world.vectors import Vec3
from world.vehicle_params import VehicleParams

# The profiles count the QP's period in ticks of this length; a scenario with another tick keeps the period.
_PROFILE_TICK_NS = 10_000_000

_NAMES = {"qp_period": "qp_ticks", "horizon": "horizon_s"}  # scenario key -> parameter
_TIMES = ("horizon", "tau_f")  # ns in a scenario, s in parameters

Entries = tuple[str, ...]  # keys of per_vehicle


@dataclass(frozen=True, slots=True)
class Control:
    """The data, laws and parameters of one vehicle."""

    agent: Law | None  # a user's; it may use the laws below
    controller: Law | None  # a user's
    guidance_law: Law
    tracking_law: Law
    guidance: GuidanceParams
    tracking: TrackingParams
    extrapolation: Extrapolation
    age_cap_s: float
    drop_after_s: float
    vehicle: VehicleParams  # the truth; of a vehicle with a plant, what is nearest to it
    plant: PlantSection | None  # none: it moves by these parameters
    model: VehicleParams  # what the controller believes
    tau_max: Vec3  # N, N m, N m
    tumble_limit: float  # |pitch| beyond which it tumbles [rad]
    external: bool  # its agent joins the run from outside
    gateway: GatewaySection | None  # what stands for a real computer, and joins; None: somebody else starts the agent
    knows_reference: bool  # also if it does not follow it
    keep_apart: KeepApartParams | None  # one filter holds for all vehicles
    navigation: Navigation | None  # None: it knows where it is
    localization: LocalizationParams | None  # None: it uses no ranges

    def plant_signals(self) -> tuple[Signal, ...] | None:
        """The signals of its plant; None: it has none. Raises PluginError: it cannot be used."""
        return None if self.plant is None else signals_of(self.plant.name, self.plant.parameters or {})

    @property
    def cascade(self) -> bool:
        """Whether a guidance and a tracking law run."""
        return self.agent is None and self.controller is None


def merge_overrides(spec: ScenarioSpec, entries: Entries) -> VehicleOverrides:
    """Every section that may be per vehicle, as it holds for the vehicles that these entries of `per_vehicle` name."""
    layers = [VehicleOverrides.model_construct(**{key: getattr(spec, key) for key in VehicleOverrides.model_fields})]
    layers += [overrides for entry, overrides in spec.per_vehicle.items() if entry in entries]
    return reduce(_override, layers)


def _override(below: VehicleOverrides, above: VehicleOverrides) -> VehicleOverrides:
    values: dict[str, Any] = {}
    for key in VehicleOverrides.model_fields:
        low, high = getattr(below, key), getattr(above, key)
        if high is None:
            values[key] = low
        elif low is None or isinstance(high, (str, bool, LawSection)):
            values[key] = high
        elif isinstance(high, AgentSection):
            values[key] = _override_agent(low, high)
        elif isinstance(high, VehicleSection) and (high.model is not None or high.plant is not None):
            values[key] = high  # another vehicle, not this one with some of its numbers
        elif isinstance(high, NavigationSection):
            values[key] = navigation_over(low, high)
        else:
            # What was written, not what has a default: a vehicle's own timeout leaves its extrapolation alone.
            written = {name: value for name, value in given_values(high).items() if name in high.model_fields_set}
            if "law" in written:
                written.setdefault("parameters", None)  # parameters of a section below belong to the law there
            values[key] = low.model_copy(update=written)
    # A controller chosen here replaces the agent and the laws that were chosen below it.
    if above.controller is not None:
        if above.whole_agent is None:
            below_it = values["agent"] or AgentSection()
            kept = AgentSection(clock=below_it.clock, localization=below_it.localization)
            values["agent"] = None if kept == AgentSection() else kept
        for key in ("guidance", "tracking"):
            section = getattr(above, key)
            if section is None or section.law is None:
                values[key] = values[key].model_copy(update={"law": None, "parameters": None})
    return VehicleOverrides.model_construct(**values)


def _override_agent(below: AgentSection, above: AgentSection) -> AgentSection:
    """An agent over another, and what is written of its clock over that of the other's."""
    law = above if above.law is not None else below
    low, high = below.clock, above.clock
    if low is not None and high is not None:
        high = low.model_copy(update=given_values(high))
    return law.model_copy(update={"clock": high or low, "localization": above.localization or below.localization})


def law_names(choice: VehicleOverrides) -> tuple[str, str] | None:
    """The guidance and the tracking law of a choice, which a whole agent may use, too; None: a controller instead."""
    assert choice.controller is not None and choice.guidance is not None and choice.tracking is not None
    pair = CONTROLLERS.get(choice.controller.law)
    if pair is None and not (choice.guidance.law and choice.tracking.law):
        return None
    guidance, tracking = (pair.guidance, pair.tracking) if pair else ("", "")
    return choice.guidance.law or guidance, choice.tracking.law or tracking


def control(
    choice: VehicleOverrides,
    tick_ns: int,
    vehicle: tuple[VehicleParams, Vec3],
    keep_apart: KeepApartParams | None,
    navigation: Navigation | None,
) -> Control:
    """The data, laws and parameters of a vehicle of a valid scenario; `vehicle`: parameters, limits [N, N m, N m]."""
    assert choice.controller is not None and choice.guidance is not None and choice.tracking is not None
    assert choice.neighbours is not None and choice.vehicle is not None and choice.model_error is not None
    names = law_names(choice)
    name, (guidance_name, tracking_name) = choice.profile or "paper", names or ("optimal", "neurodynamic")
    # At least 1: where no QP runs, nothing asks that the tick divides its period, or is no longer.
    qp_ticks = max(1, qp_period_ns(name, choice.guidance, tick_ns) // tick_ns)
    (params, tau_max), ranges = vehicle, choice.localization
    return Control(
        agent=_law(choice.whole_agent),
        controller=_law(choice.controller) if names is None else None,
        guidance_law=Law(guidance_name, choice.guidance.parameters or {}),
        tracking_law=Law(tracking_name, choice.tracking.parameters or {}),
        guidance=replace(
            profile(name, guidance=guidance_name)[0], **_tuned_values(choice.guidance) | {"qp_ticks": qp_ticks}
        ),
        tracking=replace(profile(name, tracking=tracking_name)[1], **_tuned_values(choice.tracking)),
        extrapolation=choice.neighbours.extrapolate,
        age_cap_s=choice.neighbours.age_cap / 1e9,
        drop_after_s=choice.neighbours.drop_after / 1e9,
        vehicle=params,
        plant=choice.vehicle.plant,
        model=wrong_model(params, choice.model_error),
        tau_max=tau_max,
        tumble_limit=choice.vehicle.tumble_pitch or LIMIT_RAD,
        external=bool(choice.external) or choice.gateway is not None,
        gateway=choice.gateway,
        knows_reference=choice.knows_reference is not False,
        keep_apart=keep_apart,
        navigation=navigation,
        localization=None if ranges is None else LocalizationParams(**ranges.model_dump()),
    )


def _law(section: LawSection | AgentSection | None) -> Law | None:
    return None if section is None or section.law is None else Law(section.law, section.parameters or {})


def vehicle(section: VehicleSection, folder: Path | None) -> tuple[VehicleParams, Vec3]:
    """The parameters of a vehicle and its limits [N, N m, N m]. Raises DataFileError."""
    model = load_vehicle(model_name(section), folder)
    changes = given_values(section)
    params = replace(model.params, **{key: changes[key] for key in PARAMETERS.keys() & changes.keys()})
    x, y, z = (
        limit if getattr(section, key) is None else getattr(section, key)
        for key, limit in zip(LIMITS, model.tau_max, strict=True)
    )
    return params, (x, y, z)


def model_name(section: VehicleSection) -> str:
    """The model of a vehicle: the named one, else that of its plant, else the paper's."""
    plant = section.plant
    brought = model_of(plant.name, plant.parameters or {}) if plant is not None and section.model is None else None
    return section.model or brought or "paper"


def wrong_model(params: VehicleParams, errors: ModelErrorSection) -> VehicleParams:
    """The parameters with each error applied: (1 + error) times the truth."""
    return replace(params, **{key: getattr(params, key) * (1.0 + error) for key, error in given_values(errors).items()})


def qp_period_ns(name: str, section: GuidanceSection, tick_ns: int) -> int:
    """The time between two optimisations of the gains; a profile's is at least a tick."""
    return section.qp_period or max(profile(name)[0].qp_ticks * _PROFILE_TICK_NS, tick_ns)


def given_values(section: Section) -> dict[str, Any]:
    """The values that a section sets."""
    return {key: value for key, value in section if value is not None}


def _tuned_values(section: Section) -> dict[str, Any]:
    """The parameters that a section sets, but for the period of the QP."""
    values = {
        key: value for key, value in given_values(section).items() if key not in ("law", "parameters", "qp_period")
    }
    return {_NAMES.get(key, key): value / 1e9 if key in _TIMES else value for key, value in values.items()}


def guidance_section(params: GuidanceParams, law: str, tick_ns: int) -> GuidanceSection:
    """Every parameter that a law uses, as a scenario would give it."""
    values = _shown_values(GuidanceSection, "guidance", params, law)
    return GuidanceSection.model_construct(
        **{key: value * tick_ns if key == "qp_period" else value for key, value in values.items()}
    )


def tracking_section(params: TrackingParams, law: str) -> TrackingSection:
    """Every parameter that a law uses, as a scenario would give it."""
    return TrackingSection.model_construct(**_shown_values(TrackingSection, "tracking", params, law))


def _shown_values(
    section: type[Section], kind: str, params: GuidanceParams | TrackingParams, law: str
) -> dict[str, Any]:
    keys = sorted(used_keys(kind, law).intersection(section.model_fields), key=[*section.model_fields].index)
    values = {key: getattr(params, _NAMES.get(key, key)) for key in sorted(keys, key=_NAMES.__contains__)}
    return {key: round(value * 1e9) if key in _TIMES else value for key, value in values.items()}


def used_keys(kind: str, law: str) -> frozenset[str]:
    """The scenario keys that a built-in law uses; all of them for a law of the user's."""
    laws: dict[str, Any] = {"guidance": GUIDANCE, "tracking": TRACKING}[kind]  # type: ignore[assignment]
    params = GuidanceParams if kind == "guidance" else TrackingParams
    names: Iterable[str] = laws[law].uses if law in laws else (f.name for f in fields(params))
    back = {parameter: key for key, parameter in _NAMES.items()}
    return frozenset(back.get(name, name) for name in names)


def inlined_vehicle(section: VehicleSection, folder: Path | None) -> VehicleSection:
    """The same vehicle with all its numbers in place of the name of its file."""
    params, limits = vehicle(section, folder)
    values: dict[str, Any] = {key: getattr(params, key) for key in PARAMETERS}
    values |= zip(LIMITS, limits, strict=True)
    values |= {"tumble_pitch": section.tumble_pitch, "plant": section.plant}
    return VehicleSection.model_construct(**values)
