"""Rules on `per_vehicle`, on the laws of each vehicle, and on its physical data and limits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

from agents.config import Law
from agents.controllers import BUILT_IN, CONTROLLERS
from agents.plugins.laws import load
from agents.profiles import profile
from agents.trajectory import PathError
from fleet.quantities import RATE, SPEED, QuantityError, show, show_vector, vehicle_numbers
from fleet.scenario.parts import Parts, UnknownValueError
from fleet.scenario.rules.plugins import plugin
from fleet.scenario.rules.report import Report, number_text, vehicles_exist
from fleet.scenario.schema.spec import sections
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.per_vehicle import Entries, given_values, law_names, used_keys, wrong_model
from fleet.scenario.sections.vehicle_files import mass_problems
from world.plants.classes import SHIPPED, plant_class
from world.vectors import Vec3


def plants(parts: Parts, report: Report) -> None:
    """Every plant that is named exists, and can be made with its parameters."""
    for path, section in sections(parts.spec, "vehicle"):
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


_BLEND_SAMPLES = 40  # times at which a change of the formation is looked at


def per_vehicle(parts: Parts, report: Report) -> None:
    spec = parts.spec
    seen: dict[str, str] = {}
    for text in report.keys("per_vehicle"):
        with suppress(QuantityError):  # reported by the schema
            vehicles_exist(spec, report, ("per_vehicle", text), text, key=True)
        if number_text(text) in seen:
            report.add(("per_vehicle", text), f'the same vehicles as "{seen[number_text(text)]}"', key=True)
        seen[number_text(text)] = text


def laws(parts: Parts, report: Report) -> None:
    """Every law that is named exists, and can be made with its parameters."""
    spec = parts.spec
    places: list[tuple[tuple[str, ...], Any]] = [((), spec)]
    places += [(("per_vehicle", numbers), overrides) for numbers, overrides in spec.per_vehicle.items()]
    for path, place in places:
        for kind in ("agent", "controller", "guidance", "tracking"):
            section = getattr(place, kind)
            if section is None or section.law is None:
                if section is not None and getattr(section, "parameters", None):
                    problem, hint = "have no effect without a law", "name the law, too: law: package.module:Class"
                    report.add((*path, kind, "parameters"), problem, hint, key=True)
                continue
            law(parts, report, (*path, kind), kind, Law(section.law, section.parameters or {}))


def law(parts: Parts, report: Report, path: tuple[str, ...], kind: str, law: Law) -> None:
    built_in = list(CONTROLLERS) if kind == "controller" else list(BUILT_IN[kind])
    if law.name in built_in:
        if law.parameters:
            hint = "its gains are keys of guidance and tracking"
            report.add((*path, "parameters"), f"the law {law.name} takes no parameters", hint)
        return
    plugin(parts, report, (*path, "law"), kind, law.name, built_in, partial(load, kind, law))


def effective(parts: Parts, report: Report) -> None:
    """A parameter that no law reads is a mistake, not a comment."""
    if report.mistaken("controller.law: there is no"):  # what it would read is not known
        return
    for path, message in _ineffective(parts):
        report.add(path, message, key=True)


def superfluous(parts: Parts, report: Report) -> list[tuple[str, ...]]:
    """The keys of the file that a law reads in whose place another one was typed: they belong to the former law."""
    changed = ("controller", "guidance", "tracking", "profile")
    if not any(report.typed((key,)) or report.typed((key, "law")) for key in changed):
        return []
    found = (path for path, _ in _ineffective(parts))
    return [path for path in found if path[-1] != "law" and not report.typed(path)]


def _ineffective(parts: Parts) -> Iterator[tuple[tuple[str, ...], str]]:
    """Each key that no law reads, and what is wrong with it."""
    spec = parts.spec
    for kind in ("guidance", "tracking"):
        for path, section in sections(parts.spec, kind):
            where = vehicle_numbers(path[1]) if path else range(spec.vehicles + 1)
            names = {law_names(parts.choice(entries)) for entries in {parts.entries(i) for i in where}}
            if any(n is not None and ":" in n[kind == "tracking"] for n in names):
                continue
            running = {n[kind == "tracking"] for n in names if n is not None}
            keys: set[str] = set().union(*(used_keys(kind, law) for law in running))
            for key in given_values(section).keys() - {"law", "parameters"} - keys:
                laws = ", ".join(sorted(running)) or "a controller that replaces it"
                yield (*path, kind, key), f"has no effect on {kind} law {laws}"
            if given_values(section).get("law") and not running:
                message = "has no effect beside a controller that replaces guidance and tracking"
                yield (*path, kind, "law"), message


def keep_apart(parts: Parts, report: Report) -> None:
    """The filter has a guidance and a tracking law to stand between."""
    if parts.spec.keep_apart is None:
        return
    if all(law_names(parts.choice(parts.entries(i))) is None for i in range(1, parts.spec.vehicles + 1)):
        message = "has no effect: it acts between guidance and tracking, and every vehicle has a law in place of both"
        report.add(("keep_apart",), message, key=True)


def vehicles(parts: Parts, report: Report) -> None:
    """Each vehicle's numbers can be read, and make a vehicle; so does what the controller believes."""
    for entries, choice in parts.choices():
        assert choice.model_error is not None
        try:
            params, _ = parts.vehicle(entries)
        except DataFileError as error:
            for problem in error.problems:
                report.add(report.origin(entries, "vehicle", "model") or ("vehicle", "model"), problem)
            continue
        for problem in mass_problems(params):
            report.add(report.origin(entries, "vehicle") or ("vehicle",), problem)
        if not mass_problems(params):
            for problem in mass_problems(wrong_model(params, choice.model_error)):
                report.add(report.origin(entries, "model_error") or ("model_error",), f"with it, {problem}")


