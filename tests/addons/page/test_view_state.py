"""Messages of a run become what a page draws."""

from __future__ import annotations

import json
from math import radians
from types import SimpleNamespace
from typing import Any

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from hypothesis import given
from hypothesis import strategies as st
from small_scenario import small

from fleet.addons.page.view_state import MOST_PACKETS, SAMPLE_S, ViewState
from fleet.logs.fault_intervals import FaultMessage
from fleet.recorder.transforms import quaternion
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.fault_words import entry_of_words

TURN = (radians(10.0), radians(120.0))


def placed(scenario: Scenario, t: float, *off: tuple[float, float, float]) -> Any:
    """The message that says that each vehicle is so far off its place, turned by TURN."""
    at = scenario.reference.at(t).position
    message = FrameTransforms()
    message.transforms.add(parent_frame_id="map", child_frame_id="reference")
    for i, (plan, away) in enumerate(zip(scenario.plans, off, strict=True), start=1):
        x, y, z = (a + b + c for a, b, c in zip(at, plan.at(t).position, away, strict=True))
        qx, qy, qz, qw = quaternion(*TURN)
        message.transforms.add(
            child_frame_id=f"uuv-{i}", translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw)
        )
    return message


def packet(sent: float, due: float, fate: str = "delivered", corrupted: bool = False) -> Any:
    return SimpleNamespace(sent=sent, due=due, fate=fate, corrupted=corrupted, payload=b"")


def event(fault: str, action: str, what: str) -> Any:
    return FaultMessage(fault, action, what, entry_of_words(what))


def shown(picture: ViewState) -> dict[str, Any]:
    """A frame, as a browser gets it."""
    frame: dict[str, Any] = json.loads(json.dumps(picture.frame(), allow_nan=False))
    return frame


def test_vehicles_are_where_the_transforms_say_and_their_errors_count_from_their_places() -> None:
    scenario = small()
    picture = ViewState(scenario)
    picture.transforms(0.5, placed(scenario, 0.5, (0, 0, 0), (3, 0, 4), (0, 0.5, 0)))
    frame = shown(picture)
    assert frame["t"] == 0.5 and frame["ref"] == [0.25, 0, 5]
    assert frame["errors"] == [0, 5, 0.5]
    i, _, _, depth, pitch, heading, _ = frame["uuv"][1]
    assert (i, depth) == (2, 9)
    assert (pitch, heading) == pytest.approx(TURN, abs=1e-3)


def test_speeds_come_from_two_places() -> None:
    scenario = small()
    picture = ViewState(scenario)
    picture.transforms(0.0, placed(scenario, 0.0, (0, 0, 0), (0, 0, 0), (0, 0, 0)))
    picture.transforms(0.5, placed(scenario, 0.5, (0, 0, 0), (0, 1, 0), (0, 0, 0)))
    speeds = [row[6] for row in shown(picture)["uuv"]]
    assert speeds == pytest.approx([0.5, (0.25**2 + 1) ** 0.5 / 0.5, 0.5], abs=1e-3)


def test_packets_are_shown_once_and_links_by_what_arrives() -> None:
    picture = ViewState(small())
    links = picture.setup()["links"]
    picture.packet((1, 2), packet(0.0, 0.05))
    picture.packet((2, 3), packet(0.0, 0.2))
    picture.packet((3, 2), packet(0.0, 0.05, "down"))
    picture.packet((7, 9), packet(0.0, 0.05))  # of no link of this run
    picture.at_s = 0.2
    frame = shown(picture)
    assert [(links[k], fate) for k, _, _, fate in frame["packets"]] == [
        ([1, 2], "arrived"), ([2, 3], "late"), ([3, 2], "cut"),
    ]  # fmt: skip
    states = dict(zip(map(tuple, links), frame["links"], strict=True))
    assert states == {(1, 2): "delivering", (2, 1): "silent", (2, 3): "late", (3, 2): "cut"}
    assert dict(zip(map(tuple, links), frame["losses"], strict=True)) == {(1, 2): 0, (2, 1): 0, (2, 3): 0, (3, 2): 1}
    assert frame["kinds"] == [["other bytes", 3, 1]]
    assert shown(picture)["packets"] == []


