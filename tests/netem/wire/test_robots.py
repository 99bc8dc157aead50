"""The network of one robot, with zenoh and without a run: what of it passes on, and what others show there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
import zenoh
from free_ports import free_port
from stacks import program
from waiting import wait_for

from netem.errors import BusError
from netem.robot_message import DELETE, PUT, QUERY, REPLY, RobotMessage
from netem.wire.queries import Ticket
from netem.wire.robot_queues import Inlet
from netem.wire.robots import Robot, RobotEndpoint, Token, read
from netem.wire.session import open_session

LIMIT_S = 60.0
CARRY = ("*/fleet/**", "0/**/status", "rise/@v0/**")
SERVICE = "0/fleet/set/type/hash"


def service_token(node: str, name: str = "%fleet%set") -> str:
    return f"@ros2_lv/0/{node}/0/10/SS/%/%/{node}/{name}/type/hash/qos"


class Net:
    """A robot, what it passes on, and a program of it."""

    def __init__(self) -> None:
        port = free_port()
        self.queue: SimpleQueue[Any] = SimpleQueue()
        self.robot = Robot(RobotEndpoint(1, "auv1", listen=f"tcp/127.0.0.1:{port}"), CARRY, Inlet(self.queue.put))
        self.robot.begin()
        self.program = program(port)

    def close(self) -> None:
        self.program.close()
        self.robot.close()

    def passed(self, last: str) -> list[RobotMessage]:
        """What passes on up to a message with the payload `last`."""
        found: list[RobotMessage] = []
        while not found or found[-1].payload != last.encode():
            item = self.queue.get(timeout=LIMIT_S)
            if type(item).__name__ in ("_Heard", "_Replied") and (message := read(item)) is not None:
                found.append(message)
        return found

    def tokens(self) -> dict[str, bool]:
        """The last that was said of each token."""
        found = {}
        while not self.queue.empty():
            if isinstance(item := self.queue.get(), Token):
                found[item.key] = item.alive
        return found

    def done(self) -> None:
        """Wait until its outlet has done everything."""
        empty: SimpleQueue[None] = SimpleQueue()
        self.robot.outlet.do(lambda: empty.put(None))
        empty.get(timeout=LIMIT_S)


@pytest.fixture(scope="module")
def net() -> Iterator[Net]:
    with closing(Net()) as found:
        wait_for(lambda: found.program.put("0/fleet/warm", "warm") or not found.queue.empty(), LIMIT_S, "the first")
        yield found


def marked(net: Net, number: list[int] = [0]) -> list[RobotMessage]:  # noqa: B006 - counts
    number[0] += 1
    last = f"last {number[0]}"
    net.program.put("0/fleet/last", last)
    return [one for one in net.passed(last)[:-1] if one.payload != b"warm"]


def test_a_message_passes_once_and_only_if_carry_includes_its_key(net: Net) -> None:
    """A pattern may meet several expressions, and a key may be in several."""
    for key in ("0/fleet/status", "0/fleet/x", "**", "0/**", "0/*/*", "0/secret", "rise/@v0/x", "0/fleet/*"):
        net.program.put(key, key)
    net.program.delete("0/fleet/status")
    net.program.delete("**")
    found = [(one.kind, one.key) for one in marked(net)]
    puts = ["0/fleet/status", "0/fleet/x", "rise/@v0/x", "0/fleet/*"]
    assert found == [*((PUT, key) for key in puts), (DELETE, "0/fleet/status")]
    assert net.robot.stayed == {"**": 2, "0/**": 1, "0/*/*": 1}


def test_a_query_passes_once_and_only_if_carry_includes_its_key(net: Net) -> None:
    before = net.robot.stayed["**"]
    net.robot.outlet.do(lambda: net.robot.mirror(service_token("1")))
    net.done()
    for key in ("0/fleet/status", "**", SERVICE):
        net.program.get(key, zenoh.handlers.FifoChannel(10), timeout=0.1)
    found = [(one.kind, one.key) for one in marked(net)]
    assert found == [(QUERY, "0/fleet/status"), (QUERY, SERVICE)]
    assert net.robot.stayed["**"] == before + 1
    net.robot.outlet.do(lambda: net.robot.withdraw(service_token("1")))
    net.done()


def test_a_reply_passes_only_if_carry_includes_its_key(net: Net) -> None:
    """A program may answer on another key than it was asked for."""
    with closing(Net()) as other:

        def answer(query: Any) -> None:
            for key in ("0/private/x", "0/fleet/x"):
                query.reply(key, key)

        queryable = net.program.declare_queryable("0/fleet/ask", answer)

        def asked() -> list[bytes]:
            selector = "0/fleet/ask?_anyke"
            other.program.get(selector, zenoh.handlers.FifoChannel(10), timeout=LIMIT_S)
            item = other.queue.get(timeout=LIMIT_S)
            while type(item).__name__ != "_Heard":
                item = other.queue.get(timeout=LIMIT_S)
            net.robot.ask(Ticket(item.what, 2), b"")
            found: list[RobotMessage] = []
            while type(item := net.queue.get(timeout=LIMIT_S)).__name__ != "_Replied" or item.reply is not None:
                if type(item).__name__ == "_Replied" and (message := read(item)) is not None:
                    found.append(message)
            return [one.payload for one in found if one.kind == REPLY]

        assert wait_for(asked, LIMIT_S, "an answer") == [b"0/fleet/x"]
        assert net.robot.stayed["0/private/x"] >= 1
        queryable.undeclare()


def test_a_service_is_served_while_one_of_its_tokens_is_there(net: Net) -> None:
    tokens = [service_token("1"), service_token("2")]
    for token in tokens:
        net.robot.outlet.do(lambda token=token: net.robot.mirror(token))  # type: ignore[misc]
    net.robot.outlet.do(lambda: net.robot.withdraw(tokens[0]))
    net.done()
    querier = net.program.declare_querier(SERVICE, target=zenoh.QueryTarget.ALL_COMPLETE)
    wait_for(lambda: bool(querier.matching_status.matching), LIMIT_S, "the service")
    net.robot.outlet.do(lambda: net.robot.withdraw(tokens[1]))
    net.done()
    wait_for(lambda: not querier.matching_status.matching, LIMIT_S, "its end")


@pytest.mark.parametrize("name", ["@adv%%x", "a%%b", "%", "", "a#b", "$x"])
def test_a_token_with_an_odd_key_ends_nothing(net: Net, name: str) -> None:
    token = service_token("3", name)
    net.robot.carries(token)
    net.robot.outlet.do(lambda: net.robot.mirror(token))
    net.robot.outlet.do(lambda: net.robot.withdraw(token))
    net.done()
    assert net.robot.outlet.thread.is_alive()


def test_a_token_that_two_robots_have_is_still_known_when_one_goes(net: Net) -> None:
    """Zenoh says nothing of a program's token while the same one of another robot is shown here."""
    net.robot.outlet.do(lambda: net.robot.mirror("0/fleet/alive"))
    net.done()
    own = net.program.liveliness().declare_token("0/fleet/alive")
    marked(net)
    net.robot.outlet.do(lambda: net.robot.withdraw("0/fleet/alive"))
    wait_for(lambda: net.tokens().get("0/fleet/alive"), LIMIT_S, "the robot's own")
    own.undeclare()
    wait_for(lambda: net.tokens().get("0/fleet/alive") is False, LIMIT_S, "its end")


