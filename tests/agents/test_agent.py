"""The agent's parts and the agent: laws, guards, and histories of what the network may do to it."""

from __future__ import annotations

import json
import math
import random
import struct
import zlib
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import PARAMS, WEIGHTS, Delivery, Link, Nav, agent_config, run_loop, world_config
from repository import GOLDEN

from agents.agent import Agent
from agents.api import NeighbourState, Sample, VelocityCommand
from agents.codecs import FullCodec
from agents.config import Neighbour
from agents.controllers import CONTROLLERS
from agents.errors import AgentError, ControllerError, PayloadError
from agents.laws.angles import RateFilter, wrap
from agents.laws.backstepping import NeurodynamicTracking, shunting_step
from agents.laws.kinematics import earth_velocity, flow_angles
from agents.laws.velocity_command import clip, consensus_error, direction_command, floor_speed, slew
from agents.neighbours import NeighbourTable
from agents.offset import Offset
from agents.payload import SIZE, StateMessage, decode, encode
from agents.profiles import PROFILES, profile
from agents.trajectory import Motion
from world.disturbance import NO_FORCE, PAPER
from world.dynamics import coefficients, derivative
from world.sea import World

VECTORS = json.loads((GOLDEN / "unit_vectors.json").read_text())

angle = st.floats(-50.0, 50.0)
number = st.floats(-5.0, 5.0)
vec3 = st.tuples(number, number, number)


# ------------------------------------------------------------------------------------- angles, filters


@given(angle)
def test_wrap_keeps_the_direction_and_the_interval(a: float) -> None:
    wrapped = wrap(a)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(a), abs=1e-12)
    assert math.sin(wrapped) == pytest.approx(math.sin(a), abs=1e-12)
    assert wrap(wrapped) == wrapped


def test_wrap_at_its_ends() -> None:
    assert wrap(math.pi) == math.pi
    assert wrap(-math.pi) == math.pi
    assert wrap(3 * math.pi) == pytest.approx(math.pi)
    assert wrap(math.nextafter(math.pi, 4.0)) == pytest.approx(-math.pi)


def test_filter_agrees_with_an_independent_implementation() -> None:
    case = VECTORS["diff_angle"]
    rate = RateFilter(case["tau_f"], angle=True)
    assert [rate.step(s, case["Ts"]) for s in case["s"]] == pytest.approx(case["d"], abs=1e-9)


def test_filter_settles_on_a_steady_turn_through_the_cut() -> None:
    """A heading that turns steadily, wrapped or not, has its rate."""
    rate = RateFilter(0.05, angle=True)
    for n in range(200):
        d = rate.step(wrap(2.0 + 0.03 * n), 0.01)
    assert d == pytest.approx(3.0, abs=1e-9)


def test_filter_knows_how_long_it_was_not_asked() -> None:
    """Missed samples: the difference is over the time that passed, not over one period."""
    rate = RateFilter(0.05, angle=True)
    for t in (0.0, 0.01, 0.02, 0.5, 0.51, 0.9):
        d = rate.step(0.3 * t, 0.01 if t < 0.4 else {0.5: 0.48, 0.51: 0.01, 0.9: 0.39}[t])
    assert d == pytest.approx(0.3, abs=1e-3)


# -------------------------------------------------------------------------------------------- shunting


def test_shunting_agrees_with_an_independent_implementation() -> None:
    for case in VECTORS["shunt"]:
        x = shunting_step(case["x"], case["s"], case["a"], case["b"], case["bp"], case["Ts"])
        assert x == pytest.approx(case["x_next"], abs=1e-12)


@given(st.floats(-20.0, 30.0), st.floats(-1e3, 1e3), st.floats(0.0, 10.0))
def test_shunting_is_bounded(x: float, s: float, dt: float) -> None:
    assert -20.0 - 1e-9 <= shunting_step(x, s, 10.0, 30.0, 20.0, dt) <= 30.0 + 1e-9


