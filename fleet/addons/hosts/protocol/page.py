"""The protocol page, generated from the message declarations, so that it cannot fall behind them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from inspect import getdoc
from typing import Any, NamedTuple, get_args

from msgspec import inspect

from agents import compact, message, packets, payload
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
from agents.localization import payload as located
from agents.offset import Offset, OffsetChange
from agents.trajectory import Circle, Path, StraightLine
from netem import modem_frame
from netem.cause import Cause
from netem.fault_kinds import WorldFaultKind
from netem.limits import WIRE_MESSAGE
from netem.modem_news import News
from netem.wire.credentials import LEASE_MS
from netem.wire.fields import Route, WireRecord
from netem.wire.messages import PROTOCOL_VERSION, Message, TimedFault, WorldFault
from world.vehicle_params import VehicleParams

# An agent's slice of the scenario, field by field, for the protocol page; a test compares it with the declarations.


Meaning = tuple[str, str, str]  # type, unit, meaning

_MOST = WIRE_MESSAGE.bytes
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


# A wire type is uint, bool, str, bin, the name of a record or of an enumeration of texts, or an array of one of these
# or of reals: `real[3]` of a declared length, `real[..2]` of at most one, `[*]` of any. A field that may stay open is
# `or nil`.


_SCALARS: dict[type[inspect.Type], str] = {
    inspect.IntType: "uint",
    inspect.FloatType: "real",
    inspect.BoolType: "bool",
    inspect.StrType: "str",
    inspect.NoneType: "nil",
    inspect.BytesType: "bin",
}


class Field(NamedTuple):
    """One field of a message or record."""

    wire: str
    unit: str  # "" when it has none
    meaning: str


def message_kinds() -> dict[str, tuple[type[WireRecord], Route]]:
    """Every kind of message with its class and its route, in the order of declaration."""
    return {cls.__struct_config__.tag: (cls, cls.route) for cls in get_args(Message)}


def records() -> dict[str, type[WireRecord | TimedFault]]:
    """Every record that a field may name, in the order of declaration."""
    found: list[type[WireRecord | TimedFault]] = [
        cls for cls in WireRecord.__subclasses__() if cls.__struct_config__.tag is None
    ]
    return {cls.__name__: cls for cls in (*found, WorldFault)}


def texts() -> dict[str, type[StrEnum]]:
    """Every enumeration of texts that a field may name."""
    return {cls.__name__: cls for cls in (Cause, WorldFaultKind)}


def fields_of(cls: type[WireRecord | TimedFault]) -> dict[str, Field]:
    info = inspect.type_info(cls)
    assert isinstance(info, inspect.StructType)
    return {field.name: _field(field.type) for field in info.fields}


def _field(declared: inspect.Type) -> Field:
    assert isinstance(declared, inspect.Metadata), "a field is declared with `field_meta`"
    unit = (declared.extra or {})["unit"]
    meaning = (declared.extra_json_schema or {})["description"]
    return Field(_wire_type(declared.type), unit, meaning)


def _wire_type(declared: inspect.Type) -> str:
    match declared:
        case inspect.StructType(cls=cls) | inspect.EnumType(cls=cls):
            return cls.__name__
        case inspect.UnionType(types=types):
            return " or ".join(map(_wire_type, types))
        case inspect.VarTupleType(item_type=item, min_length=None, max_length=int(most)):
            return f"{_wire_type(item)}[..{most}]"
        case inspect.VarTupleType(item_type=item, min_length=size):
            return f"{_wire_type(item)}[{'*' if size is None else size}]"
    return _SCALARS[type(declared)]


_HEAD = f"""# Wire protocol, version {PROTOCOL_VERSION}

Generated by `fleet protocol`. A test compares this page with the declarations in `netem/wire/messages.py` and
`agents/config.py`. To write an agent in another language you need only this page. `docs/examples/foreign_agent.py`
is an agent in Python, with `zenoh` and `msgpack` alone, and `docs/examples/c_agent` is an agent in C.
`fleet protocol check --id 3` plays the rest of a run against your agent and judges every message.
`docs/guide/external.md` says how to use it in a run.

## Messages

Every message is a MessagePack array `[kind, field, field, ...]` put on a key below `fleet/<run>/`, with the fields in
the order of the tables below. `uint` is an unsigned integer. `bool`, `str` (at most 4096 characters) and `bin` (bytes)
are MessagePack's own. `real[n]` is an array of n IEEE-754 doubles (`..n`: n at most, `*`: any number), finite unless
stated otherwise; an integer may replace a real. `x[*]` is an array of x, and records are arrays of their fields.

Every field is required, and no further ones are allowed, with these exceptions:

* the last fields of `nav`: `roll` (only for a vehicle with a plant), `clock_ns` (only if the scenario sets a clock) and
  `belief` (only if the vehicle navigates by a filter);
