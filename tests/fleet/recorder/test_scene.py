"""What 3D viewers are given: frames that place each vehicle, a scene that tells what the log tells, a layout."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone, log_of
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from repository import ROOT
from small_scenario import small

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.logs.decoder import _unit
from fleet.mcap.reader import LogReader
from fleet.recorder.scene.link_state import CUTS, HISTORY
from fleet.recorder.scene.messages import LinkHistories, Scene, hull
from fleet.recorder.scene.model import diameter
from fleet.recorder.scene.styles import FOXGLOVE
from fleet.recorder.transforms import quaternion
from fleet.repeat.resume import continuation
from fleet.scenario.loading import load_scenario
from netem.cause import LOSSES, Cause
from netem.wire.messages import Command, Fate, Frame, VehicleFrame

FAULTS = "faults=[{at: 1.5 s, for: 1 s, partition: halves}, {at: 2 s, for: 600 ms, kill: 4}, {at: 2.2 s, pause: 1}]"
LOSSY = "network.links={'*': 'delay 30ms', '1->2': 'delay 30ms loss 40%'}"


@pytest.fixture(scope="module")
def log(made: Alone) -> Path:
    return log_of(made("paper", "checks={}", "duration=4 s", FAULTS, LOSSY))


@pytest.fixture(scope="module")
def messages(log: Path) -> dict[str, dict[float, Any]]:
    """By topic and time [s], decoded by mcap-protobuf-support: every message of every topic is."""
    found: dict[str, dict[float, Any]] = {}
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            assert decoded.SerializeToString() == message.data or channel.topic.startswith("uuv/")
            found.setdefault(channel.topic, {})[message.log_time / 1e9] = decoded
    return found


def rotated(q: Any, v: tuple[float, float, float]) -> list[float]:
    """A vector turned by a unit quaternion."""
    axis, w = np.array([q.x, q.y, q.z]), q.w
    turned = np.array(v) + 2 * w * np.cross(axis, v) + 2 * np.cross(axis, np.cross(axis, v))
    return [float(component) for component in turned]


# --- transforms --------------------------------------------------------------


def test_frames_place_the_vehicles_as_the_log_does(messages: dict[str, dict[float, Any]]) -> None:
    assert [round(10 * t) for t in messages["transforms"]] == list(range(41))
    for t, message in messages["transforms"].items():
        of = {transform.child_frame_id: transform for transform in message.transforms}
        assert {(name, transform.parent_frame_id) for name, transform in of.items()} == {
            ("ned", "map"), ("reference", "map"), *((f"uuv-{i}", "ned") for i in range(1, 5)),
        }  # fmt: skip
        for i in range(1, 5):
            pose = messages[f"uuv/{i}/pose"][t].pose
            placed = of[f"uuv-{i}"]
            assert (placed.translation.x, placed.translation.y, placed.translation.z) == (
                pose.position.x, pose.position.y, pose.position.z,
            )  # fmt: skip
            assert str(placed.rotation) == str(pose.orientation)
            assert placed.timestamp.ToNanoseconds() == round(t * 1e9)


def test_down_is_down(messages: dict[str, dict[float, Any]]) -> None:
    """Viewers have z upwards: north, east and down in `ned` are y, x and -z in `map`."""
    ned = messages["transforms"][0.0].transforms[0]
    assert ned.child_frame_id == "ned"
    assert rotated(ned.rotation, (1, 2, 3)) == pytest.approx([2, 1, -3])


@given(st.floats(-1.5, 1.5), st.floats(-7.0, 7.0))
def test_a_quaternion_turns_forward_to_the_heading(theta: float, psi: float) -> None:
    """R e_x = (cos theta cos psi, cos theta sin psi, -sin theta): pitch up is towards -z."""
    q = hull(1, 10.0, False).cubes[0].pose.orientation
    q.x, q.y, q.z, q.w = quaternion(theta, psi)
    forward = math.cos(theta) * math.cos(psi), math.cos(theta) * math.sin(psi), -math.sin(theta)
    assert rotated(q, (1, 0, 0)) == pytest.approx(forward, abs=1e-12)


# --- the scene ---------------------------------------------------------------


def entities(message: Any) -> dict[str, Any]:
    found = {entity.id: entity for entity in message.entities}
    assert len(found) == len(message.entities)
    return found


def state(entity: Any) -> str:
    return str(entity.metadata[0].value)


def test_every_message_holds_the_whole_scene(messages: dict[str, dict[float, Any]]) -> None:
    """So that a viewer that jumps to a time is shown all of it."""
    assert list(messages["scene"]) == [0.5 * k for k in range(9)]
    links = {f"link {a}-{b}" for a, b in [(1, 2), (2, 1), (2, 3), (3, 2), (3, 4), (4, 3)]}
    frames = {t.child_frame_id for t in messages["transforms"][0.0].transforms}
    for t, message in messages["scene"].items():
        there = entities(message)
        assert there.keys() == links | {f"uuv-{i}" for i in range(1, 5)} | {"formation"}
        assert {entity.frame_id for entity in there.values()} <= frames
        assert all(entity.frame_locked and entity.timestamp.ToSeconds() == int(t) for entity in there.values())


def test_hulls_say_who_is_silent(messages: dict[str, dict[float, Any]]) -> None:
    silent = {
        t: {i for i in range(1, 5) if state(entities(message)[f"uuv-{i}"]) == "silent"}
        for t, message in messages["scene"].items()
    }
    # 4 is killed from 2 to 2.6 s, 1 suspended from 2.2 s to the end, where nobody is asked and nothing changes.
    assert silent == {
        0.0: set(), 0.5: set(), 1.0: set(), 1.5: set(),
        2.0: {4}, 2.5: {1, 4}, 3.0: {1}, 3.5: {1}, 4.0: {1},
    }  # fmt: skip
    hulls = entities(messages["scene"][2.5])
    assert [hulls[f"uuv-{i}"].texts[0].text for i in (2, 4)] == ["2", "4 silent"]
    colours = {str(hulls[f"uuv-{i}"].cylinders[0].color) for i in range(1, 5)}
    assert len(colours) == 3  # two of them grey


def test_on_a_wall_clock_one_missed_tick_is_no_silence() -> None:
    scene = Scene(load_scenario("paper"))
    asked, told = (0.0,) * 10, {}
    for tick in range(120):
        answers = b"command" if tick not in (30, 31) and tick < 60 else b""
        row = VehicleFrame(1, (0.0,) * 5, (0.0,) * 5, asked, (0.0,) * 3, answers, (), (), (), ())
        scene.see(Frame(tick, False, (), (), (row,)), {1: Command(1, tick, (0.0,) * 3, ())} if answers else {})
        told[tick] = 1 in scene.silent()
    assert [tick for tick, silent in told.items() if silent] == list(range(110, 120))  # 0.5 s after the last


def test_links_say_what_arrives(messages: dict[str, dict[float, Any]]) -> None:
    states = {
        t: {id: state(entity) for id, entity in entities(message).items() if id.startswith("link")}
        for t, message in messages["scene"].items()
    }
    assert set(states[0.0].values()) == {"silent"}  # no packet is through yet
    assert states[1.0] == dict.fromkeys(states[1.0], "delivering") | {"link 1-2": "losing"}
    assert {states[2.0][link] for link in ("link 2-3", "link 3-2")} == {"cut"}
    assert states[2.5]["link 4-3"] == "silent" and states[2.5]["link 3-4"] == "cut"  # to a dead agent nothing gets
    assert states[3.0]["link 2-3"] == "losing"  # some of its last ten were lost
    assert states[4.0]["link 2-3"] == "delivering"


def test_links_are_drawn_between_the_vehicles(messages: dict[str, dict[float, Any]]) -> None:
    """The half at the receiver is the link's; moved along with `reference`, its end is where the receiver is."""
    message = messages["scene"][1.0]
    moved = {t.child_frame_id: t.translation for t in messages["transforms"][1.0].transforms}
    for a, b in [(1, 2), (2, 1), (3, 4)]:
        middle, end = entities(message)[f"link {a}-{b}"].lines[0].points
        places = [messages[f"uuv/{i}/pose"][1.0].pose.position for i in (a, b)]
        origin = moved["reference"]
        there = [end.x + origin.x, end.y + origin.y, end.z + origin.z]
        assert there == pytest.approx([places[1].y, places[1].x, -places[1].z])
        half = [middle.x + origin.x, middle.y + origin.y]
        assert half == pytest.approx([(places[0].y + places[1].y) / 2, (places[0].x + places[1].x) / 2])


