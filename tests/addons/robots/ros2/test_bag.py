"""Bags of a run, read by two foreign libraries; and strange logs."""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest
from foreign_log import foreign
from in_process_runs import Alone, alone, log_of
from mcap.reader import make_reader
from refusals import check_commands
from tool import invoke

import fleet
from fleet.addons.robots.ros2.mapping import GRAVITY, SEA_WATER, SURFACE_PA
from fleet.addons.robots.ros2.translation import ERROR, OK

__all__ = ["alone"]
rosbags = pytest.importorskip("rosbags.highlevel", reason="the extra [ros2] is not installed")
SHORT = ("duration=2 s", "vehicles=3", "checks={}")
Messages = dict[str, list]


def export(*arguments: str | Path) -> str:
    done = invoke("export", *arguments)
    assert done.exit_code == 0, done.output
    return done.output


def read(folder: Path) -> Messages:
    found: Messages = {}
    with rosbags.AnyReader([folder]) as reader:
        for connection, at_ns, data in reader.messages():
            found.setdefault(connection.topic, []).append((at_ns, reader.deserialize(data, connection.msgtype)))
    return found


def test_a_bag_says_what_the_log_says_in_other_axes(alone: Alone, tmp_path: Path) -> None:
    result = alone("paper", *SHORT)
    bag = tmp_path / "bag"
    assert "metadata.yaml" in export(log_of(result), "--ros2", bag)
    found, log = read(bag), fleet.open_log(log_of(result))
    state, nav, command = (log[f"uuv/2/{group}"] for group in ("state", "nav", "command"))
    truth = [m for _, m in found["/uuv_2/ground_truth/odom"]]
    assert [at / 1e9 for at, _ in found["/uuv_2/ground_truth/odom"]] == pytest.approx(state.t.tolist())
    for axis, values in zip("xyz", (state.y, state.x, -state.z), strict=True):
        assert [getattr(m.pose.pose.position, axis) for m in truth] == values.tolist()
    q = [m.pose.pose.orientation for m in truth]
    yaw = [np.arctan2(2 * (o.w * o.z + o.x * o.y), 1 - 2 * (o.y**2 + o.z**2)) for o in q]
    assert np.exp(1j * np.array(yaw)) == pytest.approx(np.exp(1j * (pi / 2 - state.psi)), abs=1e-9)
    twist = found["/uuv_2/twist"][-1][1]
    assert (twist.header.frame_id, twist.twist.linear.y, twist.twist.angular.z) == (
        "uuv_2/base_link", -nav.v[-1], -nav.r[-1],
    )  # fmt: skip
    pressure = found["/uuv_2/pressure"][-1][1]
    assert pressure.fluid_pressure == pytest.approx(SURFACE_PA + SEA_WATER * GRAVITY * nav.z[-1])
    wrench = found["/uuv_2/applied_wrench"][-1][1].wrench
    assert (wrench.force.x, wrench.torque.y, wrench.torque.z) == tuple(command.applied[-1] * (1, -1, -1))
    links = [m for m in found["/fleet/recorder/scene"][-1][1].markers if m.ns.startswith("link ")]
    assert {m.text for m in links} <= {"delivering", "losing", "cut", "silent"}
    assert len(links) == len(log.links)
    assert {t.child_frame_id for t in found["/tf_static"][0][1].transforms} == {"ned"} | {
        f"uuv_{i}/base_link" for i in log.vehicles
    }


def test_another_library_reads_it(alone: Alone, tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder")
    export(log_of(alone("paper", *SHORT)), "--ros2", tmp_path / "bag")
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        messages = make_reader(file, decoder_factories=[decoder.DecoderFactory()]).iter_decoded_messages()
        found = {channel.topic: message for _, channel, _, message in messages}
    assert found["/uuv_1/odom"].child_frame_id == "uuv_1/base_link"
    assert found["/uuv_1/imu"].linear_acceleration_covariance[0] == -1.0
    assert len(found["/tf"].transforms) == 4  # reference, and three vehicles


def test_belief_and_faults_and_verdicts(alone: Alone, tmp_path: Path) -> None:
    faults = "faults=[{at: 0.5 s, for: 1 s, down: 1<->2}]"
    result = alone("dead-reckoning", "duration=2 s", faults, "checks={formation_error: {below: 1000 m}}")
    export(log_of(result), "--ros2", tmp_path / "bag")
    found, log = read(tmp_path / "bag"), fleet.open_log(log_of(result))
    covariance = found["/uuv_1/odom"][-1][1].pose.covariance.reshape(6, 6)
    belief = log["uuv/1/belief"].covariance[-2]  # of the tick before: it stands behind the nav of its tick
    assert covariance[1, 1] == pytest.approx(belief[0], rel=0.1)  # north
    assert covariance[5, 5] == pytest.approx(belief[9], rel=0.1)  # yaw
    assert not found["/uuv_1/ground_truth/odom"][-1][1].pose.covariance.any()
    statuses = [{s.name: s.level for s in m.status} for _, m in found["/diagnostics"]]
    assert len(statuses) == 3
    assert [max(s.values()) for s in statuses] == [1, 0, 0]
    assert any("check" in name and level in (OK, ERROR) for name, level in statuses[-1].items())


def test_what_cannot_be_exported(alone: Alone, tmp_path: Path) -> None:
    """Also a log of others, which has nothing for ROS."""
    places = {"LOG": log_of(alone("paper", *SHORT)), "HERE": tmp_path, "OTHER": foreign(tmp_path / "other.mcap")}
    check_commands("ros2/exports", places, "export")
    assert not (tmp_path / "bag").exists()
