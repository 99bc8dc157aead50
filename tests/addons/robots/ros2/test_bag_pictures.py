"""Bags of ROS 2 as columns, pictures and a page; a type that is not the one that is known here stays bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from html_page import Page
from in_process_runs import Alone, alone, log_of
from mcap.records import Schema
from mcap.writer import Writer
from tool import invoke

import fleet
from fleet.addons.pictures.caption import caption_of
from fleet.addons.robots.ros2.columns import definition_of, ros_columns
from fleet.addons.robots.ros2.types import types_of
from fleet.errors import FleetError
from fleet.mcap.reader import LogReadError

__all__ = ["alone"]
pytest.importorskip("rosbags.highlevel", reason="the extra [ros2] is not installed")
pytestmark = pytest.mark.usefixtures("coarse")
ODOM = "/uuv_2/ground_truth/odom"


@pytest.fixture(scope="module")
def run(alone: Alone) -> Path:
    return log_of(alone("paper", "duration=1 s", "vehicles=2", "checks={}"))


@pytest.fixture(scope="module")
def bag(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "bag"
    done = invoke("export", run, "--ros2", folder)
    assert done.exit_code == 0, done.output
    return folder


def test_the_fields_of_messages_are_columns(run: Path, bag: Path) -> None:
    """They were bytes."""
    topic, state = fleet.open_log(bag)[ODOM], fleet.open_log(run)["uuv/2/state"]
    assert topic["pose.pose.position.x"].tolist() == state.y.tolist()
    assert topic["pose.covariance"].shape == (len(state), 36)
    assert topic["header.stamp"].tolist() == pytest.approx(state.t.tolist())
    assert set(topic["child_frame_id"]) == {"uuv_2/base_link"}


def test_what_is_drawn_of_a_bag(run: Path, bag: Path) -> None:
    found = fleet.plot(bag, ["track", f"{ODOM}.pose.pose.position.z", "/uuv_1/imu"])
    assert list(found) == ["track", "uuv_2-ground_truth-odom.pose.pose.position.z", "uuv_1-imu"]
    above, below = found["track"].axes
    (line,) = [line for line in above.get_lines() if str(line.get_gid()).endswith(ODOM)]
    state = fleet.open_log(run)["uuv/2/state"]
    assert np.asarray(line.get_xdata()).tolist() == state.y.tolist()
    assert (above.get_xlabel(), below.get_ylabel()) == ("x [m]", "z [m]")
    (ax,) = found["uuv_2-ground_truth-odom.pose.pose.position.z"].axes
    assert ax.get_ylabel() == "position\nz [m]" and "sensor_msgs/msg/Imu" in caption_of(found["uuv_1-imu"])
    assert len(ax.get_lines()) == 1
    (part,) = fleet.plot(bag, f"{ODOM}.pose.pose.position.z", window=(0.5, 1.0)).values()
    t = np.asarray(part.axes[0].get_lines()[0].get_xdata())
    assert t.min() >= 0.5 and t.max() <= 1.0
    both = fleet.plot(bag, ODOM, compare=bag, labels=["old", "new"])
    (figure,) = both.values()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["old", "new"]
    for word, said in (("/uuv_2/nothing", "did you mean"), (f"{ODOM}.twist.x", "has no number")):
        with pytest.raises(FleetError, match=said):
            fleet.plot(bag, word)


def test_the_commands_take_a_bag(bag: Path, tmp_path: Path) -> None:
    drawn = invoke("plot", bag, "--what", "track,/uuv_1/pressure", "-o", tmp_path / "plots", "--no-caption", "--quiet")
    assert drawn.exit_code == 0, drawn.stderr
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {"track.png", "uuv_1-pressure.png", "captions.txt"}
    refused = invoke("plot", bag, "--vehicles", "1")
    assert refused.exit_code == 2 and "--vehicles: only for logs of runs" in refused.stderr
    page = tmp_path / "bag.html"
    assert invoke("report", bag, "-o", page, "--quiet").exit_code == 0
    words = " ".join(Page(page.read_text("utf-8")).words)
    assert "A bag of ROS 2" in words and "There was no fault" not in words
    assert f"{ODOM} nav_msgs/msg/Odometry 101" in words and "fleet plot" in words
    for verb in ("why", "view"):
        done = invoke(verb, bag, *(["--no-open"] if verb == "view" else []))
        assert done.exit_code == 2 and "fleet plot" in done.stderr


def schema(name: str, text: str) -> Schema:
    return Schema(id=1, name=name, encoding="ros2msg", data=text.encode())


def test_a_type_is_compared_and_never_taken_from_the_bag(tmp_path: Path) -> None:
    """`rosbags` makes code of a definition; a stranger's is not given to it."""
    name = "geometry_msgs/msg/Vector3"
    known = types_of().definition(name)
    assert ros_columns("/x", "cdr", schema(name, known)) is not None
    assert (
        ros_columns("/x", "cdr", schema(name, f"# words\n{known.replace('float64 y', 'float64  y # m')}")) is not None
    )
    for text in (
        known + "float64 w\n",
        known.replace("float64", "float32"),
        "T[999999999] x",
        "a" * 300_000,
        "x[" * 999,
    ):
        assert ros_columns("/x", "cdr", schema(name, text)) is None
    assert ros_columns("/x", "cdr", schema("evil_msgs/msg/Code", "float64 __import__('os')")) is None
    assert ros_columns("/x", "json", schema(name, known)) is None
    told = definition_of("a/msg/B", "Header h\nfloat64 x 1.0\nint8 K=3\nuint8 L = 4\nC[] c\n===\nMSG: a/C\nbool z\n")
    assert told == {"a/B": [("std_msgs/Header", "h"), ("float64", "x"), ("a/C[]", "c")], "a/C": [("bool", "z")]}


def test_a_message_that_is_none_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        name = "geometry_msgs/msg/Vector3"
        number = writer.register_schema(name, "ros2msg", types_of().definition(name).encode())
        channel = writer.register_channel("/v\x1b[31m", "cdr", number)
        writer.add_message(channel, 0, types_of().encode(name, types_of().new(name, x=1.0, y=2.0, z=3.0)), 0)
        writer.add_message(channel, 10**9, b"\x00\x01\x00\x00short", 10**9)
        writer.finish()
    with pytest.raises(LogReadError, match="a message is not what its type says"):
        _ = fleet.open_log(path)["/v\x1b[31m"]["x"]
    done = invoke("plot", path, "-o", tmp_path / "plots", "--quiet")
    assert done.exit_code == 2 and "a message is not what its type says" in done.stderr and "\x1b" not in done.stderr
