"""What the commands for the runs below a directory print with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct


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
