"""Where the processes of a run meet: endpoints, options, warnings, and the lists for a router of your own."""

from __future__ import annotations

import contextlib
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest
from free_ports import free_port
from host_certificates import made as made
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT
from tool import invoke

from fleet.addons.hosts import router_config
from fleet.addons.hosts.companion import HostsOptions, rendezvous
from fleet.addons.hosts.rendezvous import listening, listening_for_certificates, parse_endpoint, read_credentials
from fleet.cli.group import command_of
from fleet.errors import FleetError
from fleet.execution.rendezvous import Rendezvous
from fleet.scenario.loading import load_scenario
from netem.wire.credentials import Credentials, Listener, agent_role

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'uuv-fleet[hosts]'")


# Endpoints and options
@given(st.sampled_from(["tcp", "tls"]), st.ip_addresses() | st.from_regex(r"[a-z]{1,9}(\.[a-z]{1,5})?", fullmatch=True),
       st.integers(1, 65535))  # fmt: skip
def test_an_endpoint_reads_back(protocol: str, host: Any, port: int) -> None:
    text = f"{protocol}/{f'[{host}]' if ':' in str(host) else host}:{port}"
    assert str(parse_endpoint(text, "--listen")) == text
    assert parse_endpoint(str(parse_endpoint(text, "")), "") == parse_endpoint(text, "")


@given(st.text(max_size=30))
def test_any_other_text_is_refused_in_words(text: str) -> None:
    with contextlib.suppress(FleetError):
        assert parse_endpoint(text, "--listen").port


def test_clear_text_is_warned_of_beyond_this_host() -> None:
    assert "not encrypted" in listening("tcp/192.0.2.7:1").warnings[0]
    assert not listening("tcp/127.0.0.1:1").warnings
    assert listening("tcp/0.0.0.0:1", advertise=["sea", "192.0.2.7"]).reached == "tcp/sea:1,tcp/192.0.2.7:1"


def test_listening_for_nobody_is_warned_of(made: Path) -> None:
    for overrides, warned in (([], True), (["external=true"], False)):
        options = {
            "listen": f"tls/127.0.0.1:{free_port()}",
            "certs": made,
            "advertise": (),
            "mutual_tls": False,
            "lease": 2000,
        }
        others = {"router": None, "credentials": None, "listen_certified": None}
        found = rendezvous(load_scenario("paper", overrides), HostsOptions(**(options | others)), in_process=False)
        assert found and ["no vehicle is external" in warning for warning in found.warnings] == [True] * warned


def test_mutual_tls_takes_the_external_agents_certificates(made: Path) -> None:
    found = listening("tls/0.0.0.0:1", made, external=[2], mutual=True)
    assert found.listener and found.listener.certified == {"agent-2"}
    assert found.certificates["agent-2"].certificate == (made / "agent-2.pem").read_text()
    with pytest.raises(FleetError, match=r"agent-3\.pem is missing; make it: fleet hosts certs .* --agents 3"):
        listening("tls/0.0.0.0:1", made, external=[3], mutual=True)


def test_agents_may_come_with_certificates_alone(made: Path) -> None:
    """Beside the listener for passwords, or without one: then these stay on this host."""
    both = listening("tls/0.0.0.0:1", made)
    found = listening_for_certificates(both, "tls/0.0.0.0:2", made, external=[2])
    assert (found.listener, found.reached) == (both.listener, both.reached)
    assert found.certified and (found.certified.endpoints, found.certified.certified) == (
        ("tls/0.0.0.0:2",),
        {"agent-2"},
    )
    assert found.folders[2].endpoints == ("tls/sea.example.org:2", "tls/192.0.2.7:2", "tls/[2001:db8::7]:2")
    alone = listening_for_certificates(Rendezvous(), "tls/127.0.0.1:2", made, external=[2])
    assert (alone.listener, alone.lease_ms, alone.folders[2].endpoints) == (None, None, ("tls/127.0.0.1:2",))
    assert "PRIVATE KEY" not in repr(alone)
    with pytest.raises(FleetError, match=r"agent-3\.pem is missing; make it: fleet hosts certs .* --agents 3"):
        listening_for_certificates(Rendezvous(), "tls/127.0.0.1:2", made, external=[2, 3])
    with pytest.raises(FleetError, match="two routers: give them a port each, not both 1"):
        listening_for_certificates(both, "tls/127.0.0.1:1", made)
    with pytest.raises(FleetError, match="not for other"):
        listening_for_certificates(both, "tls/0.0.0.0:2", made, ["other"])