@given(st.floats(-20.0, 30.0), number, st.floats(0.001, 1.0))
def test_shunting_is_the_exact_solution(x: float, s: float, dt: float) -> None:
    """Two half steps with s held are one whole step, and the slope at 0 is the printed equation's."""

    def step(x: float, dt: float) -> float:
        return shunting_step(x, s, 10.0, 30.0, 20.0, dt)

    assert step(step(x, dt / 2), dt / 2) == pytest.approx(step(x, dt), abs=1e-9)
    slope = -10.0 * x + (30.0 - x) * max(s, 0.0) - (20.0 + x) * max(-s, 0.0)
    assert (step(x, 1e-7) - x) / 1e-7 == pytest.approx(slope, abs=0.02 + 1e-4 * abs(slope))


# ------------------------------------------------------------------------------- kinematics, commands


def test_command_agrees_with_an_independent_implementation() -> None:
    for case in VECTORS["command"]:
        command = direction_command(tuple(case["rho"]), 0.0, 0.0, 0.05)
        assert command == pytest.approx((case["u_cmd"], case["theta_cmd"], case["psi_cmd"]), abs=1e-12)


@given(vec3)
def test_a_vehicle_that_follows_the_command_moves_with_rho(rho: tuple[float, float, float]) -> None:
    """The command transform is the inverse of the kinematics of a body moving along its axis."""
    u_cmd, theta, psi = direction_command(rho, 0.3, -0.4, 1e-9)
    velocity = earth_velocity((0.0, 0.0, 0.0, theta, psi), (u_cmd, 0.0, 0.0, 0.0, 0.0))
    assert velocity == pytest.approx(rho, abs=1e-8)


@given(vec3, st.floats(-1.5, 1.5), angle)
def test_the_agents_kinematics_are_the_worlds(nu: Any, theta: float, psi: float) -> None:
    k = coefficients(PARAMS)
    if abs(math.cos(theta)) < 1e-2:
        return
    rate = derivative(k, (0.0, 0.0, 0.0, theta, psi, *nu, 0.0, 0.0), (0.0, 0.0, 0.0), NO_FORCE)
    velocity = earth_velocity((0.0, 0.0, 0.0, theta, psi), (*nu, 0.0, 0.0))
    assert velocity == pytest.approx(rate[:3], abs=1e-12)


@given(vec3)
def test_flow_angles_rebuild_the_velocity(nu: tuple[float, float, float]) -> None:
    u_a, attack, sideslip = flow_angles(*nu)
    u = u_a * math.cos(attack) * math.cos(sideslip)
    v = u_a * math.cos(attack) * math.sin(sideslip)
    assert (u, v, -u_a * math.sin(attack)) == pytest.approx(nu, abs=1e-9)


def test_a_velocity_near_zero_has_no_direction() -> None:
    assert direction_command((0.01, 0.01, 0.01), 0.3, -0.4, 0.05)[1:] == (0.3, -0.4)
    # Straight down: a pitch, but no course.
    speed, theta, psi = direction_command((0.0, 0.0, 1.0), 0.3, -0.4, 0.05)
    assert (speed, theta, psi) == (1.0, -math.pi / 2, -0.4)


@given(vec3, vec3, st.floats(0.0, 1.0))
def test_slew_and_clip(rho: Any, previous: Any, step: float) -> None:
    moved = slew(rho, previous, step)
    for to, at, wanted in zip(moved, previous, rho, strict=True):
        assert abs(to - at) <= step + 1e-12
        assert to == pytest.approx(min(max(wanted, at - step), at + step), abs=1e-12)
    assert clip((-2.0, 0.5, 9.0), (-1.0, 0.0, 0.0), (1.0, 1.0, 1.0)) == (-1.0, 0.5, 1.0)


def test_the_commanded_speed_leaves_room_for_the_sideways_motion() -> None:
    assert floor_speed(2.0, 0.3, 0.4, 0.3) == 2.0
    assert floor_speed(0.1, 0.3, 0.4, 0.0) == pytest.approx(0.5)


# ------------------------------------------------------------------------------------------- consensus


