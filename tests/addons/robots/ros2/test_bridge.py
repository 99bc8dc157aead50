"""A log and a live run for ROS 2: read by the library of another author, and by nodes of ours."""

from __future__ import annotations

import asyncio
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from in_process_runs import Alone, log_of
from in_process_runs import alone as alone
from live import LiveRun
from ros_session import foreign_session, ros_node, ros_router
from showing import going_on
from traffic import LIMIT_S, Command
from traffic import log as log
from waiting import wait_for

from fleet.addons.robots.ros2.bridge import RosBridge, play_log
from fleet.addons.robots.ros2.mapping import TF_STATIC
from fleet.addons.robots.ros2.node import RosNode, open_ros_session
from fleet.addons.robots.ros2.rmw import LATCHED
from fleet.addons.robots.ros2.translation import Translation
from fleet.addons.robots.ros2.types import INTERFACES, types_of
from fleet.errors import FleetError
from fleet.logs.open_log import open_log
from fleet.mcap.reader import digest
from fleet.mcap.seekable_log import SeekableLog
from netem.wire.ros_bus import SESSION_FILE, SETTINGS, RosBus

pytest.importorskip("rosbags", reason="the extra [ros2] is not installed")


def bridge_of(log: Path, node: RosNode) -> tuple[RosBridge, SeekableLog]:
    seekable = SeekableLog(log)
    schemas = {c.topic: seekable.schemas.get(c.schema_id) for c in seekable.channels.values()}
    return RosBridge(node, Translation(node.types, schemas)), seekable


def play(bridge: RosBridge, seekable: SeekableLog) -> None:
    with going_on(lambda keys, line: play_log(bridge, seekable, keys, line, rate=1000.0, loop=False)):
        wait_for(lambda: bridge.at_ns == seekable.end_ns, LIMIT_S, "the end")


def test_the_library_of_another_author_reads_it(log: Path) -> None:
    """Odometry with stamps, and the clock; each message has the attachment without which ROS drops it."""
    pyzeros = pytest.importorskip("pyzeros")
    messages = pytest.importorskip("ros2_pyterfaces.cyclone.all_msgs")
    ours = open_log(log)["uuv/2/state"]
    with ros_router() as (bus, endpoint), foreign_session(endpoint) as session:
        bridge, seekable = bridge_of(log, RosNode(bus, types_of(), 0, "fleet"))
        ready, found, times = Event(), [], []

        async def read() -> None:
            with pyzeros.auto_context(node="listener", zenoh_session=session, namespace="/"):
                odometry = pyzeros.Sub(messages.Odometry, "/uuv_2/ground_truth/odom")
                clock = pyzeros.Sub(messages.Clock, "/clock")
                wait_for(lambda: bridge._publishers["/uuv_2/ground_truth/odom"].matched, LIMIT_S, "the subscription")
                ready.set()

                async def take(sub: Any, into: list[Any], count: int) -> None:
                    async for message in sub.listen_reliable():
                        into.append(message)
                        if len(into) == count:
                            return

                await asyncio.wait_for(asyncio.gather(take(odometry, found, 10), take(clock, times, 5)), LIMIT_S)

        with going_on(lambda *_: asyncio.run(read())):
            assert ready.wait(LIMIT_S)
            play(bridge, seekable)
            wait_for(lambda: len(found) == 10 and len(times) == 5, LIMIT_S, "ten messages")
    # It keeps the last ten and drops what it is too slow for.
    east = dict(zip((ours.t * 1e9).round().astype(int).tolist(), ours.y.tolist(), strict=True))
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in found]
    assert sorted(set(stamps)) == stamps
    assert [m.pose.pose.position.x for m in found] == [east[ns] for ns in stamps]
    assert times[0].clock.sec == 0


def test_who_comes_late_gets_the_transforms_that_never_change(log: Path) -> None:
    """As rmw_zenoh subscribes to a latched topic: with a query of what was kept."""
    import zenoh.ext

    with ros_router() as (bus, endpoint):
        bridge, seekable = bridge_of(log, RosNode(bus, types_of(), 0, "fleet"))
        play(bridge, seekable)
        with foreign_session(endpoint) as session:
            (token,) = (
                str(reply.ok.key_expr)
                for reply in session.liveliness().get("@ros2_lv/0/**")
                if "%tf_static" in str(reply.ok.key_expr)
            )
            dds, hash_, qos = token.split("/")[-3:]
            assert qos == str(LATCHED)
            late: list[Any] = []
            subscriber = zenoh.ext.declare_advanced_subscriber(
                session, f"0{TF_STATIC}/{dds}/{hash_}", late.append, history=zenoh.ext.HistoryConfig()
            )
            wait_for(lambda: late, LIMIT_S, "the kept message")
            assert len(late[0].attachment.to_bytes()) == 33
            del subscriber


