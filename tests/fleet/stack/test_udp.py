"""Two programs that know datagrams alone, as those of MAVLink, pShare and DUNE do."""

from __future__ import annotations

import json
import socket
from pathlib import Path

from free_ports import free_port
from stacks import Stack
from waiting import wait_for

LIMIT_S = 20.0


def program() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.setblocking(False)
    return made


def received(at: socket.socket) -> tuple[bytes, int] | None:
    try:
        data, (_, port) = at.recvfrom(65_535)
    except BlockingIOError:
        return None
    return data, port


def test_datagrams_go_both_ways_and_an_answer_to_where_they_came_from(tmp_path: Path) -> None:
    with program() as shore, program() as asv:
        ours = {"shore": free_port(), "asv": free_port()}
        nodes = {
            "shore": {"udp": {str(ours["shore"]): f"asv:{asv.getsockname()[1]}"}},
            "asv": {"udp": {str(ours["asv"]): f"shore:{shore.getsockname()[1]}"}},
        }
        network = {"links": {"shore->asv": "delay 50ms"}}
        with Stack(tmp_path, nodes=nodes, network=network).begun() as stack:
            shore.sendto(b"order", ("127.0.0.1", ours["shore"]))
            data, port = wait_for(lambda: received(asv), LIMIT_S, "the order")
            assert (data, port) == (b"order", ours["asv"])
            asv.sendto(b"done", ("127.0.0.1", port))
            assert wait_for(lambda: received(shore), LIMIT_S, "the answer") == (b"done", ours["shore"])
            stack.fleet("inject", "down shore->asv")
            for _ in range(20):
                shore.sendto(b"lost", ("127.0.0.1", ours["shore"]))
            wait_for(lambda: read_json(stack)["lost"], LIMIT_S, "the losses")
            assert received(asv) is None
            result = stack.end()
    assert result.ledger["shore->asv"].lost["down"] > 0
    assert result.ledger["asv->shore"].delivered == 1


def read_json(stack: Stack) -> dict[str, int]:
    found: dict[str, int] = json.loads(stack.fleet("status", "--json"))
    return found


def test_a_program_whose_port_nobody_knows_gets_answers_where_it_sends_from(tmp_path: Path) -> None:
    """As MAVProxy, which sends from any free port."""
    with program() as shore, program() as asv:
        ours = {"shore": free_port(), "asv": free_port()}
        nodes = {
            "shore": {"udp": {str(ours["shore"]): "asv"}},
            "asv": {"udp": {str(ours["asv"]): f"shore:{shore.getsockname()[1]}"}},
        }
        with Stack(tmp_path, nodes=nodes).begun() as stack:
            asv.sendto(b"here", ("127.0.0.1", ours["asv"]))
            data, port = wait_for(lambda: received(shore), LIMIT_S, "what it says")
            assert (data, port) == (b"here", ours["shore"])
            shore.sendto(b"order", ("127.0.0.1", port))
            assert wait_for(lambda: received(asv), LIMIT_S, "the order") == (b"order", ours["asv"])
            stack.end()
