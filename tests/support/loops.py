"""The smallest loop round the two cores: no processes, no codec, no impairments but a constant delay.

It exists to compare controller and plant with reference trajectories, tick by tick. The fleet of the paper's
simulation is written down here once more, from the paper, so that it does not depend on any scenario file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from agents.agent import Agent
from agents.config import AgentConfig, Extrapolation, Law, Neighbour
from agents.controllers import CONTROLLERS
from agents.offset import Offset
from agents.profiles import profile
from agents.trajectory import StraightLine
from world.config import DEFAULT_SUBSTEPS, Harmonic, VehicleSetup, WorldConfig
from world.sea import World
from world.vectors import Vec3, Vec5, minus
from world.vehicle_params import VehicleParams

TICK_NS = 10_000_000
OFFSETS: tuple[Vec3, ...] = ((0.0, 0.0, 0.0), (0.0, -10.0, 0.0), (10.0, -10.0, 0.0), (10.0, 0.0, 0.0))
ETA0: tuple[Vec5, ...] = (
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-1.0, -10.0, 0.0, 0.0, 0.0),
    (8.5, -10.1, 0.0, 0.0, 0.0),
    (8.4, -0.1, 0.0, 0.0, 0.0),
)
PARAMS = VehicleParams(
    m=10.0, Iy=3.0, Iz=2.0,
    beta_udot=6.0, beta_vdot=1.1, beta_wdot=1.15, beta_qdot=0.5, beta_rdot=0.45,
    beta_u=1.0, beta_v=1.1, beta_w=1.15, beta_q=0.2, beta_r=0.25, beta_b=0.1,
)  # fmt: skip
TAU_MAX: Vec3 = (20.0, 20.0, 20.0)
NU0: Vec5 = (0.1, 0.0, 0.0, 0.0, 0.0)
REFERENCE = StraightLine(start=(5.0, 1.0, 5.0), velocity=(0.7, 0.1, 0.0))
# a_ij: a vehicle listens to the one before it with weight 1, to the one after it with 0.8.
WEIGHTS = {(2, 1): 1.0, (3, 2): 1.0, (4, 3): 1.0, (1, 2): 0.8, (2, 3): 0.8, (3, 4): 0.8}


class Nav(NamedTuple):
    tick: int
    eta: Vec5
    nu: Vec5
    roll: tuple[float, ...] = ()
    clock_ns: int | None = None
    belief: tuple[float, ...] = ()


class Delivery(NamedTuple):
    due_tick: int
    sent_tick: int
    src: int
    seq: int
    payload: bytes
    range_m: float | None = None
    range_sd_m: float | None = None


class Sample(NamedTuple):
    """All vehicles at one tick, ascending; telemetry and tau are empty at the end tick."""

    tick: int
    states: list[tuple[Vec5, Vec5]]
    telemetry: list[tuple[float, ...]]
    tau: list[Vec3]


@dataclass
class Link:
    """Constant delay in ticks on every link; 0 is the ideal network, usable in the same tick."""

    round_ticks: int = 1
    delay_ticks: int = 0
    in_flight: dict[int, list[tuple[int, Delivery]]] = field(default_factory=dict)

    def send(self, tick: int, src: int, payloads: tuple[bytes, ...]) -> None:
        for dst in (i for i, j in WEIGHTS if j == src):
            for payload in payloads:
                due = tick + self.delay_ticks
                delivery = Delivery(due, tick, src, tick // self.round_ticks, payload)
                self.in_flight.setdefault(due, []).append((dst, delivery))

    def receive(self, tick: int) -> dict[int, list[Delivery]]:
        inboxes: dict[int, list[Delivery]] = {}
        for dst, delivery in self.in_flight.pop(tick, []):
            inboxes.setdefault(dst, []).append(delivery)
        return inboxes


def agent_config(
    i: int, name: str = "paper", extrapolation: Extrapolation = "hold", round_ticks: int = 1, controller: str = "nboc"
) -> AgentConfig:
    """Vehicle i of the paper's simulation with a named tuning and controller."""
    pair = CONTROLLERS[controller]
    guidance, tracking = profile(name, pair.guidance, pair.tracking)
    neighbours = tuple(
        Neighbour(j, weight, Offset(minus(OFFSETS[i - 1], OFFSETS[j - 1])))
        for (to, j), weight in sorted(WEIGHTS.items())
        if to == i
    )
    return AgentConfig(
        id=i,
        seed=1,
        tick_ns=TICK_NS,
        round_ticks=round_ticks,
        offset=Offset(OFFSETS[i - 1]),
        reference=REFERENCE,
        reference_weight=1.0,
        neighbours=neighbours,
        extrapolation=extrapolation,
        age_cap_s=0.0,
        drop_after_s=0.0,
        guidance=guidance,
        tracking=tracking,
        vehicle=PARAMS,
        tau_max=TAU_MAX,
        guidance_law=Law(pair.guidance),
        tracking_law=Law(pair.tracking),
    )


def world_config(
    disturbance: tuple[Harmonic, ...] = (),
    substeps: int = DEFAULT_SUBSTEPS,
    current: Vec3 = (0.0, 0.0, 0.0),
    eta0: tuple[Vec5, ...] = ETA0,
) -> WorldConfig:
    """The paper's four vehicles at their initial states."""
    vehicles = tuple(VehicleSetup(i, eta, NU0, PARAMS, TAU_MAX) for i, eta in enumerate(eta0, start=1))
    return WorldConfig(1, TICK_NS, 6000, 1, substeps, vehicles, disturbance, current)


def run_loop(
    agents: dict[int, Agent],
    world: World,
    ticks: int,
    link: Link,
    order: Callable[[int], list[int]] = lambda _tick: [1, 2, 3, 4],
) -> Iterator[Sample]:
    """Drive the agents and the world for `ticks` ticks and yield every tick, the end included.

    On an ideal network (delay 0) all transmit before anyone decides. `order` gives the order in which the
    vehicles are served at a tick, which must not matter.
    """
    ids = world.ids
    for tick in range(ticks):
        serve = order(tick)
        navs = {i: Nav(tick, *world.sense(i)) for i in serve}
        if tick % link.round_ticks == 0:
            for i in serve:
                link.send(tick, i, agents[i].transmit(navs[i]))
        inboxes = link.receive(tick)
        decisions = {i: agents[i].decide(navs[i], sorted(inboxes.get(i, []), key=lambda d: d[:4])) for i in serve}
        states = [world.state(i) for i in ids]
        applied = {i: world.actuate(i, decisions[i].tau) for i in serve}
        for i in serve:
            world.advance(i, applied[i])
        yield Sample(tick, states, [decisions[i].telemetry for i in ids], [applied[i] for i in ids])
    yield Sample(ticks, [world.state(i) for i in ids], [], [])
