"""Two and three robots whose programs are zenoh's own clients: what passes, to whom, when, and what the run says."""

from __future__ import annotations

import json
import math
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zenoh
from free_ports import free_port
from stacks import Stack, program
from waiting import wait_for

from fleet.logs.reader import LogReader
from fleet.result.file import read_result
from netem.wire.robots import MOST_TOKENS

LIMIT_S = 20.0
TWO = {"auv1": None, "auv2": None}
THREE = {"auv1": None, "auv2": None, "shore": None}
CARRY = ["*/fleet/**"]
LOGIN = {"transport/auth/usrpwd/user": "auv1", "transport/auth/usrpwd/password": "secret"}


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


def heard(session: Any) -> Heard:
    return Heard(session)


def reaches(session: Any, samples: Heard, key: str = "a/warm") -> None:
    """Put until a subscriber that was just declared hears it."""
    wait_for(lambda: session.put(key, "go") or samples.warm, LIMIT_S, "the first message")


def test_a_message_arrives_with_all_that_it_had(tmp_path: Path) -> None:
    """At neighbours only, and only if its key is carried; nothing comes back to who sent it."""
    edges = {"edges": ["auv1-auv2", "auv2-shore"]}
    with Stack(tmp_path, nodes=THREE, carry=CARRY, graph=edges, log={"payloads": "yes"}).begun() as stack:
        with stack.program("auv1") as one, stack.program("auv2") as two, stack.program("shore") as three:
            here, there, far = heard(one), heard(two), heard(three)
            reaches(one, there, "auv1/fleet/warm")
            own = {"encoding": "text/plain", "attachment": b"beside", "priority": zenoh.Priority.REAL_TIME}
            one.put("auv1/private/a", "secret")
            one.put("auv1/fleet/a", "hello", express=True, **own)
            one.delete("auv1/fleet/a")
            wait_for(lambda: len(there) == 2, LIMIT_S, "two messages")
        put, delete = there
        assert (str(put.key_expr), put.payload.to_string(), str(put.encoding)) == (
            "auv1/fleet/a",
            "hello",
            "text/plain",
        )
        assert (put.attachment.to_bytes(), put.priority, put.express) == (b"beside", zenoh.Priority.REAL_TIME, True)
        assert delete.kind == zenoh.SampleKind.DELETE
        assert not far
        assert [str(sample.key_expr) for sample in here] == ["auv1/private/a", "auv1/fleet/a", "auv1/fleet/a"]
        result = stack.end()
    assert set(result.ledger) == {"auv1->auv2", "auv2->auv1", "auv2->shore", "shore->auv2"}
    assert all(account.balance == 0 for account in result.ledger.values())
    topics = {channel.topic for channel in LogReader(stack.log).channels.values()} or _topics(stack.log)
    assert "auv1/auv1/fleet/a" in topics


def _topics(log: Path) -> set[str]:
    reader = LogReader(log)
    list(reader)
    return {channel.topic for channel in reader.channels.values()}


def test_a_query_is_two_packets_and_waits_when_one_is_lost(tmp_path: Path) -> None:
    with Stack(tmp_path, nodes=TWO, network={"links": {"*": "delay 100ms"}}).begun() as stack:
        with stack.program("auv1") as one, stack.program("auv2") as two:
            asked: list[bytes] = []

            def answer(query: Any) -> None:
                with query:
                    asked.append(query.payload.to_bytes())
                    query.reply(query.key_expr, b"yes", attachment=b"beside")

            queryable = two.declare_queryable("auv2/fleet/set", answer)

            def ask(timeout: float) -> tuple[list[bytes], float]:
                began = time.monotonic()
                found = one.get("auv2/fleet/set", payload=b"go", timeout=timeout)
                return [r.ok.payload.to_bytes() for r in found if r.ok], time.monotonic() - began

            wait_for(lambda: ask(2.0)[0], LIMIT_S, "an answer")
            replies, took = ask(LIMIT_S)
            assert (replies, asked[-1]) == ([b"yes"], b"go")
            assert took >= 0.2
            stack.fleet("inject", "down auv2->auv1")
            wait_for(lambda: not ask(0.5)[0], LIMIT_S, "the fault")
            count = len(asked)
            replies, took = ask(1.0)
            assert (replies, len(asked)) == ([], count + 1)  # the request came, the reply did not
            assert took >= 1.0
            del queryable
        stack.end()


def settled(stack: Stack) -> int:
    """Packets of the run whose fate is known."""
    found = json.loads(stack.fleet("status", "--json"))
    return int(found["delivered"]) + int(found["lost"])


