"""Connections to Foxglove's server that never make a request are closed, and no others."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing

import pytest
from foxglove_client import viewer
from waiting import wait_for

from fleet.view.foxglove_server import FoxgloveChannel, FoxgloveServer
from fleet.view.unanswered import Unanswered

pytestmark = pytest.mark.skipif(not hasattr(socket, "TCP_INFO"), reason="only Linux says what was sent")


@pytest.fixture
def server() -> Iterator[FoxgloveServer]:
    with closing(FoxgloveServer("x", "127.0.0.1", 0, {7: FoxgloveChannel("a", "json", "", "", b"")})) as made:
        yield made


def port_of(server: FoxgloveServer) -> int:
    return int(server.endpoint.rpartition(":")[2])


def silent(server: FoxgloveServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port_of(server)))


def is_closed(connection: socket.socket) -> bool:
    connection.settimeout(0.05)
    try:
        return connection.recv(1) == b""
    except TimeoutError:
        return False
    except OSError:
        return True


def test_what_stays_silent_is_closed_after_a_while_and_a_viewer_is_not(server: FoxgloveServer) -> None:
    unanswered = Unanswered(port_of(server), most=10, for_s=5.0)
    with viewer(server.endpoint) as connected, silent(server) as one:
        connected.until(lambda: "a" in connected.channels)
        wait_for(lambda: len(unanswered._unanswered()) == 1, 30.0, "a connection that was accepted")
        unanswered.close_some(100.0)
        assert not is_closed(one)
        unanswered.close_some(104.9)
        assert not is_closed(one)
        unanswered.close_some(105.5)
        wait_for(lambda: is_closed(one), 30.0, "the end of a connection")
        assert connected.until(lambda: connected.channels)
        assert not unanswered._unanswered()


def test_of_too_many_the_oldest_are_closed(server: FoxgloveServer) -> None:
    unanswered = Unanswered(port_of(server), most=2, for_s=1e9)
    with silent(server) as first, silent(server) as second:
        wait_for(lambda: len(unanswered._unanswered()) == 2, 30.0, "connections that were accepted")
        unanswered.close_some(10.0)
        with silent(server) as third:
            wait_for(lambda: len(unanswered._unanswered()) == 3, 30.0, "a third connection")
            unanswered.close_some(20.0)
            wait_for(lambda: is_closed(first) or is_closed(second), 30.0, "the end of an older one")
            assert not is_closed(third)
            assert not (is_closed(first) and is_closed(second))


def test_the_server_looks_at_its_connections(server: FoxgloveServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_unanswered", Unanswered(port_of(server), most=10, for_s=0.0))
    with silent(server) as one:
        wait_for(lambda: server.events(0.01) == [] and is_closed(one), 30.0, "the end of a silent connection")