@given(vec3, vec3, st.lists(st.tuples(st.floats(0.1, 2.0), vec3), max_size=4))
def test_a_formation_in_place_has_no_error(position: Any, offset: Any, neighbours: Any) -> None:
    heard = [
        NeighbourState(n, a, d, tuple(p - x for p, x in zip(position, d, strict=True)), (0.0, 0.0, 0.0), 0.0)
        for n, (a, d) in enumerate(neighbours)
    ]
    e, c = consensus_error(position, position, 1.0, heard)
    assert e == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert c == pytest.approx(1.0 + sum(a for a, _ in neighbours))
    # Moving the vehicle alone changes e by c times the displacement, which is how the QP predicts.
    moved = tuple(p + x for p, x in zip(position, offset, strict=True))
    e, c = consensus_error(moved, position, 1.0, heard)
    assert e == pytest.approx(tuple(c * x for x in offset), abs=1e-9)


def test_a_neighbour_not_heard_counts_in_neither_sum() -> None:
    agent = Agent(agent_config(2))
    nav = Nav(0, (-1.0, -10.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0, 0.0, 0.0))
    telemetry = named(agent.decide(nav, []).telemetry)
    # Only b_i (eta_i - eta_i^d), with eta_2^d(0) = (5, -9, 5).
    assert telemetry["e_used"] == pytest.approx((-6.0, -1.0, -5.0))
    assert telemetry["neighbours_heard"] == (0.0,)
    one = agent.decide(nav._replace(tick=1), [delivery(1, 0, (0.0, 0.0, 0.0), due=1)])
    assert named(one.telemetry)["neighbours_heard"] == (1.0,)
    # a_21 = 1, Delta_21 = (0, -10, 0): pos_2 - pos_1 - Delta_21 = (-1, 0, 0); the reference moved 7 mm, 1 mm.
    assert named(one.telemetry)["e_used"] == pytest.approx((-7.007, -1.001, -5.0))


# --------------------------------------------------------------------------------------------- payload


@given(st.integers(0, 2**16 - 1), st.integers(0, 2**64 - 1), st.tuples(*[st.floats(-1e8, 1e8)] * 3), vec3)
def test_payload_reads_back(sender: int, tick: int, position: Any, velocity: Any) -> None:
    message = StateMessage(sender, tick, position, velocity)
    assert decode(encode(message)) == message
    assert len(encode(message)) == SIZE == 63


def test_every_flipped_bit_is_refused() -> None:
    data = encode(StateMessage(3, 120, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)))
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(PayloadError):
            decode(bytes(flipped))


def sealed(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (b"", "length"),
        (encode(StateMessage(1, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))[:-1], "length"),
        (sealed(struct.pack("<BHQ6d", 2, 1, 0, *[0.0] * 6)), "version"),
        (sealed(struct.pack("<BHQ6d", 1, 1, 0, math.nan, *[0.0] * 5)), "not_finite"),
        (sealed(struct.pack("<BHQ6d", 1, 1, 0, *[0.0] * 5, math.inf)), "not_finite"),
        (sealed(struct.pack("<BHQ6d", 1, 1, 0, math.inf, -math.inf, *[0.0] * 4)), "not_finite"),
        (sealed(struct.pack("<BHQ6d", 1, 1, 0, 1e308, *[0.0] * 5)), "not_finite"),  # nor what a law makes of it
        (sealed(struct.pack("<BHQ6d", 1, 1, 0, *[0.0] * 5, -9e154)), "not_finite"),
        (bytes(SIZE), "checksum"),
    ],
)
def test_a_bad_payload_says_what_is_wrong(data: bytes, cause: str) -> None:
    with pytest.raises(PayloadError) as caught:
        decode(data)
    assert caught.value.cause == cause


def test_far_and_fast_is_not_yet_absurd() -> None:
    """A vehicle that is lost goes on telling where it is; only numbers that no sea has room for are refused."""
    message = StateMessage(1, 0, (3e8, -3e8, 1e7), (0.0, 0.0, 1e6))
    assert decode(encode(message)) == message