def test_losses_and_delays_are_those_of_the_file(tmp_path: Path) -> None:
    """The share within the interval that 1 in 10,000 runs leaves, the delays not below the asked one."""
    network = {"links": {"*": "delay 50ms loss 30%"}}
    with Stack(tmp_path, nodes=TWO, network=network, header="12 bytes").begun() as stack:
        with stack.program("auv1") as one, stack.program("auv2") as two:
            delays: list[float] = []
            two.declare_subscriber("n/**", lambda s: delays.append(time.monotonic() - float(s.payload.to_string())))
            reaches(one, heard(two))
            for _ in range(400):
                one.put("n/x", str(time.monotonic()), congestion_control=zenoh.CongestionControl.BLOCK)
            wait_for(lambda: settled(stack) > 400, LIMIT_S, "their fates")
        result = stack.end()
    account = result.ledger["auv1->auv2"]
    assert len(delays) <= account.delivered
    spread = 3.9 * math.sqrt(0.3 * 0.7 / 400)
    assert abs(account.delivered / account.sent - 0.7) < spread
    assert abs(len(delays) / 400 - 0.7) < spread
    assert account.lost["loss"] + account.delivered == account.sent
    assert min(delays) >= 0.05
    assert result.punctual is not None
    assert result.punctual.late.count == account.delivered


def test_what_is_under_way_at_the_planned_end_is_in_flight(tmp_path: Path) -> None:
    sections: dict[str, Any] = {"network": {"links": {"*": "delay 60s duplicate 50%"}}}
    sections["checks"] = {"ledger": "balanced", "punctual": {"late": "1 min"}}
    with Stack(tmp_path, "--duration", "4 s", nodes=TWO, **sections).begun() as stack:
        with stack.program("auv1") as one:
            for _ in range(20):
                one.put("a/b", "go", congestion_control=zenoh.CongestionControl.BLOCK)
            stack.ends(0)
        account = read_result(stack.directory).ledger["auv1->auv2"]
    assert account.sent == 20
    assert account.in_flight == 20 + account.duplicated


def test_tokens_appear_at_neighbours_and_go(tmp_path: Path) -> None:
    edges = {"edges": ["auv1-auv2", "auv2-shore"]}
    with Stack(tmp_path, nodes=THREE, carry=CARRY, graph=edges).begun() as stack:
        with stack.program("auv1") as one, stack.program("auv2") as two, stack.program("shore") as three:

            def seen(session: Any) -> list[str]:
                found = session.liveliness().get("**", timeout=1.0)
                return sorted({str(reply.ok.key_expr) for reply in found if reply.ok})

            with one.liveliness().declare_token("auv1/fleet/alive"), one.liveliness().declare_token("auv1/own"):
                wait_for(lambda: seen(two) == ["auv1/fleet/alive"], LIMIT_S, "the token")
                assert not seen(three)
                assert seen(one) == ["auv1/fleet/alive", "auv1/own"]
            wait_for(lambda: not seen(two), LIMIT_S, "its end")
        stack.end()


def test_with_linked_discovery_a_partition_hides_tokens(tmp_path: Path) -> None:
    sections = {"discovery": "linked", "lost_after": "300 ms", "network": {"links": {"*": "delay 200ms"}}}
    with Stack(tmp_path, nodes=TWO, **sections).begun() as stack:
        with stack.program("auv1") as one, stack.program("auv2") as two:

            def seen() -> bool:
                return any(reply.ok for reply in two.liveliness().get("**", timeout=1.0))

            with one.liveliness().declare_token("auv1/alive"):
                wait_for(seen, LIMIT_S, "the token")
                stack.fleet("inject", "partition auv1 / auv2")
                wait_for(lambda: not seen(), LIMIT_S, "its end")
                stack.fleet("heal")
                wait_for(seen, LIMIT_S, "the token again")
        stack.end()


def test_a_router_that_is_there_may_go_and_come_back(tmp_path: Path) -> None:
    port = free_port()
    router = foreign_router(port)
    nodes = {"auv1": None, "shore": {"connect": f"tcp/127.0.0.1:{port}"}}
    with Stack(tmp_path, nodes=nodes).begun() as stack:
        with stack.program("auv1") as one:
            samples = heard(router)
            reaches(one, samples)
            router.close()
            stack.until("shore: the router is gone")
            router = foreign_router(port)
            samples = heard(router)
            reaches(one, samples)
        stack.end()
    router.close()


