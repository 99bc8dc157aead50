"""The lines and warnings at the start: addresses that programs can use, and who else reaches them."""

from __future__ import annotations

import json
import os
import pwd
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fleet.analysis import robot_addresses
from fleet.analysis.robot_addresses import lines, users_now, warnings
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.nodes import without_address


def scenario(**nodes: Any) -> Scenario:
    return parse_scenario(json.dumps({"title": "A stack", "nodes": nodes}), "stack.yaml")


def accounts(
    monkeypatch: pytest.MonkeyPatch, *users: tuple[str, int, str], there: tuple[int, ...] | None = None
) -> None:
    """`there`: the numbers of users with processes; None: that cannot be seen."""
    monkeypatch.setattr(robot_addresses, "users_now", lambda: None if there is None else {*there})
    own = SimpleNamespace(pw_name="me", pw_uid=os.getuid(), pw_shell="/bin/sh")
    found = [own, *(SimpleNamespace(pw_name=name, pw_uid=uid, pw_shell=shell) for name, uid, shell in users)]
    monkeypatch.setattr(pwd, "getpwall", lambda: found)


def test_an_address_of_every_interface_is_printed_as_one_to_connect_to() -> None:
    found = scenario(a={"listen": "tcp/0.0.0.0:7501"}, b={"listen": "tcp/[::]:7502"}, c={"listen": "tcp/10.0.0.0:1"})
    said = "\n".join(lines(found))
    assert said.count(f"tcp/{socket.gethostname()}:750") == 2
    assert "tcp/10.0.0.0:1" in said


def test_a_modem_says_what_programs_open() -> None:
    nodes = {"a": {"unet": 0}, "b": {"micromodem": "/tmp/ttyB"}, "c": {"evologics": 9200, "host": "10.0.0.1"},
             "d": {"micromodem": 0}}  # fmt: skip
    places = {name: {"modem": modem, "place": "0 0 10 m"} for name, modem in nodes.items()}
    water = {"acoustic": {"queue": 4}}
    found = parse_scenario(json.dumps({"title": "Modems", "nodes": places, "network": water}), "modems.yaml")
    free = "a free port, which fleet netem tells"
    assert [*lines(found)] == [
        f"a  modem of UnetStack: UnetSocket('127.0.0.1', {free})", "b  Micro-Modem: /tmp/ttyB",
        "c  modem of EvoLogics (experimental): TCP 10.0.0.1:9200, for data, and commands behind +++",
        f"d  Micro-Modem: TCP 127.0.0.1:{free}",
    ]  # fmt: skip
    assert next(iter(lines(found, modems={"a": "43211"}))) == "a  modem of UnetStack: UnetSocket('127.0.0.1', 43211)"


def test_the_modem_of_other_machines_is_warned_of() -> None:
    nodes = {"a": {"modem": {"unet": 1101, "host": "0.0.0.0"}, "place": "0 0 10 m"}, "b": {"place": "9 0 10 m"}}
    water = {"acoustic": {"queue": 4}}
    found = parse_scenario(json.dumps({"title": "Modems", "nodes": nodes, "network": water}), "modems.yaml")
    assert next(warnings(found)).startswith("a opens its modem on 0.0.0.0 for other machines")
    assert next(iter(lines(found))) == f"a  modem of UnetStack: UnetSocket('{socket.gethostname()}', 1101)"


def test_a_port_for_other_machines_is_warned_of_and_a_unix_socket_is_none(tmp_path: Path) -> None:
    found = scenario(
        a={"listen": f"unixsock-stream/{tmp_path}/a"},
        b={"listen": "tcp/0.0.0.0:1"},
        c={"listen": "tls/10.0.0.1:2", "zenoh": "x.json5"},
    )
    (said,) = warnings(found)
    assert said.startswith("b listens on tcp/0.0.0.0:1 for other machines, and the port has no password")


def test_ports_on_loopback_are_warned_of_if_other_people_use_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = scenario(
        a={"listen": "tcp/127.0.0.1:1"},
        b={"listen": "tcp/localhost:2", "zenoh": "users.json5"},
        c={"listen": f"unixsock-stream/{tmp_path}/a"},
        d={"udp": {"9000": "a:9100"}},
    )
    accounts(monkeypatch, ("daemon", 1, "/bin/sh"), ("www", 1500, "/usr/sbin/nologin"))
    assert not [*warnings(found)]
    accounts(monkeypatch, ("bob", 1501, "/bin/bash"))
    (said,) = warnings(found)
    assert said.startswith("other users of this machine (bob) can hear the programs of a, d and speak for them: ")
    people = [("bob", 1501, "/bin/bash"), ("eve", 1502, "/bin/bash")]
    accounts(monkeypatch, *people, there=(0, os.getuid()))
    assert not [*warnings(found)]
    accounts(monkeypatch, *people, there=(0, 1502))
    (said,) = warnings(found)
    assert said.startswith("other users of this machine (eve) can hear")


def test_the_users_with_processes_are_those_of_the_system() -> None:
    """At least we are there. A system that shows nobody else's processes has none of the first one."""
    there = users_now()
    assert there is None or os.getuid() in there
    assert (there is None) is not Path("/proc/1").exists()


def test_a_node_that_says_no_address_gets_one() -> None:
    """Not one that datagrams alone reach, or that sends them."""
    found = scenario(a={}, b={"udp": {"9000": "c:9100"}}, c={}, d={})
    free = without_address(found.spec.nodes or {})
    assert free == ["a", "d"]
    assert [line.split()[0] for line in lines(found) if "gets a free port of this host" in line] == free
    told = [*lines(found, {name: f"tcp/127.0.0.1:{k}" for k, name in enumerate(free, start=7000)})]
    assert 'connect/endpoints=["tcp/127.0.0.1:7001"]' in told[-1] and not any("free port" in line for line in told)
