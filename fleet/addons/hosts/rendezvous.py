"""How processes on several hosts meet in one run: where its router listens, or which other router it uses."""

from __future__ import annotations

import contextlib
import ipaddress
import re
import socket
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec

from fleet.addons.hosts.certificates import (
    ALWAYS,
    OWN,
    SERVER,
    ServerCertificate,
    host_name,
    read_ca,
    read_client,
    read_server,
)
from fleet.addons.hosts.certificates import path as certificate_path
from fleet.errors import FleetError
from fleet.execution.rendezvous import JoinFolder, KeyPair, Rendezvous
from netem.files import DamagedFile, ExposedFile, parse_json, read_private
from netem.limits import CREDENTIALS
from netem.wire.credentials import Credentials, Listener, agent_role, generate
from netem.wire.keys import Keys
from netem.wire.listening import probe_address

# Between hosts. A pull of up to a third of it is carried: the last sign of life may be a quarter of the lease old when
# it begins, and TCP's next attempt may come as late again as the pull was long.
LEASE_MS = 20_000
CERTIFIED = "--listen-certified"  # the option, for errors
RUN_ID = r"^(?=.*[A-Za-z0-9])[A-Za-z0-9_-]{1,64}$"  # one piece of a key expression
IN_CLEAR = (
    "{endpoint} is not encrypted and is for other hosts: whoever sees the traffic reads every state and can take over "
    "an agent's connection. Use it on a network that you trust, or fleet hosts certs and tls/"
)


