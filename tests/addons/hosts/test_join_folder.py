"""The folder with which an agent joins that has a certificate and no password."""

from __future__ import annotations

from pathlib import Path

from fleet.execution.directory import remove_secrets
from fleet.execution.rendezvous import JoinFolder, KeyPair
from netem.wire.keys import Keys

FOLDER = JoinFolder(3, ("tls/sea:1", "tls/192.0.2.7:1"), 20_000, "the CA\n", KeyPair("the certificate\n", "the key\n"))


def test_it_holds_everything_as_plain_text_and_is_for_this_user_only(tmp_path: Path) -> None:
    path = tmp_path / "join-3"
    FOLDER.write(path, Keys("ab"), 0, 0)
    FOLDER.write(path, Keys("ab"), 2, 40)  # another life
    assert (path / "join.conf").read_text().splitlines() == [
        "version 2", "endpoint tls/sea:1", "endpoint tls/192.0.2.7:1", "lease_ms 20000", "run ab", "vehicle 3",
        "incarnation 2", "begin 40", "cfg fleet/ab/cfg/3", "nav fleet/ab/nav/3", "rx fleet/ab/rx/3",
        "cmd fleet/ab/cmd/3", "tx fleet/ab/tx/3", "note fleet/ab/note/agent-3", "alive fleet/ab/alive/agent-3",
    ]  # fmt: skip
    assert {file.name: file.read_text() for file in path.glob("*.pem")} == {
        "ca.pem": "the CA\n",
        "certificate.pem": "the certificate\n",
        "key.pem": "the key\n",
    }
    assert path.stat().st_mode & 0o777 == 0o700
    assert {file.stat().st_mode & 0o777 for file in path.iterdir()} == {0o600}
    assert "the key" not in repr(FOLDER)


def test_what_a_killed_run_left_is_removed(tmp_path: Path) -> None:
    FOLDER.write(tmp_path / "join-3", Keys("ab"), 0, 0)
    (tmp_path / "join-3.json").write_text("{}")
    (tmp_path / "run.mcap").write_text("")
    remove_secrets(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