def test_the_formation_is_where_the_error_is_zero(log: Path, messages: dict[str, dict[float, Any]]) -> None:
    found = fleet.open_log(log, topics=["uuv/*"])
    moved = {t.child_frame_id: t.translation for t in messages["transforms"][2.0].transforms}["reference"]
    spheres = entities(messages["scene"][2.0])["formation"].spheres
    for i in range(1, 5):
        p = spheres[i].pose.position
        desired = np.array([p.y + moved.y, p.x + moved.x, -p.z - moved.z])
        row = np.flatnonzero(found[f"uuv/{i}/error"].t == 2.0)[0]
        at = found[f"uuv/{i}/state"]
        there = np.array([at.x[row], at.y[row], at.z[row]])
        assert there - found[f"uuv/{i}/error"].formation[row] == pytest.approx(desired)


def test_a_hull_displaces_what_it_weighs() -> None:
    small_one, large = hull(1, 10.0, False), hull(2, 80.0, False)
    assert diameter(80.0) == pytest.approx(2 * diameter(10.0))
    assert math.pi / 4 * diameter(10.0) ** 2 * 7 * diameter(10.0) * 1025 == pytest.approx(10.0)
    assert large.cylinders[0].size.z == pytest.approx(2 * small_one.cylinders[0].size.z)


