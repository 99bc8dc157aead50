"""Stacks whose nodes are isolated: programs that speak no zenoh pass our network, too, and none other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from live import LiveRun

from fleet.errors import ScenarioError
from fleet.result.file import read_result
from fleet.scenario.loading import parse_scenario
from netem import namespaces
from netem.errors import BusError

TALKS = """
import socket, struct, sys, threading, time

u = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
u.bind(("", 9001))
group = struct.pack("4s4s", socket.inet_aton("239.1.2.3"), bytes(4))
u.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
u.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
server = socket.create_server((sys.argv[1], 9000))


def hear():
    for n in range(1, 10**9):
        u.recvfrom(99)
        print("heard", n, flush=True)


def serve():
    for n in range(1, 10**9):
        server.accept()
        print("called", n, flush=True)


threading.Thread(target=hear, daemon=True).start()
threading.Thread(target=serve, daemon=True).start()
print("up", flush=True)
while True:
    u.sendto(b"x", ("239.1.2.3", 9001))
    try:
        socket.create_connection((sys.argv[2], 9000), timeout=0.2).close()
    except OSError:
        pass
    time.sleep(0.05)
"""
PROGRAM = {"run": ["python", "talks.py", "{address}"], "ready": {"line": "up"}}


def stack(**sections: Any) -> str:
    programs = {
        name: PROGRAM | {"run": [*PROGRAM["run"], other]} for name, other in (("a", "10.0.0.2"), ("b", "10.0.0.1"))
    }
    usual = {
        "title": "Plain sockets", "isolate": "yes", "nodes": {"a": {}, "b": {}}, "programs": programs,
        "signals": {
            "heard": {"line": r"heard (?P<value>\d+)"},
            "called": {"line": r"called (?P<value>\d+)"},
        },
        "duration": "1 s", "checks": {"punctual": {"late": "1 min"}},
    }  # fmt: skip
    return json.dumps(usual | sections)


@pytest.mark.parametrize(("loss", "hears"), [(0, True), (100, False)])
def test_tcp_and_multicast_pass_the_network_and_nothing_else(loss: int, hears: bool, tmp_path: Path) -> None:
    """Two programs of DDS heard 34 messages of each other behind links that lose everything."""
    try:
        namespaces.make_namespace(1).close()
    except BusError as error:
        pytest.skip(str(error))
    (tmp_path / "talks.py").write_text(TALKS)
    (tmp_path / "stack.yaml").write_text(stack(network={"links": {"*": f"delay 5ms loss {loss}%"}}))
    run = LiveRun(tmp_path / "runs", str(tmp_path / "stack.yaml"), "--trust", verb="netem")
    with run:
        run.ends(0)
    result = read_result(run.directory)
    lines = (run.directory / "log" / "a.log").read_text().split("\n")
    assert [any(word in line for line in lines) for word in ("heard", "called")] == [hears, hears]
    assert all(account.sent > 0 for account in result.ledger.values())
    assert all((account.delivered > 0) == hears for account in result.ledger.values())


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        (
            {"nodes": {"a": {"listen": "tcp/127.0.0.1:7501"}, "b": {}}},
            "nodes.a.listen: has no effect: an isolated node",
        ),
        ({"nodes": {"a": {"modem": {"unet": 1}}, "b": {}}}, "nodes.a.modem: has no effect"),
        ({"isolate": "no", "nodes": {"a": {"isolate": "yes"}, "b": {}}}, "nodes.b: nobody reaches it"),
        ({"programs": {"a": {"run": "true"}}}, "nodes.b: is isolated and has no program"),
        ({"programs": {"*": {"run": "true", "ready": {"port": 7}}}}, "programs.\\*.ready.port: is not seen"),
        ({"signals": {"x": {"message": "k", "count": "yes"}}}, "signals.x.message: is not seen"),
        ({"compose": "x.yaml"}, "compose: containers are outside"),
        ({"network": {"acoustic": {"modem": "s2c"}}}, "network.acoustic: has no IP"),
        ({"carry": ["**"]}, "carry: has no effect on isolated nodes"),
        ({"isolate": "perhaps"}, "expected yes or no"),
    ],
)
def test_what_has_no_meaning_for_isolated_nodes_is_refused(sections: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        parse_scenario(stack(**sections), "stack.yaml")


def test_an_isolated_stack_survives_a_round_trip() -> None:
    scenario = parse_scenario(stack(), "stack.yaml")
    again = parse_scenario(scenario.to_yaml(), "again.yaml")
    assert again == scenario and all(node.isolate for node in (again.spec.nodes or {}).values())
