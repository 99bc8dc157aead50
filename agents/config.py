"""The configuration that one agent gets before a run: its own slice of the scenario, without the slices of others.

The agent receives the slice as plain values (`to_values`, `from_values`). Another process, another host and another
language can read them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, get_type_hints

import msgspec

from agents.offset import Offset
from agents.trajectory import Motion, Reference, reference_type
from world.vectors import Vec3, plus
from world.vehicle_params import VehicleParams

Extrapolation = Literal["hold", "neighbour", "reference"]
Cost = Literal["printed", "consistent"]
Solver = Literal["piqp", "exact"]
Angles = Literal["printed", "exact"]
Astern = Literal["bow", "printed"]
OnError = Literal["abort", "coast", "die"]
Codec = Literal["full", "compact", "located"]
Method = Literal["aid", "naive", "consistent"]


@dataclass(frozen=True, slots=True)
class Neighbour:
    """One in-neighbour j of the agent: number, weight a_ij [1], offset Delta_ij = p_i - p_j [m, NED]."""

    id: int
    weight: float
    offset: Offset


@dataclass(frozen=True, slots=True)
class GuidanceParams:
    """Consensus guidance, and the online QP of its gain (eqs. 10-23)."""

    Q: Vec3  # weight of the predicted consensus error
    R1: Vec3  # weight of rho
    R2: Vec3  # weight of the change of rho
    p: float  # weight of the change of K
    K0: Vec3  # 1/s, gain before the first optimum, and of the fixed gain
    k_min: float  # 1/s
    k_max: float  # 1/s
    rho_lo: Vec3  # m/s, NED
    rho_hi: Vec3  # m/s, NED
    qp_ticks: int  # the QP runs on ticks divisible by this
    horizon_s: float  # prediction step Delta t of eq. 18
    cost: Cost = "printed"
    # How the gain is solved: by its exact formula alone, or with PIQP beside it. The gain is the same.
    solver: Solver = "piqp"
    slew: float = 0.0  # m/s^2 per axis on rho; 0: off


@dataclass(frozen=True, slots=True)
class TrackingParams:
    """The tracking laws (eqs. 28-47) and their guards."""

    k_u: float  # 1/s   K2 = (k_u, k_q, k_r); sliding mode: m/s^2 and rad/s^2, the switching gains
    k_q: float
    k_r: float
    k_theta: float  # 1/s
    k_psi: float  # 1/s
    a: float  # 1/s   shunting decay
    b_up: float  # shunting upper bound (b)
    b_down: float  # shunting lower bound (b', printed as d in Table I)
    tau_f: float  # s    derivative filter
    u_floor: float  # m/s  least forward component of the commanded speed
    rho_eps: float  # m/s  below it the commanded angles are held
    cos_eps: float  # 1    least |cos theta' cos psi'| and cos theta
    u_eps: float  # m/s  least speed in the direction cosines
    phi: Vec3 = (1.0, 1.0, 1.0)  # m/s, rad/s, rad/s: boundary layers of sliding mode
    angles: Angles = "printed"  # direction of the velocity: theta + theta', psi + psi', or the true angles
    astern: Astern = "bow"  # what is steered below 0.1 m/s of surge: the bow, or the velocity as printed


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A vertical cylinder that no vehicle may enter, from the surface to the bottom."""

    north: float  # m, where its axis is
    east: float  # m
    radius: float  # m


@dataclass(frozen=True, slots=True)
class KeepApartParams:
    """The filter that keeps vehicles apart (agents/laws/keep_apart.py)."""

    distance: float  # m, least distance of any two vehicles
    obstacles: tuple[Cylinder, ...]
    gain: float  # 1/s, gain of the barrier
    lag_s: float  # longest lag of the velocity behind the command
    slew: float  # m/s^2 per axis, limit of how fast the filter changes the command
    acceleration: float  # m/s^2, limit of what a neighbour does
    speed: float  # m/s, limit of a neighbour's speed, and on each horizontal axis of what the filter commands
    climb: float  # m/s, up or down, the limit of what is commanded
    age_cap_s: float  # what is older is extrapolated no further, and its margin grows no more