def test_of_too_many_packets_the_last_are_shown() -> None:
    picture = ViewState(small())
    for number in range(MOST_PACKETS + 10):
        picture.packet((1, 2), packet(float(number), number + 0.05))
    assert shown(picture)["packets"][0][1] == 10.0


def test_samples_come_at_their_interval_and_stay_as_history() -> None:
    scenario = small()
    picture = ViewState(scenario)
    for number in range(5):
        t = number * SAMPLE_S / 2
        picture.packet((1, 2), packet(t, t + 0.05, "loss" if number % 2 else "delivered"))
        picture.transforms(t, placed(scenario, t, (0, 0, 1), (0, 0, 0), (0, 0, 0)))
    samples = shown(picture)["samples"]
    assert [sample[0] for sample in samples] == pytest.approx([0, SAMPLE_S, 2 * SAMPLE_S])
    assert samples[-1][1] == [1, 0, 0]
    assert samples[-1][3] == pytest.approx(2 / 5)  # of the packets
    assert picture.history()["samples"] == samples and shown(picture)["samples"] == []


@given(st.lists(st.tuples(st.integers(0, 3), st.sampled_from(["delivered", "down"])), max_size=30), st.integers(1, 29))
def test_who_comes_late_shows_no_age_that_is_wrong(packets: list[tuple[int, str]], first: int) -> None:
    """Ages were counted from 0, or from the time of a jump. Without a console it says that it does not know them."""
    scenario = small()
    whole, late, told = ViewState(scenario), ViewState(scenario), ViewState(scenario)
    for picture in (late, told):
        picture.clear(float(first))
    links = scenario.graph.links

    def age(link: tuple[int, int]) -> float:
        return whole.at_s - max([n for n, (k, fate) in enumerate(packets[: int(whole.at_s)]) if links[k] == link
                                 and fate == "delivered"], default=0)  # fmt: skip

    for number, (k, fate) in enumerate(packets):
        for picture in (whole, late, told)[: 3 if number >= first else 1]:
            picture.packet(links[k], packet(float(number), number + 0.05, fate))
    for picture in (whole, late, told):
        picture.at_s = float(max(len(packets), first))
    told.set_link_ages(told.at_s, [{"src": src, "dst": dst, "age_s": age((src, dst))} for src, dst in links])
    ages = shown(whole)["ages"]
    assert shown(told)["ages"] == ages and shown(told)["since"] == first
    heard = {links[k] for k, fate in packets[first:] if fate == "delivered"}
    assert shown(late)["ages"] == [age if link in heard else None for link, age in zip(links, ages, strict=True)]
    late.transforms(40.0, placed(scenario, 40.0, (0, 0, 0), (0, 0, 0), (0, 0, 0)))
    oldest = dict(zip(late.neighbours, shown(late)["samples"][0][2], strict=True))
    assert all(
        (oldest[dst] is None) == any((src, dst) not in heard for src in some) for dst, some in late.neighbours.items()
    )


def test_scripted_faults_are_known_before_they_begin() -> None:
    picture = ViewState(small("duration=20 s", "faults=[{at: 5 s, for: 2 s, kill: 3}]"))
    assert [(row["what"], row["active"]) for row in shown(picture)["faults"]] == [("kill 3", False)]
    picture.at_s = 6.0
    frame = shown(picture)
    assert frame["faults"][0]["active"] and frame["faults"][0]["to_s"] == 7.0
    assert frame["states"] == {"3": "no agent"}
    picture.at_s = 7.0
    assert shown(picture)["faults"] == [] and shown(picture)["states"] == {}


def test_injected_faults_begin_and_end_with_their_events() -> None:
    picture = ViewState(small())
    picture.event(0.2, event("live-1", "begins", "mute 1"))
    picture.event(0.2, event("tumbled-2", "begins", "tumbled 2"))
    picture.at_s = 0.3
    frame = shown(picture)
    assert [row["id"] for row in frame["faults"]] == ["live-1"]  # a tumble is a consequence
    assert frame["states"] == {"1": "mute", "2": "tumbled"}
    picture.event(0.3, event("live-1", "ends", "mute 1"))
    assert shown(picture)["faults"] == []


