"""A run with agents on other hosts: the options of `fleet run` that say where its processes meet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fleet.cli.companion import Companion
from fleet.cli.types import FILE, FOLDER, is_given, time_within
from fleet.errors import FleetError
from fleet.option import Option, fields

if TYPE_CHECKING:
    from fleet.execution.rendezvous import Rendezvous
    from fleet.execution.wiring import Wiring
    from fleet.scenario.scenario import Scenario

# Limits of --lease [s]. Between processes of one host the lease is an hour.
_LEASES_S = (2, 1800)
Lease = Annotated[
    int, time_within(*_LEASES_S), Option("Close a link between hosts after this time without a sign of life.")
]
LEASE_NS = 20 * 10**9


@dataclass(frozen=True, kw_only=True, slots=True)
class HostsOptions:
    """The options of `fleet run` for agents on other hosts."""

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
    from fleet.execution.rendezvous import Rendezvous

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
        found = Rendezvous()
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
    return meeting.join_router(
        router, known, scenario.vehicles, certs, external=external, mutual=mutual, lease_ms=lease_ms
    )


class Hosts(Companion):
    """Another way for the processes of a run to meet."""

    options_type = HostsOptions

    @property
    def asked(self) -> bool:
        """Whether there are other hosts. A lease alone asks for none."""
        return any(is_given(name) for name in fields(HostsOptions) if name != "lease")

    def wire(self, scenario: Scenario, wiring: Wiring, one_process: str) -> Wiring:
        """The run meets where the options say. Raises FleetError: they do not go together, or with the scenario."""
        return replace(wiring, rendezvous=rendezvous(scenario, self.options, in_process=bool(one_process)))
