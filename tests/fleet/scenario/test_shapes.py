"""Named formations, graphs and vehicles, settings per vehicle: what they compile to and what they refuse."""

from __future__ import annotations

import cmath
import math
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from refusals import check_refusals
from repository import ROOT
from small_scenario import SMALL, places, read_back, small

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Status
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.motion import GRAPH, FormationShape, GraphSection
from fleet.scenario.sections.formation import SHAPES, offsets
from fleet.scenario.sections.graph import build
from fleet.scenario.sections.vehicle_files import load_vehicle

# --- formations ------------------------------------------------------------


def beside(shape: str, n: int) -> list[tuple[int, int]]:
    """The vehicles that stand next to each other in a shape, by index."""
    if shape == "wedge":  # 1 at the point, then alternately on two arms
        return [(max(0, i - 2), i) for i in range(1, n)]
    ring = [(n - 1, 0)] if shape == "circle" and n > 2 else []
    return [*pairwise(range(n)), *ring]


@pytest.mark.parametrize("shape", SHAPES)
def test_spacing_is_between_neighbours(shape: str) -> None:
    """And nobody is nearer than that to anybody, in fleets of up to 50."""
    for n in range(1, 51):
        cells = SHAPES[shape](n, 4.0)
        near = beside(shape, n)
        assert len(cells) == n
        assert all(down == 0.0 for _, _, down in cells)
        assert [math.dist(cells[i], cells[j]) for i, j in near] == pytest.approx([4.0] * len(near)), n
        assert min((math.dist(a, b) for a, b in combinations(cells, 2)), default=4.0) == pytest.approx(4.0), n
        if shape != "grid":  # the paper's square has vehicle 1 behind
            assert max(x for x, _, _ in cells) == pytest.approx(cells[0][0])
        if shape == "circle":
            assert [sum(axis) for axis in zip(*cells, strict=True)] == pytest.approx([0.0] * 3, abs=1e-9)
        else:
            assert cells[0] == (0.0, 0.0, 0.0)


def test_on_which_side_they_are() -> None:
    """North is ahead, east is starboard: as docs/reference/scenario-keys.md says."""
    signs = {shape: [int(math.copysign(y != 0, y)) for _, y, _ in make(5, 4.0)] for shape, make in SHAPES.items()}
    assert signs["line"] == [0, -1, -1, -1, -1]
    assert signs["wedge"] == [0, 1, -1, 1, -1]
    assert [round(y, 9) > 0 for _, y, _ in SHAPES["circle"](4, 4.0)] == [False, True, False, False]  # clockwise


@given(st.sampled_from(sorted(SHAPES)), st.integers(1, 50), st.floats(-720.0, 720.0))
def test_heading_is_a_rotation(shape: str, n: int, heading: float) -> None:
    """Clockwise seen from above: what is ahead in the shape lies on that course, and all distances stay."""
    section = {"shape": shape, "spacing": "4 m"}
    turned = offsets(FormationShape.model_validate(section | {"heading": f"{heading!r} deg"}), n)
    for (x, y, _), (north, east, _) in zip(offsets(FormationShape.model_validate(section), n), turned, strict=True):
        course = complex(x, y) * cmath.exp(1j * math.radians(heading))
        assert (north, east) == pytest.approx((course.real, course.imag), abs=1e-9)


def test_heading_turns_a_shape() -> None:
    north = places(small("formation={shape: column, spacing: 4 m}"))
    east = places(small("formation={shape: column, spacing: 4 m, heading: 90 deg}"))
    assert [(x, y) for x, y, _ in north] == [(0, 0), (-4, 0), (-8, 0)]
    assert [xy for x, y, _ in east for xy in (x, y)] == pytest.approx([0, 0, 0, -4, 0, -8], abs=1e-9)


def test_a_change_is_between_two_shapes() -> None:
    s = small(
        "formation.changes=[{at: 200 ms, over: 500 ms, shape: column, spacing: 5.1 m}]",
        "guidance.rho_lo=-99 -99 -1 m/s",
        "guidance.rho_hi=99 99 1 m/s",
    )
    before, after = places(s), places(small("formation={shape: column, spacing: 5.1 m}"))
    assert tuple(plan.at(0.2).position for plan in s.plans) == before
    assert tuple(plan.at(0.7).position for plan in s.plans) == after
    middle = s.plans[2].at(0.45).position
    assert middle == pytest.approx(tuple((a + b) / 2 for a, b in zip(before[2], after[2], strict=True)))
    # What each keeps from its neighbour is the difference of their plans at every time.
    (first, *_), t = s.agent_config(2).neighbours, 0.4
    own, other = s.plans[1].at(t).position, s.plans[first.id - 1].at(t).position
    assert first.offset.at(t).position == pytest.approx(tuple(a - b for a, b in zip(own, other, strict=True)))


