"""The filter that keeps vehicles apart: its constraints hold, so does the distance, and it does no more than that."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from importlib import import_module

import piqp
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from piqp import instruction_set
from small_scenario import SMALL, small

from agents.api import Sample
from agents.codecs import FullCodec
from agents.config import AgentConfig, Cylinder, KeepApartParams
from agents.controllers import layout
from agents.laws.keep_apart import SLACK, Bound, KeepApart, Seen, bounds, filter_velocity, margin
from agents.neighbours import NeighbourTable
from agents.payload import StateMessage, encode
from agents.trajectory import Motion
from fleet.analysis.preflight import warnings
from fleet.errors import ScenarioError
from fleet.scenario.loading import parse_scenario
from netem.wire.messages import Delivery
from world.vectors import ZERO, Vec3, dot, minus, move_along, plus, scale

PARAMS = KeepApartParams(
    distance=3.0, obstacles=(), gain=0.3, lag_s=1.0, slew=0.3, acceleration=0.5, speed=1.5, climb=0.1, age_cap_s=2.0
)
NOWHERE = Bound((1.0, 0.0, 0.0), -10.0, ZERO)  # no least velocity ahead

number = st.floats(-1.0, 1.0)
vector = st.tuples(number, number, number)
speed = st.floats(0.2, 1.2)
angle = st.floats(-math.pi, math.pi)


def unit(v: Vec3) -> Vec3:
    length = math.sqrt(dot(v, v))
    assume(length > 0.1)
    return scale(v, 1.0 / length)


def course(speed: float, angle: float) -> Vec3:
    return (speed * math.cos(angle), speed * math.sin(angle), 0.0)


@given(st.lists(st.tuples(vector, st.floats(0.01, 1.0)), min_size=1, max_size=8), vector, vector)
def test_every_constraint_holds_where_all_can(rows: list[tuple[Vec3, float]], possible: Vec3, rho: Vec3) -> None:
    """`possible` keeps all constraints and the limits, each with a little room."""
    x, y, z = possible
    possible = (x, y, 0.1 * z)
    found = [Bound(unit(n), dot(unit(n), possible) - room, ZERO) for n, room in rows]
    ahead = Bound((1.0, 0.0, 0.0), x - 0.01, ZERO)
    answer, active, slack = filter_velocity(rho, found, ahead, PARAMS)
    assert slack == 0.0
    assert all(dot(n, answer) >= least - SLACK for n, least, _ in found)
    if all(dot(n, rho) >= least for n, least, _ in found):
        assert answer == rho
        assert active == 0
    else:
        assert active >= 1
        assert abs(answer[2]) <= max(PARAMS.climb, abs(rho[2])) + SLACK
        assert answer[0] >= min(x - 0.01, rho[0]) - SLACK
        assert max(map(abs, answer)) <= PARAMS.speed + SLACK


@given(vector, vector)
def test_two_constraints_that_exclude_each_other_are_missed_alike_and_told(n: Vec3, rho: Vec3) -> None:
    n = unit(n)
    found = [Bound(n, 0.5, ZERO), Bound(scale(n, -1.0), 0.5, ZERO)]
    answer, active, slack = filter_velocity(rho, found, NOWHERE, PARAMS)
    assert abs(slack - 0.5) < 1e-4
    assert active == 2
    assert abs(dot(n, answer)) < 1e-4


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0), st.floats(0.0, 2.0))
def test_the_margin_grows_with_age_up_to_the_cap(a: float, b: float, speed: float) -> None:
    assert margin(0.0, speed, PARAMS) == 0.0
    assert (margin(a, speed, PARAMS) < margin(b, speed, PARAMS)) == (min(a, 2.0) < min(b, 2.0)) or abs(a - b) < 1e-6
    assert margin(2.0, speed, PARAMS) == margin(60.0, speed, PARAMS)


@given(speed, angle, st.lists(angle, min_size=1, max_size=20))
def test_the_margin_covers_what_a_neighbour_can_have_done(start: float, heading: float, pushes: list[float]) -> None:
    """Pushed with the greatest acceleration in any directions it is no farther away, and no faster, than told."""
    dt, v0 = 0.1, course(start, heading)
    p, v = ZERO, v0
    for push in pushes:
        pushed = plus(v, course(PARAMS.acceleration * dt, push))
        assume(math.hypot(*pushed) <= PARAMS.speed)
        p, v = move_along(p, scale(plus(v, pushed), 0.5), dt), pushed
    age = dt * len(pushes)
    away, faster = math.hypot(*minus(p, scale(v0, age))), math.hypot(*minus(v, v0))
    assert away + (1.0 / PARAMS.gain + PARAMS.lag_s) * faster <= margin(age, start, PARAMS) + 1e-9


@settings(max_examples=10)
@given(speed, speed, angle, angle, angle, st.floats(0.1, 1.0), st.floats(0.1, 1.0))
def test_two_vehicles_that_lag_keep_the_distance(
    s1: float, s2: float, a1: float, a2: float, where: float, lag1: float, lag2: float
) -> None:
    """Guidances that go on regardless; velocities that follow with any lag up to the longest; what is known is new."""
    wanted = (course(s1, a1), course(s2, a2))
    p, v, dt = [ZERO, course(12.0, where)], [ZERO, ZERO], 0.05
    least = math.inf
    for _ in range(400):
        commands = []
        for i, j in ((0, 1), (1, 0)):
            found = bounds(p[i], v[i], [Seen(j + 1, p[j], v[j], 0.0)], PARAMS)
            commands.append(filter_velocity(wanted[i], found, NOWHERE, PARAMS).rho)
        for i, lag in ((0, lag1), (1, lag2)):
            v[i] = move_along(v[i], minus(commands[i], v[i]), dt / lag)
            p[i] = move_along(p[i], v[i], dt)
        least = min(least, math.dist(*p))
    assert least > PARAMS.distance - 0.05  # of a step


@settings(max_examples=10)
@given(speed, angle, st.floats(0.1, 1.0))
def test_a_vehicle_that_lags_stays_out_of_a_cylinder(speed: float, start: float, lag: float) -> None:
    params = replace(PARAMS, obstacles=(Cylinder(1.0, 2.0, 4.0),))
    p = plus((1.0, 2.0, 7.0), course(10.0, start))
    wanted, v, dt = course(speed, start + math.pi), ZERO, 0.05  # straight at its axis
    for _ in range(400):
        rho = filter_velocity(wanted, bounds(p, v, [], params), NOWHERE, params).rho
        v = move_along(v, minus(rho, v), dt / lag)
        p = move_along(p, v, dt)
        assert math.dist(p[:2], (1.0, 2.0)) > 4.0 - 0.02


def test_head_on_both_turn_to_starboard_and_pass() -> None:
    p: list[Vec3] = [(0.0, 0.0, 5.0), (20.0, 0.0, 5.0)]
    wanted: list[Vec3] = [(0.7, 0.0, 0.0), (-0.7, 0.0, 0.0)]
    v, dt = list(wanted), 0.05
    slowest = math.inf
    for _ in range(1200):
        commands = []
        for i, j in ((0, 1), (1, 0)):
            found = bounds(p[i], v[i], [Seen(j + 1, p[j], v[j], 0.0)], PARAMS)
            commands.append(filter_velocity(wanted[i], found, NOWHERE, PARAMS).rho)
            slowest = min(slowest, math.hypot(*commands[i]))
        for i in (0, 1):
            v[i] = move_along(v[i], minus(commands[i], v[i]), dt)
            p[i] = move_along(p[i], v[i], dt)
    assert p[0][0] > 20.0 > 0.0 > p[1][0]
    assert p[0][1] > 0.5 > -0.5 > p[1][1]
    assert slowest > 0.3


def test_a_vehicle_in_the_same_place_has_a_direction_and_a_silent_one_waits() -> None:
    (same,) = bounds(ZERO, ZERO, [Seen(2, ZERO, ZERO, 0.0)], PARAMS)
    assert same.n == (1.0, 0.0, 0.0)
    (silent,) = bounds((10.0, 0.0, 0.0), ZERO, [Seen(2, ZERO, (1.0, 0.0, 0.0), 60.0)], PARAMS)
    assert silent.moves == ZERO


def test_who_lies_commands_no_more_than_the_limits() -> None:
    """With velocities as these PIQP has no solution."""
    told = [
        Seen(2, (0.04187392196785255, -0.11650458459085053, 0.08785437130200653),
             (-0.7487883734950451, 667610588.9104146, -571125895.1464382), 3.0),
        Seen(3, (23.708085515209522, -1.1885579682217953, -11.583630656001633),
             (-239638786.07243124, -0.002545501091738789, 0.038841624405204334), 0.1),
        Seen(4, (-0.7005369965286111, -0.6350931936699283, 0.11379344867769291),
             (0.500625621243773, 0.4956729001881177, -0.5280680162544973), 3.0),
    ]  # fmt: skip
    own = (-0.8198351009023108, 0.6446614719310506, 0.019146732905085395)
    rho = (1.0581352924977927, 0.2818074237756427, 0.33212083406733894)
    ahead = Bound((math.cos(2.7652084546664186), math.sin(2.7652084546664186), 0.0), 0.05, ZERO)
    north, east, down = filter_velocity(rho, bounds(ZERO, own, told, PARAMS), ahead, PARAMS).rho
    assert max(abs(north), abs(east)) <= PARAMS.speed and abs(down) <= abs(rho[2])


def test_the_table_gives_states_as_they_were_sampled_and_leaves_out_whom_it_drops() -> None:
    scenario = small("neighbours={extrapolate: neighbour, drop_after: 1 s}")
    table = NeighbourTable(scenario.agent_config(2), FullCodec())
    state = StateMessage(3, 5, (1.0, 2.0, 3.0), (0.5, 0.0, 0.0))
    table.absorb([Delivery(30, 5, 3, 0, 0, encode(state))], 30)
    table.states_at(30)
    assert table.sampled_states() == [Seen(3, (1.0, 2.0, 3.0), (0.5, 0.0, 0.0), 0.25)]
    last = 5 + 100  # one second later
    assert [heard.id for heard in table.states_at(last)] == [seen.id for seen in table.sampled_states()] == [3]
    assert table.states_at(last + 1) == ()
    assert table.sampled_states() == []


def test_warnings_tell_what_cannot_be_kept_apart() -> None:
    told = warnings(
        small("initial={scatter: 0 m}", "keep_apart={distance: 6 m, obstacles: [{at: 0 0 m, radius: 1 m}]}")
    )
    for words in (
        "vehicles 1 and 3 do not both hear each other",
        "at the start vehicles 1 and 2 are 5 m apart, but keep_apart.distance is 6 m",
        "at the start vehicle 1 is within obstacle 1",
        "in the formation at the end vehicles 1 and 2 are 5 m apart",
    ):
        assert any(words in line for line in told), (words, told)
    assert not any("keep_apart" in line for line in warnings(small()))


def test_a_course_that_climbs_faster_than_the_limit_is_told() -> None:
    course = "reference={start: 0 0 50 m, velocity: 0.6 0 0.3 m/s}"
    (told,) = [line for line in warnings(small(course, "keep_apart={distance: 1 m}")) if "climbs" in line]
    assert "with up to 0.3 m/s, but keep_apart.climb limits every command to 0.1 m/s" in told
    assert not any("climbs" in line for line in warnings(small(course, "keep_apart={distance: 1 m, climb: 0.3 m/s}")))


def test_a_law_in_place_of_guidance_and_tracking_leaves_no_place_for_it() -> None:
    text = SMALL + "keep_apart: {distance: 3 m}\n"
    with pytest.raises(ScenarioError, match="every vehicle has a law in place of both"):
        parse_scenario(text, "small.yaml", ["controller=elsewhere:Law"])
    within = parse_scenario(text + "agent: elsewhere:Agent\n", "small.yaml")
    (told,) = [line for line in warnings(within) if "a FormationAgent" in line]
    assert "if the agent of vehicles 1, 2, 3 has none" in told
    some = parse_scenario(text + "per_vehicle: {'3': {controller: elsewhere:Law}}\n", "small.yaml")
    assert any("vehicle 3 with a law in place of both does not keep apart" in line for line in warnings(some))


def test_the_filter_changes_the_command_slowly() -> None:
    sample = Sample(0, 0.0, 0.01, (0.0,) * 5, (0.7, 0.0, 0.0, 0.0, 0.0), (0.7, 0.0, 0.0), Motion(ZERO, ZERO), (), ZERO,
                    0.0, "")  # fmt: skip
    near, rho = [Seen(2, (4.0, 0.0, 0.0), ZERO, 0.0)], (0.7, 0.0, 0.0)
    first = KeepApart(PARAMS, 0.3)
    assert first.step(rho, sample, []) == (rho, (0.0,) * 6)
    answer, (active, *_) = first.step(rho, sample, near)
    assert active == 1.0
    assert max(map(abs, minus(answer, rho))) == pytest.approx(PARAMS.slew * sample.dt)
    first.step(rho, sample, near)
    crowd = [*near, Seen(3, (-1.0, 0.0, 0.0), ZERO, 0.0)]
    _, (active, slack, infeasible, *_) = first.step(rho, sample, crowd)
    assert active == 2.0
    assert slack > 0.0
    assert infeasible == 1.0
    for _ in range(1000):
        last, _ = first.step(rho, sample, [])
    assert last == rho


@given(st.lists(st.tuples(vector, vector, vector), min_size=1, max_size=20))
def test_no_command_climbs_or_dives_faster_than_it_may(samples: list[tuple[Vec3, Vec3, Vec3]]) -> None:
    """Whatever the guidance commands, wherever a neighbour is, and whatever was commanded before."""
    law = KeepApart(PARAMS, 0.3)
    for rho, place, velocity in samples:
        sample = Sample(0, 0.0, 0.5, (0.0,) * 5, (0.7, 0.0, 0.0, 0.0, 0.0), (0.7, 0.0, 0.0), Motion(ZERO, ZERO), (),
                        ZERO, 0.0, "")  # fmt: skip
        answer, (*_, north, east, down) = law.step(rho, sample, [Seen(2, scale(place, 6.0), velocity, 0.3)])
        assert abs(answer[2]) <= PARAMS.climb + SLACK
        assert answer == pytest.approx(plus(rho, (north, east, down)))


def test_a_command_that_dives_too_fast_loses_that_alone() -> None:
    sample = Sample(0, 0.0, 0.01, (0.0,) * 5, (0.7, 0.0, 0.0, 0.0, 0.0), (0.7, 0.0, 0.0), Motion(ZERO, ZERO), (), ZERO,
                    0.0, "")  # fmt: skip
    for _ in range(2):
        answer, (active, slack, infeasible, *change) = KeepApart(PARAMS, 0.3).step((0.5, -0.2, 0.4), sample, [])
        assert answer == (0.5, -0.2, PARAMS.climb)
        assert (active, slack, infeasible) == (0.0, 0.0, 0.0)
        assert change == pytest.approx([0.0, 0.0, PARAMS.climb - 0.4])


def test_a_run_without_the_section_reports_nothing_of_it() -> None:
    assert layout(small().agent_config(1)).where("keep_apart_slack") is None
    where = layout(small("keep_apart={distance: 1 m}").agent_config(1)).where("keep_apart_slack")
    assert where is not None


def test_the_section_reads_back() -> None:
    scenario = small("keep_apart={distance: 1 m, obstacles: [{at: 50 -2.5 m, radius: 20 cm}], lag: 1500 ms}")
    assert parse_scenario(scenario.to_yaml(), "again.yaml") == scenario
    config = scenario.agent_config(1)
    assert AgentConfig.from_values(config.to_values()) == config


def test_builds_of_the_solver_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """PIQP only says which constraints are active, so its last bits do not matter."""
    draw = random.Random(3)

    def answer() -> list[Vec3]:
        found = []
        for _ in range(draw.randint(1, 8)):
            n = (draw.gauss(0.0, 1.0), draw.gauss(0.0, 1.0), draw.gauss(0.0, 1.0))
            found.append(Bound(scale(n, 1.0 / math.hypot(*n)), draw.uniform(-1.0, 0.5), ZERO))
        found += found[: draw.randint(0, 1)]  # a constraint twice
        rho = (draw.uniform(-1.0, 1.0), draw.uniform(-1.0, 1.0), draw.uniform(-1.0, 1.0))
        ahead = Bound((1.0, 0.0, 0.0), draw.uniform(-1.0, 0.3), ZERO)
        answers = []
        for build in ("piqp_python", "piqp_python_avx2"):
            module = import_module(f"piqp.{build}")
            monkeypatch.setattr(piqp, "DenseSolver", module.DenseSolver)
            monkeypatch.setattr(piqp, "PIQP_SOLVED", module.PIQP_SOLVED)
            answers.append(filter_velocity(rho, found, ahead, PARAMS).rho)
        return answers

    if not instruction_set.avx2:
        pytest.skip("this processor runs one build only")
    assert all(one == other for one, other in (answer() for _ in range(3000)))
