"""Every message of a run, declared once: field, meaning, unit.

A message is a MessagePack array `[kind, field, field, ...]` in the declared order. The encoder, the strict decoder
(`netem.wire.codec`) and the protocol page (`fleet protocol`) follow from the declarations in this file.

Integers are unsigned; reals are IEEE-754 doubles (an integer is accepted where a real is expected, because
some languages' MessagePack writes 1.0 as 1). Ticks count control periods Ts from the start of the run.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Struct

from netem.cause import Cause
from netem.fault_kinds import WorldFaultKind
from netem.wire.fields import (
    Real,
    Reals,
    Reals2,
    Reals3,
    Reals5,
    Reals10,
    RealsTo2,
    Route,
    Text,
    Uint,
    WireRecord,
    field_meta,
)

PROTOCOL_VERSION = 2
RUN_OVER = "the run is over"  # the reason of nearly every End


class Delivery(WireRecord, frozen=True):
    """One payload that reaches an agent."""

    due_tick: Annotated[Uint, field_meta("first tick of use by the receiver", "tick")]
    sent_tick: Annotated[Uint, field_meta("round tick of sending, by the clock of its sender", "tick")]
    src: Annotated[Uint, field_meta("sending vehicle")]
    seq: Annotated[Uint, field_meta("number of the payload on its directed link, from 0")]
    copy: Annotated[Uint, field_meta("0 for the original, 1.. for duplicates made by the network")]
    payload: Annotated[bytes, field_meta("opaque to the network")]
    range_m: Annotated[
        Real | None, field_meta("to the sender, as the modem measured it; **left out** without a range", "m")
    ] = None
    range_sd_m: Annotated[Real | None, field_meta("its standard deviation, as the modem knows it; likewise", "m")] = (
        None
    )
    range_tick: Annotated[Uint | None, field_meta("when the vehicles were so far apart; likewise", "tick")] = None


class MeasuredRange(WireRecord, frozen=True):
    """The distance of two vehicles, as a modem measured it."""

    range_m: Annotated[Real, field_meta("as measured", "m")]
    sd_m: Annotated[Real, field_meta("its standard deviation, as the modem knows it", "m")]
    tick: Annotated[Uint, field_meta("when the vehicles were so far apart", "tick")]
    distance_m: Annotated[Real, field_meta("their true distance", "m")]


class Fate(WireRecord, frozen=True):
    """The one, final record of a packet: netem writes it at the tick where the fate became final."""

    final_tick: Annotated[Uint, field_meta("due tick if delivered, drop tick if lost, end tick if in flight", "tick")]
    src: Annotated[Uint, field_meta("sending vehicle")]
    dst: Annotated[Uint, field_meta("receiving vehicle")]
    seq: Annotated[Uint, field_meta("number of the payload on its directed link, from 0")]
    copy: Annotated[Uint, field_meta("0 for the original, 1.. for duplicates")]
    sent_tick: Annotated[Uint, field_meta("round tick at which it was sent", "tick")]
    due_tick: Annotated[Uint, field_meta("first tick of use, real or planned", "tick")]
    delay_ns: Annotated[Uint, field_meta("drawn delay of the link, before rounding up to ticks", "ns")]
    cause: Annotated[Cause, field_meta("delivered, in flight, or the cause of its loss")]
    corrupted: Annotated[bool, field_meta("whether the link changed the payload")]
    payload: Annotated[bytes, field_meta("the payload's bytes")]
    measured: Annotated[MeasuredRange | None, field_meta("of one that was delivered; **left out** without a range")] = (
        None
    )


class Fix(WireRecord, frozen=True):
    """A fix of a vehicle's position, when its navigation got it."""

    source: Annotated[Text, field_meta("gps, usbl or lbl")]
    measured: Annotated[Uint, field_meta("when it was measured", "tick")]
    tick: Annotated[Uint, field_meta("when it was there", "tick")]
    position: Annotated[Reals2, field_meta("north, east", "m")]
    sigma: Annotated[Real, field_meta("standard deviation that it has by itself, on each axis", "m")]
    nis: Annotated[
        Real, field_meta("its innovation squared, normalised by the filter's covariance, 2 degrees of freedom")
    ]
    used: Annotated[bool, field_meta("false when the filter refused it")]


