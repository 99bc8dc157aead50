"""Messages of robots in the log, and the places that their topics give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fleet.addons.robots.message_log import MessageLog, place_of
from fleet.addons.robots.ros2.types import types_of
from fleet.errors import FleetError
from fleet.mcap.reader import LogReader
from fleet.recorder.log_file import LogFile
from netem.relay_messages import LoggedMessage

pytest.importorskip("rosbags", reason="the extra [ros2] is not installed")
POSE = "geometry_msgs/msg/PoseStamped"


def key(name: str, kind: str) -> str:
    package, _, short = kind.split("/")
    return f"0/{name}/{package}::msg::dds_::{short}_/{types_of().hash(kind)}"


def pose(x: float, y: float, z: float, qz: float, qw: float) -> bytes:
    new = types_of().new
    header = new("std_msgs/msg/Header", stamp=new("builtin_interfaces/msg/Time", sec=0, nanosec=0), frame_id="map")
    turned = new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=qz, w=qw)
    point: Any = new(
        "geometry_msgs/msg/Pose", position=new("geometry_msgs/msg/Point", x=x, y=y, z=z), orientation=turned
    )
    return types_of().encode(POSE, new(POSE, header=header, pose=point))


def test_east_north_up_becomes_north_east_down() -> None:
    """A robot that looks north: yaw 90 degrees from east there, 0 from north here."""
    north, east, down, yaw = place_of(key("auv1/pose", POSE), pose(1.0, 2.0, -3.0, 0.5**0.5, 0.5**0.5))
    assert (north, east, down) == (2.0, 1.0, 3.0)
    assert yaw == pytest.approx(0.0)


def test_another_type_or_other_bytes_are_refused() -> None:
    with pytest.raises(FleetError, match="says no place: expected nav_msgs"):
        place_of(key("auv1/chat", "std_msgs/msg/String"), b"")
    with pytest.raises(FleetError, match="no topic of ROS 2"):
        place_of("auv1/odom", b"")
    with pytest.raises(FleetError, match="no geometry_msgs"):
        place_of(key("auv1/pose", POSE), b"\x00\x01\x00\x00abc")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e308, -1.1e9])
@pytest.mark.parametrize("where", range(5))
def test_a_place_that_is_not_finite_is_refused(value: float, where: int) -> None:
    """As that of a filter that has not begun; in water it ended the run."""
    said = [1.0, 2.0, 3.0, 0.0, 1.0]
    said[where] = value
    with pytest.raises(FleetError, match="is not finite, or beyond 1e"):
        place_of(key("auv1/pose", POSE), pose(*said))


def test_without_the_extra_a_message_has_its_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended a live network."""
    name = key("auv1/pose", POSE)
    monkeypatch.setattr("fleet.logs.table.find_spec", lambda name: None)
    log = LogFile(tmp_path / "run.mcap")
    MessageLog(log, 1_000_000, ("auv1",)).write(LoggedMessage(5, 1, name, "put", "application/cdr", b"abc"))
    log.close()
    reader = LogReader(tmp_path / "run.mcap")
    assert [bytes(record.data) for record in reader] == [b"abc"]
    assert [channel.message_encoding for channel in reader.channels.values()] == ["application/cdr"]


def test_a_known_type_has_its_schema_and_others_their_encoding(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "run.mcap")
    messages = MessageLog(log, 1_000_000, ("auv1", "auv2"))
    messages.write(LoggedMessage(5, 1, key("auv1/pose", POSE), "put", "application/cdr", pose(0.0, 0.0, 0.0, 0.0, 1.0)))
    messages.write(LoggedMessage(6, 2, "auv2/x", "put", "application/json", b"{}"))
    messages.write(LoggedMessage(7, 2, "auv2/x", "query", "", b"?"))
    log.close()
    reader = LogReader(tmp_path / "run.mcap")
    assert [record.log_ns for record in reader] == [5_000_000, 6_000_000, 7_000_000]
    topics = {(c.topic, c.message_encoding, c.metadata["zenoh.kind"]): c.schema_id for c in reader.channels.values()}
    assert set(topics) == {
        ("auv1/auv1/pose", "cdr", "put"), ("auv2/auv2/x", "json", "put"), ("auv2/auv2/x", "", "query"),
    }  # fmt: skip
    assert reader.schemas[topics["auv1/auv1/pose", "cdr", "put"]].name == POSE
