"""The server for Foxglove's viewers: ports, slow clients, and services that say no."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import pytest
from foxglove_client import LIMIT_S, viewer
from waiting import wait_for

from fleet.addons.page.foxglove_server import BACKLOG, FoxgloveChannel, FoxgloveServer, ServiceOffer
from fleet.errors import FleetError

HOST = "127.0.0.1"
CHANNELS = {7: FoxgloveChannel("a", "json", "", "", b"")}


def test_a_port_that_is_taken() -> None:
    """One that was asked for is an error; otherwise another one is taken."""
    first = FoxgloveServer("first", HOST, None, CHANNELS)
    second = FoxgloveServer("second", HOST, None, CHANNELS)
    try:
        assert first.endpoint != second.endpoint
        port = int(first.endpoint.rpartition(":")[2])
        with pytest.raises(FleetError, match=rf"cannot listen on {HOST}:{port}: .*in use") as caught:
            FoxgloveServer("third", HOST, port, CHANNELS)
        assert caught.value.status == 3
    finally:
        first.close()
        second.close()


def test_nobody_waits_for_a_viewer_that_takes_nothing() -> None:
    """What has waited longest is left out for it, which is told; the newest messages come when it takes them again."""
    data, count = b"x" * 1000, 4 * BACKLOG  # more than sockets and queue hold
    with closing(FoxgloveServer("x", HOST, 0, CHANNELS)) as server, viewer(server.endpoint, most=10) as slow:
        slow.subscribe("a")
        assert wait_for(lambda: server.events(0.1), LIMIT_S, "a subscription") and server.viewers == 1
        for n in range(count):
            server.put(7, data, n)
        assert server.sent == count
        assert server.fell_behind() and not server.fell_behind()
        slow.until(lambda: slow.messages and slow.messages[-1].log_ns == count - 1)
        assert len(slow.messages) < count
        slow.until(lambda: slow.told)
        assert "left out" in slow.told[0]


def test_services_answer_and_refuse_in_words() -> None:
    """An object comes and goes; what is no object, and what goes wrong, is a refusal with its words."""

    def call(asked: dict[str, Any]) -> dict[str, Any]:
        if "no" in asked:
            raise FleetError("there is no link 1->9")
        return {"got": asked}

    with (
        closing(
            FoxgloveServer("x", HOST, 0, CHANNELS, services=[ServiceOffer("/do", {"type": "object"}, {}, call)])
        ) as server,
        viewer(server.endpoint) as watcher,
    ):
        watcher.until(lambda: watcher.services)
        assert watcher.call("/do", a=1) == {"got": {"a": 1}}
        assert "there is no link 1->9" in watcher.call("/do", no=1)
        assert "takes a JSON object" in watcher.call("/do", body="[1]")
        assert "takes a JSON object" in watcher.call("/do", body="{")