# ------------------------------------------------------------------------------------------ neighbours


def delivery(
    src: int,
    sent: int,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    due: int = 0,
    sender: int | None = None,
) -> Delivery:
    message = StateMessage(src if sender is None else sender, sent, position, velocity)
    return Delivery(due, sent, src, sent, encode(message))


def table(extrapolation: Any = "hold") -> NeighbourTable:
    neighbours = (Neighbour(3, 0.8, Offset((0.0, 0.0, 0.0))), Neighbour(1, 1.0, Offset((0.0, -10.0, 0.0))))
    config = replace(agent_config(1), neighbours=neighbours, extrapolation=extrapolation)
    return NeighbourTable(config, FullCodec())


def test_neighbours_come_in_one_order() -> None:
    t = table()
    t.absorb([delivery(3, 5), delivery(1, 5)], 6)
    assert [h.weight for h in t.states_at(6)] == [1.0, 0.8]


@pytest.mark.parametrize(
    ("mode", "x", "y"), [("hold", 4.0, 1.0), ("neighbour", 4.0 + 0.5 * 0.3, 1.0), ("reference", 4.21, 1.03)]
)
def test_extrapolation(mode: str, x: float, y: float) -> None:
    t = table(mode)
    t.absorb([delivery(1, 20, (4.0, 1.0, 2.0), (0.5, 0.0, 0.0))], 25)
    assert t.states_at(50)[0].position == pytest.approx((x, y, 2.0))


@given(st.permutations([10, 20, 20, 30, 40]))
def test_the_newest_by_sending_wins_in_any_order_of_arrival(order: list[int]) -> None:
    t = table()
    for sent in order:
        t.absorb([delivery(1, sent, (float(sent), 0.0, 0.0))], 100)
    assert t.states_at(100)[0].position == (40.0, 0.0, 0.0)
    assert sum(t.counters.values()) == len(order)


def test_a_duplicate_is_ignored_and_a_late_message_is_superseded() -> None:
    t = table()
    t.absorb([delivery(1, 20, (1.0, 0.0, 0.0)), delivery(1, 20, (2.0, 0.0, 0.0)), delivery(1, 10)], 30)
    assert t.states_at(30)[0].position == (1.0, 0.0, 0.0)
    assert (t.counters["accepted"], t.counters["duplicate"], t.counters["superseded"]) == (1, 1, 1)


def test_extrapolation_ends_at_its_cap_and_silence_ends_a_neighbours_weight() -> None:
    """Sim time, not wall time: the same ticks whatever the machine; and the next message brings the neighbour back."""
    neighbours = (Neighbour(1, 1.0, Offset((0.0, 0.0, 0.0))),)
    config = replace(agent_config(1), neighbours=neighbours, extrapolation="neighbour")
    t = NeighbourTable(replace(config, age_cap_s=0.5, drop_after_s=2.0), FullCodec())
    t.absorb([delivery(1, 0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))], 1)
    assert [t.states_at(k)[0].position[0] for k in (40, 50, 51, 200)] == pytest.approx([0.4, 0.5, 0.5, 0.5])
    assert t.states_at(200)[0].age == pytest.approx(2.0)
    assert t.states_at(201) == ()
    t.absorb([delivery(1, 190, (9.0, 0.0, 0.0))], 202)
    assert len(t.states_at(202)) == 1


def test_what_cannot_be_used_is_counted_and_dropped() -> None:
    t = table()
    corrupt = delivery(1, 20)._replace(payload=bytes(SIZE))
    t.absorb([corrupt, corrupt._replace(payload=b"hello")], 30)
    t.absorb([delivery(1, 20, sender=3), delivery(4, 20), delivery(1, 31)], 30)
    assert t.states_at(30) == ()
    counted = {cause: n for cause, n in t.counters.items() if n}
    assert counted == {"checksum": 1, "length": 1, "wrong_sender": 2, "from_future": 1}


# --------------------------------------------------------------------------------------------- profiles


