"""The data of a vehicle, and the errors of its controller's model of it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import PlainSerializer

from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section, word_for

DEFAULT_BUDGET_NS = 10_000_000_000


class PlantSection(Section):
    """A vehicle with equations of its own: a plant by name, `package.module:Class` or entry point; see world.api."""

    name: str
    parameters: dict[str, Any] | None = None
    budget: v.Time = DEFAULT_BUDGET_NS  # wall time that it may take for a tick; 0: any


def _show_plant(section: PlantSection | None) -> Any:
    values = section and section.model_dump(exclude_defaults=True)
    return values["name"] if values and set(values) == {"name"} else values


PlantChoice = Annotated[PlantSection, word_for("name"), PlainSerializer(_show_plant)]


class VehicleSection(Section):
    """The vehicle: a model, shipped or a TOML file, and what differs from it. Commands are clipped to the limits.

    With a plant the vehicle moves by equations of its own, and the model is what its controllers know of it.
    """

    plant: PlantChoice | None = None  # none: it moves by the equations of the 5-DOF model
    model: str | None = None  # default: the model of the plant, or paper
    m: v.Mass | None = None
    Iy: v.Inertia | None = None
    Iz: v.Inertia | None = None
    beta_udot: v.Mass | None = None
    beta_vdot: v.Mass | None = None
    beta_wdot: v.Mass | None = None
    beta_qdot: v.Inertia | None = None
    beta_rdot: v.Inertia | None = None
    beta_u: v.Damping | None = None
    beta_v: v.Damping | None = None
    beta_w: v.Damping | None = None
    beta_q: v.RotationDamping | None = None
    beta_r: v.RotationDamping | None = None
    beta_b: v.AnyMoment | None = None
    surge_force: v.Force | None = None
    pitch_moment: v.Moment | None = None
    yaw_moment: v.Moment | None = None
    tumble_pitch: v.PitchLimit | None = None  # |pitch| beyond which it tumbles; 80 deg


class ModelErrorSection(Section):
    """By how much the controller's model of the vehicle is wrong, per parameter: 10 % is 1.1 times the truth."""

    m: v.Ratio | None = None
    Iy: v.Ratio | None = None
    Iz: v.Ratio | None = None
    beta_udot: v.Ratio | None = None
    beta_vdot: v.Ratio | None = None
    beta_wdot: v.Ratio | None = None
    beta_qdot: v.Ratio | None = None
    beta_rdot: v.Ratio | None = None
    beta_u: v.Ratio | None = None
    beta_v: v.Ratio | None = None
    beta_w: v.Ratio | None = None
    beta_q: v.Ratio | None = None
    beta_r: v.Ratio | None = None
    beta_b: v.Ratio | None = None