def test_two_nodes_at_one_network_are_refused(tmp_path: Path) -> None:
    """By their zenoh id: the addresses differ."""
    first, second = free_port(), free_port()
    router = foreign_router(first, second)
    nodes = {"a": {"connect": f"tcp/127.0.0.1:{first}"}, "b": {"connect": f"tcp/127.0.0.1:{second}"}}
    with Stack(tmp_path, nodes=nodes) as stack:
        stack.ends(3)
        assert "a and b reach the same zenoh network" in stack.said
    router.close()


def test_a_port_in_use_ends_it_before_it_begins(tmp_path: Path) -> None:
    port = free_port()
    taken = {"a": None, "b": {"listen": f"tcp/127.0.0.1:{port}"}}
    with closing(foreign_router(port)), Stack(tmp_path, nodes=taken) as stack:
        stack.ends(3)
        assert f"b: cannot listen on tcp/127.0.0.1:{port}" in stack.said


@pytest.mark.slow
def test_a_storm_of_tokens_and_a_huge_payload_leave_the_others_alone(tmp_path: Path) -> None:
    strict = {"punctual": {"late": "20 ms"}}
    with Stack(tmp_path, nodes=TWO, log={"payloads": "yes"}, checks=strict).begun() as stack:
        with stack.program("auv1") as one, stack.program("auv2") as two:
            samples = heard(two)
            reaches(one, samples)
            tokens = [one.liveliness().declare_token(f"t/{n}") for n in range(MOST_TOKENS + 10)]
            stack.until(f"more than {MOST_TOKENS} liveliness tokens")
            one.put("a/b", bytes(50_000_000), congestion_control=zenoh.CongestionControl.BLOCK)
            wait_for(lambda: samples, LIMIT_S, "50 MB")
            assert len(samples[0].payload) == 50_000_000
            samples.clear()
            one.put("a/b", "still there")
            wait_for(lambda: samples, LIMIT_S, "the next")
            del tokens
        stack.end(1)  # handing 50 MB over takes longer than `punctual` allows, and it says so


def test_a_relay_that_is_killed_leaves_a_whole_log(tmp_path: Path) -> None:
    with Stack(tmp_path, nodes=TWO).begun() as stack, stack.program("auv1") as one, stack.program("auv2") as two:
        samples = heard(two)
        reaches(one, samples)
        stack.until_running(1.5)
        stack.role("relay").kill()
        stack.ends(3)
        assert "was killed by SIGKILL" in stack.said
    assert any("link/1-2" in topic for topic in _topics(stack.log))
    with pytest.raises(zenoh.ZError):
        program(stack.ports["auv1"])  # nobody listens there any more


def test_a_router_of_ours_asks_for_the_users_of_a_zenoh_file(tmp_path: Path) -> None:
    users, file, port = tmp_path / "users", tmp_path / "auv1.json5", free_port()
    users.write_text("auv1:secret\n")
    file.write_text(f'{{transport: {{auth: {{usrpwd: {{dictionary_file: "{users}"}}}}}}}}')
    nodes = {"auv1": {"listen": f"tcp/127.0.0.1:{port}", "zenoh": file.name}, "auv2": None}
    with Stack(tmp_path, nodes=nodes).begun() as stack:
        with pytest.raises(zenoh.ZError):
            program(port)
        with closing(program(port, LOGIN)) as one, stack.program("auv2") as two:
            samples = heard(two)
            reaches(one, samples)
        stack.end()


def test_who_comes_late_gets_what_a_publisher_of_another_robot_keeps(tmp_path: Path) -> None:
    """As a transient local topic of ROS 2 does."""
    import zenoh.ext

    with Stack(tmp_path, nodes=TWO, carry=CARRY).begun() as stack:
        stamped = {"timestamping/enabled": True}
        with (
            closing(program(stack.ports["auv1"], stamped)) as one,
            closing(program(stack.ports["auv2"], stamped)) as two,
        ):
            cache = zenoh.ext.CacheConfig(1)
            publisher = zenoh.ext.declare_advanced_publisher(one, "0/fleet/map", cache=cache, publisher_detection=True)
            publisher.put(b"kept")
            late: list[Any] = []
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            subscriber = zenoh.ext.declare_advanced_subscriber(two, "0/fleet/map", late.append, history=history)
            wait_for(lambda: late, LIMIT_S, "what was kept")
            assert late[0].payload.to_bytes() == b"kept"
            del subscriber
        stack.end()