def test_what_happened_to_vehicles_is_one_row_for_each_and_past_faults_stay_known() -> None:
    picture = ViewState(small())
    for n, (begin, end) in enumerate([(0.1, 0.2), (0.25, 0.3), (0.4, 0.45)]):
        picture.event(begin, event(f"tumbled-2-{n}", "begins", "tumbled 2"))
        picture.event(end, event(f"tumbled-2-{n}", "ends", "tumbled 2"))
    picture.event(0.2, event("live-1", "begins", "mute 1"))
    changes = picture.changes
    picture.event(0.3, event("live-1", "ends", "mute 1"))
    assert picture.changes > changes
    known = picture.known()
    assert known["events"] == [{"text": "tumbled 2: 3 times, first at 0.1 s", "at_s": 0.1}]
    assert [(row["what"], row["from_s"], row["to_s"]) for row in known["faults"]] == [("mute 1", 0.2, 0.3)]
    changes = picture.changes
    picture.faults([*known["faults"], *picture._events.values()])
    assert picture.known() == known and picture.changes == changes  # nothing is new
    picture.set_vehicle_events([{"what": "tumbled 3", "times": 4, "first_s": 0.05}])  # the console has seen more
    assert picture.known()["events"] == [{"text": "tumbled 3: 4 times, first at 0.05 s", "at_s": 0.05}]


def test_places_that_are_no_numbers_are_left_open() -> None:
    scenario = small()
    picture = ViewState(scenario)
    picture.transforms(0.0, placed(scenario, 0.0, (float("nan"), 0, 0), (float("inf"), 0, 0), (0, 0, 0)))
    assert shown(picture)["errors"] == [None, None, 0]


def test_signals_are_thinned() -> None:
    picture = ViewState(small())
    picture.follow({"uuv/1/state.z"})
    for tick in range(100):
        picture.signal("uuv/1/state.z", tick * 0.01, float(tick))
    values = shown(picture)["signals"]["uuv/1/state.z"]
    assert values[:3] == [[0, 0], [0.05, 5], [0.1, 10]] and len(values) == 20
    assert "signals" not in shown(picture)
    picture.follow({"uuv/1/state.x"})
    assert picture.history()["signals"] == {"uuv/1/state.x": []}


def test_a_formation_that_changes_is_told_again_and_again() -> None:
    assert "moving" not in shown(ViewState(small()))
    changing = ViewState(
        small("duration=200 s", "formation.changes=[{at: 1 s, over: 100 s, shape: column, spacing: 8 m}]")
    )
    before = shown(changing)["moving"]
    changing.at_s = 60.0
    assert shown(changing)["moving"] != before


@pytest.mark.parametrize("name", ["uuv-x", "uuv-99", "uuv-0", "uuv-01", "uuv-"])
def test_frames_of_no_vehicle_are_left_out(name: str) -> None:
    scenario = small()
    picture, message = ViewState(scenario), FrameTransforms()
    message.transforms.add(child_frame_id=name, translation=Vector3(), rotation=Quaternion(w=1.0))
    picture.transforms(1.0, message)
    assert picture.frame()["uuv"] == []


def test_a_moored_fleet_follows_no_reference() -> None:
    setup = ViewState(load_scenario("election", ["moored=true"])).setup()
    assert setup["moored"] and setup["leaders"] == []
    setup = ViewState(small()).setup()
    assert not setup["moored"] and setup["leaders"]


def test_nodes_have_names_and_no_places_to_keep() -> None:
    """A reference, a formation error and a star mean nothing for robots that are not ours."""
    nodes = {name: {"place": f"{north} 0 10 m"} for north, name in enumerate(("auv1", "shore"))}
    scenario = parse_scenario(json.dumps({"title": "A stack", "nodes": nodes}), "stack.yaml")
    picture = ViewState(scenario)
    setup = picture.setup()
    assert (setup["guided"], setup["leaders"], setup["ends"]) == (False, [], False)
    assert not setup["standing"] and not setup["moving"]
    assert {row["name"] for row in setup["legend"]}.isdisjoint({"course", "desired place"})
    message = FrameTransforms()
    message.transforms.add(child_frame_id="uuv-2", translation=Vector3(x=1.0, y=0.0, z=10.0))
    picture.transforms(0.0, message)
    assert shown(picture)["labels"] == [[2, "shore", "10.0 m deep"]]
