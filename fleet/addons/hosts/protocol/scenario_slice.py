"""An agent's slice of the scenario, field by field, for the protocol page; a test compares it with the declarations."""

from __future__ import annotations

from agents.config import (
    AgentConfig,
    Cylinder,
    GuidanceParams,
    KeepApartParams,
    Law,
    LocalizationParams,
    Neighbour,
    TrackingParams,
)
from agents.offset import Offset, OffsetChange
from agents.trajectory import Circle, Path, StraightLine
from world.vehicle_params import VehicleParams

Meaning = tuple[str, str, str]  # type, unit, meaning

_LAWS = "what our agent runs; null for none; of no meaning to yours"

FIELDS: dict[type, dict[str, Meaning]] = {
    AgentConfig: {
        "id": ("uint", "", "the vehicle's number i"),
        "seed": ("uint", "", "of the run; whoever draws at random draws from it, for a log that repeats"),
        "tick_ns": ("uint", "ns", "the control period Ts"),
        "round_ticks": ("uint", "tick", "m, between two round ticks: tick k is one if m divides it"),
        "offset": ("Offset", "m", "p_i(t), where the vehicle belongs relative to the reference"),
        "reference": (
            "StraightLine, Circle, Path or null",
            "",
            "the trajectory eta_1^d(t), by its `kind`; null: not told",
        ),
        "reference_weight": ("real", "1", "b_i; 0: this vehicle does not follow the reference itself"),
        "neighbours": ("Neighbour[*]", "", "the neighbours that it hears, ascending; it does not know its listeners"),
        "extrapolation": ("str", "", "hold, neighbour or reference: how ours makes up for the age of a message"),
        "age_cap_s": ("real", "s", "what is older is extrapolated no further; 0: any"),
        "drop_after_s": ("real", "s", "after this silence a neighbour has no weight; 0: never"),
        "guidance": ("map", "", "parameters of our guidance laws, below"),
        "tracking": ("map", "", "parameters of our tracking laws, below"),
        "vehicle": ("map", "", "the model of the own vehicle as the scenario lets its controller believe, below"),
        "tau_max": ("real[3]", "N, N m", "limits of thrust, pitch and yaw moment; the world clips what is beyond"),
        "guidance_law": ("Law", "", _LAWS),
        "tracking_law": ("Law", "", _LAWS),
        "controller": ("Law or null", "", _LAWS),
        "agent": ("Law or null", "", _LAWS),
        "on_error": ("str", "", "abort, coast or die: what ours does when a law fails"),
        "budget_s": ("real", "s", "wall time that a law of ours may take for a sample; 0: any"),
        "codec": ("str", "", "full, compact or located: which payload the scenario wants, at the end of this page"),
        "standby_for": ("uint[*]", "", "neighbours; while it hears none of them it follows the reference itself"),
        "standby_after_s": ("real", "s", "for so long it must not have heard them"),
        "keep_apart": ("KeepApartParams or null", "", "what keeps vehicles apart; yours may do the same"),
        "localization": ("LocalizationParams or null", "", "how ranges to others are used; yours may do the same"),
        "moored": ("bool", "", "the vehicle does not move, so commands have no effect"),
    },
    Neighbour: {
        "id": ("uint", "", "the neighbour's number j, `src` of its deliveries"),
        "weight": ("real", "1", "a_ij"),
        "offset": ("Offset", "m", "Delta_ij(t) = p_i(t) - p_j(t)"),
    },
    Offset: {
        "start": ("real[3]", "m", "NED, until the first change"),
        "changes": ("OffsetChange[*]", "", "in order of time, none before the one before is complete"),
    },
    OffsetChange: {
        "begin": ("real", "s", "when the offset begins to move"),
        "blend": ("real", "s", "how long that takes: with x from 0 to 1 it goes 10 x^3 - 15 x^4 + 6 x^5 of the way"),
        "offset": ("real[3]", "m", "NED, where it arrives"),
    },
    StraightLine: {
        "start": ("real[3]", "m", "NED, at t = 0"),
        "velocity": ("real[3]", "m/s", "NED; the position is start + velocity t"),
        "kind": ("str", "", "line"),
    },
    Circle: {
        "center": ("real[3]", "m", "NED; z at t = 0"),
        "radius": ("real", "m", ""),
        "speed": ("real", "m/s", "along the circle"),
        "bearing": ("real", "rad", "of the start seen from the centre, clockwise from north"),
        "sense": ("real", "1", "1 clockwise seen from above, -1 anticlockwise"),
        "sink": ("real", "m/s", "downwards; not 0: a helix"),
        "kind": ("str", "", "circle"),
    },
    Path: {
        "points": ("real[3][*]", "m", "NED; straight legs between them, rounded by arcs that touch both legs"),
        "speed": ("real", "m/s", "along legs and arcs"),
        "radius": ("real", "m", "of the arcs"),
        "closed": ("bool", "", "from the last point back to the first, beginning where the first corner's arc ends"),
        "kind": ("str", "", "path; an open one begins at its first point and goes on straight behind its last"),
    },
    Law: {
        "name": ("str", "", "one of ours, or module:Class"),
        "parameters": ("map", "", "what it is made with"),
    },
    KeepApartParams: {
        "distance": ("real", "m", "between any two vehicles"),
        "obstacles": ("Cylinder[*]", "", "vertical cylinders that no vehicle may enter"),
        "gain": ("real", "1/s", "of the barrier"),
        "lag_s": ("real", "s", "longest lag of the velocity behind the command"),
        "slew": ("real", "m/s^2", "per axis, limit of how fast the filter changes the command"),
        "acceleration": ("real", "m/s^2", "limit of what a neighbour does"),
        "speed": ("real", "m/s", "likewise; and on each horizontal axis the limit of what the filter commands"),
        "climb": ("real", "m/s", "greatest vertical velocity that is commanded, up or down"),
        "age_cap_s": ("real", "s", "what is older is extrapolated no further, and its margin grows no more"),
    },
    Cylinder: {
        "north": ("real", "m", "of the axis"),
        "east": ("real", "m", ""),
        "radius": ("real", "m", ""),
    },
    LocalizationParams: {
        "method": ("str", "", "aid, naive or consistent"),
        "gate": ("real", "1", "chi-square with 1 degree of freedom: a range that fits worse is refused"),
        "mirror": ("bool", "", "whether the mirror image of the place is kept, until ranges tell which it is"),
        "nis": ("bool", "", "whether the mean NIS of the ranges is reported"),
    },
    VehicleParams: {
        "m": ("real", "kg", "mass"),
        "Iy": ("real", "kg m^2", "moment of inertia in pitch"),
        "Iz": ("real", "kg m^2", "moment of inertia in yaw"),
        "beta_udot": ("real", "kg", "added mass in surge; m1 = m - beta_udot, and so on"),
        "beta_vdot": ("real", "kg", "in sway"),
        "beta_wdot": ("real", "kg", "in heave"),
        "beta_qdot": ("real", "kg m^2", "in pitch"),
        "beta_rdot": ("real", "kg m^2", "in yaw"),
        "beta_u": ("real", "kg/s", "linear damping in surge"),
        "beta_v": ("real", "kg/s", "in sway"),
        "beta_w": ("real", "kg/s", "in heave"),
        "beta_q": ("real", "kg m^2/s", "in pitch"),
        "beta_r": ("real", "kg m^2/s", "in yaw"),
        "beta_b": ("real", "N m", "restoring moment in pitch"),
    },
    GuidanceParams: {
        "Q": ("real[3]", "1", "weight of the predicted consensus error"),
        "R1": ("real[3]", "1", "weight of the commanded velocity rho"),
        "R2": ("real[3]", "1", "weight of its change"),
        "p": ("real", "1", "weight of the change of the gain K"),
        "K0": ("real[3]", "1/s", "the gain before the first optimum, and the fixed one"),
        "k_min": ("real", "1/s", "least gain"),
        "k_max": ("real", "1/s", "greatest gain"),
        "rho_lo": ("real[3]", "m/s", "NED, least commanded velocity"),
        "rho_hi": ("real[3]", "m/s", "NED, greatest commanded velocity"),
        "qp_ticks": ("uint", "tick", "the gain is optimised on ticks that this divides"),
        "horizon_s": ("real", "s", "prediction step"),
        "cost": ("str", "", "printed or consistent"),
        "solver": ("str", "", "piqp or exact: whether PIQP solves the problem of the gain beside the formula"),
        "slew": ("real", "m/s^2", "limit of the change of rho per axis; 0: none"),
    },
    TrackingParams: {
        "k_u": ("real", "1/s", "gain in surge; of sliding mode the switching gain, m/s^2"),
        "k_q": ("real", "1/s", "in pitch rate; rad/s^2"),
        "k_r": ("real", "1/s", "in yaw rate; rad/s^2"),
        "k_theta": ("real", "1/s", "in pitch"),
        "k_psi": ("real", "1/s", "in yaw"),
        "a": ("real", "1/s", "shunting decay"),
        "b_up": ("real", "1", "shunting upper bound"),
        "b_down": ("real", "1", "shunting lower bound"),
        "tau_f": ("real", "s", "derivative filter"),
        "u_floor": ("real", "m/s", "least forward component of the commanded speed"),
        "rho_eps": ("real", "m/s", "below it the commanded angles are held"),
        "cos_eps": ("real", "1", "least cosine of the pitch angles"),
        "u_eps": ("real", "m/s", "least speed in the direction cosines"),
        "phi": ("real[3]", "m/s, rad/s, rad/s", "boundary layers of sliding mode"),
        "angles": ("str", "", "printed or exact"),
        "astern": ("str", "", "what is steered below 0.1 m/s of surge: bow, or the velocity as printed"),
    },
}

TITLES = {
    AgentConfig: "The slice",
    VehicleParams: "`vehicle`",
    GuidanceParams: "`guidance`",
    TrackingParams: "`tracking`",
}


def slice_page() -> str:
    parts = []
    for cls, fields in FIELDS.items():
        rows = ["| key | type | unit | meaning |", "|---|---|---|---|"]
        rows += [f"| {name} | {kind} | {unit} | {meaning} |" for name, (kind, unit, meaning) in fields.items()]
        parts.append(f"### {TITLES.get(cls, f'`{cls.__name__}`')}\n\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)
