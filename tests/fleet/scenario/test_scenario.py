"""Scenario files: what they compile to, that they survive a round trip, and how mistakes are reported."""

from __future__ import annotations

import time
from dataclasses import fields, replace
from itertools import pairwise
from math import pi
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from marks import slow
from refusals import check_refusals
from repository import EXPECTED
from small_scenario import SMALL, WILD, accepted, places, read_back, small

from agents.config import GuidanceParams, Neighbour, TrackingParams
from agents.offset import Offset
from agents.profiles import PROFILES, profile
from agents.trajectory import StraightLine
from fleet.errors import FleetError, ScenarioError
from fleet.scenario.catalogue import list_scenarios
from fleet.scenario.loading import load_scenario, parse_scenario, short_text
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.control import GuidanceSection, TrackingSection
from fleet.scenario.schema.network import LinkSection, LinkStateSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.formation import grid
from fleet.scenario.sections.log_rates import DRAWN_GROUPS, LOG_GROUPS
from fleet.scenario.text.yaml_reader import Source, plain, read, resolve
from fleet.scenario.validation import EXAMPLES
from fleet.scenario.value_types import Section
from netem.condition import Condition

SHIPPED = [row.name for row in list_scenarios()]


def problems(text: str, *overrides: str) -> list[tuple[int, int, str]]:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, "t.yaml", overrides)
    return [(p.line, p.column, p.message) for p in caught.value.problems]


# --- what a scenario compiles to -------------------------------------------


def test_the_paper_is_the_paper() -> None:
    """The numbers of the paper's simulation section, written down here a second time."""
    s = load_scenario("paper")
    assert (s.vehicles, s.ticks, s.tick_ns, s.round_ticks, s.seed) == (4, 6000, 10_000_000, 10, 1)
    assert places(s) == ((0, 0, 0), (0, -10, 0), (10, -10, 0), (10, 0, 0))
    assert s.graph.weights == {(1, 2): 1, (2, 3): 1, (3, 4): 1, (2, 1): 0.8, (3, 2): 0.8, (4, 3): 0.8}
    assert s.b == (1, 1, 1, 1)
    assert s.conditions == {}
    world = s.world_config
    assert [v.id for v in world.vehicles] == [1, 2, 3, 4]
    starts = [(0, 0, 0, 0, 0), (-1, -10, 0, 0, 0), (8.5, -10.1, 0, 0, 0), (8.4, -0.1, 0, 0, 0)]
    assert [v.eta0 for v in world.vehicles] == starts
    assert {v.nu0 for v in world.vehicles} == {(0.1, 0, 0, 0, 0)}
    assert {v.tau_max for v in world.vehicles} == {(20, 20, 20)}
    assert world.disturbance == ()
    assert world.noise.off
    agent = s.agent_config(2)
    assert agent.neighbours == (Neighbour(1, 1.0, Offset((0, -10, 0))), Neighbour(3, 0.8, Offset((-10, 0, 0))))
    assert agent.reference == StraightLine((5, 1, 5), (0.7, 0.1, 0))
    assert agent.offset == Offset((0, -10, 0))
    assert agent.reference_weight == 1
    assert (agent.guidance, agent.tracking) == profile("paper")
    assert agent.extrapolation == "neighbour"
    net = s.netem_config
    assert net.vehicles == (1, 2, 3, 4)
    assert set(net.links) == set(s.graph.weights)
    assert not net.ideal


def test_disturbance_of_the_paper() -> None:
    """(3.1 sin t, 3.1 cos t, 2.1 sin t, 1.1 sin t, 1.1 sin t)."""
    world = load_scenario("paper-disturbed").world_config
    assert [(h.amplitude, h.omega) for h in world.disturbance] == [(a, 1) for a in (3.1, 3.1, 2.1, 1.1, 1.1)]
    assert [h.phase for h in world.disturbance] == [0, pi / 2, 0, 0, 0]


