"""Programs that know datagrams alone, as those of MAVLink, pShare and DUNE do; two pairs of them in one run."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import NamedTuple

import pytest
from free_ports import free_port
from stacks import Stack
from waiting import wait_for

from netem.errors import BusError
from netem.relay_process import _address

LIMIT_S = 60.0


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


class Sea(NamedTuple):
    """The run, and the program and the port of ours of each node."""

    stack: Stack
    programs: dict[str, socket.socket]
    ours: dict[str, int]


@pytest.fixture(scope="module")
def sea(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sea]:
    """`base` knows where the program of `auv` is; `asv` sends to `shore`, whose program has no port that is known."""
    names = ("shore", "asv", "base", "auv")
    ours = {name: free_port() for name in names}
    with ExitStack() as opened:
        programs = {name: opened.enter_context(program()) for name in names}
        to = {name: f"{name}:{at.getsockname()[1]}" for name, at in programs.items()}
        targets = {"base": to["auv"], "auv": to["base"], "shore": "asv", "asv": to["shore"]}
        nodes = {name: {"udp": {str(ours[name]): target}} for name, target in targets.items()}
        sections = {"graph": {"edges": ["base-auv", "shore-asv"]}, "network": {"links": {"base->auv": "delay 50ms"}}}
        stack = Stack(tmp_path_factory.mktemp("udp"), nodes=nodes, **sections)
        yield Sea(opened.enter_context(stack).begun(), programs, ours)


def test_a_program_whose_port_nobody_knows_gets_answers_where_it_sends_from(sea: Sea) -> None:
    """As MAVProxy, which sends from any free port."""
    shore, asv = sea.programs["shore"], sea.programs["asv"]
    asv.sendto(b"here", ("127.0.0.1", sea.ours["asv"]))
    data, port = wait_for(lambda: received(shore), LIMIT_S, "what it says")
    assert (data, port) == (b"here", sea.ours["shore"])
    shore.sendto(b"order", ("127.0.0.1", port))
    assert wait_for(lambda: received(asv), LIMIT_S, "the order") == (b"order", sea.ours["asv"])


def test_another_program_does_not_take_the_place_of_one_that_speaks(sea: Sea) -> None:
    """One datagram of any user of the machine did."""
    shore, asv = sea.programs["shore"], sea.programs["asv"]
    with program() as stranger:
        for name, at in (("first", asv), ("other", stranger)):
            at.sendto(name.encode(), ("127.0.0.1", sea.ours["asv"]))
            assert wait_for(lambda: received(shore), LIMIT_S, "what it says") == (name.encode(), sea.ours["shore"])
        shore.sendto(b"order", ("127.0.0.1", sea.ours["shore"]))
        assert wait_for(lambda: received(asv), LIMIT_S, "the order") == (b"order", sea.ours["asv"])
        assert received(stranger) is None


def test_a_host_is_looked_up_at_the_start() -> None:
    assert _address("127.0.0.1") == "127.0.0.1"
    with pytest.raises(BusError, match=r"datagrams cannot go to no\.such\.host\.invalid: "):
        _address("no.such.host.invalid")


def test_datagrams_go_both_ways_and_an_answer_to_where_they_came_from(sea: Sea) -> None:
    """And none while the link is down; this ends the run."""
    base, auv, stack = sea.programs["base"], sea.programs["auv"], sea.stack
    base.sendto(b"order", ("127.0.0.1", sea.ours["base"]))
    data, port = wait_for(lambda: received(auv), LIMIT_S, "the order")
    assert (data, port) == (b"order", sea.ours["auv"])
    auv.sendto(b"done", ("127.0.0.1", port))
    assert wait_for(lambda: received(base), LIMIT_S, "the answer") == (b"done", sea.ours["base"])
    stack.fleet("inject", "down base->auv")

    def lost() -> int:
        base.sendto(b"lost", ("127.0.0.1", sea.ours["base"]))
        return int(json.loads(stack.fleet("status", "--json"))["lost"])

    wait_for(lost, LIMIT_S, "the losses")
    result = stack.end()
    account, before = result.ledger["base->auv"], 0
    while received(auv) is not None:
        before += 1  # it was sent before the fault began
    assert account.lost["down"] > 0
    assert account.delivered == 1 + before
    assert account.sent == 1 + before + account.lost["down"]
    assert result.ledger["auv->base"].delivered == 1