* the last three fields of a `Delivery`, all of them if a modem has measured a range;
* the last field of a `Fate`, in the same way.

An agent may ignore them. **A message has at most {_MOST} bytes**: the transport loses longer ones silently.

Ticks count control periods Ts from the start of the run, and tick k is at time t = k Ts. Round ticks are multiples of
`round_ticks`. If `nav` has a `clock_ns`, the vehicle's own clock shows another time. Computations from the time (the
reference, ages, the `sent_tick` of a payload) then use `clock_ns`, in ticks `clock_ns / tick_ns` rounded down. Answers
to messages still use `tick`. `sent_tick` of a delivery is by the clock of its sender, `due_tick` by simulated time.

Positions are north, east, down (NED) in m, angles in rad (psi from north to east, theta positive nose up), velocities
u, v, w are along the body's axes (forward, starboard, down) over ground.
With roll zero, the velocity over ground is `(cos psi f - sin psi v, sin psi f + cos psi v, cos theta w - sin theta u)`
with `f = cos theta u + sin theta w`. With roll phi, v and w in it are `cos phi v - sin phi w` and
`sin phi v + cos phi w`; without that it is wrong by at most `2 sin(|phi| / 2) sqrt(v^2 + w^2)`.

## Joining

1. Read `join-<i>.json`: `endpoint` (perhaps several with commas between them: try them in turn), `run`, `vehicle`,
   `user`, `password`, `version` (of this protocol), and maybe `lease_ms`, `ca`, `certificate` and `key`. On the
   run's own host it is `unixsock-stream/PATH`, a Unix socket; a zenoh without them needs `fleet run --port`.