def test_rough_sea_and_ideal() -> None:
    rough = load_scenario("rough-sea")
    assert rough.conditions == dict.fromkeys(rough.graph.links, Condition(200_000_000, 50_000_000, 0.3))
    bounds = {"rho_lo": (-1.8, -1.8, -1.0), "rho_hi": (1.8, 1.8, 1.0)}
    assert rough.agent_config(1).guidance == replace(profile("hardened")[0], **bounds)
    ideal = load_scenario("ideal")
    assert ideal.netem_config.ideal
    assert ideal.round_ticks == 1


def test_shipped_scenarios_carry_their_file_name_and_checks() -> None:
    for name in SHIPPED:
        s = load_scenario(name)
        checks = s.spec.checks
        assert s.name == name
        assert checks.formation_error is not None or checks.min_separation is not None or checks.python, name
        assert checks.formation_error is None or checks.formation_error.after < s.duration_ns, name


def test_neighbours_offsets_cancel() -> None:
    """Delta_ij = -Delta_ji, and every directed edge is a link."""
    s = load_scenario("paper", ["vehicles=9", "graph.shape=ring"])
    delta = {(i, n.id): n.offset.start for i in range(1, 10) for n in s.agent_config(i).neighbours}
    for (i, j), offset in delta.items():
        assert offset == tuple(-x for x in delta[j, i])
    assert {(j, i) for i, j in delta} == set(s.netem_config.links)


def test_later_link_rules_win() -> None:
    links = 'network.links={"*": delay 20ms, 1->*: down, "*->2": loss 10%, 2<->3: delay 1s}'
    s = small(links)
    assert s.conditions == {
        (1, 2): Condition(loss=0.1),
        (2, 1): Condition(delay_ns=20_000_000),
        (2, 3): Condition(delay_ns=10**9),
        (3, 2): Condition(delay_ns=10**9),
    }
    assert small(links, "network.links.*=delay 0ms").conditions == {}


def test_explicit_edges_point_the_way_the_payload_travels() -> None:
    s = small('graph={edges: {"1->2": 1.5, "1->3": 0.5}, reference: [1]}')
    assert s.graph.neighbours(2) == ((1, 1.5),)
    assert s.graph.neighbours(1) == ()
    assert s.b == (1, 0, 0)


def test_overrides_of_the_profile() -> None:
    s = small("profile=hardened", "guidance.k_max=0.5 1/s", "guidance.qp_period=20 ms", "tracking.tau_f=20 ms")
    assert s.controls[0].guidance.k_max == 0.5
    assert s.controls[0].guidance.qp_ticks == 2
    assert s.controls[0].tracking.tau_f == 0.02
    assert s.controls[0].guidance.k_min == profile("hardened")[0].k_min


def test_every_parameter_can_be_set() -> None:
    """A parameter that the controllers gain must gain a key here; two are written as times."""
    guidance = {field.name for field in fields(GuidanceParams)}
    law = {"law", "parameters"}
    assert set(GuidanceSection.model_fields) == guidance - {"qp_ticks", "horizon_s"} | {"qp_period", "horizon"} | law
    assert set(TrackingSection.model_fields) == {field.name for field in fields(TrackingParams)} | law


def test_the_qp_period_is_a_time() -> None:
    """A profile's period of five ticks of 10 ms stays 50 ms when the tick changes."""
    assert small("tick=5 ms").controls[0].guidance.qp_ticks == 10


def test_a_tick_longer_than_the_qp_period_of_the_profile_is_the_period() -> None:
    """Otherwise a longer tick would need two settings."""
    assert small("tick=100 ms", "network.period=100 ms").controls[0].guidance.qp_ticks == 1


def test_log_groups() -> None:
    every = small("log.every=5 ticks", "log.pose=1 tick").log_every
    assert tuple(every) == (*LOG_GROUPS, *DRAWN_GROUPS)
    assert every["pose"] == 1
    assert every["error"] == 5


def test_no_log() -> None:
    """One word, which prints as it was written; the rates are the defaults, by which the digest is made."""
    none = small("log=none")
    assert none.spec.log.none
    assert none.log_every == small("log={}").log_every
    assert "\nlog: none\n" in none.to_yaml()
    read_back(none)
    assert "none" not in small("log={}").to_yaml().split("\nlog:")[1].split("\nchecks:")[0]