@pytest.mark.parametrize("name", PROFILES)
def test_every_profile_leaves_room_round_the_reference(name: str) -> None:
    guidance, _ = profile(name)
    for low, v, high in zip(guidance.rho_lo, (0.7, 0.1, 0.0), guidance.rho_hi, strict=True):
        assert low < v < high
    assert 0.0 < guidance.k_min < guidance.k_max


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(AgentError, match="paper, consistent, hardened"):
        profile("papper")


# ------------------------------------------------------------------------------------------- the agent


def named(telemetry: tuple[float, ...], controller: str = "nboc") -> dict[str, tuple[float, ...]]:
    """Telemetry by signal name."""
    layout = Agent(agent_config(1, controller=controller)).layout
    assert len(telemetry) == layout.size
    return {signal.name: telemetry[place] for _, signal, place in layout.signals()}


def still(tick: int = 0, **changes: tuple[float, ...]) -> Nav:
    nav = Nav(tick, (0.0, 0.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0, 0.0, 0.0))
    return nav._replace(**changes)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_telemetry_is_what_signals_declare(controller: str) -> None:
    agent = Agent(agent_config(1, controller=controller))
    tau, telemetry, payloads = agent.step(still(), [])
    assert len(telemetry) == agent.layout.size
    assert all(type(value) is float for value in (*tau, *telemetry))
    assert len(payloads) == 1
    names = [(group, signal.name) for group, signal, _ in agent.layout.signals()]
    assert len(set(names)) == len(names)


def test_tau_is_the_demand_within_the_limits() -> None:
    agent = Agent(agent_config(1))
    decision = agent.decide(still(), [])
    demand = named(decision.telemetry)["demand"]
    assert demand[0] > 20.0
    assert decision.tau == (20.0, demand[1], demand[2])


def test_it_sends_its_state_on_round_ticks_only() -> None:
    agent = Agent(agent_config(3, round_ticks=10))
    nav = still(eta=(1.0, 2.0, 3.0, 0.2, 0.5), nu=(1.0, 0.1, -0.2, 0.0, 0.0))
    sent = [agent.step(nav._replace(tick=k), []).payloads for k in range(21)]
    assert [k for k, payloads in enumerate(sent) if payloads] == [0, 10, 20]
    message = decode(sent[10][0])
    assert message == StateMessage(3, 10, (1.0, 2.0, 3.0), earth_velocity(nav.eta, nav.nu))


def test_step_is_transmit_then_decide() -> None:
    one, other = Agent(agent_config(2)), Agent(agent_config(2))
    inbox = [delivery(1, 0), delivery(3, 0)]
    stepped = one.step(still(), inbox)
    assert stepped.payloads == other.transmit(still())
    assert stepped[:2] == other.decide(still(), inbox)[:2]


def test_the_gain_is_optimised_on_global_ticks() -> None:
    """An agent that starts at tick 7 uses K0 until tick 10; in between the gain is held."""
    agent = Agent(agent_config(1))
    found = {k: named(agent.decide(still(k), []).telemetry) for k in range(7, 16)}
    assert [k for k, t in found.items() if t["qp_status"] == (1.0,)] == [10, 15]
    assert found[7]["K"] == found[9]["K"] == (0.3, 0.3, 0.3)
    assert found[10]["K"] == found[14]["K"] != (0.3, 0.3, 0.3)


def test_the_first_sample_has_no_past() -> None:
    """Filters at rest, shunting states moved by one sample only, whatever the tick is."""
    early, late = Agent(agent_config(1)), Agent(agent_config(1))
    reference = early.config.reference
    moved = tuple(start + 50.0 * v for start, v in zip((0.0, 0.0, 0.0), reference.velocity, strict=True))
    first = early.decide(still(0), []).telemetry
    restarted = late.decide(still(5000, eta=(*moved, 0.0, 0.0)), []).telemetry
    assert restarted == pytest.approx(first, abs=1e-9)


