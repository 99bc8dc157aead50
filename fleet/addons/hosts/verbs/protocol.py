"""The commands for external agents: `fleet agent` runs one, `fleet protocol` is for authors in other languages."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn, TypeVar

import click

from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.group import ListingGroup, report
from fleet.cli.types import FILE, FOLDER, TIME, Distribution, Trust, Whole, time_within
from fleet.errors import FleetError, printable
from fleet.option import Option
from fleet.processes.interrupts import ending_status
from fleet.terminal.status_line import StatusLine

if TYPE_CHECKING:
    from agents.join import MakeCore
    from fleet.addons.hosts.gateway import Gateway


_CHECK = "Exit status: 0 every check passed, 1 one did not, 2 usage, or nobody came, 129 terminal closed, 130 Ctrl-C."


@click.group(cls=ListingGroup, invoke_without_command=True)
@click.pass_context
def protocol(context: click.Context) -> None:
    """Print the wire protocol page (Markdown) for authors of agents in other languages, or check an agent.

    \b
    Examples:
      fleet protocol > protocol.md
      fleet protocol check --id 3
    """
    if context.invoked_subcommand is None:
        from fleet.addons.hosts.protocol.page import page

        click.echo(page(), nl=False)


@command(epilog=_CHECK, group=protocol)
def check(
    *,
    vehicle: Annotated[int, Whole(min=1), Option("The agent's number.", "I", "--id")],
    scenario: Annotated[str, scenarios, Option("The scenario of the agent's slice.")] = "paper",
    trust: Trust = False,
    join_file: Annotated[Path | None, FILE, Option(
        "Where to write the join file; by default join-<i>.json here.")] = None,
    timeout: Annotated[int, TIME, Option("How long to wait for the agent.")] = 300 * 10**9,
    port: Annotated[int | None, Whole(1, 65535), Option(
        "Loopback port of the router; by default a free one.")] = None,
    listen_certified: Annotated[str | None, Option(
        "Also listen here for an agent with a certificate and no password (zenoh-pico).", "ENDPOINT")] = None,
    certs: Annotated[Path | None, FOLDER, Option(
        "With --listen-certified: certificates, made by fleet hosts certs.")] = None,
) -> None:  # fmt: skip
    """Play world and netem against your agent, and judge all its messages.

    The command writes a join file, waits for the agent, and plays a fixed exchange. That has the handshake, ticks and
    round ticks, inboxes that come late, in parts and damaged, malformed messages, an earlier life, a gap, and the end.

    \b
    Examples:
      fleet protocol check --id 3
      fleet protocol check --id 2 --scenario rough-sea --join-file /tmp/join-2.json
      fleet protocol check --id 3 --listen-certified tls/127.0.0.1:7448 --certs certs
    """
    from fleet.addons.hosts.protocol.conformance import Examination
    from fleet.addons.hosts.rendezvous import CERTIFIED, check_free, listening_for_certificates
    from fleet.execution.rendezvous import Rendezvous
    from fleet.scenario.loading import load_scenario
    from netem.wire.session import quiet_zenoh

    quiet_zenoh()
    place = None
    if certs and not listen_certified:
        raise FleetError("--certs is for --listen-certified ENDPOINT, such as tls/127.0.0.1:7448")
    if listen_certified:
        place = listening_for_certificates(Rendezvous(), listen_certified, certs, external=(vehicle,))
        check_free(listen_certified, CERTIFIED)
    file = join_file or Path(f"join-{vehicle}.json")
    examination = Examination(load_scenario(scenario), vehicle, file, port=port, meeting=place)
    found = examination.run(timeout / 1e9, lambda text: click.echo(text, err=True))
    for text in examination.notes:
        click.echo(f"note  the agent says: {printable(text)}")
    for verdict in found:
        click.echo(printable(str(verdict)))
    passed = sum(verdict.passed is True for verdict in found)
    slowest = f"; slowest answer {examination.slowest_s * 1e3:.1f} ms"
    click.echo(f"{passed} of {len(found)} checks passed{slowest}")
    sys.exit(0 if passed == len(found) else 1)


T = TypeVar("T")
_POLL_S = 0.5
_TOO_FAST = 1.2  # times faster than the wall clock: real programs cannot follow

_AGENT = (
    "Exit status: 0 the run is over; 2 it cannot join; 3 it had joined and its life ended before the run: a fault "
    "killed it, its link ended, its law failed; 129 terminal closed, 130 Ctrl-C."
)


@command(epilog=_AGENT)
def agent(
    *,
    path: Annotated[Path, FILE, Option(
        "The join-<i>.json that fleet run wrote for an external vehicle.", "FILE", "--join")],
    wait: Annotated[int | None, time_within(1, 86_400), Option(
        "Wait for the file, and for a run that takes this agent, up to this time; 300 s without a time.", "[TIME]",
        alone="300 s")] = None,
    ros2: Annotated[Distribution | None, Option(
        "A node of ROS 2 is the agent: it gets the vehicle's measurements and messages, and answers with a wrench.",
        "[DISTRO]", alone="jazzy")] = None,
    udp: Annotated[tuple[str, ...], Option(
        "A real program is the agent: what comes for PORT goes to HOST:PORT over UDP, and what it sends to our PORT "
        "goes to all that hear the vehicle; repeatable.", "PORT=HOST:PORT")] = (),
    zenoh: Annotated[str, Option(
        "Real programs of zenoh are the agent, and connect to this address, such as tcp/0.0.0.0:7501.",
        "ADDRESS")] = "",
    carry: Annotated[tuple[str, ...], Option(
        "With --zenoh: key expressions of what leaves the vehicle; by default all.", "KEYEXPR")] = (),
    modem: Annotated[str, Option(
        "A real program is the agent, and opens an acoustic modem here: unet=1101, evologics=9200, micromodem=7000 or "
        "micromodem=PATH.", "LANGUAGE=PORT")] = "",
    start: Annotated[str, Option(
        "With --zenoh, --udp or --modem: start this program when it can connect, and end it with the run.", "COMMAND",
        "--run")] = "",
    trust: Trust = False,
    quiet: Annotated[bool, Option("Print only errors.", flag="-q --quiet")] = False,
) -> None:  # fmt: skip
    """Run the agent of an external vehicle here, in this terminal, until the run is over.

    It behaves like the agent that fleet run would start: the scenario determines its laws, and the log is the same.

    \b
    Examples:
      fleet run paper --set "per_vehicle={3: {external: true}}"     in one terminal; in another:
      fleet agent --join runs/latest/join-3.json
      fleet agent --join runs/latest/join-3.json --wait       also before the run is started
      fleet agent --join runs/latest/join-3.json --ros2       a node of ROS 2 commands vehicle 3
      fleet agent --join runs/latest/join-3.json --udp 9000=192.168.0.7:9100     a real computer is vehicle 3
      fleet agent --join runs/latest/join-3.json --modem unet=1101    and talks by the modem of vehicle 3
    """
    import setproctitle

    from agents.join import serve
    from agents.join_file import JoinError, JoinFile
    from fleet.processes.child_start import die_with_study
    from netem.wire.messages import RUN_OVER, End
    from netem.wire.session import quiet_zenoh

    if ros2 and (udp or zenoh or modem):
        raise click.UsageError("--ros2 and --udp, --zenoh or --modem: one of them is the agent")
    if carry and not zenoh:
        raise click.UsageError("--carry has no effect without --zenoh")
    if start and not (udp or zenoh or modem):
        raise click.UsageError("--run has no effect without --zenoh, --udp or --modem")
    die_with_study()
    line = StatusLine(quiet=quiet)
    tell = line.print
    joined = False
    gateway = _gateway(udp, zenoh, carry, modem, start, tell) if udp or zenoh or modem else None

    def leave(status: int) -> NoReturn:
        if gateway is not None:
            gateway.close()
        _leave(status)

    def begun(text: str) -> None:
        nonlocal joined
        joined = True
        tell(f"{text}; Ctrl-C leaves it")

    def join() -> tuple[int, End]:
        joining = JoinFile.read(path)
        setproctitle.setproctitle(f"fleet agent {joining.vehicle} [{joining.scenario}]")
        quiet_zenoh()
        make = None if ros2 is None else _node(ros2, joining.vehicle, line)
        return joining.vehicle, serve(joining, begun, make if gateway is None else gateway.begin)

    try:
        with line:
            vehicle, end = join() if wait is None else patiently(join, wait / 1e9, path, line)
    except JoinError as error:
        report(error)
        leave(3 if joined else 2)
    except KeyboardInterrupt as error:
        tell("left the run" if joined else f"not waiting for {path} any longer" if wait else "no run was joined")
        leave(ending_status(error))
    except FleetError as error:
        leave(report(error))
    except SystemExit:
        leave(3)  # the law failed, and what it raised has been printed
    except Exception as error:
        click.echo(f"fleet: the law failed: {type(error).__name__}: {error}", err=True)
        leave(3)
    if gateway is not None:
        out, into, lost, late = gateway.counts
        without = f"; {late} waited longer than a round" if late else ""
        without += f"; {lost} found no room" if lost else ""
        tell(f"of the real programs {out} messages went into the network, {into} came{without}")
        if gateway.pace > _TOO_FAST:
            tell(f"the run was {gateway.pace:.2g} times faster than the wall clock of the real programs: --speed 1")
    tell(f"agent {vehicle}: {end.reason}")
    leave(0 if end.reason == RUN_OVER else 3)


def _gateway(
    udp: Sequence[str], zenoh: str, carry: Sequence[str], modem: str, start: str, tell: Callable[[str], None]
) -> Gateway:
    """What stands for real programs. Raises FleetError: a rule is none."""
    from fleet.addons.hosts.gateway import Gateway, UdpRule, modem_section

    section = modem_section(modem) if modem else None
    try:
        words = shlex.split(start)
    except ValueError as error:
        raise FleetError(f"--run: {start!r:.80} cannot be taken apart into words: {error}") from None
    return Gateway([UdpRule.of(text) for text in udp], zenoh, carry or ("**",), tell, section, words)


@cache
def _node(distribution: str, vehicle: int, line: StatusLine) -> MakeCore:
    """A function that makes a node of ROS 2, when there is one, the agent of a vehicle.

    Raises FleetError: nodes cannot meet.
    """
    from fleet.addons.robots.ros2.agent import RosAgent
    from fleet.addons.robots.ros2.node import RosNode, open_ros_session
    from fleet.addons.robots.ros2.rmw import domain_of
    from fleet.addons.robots.ros2.types import types_of

    types, domain = types_of(distribution), domain_of(None)
    bus, words = open_ros_session(None, None)
    line.print(f"ROS 2: domain {domain}, {words}")
    adapter = RosAgent(RosNode(bus, types, domain, f"uuv_{vehicle}_agent"), vehicle, line.print)
    adapter.wait_for_node()
    return adapter.begin


def patiently(join: Callable[[], T], wait_s: float, path: Path, line: StatusLine) -> T:
    """Try to join until it is possible, and tell each new reason why it is not.

    A file of a run that is over is no reason to end: the next run may write another one there.

    Raises NotYetError: it was not possible in that time; JoinError: it is no use to wait.
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
