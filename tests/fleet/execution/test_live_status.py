"""What `fleet status` says of vehicles and links: computed from a journal when somebody asks."""

from __future__ import annotations

from itertools import pairwise

import pytest

from benchmarks.recorder import Calls
from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.execution.live_status import WORST_LINKS, WORST_VEHICLES, event_rows, link_rows, vehicle_rows
from fleet.recorder.journal import Journal
from fleet.recorder.metrics import SETTLE_M
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.fault_entry import vehicle_entry
from fleet.scenario.sections.timeline import Event

OVERRIDES = [
    "vehicles=14",
    "duration=3 s",
    "checks={}",
    "network.links={'*': 'delay 100ms', '4->5': 'loss 50%'}",
    "faults=[{at: 1 s, down: '8->9'}, {at: 1 s, kill: 3}]",
]


@pytest.fixture(scope="module")
def run() -> tuple[Scenario, Journal]:
    """A run that is over, with a link that is down for its last two seconds, and one that loses half."""
    scenario = load_scenario("paper", OVERRIDES)
    journal = Journal(scenario, Calls())
    InProcess(scenario, journal).serve(GrantPolicy.of(scenario), lambda: None)
    return scenario, journal


def test_the_worst_vehicles_in_the_order_of_their_numbers(run: tuple[Scenario, Journal]) -> None:
    scenario, journal = run
    every = vehicle_rows(scenario, journal, [3], every=True)
    shown = vehicle_rows(scenario, journal, [3])
    assert [row["vehicle"] for row in every] == list(range(1, 15))
    assert len(shown) == WORST_VEHICLES
    assert all(one["vehicle"] < next_one["vehicle"] for one, next_one in pairwise(shown))
    left_out = [row for row in every if row not in shown]
    assert max(row["formation_m"] for row in left_out) <= min(row["formation_m"] for row in shown)
    assert [row["state"] for row in every] == ["alive"] * 2 + ["tumbled, no agent"] + ["alive"] * 11
    assert every[0]["formation_m"] == journal.metrics.series[1].formation[-1]


def test_what_a_vehicle_knows_is_as_old_as_its_oldest_link(run: tuple[Scenario, Journal]) -> None:
    rows = {row["vehicle"]: row for row in vehicle_rows(*run, [], every=True)}
    assert (rows[9]["oldest_s"], rows[9]["oldest_of"]) == (pytest.approx(2.0, abs=0.3), 8)
    assert (rows[4]["oldest_s"], rows[4]["oldest_of"]) == (pytest.approx(2.0, abs=0.3), 3)
    assert rows[12]["oldest_s"] < 0.5


def test_the_worst_links_first(run: tuple[Scenario, Journal]) -> None:
    every, shown = link_rows(*run, every=True), link_rows(*run)
    assert len(every) == len(run[0].graph.links)
    assert shown == every[:WORST_LINKS]
    assert {(row["src"], row["dst"]) for row in shown} == {(2, 3), (4, 3), (8, 9), (3, 2), (3, 4)}
    lossy = next(row for row in every if (row["src"], row["dst"]) == (4, 5))
    assert lossy["lost"] > 0 and lossy["lost_share"] == lossy["lost"] / (lossy["lost"] + lossy["delivered"])
    assert all(one["age_s"] >= next_one["age_s"] for one, next_one in pairwise(every))


def test_before_the_first_frame_there_are_no_vehicles(run: tuple[Scenario, Journal]) -> None:
    scenario = run[0]
    journal = Journal(scenario, Calls())
    assert vehicle_rows(scenario, journal, []) == []
    assert [row["age_s"] for row in link_rows(scenario, journal)] == [0.0] * WORST_LINKS


def test_settled_is_below_five_centimetres_for_long_enough(run: tuple[Scenario, Journal]) -> None:
    """As in the result table: a tenth of the time so far; a moment is not enough."""
    scenario, journal = run
    series = journal.metrics.series[1]
    frames = len(series.e)
    for below, settled in ((frames, True), (frames // 5, True), (frames // 20, False), (0, False)):
        for k in range(frames):
            series.e[k] = SETTLE_M / 2 if k >= frames - below else 1.0
        assert vehicle_rows(scenario, journal, [], every=True)[0]["settled"] == settled, below


def test_events_of_vehicles_are_no_faults(run: tuple[Scenario, Journal]) -> None:
    """Vehicle 3, whose agent is dead, tumbles: one row, however often it did."""
    scenario, journal = run
    (row,) = event_rows(scenario, journal)
    began = [event.tick for event in journal.happened if event.what == "tumbled 3" and event.action == "begins"]
    assert (row["what"], row["times"], row["id"]) == ("tumbled 3", len(began), "tumbled-3")
    assert (row["first_s"], row["last_s"]) == (began[0] / 100, began[-1] / 100)
    assert not row["lasts"]  # the run is over, and with it everything that lasted
    assert journal.active == []


def test_what_lasts_is_told_while_it_lasts() -> None:
    scenario = load_scenario("paper", OVERRIDES)
    journal = Journal(scenario, Calls())
    for tick, number, action in ((100, 1, "begins"), (110, 1, "ends"), (120, 2, "begins")):
        name = "tumbled-3" if number == 1 else f"tumbled-3-{number}"
        journal.happened.append(Event(tick, name, action, "tumbled 3", vehicle_entry("tumbled", 3)))
    row = {
        "what": "tumbled 3",
        "times": 2,
        "first_s": 1.0,
        "id": "tumbled-3-2",
        "entry": '{"tumbled": "3"}',
        "last_s": 1.2,
        "lasts": True,
    }
    assert event_rows(scenario, journal) == [row]
