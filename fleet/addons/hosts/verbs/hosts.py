"""The commands `fleet hosts` that prepare a run over several hosts, and the options of `fleet run` for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.cli.changes import Overrides
from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.group import ListingGroup
from fleet.cli.types import FILE, FOLDER, Force, Whole, time_within
from fleet.errors import FleetError
from fleet.option import Option

if TYPE_CHECKING:
    from fleet.addons.hosts.rendezvous import Rendezvous
    from fleet.scenario.scenario import Scenario

# Limits of --lease [s]. Between processes of one host the lease is an hour.
_LEASES_S = (2, 1800)
Lease = Annotated[
    int, time_within(*_LEASES_S), Option("Close a link between hosts after this time without a sign of life.")
]
LEASE_NS = 20 * 10**9


@dataclass(frozen=True, kw_only=True, slots=True)
class HostsOptions:
    """The options of `fleet run` for agents on other hosts; `rendezvous` reads them."""

    listen: Annotated[str | None, Option(
        "Also listen for agents on other hosts, e.g. tls/0.0.0.0:7447.", "ENDPOINT")] = None  # fmt: skip
    listen_certified: Annotated[str | None, Option(
        "Also listen here for agents with a certificate and no password (zenoh-pico).", "ENDPOINT")] = (
            None)  # fmt: skip
    certs: Annotated[Path | None, FOLDER, Option("Certificates for tls, made by fleet hosts certs.")] = None
    advertise: Annotated[tuple[str, ...], Option(
        "With --listen: this host's name or address for agents; repeatable.", "HOST")] = ()  # fmt: skip
    mutual_tls: Annotated[bool, Option("External agents show client certificates, too.")] = False
    router: Annotated[str | None, Option("Join this zenoh router instead of hosting one.", "ENDPOINT")] = None
    credentials: Annotated[Path | None, FILE, Option("With --router: the file of fleet hosts acl -o.")] = None
    lease: Lease = LEASE_NS


def rendezvous(scenario: Scenario, options: HostsOptions, *, in_process: bool) -> Rendezvous | None:
    """Where the processes meet, by the options for it; None if none of these options is given.

    Raises FleetError: they do not go together, or with the scenario.
    """
    names = ("listen", "listen_certified", "router", "certs", "advertise", "mutual_tls", "credentials")
    given = [name for name in names if getattr(options, name)]
    if not given:
        return None
    from fleet.addons.hosts import rendezvous as meeting

    listen, router, lease_ms = options.listen, options.router, options.lease // 1_000_000
    certified = options.listen_certified
    spelt = "--" + given[0].replace("_", "-")
    if in_process:
        raise FleetError(f"{spelt}: a run in one process has no router that others could join")
    if certified and router:
        raise FleetError(
            f"{meeting.CERTIFIED} is for a run that hosts its router: the one of --router asks for passwords"
        )
    if listen and router:
        raise FleetError("either --listen or --router, not both")
    if not (listen or router or certified):
        raise FleetError(f"{spelt} needs --listen or --router")
    if options.mutual_tls and not (listen or router):
        raise FleetError(f"--mutual-tls is for --listen or --router: {meeting.CERTIFIED} always asks for certificates")
    certs, external = options.certs, scenario.external
    if lease_ms >= scenario.spec.stall_timeout / 1e6:
        raise FleetError(
            f"--lease {lease_ms / 1000:g} s is no shorter than stall_timeout {scenario.stall_timeout_s:g} s: "
            f"the run would break before a silent link ends: --set stall_timeout='{lease_ms / 500:g} s'"
        )
    if not router:
        if options.credentials:
            raise FleetError("--credentials is for --router: a router of its own makes fresh ones")
        found = meeting.Rendezvous()
        if listen:
            found = meeting.listening(
                listen, certs, options.advertise, external=external, mutual=options.mutual_tls, lease_ms=lease_ms
            )
            meeting.check_free(listen)
        if certified:
            found = meeting.listening_for_certificates(
                found, certified, advertise=options.advertise, certs=certs, external=external, lease_ms=lease_ms
            )
            meeting.check_free(certified, meeting.CERTIFIED)
        if not scenario.external:
            nobody = (
                f"{spelt}: no vehicle is external, so nobody can join; say who: --set external=true for all of them"
            )
            found = replace(found, warnings=(*found.warnings, nobody))
        return found
    if options.advertise:
        raise FleetError("--advertise is for --listen: agents are told the endpoint of --router")
    if not options.credentials:
        raise FleetError("--router needs --credentials FILE, which fleet hosts acl SCENARIO -o DIR writes")
    known, mutual = options.credentials, options.mutual_tls
    return meeting.through_router(
        router, known, scenario.vehicles, certs, external=external, mutual=mutual, lease_ms=lease_ms
    )


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


COMMANDS = (hosts,)
