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
    group: Annotated[str, Meta(description="The group of the list in which it stands.")]
    title: Title
    vehicles: Vehicles
    duration_s: Duration
    expect: Expect


class StudyRow(Struct):
    """One study that ships with the package."""

    name: Annotated[str, Meta(description="Name of the study.")]
    title: Annotated[str, Meta(description="What it asks.")]
    scenario: Annotated[str, Meta(description="Name of the scenario that is run.")]
    runs: Annotated[int, Meta(description="Number of its runs.")]
    core_s: Annotated[float, Meta(description="Time that all of them take one compiled core, roughly [s].")]


class Scenarios(Struct):
    """`fleet list --json`: the scenarios and the studies that ship with the package."""

    scenarios: Annotated[list[ScenarioRow], Meta(description="By name.")]
    studies: Annotated[list[StudyRow], Meta(description="By name.")]
