"""Certificates for runs over several hosts: an own certificate authority (CA) and the certificates that it signs.

The CA's key exists only while `make` runs, so nothing more can be signed with it, and another host needs a new set.
That is cheap, because every join file carries the CA that its agent shall trust.
"""

from __future__ import annotations

import contextlib
import ipaddress
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from fleet.errors import FleetError
from fleet.execution.rendezvous import KeyPair
from netem.files import ExposedFile, read_file, read_private
from netem.limits import CREDENTIALS
from netem.whole_file import write_whole

CA, SERVER = "ca", "server"
OWN = "fleet"  # what the run's own processes show to a router that asks for certificates
ALWAYS = ("localhost", "127.0.0.1")
_SKEW = timedelta(hours=1)  # a host's clock may be late
_LABEL = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?")


@dataclass(frozen=True, slots=True)
class ServerCertificate:
    """The certificate of a router that listens with TLS, and the names and addresses that it is valid for."""

    ca: str  # PEM
    pair: KeyPair
    hosts: tuple[str, ...]


def make(directory: Path, hosts: Sequence[str] = (), *, agents: int = 0, days: int = 365, force: bool = False) -> None:
    """Write `ca.pem`, `server.pem` and `server-key.pem`, and for mutual TLS the same for each client.

    Args:
        hosts: names and addresses of the router's host; loopback is always added.
        agents: if positive, agent-1 ... agent-N and the run's own processes get client certificates.

    Raises FleetError: a host that is none, files in the way, no place to write, or `cryptography` is missing.
    """
    names = list(dict.fromkeys([*map(host_name, hosts), *ALWAYS]))
    clients = [OWN, *(f"agent-{i}" for i in range(1, agents + 1))] if agents else []
    files = [
        path(directory, CA),
        *(path(directory, who, key=key) for who in [SERVER, *clients] for key in (False, True)),
    ]
    there = [file.name for file in files if file.exists()]
    if there and not force:
        raise FleetError(
            f"{directory} holds {', '.join(there[:4])}{', ...' if len(there) > 4 else ''} already; --force replaces "
            "them, and whoever trusts the old CA cannot join any more; or choose another directory"
        )
    made = _sign(names, clients, days)
    try:
        if not directory.exists():
            directory.mkdir(mode=0o700, parents=True)
        for who, (certificate, key) in made.items():
            write_whole(path(directory, who), certificate, 0o644)
            if key:
                write_whole(path(directory, who, key=True), key)
    except OSError as error:
        raise FleetError(f"{directory} cannot be written: {error.strerror}") from None


def path(directory: Path, who: str, *, key: bool = False) -> Path:
    """The file of a certificate, or of the key to it. `who`: `CA`, `SERVER`, `OWN` or a role."""
    return directory / f"{who}{'-key' if key else ''}.pem"


def host_name(text: str) -> str:
    """A host name or address in the spelling of certificates. Raises FleetError: it is neither."""
    with contextlib.suppress(ValueError):
        address = ipaddress.ip_address(text.removeprefix("[").removesuffix("]"))
        if address.is_unspecified:
            raise FleetError(f"{text} is an address to listen on; expected the address that others use for this host")
        return str(address)
    labels = text.rstrip(".").split(".")
    if len(text) > 253 or not all(_LABEL.fullmatch(label) for label in labels) or labels[-1].isdigit():
        raise FleetError(
            f"expected a host name or an IP address such as sea.example.org or 192.0.2.7, without a port, got {text!r}"
        )
    return text.rstrip(".").lower()


def read_ca(directory: Path) -> str:
    """Read the CA's certificate, PEM. Raises FleetError: there is none."""
    text = _read(path(directory, CA))
    _parse(path(directory, CA), text)
    return text


def read_server(directory: Path) -> ServerCertificate:
    """Read the router's certificate with its key.

    Raises FleetError: a file is missing or damaged, the certificate is out of date or is not the CA's, the key is not
    the certificate's, or others can read it.
    """
    x509 = _cryptography()
    ca, pair = read_ca(directory), read_client(directory, SERVER)
    certificate = _parse(path(directory, SERVER), pair.certificate)[0]
    hosts: list[str] = []
    with contextlib.suppress(x509.ExtensionNotFound):
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = [str(name.value) for name in names]
    return ServerCertificate(ca, pair, tuple(hosts))