def velocity_bounds(parts: Parts, report: Report) -> None:
    """Every reference velocity is strictly inside the bounds: then the QP has a solution k > 0 for every error."""
    low, high = desired_velocity(parts)
    for entries, law, section, name in parts.guidance():
        if law != "optimal":
            continue
        preset = profile(name)[0]
        bounds: dict[str, Vec3] = {"rho_lo": section.rho_lo or preset.rho_lo, "rho_hi": section.rho_hi or preset.rho_hi}
        for bound_name, bound in bounds.items():
            sign, speeds = (1.0, low) if bound_name == "rho_lo" else (-1.0, high)
            for axis, limit, speed in zip("xyz", bound, speeds, strict=True):
                if sign * limit < sign * speed:
                    continue
                written = report.origin(entries, "guidance", bound_name)
                of_reference = "speed" if parts.spec.reference.velocity is None else "velocity"
                side, extreme = ("below", "least ") if sign > 0 else ("above", "greatest ")
                extreme = "" if low == high else extreme
                report.add(
                    written or ("reference", of_reference),
                    f"{bound_name} {show_vector(bound, SPEED)} must be {side} the {extreme}reference velocity "
                    f"{rounded(speeds)} on every axis; it is not on {axis}",
                    "" if written else f"the bound is that of profile {name}; set {key_of(entries, bound_name)}",
                )
                break


def desired_velocity(parts: Parts) -> tuple[Vec3, Vec3]:
    """Least and greatest velocity that any vehicle is asked for on each axis, changes of the formation included."""
    try:
        low, high = map(list, parts.reference.velocity_bounds())
    except PathError:
        raise UnknownValueError from None
    for change in parts.spec.formation.changes or ():
        for step in range(_BLEND_SAMPLES + 1):
            t = (change.at + change.over * step / _BLEND_SAMPLES) / 1e9
            velocity = parts.reference.at(t).velocity
            for plan in parts.plans:
                rate = plan.at(t).velocity
                for axis in range(3):
                    low[axis] = min(low[axis], velocity[axis] + rate[axis])
                    high[axis] = max(high[axis], velocity[axis] + rate[axis])
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def key_of(entries: Entries, key: str) -> str:
    """The nearest key that sets a guidance parameter of the vehicles that these entries name."""
    return f"per_vehicle.{entries[-1]}.guidance.{key}" if entries else f"guidance.{key}"


def rounded(speeds: Vec3) -> str:
    return show_vector(tuple(float(f"{speed:.4g}") for speed in speeds), SPEED)


def gain_bounds(parts: Parts, report: Report) -> None:
    for entries, law, section, name in parts.guidance():
        preset = profile(name)[0]
        k_min, k_max = section.k_min or preset.k_min, section.k_max or preset.k_max
        if k_min > k_max and {"k_min", "k_max"} <= used_keys("guidance", law):
            path = report.origin(entries, "guidance", "k_max") or report.origin(entries, "guidance", "k_min")
            assert path is not None  # no profile is wrong by itself
            given_both = section.k_min is not None and section.k_max is not None
            hint = "" if given_both else f"the other one is that of profile {name}"
            report.add(path, f"k_min {show(k_min, RATE)} is above k_max {show(k_max, RATE)}", hint)


def cosine_guard(parts: Parts, report: Report) -> None:
    for path, section in sections(parts.spec, "tracking"):
        if section.cos_eps is not None and section.cos_eps >= 1.0:
            report.add((*path, "tracking", "cos_eps"), f"is a cosine and must be below 1, got {section.cos_eps!r}")
