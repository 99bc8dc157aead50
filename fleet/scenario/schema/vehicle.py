"""The data of a vehicle, and the errors of its controller's model of it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from fleet.scenario.schema.value_types import (
    AnyMoment,
    Damping,
    Force,
    Inertia,
    Mass,
    Moment,
    PitchLimit,
    Ratio,
    RotationDamping,
    Section,
    Time,
)

DEFAULT_BUDGET_NS = 10_000_000_000


class PlantSection(Section):
    """A vehicle with equations of its own: a plant by name, `package.module:Class` or entry point; see world.api."""

    name: str
    parameters: dict[str, Any] | None = None
    budget: Time = DEFAULT_BUDGET_NS  # wall time that it may take for a tick; 0: any


def _read_plant(value: Any) -> Any:
    """A plant may be given by its name alone."""
    return {"name": value} if isinstance(value, str) else value


def _show_plant(section: PlantSection | None) -> Any:
    if section is None:
        return None
    values = section.model_dump(exclude_defaults=True)
    return section.name if set(values) == {"name"} else values


PlantChoice = Annotated[PlantSection, BeforeValidator(_read_plant), PlainSerializer(_show_plant)]


class VehicleSection(Section):
    """The vehicle: a model, shipped or a TOML file, and what differs from it. Commands are clipped to the limits.

    With a plant the vehicle moves by equations of its own, and the model is what its controllers know of it.
    """

    plant: PlantChoice | None = None  # none: it moves by the equations of the 5-DOF model
    model: str | None = None  # that of the plant, or paper
    m: Mass | None = None
    Iy: Inertia | None = None
    Iz: Inertia | None = None
    beta_udot: Mass | None = None
    beta_vdot: Mass | None = None
    beta_wdot: Mass | None = None
    beta_qdot: Inertia | None = None
    beta_rdot: Inertia | None = None
    beta_u: Damping | None = None
    beta_v: Damping | None = None
    beta_w: Damping | None = None
    beta_q: RotationDamping | None = None
    beta_r: RotationDamping | None = None
    beta_b: AnyMoment | None = None
    surge_force: Force | None = None
    pitch_moment: Moment | None = None
    yaw_moment: Moment | None = None
    tumble_pitch: PitchLimit | None = None  # |pitch| beyond which it tumbles; 80 deg


class ModelErrorSection(Section):
    """By how much the controller's model of the vehicle is wrong, per parameter: 10 % is 1.1 times the truth."""

    m: Ratio | None = None
    Iy: Ratio | None = None
    Iz: Ratio | None = None
    beta_udot: Ratio | None = None
    beta_vdot: Ratio | None = None
    beta_wdot: Ratio | None = None
    beta_qdot: Ratio | None = None
    beta_rdot: Ratio | None = None
    beta_u: Ratio | None = None
    beta_v: Ratio | None = None
    beta_w: Ratio | None = None
    beta_q: Ratio | None = None
    beta_r: Ratio | None = None
    beta_b: Ratio | None = None
