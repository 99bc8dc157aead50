"""How a scenario is run, as opposed to what it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fleet.option import Kind, Limits, Option
from netem.clock import Clock

RunsFolder = Annotated[Path, Option("The folder for run directories.", "DIR", "-o --out")]
OnlyDirectory = Annotated[bool, Option("Print only the run's directory; failures go to stderr.", flag="-q --quiet")]


@dataclass(frozen=True, slots=True)
class Options:
    """How to run. In lockstep nothing here changes a byte of the log.

    In lockstep everyone waits for everyone, and `speed` only holds the run back. With the clock `real` ticks begin by
    the wall clock, `speed` times as fast, and wait for nobody, so agents can be late.

    Each field is an option of `fleet run`.
    """

    out: RunsFolder = Path("runs")
    in_process: Annotated[bool, Option("One process, no zenoh; the same log, byte for byte.")] = False
    clock: Annotated[Clock, Option(
        "Deprecated: real lets ticks begin by the wall clock and wait for no agent; the result lists late agents.")] = (
            Clock.LOCKSTEP)  # fmt: skip
    speed: Annotated[float | None, Kind.SPEED, Option(
        "Speed in multiples of real time, or as fast as possible; with --clock real, 1.")] = None  # fmt: skip
    max_missed: Annotated[float, Kind.SHARE, Option(
        "With --clock real: the run fails if an agent misses a larger share of its ticks.")] = 0.01  # fmt: skip
    port: Annotated[int | None, Limits(1, 65535), Option(
        "Listen on this port of 127.0.0.1, too, for agents that cannot use the run's Unix socket.")] = (
            None)  # fmt: skip
    publish: Annotated[bool, Option(
        "Publish the journal on zenoh during the run; slow listeners do not slow the run.")] = False  # fmt: skip
    wait_for_subscribers: Annotated[bool, Option(
        "With --publish, or an option that publishes: begin when there is a listener.")] = False  # fmt: skip
    join_timeout_s: Annotated[float, Kind.TIME, Option(
        "How long to wait for each external agent.", flag="--join-timeout")] = 300.0  # fmt: skip
    quiet: OnlyDirectory = False
