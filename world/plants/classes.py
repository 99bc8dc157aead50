"""Finds the class of a plant by its name: a shipped plant, a class of the user, or an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from world.errors import FmuError, PluginError, UntrustedError
from world.plugins.checks import check_class, check_signals
from world.plugins.loading import file_class, load_class, unit_file
from world.plugins.trust import permitted_file
from world.signal import Signal

KIND = "plant"
# The plants that ship: name -> `module:Class`. They are imported when a scenario names them.
SHIPPED: dict[str, str] = {"bluerov2": "world.plants.bluerov2:BlueROV2", "remus100": "world.plants.remus100:Remus100"}
METHODS: dict[str, tuple[str, ...]] = {
    "start": ("pose", "velocity"),
    "step": ("state", "tau", "water", "dt"),
    "pose": ("state",),
    "velocity": ("state",),
}
_TAKEN = frozenset(("phi", "p"))  # signals that every plant has besides its own


def plant_class(name: str, parameters: Mapping[str, Any]) -> type[Any]:
    """The class of a plant, checked. `name`: of a plant that ships, `package.module:Class`, an entry point of group
    `uuv_fleet.plants`, or `fmu:FILE`. `parameters`: its parameters, in addition to its configuration. Raises
    UntrustedError: its module or file is not installed, and was not let in with `admit`; PluginError: there is no such
    class, or it cannot be used."""
    if name in SHIPPED:
        module, _, class_name = SHIPPED[name].partition(":")
        shipped: type[Any] = getattr(import_module(module), class_name)
        _check(name, shipped, parameters)
        return shipped
    if unit_file(KIND, name):
        unit = _unit_class(name, parameters)
        _check(name, unit, parameters)
        return unit
    return load_class(KIND, name, lambda found: _check(name, found, parameters))


def module_of(name: str) -> str | None:
    """The module that the class of a plant is imported from; None: it ships, or is an FMU or an entry point."""
    return None if name in SHIPPED or ":" not in name or unit_file(KIND, name) else name.partition(":")[0]


def file_of(name: str) -> Path | None:
    """The path of a plant that is a file and may run.

    None: the plant is a class, or the user has not allowed the file.
    """
    try:
        return permitted_file(KIND, name) if unit_file(KIND, name) else None
    except UntrustedError:
        return None


def model_of(name: str, parameters: Mapping[str, Any]) -> str | None:
    """The vehicle file that a plant brings for the controllers; None: it brings none, or may not run."""
    try:
        model = getattr(plant_class(name, parameters), "model", None)
    except PluginError:
        return None
    return model if isinstance(model, str) else None


def signals_of(name: str, parameters: Mapping[str, Any]) -> tuple[Signal, ...]:
    """The values that a plant reports in addition to its motion. Raises PluginError: it cannot be used."""
    signals: tuple[Signal, ...] = getattr(plant_class(name, parameters), "signals", ())
    return signals


def _unit_class(name: str, parameters: Mapping[str, Any]) -> type[Any]:
    try:
        return file_class(KIND, name, parameters)  # type: ignore[no-any-return]
    except FmuError as error:
        raise PluginError(KIND, name, error.problem, error.hint) from None


def _check(name: str, found: Any, parameters: Mapping[str, Any]) -> None:
    check_class(KIND, name, found, METHODS, parameters, "world.api.PlantConfig")
    signals = getattr(found, "signals", ())
    check_signals(KIND, name, signals, _TAKEN)
    if signals and not callable(getattr(found, "report", None)):
        hint = "report(state) returns a dict with a number per signal"
        raise PluginError(KIND, name, "it has signals and no method report", hint)
    model = getattr(found, "model", None)
    if model is not None and not isinstance(model, str):
        raise PluginError(KIND, name, f"its model is {model!r:.80}", "expected the name of a vehicle file")