2. Open one [zenoh](https://zenoh.io) 1.x session in mode `client`, connected to `endpoint`, with these settings:
   * `transport/auth/usrpwd/user` and `password`;
   * `transport/unicast/lowlatency: true` and `transport/unicast/qos/enabled: false`, as in the router;
   * `transport/link/tx/lease: {LEASE_MS}` ms, so that a process that is suspended for a while stays in the run.
     Between hosts use `lease_ms` instead.

   (Measured: a session with zenoh's defaults for all three is closed.) If there is a `ca`, the endpoint is `tls/...`.
   `ca` is then the certificate to trust: base64 of the PEM is `transport/link/tls/root_ca_certificate_base64`. For
   `certificate` and `key` set `connect_certificate_base64`, `connect_private_key_base64` and `enable_mtls: true` in the
   same way. A wrong password looks like a missing router. A session whose link was cut links again by itself. But its
   messages are lost, and so is this life: you receive `end`, and close the session.

   A zenoh without passwords or without the low-latency transport (zenoh-pico) joins with the folder `join-<i>` instead,
   which `fleet run --listen-certified` writes. `join.conf` has the endpoint and the keys, and `ca.pem`,
   `certificate.pem` and `key.pem` are for mutual TLS (1.3). This session has zenoh's defaults.
3. Query `cfg/<i>` without a payload. The answer is a MessagePack map: `agent` (the slice of the scenario, below),
   `incarnation` (the number of your life; 0 for the first), `begin` (the tick of your first nav, a round tick)
   and `version`. If it has the key `error` instead, you cannot join, and it gives the reason. An answer longer than
   32,000 bytes (an agent with about a hundred neighbours) comes in several replies on the same key, without
   consolidation: join them.
4. Subscribe to `nav/<i>` and `rx/<i>`. Declare publishers on `cmd/<i>` and `tx/<i>`, reliable and with congestion
   control *block*.
5. Put `hello` on `cmd/<i>` and on `tx/<i>`, every 20 to 200 ms, with role `agent`, your number, your incarnation and
   version {PROTOCOL_VERSION}. Stop when a `hello` with `echo` set came on `nav/<i>` (from the world) and on `rx/<i>`
   (from netem). Further echoes may come later, at any time; ignore them. More than 60 a second are refused.
6. Put the same `hello` with `echo` set on `cmd/<i>`, then declare the liveliness token `alive/agent-<i>`. You have
   joined. The first nav comes when all agents have, or when the run has reached `begin`: wait without a limit.

`bundle` and `ended` below are for agents that share a process of the run, and for world and netem; you never get them.

The router lets you put on `cmd/<i>`, `tx/<i>` and `note/agent-<i>`, subscribe to `nav/<i>` and `rx/<i>`, query
`cfg/<i>` and hold your token. Anything else is dropped in silence. A `note` is a line for the operator.

## A tick

The world sends `nav` of tick k. Answer it once, with `cmd` of tick k, and before that, if k is a round tick, with `tx`
of tick k. The next nav comes after your cmd, so at most one is unanswered. Navs are ascending, and mostly consecutive;
an agent that was suspended is not asked for the ticks in between, round ticks included, and sends nothing for them.

**Before you answer nav k, your inbox must be known up to k.** At the start it is known up to `begin`, and empty. Each
`rx` extends it to its `until`, by `round_ticks` at a time: the first comes with `until = begin + round_ticks`. A long
one comes in parts: only when one with `more` false is there is it known up to `until`. An rx may come before the nav
that needs it or after it; nav and rx have no order between them, but each key has. The rx that covers the ticks after
round tick k comes after everybody has put tx of k, yours included.

A delivery counts from its `due_tick` on. At tick k use the deliveries with `due_tick <= k`, once each, and keep the
others, in their order of arrival. `payload` is a payload of the sender's tx. The network may have damaged it (bits
flipped), duplicated it (`copy` above 0), delayed it past later ones, or lost it. Payloads are the agents' own affair;
to understand ours, and be understood, use the payload at the end of this page. A payload of yours goes
to every neighbour that hears you. `tx` without payloads is the null message, and is required: the round waits for it.

`cmd` carries surge force, pitch and yaw moment. The world clips them. `telemetry` is empty, or has all the values that
the laws named in the slice declare; leave it empty.

An answer has no limit of wall time, because simulated time waits. But if the run stands still for the scenario's
`stall_timeout` (30 s), it ends, and names the process that it waited for. For a log that repeats, answer from your
slice, your navs and deliveries alone: no wall clock, and no randomness except from `seed`.

If the answer on `cfg/<i>` says `clock: real`, the run does not wait. Answer the newest `nav` at once with the
deliveries that have come and are due. An `rx` then comes only with content, and its `until` has no meaning.

## The bus of a vehicle

`nav`, `end` and `cmd` are the wires within a vehicle, from its sensors to its agent and from there to its
actuators. For an agent that a run starts in lockstep, with a process of its own, they are a pair of Unix sockets
(`SOCK_SEQPACKET`): a packet is a message. The process inherits its end, so there is no address and no password. The
`hello` to the world and its echo go there, too. Your agent has the keys `nav/<i>` and `cmd/<i>` instead, as agents that
share a process and those on a wall clock. The messages are the same, byte for byte. Agents talk to each other on `tx`
and `rx` in all cases.

## Lives and the end

Messages with a lower incarnation than yours are for a life that is over: ignore them. Malformed messages are dropped,
and the session goes on.

`end` of your incarnation says that no nav follows: the run is over, or a fault killed this agent. Close the session.
If the session loses its router, the run is over too, or broke. Do not reconnect: a lost token ends the life.
Without a token you are dead, and `on_death` of the scenario decides what follows. Another life is another join.

## What is refused

World and netem refuse these messages:

* a message on the wrong key, malformed, or of another incarnation or version;
* `cmd` without an unanswered nav, or of another tick;
* `tx` of a tick that is no round tick, that was exchanged, or that already has one from you;
* telemetry of another size.

They count them in `result.json`, report the first one to the console (`rejected on ...`, among the notes of the run),
and drop them. The correct message is still due.

## What `cfg` tells

The map `agent`; its values are maps, arrays and scalars of MessagePack. Keys may be added in later versions.

{slice_page()}
"""


def page() -> str:
    parts = [_HEAD]
    for kind, (cls, route) in message_kinds().items():
        where = f"Key `{route.key}`, {route.sender} to {route.receiver}."
        parts.append(f"## `{kind}`\n\n{where} {getdoc(cls)}\n\n{_table(fields_of(cls))}")
    parts.append("## Records\n")
    parts += [f"### `{name}`\n\n{getdoc(cls)}\n\n{_table(fields_of(cls))}" for name, cls in sorted(records().items())]
    for name, enum in texts().items():
        parts.append(f"### `{name}`\n\n{getdoc(enum)} One of these texts: {', '.join(f'`{text}`' for text in enum)}.\n")
    parts.append(f"## The payload of our own agents\n\nOpaque to the network.\n\n{getdoc(payload)}\n")
    parts.append(f"### The compact payload\n\n{getdoc(compact)}\n")
    parts.append(f"### The located payload\n\n{getdoc(located)}\n")
    parts.append(f"## Payloads that programs, laws and gateways share\n\n### Messages\n\n{getdoc(message)}\n")
    parts.append(f"### Packets\n\n{getdoc(packets)}\n")
    parts.append(f"### Modems\n\n{getdoc(modem_frame)}\n\nThe news:\n")
    parts += [f"* `{_news(cls)}`: {getdoc(cls)}" for cls in get_args(News)]
    parts.append("")
    return "\n".join(parts)


def _news(cls: Any) -> str:
    """The list that stands for a piece of news: its tag, and its fields."""
    return f"[{', '.join([str(cls.__struct_config__.tag), *cls.__struct_fields__])}]"


def _table(fields: Mapping[str, Field]) -> str:
    rows = ["| field | type | unit | meaning |", "|---|---|---|---|"]
    rows += [f"| {name} | {field.wire} | {field.unit} | {field.meaning} |" for name, field in fields.items()]
    return "\n".join(rows) + "\n"