@pytest.mark.parametrize("vehicles", [1, 2, 3, 4, 5, 9, 10, 100])
def test_grid_neighbours_are_adjacent(vehicles: int) -> None:
    cells = grid(vehicles, 10.0)
    assert len(set(cells)) == vehicles
    for a, b in pairwise(cells):
        assert sum(abs(x - y) for x, y in zip(a, b, strict=True)) == 10.0


def test_scatter_is_order_free() -> None:
    """More vehicles do not move the first ones relative to their places; another seed does."""
    few, many = small(), small("vehicles=10", "formation.spacing=5 m")

    def offsets_of(s: Scenario) -> list[tuple[float, ...]]:
        return [
            tuple(round(a - b, 9) for a, b in zip(e, p, strict=False))
            for (e, _), p in zip(s.initial, places(s), strict=True)
        ]

    assert offsets_of(few) == offsets_of(many)[:3]
    assert offsets_of(small("seed=2")) != offsets_of(few)
    assert all(abs(x) <= 1 and abs(y) <= 1 and 0 <= z <= 1 for x, y, z in offsets_of(many))


# --- the merged scenario ---------------------------------------------------


@pytest.mark.parametrize("overrides", [[], *slow(["vehicles=20", "seed=9", "duration=5 s"])])
def test_show_config_loads_to_an_equal_scenario(overrides: list[str]) -> None:
    for name in SHIPPED:
        read_back(load_scenario(name, overrides))


def test_show_config_golden() -> None:
    text = load_scenario("rough-sea", ["vehicles=20", "guidance.k_max=0.25 1/s"]).to_yaml()
    assert text == (EXPECTED / "show_config.yaml").read_text()


POSITIVE = st.floats(1e-3, 1e3)
ANY = st.floats(-1e3, 1e3)
CHOICES: dict[str, st.SearchStrategy[str]] = {
    "seed": st.integers(0, 2**63 - 1).map(str),
    "title": st.text(st.characters(categories=["L", "N", "P", "S", "Zs"]), min_size=1, max_size=40)
    .filter(lambda t: t.strip() and t.isprintable())
    .map(lambda t: '"' + t.replace("\\", "\\\\").replace('"', '\\"') + '"'),
    "reference.start": st.tuples(ANY, ANY, ANY).map(lambda v: f"{v[0]!r} {v[1]!r} {v[2]!r} m"),
    "formation.spacing": POSITIVE.map(lambda v: f"{v!r} m"),
    "initial.scatter": POSITIVE.map(lambda v: f"{v!r} cm"),
    "initial.surge": ANY.map(lambda v: f"{v!r} kn"),
    "graph.ahead": POSITIVE.map(repr),
    "graph.reference": st.lists(st.integers(1, 3), min_size=1, unique=True).map(str),
    "vehicle.yaw_moment": POSITIVE.map(lambda v: f"{v!r} Nm"),
    "sensors.angle_noise": POSITIVE.map(lambda v: f"{v!r} deg"),
    "sensors.rate_noise": POSITIVE.map(lambda v: f"{v!r} rad/s"),
    "navigation": st.sampled_from(["ideal", "dead-reckoning", "mems", "{}", "{gps: {}}"]),
    "navigation.start": POSITIVE.map(lambda v: f"{v!r} m"),
    "navigation.gyro_bias": st.floats(1e-3, 1e3).map(lambda v: f"{v!r} deg/h"),
    "navigation.lbl": st.tuples(ANY, ANY).map(lambda v: f"{{at: {v[0]!r} {v[1]!r} 0 m, loss: 5 %, delay: 1 s}}"),
    "per_vehicle.2.navigation": st.sampled_from(["ideal", "mems", "{gps: {noise: 3 m}}"]),
    "profile": st.sampled_from(sorted(PROFILES)),
    "guidance.Q": st.tuples(POSITIVE, POSITIVE, POSITIVE).map(lambda v: f"{v[0]!r} {v[1]!r} {v[2]!r}"),
    "guidance.slew": POSITIVE.map(lambda v: f"{v!r} m/s^2"),
    "tracking.tau_f": st.integers(0, 10**9).map(lambda v: f"{v} ns"),
    "network.period": st.integers(1, 100).map(lambda v: f"{v * 10} ms"),
    "network.links.1->2": st.floats(0, 100).map(lambda v: f"delay 3ms loss {v!r}%"),
    "network.links.*": st.integers(0, 10**12).map(lambda v: f"delay {v // 1000}us"),
    "network.links.2->1": st.tuples(st.integers(10, 10**6), st.integers(10, 10**6), st.booleans()).map(
        lambda v: (
            f"{{states: {{a: {{mean: {v[0]} ms}}, b: {{condition: loss 3%, mean: {v[1]} ms}}}}, together: {v[2]}}}"
        )
    ),
    "network.links.2->3": st.lists(st.integers(0, 10**9), min_size=1, max_size=4).map(
        lambda v: '{trace: "delay [us]\\n' + "".join(f"{us}\\n" for us in v) + '", by: packet}'
    ),
    "network": st.just("ideal"),
    "log.pose": st.integers(1, 100).map(lambda v: f"{v} ticks"),
}


