"""The bridge to ROS 2 beside a run: `fleet run --ros2`."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.cli.companion import Companion, RunCompanion
from fleet.option import Option
from fleet.processes.side_process import begin, end, line_of, pipe
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.execution.options import Options
    from fleet.scenario.scenario import Scenario

READY_S = 30.0
CLOSE_S = 8.0  # after the run, for what is on its way


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    """The options of `fleet run` for ROS 2."""

    ros2: Annotated[bool, Option("Publish the run, and show it to ROS 2 as fleet ros2 does.")] = False


class Bridge(Companion):
    """`fleet ros2` in a process beside the run."""

    options_type = BridgeOptions

    def prepare(self, scenario: Scenario, how: Options, one_process: str) -> Options:
        """The run is published, since the bridge reads its journal. Raises UsageError: it runs in one process."""
        if one_process:
            raise click.UsageError(
                f"--ros2 needs a run with processes, so not with {one_process}; fleet ros2 plays its log afterwards"
            )
        return replace(how, publish=True)

    @contextmanager
    def start(self, how: Options) -> Iterator[RunCompanion]:
        """The bridge, which begins when the run is published. Raises FleetError: the extra is not installed."""
        from fleet.addons.robots.ros2.types import types_of

        types_of()
        with closing(BridgeProcess()) as bridge:
            yield bridge


class BridgeProcess(RunCompanion):
    """The bridge of `fleet run --ros2`: `fleet ros2` in a process of its own, which ends with the run."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def on_run_published(self, directory: Path) -> None:
        """Start it, and wait until nodes can see the run. If they cannot, the run goes on without it."""
        # It ends with the run's publisher.
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE}
        self._process = begin("fleet.__main__", "ros2", str(directory), **streams)
        if not line_of(self._process, READY_S):
            self.close(0.0)
            say("warning: the run goes on without ROS 2, which fleet ros2 can join later", err=True)

    def close(self, limit_s: float = CLOSE_S) -> None:
        """End it, once it has published what there was."""
        process, self._process = self._process, None
        if process is not None:
            end(process, limit_s)
            pipe(process.stdout).close()
