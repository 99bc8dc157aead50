"""The output of `fleet list` and `fleet ls` with `--json`."""

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
    group: Annotated[str, Meta(description="Its group in the list.")]
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


class RunRow(Struct):
    """One run, which goes on or is over."""

    run: Annotated[str, Meta(description="Name of the run: of its directory.")]
    directory: Annotated[str, Meta(description="The run's directory, as it is reached from here.")]
    scenario: Annotated[str, Meta(description="Name of the scenario.")]
    verdict: Annotated[str, Meta(description="pass, FAIL, broke (also: left no result), stopped or live.")]
    sim_s: Annotated[float | None, Meta(description="Simulated time that was reached [s]; null: there is no result.")]
    size_bytes: Annotated[int, Meta(description="Size of all files in the directory [bytes].")]
    began: Annotated[str, Meta(description="When it began, UTC, as ISO 8601 writes it.")]
    age_s: Annotated[float, Meta(description="How long ago it began [s].")]


class Runs(Struct):
    """`fleet ls --json`: the runs below a directory."""

    runs: Annotated[list[RunRow], Meta(description="The newest first.")]
    size_bytes: Annotated[int, Meta(description="Size of all of them [bytes].")]
