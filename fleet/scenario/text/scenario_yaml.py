"""A scenario as text: the merged values, with units, in the order of the schema.

Values that the profile supplies stand as comments under their section. Written as keys they would silence a
later `--set profile=...`, because an explicit value wins over the profile.
"""

from __future__ import annotations

from typing import Any

from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.schema.vehicle import VehicleSection
from fleet.scenario.sections import per_vehicle
from fleet.scenario.sections.vehicle_files import LIMITS
from fleet.scenario.text.nodes import vehicles_to_nodes
from fleet.scenario.text.yaml_writer import entry, scalar


def scenario_yaml(spec: ScenarioSpec) -> str:
    """The text of a scenario; values that its profile and its vehicle's model supply are comments."""
    values = spec.model_dump(exclude_none=True, by_alias=True)
    values["per_vehicle"] = _per_vehicle(spec)
    values["faults"] = [
        fault.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True) for fault in spec.faults
    ]
    values["triggers"] = [
        trigger.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True) for trigger in spec.triggers
    ]
    for key in ("per_vehicle", "model_error", "faults", "triggers"):
        if not values[key]:
            del values[key]
    if values["expect"] == "pass":
        del values["expect"]
    if spec.nodes is not None:
        values = vehicles_to_nodes(values)
    lines: list[str] = []
    supplied = {} if spec.nodes is not None else _supplied_values(spec)
    for key, value in values.items():
        lines += entry(key, value, 0) if value != {} else [f"{key}:"]
        origin, given = supplied.get(key, ("", {}))
        rest = {k: v for k, v in given.items() if k not in value and v is not None}
        if rest:
            lines.append(f"  # from {origin}:")
            lines += [f"  # {k}: {scalar(v)}" for k, v in rest.items()]
    return "\n".join(lines) + "\n"


def short_yaml(spec: ScenarioSpec) -> str:
    """The text of a scenario with nothing that is so anyway, for people. Versions may differ in what that is."""
    values = spec.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True)
    values["per_vehicle"] = _per_vehicle(spec)
    values = vehicles_to_nodes(values) if spec.nodes is not None else values
    return "\n".join(line for key, value in values.items() if value != {} for line in entry(key, value, 0)) + "\n"


def _per_vehicle(spec: ScenarioSpec) -> dict[str, Any]:
    """What some vehicles have otherwise, as it was given."""
    return {
        numbers: overrides.model_dump(exclude_none=True, exclude_unset=True, by_alias=True)
        for numbers, overrides in spec.per_vehicle.items()
    }


def _supplied_values(spec: ScenarioSpec) -> dict[str, tuple[str, dict[str, Any]]]:
    """The values that profile and model supply: section -> (origin, values), for vehicles without own entries."""
    supplied: dict[str, tuple[str, dict[str, Any]]] = {}
    model = VehicleSection(model=spec.vehicle.model or "paper")
    if set(per_vehicle.given_values(spec.vehicle)) <= {"model", "plant", "tumble_pitch", *LIMITS}:
        supplied["vehicle"] = f"vehicle {model.model}", per_vehicle.inlined_vehicle(model, None).model_dump()
    choice = per_vehicle.merge_overrides(spec, ())
    names = per_vehicle.law_names(choice)
    if names is not None:
        guidance, tracking = names
        profile = f"profile {spec.profile}"
        params = per_vehicle.control(choice, spec.tick, per_vehicle.vehicle(spec.vehicle, None), None, None)
        shown_guidance = per_vehicle.guidance_section(params.guidance, guidance, spec.tick).model_dump()
        shown_tracking = per_vehicle.tracking_section(params.tracking, tracking).model_dump()
        supplied["guidance"] = f"{profile}, law {guidance}", shown_guidance
        supplied["tracking"] = f"{profile}, law {tracking}", shown_tracking
    return supplied
