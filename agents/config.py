"""What one agent is told before a run: its own slice of the scenario and nothing about anyone else's.

The slice travels to the agent as plain values (`to_values`, `from_values`), so that an agent in another
process, on another host or in another language receives the same thing.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from world.vehicle import Vec3, VehicleParams

Extrapolation = Literal["hold", "neighbour", "reference"]
Cost = Literal["printed", "consistent"]


@dataclass(frozen=True, slots=True)
class Neighbour:
    """One in-neighbour j of the agent: number, weight a_ij [1], offset Delta_ij = p_i - p_j [m, NED]."""

    id: int
    weight: float
    offset: Vec3


@dataclass(frozen=True, slots=True)
class Reference:
    """The leader trajectory eta_1^d(t) = start + velocity t [m, m/s, NED], known to every agent (eq. 11)."""

    start: Vec3
    velocity: Vec3


@dataclass(frozen=True, slots=True)
class GuidanceParams:
    """Consensus guidance and its online gain QP (eqs. 10-23)."""

    Q: Vec3  # weight of the predicted consensus error
    R1: Vec3  # weight of rho
    R2: Vec3  # weight of the change of rho
    p: float  # weight of the change of K
    K0: Vec3  # 1/s, gain before the first optimum
    k_min: float  # 1/s
    k_max: float  # 1/s
    rho_lo: Vec3  # m/s, NED
    rho_hi: Vec3  # m/s, NED
    qp_ticks: int  # the QP runs on ticks divisible by this
    horizon_s: float  # prediction step Delta t of eq. 18
    cost: Cost = "printed"
    slew: float = 0.0  # m/s^2 per axis on rho; 0: off


@dataclass(frozen=True, slots=True)
class TrackingParams:
    """Neurodynamics backstepping (eqs. 28-47) and its guards."""

    k_u: float  # 1/s   K2 = (k_u, k_q, k_r)
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


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """One agent's slice of the scenario."""

    id: int
    seed: int
    tick_ns: int
    round_ticks: int
    offset: Vec3  # p_i [m, NED]: eta_i^d = eta_1^d + p_i
    reference: Reference
    reference_weight: float  # b_i [1]
    neighbours: tuple[Neighbour, ...]
    extrapolation: Extrapolation
    controller: str  # registered name, "nboc"
    guidance: GuidanceParams
    tracking: TrackingParams
    vehicle: VehicleParams  # the controller's model of its own vehicle
    tau_max: Vec3  # N, N m, N m

    def to_values(self) -> dict[str, Any]:
        """Plain maps, lists and scalars (MessagePack values)."""
        return asdict(self)

    @classmethod
    def from_values(cls, values: dict[str, Any]) -> AgentConfig:
        """The inverse of `to_values`; lists become tuples again.

        Raises:
            TypeError: a field is missing or unknown.
        """
        v = {key: _tuples(value) for key, value in values.items()}
        v["reference"] = Reference(**v["reference"])
        v["neighbours"] = tuple(Neighbour(**n) for n in v["neighbours"])
        v["guidance"] = GuidanceParams(**v["guidance"])
        v["tracking"] = TrackingParams(**v["tracking"])
        v["vehicle"] = VehicleParams(**v["vehicle"])
        return cls(**v)


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return tuple(_tuples(item) for item in value)
    return value