def test_no_solution_holds_the_gain_and_is_flagged() -> None:
    """A reference outside the bounds of rho: infeasible as soon as the error points outward."""
    config = agent_config(1)
    guidance = replace(config.guidance, rho_hi=(0.5, 1.0, 1.25), rho_lo=(0.1, -1.0, -1.25))
    agent = Agent(replace(config, guidance=guidance))
    telemetry = named(agent.decide(still(), []).telemetry)
    assert telemetry["qp_status"] == (2.0,)
    assert telemetry["K"] == config.guidance.K0
    assert telemetry["rho"][0] == 0.5
    assert agent.counters()["qp_failures"] == 1


def test_the_slew_limit_holds_from_the_first_sample() -> None:
    agent = Agent(agent_config(1, "hardened"))
    previous = (0.1, 0.0, 0.0)  # the own velocity stands for the previous rho
    for k in range(5):
        rho = named(agent.decide(still(k), []).telemetry)["rho"]
        assert all(abs(a - b) <= 0.003 + 1e-12 for a, b in zip(rho, previous, strict=True))
        previous = rho


@pytest.mark.parametrize("position", range(10))
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_measurement_that_is_not_finite_is_an_error(position: int, value: float) -> None:
    numbers = [0.1] * 10
    numbers[position] = value
    nav = Nav(4, tuple(numbers[:5]), tuple(numbers[5:]))
    with pytest.raises(ControllerError) as caught:
        Agent(agent_config(2)).decide(nav, [])
    assert (caught.value.agent, caught.value.tick) == (2, 4)


@pytest.mark.parametrize("speed", [1e155, 1e200, 1e308])
def test_a_controller_that_leaves_the_finite_numbers_says_where(speed: float) -> None:
    nav = still(nu=(speed, speed, 0.0, speed, speed))
    with pytest.raises(ControllerError) as caught:
        Agent(agent_config(1)).decide(nav, [])
    assert caught.value.agent == 1


def test_a_telemetry_that_is_not_finite_is_named() -> None:
    brain = Agent(agent_config(1))
    telemetry = list(brain.decide(still(0), [])[1])
    group, signal, place = list(brain.layout.signals())[-1]
    telemetry[place.start] = math.nan
    with pytest.raises(ControllerError, match=f"{group}.{signal.name} is"):
        brain._check(4, (0.0, 0.0, 0.0), tuple(telemetry))
    with pytest.raises(ControllerError, match="tau is"):
        brain._check(4, (0.0, math.inf, 0.0), tuple(0.0 for _ in telemetry))


def test_time_does_not_go_back() -> None:
    agent = Agent(agent_config(1))
    agent.decide(still(3), [])
    with pytest.raises(AgentError, match="tick 3"):
        agent.decide(still(3), [])


def test_missed_samples_count_as_the_time_they_took() -> None:
    """A pitch that turned slowly while no nav came does not look like a jump."""
    agent, steady = Agent(agent_config(1)), Agent(agent_config(1))
    for k in range(300):
        nav = still(k, eta=(0.0, 0.0, 0.0, 0.0, 0.001 * k), nu=(0.5, 0.0, 0.0, 0.0, 0.1))
        last = steady.decide(nav, []).telemetry
        if k < 200 or k == 299:
            resumed = agent.decide(nav, []).telemetry
    assert named(resumed)["r_err"] == pytest.approx(named(last)["r_err"], abs=0.05)


def sample_of(eta: Any, nu: Any) -> Sample:
    """A sample of a vehicle alone."""
    zero = (0.0, 0.0, 0.0)
    return Sample(0, 0.0, 0.01, eta, nu, earth_velocity(eta, nu), Motion(zero, zero), (), zero, 1.0, "seed")


