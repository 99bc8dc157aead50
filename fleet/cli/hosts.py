"""The commands `fleet hosts` that prepare a run over several hosts, and the options of `fleet run` for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from fleet.cli.completion import scenarios
from fleet.cli.group import ListingGroup
from fleet.cli.types import FOLDER, FORCE, OVERRIDES, PATH, Whole, time_within
from fleet.errors import FleetError

if TYPE_CHECKING:
    from fleet.hosts.rendezvous import Rendezvous
    from fleet.scenario.scenario import Scenario

F = TypeVar("F", bound=Callable[..., Any])
# Limits of --lease [s]. Between processes of one host the lease is an hour.
_LEASES_S = (2, 1800)

_LEASE = click.option("--lease", type=time_within(*_LEASES_S), default="20 s", show_default=True,
                      help="Close a link between hosts after this time without a sign of life.")  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class HostsOptions:
    """The values of `hosts_options`."""

    listen: str | None
    listen_certified: str | None
    certs: Path | None
    advertise: tuple[str, ...]
    mutual_tls: bool
    router: str | None
    credentials: Path | None
    lease: int  # ns


def hosts_options(command: F) -> F:
    """Add the options of `fleet run` for agents on other hosts; `rendezvous` reads their values."""
    folder, file = (click.Path(path_type=Path, file_okay=dir_, dir_okay=not dir_) for dir_ in (False, True))
    for option in (
        _LEASE,
        click.option("--credentials", metavar="FILE", type=file, help="With --router: the file of fleet hosts acl -o."),
        click.option("--router", metavar="ENDPOINT", help="Join this zenoh router instead of hosting one."),
        click.option("--mutual-tls", is_flag=True, help="External agents show client certificates, too."),
        click.option("--advertise", metavar="HOST", multiple=True,
                     help="With --listen: this host's name or address for agents; repeatable."),
        click.option("--certs", metavar="DIR", type=folder, help="Certificates for tls, made by fleet hosts certs."),
        click.option("--listen-certified", metavar="ENDPOINT",
                     help="Also listen here for agents with a certificate and no password (zenoh-pico)."),
        click.option("--listen", metavar="ENDPOINT",
                     help="Also listen for agents on other hosts, e.g. tls/0.0.0.0:7447."),
    ):  # fmt: skip
        command = option(command)
    return command


def rendezvous(scenario: Scenario, options: HostsOptions, *, in_process: bool) -> Rendezvous | None:
    """Where the processes meet, by the options of `hosts_options`; None if none of these options is given.

    Raises FleetError: they do not go together, or with the scenario.
    """
    names = ("listen", "listen_certified", "router", "certs", "advertise", "mutual_tls", "credentials")
    given = [name for name in names if getattr(options, name)]
    if not given:
        return None
    from fleet.hosts import rendezvous as meeting

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


@hosts.command()
@click.argument("directory", type=FOLDER)
@click.option("--host", "names", metavar="NAME_OR_IP", multiple=True,
              help="Name or address that agents use for the router; repeatable. Loopback is always added.")  # fmt: skip
@click.option("--agents", metavar="N", type=Whole(0, 1000), default=0,
              help="For mutual TLS: client certificates for agents 1 to N, and for the run itself.")  # fmt: skip
@click.option("--days", metavar="N", type=Whole(1, 3650), default=365, show_default=True,
              help="How long the certificates are valid.")  # fmt: skip
@FORCE
def certs(directory: Path, names: tuple[str, ...], agents: int, days: int, force: bool) -> None:
    """Make a certificate authority and a router's certificate in DIR, for runs over several hosts.

    The authority's own key is not kept, so it can never sign anything else. Only you can read the keys.

    \b
    Examples:
      fleet hosts certs certs --host sea.example.org --host 192.0.2.7
      fleet hosts certs certs --host 192.0.2.7 --agents 4      also client certificates, for --mutual-tls
    """
    from fleet.hosts.certificates import ALWAYS, make

    make(directory, names, agents=agents, days=days, force=force)
    click.echo(f"wrote {directory}: a router's certificate for {', '.join([*names, *ALWAYS])}", err=True)
    if not names:
        click.echo("warning: agents on other hosts cannot use it: name this host with --host", err=True)


@hosts.command()
@click.argument("scenario", shell_complete=scenarios)
@click.option("-o", "--out", "out", type=FOLDER,
              help="Write router.json5, users and credentials.json to DIR; by default print router.json5.")  # fmt: skip
@click.option("--run", "run", metavar="ID", help="The run's id; by default a random one.")
@click.option("--listen", metavar="ENDPOINT", default="tls/0.0.0.0:7447", show_default=True,
              help="Where the router listens.")  # fmt: skip
@click.option("--certs", type=FOLDER, help="Where the router finds its certificate, for tls.")
@click.option("--mutual-tls", is_flag=True, help="The router asks clients for certificates.")
@click.option("--users-file", metavar="PATH", type=PATH, help="Where the router finds the users; by default in DIR.")
@_LEASE
@OVERRIDES
@FORCE
def acl(
    scenario: str,
    out: Path | None,
    run: str | None,
    listen: str,
    certs: Path | None,
    mutual_tls: bool,
    users_file: Path | None,
    lease: int,
    overrides: tuple[str, ...],
    force: bool,
) -> None:
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

    from fleet.hosts import router_config as lists
    from fleet.hosts.rendezvous import parse_endpoint, run_id
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