# --- graphs ----------------------------------------------------------------


def links(graph: str, n: int = 6, *more: str) -> set[tuple[int, int]]:
    return set(small(f"vehicles={n}", f"graph={graph}", *more).graph.links)


def test_graphs_by_name() -> None:
    assert links("{shape: star}", 4) == {(1, 2), (2, 1), (1, 3), (3, 1), (1, 4), (4, 1)}
    assert links("{shape: star, hub: 3}", 3) == {(3, 1), (1, 3), (3, 2), (2, 3)}
    assert len(links("{shape: complete}", 6)) == 30
    assert set(small("graph={shape: complete, weight: 0.3}").graph.weights.values()) == {0.3}
    near = small("vehicles=9", "graph={shape: nearest, count: 3}").graph
    assert all(len(near.neighbours(i)) == 3 for i in range(1, 10))
    # In a column the nearest are those before and behind.
    column = "formation={shape: column}"
    assert small("vehicles=5", column, "graph={shape: nearest}").graph.neighbours(3) == ((2, 1.0), (4, 1.0))


def edges(graph: str, n: int, seed: int = 1) -> set[tuple[int, int]]:
    """The links of a named shape over a wedge."""
    section = GraphSection.model_validate(yaml.safe_load(graph))
    return set(build(section, SHAPES["wedge"](n, 4.0), seed).links)


def components(links: set[tuple[int, int]], n: int) -> int:
    """How many parts a graph has, links taken both ways."""
    part = list(range(n + 1))
    for _ in range(n):
        for i, j in links:
            part[i] = part[j] = min(part[i], part[j])
    return len({part[i] for i in range(1, n + 1)})


@pytest.mark.parametrize("shape", [shape for shape in GRAPH if shape != "edges"])
@pytest.mark.parametrize("n", [3, 4, 7, 20, 50])
def test_every_graph_is_what_its_name_says(shape: str, n: int) -> None:
    found = edges(f"{{shape: {shape}}}", n)
    heard = {i: {j for j, to in found if to == i} for i in range(1, n + 1)}
    assert all(i != j and 1 <= i <= n and 1 <= j <= n for i, j in found)
    if shape == "nearest":  # the only one in which hearing is not mutual
        assert {len(others) for others in heard.values()} == {2}
        cells = SHAPES["wedge"](n, 4.0)
        for i, others in heard.items():
            ways = sorted(math.dist(cells[i - 1], cells[j - 1]) for j in range(1, n + 1) if j != i)
            assert sorted(math.dist(cells[i - 1], cells[j - 1]) for j in others) == pytest.approx(ways[:2])
        return
    assert found == {(j, i) for i, j in found}
    assert components(found, n) == 1
    sizes = {"path": 2 * (n - 1), "ring": 2 * n, "star": 2 * (n - 1), "complete": n * (n - 1)}
    assert len(found) == sizes.get(shape, len(found))
    if shape == "star":
        assert len(heard[1]) == n - 1


@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 2**63 - 1), st.floats(0.0, 100.0))
def test_random_graphs_are_connected_and_order_free(n: int, m: int, seed: int, percent: float) -> None:
    """A draw per pair: another vehicle adds pairs and changes none; so does a larger probability."""
    few, many = sorted((n, m))
    graph = f"{{shape: random, probability: {percent!r} %}}"
    found = edges(graph, many, seed)
    assert components(found, many) == 1
    assert found == {(j, i) for i, j in found}
    assert edges(graph, few, seed) == {link for link in found if max(link) <= few}
    assert edges("{shape: random, probability: 0}", many, seed) <= found
    assert len(edges("{shape: random, probability: 0}", many, seed)) == 2 * (many - 1)
    assert len(edges("{shape: random, probability: 100 %}", many, seed)) == many * (many - 1)


# --- references ------------------------------------------------------------

WIDE = ("guidance.rho_lo=-2 -2 -1.25 m/s", "guidance.rho_hi=2 2 1.25 m/s")
REFERENCES = {
    "circle": "{shape: circle, center: 0 0 10 m, radius: 20 m, speed: 0.5 m/s, bearing: 30 deg, turn: port}",
    "helix": "{shape: helix, center: 0 0 10 m, radius: 20 m, speed: 0.5 m/s, sink: -0.1 m/s}",
    "lawn-mower": "{shape: lawn-mower, start: 0 0 5 m, leg: 30 m, legs: 4, spacing: 10 m, speed: 0.5 m/s}",
    "waypoints": "{shape: waypoints, points: [0 0 5 m, 40 0 5 m, 40 40 9 m], speed: 0.5 m/s, acceleration: 0.05 m/s^2}",
    "loop": "{shape: waypoints, points: [0 0 5 m, 40 0 5 m, 40 40 9 m], speed: 1 m/s, acceleration: 0.2 m/s^2, "
    "closed: true}",
}  # fmt: skip