# A router that is there already
def test_acl_prints_no_password_and_writes_them_for_us_alone(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "acl"
    arguments = ["hosts", "acl", "paper", "--certs", str(made), "--run", "trial"]
    printed, written = invoke(*arguments), invoke(*arguments, "-o", out)
    assert printed.exit_code == written.exit_code == 0, printed.output + written.output
    run, credentials = read_credentials(out / router_config.CREDENTIALS, 4)
    assert run == "trial" and credentials["agent-3"].user == "trial-agent-3"
    users = dict(line.split(":") for line in (out / router_config.USERS).read_text().splitlines())
    assert users == {c.user: c.password for c in credentials.values()}
    secrets = [*users.values(), (made / "server-key.pem").read_text().splitlines()[1]]
    public = printed.output + written.output + (out / router_config.CONFIG).read_text()
    assert len(set(secrets)) == 9 and not [secret for secret in secrets if secret in public]
    assert {stat.S_IMODE((out / name).stat().st_mode) for name in (router_config.USERS, router_config.CREDENTIALS)} == {
        0o600
    }
    again = invoke(*arguments, "-o", out)
    assert again.exit_code == 2 and "--force" in again.output
    assert read_credentials(out / router_config.CREDENTIALS, 4)[1] == credentials


def _command(words: str) -> click.Command:
    found = command_of(words.split()[0])
    return found.commands[words.split()[1]] if isinstance(found, click.Group) else found


# The page
def test_the_page_names_options_that_there_are() -> None:
    page = (ROOT / "docs" / "guide" / "hosts.md").read_text()
    named = {name: set() for name in ("run", "hosts certs", "hosts acl", "agent")}
    for name, rest in re.findall(r"\bfleet (run|hosts certs|hosts acl|agent) ([^`#\n]*)", page):
        named[name] |= set(re.findall(r"--[a-z-]+", rest))
    assert {"--listen", "--router", "--certs"} <= named["run"] and named["agent"] == {"--join"}
    for name, options in named.items():
        known = {option for parameter in _command(name).params for option in parameter.opts}
        assert options <= known, name


def test_the_pages_service_is_one(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    unit = re.findall(r"```ini\n(.*?)```", (ROOT / "docs" / "guide" / "hosts.md").read_text(), re.DOTALL)
    assert len(unit) == 1 and unit[0].count("/opt/fleet/bin/fleet") == 1
    file = tmp_path / "fleet-agent@.service"
    file.write_text(unit[0].replace("/opt/fleet/bin/fleet", sys.executable))  # it must exist
    verify = ["systemd-analyze", "verify", "--man=no", str(file)]
    done = subprocess.run(verify, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_nothing_that_holds_secrets_shows_them() -> None:
    secret = Credentials("u", "swordfish", key="-----KEY-----")
    values = [
        secret,
        Rendezvous(credentials={agent_role(1): secret}, listener=Listener((), 1, key="-----KEY-----")),
        [secret],
    ]
    assert "swordfish" not in f"{values}" and "-----KEY-----" not in f"{values}"
    assert Credentials.from_values(secret.to_values() | {"more": 1}) == secret
    assert secret.to_values() == {"user": "u", "password": "swordfish", "key": "-----KEY-----"}