def test_a_node_of_ours_hears_what_another_one_says() -> None:
    """And tells of those that speak another version, another type, no CDR, or without an attachment."""
    kind, topic = "geometry_msgs/msg/TwistStamped", "/uuv_3/twist"
    with ros_router() as (bus, endpoint), ros_node(endpoint, "talker") as talker:
        node, heard = RosNode(bus, types_of(), 0, "listener"), []
        node.subscribe(topic, kind, heard.append)
        publisher = talker.publisher(topic, kind)
        wait_for(lambda: publisher.matched, LIMIT_S, "the subscription")
        assert wait_for(lambda: node.publishers_of(topic), LIMIT_S, "the token")
        types = talker.types
        empty = types.new("geometry_msgs/msg/Vector3", x=1.5, y=0.0, z=0.0)
        twist = types.new("geometry_msgs/msg/Twist", linear=empty, angular=empty)
        stamp = types.new("builtin_interfaces/msg/Time", sec=1, nanosec=2)
        header = types.new("std_msgs/msg/Header", stamp=stamp, frame_id="f")
        publisher.publish(types.new(kind, header=header, twist=twist))
        wait_for(lambda: heard, LIMIT_S, "the message")
        assert (heard[0].header.stamp.nanosec, heard[0].twist.linear.x) == (2, 1.5)
        with foreign_session(endpoint) as session:
            key = f"0/uuv_3/twist/geometry_msgs::msg::dds_::TwistStamped_/{types.hash(kind)}"
            session.put(key, b"\x00\x01\x00\x00", attachment=bytes(16) + b"\x10" + bytes(16))
            session.put(key, b"")
            told = [
                session.liveliness().declare_token(f"@ros2_lv/0/z/0/{n}/MP/%/%/old/%uuv_3%twist/{rest}/::,10:,:,:,,")
                for n, rest in enumerate(
                    ("geometry_msgs::msg::dds_::TwistStamped_/RIHS01_0", "std_msgs::msg::dds_::String_/h"), start=1
                )
            ]
            wait_for(lambda: len(node.problems) == 4, LIMIT_S, "four problems")
            del told
        text = "\n".join(node.problems)
        for words in (
            "no geometry_msgs/msg/TwistStamped in CDR",
            "without an attachment",
            "another version of",
            "has std_msgs/msg/String on",
        ):
            assert words in text
        assert len(heard) == 1


def test_a_second_library_publishes_and_calls() -> None:
    """It computes keys and hashes from definitions that it is given, also of our own types."""
    sdk = pytest.importorskip("zenoh_ros2_sdk")
    text = (INTERFACES / "srv" / "Heal.srv").read_text("utf-8")
    request, response = text.split("---\n")
    kind = "uuv_fleet_msgs/srv/Heal"
    with ros_router() as (bus, endpoint):
        port = int(endpoint.rpartition(":")[2])
        node, heard = RosNode(bus, types_of(), 0, "listener"), []
        node.subscribe("/chatter", "std_msgs/msg/String", heard.append)
        new = node.types.new
        node.serve("/fleet/heal", kind, lambda asked: new(f"{kind}_Response", success=True, message=f"not {asked.id}"))
        talker = sdk.ROS2Publisher(
            "/chatter", "std_msgs/msg/String", msg_definition="string data\n", router_port=port, domain_id=0
        )
        wait_for(lambda: talker.publish(data="hello") or heard, LIMIT_S, "a message")
        caller = sdk.ROS2ServiceClient(
            "/fleet/heal", kind, request_definition=request, response_definition=response, router_port=port, domain_id=0
        )
        answer = wait_for(lambda: caller.call(id="live-1"), LIMIT_S, "an answer")
        caller.close()
        talker.close()
    assert heard[0].data == "hello"
    assert (answer.success, answer.message) == (True, "not live-1")
    assert not node.problems