@pytest.mark.parametrize(
    "overrides",
    [
        *([f"reference={text}", *WIDE] for text in REFERENCES.values()),
        ["reference={shape: line, start: 1 2 3 m, velocity: 0.5 0.1 0 m/s}"],
        *([f"formation={{shape: {shape}, spacing: 3.3 m, heading: -20 deg}}"] for shape in SHAPES),
        *([f"graph={{shape: {shape}}}"] for shape in GRAPH if shape != "edges"),
        ["graph={shape: nearest, count: 1, weight: 2}"],
        ["graph={shape: star, hub: 2}", "formation={offsets: [0 0 0 m, 3 0 0 m, 0 3 0 m]}"],
        ["formation.changes=[{at: 0 s, over: 900 ms, offsets: [0 0 0 m, 0 -5 0 m, 5.1 -5 0 m]}]"],
        ["formation={shape: wedge, changes: [{at: 100 ms, over: 900 ms, shape: wedge, spacing: 10.1 m}]}"],
        ["graph={shape: random, probability: 30 %, weight: 0.5, reference: [2]}"],
        ["initial={scatter: 1 m, around: reference}"],
        ["model_error={m: 10 %, beta_u: -20 %}", "vehicle.beta_v=1.3 kg/s"],
        ["per_vehicle={'2-3': {controller: bsmc, tracking: {phi: 0.5 1 1}, vehicle: {surge_force: 7 N}}}"],
        ["per_vehicle={'1, 3': {profile: hardened, neighbours: {extrapolate: hold}, model_error: {m: 5 %}}}"],
        ["guidance=fixed", "tracking={law: sliding-mode, angles: exact}", "on_controller_error=coast"],
        ["controller=boc", "controller_budget=3 ms"],
    ],
)
def test_round_trip(overrides: list[str]) -> None:
    """What a run leaves behind loads to an equal scenario."""
    read_back(small(*overrides))


def test_around_the_reference_they_start_in_place() -> None:
    s = small("reference=" + REFERENCES["circle"], *WIDE, "initial={scatter: 0 m, around: reference}")
    start = s.reference.at(0.0)
    for (eta0, _), plan in zip(s.initial, s.plans, strict=True):
        assert eta0[:3] == pytest.approx(tuple(a + b for a, b in zip(start.position, plan.start, strict=True)))
        assert eta0[4] == pytest.approx(math.atan2(start.velocity[1], start.velocity[0]))


# --- vehicles --------------------------------------------------------------


def test_the_shipped_vehicle_is_the_papers() -> None:
    """Table I, written down here a second time."""
    vehicle = load_vehicle("paper")
    assert vehicle.params.inertia == pytest.approx((4.0, 8.9, 8.85, 2.5, 1.55))
    p = vehicle.params
    assert (p.beta_u, p.beta_v, p.beta_w, p.beta_q, p.beta_r, p.beta_b) == (1.0, 1.1, 1.15, 0.2, 0.25, 0.1)
    assert vehicle.tau_max == (20.0, 20.0, 20.0)


PAPER_TOML = (ROOT / "world" / "vehicles" / "paper.toml").read_text("utf-8")


def with_vehicle(tmp_path: Path, text: str, *overrides: str) -> Scenario:
    (tmp_path / "mine.toml").write_text(text, "utf-8")
    (tmp_path / "s.yaml").write_text(SMALL, "utf-8")
    return load_scenario(str(tmp_path / "s.yaml"), overrides or ["vehicle.model=mine.toml"])


def test_a_vehicle_file(tmp_path: Path) -> None:
    """Beside the scenario; other units; and the merged scenario no longer needs it."""
    text = PAPER_TOML.replace("value = 10.0, unit", "value = 12000, unit").replace(
        '12000, unit = "kg"', '12000, unit = "g"'
    )
    s = with_vehicle(tmp_path, text)
    assert s.controls[0].vehicle.m == 12.0
    assert s.world_config.vehicles[0].params.m == s.agent_config(1).vehicle.m == 12.0
    (tmp_path / "mine.toml").unlink()
    read_back(s)
    one = with_vehicle(tmp_path, text, "per_vehicle.2.vehicle.model=mine.toml")
    assert [c.vehicle.m for c in one.controls] == [10.0, 12.0, 10.0]
    read_back(one)


def test_a_bad_vehicle_file(tmp_path: Path) -> None:
    """The one that ships, a part of which, or all, is replaced by something else."""

    def changed(old: str, new: str) -> None:
        with_vehicle(tmp_path, new if old == "all" else PAPER_TOML.replace(old, new))

    check_refusals("scenario/vehicle files", changed, hide={str(tmp_path): "HERE"})