@dataclass(frozen=True, slots=True)
class RouterEndpoint:
    """`tcp/HOST:PORT` or `tls/HOST:PORT`."""

    protocol: str
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.protocol}/{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def wildcard(self) -> bool:
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_unspecified
        return False

    @property
    def loopback(self) -> bool:
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"


def parse_endpoint(text: str, option: str) -> RouterEndpoint:
    """Read an endpoint as zenoh writes it.

    `option`: where it was given, for the error. Raises FleetError: it is none, or of another protocol.
    """
    protocol, slash, place = text.partition("/")
    host, colon, port = place.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    known = slash and protocol in ("tcp", "tls")
    if not known or not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise FleetError(f"{option}: expected tls/HOST:PORT or tcp/HOST:PORT such as tls/0.0.0.0:7447, got {text!r}")
    endpoint = RouterEndpoint(protocol, host, int(port))
    if not endpoint.wildcard:
        _host(option, host)
    return endpoint


def listening(
    listen: str,
    certs: Path | None = None,
    advertise: Sequence[str] = (),
    *,
    external: Sequence[int] = (),
    mutual: bool = False,
    lease_ms: int = LEASE_MS,
) -> Rendezvous:
    """The rendezvous of a run whose own router also listens for other hosts.

    Args:
        listen: the endpoint of the router. `0.0.0.0` and `[::]` mean every address of this host.
        certs: for tls, the directory that `fleet hosts certs` has made.
        advertise: names or addresses that agents on other hosts use. Default: those of the certificate, or this host's
            address.
        external: vehicles with an agent on another host; `mutual`: these must show their own certificates.

    Raises FleetError: the arguments contradict each other, or the certificates cannot be used.
    """
    endpoint = parse_endpoint(listen, "--listen")
    if endpoint.protocol == "tcp" and (certs or mutual):
        raise FleetError(
            f"--certs and --mutual-tls are for tls: --listen {RouterEndpoint('tls', endpoint.host, endpoint.port)}"
        )
    hosts = [_host("--advertise", host) for host in advertise]
    if endpoint.protocol == "tcp":
        hosts = hosts or [_own_address() if endpoint.wildcard else endpoint.host]
        reached = ",".join(str(RouterEndpoint("tcp", host, endpoint.port)) for host in hosts)
        warnings = () if endpoint.loopback else (IN_CLEAR.format(endpoint=endpoint),)
        return Rendezvous(
            listener=Listener((str(endpoint),), lease_ms), reached=reached, lease_ms=lease_ms, warnings=warnings
        )
    if certs is None:
        raise FleetError(
            f"{endpoint} needs certificates: make them, fleet hosts certs DIR --host NAME, then --certs DIR"
        )
    server = read_server(certs)
    roles = [agent_role(i) for i in external] if mutual else []
    return Rendezvous(
        listener=_with_tls(endpoint, lease_ms, server, roles),
        reached=",".join(_public_endpoints(endpoint, hosts, server, certs)),
        ca=server.ca,
        certificates={role: read_client(certs, role) for role in roles},
        lease_ms=lease_ms,
    )


def listening_for_certificates(
    rendezvous: Rendezvous,
    listen: str,
    certs: Path | None,
    advertise: Sequence[str] = (),
    *,
    external: Sequence[int] = (),
    lease_ms: int = LEASE_MS,
) -> Rendezvous:
    """The same rendezvous, where the run also listens for agents that have a certificate and no password.

    Arguments as for `listening`; the endpoint is another one, for tls. Raises FleetError as well.
    """
    endpoint = parse_endpoint(listen, CERTIFIED)
    if endpoint.protocol != "tls":
        safe = RouterEndpoint("tls", endpoint.host, endpoint.port)
        raise FleetError(f"{CERTIFIED}: certificates are shown with tls only: {CERTIFIED} {safe}")
    if certs is None:
        raise FleetError(
            f"{CERTIFIED} needs certificates: fleet hosts certs DIR --host NAME --agents N, then --certs DIR"
        )
    if rendezvous.listener and any(parse_endpoint(e, "").port == endpoint.port for e in rendezvous.listener.endpoints):
        raise FleetError(f"--listen and {CERTIFIED} are two routers: give them a port each, not both {endpoint.port}")
    server = read_server(certs)
    reached = _public_endpoints(endpoint, [_host("--advertise", host) for host in advertise], server, certs)
    return replace(
        rendezvous,
        certified=_with_tls(endpoint, lease_ms, server, map(agent_role, external)),
        folders={i: JoinFolder(i, reached, lease_ms, server.ca, read_client(certs, agent_role(i))) for i in external},
    )


def _with_tls(endpoint: RouterEndpoint, lease_ms: int, server: ServerCertificate, roles: Iterable[str]) -> Listener:
    own = server.pair
    return Listener((str(endpoint),), lease_ms, server.ca, own.certificate, own.key, certified=frozenset(roles))


def check_free(listen: str, option: str = "--listen") -> None:
    """Check that the world will be able to listen there.

    `option`: where it was given, for the error. Raises FleetError: the port is taken or not for us, or the address is
    not of this host.
    """
    endpoint = parse_endpoint(listen, option)
    try:
        probe_address(endpoint.host, endpoint.port)
    except OSError as error:
        raise FleetError(
            f"{option}: {listen} cannot be used ({error.strerror}); choose another address or port"
        ) from None


def join_router(
    router: str,
    credentials: Path,
    vehicles: int,
    certs: Path | None = None,
    *,
    external: Sequence[int] = (),
    mutual: bool = False,
    lease_ms: int = LEASE_MS,
) -> Rendezvous:
    """The rendezvous of a run whose processes join an existing router.

    Args:
        credentials: the file that `fleet hosts acl -o` wrote beside the router's configuration.
        certs: a directory with the CA of the router. For mutual TLS it also has the clients' certificates.
        external: vehicles with an agent on another host; `mutual`: clients must show certificates.

    Raises FleetError: the arguments contradict each other, the file is for another number of vehicles, or the
    certificates cannot be used.
    """
    endpoint = parse_endpoint(router, "--router")
    if endpoint.wildcard:
        raise FleetError(f"--router: {router} is an address to listen on; expected the router's own address")
    if endpoint.protocol == "tcp" and (certs or mutual):
        raise FleetError(
            f"--certs and --mutual-tls are for tls: --router {RouterEndpoint('tls', endpoint.host, endpoint.port)}"
        )
    if mutual and certs is None:
        raise FleetError("--mutual-tls needs the certificates: --certs DIR")
    run, known = read_credentials(credentials, vehicles)
    ca = read_ca(certs) if certs else ""
    own = read_client(certs, OWN) if certs and mutual else KeyPair("", "")
    roles = [agent_role(i) for i in external] if mutual else []
    return Rendezvous(
        run=run,
        router=str(endpoint),
        credentials={
            role: Credentials(c.user, c.password, ca, own.certificate, own.key, lease_ms) for role, c in known.items()
        },
        ca=ca,
        certificates={role: read_client(certs, role) for role in roles if certs},
        lease_ms=lease_ms,
        warnings=() if endpoint.loopback or endpoint.protocol == "tls" else (IN_CLEAR.format(endpoint=endpoint),),
    )


class _CredentialsFile(msgspec.Struct):
    """The file that `fleet hosts acl` writes for `fleet run`."""

    run: Annotated[str, msgspec.Meta(pattern=RUN_ID)]
    vehicles: Annotated[int, msgspec.Meta(ge=1)]
    users: dict[str, tuple[str, str]]  # by role: user and password


def new_credentials(run: str, vehicles: int) -> dict[str, Any]:
    """The content of a credentials file: the run's id, and user and password of every role."""
    fresh = generate(tuple(range(1, vehicles + 1)), prefix=f"{run}-", world=True)
    return {"run": run, "vehicles": vehicles, "users": {role: [c.user, c.password] for role, c in fresh.items()}}


def read_credentials(file: Path, vehicles: int) -> tuple[str, dict[str, Credentials]]:
    """The run's id and the credentials by role.

    Raises FleetError: no such file, others can read it, it is damaged, or made for another number of vehicles.
    """
    again = "make it with fleet hosts acl SCENARIO -o DIR"
    try:
        found = parse_json(read_private(file, CREDENTIALS.bytes), _CredentialsFile)
    except OSError as error:
        raise FleetError(f"{file} cannot be read: {error.strerror}; {again}") from None
    except ExposedFile as error:
        raise FleetError(str(error)) from None
    except DamagedFile as error:
        raise FleetError(f"{file} is no credentials file: {error}; {again}") from None
    if found.vehicles != vehicles:
        raise FleetError(f"{file} was made for {found.vehicles} vehicles, and the scenario has {vehicles}; {again}")
    if missing := new_credentials(found.run, vehicles)["users"].keys() - found.users.keys():
        raise FleetError(f"{file} lacks {', '.join(sorted(missing))}; {again}")
    return found.run, {role: Credentials(*known) for role, known in found.users.items()}


def run_id(text: str) -> str:
    """Check a run's id, which is one piece of a key expression and the beginning of user names.

    Raises FleetError: it has other characters, or too many.
    """
    if not re.fullmatch(RUN_ID, text):
        raise FleetError(f"--run: expected letters, digits, - and _ such as sea-trial-3, got {text!r}")
    return Keys(text).run


def _host(option: str, host: str) -> str:
    try:
        return host_name(host)
    except FleetError as error:
        raise FleetError(f"{option}: {error}") from None


def _public_endpoints(
    endpoint: RouterEndpoint, hosts: list[str], server: ServerCertificate, certs: Path
) -> tuple[str, ...]:
    """The endpoints under which agents reach a tls listener, at `hosts` or else at those of its certificate.

    Raises FleetError: a name that the certificate does not hold: every agent would refuse it later.
    """
    named = server.hosts
    if not hosts:
        others = [host for host in named if host not in ALWAYS]
        hosts = (others or list(named)) if endpoint.wildcard else [endpoint.host]
    for host in hosts:
        wild = "*." + host.partition(".")[2]
        if host not in named and wild not in named:
            file, known = certificate_path(certs, SERVER), ", ".join(named) or "nobody"
            raise FleetError(
                f"{file} is for {known}, not for {host}: agents refuse it. Make another: fleet hosts certs {certs} "
                f"{' '.join(f'--host {name}' for name in (*named, host) if name not in ALWAYS)} --force; "
                "or --advertise one of those"
            )
    return tuple(str(RouterEndpoint("tls", host, endpoint.port)) for host in hosts)


def _own_address() -> str:
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))
        return str(probe.getsockname()[0])
    raise FleetError("the address of this host for agents is unknown: name it with --advertise HOST")