class VehicleFrame(WireRecord, frozen=True):
    """One vehicle at one tick, as the world computed it."""

    id: Annotated[Uint, field_meta("vehicle number")]
    eta: Annotated[Reals5, field_meta("true x, y, z (NED), theta, psi", "m, rad")]
    nu: Annotated[Reals5, field_meta("true u, v, w (body, over ground), q, r", "m/s, rad/s")]
    nav: Annotated[Reals, field_meta("what its sensor reported: eta, nu, and roll if it has it; empty when not sensed")]
    tau: Annotated[Reals, field_meta("applied thrust and moments after limits; empty at the end", "N, N m")]
    command: Annotated[bytes, field_meta("the agent's Command message, without what it said; empty when none")]
    plant: Annotated[Reals, field_meta("true phi, p and what its plant reports, in that order; empty without a plant")]
    clock: Annotated[Reals, field_meta("by how much its clock is ahead; empty while all clocks are right", "s")]
    belief: Annotated[Reals, field_meta("covariance of what it reported, as in nav; empty where nav has none")]
    fixes: Annotated[tuple[Fix, ...], field_meta("fixes of its navigation since the frame before")]


class Arrival(WireRecord, frozen=True):
    """When one delivery came to its receiver."""

    src: Annotated[Uint, field_meta("sending vehicle")]
    seq: Annotated[Uint, field_meta("number of the payload on its directed link")]
    copy: Annotated[Uint, field_meta("0 for the original, 1.. for duplicates")]
    at_ns: Annotated[Uint, field_meta("when it came in, by CLOCK_MONOTONIC of the agent's host", "ns")]


class Life(WireRecord, frozen=True):
    """A vehicle lost its agent, or got another one."""

    tick: Annotated[Uint, field_meta("first tick without, or with", "tick")]
    vehicle: Annotated[Uint, field_meta("vehicle number")]
    begins: Annotated[bool, field_meta("true when another agent takes over")]
    diverged: Annotated[
        bool, field_meta("true when the vehicle's motion left the finite numbers: it is not integrated any more")
    ]


class Tumble(WireRecord, frozen=True):
    """A vehicle's pitch went beyond its limit, or came back."""

    tick: Annotated[Uint, field_meta("first tick at which it is so", "tick")]
    vehicle: Annotated[Uint, field_meta("vehicle number")]
    begins: Annotated[bool, field_meta("false when the vehicle has come back")]
    number: Annotated[Uint, field_meta("how often it has tumbled, this time included")]


OUT, ERR, END, FAILED = "out", "err", "end", "failed"  # streams of what is said: printed twice, and how it ended


class Said(WireRecord, frozen=True):
    """A line that an agent said: what its program printed, or how that ended."""

    at_ns: Annotated[Uint, field_meta("when, from the beginning of the run", "ns")]
    stream: Annotated[Text, field_meta("out, err; end, or failed: how its program ended, which is then no more")]
    text: Annotated[Text, field_meta("without its line break")]


class SaidBy(WireRecord, frozen=True):
    """A line, and who said it."""

    vehicle: Annotated[Uint, field_meta("vehicle number")]
    said: Annotated[Said, field_meta("the line")]


class Frame(WireRecord, frozen=True):
    """All vehicles at one tick; the log's source."""

    tick: Annotated[Uint, field_meta("control tick; consecutive on this key", "tick")]
    more: Annotated[bool, field_meta("more vehicles of the same tick follow")]
    lives: Annotated[tuple[Life, ...], field_meta("since the frame before; with the first part")]
    tumbles: Annotated[tuple[Tumble, ...], field_meta("likewise")]
    vehicles: Annotated[tuple[VehicleFrame, ...], field_meta("ascending by id")]
    said: Annotated[
        tuple[SaidBy, ...], field_meta("since the frame before, by vehicle; each vehicle's in its order")
    ] = ()