@given(st.lists(st.sampled_from(sorted(CHOICES)).flatmap(lambda k: CHOICES[k].map(lambda v: f"{k}={v}")), max_size=8))
def test_every_valid_scenario_round_trips(overrides: list[str]) -> None:
    try:
        s = small(*overrides)
    except ScenarioError:  # `network=ideal` and then a period, for one
        return
    read_back(s)


def test_an_explicit_profile_can_still_be_changed() -> None:
    """The shown profile values are comments: as keys they would silence `--set profile`."""
    shown = load_scenario("paper").to_yaml()
    assert parse_scenario(shown, "p.yaml", ["profile=hardened"]).controls[0].guidance == profile("hardened")[0]


# --- overrides and scaling -------------------------------------------------


def test_overrides_apply_in_order() -> None:
    assert small("seed=3", "seed=4").seed == 4
    assert load_scenario("paper", ["initial.2.surge=0.3 m/s"]).initial[1][1][0] == 0.3
    assert small("sea.current=0.1 0 0 m/s").world_config.current == (0.1, 0, 0)


def test_mistakes_of_file_and_overrides_come_together() -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(SMALL.replace("1 s", "1 m"), "t.yaml", ["seed=x", "nope=1", "seed=y"])
    assert [p.file for p in caught.value.problems] == ["t.yaml", "--set nope=1", "--set seed=y"]


CHAINS = ["follow-the-leader", "leader-lost", "leader-lost-standby", "rough-sea"]


# Of other shapes than a grid of 10 m, or other graphs than a line.
SHAPES = (
    "survey", "helix", "acoustic-80bps", "acoustic-s2c", "acoustic-noise", "average", "average-naive", "election",
    "election-slow", "event-triggered", "event-triggered-loss", "auction", "auction-partition", "crossing",
    "mission-2012", "mission-2012-model", "navigation-aid", "navigation-aid-clock", "locate-naive",
    "locate-naive-loop", "locate-consistent", "locate-compass",
    "mirror-image", "mirror-image-turn", "formation-on-belief", "formation-no-fixes", "roll-call",
)  # fmt: skip


@pytest.mark.parametrize("vehicles", [1, 2, *slow(20)])
def test_all_that_ships_scales_by_itself(vehicles: int) -> None:
    """What is said of vehicles that are gone goes with them; a shape fits any number."""
    for name in SHIPPED:
        ring = name in SHAPES and vehicles < 3
        s = load_scenario(name, [f"vehicles={vehicles}", *(["graph={shape: path}"] if ring else [])])
        assert s.vehicles == len(s.plans) == len(s.controls) == vehicles, name
        assert all(1 <= i <= vehicles for link in s.graph.links for i in link), name
        if name not in SHAPES:
            assert len(s.initial) == len(s.world_config.vehicles) == vehicles, name
            assert places(s) == grid(vehicles, 10.0), name
            assert len(s.graph.links) == (1 if name in CHAINS else 2) * (vehicles - 1), name
            assert {nu0[0] for _, nu0 in s.initial} == {load_scenario(name).initial[0][1][0]}, name
            assert set(s.graph.weights.values()) <= {1.0, 0.8}, name


