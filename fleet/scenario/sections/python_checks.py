"""Checks in Python: their classes by name, and the parameters with which each is made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fleet.scenario.schema.checks import SOMETIMES
from world.plugins.checks import check_class
from world.plugins.loading import load_class

NAME = "name"  # name of the verdict; only this key and `sometimes` are no parameters of the class


def parameters_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of a check as the scenario writes them."""
    return {key: value for key, value in given.items() if key not in (NAME, SOMETIMES)}


def load_check(name: str, parameters: Mapping[str, Any]) -> type[Any]:
    """The class `package.module:Class` of a check that can be made with these parameters.

    Raises UntrustedError: its module is not installed, and was not let in with `admit`; PluginError: there is no such
    class, or it cannot be used.
    """
    methods = {"step": ("tick",)}
    config = "what it may know of the scenario, fleet.checks.api.Facts"
    return load_class("check", name, lambda found: check_class("check", name, found, methods, parameters, config))