def test_a_domain_has_one_fleet() -> None:
    with ros_router() as (bus, endpoint):
        RosNode(bus, types_of(), 3, "uuv_fleet")
        with (
            pytest.raises(FleetError, match="domain 3 has a node uuv_fleet already"),
            ros_node(endpoint, "uuv_fleet", 3),
        ):
            pass
        with ros_node(endpoint, "uuv_fleet", 4) as other:
            assert not other.problems


def test_where_nodes_meet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked for goes before rmw_zenoh's variables."""
    file = tmp_path / "session.json5"
    with ros_router() as (_, endpoint):
        file.write_text(
            f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
        )
        monkeypatch.setenv(SESSION_FILE, str(file))
        for connect in (None, endpoint):
            bus, words = open_ros_session(connect, None)
            bus.close()
            assert endpoint in words
    cases: list[tuple[dict[str, str], str | None, str]] = [
        ({SESSION_FILE: str(tmp_path / "none.json5")}, None, "zenoh does not take"),
        ({SETTINGS: "nothing/known=1"}, None, "zenoh does not take"),
        ({}, "tcp/127.0.0.1:1", "no router answers at tcp/127.0.0.1:1.*rmw_zenohd"),
    ]
    join = RosBus.join
    monkeypatch.setattr(RosBus, "join", lambda endpoint: join(endpoint, timeout_ms=100))
    for environment, connect, problem in cases:
        monkeypatch.delenv(SESSION_FILE, raising=False)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        with pytest.raises(FleetError, match=problem):
            open_ros_session(connect, None)


@pytest.mark.slow
def test_a_run_that_is_shown_has_the_log_that_it_has_alone(alone: Alone, tmp_path: Path) -> None:
    """A node that subscribes to all of a vehicle is there before the first tick."""
    with ros_router() as (_, endpoint), ros_node(endpoint, "listener") as node:
        seen: dict[str, list[Any]] = {name: [] for name in ("odom", "twist", "imu", "pressure")}
        kinds = dict(zip(seen, ("nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Imu",
                                "sensor_msgs/msg/FluidPressure"), strict=True))  # fmt: skip
        for name, messages in seen.items():
            node.subscribe(f"/uuv_1/{name}", kinds[name], messages.append)
        overrides = ("duration=2 s", "checks={}")
        environment = {SETTINGS: f'mode="client";connect/endpoints=["{endpoint}"]'}
        words = ("paper", *(word for text in overrides for word in ("--set", text)), "--ros2", "--speed", "2")
        with LiveRun(tmp_path, *words, environment=environment) as run:
            assert run.status() == 0, run.printed
            assert "ROS 2: domain 0" in run.printed
            assert digest(run.log) == digest(log_of(alone("paper", *overrides)))
        wait_for(lambda: all(seen.values()), LIMIT_S, "a message of each kind")
        assert not node.problems


@pytest.mark.slow
def test_a_live_run_is_shown_and_disturbed(tmp_path: Path) -> None:
    """A service cuts a link, an unknown word is refused in a sentence, and the run's log holds the fault."""
    with (
        ros_router() as (_, endpoint),
        LiveRun(tmp_path, "paper", "--publish", "--speed", "1", "--duration", "300 s", "--quiet") as run,
        ros_node(endpoint, "operator") as node,
    ):
        run.until_running(0.1)
        with Command("ros2", run.directory, "--connect", endpoint, "--control") as shown:
            shown.until(endpoint)
            assert "can disturb the run" in shown.printed
            seen: list[Any] = []
            node.subscribe("/uuv_1/odom", "nav_msgs/msg/Odometry", seen.append)
            wait_for(lambda: len(seen) > 3, LIMIT_S, "odometry")
            assert [m.header.frame_id for m in seen[:3]] == ["map"] * 3
            kind = "uuv_fleet_msgs/srv/Inject"
            answer = node.call("/fleet/inject", kind, node.types.new(f"{kind}_Request", what="down '1<->2'"))
            assert answer.success, answer.message
            refused = node.call("/fleet/inject", kind, node.types.new(f"{kind}_Request", what="nonsense"))
            assert not refused.success
            assert "nonsense" in refused.message
            kind = "uuv_fleet_msgs/srv/Heal"
            healed = node.call("/fleet/heal", kind, node.types.new(f"{kind}_Request", id=""))
            assert healed.message == answer.message