def read_client(directory: Path, who: str) -> KeyPair:
    """Read the certificate of a client with its key. Raises FleetError: as for `read_server`."""
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    ca_path, certificate_path, key_path = path(directory, CA), path(directory, who), path(directory, who, key=True)
    authorities = _parse(ca_path, _read(ca_path))
    pair = KeyPair(_read(certificate_path), _read(key_path, private=True))
    certificate, *between = _parse(certificate_path, pair.certificate)
    try:
        key = load_pem_private_key(pair.key.encode(), password=None)
    except (ValueError, TypeError):
        raise FleetError(f"{key_path} holds no private key in PEM without a passphrase") from None
    if key.public_key() != certificate.public_key():
        raise FleetError(f"{key_path} is not the key of {certificate_path}; make all again: {_again(directory)}")
    now = datetime.now(UTC)  # noqa: TID251 (certificates are in wall time)
    if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
        span = f"{certificate.not_valid_before_utc:%Y-%m-%d %H:%M} to {certificate.not_valid_after_utc:%Y-%m-%d %H:%M}"
        raise FleetError(
            f"{certificate_path} is valid from {span} UTC, and now it is {now:%Y-%m-%d %H:%M}; "
            f"make all again with {_again(directory)}, or set the clock"
        )
    if not any(_signed_by(certificate, each) for each in (*authorities, *between)):
        raise FleetError(
            f"{certificate_path} was not signed by {ca_path}: they are of different CAs; "
            f"make all again: {_again(directory)}"
        )
    return pair


def _signed_by(certificate: Any, authority: Any) -> bool:
    from cryptography.exceptions import InvalidSignature

    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _sign(hosts: list[str], clients: list[str], days: int) -> dict[str, tuple[bytes, bytes]]:
    """Certificate and key, PEM, by name; of the CA the certificate only."""
    x509 = _cryptography()
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    def named(text: str) -> Any:
        return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])

    issuer = named(f"uuv-fleet CA {secrets.token_hex(4)}")
    ca_key = ec.generate_private_key(ec.SECP256R1())
    begin = datetime.now(UTC).replace(microsecond=0) - _SKEW  # noqa: TID251
    end = begin + _SKEW + timedelta(days=days)

    def signed(subject: Any, public_key: Any, extensions: list[tuple[Any, bool]]) -> bytes:
        builder = x509.CertificateBuilder(issuer, subject, public_key, x509.random_serial_number(), begin, end)
        for extension, critical in extensions:
            builder = builder.add_extension(extension, critical)
        certificate: bytes = builder.sign(ca_key, hashes.SHA256()).public_bytes(Encoding.PEM)
        return certificate

    def may(**allowed: bool) -> Any:
        kinds = ("content_commitment", "key_encipherment", "data_encipherment", "key_agreement", "key_cert_sign")
        nothing = dict.fromkeys(("digital_signature", *kinds, "crl_sign", "encipher_only", "decipher_only"), False)
        return x509.KeyUsage(**(nothing | allowed))

    def leaf(name: str, purpose: Any, names: list[Any]) -> tuple[bytes, bytes]:
        key = ec.generate_private_key(ec.SECP256R1())
        extensions = [
            (x509.BasicConstraints(ca=False, path_length=None), True),
            (may(digital_signature=True), True),
            (x509.ExtendedKeyUsage([purpose]), False),
            (x509.SubjectAlternativeName(names), False),
        ]
        private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        return signed(named(name), key.public_key(), extensions), private

    root = [(x509.BasicConstraints(ca=True, path_length=0), True), (may(key_cert_sign=True, crl_sign=True), True)]
    made = {CA: (signed(issuer, ca_key.public_key(), root), b"")}
    made[SERVER] = leaf(hosts[0][:64], ExtendedKeyUsageOID.SERVER_AUTH, [_san(host) for host in hosts])
    for client in clients:
        made[client] = leaf(client, ExtendedKeyUsageOID.CLIENT_AUTH, [x509.DNSName(client)])
    return made


def _san(host: str) -> Any:
    x509 = _cryptography()
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _parse(file: Path, text: str) -> list[Any]:
    """The certificates in a file; of a chain the first is the own one."""
    try:
        return list(_cryptography().load_pem_x509_certificates(text.encode()))
    except ValueError:
        raise FleetError(f"{file} holds no certificate in PEM") from None


def _again(directory: Path, agents: str = "") -> str:
    """The command that makes a directory of certificates, for errors; it mentions --force if there are some already."""
    there = next(directory.glob("*.pem"), None) is not None
    more = " --force, with each --host that it was for and all agents" if there else ""
    return f"fleet hosts certs {directory} --host NAME{agents}{more}"


def _read(file: Path, *, private: bool = False) -> str:
    try:
        return (read_private if private else read_file)(file, CREDENTIALS.bytes).decode("ascii")
    except ExposedFile as error:
        raise FleetError(str(error)) from None
    except FileNotFoundError:
        agents = f" --agents {who.group(1)}" if (who := re.match(r"agent-(\d+)", file.name)) else ""
        raise FleetError(f"{file} is missing; make it: {_again(file.parent, agents)}") from None
    except OSError as error:
        raise FleetError(f"{file} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FleetError(f"{file} is not PEM: expected text between BEGIN and END lines") from None


def _cryptography() -> Any:
    try:
        from cryptography import x509
    except ImportError:
        raise FleetError(
            "certificates need the package cryptography, which is not installed: pip install 'uuv-fleet[hosts]'"
        ) from None
    return x509
