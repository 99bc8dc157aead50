"""Traffic of ROS 2 into a bag: from a fleet that is shown, and from nodes that speak it badly."""

from __future__ import annotations

import shutil
import signal
from pathlib import Path
from typing import Any

import pytest
from in_process_runs import alone as alone
from ros_session import ros_router
from showing import going_on
from tool import invoke
from traffic import LIMIT_S, Command
from traffic import log as log
from waiting import wait_for

from fleet.addons.robots.ros2.bridge import RosBridge, play_log
from fleet.addons.robots.ros2.node import RosNode
from fleet.addons.robots.ros2.record import BagWriter
from fleet.addons.robots.ros2.rmw import Entity, RmwAttachment, pack
from fleet.addons.robots.ros2.translation import Translation
from fleet.addons.robots.ros2.types import types_of
from fleet.mcap.seekable_log import SeekableLog
from netem.wire.open_bus import ZenohSample

rosbags = pytest.importorskip("rosbags.highlevel", reason="the extra [ros2] is not installed")
CLOCK = "rosgraph_msgs/msg/Clock"


def read(folder: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with rosbags.AnyReader([folder]) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return found


def test_what_a_fleet_publishes_is_recorded(log: Path, tmp_path: Path) -> None:
    """Also the transforms that were published before the recorder came."""
    seekable = SeekableLog(log)
    with ros_router() as (bus, endpoint):
        schemas = {c.topic: seekable.schemas.get(c.schema_id) for c in seekable.channels.values()}
        bridge = RosBridge(RosNode(bus, types_of(), 0, "fleet"), Translation(types_of(), schemas))

        def play() -> None:
            with going_on(lambda keys, line: play_log(bridge, seekable, keys, line, rate=4.0, loop=False)):
                wait_for(lambda: bridge.at_ns == seekable.end_ns, LIMIT_S, "the end")

        play()
        with Command("record", "--ros2", "-o", tmp_path / "bag", "--connect", endpoint) as recorder:
            recorder.until("recording 0/**")
            odometry = bridge._publishers["/uuv_1/odom"]
            wait_for(lambda: odometry.matched, LIMIT_S, "the subscription")
            bridge.at_ns = 0
            play()
            # What comes behind all others, and is told: then all have come.
            bus.plain("0/no_key_of_ros", drop=False).put(b"", None)
            recorder.until("0/no_key_of_ros is no key of rmw_zenoh")
            recorder.send(signal.SIGINT)
            assert recorder.status() == 130, recorder.printed
    found = read(tmp_path / "bag")
    assert len(found["/tf_static"]) == 1
    assert len(found["/uuv_1/odom"]) > 10
    assert found["/clock"][-1].clock.sec == 2


def test_what_cannot_be_recorded_is_told_once(tmp_path: Path) -> None:
    types, told = types_of(), []
    writer = BagWriter(tmp_path / "bag", types, told.append)
    time = types.new("builtin_interfaces/msg/Time", sec=1, nanosec=0)
    data = types.encode(CLOCK, types.new(CLOCK, clock=time))
    attachment = pack(RmwAttachment(1, 1, bytes(16)))
    good = Entity(0, "/clock", CLOCK, types.hash(CLOCK))
    humble = Entity(0, "/humble", CLOCK, "TypeHashNotSupported")
    others = [Entity(0, "/clock2", CLOCK, "RIHS01_0").key, Entity(0, "/own", "own_msgs/msg/Own", "RIHS01_0").key]
    cases = [(key, data, attachment) for key in (good.key, humble.key, *others, "0/anything")]
    cases += [(good.key, data[:5], attachment), (good.key, data, None)]
    for _ in range(2):
        for key, payload, attached in cases:
            writer.add(ZenohSample(key, payload, False, "zenoh/bytes", attached, None), 5)
    writer.close()
    writer.close()
    assert writer.samples == 4
    assert {topic: len(some) for topic, some in read(tmp_path / "bag").items()} == {"/clock": 2, "/humble": 2}
    assert len(told) == 5
    text = "\n".join(told)
    for words in ("another version", "not known here", "no key of rmw_zenoh", f"no {CLOCK} in CDR", "an attachment"):
        assert words in text


def test_a_killed_recorder_leaves_a_bag_that_can_be_recovered(tmp_path: Path) -> None:
    """It had left neither metadata.yaml nor, of less than a megabyte, any message."""
    types, folder = types_of(), tmp_path / "bag"
    writer = BagWriter(folder, types, lambda _: None)
    entity = Entity(0, "/clock", CLOCK, types.hash(CLOCK))
    for second in range(1, 4):
        time = types.new("builtin_interfaces/msg/Time", sec=second, nanosec=0)
        data = types.encode(CLOCK, types.new(CLOCK, clock=time))
        sample = ZenohSample(entity.key, data, False, "zenoh/bytes", pack(RmwAttachment(second, 1, bytes(16))), None)
        writer.add(sample, second * 1_000_000_000)
    killed = tmp_path / "killed" / "bag"  # as the disk has it now
    shutil.copytree(folder, killed)
    writer.close()
    assert [path.name for path in killed.iterdir()] == ["bag.mcap"]
    done = invoke("recover", killed)
    said = "bag.recovered: 3 messages up to t = 3 s; LOST: the end: the file is cut"
    assert (done.exit_code, said in done.output) == (3, True), done.output
    assert [one.clock.sec for one in read(tmp_path / "killed" / "bag.recovered")["/clock"]] == [1, 2, 3]
    assert sorted(path.name for path in (tmp_path / "killed").iterdir()) == ["bag", "bag.recovered"]
    assert "exists already" in invoke("recover", killed).output
    with (killed / "bag.mcap").open("r+b") as file:
        file.truncate(killed.joinpath("bag.mcap").stat().st_size - 40)
    done = invoke("recover", killed, "-o", tmp_path / "cut")
    assert (done.exit_code, "LOST" in done.output) == (3, True), done.output
    assert [one.clock.sec for one in read(tmp_path / "cut")["/clock"]] == [1, 2]
