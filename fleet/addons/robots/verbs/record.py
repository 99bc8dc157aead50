"""The command `fleet record`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import click

from fleet.cli import completion
from fleet.cli.declare import command
from fleet.cli.group import exit_status
from fleet.cli.replay import Connect, Listen, NoSummary, open_session
from fleet.cli.sessions import ending
from fleet.cli.types import FILE, TIME
from fleet.errors import FleetError
from fleet.option import Option
from fleet.terminal.status_line import StatusLine
from fleet.terminal.width import say

EPILOG = "Exit status: 0 done, 2 usage or a bad file, 3 no connection or a full disk, 129 terminal closed, 130 Ctrl-C."


@command(epilog=EPILOG)
def record(
    *,
    keys: Annotated[tuple[str, ...], Option(
        "Key expression to record, e.g. 'robot/**'; repeatable.", "KEY", "-k --key")] = (),
    output: Annotated[Path | None, FILE, Option(
        "The file to write; by default record-<UTC time>.mcap.", flag="-o --out")] = None,
    duration: Annotated[int | None, TIME, Option("Stop after this time, e.g. '1 min'.")] = None,
    connect: Connect = None,
    listen: Listen = None,
    run: Annotated[str | None, completion.published_runs, Option(
        "Record the journal of this live run, started with --publish, as a log, until it ends: its name or the "
        "beginning of it, its scenario, or its directory.", "NAME")] = None,
    ros2: Annotated[bool, Option(
        "Write the messages of ROS 2 nodes as a bag, over rmw_zenoh with ROS_DOMAIN_ID; --out is its directory, and "
        "--key a topic such as '/uuv_1/*'.")] = False,
    quiet: NoSummary = False,
) -> None:  # fmt: skip
    """Record zenoh traffic of any kind to an MCAP file, until Ctrl-C.

    With --run it ends with the run, and the file is a log of the run, which every command reads. Other payloads stay as
    they are, with their encoding, attachment and timestamp; `fleet replay` publishes them again.

    \b
    Examples:
      fleet record --key 'robot/**' -o robot.mcap --connect tcp/127.0.0.1:7447
      fleet record --key 'robot/**' --key 'base/*/status' --listen tcp/0.0.0.0:7447 --duration '10 min'
      fleet record --run paper -o journal.mcap
      fleet record --ros2 -o bag                  everything on the domain of ROS, as ros2 bag record
    """
    from fleet.processes.interrupts import holding_interrupts
    from fleet.replay.capture import PublisherGone, Recorder, TrafficWriter

    connect, credentials, keys, journal = _find_recorded(keys, connect, listen, run, ros2=ros2)
    path = output or Path(f"record-{datetime.now(UTC):%Y%m%d-%H%M%S}{'' if ros2 else '.mcap'}")  # noqa: TID251 (a name)
    with ending() as sessions, StatusLine(quiet=quiet) as line:
        if ros2:
            bus, source, keys, open_writer = _ros2(connect, listen, keys, path, line)
        else:
            bus = source = open_session(connect, listen, credentials)
            open_writer = partial(TrafficWriter, path, keys)
            if journal is not None:
                from fleet.addons.robots.run_log import RunLogWriter

                open_writer = partial(RunLogWriter, path, bus, journal)
        sessions.append(bus)
        with exit_status(2):
            recorder = Recorder(source, keys)
            writer = open_writer()
        line.print(f"recording {', '.join(keys)} at {bus.endpoint} to {path}")
        if any("*" in key for key in keys) and not (ros2 or run):
            line.print("* and ** leave out parts that begin with @, such as @v0: name them, --key '@v0/**'")
        with exit_status(3), holding_interrupts() as interrupted:
            try:
                over = None if run is None else PublisherGone(lambda: bus.connected)
                if recorder.record(writer, duration, line, interrupted, over):
                    line.print("the run is over: nobody publishes it any more")
            except BaseException:
                with suppress(FleetError):  # a full disk is reported once
                    _finish(recorder, writer, line, path)
                raise
            _finish(recorder, writer, line, path)


def _find_recorded(
    keys: tuple[str, ...], connect: str | None, listen: str | None, run: str | None, *, ros2: bool
) -> tuple[str | None, Any, tuple[str, ...], Any]:
    """The endpoint to connect to, the credentials for it, the keys to record, and those of the run whose log it is.

    Raises click.UsageError: there is no key, or options exclude each other.
    """
    if ros2 and run is not None:
        raise click.UsageError("--run records a run, and --ros2 records nodes of ROS 2: give one of them")
    if run is None:
        if not keys and not ros2:
            raise click.UsageError("no key to record: give --key 'robot/**', or --key '**' for everything")
        return connect, None, keys, None
    if connect or listen:
        raise click.UsageError("--run finds the router by itself: leave out --connect and --listen")
    endpoint, credentials, of_run = _observer(run)
    return endpoint, credentials, keys or (of_run.log("**"),), None if keys else of_run


def _ros2(
    connect: str | None, listen: str | None, topics: tuple[str, ...], path: Path, line: StatusLine
) -> tuple[Any, Any, tuple[str, ...], Callable[[], Any]]:
    """A session among nodes of ROS 2, a function that subscribes, the keys, and a function that opens the bag."""
    from fleet.addons.robots.ros2.node import open_ros_session
    from fleet.addons.robots.ros2.record import BagWriter, WithHistory
    from fleet.addons.robots.ros2.rmw import domain_of
    from fleet.addons.robots.ros2.types import types_of
    from netem.wire.session import quiet_zenoh

    if connect and listen:
        raise click.UsageError("give either --connect or --listen, not both")
    types, domain = types_of(), domain_of(None)
    quiet_zenoh()
    bus, _ = open_ros_session(connect, listen)
    keys = tuple(f"{domain}/{topic.strip('/')}/*/*" for topic in topics) or (f"{domain}/**",)
    return bus, WithHistory(bus), keys, partial(BagWriter, path, types, line.print)


def _finish(recorder: Any, writer: Any, line: Any, path: Path) -> None:
    recorder.finish(writer)
    line.print(f"recorded {writer.samples} messages, {writer.size / 1e6:.2f} MB, to {path}")
    if recorder.left_out:
        say(f"warning: {recorder.left_out}", err=True)
    if lacks := getattr(writer, "lacks", ""):
        say(f"note  {lacks}", err=True)


def _observer(run: str) -> tuple[str, Any, Any]:
    """Endpoint, credentials and keys of a live run that was started with --publish."""
    from fleet.execution.connection import RemoteError, choose
    from fleet.execution.directory import OBSERVE
    from fleet.replay.observed import read_observed
    from netem.files import DamagedFile
    from netem.wire.credentials import Credentials
    from netem.wire.keys import Keys

    try:
        path = choose(run, OBSERVE) / OBSERVE
        found = read_observed(path)
        return found.endpoint, Credentials(found.user, found.password), Keys(found.run)
    except RemoteError as error:
        raise click.BadParameter(
            f"{error}; the run must have been started with --publish", param_hint="--run"
        ) from None
    except (OSError, DamagedFile):
        raise click.BadParameter(
            f"{run} is no live run that is published: there is no usable {OBSERVE}", param_hint="--run"
        ) from None