@pytest.mark.parametrize("name", CHAINS)
def test_a_chain_stays_a_chain(name: str) -> None:
    """Vehicle k hears vehicle k - 1 alone: nobody is heard by those ahead, also with more vehicles."""
    assert load_scenario(name).graph.links == ((1, 2), (2, 3), (3, 4))
    assert load_scenario(name, ["vehicles=6"]).graph.links == ((1, 2), (2, 3), (3, 4), (4, 5), (5, 6))
    assert load_scenario(name, ["vehicles=2"]).graph.links == ((1, 2),)


def test_a_scaled_chain_keeps_its_weights_and_link_conditions() -> None:
    text = load_scenario("paper").to_yaml()
    text = text.replace("period: 100 ms", 'period: 100 ms\n  links: {"*": loss 1%, 4->3: loss 3%, 2->1: loss 2%}')
    shape = "  shape: path\n  ahead: 1\n  behind: 0.8\n"
    backwards = text.replace(shape, '  edges: {"2->1": 1, "3->2": 0.5, "4->3": 0.7}\n')
    s = parse_scenario(backwards, "t.yaml", ["vehicles=6"])
    assert s.graph.weights == {(2, 1): 1.0, (3, 2): 0.5, (4, 3): 0.7, (5, 4): 0.7, (6, 5): 0.7}
    assert (s.conditions[2, 1].loss, s.conditions[4, 3].loss, s.conditions[6, 5].loss) == (0.02, 0.03, 0.01)
    s = parse_scenario(backwards, "t.yaml", ["vehicles=2"])
    assert (s.graph.weights, s.conditions) == ({(2, 1): 1.0}, {(2, 1): Condition(loss=0.02)})
    assert parse_scenario(backwards, "t.yaml", ["vehicles=1"]).graph.links == ()


def test_scaling_to_the_same_number_changes_nothing() -> None:
    assert load_scenario("paper", ["vehicles=4"]) == load_scenario("paper")


def test_what_is_also_set_wins_over_scaling() -> None:
    """Whatever the order on the command line: the overrides are of the scaled scenario."""
    ring = load_scenario("paper", ["initial.scatter=0 m", "graph.shape=ring", "vehicles=20"])
    assert [eta0[:3] for eta0, _ in ring.initial] == list(places(ring))
    assert len(ring.graph.links) == 40
    s = load_scenario("paper", ["vehicles=2", "formation={offsets: [0 0 0 m, 3 0 0 m]}", "graph={shape: path}"])
    assert places(s) == ((0, 0, 0), (3, 0, 0))
    assert set(s.graph.weights.values()) == {1.0}


def test_scaling_drops_what_no_longer_fits() -> None:
    text = load_scenario("paper").to_yaml().replace("reference: all", "reference: [1, 4]")
    text = text.replace("period: 100 ms", 'period: 100 ms\n  links: {"*": loss 1%, 3->4: down, 1->2: loss 2%}')
    s = parse_scenario(text, "t.yaml", ["vehicles=3"])
    assert s.b == (1, 0, 0)
    assert s.conditions[1, 2].loss == 0.02
    s = parse_scenario(text, "t.yaml", ["vehicles=2", "network.links.2->1=loss 3%"])
    assert s.conditions == {(2, 1): Condition(loss=0.03), (1, 2): Condition(loss=0.02)}
    explicit = text.replace(
        "  shape: path\n  ahead: 1\n  behind: 0.8\n", '  edges: {"4->3": 1, "3->4": 1, "1->2": 1}\n'
    )
    s = parse_scenario(explicit, "t.yaml", ["vehicles=5"])
    assert len(s.graph.links) == 8
    assert s.conditions == dict.fromkeys(s.graph.links, Condition(loss=0.01))