def fate(cause: str, corrupted: bool = False) -> Fate:
    return Fate(1, 1, 2, 0, 0, 0, 1, 0, cause, corrupted, b"")


@given(st.lists(st.sampled_from([*LOSSES, Cause.DELIVERED, Cause.IN_FLIGHT]), max_size=3 * HISTORY))
def test_the_state_of_a_link_is_that_of_its_last_packets(causes: list[str]) -> None:
    histories = LinkHistories([(1, 2)])
    for cause in causes:
        histories.settle(fate(cause))
    last = [cause for cause in causes if cause != Cause.IN_FLIGHT][-HISTORY:]
    found = histories.state((1, 2))
    assert found in FOXGLOVE.links
    assert (found == "silent") == (not last)
    assert (found == "delivering") == (bool(last) and set(last) == {Cause.DELIVERED})
    if last and last[-1] == Cause.DELIVERED:
        assert found in ("delivering", "losing")
    if last and last[-1] in CUTS:
        assert found == "cut"


def test_a_corrupted_packet_is_a_lost_one() -> None:
    histories = LinkHistories([(1, 2)])
    for corrupted in (False, True):
        histories.settle(fate(Cause.DELIVERED, corrupted))
    assert histories.state((1, 2)) == "losing"


# --- as a part of the log ----------------------------------------------------


def test_what_is_drawn_can_be_thinned_and_left_out(made: Alone) -> None:
    assert {k: v for k, v in small().log_every.items() if k in ("transforms", "scene")} == {
        "transforms": 10,
        "scene": 50,
    }
    thinned = small("log.every=7 ticks").log_every
    assert (thinned["transforms"], thinned["scene"]) == (14, 56)  # no frame is made for them alone
    assert small("log.every=200 ticks", "duration=4 s").log_every["scene"] == 200
    assert small("log.scene=0 ticks").log_every["scene"] == 0

    without = made("paper", "checks={}", "log.scene=0 ticks", "log.transforms=25 ticks", "duration=1 s")
    log = fleet.open_log(without.directory)
    assert "scene" not in log
    assert log["transforms"].t.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_a_run_that_goes_on_draws_the_same(log: Path, tmp_path: Path) -> None:
    """Histories of links come from the snapshot, and who is silent from the first frame."""
    for at in (1_000_000_000, 3_000_000_000):
        scenario, start = continuation(log, at)
        how = Options(tmp_path, in_process=True, quiet=True)
        again = execute(scenario, how, wiring=Wiring(start=start)).directory / "run.mcap"
        rest, before = ([r for r in LogReader(path) if r.log_ns >= at] for path in (again, log))
        assert rest == before


