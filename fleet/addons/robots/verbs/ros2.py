"""The command `fleet ros2`."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.addons.page.verbs.shown import LogLoop, LogRate, Shown, find_shown
from fleet.cli.declare import command
from fleet.cli.group import exit_status
from fleet.cli.sessions import ending
from fleet.cli.types import ENDPOINT, Distribution, Whole
from fleet.errors import FleetError
from fleet.option import Option
from fleet.terminal.progress import showing
from fleet.terminal.status_line import StatusLine

if TYPE_CHECKING:
    from fleet.addons.page.source import LiveSource, LogSource
    from fleet.addons.robots.ros2.bridge import RosBridge
    from fleet.addons.robots.ros2.translation import Translation

EPILOG = "Exit status: 0 done, 2 usage or a bad file, 3 no connection or domain, 129 terminal closed, 130 Ctrl-C."
NODE = "uuv_fleet"


@command(epilog=EPILOG)
def ros2(
    what: Shown = None,
    *,
    domain: Annotated[int | None, Whole(0, 232), Option("Domain of ROS; by default ROS_DOMAIN_ID, or 0.", "N")] = None,
    distro: Annotated[Distribution, Option("Distribution of ROS that the nodes run.")] = "jazzy",
    connect: Annotated[str | None, ENDPOINT, Option("Join the router there, such as rmw_zenohd.")] = None,
    listen: Annotated[str | None, ENDPOINT, Option(
        "Be the router at this address; by default join the one at tcp/127.0.0.1:7447, or be it.")] = None,
    control: Annotated[bool, Option("Offer services that inject and heal faults of a live run.")] = False,
    rate: Annotated[LogRate, Option("For a log: speed in multiples of its own pace.", "X", "-r --rate")] = None,
    loop: LogLoop = False,
    interfaces: Annotated[Path | None, Option(
        "Write the package uuv_fleet_msgs below DIR, for colcon, and stop.", "DIR")] = None,
    quiet: Annotated[bool, Option("Print only errors.", flag="-q --quiet")] = False,
) -> None:  # fmt: skip
    """Show a live run or a log to nodes of ROS 2, over zenoh as rmw_zenoh speaks it.

    Prints domain and address. Nodes need RMW_IMPLEMENTATION=rmw_zenoh_cpp, and for our clock use_sim_time.

    \b
    Examples:
      fleet ros2                                  the live run of this folder, or the newest log
      fleet ros2 runs/latest --loop
      fleet ros2 paper --connect tcp/192.0.2.7:7447 --domain 7
      fleet ros2 paper --control                  services /fleet/inject and /fleet/heal
    """
    from fleet.addons.page.source import LiveSource

    if interfaces is not None:
        _write_interfaces(interfaces)
        return
    if connect and listen:
        raise click.UsageError("give either --connect or --listen, not both")
    source = find_shown(what, rate, control=control, loop=loop)
    with StatusLine(quiet=quiet) as line:

        def open_bridge(translation: Translation, sessions: list[object]) -> RosBridge:
            return _open_bridge(translation, sessions, line, source if control else None, domain, connect, listen)

        if isinstance(source, LiveSource):
            _serve_run(source, distro, line, open_bridge)
        else:
            _serve_log(source, distro, line, open_bridge, 1.0 if rate is None else rate, loop=loop)


def _open_bridge(
    translation: Translation,
    sessions: list[object],
    line: StatusLine,
    controlled: LiveSource | LogSource | None,
    domain: int | None,
    connect: str | None,
    listen: str | None,
) -> RosBridge:
    """A node with the topics of a journal, and the services that disturb the run `controlled`."""
    from fleet.addons.page.source import LiveSource
    from fleet.addons.robots.ros2.bridge import RosBridge, offer_control
    from fleet.addons.robots.ros2.node import RosNode, open_ros_session
    from fleet.addons.robots.ros2.rmw import domain_of
    from netem.wire.session import quiet_zenoh

    number = domain_of(domain)
    quiet_zenoh()
    bus, words = open_ros_session(connect, listen)
    sessions.append(bus)
    node = RosNode(bus, translation.maker.types, number, NODE)
    bridge = RosBridge(node, translation)
    if isinstance(controlled, LiveSource):
        offer_control(node, controlled.open_control())
        line.print("warning: whoever reaches this router can disturb the run: services /fleet/inject and /fleet/heal")
    else:
        line.print("nodes can watch; --control would let them disturb a live run, too")
    line.print(f"ROS 2: domain {number}, {words}")
    click.echo(f"{number} {bus.endpoint}")
    return bridge


def _serve_run(
    source: LiveSource, distro: str, line: StatusLine, open_bridge: Callable[[Translation, list[object]], RosBridge]
) -> None:
    from fleet.addons.robots.ros2.bridge import schemas_of, show_run
    from fleet.addons.robots.ros2.translation import Translation
    from fleet.addons.robots.ros2.types import types_of
    from fleet.replay.live_journal import LiveJournal
    from netem.wire.session import quiet_zenoh

    types = types_of(distro)
    quiet_zenoh()
    line.print(f"the live run in {source.directory}")
    with ending() as sessions, exit_status(3):
        journal = LiveJournal.connect(source.observed, source.directory.name)
        sessions.append(journal)
        bridge = open_bridge(Translation(types, schemas_of(journal)), sessions)
        show_run(bridge, journal, source, line)
        line.print(f"the run is over; its log: fleet ros2 {source.directory}")


def _serve_log(
    source: LogSource,
    distro: str,
    line: StatusLine,
    open_bridge: Callable[[Translation, list[object]], RosBridge],
    rate: float,
    *,
    loop: bool,
) -> None:
    from fleet.addons.page.feed import checks_judged
    from fleet.addons.robots.ros2.bridge import play_log
    from fleet.addons.robots.ros2.translation import Translation
    from fleet.addons.robots.ros2.types import types_of
    from fleet.mcap.seekable_log import SeekableLog
    from fleet.terminal.keyboard import Keyboard

    types = types_of(distro)
    with showing(f"reading {source.path}") as on_progress:
        log = SeekableLog(source.path, on_progress)
    translation = Translation(types, {c.topic: log.schemas.get(c.schema_id) for c in log.channels.values()})
    if not translation.vehicles:
        raise FleetError(f"{source.path} holds nothing that has a topic in ROS 2: it is no log of a run")
    with ending() as sessions, exit_status(3):
        if log.missing:
            line.print(f"warning: {source.path}: {log.missing}")
        bridge = open_bridge(translation, sessions)
        line.print(f"playing {source.path}")
        with Keyboard() as keyboard:
            play_log(bridge, log, keyboard, line, rate=rate, loop=loop)
        if (judged := checks_judged(source.path)) is not None:
            bridge.checks(judged["rows"])


def _write_interfaces(folder: Path) -> None:
    from fleet.addons.robots.ros2.types import INTERFACES

    place = folder / INTERFACES.name
    if place.exists():
        raise FleetError(f"{place} exists already")
    try:
        shutil.copytree(INTERFACES, place)
    except OSError as error:
        raise FleetError(f"cannot write {place}: {error.strerror or error}") from None
    click.echo(place)
