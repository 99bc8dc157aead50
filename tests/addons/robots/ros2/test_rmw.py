"""Keys, tokens, attachments and hashes against the examples of rmw_zenoh's own design page, and against pyzeros."""

from __future__ import annotations

import pytest
from repository import ROOT

from fleet.addons.robots.ros2.mapping import TOPICS, table
from fleet.addons.robots.ros2.rmw import (
    DEFAULT,
    LATCHED,
    SENSOR,
    Entity,
    Qos,
    RmwAttachment,
    domain_of,
    gid_of,
    node_token,
    pack,
    read_key,
    unpack,
)  # fmt: skip
from fleet.addons.robots.ros2.types import DISTRIBUTIONS, NO_HASH, dds_name, ros_name, types_of
from fleet.errors import FleetError

pytest.importorskip("rosbags", reason="the extra [ros2] is not installed")

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ADD = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
# By rosidl: of the design page, and of threads in which others quote them. They are the same in Jazzy and Kilted.
HASHES = {
    "std_msgs/msg/String": STRING,
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "geometry_msgs/msg/TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
}


@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_hashes_are_those_of_rosidl(distribution: str) -> None:
    types = types_of(distribution)
    assert {name: types.hash(name) for name in HASHES} == HASHES
    types.add_service("example_interfaces/srv/AddTwoInts", "int64 a\nint64 b\n---\nint64 sum\n")
    assert types.hash("example_interfaces/srv/AddTwoInts") == ADD
    with pytest.raises(FleetError, match="no type that is known"):
        types.hash("no_msgs/msg/None")


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_every_topic_has_a_type_in_every_distribution(distribution: str) -> None:
    types = types_of(distribution)
    hashes = {types.hash(topic.type) for topic in TOPICS}
    assert hashes == {NO_HASH} if distribution == "humble" else all(h.startswith("RIHS01_") for h in hashes)


def test_the_pyzeros_library_computes_the_same_hashes_and_ids() -> None:
    """Another author's code, from the definitions of its own."""
    cyclone = pytest.importorskip("ros2_pyterfaces.cyclone.all_msgs")
    utils = pytest.importorskip("pyzeros.utils")
    theirs = {t.type: getattr(cyclone, t.type.rpartition("/")[2], None) for t in TOPICS}  # it lacks some
    known = {name: cls for name, cls in theirs.items() if cls is not None}
    assert len(known) == 8
    assert {name: cls.hash_rihs01() for name, cls in known.items()} == {name: types_of().hash(name) for name in known}
    token = node_token(0, "b89f", "talker")
    assert gid_of(token) == utils.rmw_zenoh_gid(token)


@pytest.mark.parametrize(
    ("entity", "key", "kind", "number", "qos", "token"),
    [
        (
            Entity(0, "/robot1/chatter", "std_msgs/msg/String", STRING),
            f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING}", "MP", 10, Qos(depth=7),
            f"@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%robot1%chatter/std_msgs::msg::dds_::String_/{STRING}/::,7:,:,:,,",
        ),
        (
            Entity(2, "/add_two_ints", "example_interfaces/srv/AddTwoInts", ADD),
            f"2/add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/{ADD}", "SS", 10, DEFAULT,
            f"@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/SS/%/%/talker/%add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/{ADD}/::,10:,:,:,,",
        ),
    ],
)  # fmt: skip
def test_keys_and_tokens_of_the_design_page(
    entity: Entity, key: str, kind: str, number: int, qos: Qos, token: str
) -> None:
    assert entity.key == key
    assert read_key(key) == entity
    assert entity.token("8b20917502ee955ac4476e0266340d5c", "talker", number, kind, qos) == token
    assert ros_name(dds_name(entity.type)) == entity.type


def test_qualities_of_service() -> None:
    assert [str(q) for q in (DEFAULT, SENSOR, LATCHED)] == ["::,10:,:,:,,", "2::,5:,:,:,,", ":1:,1:,:,:,,"]


def test_an_attachment_has_33_bytes() -> None:
    attachment = RmwAttachment(1, 1_700_000_000_000_000_000, bytes(range(16)))
    data = pack(attachment)
    assert data.hex() == "0100000000000000" + "00002a36fe9c9717" + "10" + "000102030405060708090a0b0c0d0e0f"
    assert len(data) == 33
    assert unpack(data) == attachment
    for wrong in (None, b"", data[:-1], data[:16] + b"\x0f" + data[17:]):
        with pytest.raises(ValueError, match="attachment"):
            unpack(wrong)


@pytest.mark.parametrize("key", ["", "a/b", "0/x", "0/x/y/z", "x/chatter/std_msgs::msg::dds_::String_/h", "0//::::/h"])
def test_other_keys_are_none_of_ros(key: str) -> None:
    assert read_key(key) is None


def test_the_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert domain_of(None) == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert (domain_of(None), domain_of(7)) == (42, 7)
    for wrong in ("233", "-1", "x"):
        monkeypatch.setenv("ROS_DOMAIN_ID", wrong)
        with pytest.raises(FleetError, match="from 0 to 232"):
            domain_of(None)


def test_the_guide_has_the_table_of_topics() -> None:
    assert table() in (ROOT / "docs" / "guide" / "ros2.md").read_text("utf-8")
