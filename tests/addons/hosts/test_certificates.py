"""Certificates: made for the hosts, for us alone, and refused in words when they cannot work."""

from __future__ import annotations

import stat
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from host_certificates import made as made
from refusals import check_refusals

from fleet.addons.hosts import certificates
from fleet.addons.hosts.rendezvous import listening
from fleet.errors import FleetError
from netem.whole_file import write_whole

x509 = pytest.importorskip("cryptography.x509", reason="cryptography is not installed: pip install 'uuv-fleet[hosts]'")


# Certificates
def test_certificates_are_for_the_hosts_and_keys_are_ours_alone(made: Path) -> None:
    server = certificates.read_server(made)
    assert server.hosts == ("sea.example.org", "192.0.2.7", "2001:db8::7", "localhost", "127.0.0.1")
    keys = sorted(file.name for file in made.glob("*-key.pem"))
    assert keys == ["agent-1-key.pem", "agent-2-key.pem", "fleet-key.pem", "server-key.pem"]  # and none of the CA
    assert {stat.S_IMODE((made / name).stat().st_mode) for name in keys} == {0o600}
    assert stat.S_IMODE(made.stat().st_mode) == 0o700
    certificate = x509.load_pem_x509_certificate((made / "server.pem").read_bytes())
    now = datetime.now(UTC)  # noqa: TID251
    assert certificate.not_valid_before_utc < now - timedelta(minutes=50)  # for a client whose clock is late
    assert timedelta(days=364) < certificate.not_valid_after_utc - now <= timedelta(days=365)
    assert server.pair.key not in repr(server)


def test_nothing_is_replaced_unless_forced(made: Path, tmp_path: Path) -> None:
    before = {file.name: file.read_bytes() for file in made.iterdir()}
    with pytest.raises(FleetError, match=r"holds ca\.pem, server\.pem.*--force"):
        certificates.make(made)
    assert before == {file.name: file.read_bytes() for file in made.iterdir()}
    certificates.make(tmp_path / "a")
    first = (tmp_path / "a" / "ca.pem").read_bytes()
    certificates.make(tmp_path / "a", force=True)
    assert (tmp_path / "a" / "ca.pem").read_bytes() != first
    assert certificates.read_server(tmp_path / "a").hosts == certificates.ALWAYS


def _other_ca(directory: Path) -> None:
    certificates.make(directory.parent / "other", force=True)
    (directory / "ca.pem").write_bytes((directory.parent / "other" / "ca.pem").read_bytes())


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no CA": lambda d: (d / "ca.pem").unlink(),
    "no key": lambda d: (d / "server-key.pem").unlink(),
    "key for all": lambda d: (d / "server-key.pem").chmod(0o644),
    "no PEM": lambda d: (d / "server.pem").write_bytes(b"\xff\x00"),
    "no certificate": lambda d: (d / "server.pem").write_text("x"),
    "no private key": lambda d: (d / "server-key.pem").write_text("x"),
    "another CA": _other_ca,
    "another key": lambda d: (d / "server-key.pem").write_bytes((d / "agent-1-key.pem").read_bytes()),
}


def test_certificates_that_cannot_work_are_refused_with_the_cure(tmp_path: Path) -> None:
    def read(damage: str) -> None:
        certificates.make(tmp_path / "c", agents=1, force=True)
        DAMAGES[damage](tmp_path / "c")
        certificates.read_server(tmp_path / "c")

    check_refusals("hosts/damaged certificates", read, DAMAGES, hide={str(tmp_path): "HERE"})


def test_a_certificate_out_of_date_is_refused(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Later(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Later:
            return cls.fromtimestamp(datetime.now(tz).timestamp() + 366 * 86400, tz)  # noqa: TID251

    monkeypatch.setattr(certificates, "datetime", Later)
    with pytest.raises(FleetError, match=r"is valid from .* now it is .*--force"):
        certificates.read_server(made)


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "key.pem"
    write_whole(file, b"old")
    assert stat.S_IMODE(file.stat().st_mode) == 0o600

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("netem.whole_file.os.replace", full)
    with pytest.raises(OSError, match="No space"):
        write_whole(file, b"new")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("key.pem", b"old")]


@pytest.mark.parametrize("text", ["", "a b", "tls/x:1", "x:7447", "0.0.0.0", "::", "1.2.3", "-x", "a..b", "é"])
def test_what_is_no_host_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(FleetError):
        certificates.make(tmp_path / "c", [text])
    assert not (tmp_path / "c").exists()


def test_agents_are_told_what_the_certificate_holds(made: Path) -> None:
    everywhere = listening("tls/0.0.0.0:7447", made)
    assert everywhere.reached == "tls/sea.example.org:7447,tls/192.0.2.7:7447,tls/[2001:db8::7]:7447"
    assert (
        everywhere.ca == (made / "ca.pem").read_text()
        and everywhere.listener
        and everywhere.listener.certified == set()
    )
    assert listening("tls/192.0.2.7:1", made).reached == "tls/192.0.2.7:1"
    assert listening("tls/0.0.0.0:1", made, ["SEA.example.org"]).reached == "tls/sea.example.org:1"
    with pytest.raises(FleetError, match=r"not for 192\.0\.2\.8.*fleet hosts certs .* --host 192\.0\.2\.8 --force"):
        listening("tls/0.0.0.0:1", made, ["192.0.2.8"])
