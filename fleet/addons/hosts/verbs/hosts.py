"""The commands `fleet hosts`, which prepare a run over several hosts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.addons.hosts.companion import LEASE_NS, Lease
from fleet.cli.changes import Overrides
from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.group import ListingGroup
from fleet.cli.types import FOLDER, Force, Whole
from fleet.errors import FleetError
from fleet.option import Option

if TYPE_CHECKING:
    pass


@click.group(cls=ListingGroup)
def hosts() -> None:
    """Prepare a run over several hosts: make certificates, or the configuration of a zenoh router.

    \b
    Examples:
      fleet hosts certs certs --host sea.example.org
      fleet hosts acl paper -o acl --certs certs
    """


@command(group=hosts)
def certs(
    directory: Annotated[Path, FOLDER],
    *,
    host: Annotated[tuple[str, ...], Option(
        "Name or address that agents use for the router; repeatable. Loopback is always added.", "NAME_OR_IP")] = (),
    agents: Annotated[int, Whole(0, 1000), Option(
        "For mutual TLS: client certificates for agents 1 to N, and for the run itself.", "N")] = 0,
    days: Annotated[int, Whole(1, 3650), Option("How long the certificates are valid.", "N")] = 365,
    force: Force = False,
) -> None:  # fmt: skip
    """Make a certificate authority and a router's certificate in DIR, for runs over several hosts.

    The authority's own key is not kept, so it can never sign anything else. Only you can read the keys.

    \b
    Examples:
      fleet hosts certs certs --host sea.example.org --host 192.0.2.7
      fleet hosts certs certs --host 192.0.2.7 --agents 4      also client certificates, for --mutual-tls
    """
    from fleet.addons.hosts.certificates import ALWAYS, make

    make(directory, host, agents=agents, days=days, force=force)
    click.echo(f"wrote {directory}: a router's certificate for {', '.join([*host, *ALWAYS])}", err=True)
    if not host:
        click.echo("warning: agents on other hosts cannot use it: name this host with --host", err=True)


@command(group=hosts)
def acl(
    scenario: Annotated[str, scenarios],
    *,
    out: Annotated[Path | None, FOLDER, Option(
        "Write router.json5, users and credentials.json to DIR; by default print router.json5.",
        flag="-o --out")] = None,
    run: Annotated[str | None, Option("The run's id; by default a random one.", "ID")] = None,
    listen: Annotated[str, Option("Where the router listens.", "ENDPOINT")] = "tls/0.0.0.0:7447",
    certs: Annotated[Path | None, FOLDER, Option("Where the router finds its certificate, for tls.")] = None,
    mutual_tls: Annotated[bool, Option("The router asks clients for certificates.")] = False,
    users_file: Annotated[Path | None, Option("Where the router finds the users; by default in DIR.")] = None,
    lease: Lease = LEASE_NS,
    overrides: Overrides = (),
    force: Force = False,
) -> None:  # fmt: skip
    """Print a configuration that lets an existing zenoh router serve a run of SCENARIO.

    Passwords are never printed. With -o they go into files that only you can read: one for the router, and one for
    fleet run --credentials.

    \b
    Examples:
      fleet hosts acl paper -o acl --certs certs
      zenohd -c acl/router.json5                       on the router's host
      fleet run paper --router tls/sea.example.org:7447 --credentials acl/credentials.json --certs certs
    """
    from secrets import token_hex

    from fleet.addons.hosts import router_config as lists
    from fleet.addons.hosts.rendezvous import parse_endpoint, run_id
    from fleet.scenario.loading import load_scenario

    vehicles = load_scenario(scenario, overrides, imports=False).vehicles
    endpoint = parse_endpoint(listen, "--listen")
    if endpoint.protocol == "tls" and certs is None:
        raise FleetError(f"{endpoint} needs certificates: --certs DIR (fleet hosts certs DIR --host NAME); or tcp/")
    if endpoint.protocol == "tcp" and (certs or mutual_tls):
        raise FleetError("--certs and --mutual-tls are for tls/ endpoints")
    name = token_hex(4) if run is None else run_id(run)
    users = users_file or (out or Path()).absolute() / lists.USERS
    place = certs.absolute() if certs else None
    text = lists.config(
        name, vehicles, str(endpoint), str(users), place, mutual=mutual_tls, lease_ms=lease // 1_000_000
    )
    if out is None:
        click.echo(text, nl=False)
        return
    lists.write(out, name, vehicles, text, force=force)
    click.echo(
        f"wrote {out}: {lists.CONFIG} and {lists.USERS} for the router, {lists.CREDENTIALS} for the run", err=True
    )