@pytest.mark.parametrize(
    ("theta", "nu"),
    [
        (0.0, (0.0, 0.0, 0.0, 0.0, 0.0)),  # no speed at all
        (0.0, (-0.5, 0.1, 0.0, 0.0, 0.0)),  # backward
        (0.0, (0.0, 0.5, 0.0, 0.0, 0.0)),  # sideways: the thrust has no part in the velocity
        (0.0, (0.0, 0.0, -0.5, 0.0, 0.0)),
        (math.pi / 2, (0.5, 0.0, 0.0, 0.0, 0.0)),  # vertical
        (2.0, (0.5, 0.0, 0.0, 0.0, 0.0)),  # upside down
        (0.0, (1e-12, -1e-12, 1e-12, 0.0, 0.0)),
    ],
)
def test_guards(theta: float, nu: Any) -> None:
    """Where the printed law divides by zero the demand stays of a reasonable size."""
    config = agent_config(1)
    tracking = NeurodynamicTracking(config)
    for command in ((0.7, 0.0, 0.0), (1.5, 0.5, -2.0)):
        demand, values = tracking.step(sample_of((0.0, 0.0, 0.0, theta, 0.0), nu), VelocityCommand(*command))
        assert all(map(math.isfinite, values))
        assert max(map(abs, demand)) < 500.0


def test_at_rest_the_thrust_still_has_a_direction() -> None:
    """Below u_eps the printed cosine shrinks with the speed; above, a straight run has cosine 1."""
    config = agent_config(1)
    config = replace(config, tracking=replace(config.tracking, astern="printed"))
    for u, cosine in ((0.01, 0.5), (0.019, 0.95), (0.5, 1.0)):
        tracking = NeurodynamicTracking(config)
        sample = sample_of((0.0,) * 5, (u, 0.0, 0.0, 0.0, 0.0))
        demand, values = tracking.step(sample, VelocityCommand(0.7, 0.0, 0.0))
        x1 = values[5]
        assert demand[0] == pytest.approx(1.0 * u - 4.0 / cosine * 10.0 * x1)


def test_with_nowhere_to_go_the_first_direction_is_held() -> None:
    """Below rho_eps the angles are those of the vehicle at its first sample."""
    config = agent_config(1)
    nearly_still = replace(config.guidance, rho_lo=(-0.01,) * 3, rho_hi=(0.01,) * 3)
    config = replace(config, guidance=nearly_still)
    agent = Agent(config)
    agent.decide(still(0, eta=(0.0, 0.0, 0.0, 0.2, -0.5)), [])
    telemetry = named(agent.decide(still(1, eta=(0.0, 0.0, 0.0, 0.3, 0.7)), []).telemetry)
    assert (telemetry["theta_cmd"], telemetry["psi_cmd"]) == ((0.2,), (-0.5,))


def test_the_law_cancels_the_vehicles_own_dynamics() -> None:
    """With no error at all, the demanded forces balance surge, pitch and yaw in a steady straight run."""
    config = agent_config(1)
    tracking = NeurodynamicTracking(config)
    eta, nu = (0.0, 0.0, 0.0, 0.0, 0.4), (0.8, 0.0, 0.0, 0.0, 0.0)
    tau, _ = tracking.step(sample_of(eta, nu), VelocityCommand(0.8, 0.0, 0.4))
    rate = derivative(coefficients(config.vehicle), (*eta, *nu), tau, NO_FORCE)
    assert rate[5:] == pytest.approx((0.0,) * 5, abs=1e-12)


# ----------------------------------------------------------------------------- determinism


def test_the_order_in_which_agents_are_served_changes_no_bit() -> None:
    def run(order: Any) -> list[Any]:
        agents = {i: Agent(agent_config(i, "paper", "neighbour", 10)) for i in (1, 2, 3, 4)}
        return list(run_loop(agents, World(world_config(PAPER)), 120, Link(10, 1), order))

    rng = random.Random(1)
    assert run(lambda _tick: rng.sample([1, 2, 3, 4], 4)) == run(lambda _tick: [1, 2, 3, 4])


def test_an_agent_hears_only_its_in_neighbours() -> None:
    """The graph of the paper's fleet: a chain, heard in both directions."""
    for i in (1, 2, 3, 4):
        heard = {n.id for n in agent_config(i).neighbours}
        assert heard == {j for to, j in WEIGHTS if to == i} == {j for j in (i - 1, i + 1) if 1 <= j <= 4}
