"""What `fleet list` prints with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Name = Annotated[str, Meta(description="Name of the scenario.")]
Title = Annotated[str, Meta(description="What one learns from it.")]
Vehicles = Annotated[int, Meta(description="Number of vehicles.")]
Duration = Annotated[float, Meta(description="Simulated time of a run [s].")]
Expect = Annotated[str, Meta(description="pass, or fail: it is meant to fail a check.")]


class ScenarioRow(Struct):
    """One scenario that ships with the package."""

    name: Name
    title: Title
    vehicles: Vehicles
    duration_s: Duration
    expect: Expect


class Scenarios(Struct):
    """`fleet list --json`: the scenarios that ship with the package."""

    scenarios: Annotated[list[ScenarioRow], Meta(description="By name.")]