def test_a_hundred_vehicles_load_fast() -> None:
    start = time.process_time()
    s = load_scenario("rough-sea", ["vehicles=100"])
    for i in range(1, 101):
        s.agent_config(i)
    assert time.process_time() - start < 1.0  # whatever else the machine does


# --- mistakes --------------------------------------------------------------


def test_ten_mistakes_in_one_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXPECTED)
    with pytest.raises(ScenarioError) as caught:
        load_scenario("ten_mistakes.yaml")
    assert str(caught.value) + "\n" == (EXPECTED / "ten_mistakes.txt").read_text()
    places = [(p.line, p.column) for p in caught.value.problems]
    assert places == sorted(places)
    assert len(places) >= 10
    assert isinstance(caught.value, FleetError)


def test_the_hints_for_missing_keys_make_a_scenario() -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario("name: mine\n", "mine.yaml")
    hints = [problem.hint.removeprefix("for example ") for problem in caught.value.problems]
    assert len(hints) == len(EXAMPLES)
    assert parse_scenario("\n".join(["name: mine", *hints]), "mine.yaml").vehicles == 4


def test_an_empty_section_is_its_defaults() -> None:
    assert parse_scenario(SMALL + "sea:\nguidance:\n", "small.yaml") == small()


def test_unknown_names_and_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match='did you mean "rough-sea"'):
        load_scenario("rough_sea")
    for path in (tmp_path, tmp_path / "none.yaml", "", "a\0b", "x" * 5000):
        with pytest.raises(ScenarioError):
            load_scenario(path)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"title: \xff")
    with pytest.raises(ScenarioError, match="not UTF-8"):
        load_scenario(binary)


def test_a_file_names_its_scenario(tmp_path: Path) -> None:
    path = tmp_path / "My Sea (2).yaml"
    path.write_bytes(b"\xef\xbb\xbf" + SMALL.replace("\n", "\r\n").encode())
    assert load_scenario(path).name == "my-sea-2"


# --- YAML ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001), ("on", "on"), ("yes", "yes"), ("12:30", "12:30"), ("010", 10), ("1_000", "1_000"),
        ("true", True), ("null", None), ("~", None), ("", None), ("0x10", "0x10"), ("-.5", -0.5), ("1.", 1.0),
        ("2026-01-01", "2026-01-01"), ("=", "="), ("<<", "<<"),
    ],
)  # fmt: skip
def test_scalars_follow_yaml_1_2(text: str, value: Any) -> None:
    assert resolve(text) == value
    assert type(resolve(text)) is type(value)


def test_anchors_work() -> None:
    root, found = read(Source("t", "a: &x {b: [1, 2]}\nc: *x\n"))
    assert plain(root) == {"a": {"b": [1, 2]}, "c": {"b": [1, 2]}}
    assert not found


def test_hostile_yaml_is_refused_at_once() -> None:
    """What is read is bounded in depth and size before it is understood: ten lines may stand for 10^10 values."""
    aliases = ["a0: &a0 [1, 1]"] + [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 40)]
    cases = [
        *("", "# only a comment\n", "- 1\n", "a: 1\n---\nb: 2\n", "a: !!python/object x\n", "? [1]\n: 2\n"),
        *("a: &x [*x]\n", "a: *x\n", "*->2: down\n", "a:\n\tb: 1\n", "a: \x00\n", "a: \ud800\n", "\n".join(aliases)),
        *("[" * 100_000, "{a: " * 100_000, "- " * 100_000, "? " * 50_000, "a: " + "{a: " * 50),
        *("a" * 1_000_001, "&" + "a" * 1_000_000, "x: " + "9" * 1_000_000, "[" + "1," * 30_000 + "]"),
        *("vehicles: 999999999999999999", "duration: " + "9" * 300 + " s", "vehicles: 100000\nduration: 1000000 s"),
    ]
    start = time.process_time()
    check_refusals("scenario/hostile YAML", lambda text: parse_scenario(text, "t.yaml"), cases)
    assert time.process_time() - start < 10.0