# --- Unix sockets


def listens(path: Path) -> None:
    open_session("router", {"listen/endpoints": [f"unixsock-stream/{path}"], "listen/exit_on_failure": True}).close()


@pytest.mark.parametrize("beside", ["", ".lock"])
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_who_listens_on_a_unix_socket_removes_nothing_of_others(tmp_path: Path, kind: str, beside: str) -> None:
    (tmp_path / "thesis").write_text("years of work")
    path = tmp_path / f"x{beside}"
    if kind == "file":
        path.write_text("years of work")
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(tmp_path / "thesis")
    before = sorted((p.name, p.lstat().st_ino) for p in tmp_path.iterdir())
    with pytest.raises(zenoh.ZError, match="is there already"):
        listens(tmp_path / "x")
    meeting = RobotEndpoint(1, "auv1", listen=f"unixsock-stream/{tmp_path / 'x'}")
    with pytest.raises(BusError, match="is there already"):
        Robot(meeting, ["**"], Inlet(print))
    assert sorted((p.name, p.lstat().st_ino) for p in tmp_path.iterdir()) == before


def test_a_socket_that_was_left_is_used_again_in_a_folder_of_ones_own(tmp_path: Path) -> None:
    import socket

    path = tmp_path / "x"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    (tmp_path / "x.lock").touch()
    os.chmod(tmp_path, 0o777)
    with pytest.raises(zenoh.ZError, match="is there already"):
        listens(path)
    os.chmod(tmp_path, 0o700)
    listens(path)


def test_a_file_of_zenoh_adds_no_addresses(tmp_path: Path) -> None:
    (tmp_path / "thesis").write_text("years of work")
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"listen": {"endpoints": [f"unixsock-stream/{tmp_path / 'thesis'}"]}}))
    port = free_port()
    there = open_session("router", {"listen/endpoints": [f"tcp/127.0.0.1:{port}"]})
    with closing(there):
        Robot(RobotEndpoint(1, "a", connect=f"tcp/127.0.0.1:{port}", config=str(file)), ["**"], Inlet(print)).close()
    assert (tmp_path / "thesis").read_text() == "years of work"


def test_what_a_robot_with_a_modem_of_its_own_says_here_stays(net: Net) -> None:
    """Its programs send through the modem; else their topics were in the water, too, and in its way."""
    port = free_port()
    heard: SimpleQueue[Any] = SimpleQueue()
    endpoint = RobotEndpoint(2, "auv2", listen=f"tcp/127.0.0.1:{port}", silent=True)
    with closing(Robot(endpoint, ["**"], Inlet(heard.put))) as robot:
        placed: SimpleQueue[bytes] = SimpleQueue()
        robot.begin()
        robot.watch("odom", lambda key, payload: placed.put(payload))
        with closing(program(port)) as own:
            wait_for(lambda: own.put("odom", "here") or not placed.empty(), LIMIT_S, "what is watched")
        assert not robot.carries(service_token("1"))
    while not heard.empty():
        assert type(heard.get()).__name__ not in ("_Heard", "_Replied")
