"""What `fleet export` writes for networks and for ROS 2: traces of links, and bags."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import click

from fleet.cli.exporter import Exporter, Selection
from fleet.cli.types import FOLDER, TIME
from fleet.option import Option
from fleet.terminal.progress import showing
from fleet.terminal.width import say


@dataclass(frozen=True, slots=True)
class TraceOptions:
    """The options of `fleet export` for traces."""

    traces: Annotated[Path | None, FOLDER, Option(
        "Write the fate of each packet here: a CSV file per directed link, or per key of a recording, which "
        "network.links can read.")] = None  # fmt: skip
    sequence: Annotated[str | None, Option(
        "Traces of a recording: the field of JSON payloads that counts them.", "FIELD")] = None  # fmt: skip
    period: Annotated[int | None, TIME, Option(
        "Traces of a recording: time between two messages of a key without numbers.")] = None  # fmt: skip


class Traces(Exporter):
    """Traces of links, of a run or of a recording."""

    options_type = TraceOptions
    selects = True
    form = "--traces DIR"

    @property
    def folder(self) -> Path | None:
        """Where they go."""
        return self.options.traces  # type: ignore[no-any-return]

    def write(self, log: Path, selection: Selection, *, force: bool) -> Iterable[Path]:
        """Write them. Raises UsageError: the log is of a run, and has all its links; FleetError: it cannot be done."""
        from fleet.addons.robots.field_traces import FieldSelection, write_field_traces
        from fleet.logs.link_traces import write_traces
        from fleet.logs.open_log import open_log

        if self.folder is None:
            raise click.UsageError("--sequence and --period are for --traces")
        if self.options.period == 0:
            raise click.BadParameter("must be above 0", param_hint="--period")

        def tell_user(text: str) -> None:
            say(f"fleet: {text}", err=True)

        with showing(f"reading {log}") as on_progress:
            found = open_log(log, ["link/*"], share=on_progress)
        chosen = FieldSelection(*selection, self.options.sequence, self.options.period)
        if not found.run:
            with showing(f"reading {log}") as on_progress:
                return write_field_traces(log, self.folder, chosen, force=force, say=tell_user, on_progress=on_progress)
        if any(chosen):
            raise click.UsageError(f"{log} is the log of a run: its traces are those of all links, and take no options")
        if found.missing:
            tell_user(f"{found.path}: {found.missing}")
        return write_traces(found, self.folder, force=force, say=tell_user)


@dataclass(frozen=True, slots=True)
class BagOptions:
    """The options of `fleet export` for a bag."""

    ros2: Annotated[Path | None, FOLDER, Option("Write a bag of ROS 2 here; needs uuv-fleet[ros2].")] = (
        None)  # fmt: skip


class BagOfRos(Exporter):
    """A bag of ROS 2."""

    options_type = BagOptions
    form = "--ros2 DIR"

    @property
    def folder(self) -> Path | None:
        """The directory of the bag."""
        return self.options.ros2  # type: ignore[no-any-return]

    def write(self, log: Path, selection: Selection, *, force: bool) -> Iterable[Path]:
        """Write it, with all topics that have a type in ROS 2. Raises FleetError: it cannot be written."""
        from fleet.addons.robots.ros2.bag import write_bag
        from fleet.mcap.reader import log_path

        with showing(f"writing {self.folder}") as on_progress:
            paths, missing = write_bag(log_path(log), self.options.ros2, on_progress)
        if missing:
            say(f"fleet: {log}: {missing}", err=True)
        return paths