@dataclass(frozen=True, slots=True)
class LocalizationParams:
    """How a vehicle uses ranges to others (agents/localization/localizer.py)."""

    method: Method
    gate: float  # chi-square with 1 degree of freedom: a range that fits worse is refused
    mirror: bool = False  # whether it keeps the mirror image of its place (agents/localization/mirror_image.py)
    nis: bool = False  # whether it reports the mean NIS of the ranges that it used


@dataclass(frozen=True, slots=True)
class Law:
    """A law and its parameters. The name is that of a shipped law or of an entry point, or it is `module:Class`."""

    name: str
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """One agent's slice of the scenario."""

    id: int  # number of the vehicle, from 1
    seed: int  # of the run
    tick_ns: int  # control period Ts
    round_ticks: int  # m, ticks from one transmission to the next
    offset: Offset  # p_i [m, NED]: eta_i^d = eta_1^d + p_i
    reference: Reference | None  # eta_1^d (eq. 11); None: this agent does not know it
    reference_weight: float  # b_i [1]
    neighbours: tuple[Neighbour, ...]  # those that it may hear
    extrapolation: Extrapolation  # how an old position of a neighbour is carried on
    age_cap_s: float  # what is older is extrapolated no further; 0: any
    drop_after_s: float  # a neighbour not heard for longer has no weight until it is heard again; 0: never
    guidance: GuidanceParams  # parameters of the law for the velocity
    tracking: TrackingParams  # parameters of the law for the forces
    vehicle: VehicleParams  # the controller's model of its own vehicle
    tau_max: Vec3  # N, N m, N m
    guidance_law: Law = Law("optimal")  # turns the sample into a commanded velocity
    tracking_law: Law = Law("neurodynamic")  # turns the commanded velocity into forces
    controller: Law | None = None  # one law in place of guidance and tracking
    agent: Law | None = None  # a whole agent in place of all laws
    on_error: OnError = "abort"  # what follows when a law fails
    budget_s: float = 0.0  # wall time a law may take for a sample; 0: any
    codec: Codec = "full"  # format of its messages: agents.payload, agents.compact or agents.localization.payload
    standby_for: tuple[int, ...] = ()  # while it hears none of these neighbours it follows the reference itself
    standby_after_s: float = 0.0  # how long the agent must hear none of them before it follows the reference [s]
    keep_apart: KeepApartParams | None = None  # between guidance and tracking; None: nothing is there
    localization: LocalizationParams | None = None  # between navigation and guidance; None: nothing is there
    moored: bool = False  # its vehicle does not move, so a whole agent need not steer

    def desired(self, t: float) -> Motion:
        """Say where the vehicle should be: pd_i = eta_1^d + p_i.

        Args:
            t: time [s].

        Returns:
            The position [m, NED] and the velocity [m/s, NED].

        Raises:
            ValueError: this agent does not know the reference.
        """
        if self.reference is None:
            raise ValueError(f"agent {self.id} is not told the reference (knows_reference: false), only what it hears")
        reference = self.reference.at(t)
        if not self.offset.changes:
            return Motion(plus(reference.position, self.offset.start), reference.velocity)
        own = self.offset.at(t)
        return Motion(plus(reference.position, own.position), plus(reference.velocity, own.velocity))

    def to_values(self) -> dict[str, Any]:
        """Write the slice for another process, host or language.

        Returns:
            Plain maps, sequences and scalars (MessagePack values), in the order of the declarations.
        """
        values: dict[str, Any] = msgspec.to_builtins(self)
        return values

    @classmethod
    def from_values(cls, values: dict[str, Any]) -> AgentConfig:
        """Read a slice.

        Args:
            values: as `to_values` returns them; every value must be of its declared type.

        Returns:
            The slice.

        Raises:
            ValueError: a value is of another type, or missing within a map.
            TypeError: a field of the slice is missing.
            KeyError: a field of the slice is unknown.
        """
        # Each field for itself: msgspec cannot tell the three data classes of a reference apart.
        types = _TYPES | {"reference": reference_type(values["reference"])}
        return cls(**{key: msgspec.convert(value, types[key]) for key, value in values.items()})


_TYPES: dict[str, Any] = get_type_hints(AgentConfig)
