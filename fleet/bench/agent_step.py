"""The cost of one sample of one agent, and its parts: on the samples of a real run, in CPU time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from time import thread_time_ns
from typing import Any

from agents.agent import Agent
from agents.codecs import FullCodec
from agents.config import AgentConfig
from agents.controllers import CONTROLLERS, Cascade
from agents.laws.gain_qp import build_qp, solve
from agents.laws.guidance import OptimalGuidance
from agents.laws.kinematics import earth_velocity
from agents.laws.velocity_command import consensus_error, direction_command, floor_speed
from agents.neighbours import NeighbourTable
from agents.payload import StateMessage
from agents.payload import encode as encode_payload
from agents.sample import Sample, VelocityCommand
from fleet.execution.in_memory import record
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Delivery, Nav

VEHICLE = 2  # two neighbours
GOALS_US = {"agent step": 40.0, "agent step with QP": 80.0}


@dataclass(slots=True)
class _Costs:
    """Microseconds of CPU time by stage."""

    by_stage: dict[str, list[float]] = field(default_factory=dict)

    def time(self, stage: str, call: Callable[..., Any], *args: Any) -> Any:
        began = thread_time_ns()
        result = call(*args)
        self.by_stage.setdefault(stage, []).append((thread_time_ns() - began) / 1e3)
        return result

    def medians(self) -> dict[str, float]:
        return {stage: median(values) for stage, values in self.by_stage.items()}


def agent_steps(ticks: int) -> dict[str, float]:
    """Median microseconds of CPU time: whole steps, controllers alone, and the stages of a step without QP."""
    config, tape = _tape(ticks)
    costs = _Costs()
    # The cost of the clock itself is part of every figure, therefore it is shown.
    for _ in range(1000):
        costs.time("(an empty call, clock included)", _nothing)
    agent = Agent(config)
    for nav, deliveries in tape:
        costs.time(f"agent step{_kind(config, nav.tick)}", agent.step, nav, deliveries)
    _stages(config, tape, costs)
    for name in CONTROLLERS:
        other = load_scenario("ideal", [f"controller={name}"]).agent_config(VEHICLE)
        for sample, cascade in _samples(other, tape):
            if sample.tick % config.round_ticks:
                qp = _kind(config, sample.tick) if name.endswith("oc") else ""
                costs.time(f"controller alone, {name}{qp}", cascade.step, sample)
    return costs.medians()


def _kind(config: AgentConfig, tick: int) -> str:
    if tick % config.round_ticks == 0:
        return " with QP and round"
    return " with QP" if tick % config.guidance.qp_ticks == 0 else ""


def _tape(ticks: int) -> tuple[AgentConfig, list[tuple[Nav, list[Delivery]]]]:
    """The samples and messages of vehicle 2 of the disturbed paper run from 20 s on, when it is in formation."""
    start = 2000
    scenario = load_scenario("paper-disturbed", [f"duration={(start + ticks) * 10} ms", "checks={}"])
    recording = record(scenario)
    config = scenario.agent_config(VEHICLE)
    tape = []
    for tick in range(start, start + ticks):
        eta, nu = recording["eta"][tick].tolist(), recording["nu"][tick].tolist()
        deliveries = []
        sent = tick - 1
        if sent % scenario.round_ticks == 0:
            for n in config.neighbours:
                j = n.id - 1
                velocity = earth_velocity(tuple(eta[j]), tuple(nu[j]))
                payload = encode_payload(StateMessage(n.id, sent, tuple(eta[j][:3]), velocity))
                deliveries.append(Delivery(tick, sent, n.id, sent, 0, payload))
        tape.append((Nav(0, tick, tuple(eta[VEHICLE - 1]), tuple(nu[VEHICLE - 1])), deliveries))
    return config, tape


def _samples(config: AgentConfig, tape: list[tuple[Nav, list[Delivery]]]) -> list[tuple[Sample, Cascade]]:
    table = NeighbourTable(config, FullCodec())
    cascade = Cascade(config, [])
    found = []
    for nav, deliveries in tape:
        table.absorb(deliveries, nav.tick)
        heard = table.heard(nav.tick)
        desired = config.desired(nav.tick * 0.01)
        e, c = consensus_error(nav.eta[:3], desired.position, config.reference_weight, heard)  # type: ignore[arg-type]
        velocity = earth_velocity(nav.eta, nav.nu)
        sample = Sample(nav.tick, nav.tick * 0.01, 0.01, nav.eta, nav.nu, velocity, desired, heard, e, c, "")  # type: ignore[arg-type]
        found.append((sample, cascade))
    return found


def _stages(config: AgentConfig, tape: list[tuple[Nav, list[Delivery]]], costs: _Costs) -> None:
    table = NeighbourTable(config, FullCodec())
    cascade = Cascade(config, [])
    guidance, tracking = cascade.guidance, cascade.tracking
    held = (0.0, 0.0)
    for (nav, deliveries), (sample, _) in zip(tape, _samples(config, tape), strict=True):
        table.absorb(deliveries, nav.tick)
        plain = not _kind(config, nav.tick)
        count = costs if plain else _Costs()
        heard = count.time("  of which neighbours extrapolated", table.heard, nav.tick)
        count.time("  of which desired place", config.desired, sample.t)
        position, desired = sample.eta[:3], sample.desired.position
        count.time("  of which consensus error", consensus_error, position, desired, config.reference_weight, heard)
        count.time("  of which own velocity over ground", earth_velocity, sample.eta, sample.nu)
        rho, _values = count.time("  of which guidance, gain held", guidance.step, sample)
        u_cmd, *angles = count.time("  of which speed and direction", direction_command, rho, *held, 0.05)
        held = (angles[0], angles[1])
        command = VelocityCommand(floor_speed(u_cmd, sample.nu[1], sample.nu[2], 0.3), *held)
        count.time("  of which tracking", tracking.step, sample, command)
        if not plain and isinstance(guidance, OptimalGuidance):
            problem = costs.time(
                "QP: build", build_qp, sample.e, sample.c, (0.7, 0.1, 0.0), rho, guidance.K, config.guidance
            )
            costs.time("QP: solve (PIQP, fresh solver)", solve, problem)


def _nothing() -> None:
    return None