def test_units_of_lists_of_messages() -> None:
    units = {"transforms.translation": "m", "tau": "N, N m", "scale": "1"}
    assert _unit(units, "transforms.translation.x") == "m"
    assert [_unit(units, "tau", k) for k in range(3)] == ["N", "N m", "N, N m"]
    assert _unit(units, "tau.x", 1) == "N, N m"
    assert _unit(units, "other.x") == ""


# --- the layout --------------------------------------------------------------

_PATH = re.compile(r'(?:"([^"]+)"|([\w-]+))((?:\.\w+|\[\d*:?\]|\{\w+=="[^"]*"\})*)')


def values(message: Any, steps: list[str]) -> list[Any]:
    """What a path of Foxglove's finds in a message; KeyError where a field is not there."""
    found = [message]
    for step in steps:
        if step.startswith("."):
            if any(step[1:] not in m.DESCRIPTOR.fields_by_name for m in found):
                raise KeyError(step)
            found = [getattr(m, step[1:]) for m in found]
        elif step.startswith("["):
            found = [element for m in found for element in (m if ":" in step else [m[int(step[1:-1])]])]
        else:
            name, wanted = re.fullmatch(r'\{(\w+)=="(.*)"\}', step).groups()  # type: ignore[union-attr]
            found = [m for m in found if getattr(m, name) == wanted]
    return found


def test_the_layout_names_what_a_log_holds(messages: dict[str, dict[float, Any]]) -> None:
    layout = json.loads((ROOT / "docs" / "examples" / "foxglove-layout.json").read_text())

    def ids(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else ids(node["first"]) | ids(node["second"])

    assert ids(layout["layout"]) == set(layout["configById"])
    used = 0
    for name, config in layout["configById"].items():
        for path in [p["value"] for p in config.get("paths", [])] + [config[k] for k in ("topicPath",) if k in config]:
            match = _PATH.fullmatch(path)
            assert match is not None, (name, path)
            topic = messages[match[1] or match[2]]
            steps = re.findall(r"\.\w+|\[\d*:?\]|\{[^}]*\}", match[3])
            assert any(values(message, steps) for message in topic.values()), (name, path)
            used += bool(steps)
    assert used > 25
    view = layout["configById"]["3D!uuv"]
    assert view["topics"].keys() == {"scene"} <= messages.keys()
    frames = {t.child_frame_id for t in messages["transforms"][0.0].transforms} | {"map"}
    assert {view["followTf"], view["layers"]["grid"]["frameId"]} <= frames


def test_the_layout_shows_whole_plots_titles_and_hulls(messages: dict[str, dict[float, Any]]) -> None:
    """Legends stand beside the plots; every panel has a title by Foxglove's key and by Lichtblick's; and in a view of
    500 pixels a hull is at least 20 pixels long."""
    layout = json.loads((ROOT / "docs" / "examples" / "foxglove-layout.json").read_text())
    for name, config in layout["configById"].items():
        assert (
            config["foxglovePanelTitle"]
            == config["lichtblickPanelTitle"]
            == config.get("title", config["foxglovePanelTitle"])
        )
        if name.startswith("Plot!"):
            assert (config["showLegend"], config["legendDisplay"]) == (True, "left")
    camera = layout["configById"]["3D!uuv"]["cameraState"]
    pixels_per_m = 500 / (2 * camera["distance"] * math.tan(math.radians(camera["fovy"] / 2)))
    hull = next(e for e in messages["scene"][0.0].entities if e.id == "uuv-1")
    length = sum(cylinder.size.z for cylinder in hull.cylinders)
    assert length * pixels_per_m > 20
