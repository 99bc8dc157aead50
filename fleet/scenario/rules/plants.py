"""Rules on the plants of vehicles."""

from __future__ import annotations

from functools import partial

from fleet.scenario.parts import Parts
from fleet.scenario.rules.plugins import plugin
from fleet.scenario.rules.report import Report
from world.plants.classes import SHIPPED, plant_class


def plants(parts: Parts, report: Report) -> None:
    """Every plant that is named exists, and can be made with its parameters."""
    for path, section in parts.sections("vehicle"):
        plant = section.plant
        if plant is not None:
            at = (*path, "vehicle", "plant")
            at = (*at, "name") if report.has((*at, "name")) else at
            load = partial(plant_class, plant.name, plant.parameters or {})
            plugin(parts, report, at, "plant", plant.name, list(SHIPPED), load)


def rolls(parts: Parts, report: Report) -> None:
    """Only a vehicle with a plant can begin with a roll."""
    for index, state in enumerate(parts.spec.initial.vehicles or ()):
        if index >= parts.spec.vehicles or not (state.roll or state.roll_rate):
            continue
        choice = parts.choice(parts.entries(index + 1))
        assert choice.vehicle is not None
        if choice.vehicle.plant is None:
            key = "roll" if state.roll else "roll_rate"
            hint = "the 5-DOF model has no roll: give it a vehicle.plant"
            message = f"has no effect on vehicle {index + 1}, which cannot roll"
            report.add(("initial", index, key), message, hint, key=True)
