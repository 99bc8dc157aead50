"""The programs of these robots are zenoh's own clients. The tests ask what passes, to whom and when.

Most tests ask one run, in which each has robots of its own that no other robot is a neighbour of.
"""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import zenoh
from free_ports import free_port
from stacks import Stack, program
from tool import invoke
from waiting import wait_for

from fleet.mcap.reader import LogReader
from fleet.result.file import read_result
from fleet.result.result import Result
from netem.limits import TOKENS

LIMIT_S = 60.0
TWO = {"auv1": None, "auv2": None}
CARRY = ["*/fleet/**"]
EDGES = ["auv1-auv2", "auv2-shore", "asker.1-answerer", "talker-lossy", "early.1-far", "near-remote", "guarded-guest"]
LINKS = {
    "asker.1<->answerer": "delay 100ms",
    "talker->lossy": "delay 50ms loss 30%",
    "early.1->far": "delay 60s duplicate 50%",
}
LOGIN = {"transport/auth/usrpwd/user": "guarded", "transport/auth/usrpwd/password": "secret"}
WAITS = zenoh.CongestionControl.BLOCK


def foreign_router(*ports: int) -> Any:
    config = zenoh.Config()
    endpoints = [f"tcp/127.0.0.1:{port}" for port in ports]
    for key, value in {
        "mode": "router", "listen/endpoints": endpoints, "scouting/multicast/enabled": False,
    }.items():  # fmt: skip
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Heard(list[Any]):
    """The messages that a subscriber hears, without those that only ask whether it hears anything."""

    def __init__(self, session: Any) -> None:
        self.warm: list[Any] = []
        session.declare_subscriber("**", lambda s: (self.warm if str(s.key_expr).endswith("warm") else self).append(s))


def reaches(session: Any, samples: Heard, key: str = "a/fleet/warm") -> None:
    """Put until a subscriber that was just declared hears it."""
    wait_for(lambda: session.put(key, "go") or samples.warm, LIMIT_S, "the first message")


def tokens_at(session: Any) -> list[str]:
    """The liveliness tokens that a program finds."""
    found = session.liveliness().get("**", timeout=LIMIT_S)
    return sorted({str(reply.ok.key_expr) for reply in found if reply.ok})


def topics(log: Path) -> set[str]:
    reader = LogReader(log)
    list(reader)
    return {channel.topic for channel in reader.channels.values()}


# --- one run ----------------------------------------------------------------


class Shore:
    """The network of others that the node `remote` reaches: a router that may go and come back."""

    def __init__(self) -> None:
        self.port = free_port()
        self.router = foreign_router(self.port)

    def comes_back(self) -> None:
        self.router = foreign_router(self.port)


@pytest.fixture(scope="module")
def shore() -> Iterator[Shore]:
    found = Shore()
    yield found
    found.router.close()