def test_marks_count_characters() -> None:
    root, _ = read(Source("t", "é: 'ü 5 s'\n"))
    assert (root.entries["é"].place.column, root.entries["é"].text.column) == (4, 5)


@given(st.text())
def test_any_text_is_a_scenario_error(text: str) -> None:
    with pytest.raises(ScenarioError):
        parse_scenario(text, "t.yaml")


def _key_paths(section: type[Section] = ScenarioSpec) -> list[str]:
    paths = []
    for key, info in section.model_fields.items():
        paths.append(key)
        if isinstance(info.annotation, type) and issubclass(info.annotation, Section):
            paths += [f"{key}.{below}" for below in _key_paths(info.annotation)]
    return paths


LINK_KEYS = [f"network.links.*.{key}" for key in LinkSection.model_fields]
LINK_KEYS += [f"network.links.*.states.bad.{key}" for key in (*LinkStateSection.model_fields, "loss", "next.good")]
WILD_OVERRIDES = st.lists(
    st.tuples(st.sampled_from([*_key_paths(), *LINK_KEYS]), WILD).map(lambda pair: f"{pair[0]}={pair[1]}"), max_size=6
)


@given(WILD_OVERRIDES)
@example(["nodes={0}"])
def test_any_override_is_accepted_or_a_scenario_error(overrides: list[str]) -> None:
    """Wrong values of every type at every key: the validator itself never raises anything else."""
    accepted(*overrides)


@pytest.mark.parametrize(
    ("text", "b"), [("2", (0, 1, 0)), ("1-2", (1, 1, 0)), ('"1, 3"', (1, 0, 1)), ("[3]", (0, 0, 1))]
)
def test_who_follows_the_reference(text: str, b: tuple[int, ...]) -> None:
    """Vehicles are named as everywhere else, or in a list; what is printed is read back to the same."""
    s = small(f"graph.reference={text}")
    assert tuple(s.b) == b
    read_back(s)
    written = SMALL.replace("shape: path", f"shape: path, reference: {text}, ahead: 1")
    if b[:2] != (0, 0):
        assert tuple(parse_scenario(written, "t.yaml", ["vehicles=2"]).b) == b[:2]


def test_an_unknown_controller_is_one_mistake() -> None:
    """Whether the keys of guidance have an effect on it is not known."""
    with pytest.raises(ScenarioError) as caught:
        load_scenario("rough-sea", ["controller=nosuch"])
    assert [problem.key for problem in caught.value.problems] == ["controller.law"]


@pytest.mark.parametrize("name", [*SHIPPED[::4], "small"])
def test_the_short_text_is_the_same_scenario_without_what_is_so_anyway(name: str) -> None:
    """A scenario of 25 lines, shrunk, had 112."""
    scenario = small("duration=2 s", "network.links={'*': loss 9%}") if name == "small" else load_scenario(name)
    text = short_text(scenario)
    assert parse_scenario(text, "short.yaml").to_yaml() == scenario.to_yaml()
    assert len(text.splitlines()) < 0.65 * len(scenario.to_yaml().splitlines())
    if name == "small":
        assert len(text.splitlines()) < 30


@pytest.mark.parametrize("controller", ["bc", "bsmc", "boc"])
def test_keys_of_a_law_that_is_replaced_on_the_command_line_go_with_it(controller: str) -> None:
    """rough-sea has bounds of guidance that not every controller reads: each can be tried. Typed ones are mistakes."""
    changed = load_scenario("rough-sea", [f"controller={controller}"])
    assert f"controller: {controller}" in read_back(changed).to_yaml()
    if controller == "bc":
        with pytest.raises(ScenarioError, match=r"guidance\.rho_lo: has no effect on guidance law fixed"):
            load_scenario("rough-sea", ["controller=bc", "guidance.rho_lo=-1 -1 -1 m/s"])