class TimedFault(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """The fields of all faults: a name, a beginning and an end."""

    id: Annotated[Text, field_meta("name of the fault, unique in a run")]
    begin: Annotated[Uint, field_meta("first tick at which it acts", "tick")]
    end: Annotated[Uint | None, field_meta("first tick after the fault; nil: it lasts to the end", "tick")]

    def active(self, tick: int) -> bool:
        """Whether the fault acts at a tick."""
        return self.begin <= tick and (self.end is None or tick < self.end)


class WorldFault(TimedFault, frozen=True):
    """A fault of sensors, actuators or sea."""

    kind: Annotated[WorldFaultKind, field_meta("what it does")]
    vehicles: Annotated[tuple[Uint, ...], field_meta("the vehicles concerned; empty: all")]
    values: Annotated[Reals, field_meta("the numbers of its kind, in their order")]

    def concerns(self, i: int) -> bool:
        """Whether the fault acts on vehicle i."""
        return not self.vehicles or i in self.vehicles


class BundlePart(WireRecord, frozen=True):
    """A message of, or for, one of several agents that share a process."""

    vehicle: Annotated[Uint, field_meta("vehicle number")]
    message: Annotated[bytes, field_meta("one that would travel on the agent's own key")]


class Hello(WireRecord, frozen=True, tag="hello"):
    """Readiness probe; whoever receives one on its own key answers with `echo` set."""

    route: ClassVar[Route] = Route("any", "any", "any")

    role: Annotated[Text, field_meta("agent, world, netem or console")]
    id: Annotated[Uint, field_meta("vehicle number; 0 for other roles")]
    incarnation: Annotated[Uint, field_meta("0 for the first life of an agent, then 1, 2, ...")]
    version: Annotated[Uint, field_meta("protocol version")]
    echo: Annotated[bool, field_meta("true in the answer")]


class Nav(WireRecord, frozen=True, tag="nav"):
    """The vehicle's own measured or believed pose and velocity at a tick, and no others."""

    route: ClassVar[Route] = Route("nav/{i}", "world", "agent i")

    incarnation: Annotated[Uint, field_meta("life of the agent it is meant for")]
    tick: Annotated[Uint, field_meta("control tick; consecutive on this key", "tick")]
    eta: Annotated[Reals5, field_meta("x, y, z (NED), theta, psi (unwrapped)", "m, rad")]
    nu: Annotated[Reals5, field_meta("u, v, w (body, over ground), q, r", "m/s, rad/s")]
    roll: Annotated[
        RealsTo2, field_meta("phi, p; **left out** without roll, or empty before `clock_ns`", "rad, rad/s")
    ] = ()
    clock_ns: Annotated[
        Uint | None,
        field_meta(
            "what the vehicle's clock shows; **left out** while all clocks are right, or nil before `belief`", "ns"
        ),
    ] = None
    belief: Annotated[
        Reals10,
        field_meta(
            "covariance of x, y, z, psi: upper triangle, row by row; **left out** without a filter", "m^2, m rad, rad^2"
        ),
    ] = ()


class End(WireRecord, frozen=True, tag="end"):
    """No Nav follows for this life of the agent, which closes its session. Only external agents get it."""

    route: ClassVar[Route] = Route("nav/{i}", "world", "agent i")

    incarnation: Annotated[Uint, field_meta("life of the agent that is over; of a later one this says nothing")]
    tick: Annotated[Uint, field_meta("first tick without it; of no meaning when the run is over", "tick")]
    reason: Annotated[Text, field_meta("one line for a person")]


class Command(WireRecord, frozen=True, tag="cmd"):
    """The agent's answer to Nav of the same tick."""

    route: ClassVar[Route] = Route("cmd/{i}", "agent i", "world")

    incarnation: Annotated[Uint, field_meta("life of the sending agent")]
    tick: Annotated[Uint, field_meta("tick of the Nav it answers", "tick")]
    tau: Annotated[Reals3, field_meta("surge force, pitch moment, yaw moment", "N, N m")]
    telemetry: Annotated[
        tuple[float, ...], field_meta("controller signals in their declared order, or none at all; need not be finite")
    ]
    said: Annotated[tuple[Said, ...], field_meta("lines for the log, in order; **left out** without any")] = ()


class Transmission(WireRecord, frozen=True, tag="tx"):
    """The agent's payloads at a round tick; an empty list is the null message and is required."""

    route: ClassVar[Route] = Route("tx/{i}", "agent i", "netem")

    incarnation: Annotated[Uint, field_meta("life of the sending agent")]
    tick: Annotated[Uint, field_meta("round tick", "tick")]
    payloads: Annotated[tuple[bytes, ...], field_meta("each goes to every graph neighbour")]


class Receipt(WireRecord, frozen=True, tag="receipt"):
    """In a realtime run: the deliveries that an agent used at a tick, and when they had come. Optional."""

    route: ClassVar[Route] = Route("tx/{i}", "agent i", "netem")

    incarnation: Annotated[Uint, field_meta("life of the sending agent")]
    tick: Annotated[Uint, field_meta("of the Nav of their first use", "tick")]
    arrivals: Annotated[tuple[Arrival, ...], field_meta("in the order in which they were used")]


class Inbox(WireRecord, frozen=True, tag="rx"):
    """All that will be delivered to the agent after its previous inbox's `until`, up to this one's."""

    route: ClassVar[Route] = Route("rx/{i}", "netem", "agent i")

    incarnation: Annotated[Uint, field_meta("life of the agent it is meant for")]
    until: Annotated[Uint, field_meta("the inbox is known up to this tick", "tick")]
    more: Annotated[bool, field_meta("more deliveries of the same inbox follow")]
    deliveries: Annotated[tuple[Delivery, ...], field_meta("ordered by (due, sent, src, seq, copy)")]


class Round(WireRecord, frozen=True, tag="round"):
    """All commands of a round tick have come: which vehicles are alive, and where."""

    route: ClassVar[Route] = Route("tx/round", "world", "netem")

    tick: Annotated[Uint, field_meta("round tick", "tick")]
    alive: Annotated[tuple[Uint, ...], field_meta("vehicles alive at the tick, ascending")]
    positions: Annotated[tuple[Reals3, ...], field_meta("true x, y, z (NED) of each alive vehicle", "m")]
    paused: Annotated[tuple[Uint, ...], field_meta("those of them that are suspended: no transmission comes")]
    more: Annotated[bool, field_meta("more vehicles of the same round follow; **left out** in the last part")] = False


class Pace(WireRecord, frozen=True, tag="pace"):
    """In a realtime run: when ticks begin; put before the Round of the same tick."""

    route: ClassVar[Route] = Route("tx/round", "world", "netem")

    tick: Annotated[Uint, field_meta("round tick", "tick")]
    at_ns: Annotated[Uint, field_meta("when it begins, by CLOCK_MONOTONIC of the world's host", "ns")]
    period_ns: Annotated[Uint, field_meta("of wall time per tick, until the next Pace", "ns")]


class Frames(WireRecord, frozen=True, tag="frames"):
    """Consecutive frames in one message: while the world is busy it saves a message per tick."""

    route: ClassVar[Route] = Route("frame", "world", "console")

    frames: Annotated[tuple[Frame, ...], field_meta("ascending by tick")]


class LinkReport(WireRecord, frozen=True, tag="links"):
    """The fates that became final after the `until` of the previous report, and by the `until` of this one."""

    route: ClassVar[Route] = Route("links", "netem", "console")

    until: Annotated[Uint, field_meta("fates are complete up to this tick", "tick")]
    closing: Annotated[bool, field_meta("true for the last report of a run")]
    more: Annotated[bool, field_meta("more fates of the same report follow")]
    fates: Annotated[tuple[Fate, ...], field_meta("ordered by (final, src, dst, seq, copy)")]


class Grant(WireRecord, frozen=True, tag="grant"):
    """Ticks below `until` may be started."""

    route: ClassVar[Route] = Route("cmd/grant", "console", "world")

    until: Annotated[Uint, field_meta("state `until` will exist, Nav(`until`) is not sent", "tick")]


class Death(WireRecord, frozen=True, tag="death"):
    """An agent has ended, or will: from a tick on its vehicle is not waited for any more."""

    route: ClassVar[Route] = Route("cmd/grant", "console", "world")

    vehicle: Annotated[Uint, field_meta("vehicle number")]
    tick: Annotated[
        Uint | None, field_meta("first tick without an agent; nil: the process has ended, the next", "tick")
    ]
    incarnation: Annotated[Uint, field_meta("the life that ended, if it has")]
    until: Annotated[
        Uint | None, field_meta("round tick of the takeover by another agent; nil: no other than planned", "tick")
    ]


class Restart(WireRecord, frozen=True, tag="restart"):
    """Another agent takes a vehicle over earlier than planned; that tick is not granted before it is ready."""

    route: ClassVar[Route] = Route("cmd/grant", "console", "world")

    vehicle: Annotated[Uint, field_meta("vehicle number")]
    begin: Annotated[Uint | None, field_meta("since when it has none; nil: since whenever", "tick")]
    tick: Annotated[Uint, field_meta("round tick, its first sample", "tick")]


class WorldFaults(WireRecord, frozen=True, tag="faults"):
    """The faults of sensors, actuators and sea, all of them: they replace those sent before."""

    route: ClassVar[Route] = Route("cmd/grant", "console", "world")

    faults: Annotated[tuple[WorldFault, ...], field_meta("in the order in which they begin")]


class Note(WireRecord, frozen=True, tag="note"):
    """A line for the operator: a rejected message, a failed controller, a counter."""

    route: ClassVar[Route] = Route("note", "world, netem, agents", "console")

    role: Annotated[Text, field_meta("the sending process")]
    subject: Annotated[Uint, field_meta("vehicle concerned; 0 for none")]
    tick: Annotated[Uint, field_meta("tick at which it was noticed", "tick")]
    text: Annotated[Text, field_meta("one line")]


class Bundle(WireRecord, frozen=True, tag="bundle"):
    """Messages of several agents that share a process, in one put. You never get it."""

    route: ClassVar[Route] = Route(
        "host/{h}, cmd/host-{h}, tx/host-{h}", "world and netem, host h", "host h, world, netem"
    )

    parts: Annotated[tuple[BundlePart, ...], field_meta("those of one agent in their order")]


class Ended(WireRecord, frozen=True, tag="ended"):
    """One of several agents that share a process has ended; the others continue."""

    route: ClassVar[Route] = Route("note/host-{h}", "host h", "console")

    vehicle: Annotated[Uint, field_meta("vehicle number")]
    status: Annotated[Uint, field_meta("with which a process of its own would have ended")]


Message = (
    Hello
    | Nav
    | End
    | Command
    | Transmission
    | Receipt
    | Inbox
    | Round
    | Pace
    | Frames
    | LinkReport
    | Grant
    | Death
    | Restart
    | WorldFaults
    | Note
    | Bundle
    | Ended
)