@pytest.fixture(scope="module")
def stack(shore: Shore, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The run. `result` ends it, so tests that need it alive stand before those that ask for its result."""
    folder = tmp_path_factory.mktemp("zenoh")
    (folder / "users").write_text("guarded:secret\n")
    users = folder / "users"
    (folder / "guarded.json5").write_text(f'{{transport: {{auth: {{usrpwd: {{dictionary_file: "{users}"}}}}}}}}')
    nodes: dict[str, Any] = {name: None for edge in EDGES for name in edge.split("-")}
    nodes["guarded"] = {"listen": f"tcp/127.0.0.1:{free_port()}", "zenoh": "guarded.json5"}
    nodes["remote"] = {"connect": f"tcp/127.0.0.1:{shore.port}"}
    sections: dict[str, Any] = {"carry": CARRY, "graph": {"edges": EDGES}, "network": {"links": LINKS}}
    sections |= {"header": "12 bytes", "log": {"payloads": "yes"}}
    with Stack(folder, nodes=nodes, **sections).begun() as found:
        found.ports["guarded"] = int(nodes["guarded"]["listen"].rpartition(":")[2])
        yield found


def test_a_query_is_two_packets_and_waits_when_one_is_lost(stack: Stack) -> None:
    with stack.program("asker.1") as one, stack.program("answerer") as two:
        asked: list[bytes] = []

        def answer(query: Any) -> None:
            with query:
                asked.append(query.payload.to_bytes())
                query.reply(query.key_expr, b"yes", attachment=b"beside")

        queryable = two.declare_queryable("answerer/fleet/set", answer)

        def ask(timeout: float) -> tuple[list[bytes], float]:
            began = time.monotonic()
            found = one.get("answerer/fleet/set", payload=b"go", timeout=timeout)
            return [r.ok.payload.to_bytes() for r in found if r.ok], time.monotonic() - began

        wait_for(lambda: ask(2.0)[0], LIMIT_S, "an answer")
        replies, took = ask(LIMIT_S)
        assert (replies, asked[-1]) == ([b"yes"], b"go")
        assert took >= 0.2
        stack.fleet("inject", "down answerer->asker.1")
        wait_for(lambda: not ask(0.5)[0], LIMIT_S, "the fault")
        count = len(asked)
        replies, took = ask(0.5)
        assert replies == []
        assert took >= 0.5
        wait_for(lambda: len(asked) > count, LIMIT_S, "the request, which came although the reply did not")
        del queryable


def test_the_connection_file_has_the_addresses(stack: Stack) -> None:
    found = json.loads((stack.directory / "connection.json").read_text())["nodes"]
    assert {name: f"tcp/127.0.0.1:{port}" for name, port in stack.ports.items()}.items() <= found.items()


def test_tokens_appear_at_neighbours_and_go(stack: Stack) -> None:
    with stack.program("auv1") as one, stack.program("auv2") as two, stack.program("shore") as three:
        with one.liveliness().declare_token("auv1/fleet/alive"), one.liveliness().declare_token("auv1/own"):
            wait_for(lambda: tokens_at(two) == ["auv1/fleet/alive"], LIMIT_S, "the token")
            assert not tokens_at(three)
            assert tokens_at(one) == ["auv1/fleet/alive", "auv1/own"]
        wait_for(lambda: not tokens_at(two), LIMIT_S, "its end")


def test_a_router_that_is_there_may_go_and_come_back(stack: Stack, shore: Shore) -> None:
    with stack.program("near") as one:
        reaches(one, Heard(shore.router))
        shore.router.close()
        stack.until("remote: the router is gone")
        shore.comes_back()
        reaches(one, Heard(shore.router))


def test_a_router_of_ours_asks_for_the_users_of_a_zenoh_file(stack: Stack) -> None:
    with pytest.raises(zenoh.ZError):
        program(stack.ports["guarded"])
    with closing(program(stack.ports["guarded"], LOGIN)) as one, stack.program("guest") as two:
        reaches(one, Heard(two))


def test_who_comes_late_gets_what_a_publisher_of_another_robot_keeps(stack: Stack) -> None:
    """As a transient local topic of ROS 2 does."""
    import zenoh.ext

    stamped = {"timestamping/enabled": True}
    with closing(program(stack.ports["auv1"], stamped)) as one, closing(program(stack.ports["auv2"], stamped)) as two:
        cache = zenoh.ext.CacheConfig(1)
        publisher = zenoh.ext.declare_advanced_publisher(one, "0/fleet/map", cache=cache, publisher_detection=True)
        publisher.put(b"kept")
        late: list[Any] = []
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
        subscriber = zenoh.ext.declare_advanced_subscriber(two, "0/fleet/map", late.append, history=history)
        wait_for(lambda: late, LIMIT_S, "what was kept")
        assert late[0].payload.to_bytes() == b"kept"
        del subscriber


# --- what is said of it at its end --------------------------------------------


class Passed(NamedTuple):
    """The messages of the first of three robots in a row, as the program of each one heard them."""

    here: list[Any]
    there: list[Any]
    far: list[Any]


@pytest.fixture(scope="module")
def passed(stack: Stack) -> Passed:
    with stack.program("auv1") as one, stack.program("auv2") as two, stack.program("shore") as three:
        here, there, far = Heard(one), Heard(two), Heard(three)
        reaches(one, there, "auv1/fleet/warm")
        reaches(two, far, "auv2/fleet/warm")
        one.put("auv1/private/a", "secret")
        own = {"encoding": "text/plain", "attachment": b"beside", "priority": zenoh.Priority.REAL_TIME}
        one.put("auv1/fleet/a", "hello", express=True, **own)
        one.delete("auv1/fleet/a")
        wait_for(lambda: len(there) == 2 and len(here) == 3, LIMIT_S, "its messages, there and at their sender")
        return Passed(list(here), list(there), list(far))


@pytest.fixture(scope="module")
def delays(stack: Stack) -> list[float]:
    """How long each of 400 messages took that came through a link with losses [s]."""

    def settled() -> int:
        found = json.loads(stack.fleet("status", "--json"))
        return int(found["delivered"]) + int(found["lost"])

    found: list[float] = []
    with stack.program("talker") as one, stack.program("lossy") as two:
        two.declare_subscriber("n/**", lambda s: found.append(time.monotonic() - float(s.payload.to_string())))
        reaches(one, Heard(two))
        before = settled()
        for _ in range(400):
            one.put("n/fleet/x", str(time.monotonic()), congestion_control=WAITS)
        wait_for(lambda: settled() >= before + 400, LIMIT_S, "their fates")
    return found


@pytest.fixture(scope="module")
def result(stack: Stack, passed: Passed, delays: list[float]) -> Result:
    """That of the run, whose last messages were still under way."""
    with stack.program("early.1") as one:
        for _ in range(20):
            one.put("early/fleet/b", "go", congestion_control=WAITS)
        # The relay takes messages in their order: when the log has this one, the relay has had the others.
        one.put("early/fleet/last", "go", congestion_control=WAITS)
        wait_for(lambda: "early.1/early/fleet/last" in topics(stack.log), LIMIT_S, "the last message")
    return stack.end()


def test_a_message_arrives_with_all_that_it_had(stack: Stack, passed: Passed, result: Result) -> None:
    """At neighbours only, and only if its key is carried; nothing comes back to who sent it."""
    put, delete = passed.there
    assert (str(put.key_expr), put.payload.to_string(), str(put.encoding)) == ("auv1/fleet/a", "hello", "text/plain")
    assert (put.attachment.to_bytes(), put.priority, put.express) == (b"beside", zenoh.Priority.REAL_TIME, True)
    assert delete.kind == zenoh.SampleKind.DELETE
    assert not passed.far
    assert [str(sample.key_expr) for sample in passed.here] == ["auv1/private/a", "auv1/fleet/a", "auv1/fleet/a"]
    pairs = [edge.split("-") for edge in EDGES]
    assert set(result.ledger) == {f"{a}->{b}" for pair in pairs for a, b in (pair, pair[::-1])}
    assert all(account.balance == 0 for account in result.ledger.values())
    assert "auv1/auv1/fleet/a" in topics(stack.log)


def test_losses_and_delays_are_those_of_the_file(delays: list[float], result: Result) -> None:
    """The share within the interval that 1 in 10,000 runs leaves, the delays not below the asked one."""
    account = result.ledger["talker->lossy"]
    assert len(delays) <= account.delivered
    spread = 3.9 * math.sqrt(0.3 * 0.7 / 400)
    assert abs(account.delivered / account.sent - 0.7) < spread
    assert abs(len(delays) / 400 - 0.7) < spread
    assert account.lost["loss"] + account.delivered == account.sent
    assert min(delays) >= 0.05
    assert result.punctual is not None
    delivered = sum(account.delivered for account in result.ledger.values())
    # What was handed over while its receiver went is late or not, too, and is lost.
    gone = sum(account.lost.get("receiver", 0) for account in result.ledger.values())
    assert delivered <= result.punctual.late.count <= delivered + gone


def test_what_is_under_way_at_the_end_is_in_flight(result: Result) -> None:
    account = result.ledger["early.1->far"]
    assert account.sent == 21
    assert account.in_flight == 21 + account.duplicated


# --- runs that end in another way ---------------------------------------------


def netem(folder: Path, nodes: dict[str, Any], *options: str, **sections: Any) -> tuple[int, str]:
    """The exit status of `fleet netem` in this process, and what it said."""
    file = folder / "stack.yaml"
    file.write_text(json.dumps({"title": "A stack", "nodes": nodes, **sections}), "utf-8")
    done = invoke("netem", file, "--out", folder / "runs", *options)
    return done.exit_code, " ".join(done.output.split())


def test_a_run_ends_at_its_planned_end(tmp_path: Path) -> None:
    """Nodes that say no address get one, and are told it."""
    slow = {"punctual": {"late": "1 min"}}  # whatever else the machine does
    status, said = netem(tmp_path, {name: {} for name in TWO}, "--duration", "200 ms", "--trust", checks=slow)
    assert status == 0, said
    assert len(set(re.findall(r"connect/endpoints=\[\"(tcp/127\.0\.0\.1:\d+)\"\]", said))) == 2, said
    directory = (tmp_path / "runs" / "latest").resolve()
    assert read_result(directory).ledger.keys() == {"auv1->auv2", "auv2->auv1"}
    assert max(record.log_ns for record in LogReader(directory / "run.mcap")) == 200_000_000


def test_two_nodes_at_one_network_are_refused(tmp_path: Path) -> None:
    """By their zenoh id: the addresses differ."""
    first, second = free_port(), free_port()
    nodes = {"a": {"connect": f"tcp/127.0.0.1:{first}"}, "b": {"connect": f"tcp/127.0.0.1:{second}"}}
    with closing(foreign_router(first, second)):
        status, said = netem(tmp_path, nodes)
    assert (status, "a and b reach the same zenoh network" in said) == (3, True), said


def test_a_port_in_use_ends_it_before_it_begins(tmp_path: Path) -> None:
    port = free_port()
    taken = {"a": {"listen": f"tcp/127.0.0.1:{free_port()}"}, "b": {"listen": f"tcp/127.0.0.1:{port}"}}
    with closing(foreign_router(port)):
        status, said = netem(tmp_path, taken)
    assert (status, f"b: cannot listen on tcp/127.0.0.1:{port}" in said) == (3, True), said


def test_with_linked_discovery_a_partition_hides_tokens(linked: Stack) -> None:
    with linked.program("auv1") as one, linked.program("auv2") as two, one.liveliness().declare_token("auv1/alive"):
        wait_for(lambda: tokens_at(two), LIMIT_S, "the token")
        linked.fleet("inject", "partition auv1 / auv2")
        wait_for(lambda: not tokens_at(two), LIMIT_S, "its end")
        linked.fleet("heal")
        wait_for(lambda: tokens_at(two), LIMIT_S, "the token again")


@pytest.fixture(scope="module")
def linked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A run in which tokens need a link that something can pass; the test of a killed relay ends it."""
    sections = {"discovery": "linked", "lost_after": "300 ms", "network": {"links": {"*": "delay 200ms"}}}
    with ExitStack() as opened:
        yield opened.enter_context(Stack(tmp_path_factory.mktemp("linked"), nodes=TWO, **sections).begun())


def test_a_relay_that_is_killed_leaves_a_whole_log(linked: Stack) -> None:
    with linked.program("auv1") as one, linked.program("auv2") as two:
        reaches(one, Heard(two))
        wait_for(lambda: any("link/1-2" in topic for topic in topics(linked.log)), LIMIT_S, "a packet in the log")
        linked.role("relay").kill()
        linked.ends(3)
        assert "was killed by SIGKILL" in linked.said
    assert any("link/1-2" in topic for topic in topics(linked.log))
    with pytest.raises(zenoh.ZError):
        program(linked.ports["auv1"])  # nobody listens there any more


@pytest.mark.slow
def test_a_storm_of_tokens_and_a_huge_payload_leave_the_others_alone(tmp_path: Path) -> None:
    with Stack(tmp_path, nodes=TWO, log={"payloads": "yes"}).begun() as stack:
        with stack.program("auv1") as one, stack.program("auv2") as two:
            samples = Heard(two)
            reaches(one, samples)
            tokens = [one.liveliness().declare_token(f"t/{n}") for n in range(TOKENS.items + 10)]
            stack.until(f"more than {TOKENS.items} liveliness tokens")
            one.put("a/b", bytes(50_000_000), congestion_control=WAITS)
            wait_for(lambda: samples, LIMIT_S, "50 MB")
            assert len(samples[0].payload) == 50_000_000
            samples.clear()
            one.put("a/b", "still there")
            wait_for(lambda: samples, LIMIT_S, "the next")
            del tokens
        stack.end()