def test_model_error_is_the_controllers_alone() -> None:
    s = small("model_error={m: 10 %, beta_b: -0.5}", "per_vehicle.2.model_error.m=20 %")
    assert [c.model.m for c in s.controls] == pytest.approx([11.0, 12.0, 11.0])
    assert {c.vehicle.m for c in s.controls} == {10.0}
    assert s.agent_config(2).vehicle.m == pytest.approx(12.0)
    assert s.agent_config(1).vehicle.beta_b == pytest.approx(0.05)
    assert s.world_config.vehicles[1].params.m == 10.0


# --- per vehicle -----------------------------------------------------------


def test_each_setting_reaches_its_vehicles() -> None:
    s = small(
        "vehicles=5",
        "controller=boc",
        "per_vehicle={'2-4': {controller: bc, profile: hardened}, '3': {guidance: optimal, guidance.k_max: 1}}"
        .replace(", guidance.k_max: 1", ""),
        "per_vehicle.4.tracking.k_u=3 1/s",
        "per_vehicle.5.neighbours.extrapolate=reference",
    )  # fmt: skip
    assert [c.guidance_law.name for c in s.controls] == ["optimal", "fixed", "optimal", "fixed", "optimal"]
    assert [c.tracking_law.name for c in s.controls] == ["backstepping"] * 5
    assert [c.guidance.k_max for c in s.controls] == [2.0, 0.3, 0.3, 0.3, 2.0]
    assert [c.tracking.k_u for c in s.controls] == [10.0, 10.0, 10.0, 3.0, 10.0]
    assert [c.extrapolation for c in s.controls] == ["hold"] * 4 + ["reference"]
    assert [c.guidance.K0[0] for c in s.controls] == [0.3, 0.6, 0.3, 0.6, 0.3]


def test_what_a_vehicle_does_not_mention_stays() -> None:
    s = small("neighbours={extrapolate: reference, drop_after: 9 s}", "per_vehicle.2.neighbours.drop_after=2 s")
    assert [(c.extrapolation, c.drop_after_s) for c in s.controls] == [
        ("reference", 9.0),
        ("reference", 2.0),
        ("reference", 9.0),
    ]
    read_back(s)


def test_a_controller_per_vehicle_replaces_laws_below_it() -> None:
    s = small("guidance=fixed", "per_vehicle.2.controller=boc", "per_vehicle.3={controller: boc, guidance: fixed}")
    assert [c.guidance_law.name for c in s.controls] == ["fixed", "optimal", "fixed"]
    assert [c.tracking_law.name for c in s.controls] == ["neurodynamic", "backstepping", "backstepping"]


# --- runs ------------------------------------------------------------------


def test_a_mixed_fleet_runs_the_same_way_everywhere(tmp_path: Path) -> None:
    """Every controller of the paper side by side, on a helix while the ring widens: each vehicle logs what its own
    laws report, and the distributed run gives the bytes of the in-process one."""
    changes = "formation.changes=[{at: 200 ms, over: 5 s, shape: circle, spacing: 8.5 m}]"
    s = load_scenario("helix", ["duration=1 s", "checks={}", "log.every=2 ticks", changes])
    alone = execute(s, Options(tmp_path, in_process=True, quiet=True))
    fleet = execute(s, Options(tmp_path, quiet=True))
    assert alone.status is fleet.status is Status.PASS, (alone.reason, fleet.reason)
    assert (fleet.directory / "run.mcap").read_bytes() == (alone.directory / "run.mcap").read_bytes()
    with (alone.directory / "run.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    schema: dict[str, Any] = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    tracking = ["Neurodynamic", "Backstepping", "Neurodynamic", "Backstepping", "SlidingMode", "SlidingMode"]
    assert [schema[f"uuv/{i}/control"] for i in range(1, 7)] == [f"uuv_fleet.{law}Control" for law in tracking]
    guidance = ["Optimal", "Optimal", "Fixed", "Fixed", "Fixed", "Optimal"]
    assert [schema[f"uuv/{i}/guidance"] for i in range(1, 7)] == [f"uuv_fleet.{law}Guidance" for law in guidance]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["helix", "survey"])
def test_shipped_courses_are_followed(name: str, tmp_path: Path) -> None:
    """Their own checks, in the first minute; the change of the survey's formation is brought forward."""
    early = ["formation.changes.1.at=25 s"] if name == "survey" else []
    overrides = ["duration=60 s", "log.every=20 ticks", "checks.formation_error.after=45 s", *early]
    result = execute(load_scenario(name, overrides), Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, (result.reason, result.checks)
