"""Two robots whose programs speak ROS 2 over zenoh, by libraries of other authors: topic, service, discovery."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event
from typing import Any

import pytest
from repository import ROOT
from ros_session import foreign_session
from showing import going_on
from stacks import Stack
from waiting import wait_for

from fleet.mcap.reader import LogReader

pytest.importorskip("zenoh_ros2_sdk")
ROBOT = ROOT / "tests" / "support" / "ros_robot.py"
LIMIT_S = 60.0
CARRY = ["*/fleet/**"]


HEARS_S, NOTHING_S = 50.0, 1.0  # how long a listener waits for what must come, and for what must not


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A run of two robots; the program of the first one talks. The test of a partition ends it."""
    sections: dict[str, Any] = {
        "carry": CARRY, "network": {"links": {"*": "delay 100ms"}}, "discovery": "linked", "lost_after": "500 ms",
        "log": {"payloads": "yes"},
    }  # fmt: skip
    with (
        Stack(tmp_path_factory.mktemp("ros"), nodes={"auv1": None, "auv2": None}, **sections).begun() as found,
        talker(found.ports["auv1"]),
    ):
        yield found


@contextmanager
def talker(port: int) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, ROBOT, "talk", str(port)], stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def listened(stack: Stack, seconds: float) -> dict[str, Any]:
    """A program of the second robot tells which messages it hears, which services it finds, and their answer."""
    words = [sys.executable, ROBOT, "listen", str(stack.ports["auv2"]), str(seconds)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=4 * LIMIT_S, check=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_a_second_library_hears_the_first(stack: Stack) -> None:
    pyzeros = pytest.importorskip("pyzeros")
    messages = pytest.importorskip("ros2_pyterfaces.cyclone.all_msgs")
    found: list[Any] = []
    with foreign_session(f"tcp/127.0.0.1:{stack.ports['auv2']}") as session:
        heard = Event()

        async def read() -> None:
            with pyzeros.auto_context(node="listener", zenoh_session=session, namespace="/"):
                async for message in pyzeros.Sub(messages.String, "/fleet/chatter").listen_reliable():
                    found.append(message)
                    heard.set()
                    return

        with going_on(lambda *_: asyncio.run(asyncio.wait_for(read(), LIMIT_S))):
            assert heard.wait(LIMIT_S)
    assert " " in found[0].data


def test_topic_service_and_discovery_pass_and_a_partition_stops_them(stack: Stack) -> None:
    found = listened(stack, HEARS_S)
    assert min(found["delays"]) >= 0.1
    assert found["services"] == {"/fleet/set": ["std_srvs/srv/SetBool"]}
    assert found["answer"] == "done"
    assert found["took"] >= 0.2
    stack.fleet("inject", "partition auv1 / auv2")
    with stack.program("auv2") as session:
        wait_for(lambda: not list(session.liveliness().get("**", timeout=LIMIT_S)), LIMIT_S, "the end of all tokens")
    cut = listened(stack, NOTHING_S)
    assert (cut["delays"], cut["services"], cut["answer"]) == ([], {}, False)
    stack.fleet("heal")
    healed = listened(stack, HEARS_S)
    assert healed["delays"]
    assert (healed["services"], healed["answer"]) == (found["services"], "done")
    stack.end()
    reader = LogReader(stack.log)
    list(reader)
    (topic,) = (channel for channel in reader.channels.values() if channel.topic == "auv1/fleet/chatter")
    assert reader.schemas[topic.schema_id].name == "std_msgs/msg/String"
