"""The command `fleet agent`, which joins a run from outside."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TypeVar

import click

from fleet.cli.group import report
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import Duration
from fleet.errors import FleetError
from fleet.processes.interrupts import ending_status
from world.plugins.trust import Trust

if TYPE_CHECKING:
    from agents.join import MakeCore
    from fleet.terminal.status_line import StatusLine

T = TypeVar("T")
_POLL_S = 0.5

_AGENT = (
    "Exit status: 0 the run is over; 2 it cannot join; 3 it had joined and its life ended before the run: a fault "
    "killed it, its link ended, its law failed; 129 terminal closed, 130 Ctrl-C."
)


@click.command(cls=TrustingCommand, epilog=_AGENT)
@click.option(
    "--join",
    "path",
    metavar="FILE",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="The join-<i>.json that fleet run wrote for an external vehicle.",
)
@click.option(
    "--wait",
    metavar="[TIME]",
    type=Duration(1, 86_400),
    is_flag=False,
    flag_value="300 s",
    help="Wait for the file, and for a run that takes this agent, up to this time; 300 s without a time.",
)
@click.option(
    "--ros2",
    metavar="[DISTRO]",
    type=click.Choice(("humble", "jazzy", "kilted")),
    is_flag=False,
    flag_value="jazzy",
    help="A node of ROS 2 is the agent: it gets the vehicle's measurements and messages, and answers with a wrench.",
)
@trust_option
@click.option("-q", "--quiet", is_flag=True, help="Print only errors.")
def agent(path: Path, wait: int | None, ros2: str | None, trust: Trust, quiet: bool) -> None:
    """Run the agent of an external vehicle here, in this terminal, until the run is over.

    It behaves like the agent that fleet run would start: the scenario determines its laws, and the log is the same.

    \b
    Examples:
      fleet run paper --set "per_vehicle={3: {external: true}}"     in one terminal; in another:
      fleet agent --join runs/latest/join-3.json
      fleet agent --join runs/latest/join-3.json --wait       also before the run is started
      fleet agent --join runs/latest/join-3.json --ros2       a node of ROS 2 commands vehicle 3
    """
    import setproctitle
    from rich.console import Console as Terminal

    from agents.join import serve
    from agents.join_file import JoinError, JoinFile
    from fleet.terminal.status_line import StatusLine
    from netem.wire.messages import RUN_OVER, End
    from netem.wire.session import quiet_zenoh

    line = StatusLine(Terminal(stderr=True), quiet=quiet)
    tell = line.print
    joined = False

    def begun(text: str) -> None:
        nonlocal joined
        joined = True
        tell(f"{text}; Ctrl-C leaves it")

    def join() -> tuple[int, End]:
        joining = JoinFile.read(path)
        setproctitle.setproctitle(f"fleet agent {joining.vehicle} [{joining.scenario}]")
        quiet_zenoh()
        make = None if ros2 is None else _node(ros2, joining.vehicle, line)
        return joining.vehicle, serve(joining, begun, trust, make)

    try:
        with line:
            vehicle, end = join() if wait is None else patiently(join, wait / 1e9, path, line)
    except JoinError as error:
        report(error)
        _leave(3 if joined else 2)
    except KeyboardInterrupt as error:
        tell("left the run" if joined else f"not waiting for {path} any longer" if wait else "no run was joined")
        _leave(ending_status(error))
    except FleetError as error:
        _leave(report(error))
    except SystemExit:
        _leave(3)  # the law failed, and what it raised has been printed
    except Exception as error:
        click.echo(f"fleet: the law failed: {type(error).__name__}: {error}", err=True)
        _leave(3)
    tell(f"agent {vehicle}: {end.reason}")
    _leave(0 if end.reason == RUN_OVER else 3)


@cache
def _node(distribution: str, vehicle: int, line: StatusLine) -> MakeCore:
    """A function that makes a node of ROS 2, when there is one, the agent of a vehicle.

    Raises FleetError: nodes cannot meet.
    """
    from fleet.ros2.agent import RosAgent
    from fleet.ros2.node import RosNode, open_ros_session
    from fleet.ros2.rmw import domain_of
    from fleet.ros2.types import types_of

    types, domain = types_of(distribution), domain_of(None)
    bus, words = open_ros_session(None, None)
    line.print(f"ROS 2: domain {domain}, {words}")
    adapter = RosAgent(RosNode(bus, types, domain, f"uuv_{vehicle}_agent"), vehicle, line.print)
    adapter.wait_for_node()
    return adapter.begin


def patiently(join: Callable[[], T], wait_s: float, path: Path, line: StatusLine) -> T:
    """Try to join until it is possible, and tell each new reason why it is not.

    A file of a run that is over is no reason to end: the next run may write another one there.

    Args:
        join: joins, serves, and returns what came of it.
        wait_s: how long.
        path: of the join file.

    Raises:
        NotYetError: it was not possible in that time.
        JoinError: it is no use to wait.
    """
    from agents.join_file import NotYetError

    began, told = time.monotonic(), ""
    while True:
        try:
            return join()
        except NotYetError as error:
            waited = time.monotonic() - began
            if waited >= wait_s:
                raise NotYetError(f"waited {wait_s:g} s: {error}") from None
            if str(error) != told:
                told = str(error)
                line.print(f"waiting, at most {wait_s:g} s: {told}")
        line.show(f"waiting for {path} and its run, {waited:.0f} of {wait_s:g} s; Ctrl-C ends it")
        time.sleep(_POLL_S)


def _leave(status: int) -> NoReturn:
    # The interpreter's normal exit would wait for the thread that waits for a nav.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


COMMANDS = (agent,)
