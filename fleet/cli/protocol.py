"""The commands for authors of agents in other languages: `fleet protocol` and `fleet protocol check`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from fleet.cli.completion import scenarios
from fleet.cli.group import ListingGroup
from fleet.cli.types import TRUST, Duration, Whole

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
        from fleet.protocol.page import page

        click.echo(page(), nl=False)


@protocol.command(epilog=_CHECK)
@click.option("--id", "vehicle", metavar="I", type=Whole(min=1), required=True, help="The agent's number.")
@click.option("--scenario", default="paper", show_default=True, shell_complete=scenarios,
              help="The scenario of the agent's slice.")  # fmt: skip
@TRUST
@click.option("--join-file", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False),
              help="Where to write the join file; by default join-<i>.json here.")  # fmt: skip
@click.option("--timeout", type=Duration(), default="300 s", show_default=True, help="How long to wait for the agent.")
@click.option("--port", type=Whole(1, 65535), help="Loopback port of the router; by default a free one.")
@click.option("--listen-certified", metavar="ENDPOINT",
              help="Also listen here for an agent with a certificate and no password (zenoh-pico).")  # fmt: skip
@click.option("--certs", metavar="DIR", type=click.Path(path_type=Path, file_okay=False),
              help="With --listen-certified: certificates, made by fleet hosts certs.")  # fmt: skip
def check(
    vehicle: int,
    scenario: str,
    join_file: Path | None,
    timeout: int,
    port: int | None,
    listen_certified: str | None,
    certs: Path | None,
) -> None:
    """Play world and netem against your agent, and judge all its messages.

    The command writes a join file, waits for the agent, and plays a fixed exchange. That has the handshake, ticks and
    round ticks, inboxes that come late, in parts and damaged, malformed messages, an earlier life, a gap, and the end.

    \b
    Examples:
      fleet protocol check --id 3
      fleet protocol check --id 2 --scenario rough-sea --join-file /tmp/join-2.json
      fleet protocol check --id 3 --listen-certified tls/127.0.0.1:7448 --certs certs
    """
    from fleet.errors import FleetError, printable
    from fleet.hosts.rendezvous import CERTIFIED, Rendezvous, check_free, listening_for_certificates
    from fleet.protocol.conformance import Examination
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


COMMANDS = (protocol,)
