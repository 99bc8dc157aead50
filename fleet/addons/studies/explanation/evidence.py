"""Evidence from a log about the time of a failed check: faults, missing messages, and the knowledge of vehicles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from math import hypot, inf, isfinite
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from agents import payload
from agents.errors import PayloadError
from agents.localization.payload import decode as decode_located
from agents.localization.payload import is_located
from fleet.logs.open_log import Log
from fleet.logs.topic import Topic
from fleet.logs.topic_names import link_topic
from fleet.mcap.reader import LogReadError
from fleet.scenario.sections.fault_entry import entry_kind, entry_vehicles
from fleet.scenario.sections.signals import parse_name
from netem.cause import Cause
from netem.condition import Link
from netem.lives import Absence, Lives

TOPICS = ("uuv/*/state", "uuv/*/belief", "uuv/*/located", "uuv/*/control", "uuv/*/guidance", "uuv/*/error",
          "uuv/*/command", "uuv/*/clock", "uuv/*/plant", "uuv/*/nav", "faults", "link/*")  # fmt: skip
MOST_GAPS = 400  # that are kept, those that explain most
_FADES = 0.1  # seconds of silence that each second since its end makes up for: chosen
_MOST_SIGNALS = 8  # of one vehicle
_OF_AGENTS = ("command", "state", "control")  # the first topic that there is tells whether an agent reports
_UNUSUAL = 2.5  # times the usual time between two sendings: chosen
ON_THE_WAY = "on the way"
NOT_SENT = "not sent"
CORRUPTED = "corrupted"
# Why a message did not arrive, in words.
CAUSES: dict[str, str] = {
    Cause.LOSS: "lost on the link",
    Cause.DOWN: "the link was down",
    Cause.PARTITION: "the two sides were parted",
    Cause.MUTE: "the sender was mute",
    Cause.QUEUE: "the queue was full",
    Cause.REPLACED: "the modem sent a newer one in its place",
    Cause.MTU: "too long for the modem",
    Cause.RANGE: "out of the modem's range",
    Cause.HALF_DUPLEX: "the receiver's modem was sending",
    Cause.COLLISION: "two transmissions met",
    Cause.SNR: "too weak against the noise",
    Cause.DEAD_SENDER: "the sender's agent was gone",
    Cause.DEAF: "the receiver was deaf",
    Cause.DEAD_RECEIVER: "the receiver's agent was gone",
    Cause.RECEIVER: "the receiver's program did not take it",
    CORRUPTED: "it arrived damaged",
    ON_THE_WAY: "still in flight",
    NOT_SENT: "the sender sent nothing",
}


class FaultThen(Struct, frozen=True):
    """A fault that had begun when the check failed."""

    id: str
    what: str
    from_s: float
    to_s: Annotated[float, Meta(description="When it ended, or the log does.")]
    on: Annotated[bool, Meta(description="Whether it was on when the check failed.")]


class Gap(Struct, frozen=True):
    """Consecutive messages on one link, or on several at the same time, that did not arrive or were never sent."""

    links: list[str]
    cause: Annotated[
        str, Meta(description="Of most losses: a fate of the log, `corrupted`, `on the way`, or `not sent`.")
    ]
    words: str
    from_s: Annotated[float, Meta(description="When the first was sent; of `not sent`: the last before the silence.")]
    to_s: Annotated[float, Meta(description="When the last was sent; of `not sent`: the first after it.")]
    messages: Annotated[int, Meta(description="Of all links together.")]
    goes_on: Annotated[bool, Meta(description="Still silent when the check failed.")]


class Heard(Struct, frozen=True):
    """A vehicle's knowledge of a neighbour."""

    vehicle: int
    sent_s: Annotated[float | None, Meta(description="When the newest message that arrived was sent; null: none.")]
    age_s: float | None
    moved_m: Annotated[
        float | None, Meta(description="How far the neighbour had moved since that message [m]; null: unknown.")
    ]


class VehicleThen(Struct, frozen=True):
    """A vehicle's knowledge when the check failed."""

    vehicle: int
    life: Annotated[int, Meta(description="Which agent of the vehicle this is, from 1; kills end them.")]
    life_since_s: float
    silent_s: Annotated[float | None, Meta(description="How long it had reported nothing; null: it did report.")]
    heard: Annotated[list[Heard], Meta(description="Of each neighbour.")]
    off_m: Annotated[float | None, Meta(description="Believed minus true position; null: it knew its place.")]
    sd_m: Annotated[float | None, Meta(description="Its own estimate of that error, north and east.")]
    signals: dict[str, float | None]


class Evidence(NamedTuple):
    """Faults, gaps, losses and knowledge, all at the time when the check failed."""

    faults: list[FaultThen]
    gaps: list[Gap]
    lost: dict[str, int]  # messages by cause
    sent: int  # messages in all
    vehicles: list[VehicleThen]


def evidence(
    log: Log,
    at_s: float,
    signals: Sequence[str],
    failing: Collection[int] = (),
    *,
    protocol: bool,
    nodes: Sequence[str] = (),
    moves: bool = True,
) -> Evidence:
    """Collect the evidence of a log about a time.

    Args:
        log: the log.
        at_s: the time [s].
        signals: the signals of the check.
        failing: the vehicles that failed it; their silences come first.
        protocol: whether to add the signals of the agents' own protocol.
        nodes: the names of nodes, by which the log names them; none: the log is of vehicles.
        moves: whether the vehicles have places in a formation, and so errors; moored ones have none.
    """
    faults = [FaultThen(f.id, f.what, f.begin, f.end, f.end > at_s) for f in log.faults if f.begin <= at_s]
    each = {link: _Packets.of(log[link_topic(link)], at_s) for link in log.links}
    numbers = log.vehicles or sorted({i for link in log.links for i in link})  # nodes have no topics of their own
    kills = [fault for fault in log.faults if entry_kind(fault.entry) == "kill" and fault.end < log.end]
    lives = Lives(Absence(i, _ns(one.begin), _ns(one.end)) for one in kills for i in entry_vehicles(one.entry))
    lost: Counter[str] = Counter()
    for packets in each.values():
        lost.update(cause for cause in packets.causes if cause)
    units = None if nodes else ("1", "s")  # of programs every number, of agents what may be one of their protocol
    vehicles = [_vehicle(log, i, at_s, each, signals, lives, units, protocol=protocol, moves=moves) for i in numbers]
    pauses = _pauses(each, at_s)
    gaps, sent = _gaps(each, at_s, failing, pauses), sum(len(packets.sent) for packets in each.values())
    return Evidence(faults, gaps, dict(lost.most_common()), sent, vehicles)


def first_older(
    log: Log, links: Collection[Link], below_s: float, after_s: float, end_s: float, *, from_first_packet: bool
) -> tuple[float, Link] | None:
    """When the newest that had arrived on one of these links was first as old as a limit, and the link; None: never.

    Args:
        log: the log.
        links: the links.
        below_s: the limit [s].
        after_s: earlier times do not count [s].
        end_s: when the run ended [s].
        from_first_packet: whether the age of a link counts from its first packet, and not from the beginning.
    """
    found: list[tuple[float, Link]] = []
    for link in set(links).intersection(log.links):
        topic = log[link_topic(link)]
        if from_first_packet and not len(topic):
            continue  # its age has not begun
        whole = (topic["fate"] == Cause.DELIVERED) & ~np.asarray(topic["corrupted"], bool)
        arrivals = sorted(zip(topic["due"][whole].tolist(), topic["sent"][whole].tolist(), strict=True))
        heard_s = arrived_s = float(topic["sent"].min()) if from_first_packet else log.begin
        for due_s, sent_s in [*arrivals, (inf, inf)]:
            broken_s = max(heard_s + below_s, arrived_s, after_s)
            if broken_s < due_s - 1e-9 and broken_s <= end_s + 1e-9:
                found.append((broken_s, link))
                break
            heard_s, arrived_s = max(heard_s, sent_s), due_s
    return min(found, default=None)


class _Packets(NamedTuple):
    """The packets of one link that were sent up to a time, in order."""

    sent: list[float]
    causes: list[str]  # why each did not arrive; empty: it did
    newest: bytes | None  # payload of the newest that arrived whole
    usual_s: float  # of those that arrived, how long they were on the way

    @classmethod
    def of(cls, topic: Topic, at_s: float) -> _Packets:
        if not len(topic):
            return cls([], [], None, 0.0)
        causes: dict[int, tuple[float, str, int]] = {}  # by number: sent, why not, row
        names = ("seq", "sent", "due", "fate", "corrupted")
        rows = zip(topic.t.tolist(), *(topic[name].tolist() for name in names), strict=True)
        for row, (settled, seq, sent, due, fate, corrupted) in enumerate(rows):
            if sent > at_s:
                continue
            # What the log says of it later, such as that nobody was there when it came, had not happened yet.
            under_way = fate == Cause.IN_FLIGHT or max(due if fate == Cause.DELIVERED else sent, settled) > at_s
            cause = ON_THE_WAY if under_way else CORRUPTED if corrupted else "" if fate == Cause.DELIVERED else fate
            if seq not in causes or not cause:  # of copies one that arrives counts
                causes[seq] = sent, cause, row
        ordered = [causes[seq] for seq in sorted(causes)]
        arrived = [one for one in ordered if not one[1]]
        newest = topic["payload"][arrived[-1][2]] if arrived and "payload" in topic else None
        came = [row for _, _, row in arrived]
        usual_s = float(np.median(topic["due"][came] - topic["sent"][came])) if came else 0.0
        return cls([sent for sent, *_ in ordered], [cause for _, cause, _ in ordered], newest, usual_s)

    def last_arrived(self) -> float | None:
        """When the newest that arrived was sent [s]."""
        return next((s for s, cause in zip(reversed(self.sent), reversed(self.causes), strict=True) if not cause), None)

    def gaps(self, pauses: Collection[float]) -> Iterator[tuple[float, float, str, int, bool]]:
        """Each gap: first and last sending [s], cause, number of messages, and whether it goes on. `pauses`: when the
        sender had sent for the last time before it was silent; a gap ends there, too."""
        begin, found = 0, Counter[str]()
        for k, cause in enumerate([*self.causes, ""]):
            if found and self.sent[k - 1] in pauses:
                yield self.sent[begin], self.sent[k - 1], found.most_common(1)[0][0], k - begin, False
                found = Counter()
            if cause:
                begin = begin if found else k
                found[cause] += 1
            elif found:
                yield self.sent[begin], self.sent[k - 1], found.most_common(1)[0][0], k - begin, k == len(self.causes)
                found = Counter()


def _pauses(each: Mapping[Link, _Packets], at_s: float) -> dict[int, list[tuple[float, float]]]:
    """By sender: from when to when it sent nothing on any link, for much longer than is usual for it [s].

    As it stops, dies or is paused; and a law of its own may choose to send nothing.
    """
    sent: dict[int, set[float]] = {}
    for (src, _), packets in each.items():
        sent.setdefault(src, set()).update(packets.sent)
    found = {}
    for src, some in sent.items():
        times = sorted(some)
        usual = float(np.quantile(np.diff(times), 0.95)) if len(times) > 1 else 0.0
        found[src] = [(a, b) for a, b in pairwise([*times, at_s]) if b - a > _UNUSUAL * usual]
    return found


def _gaps(
    each: dict[Link, _Packets], at_s: float, failing: Collection[int], pauses: Mapping[int, list[tuple[float, float]]]
) -> list[Gap]:
    """The gaps of all links, by how much they explain. Equal gaps are one.

    First come senders that are silent still. Then come those by which a vehicle that failed heard or said nothing.
    Among them the longest comes first. One that has long been over counts for less, and messages on the way count for
    as much as they take longer than others of their link.
    """
    together: dict[tuple[float, float, str, bool], list[tuple[str, int]]] = {}
    for (src, dst), packets in each.items():
        for first, last, cause, messages, goes_on in packets.gaps({begin for begin, _ in pauses[src]}):
            together.setdefault((first, last, cause, goes_on), []).append((f"{src}->{dst}", messages))
        for begin, end in pauses[src]:
            together.setdefault((begin, end, f"{NOT_SENT} {src}", end == at_s), []).append((f"{src}->{dst}", 0))
    gaps = [
        _gap([link for link, _ in links], cause, first, last, sum(n for _, n in links), goes_on=on)
        for (first, last, cause, on), links in together.items()
    ]

    def rank(gap: Gap) -> tuple[Any, ...]:
        stopped = gap.cause == NOT_SENT and gap.goes_on
        ends = [tuple(map(int, link.split("->"))) for link in gap.links]
        touched = any(dst in failing or (gap.cause == NOT_SENT and src in failing) for src, dst in ends)
        silence = gap.to_s - gap.from_s - (0.0 if gap.goes_on else _FADES * (at_s - gap.to_s))
        if gap.cause == ON_THE_WAY:
            silence -= min(each[src, dst].usual_s for src, dst in ends)
        return not stopped, not touched, -silence, gap.from_s, gap.links

    return sorted(gaps, key=rank)[:MOST_GAPS]


def _gap(links: list[str], cause: str, first: float, last: float, messages: int, *, goes_on: bool) -> Gap:
    cause = NOT_SENT if cause.startswith(NOT_SENT) else cause
    return Gap(links, cause, CAUSES.get(cause, cause), first, last, messages, goes_on)


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)


def _vehicle(
    log: Log,
    i: int,
    at_s: float,
    each: dict[Link, _Packets],
    signals: Sequence[str],
    lives: Lives,
    units: Collection[str] | None,
    *,
    protocol: bool,
    moves: bool,
) -> VehicleThen:
    heard = [_heard(log, src, packets, at_s) for (src, dst), packets in each.items() if dst == i]
    shown: dict[str, float | None] = {}
    names = [name for name in map(parse_name, signals) if name is not None]
    for name in names:
        group, _, field = name.name.partition(".")
        value = _value(log, f"uuv/{i}/{group}", field, at_s, absolute=name.absolute)
        if value is not None:
            shown[str(name)] = value
    if protocol and (topic := _there(log, f"uuv/{i}/control")) is not None:
        for field, unit in topic.units.items():
            fits = units is None or unit in units
            if fits and f"control.{field}" not in shown and topic[field].ndim == 1:
                shown[f"control.{field}"] = _value(log, topic.name, field, at_s)
    where = _value(log, f"uuv/{i}/error", "formation_norm", at_s) if moves else None
    if where is not None:
        shown.setdefault("error.formation_norm", where)
    state = next((t for group in _OF_AGENTS if (t := _there(log, f"uuv/{i}/{group}")) is not None), None)
    k = -1 if state is None else _sample(state, at_s)
    silent = at_s - float(state.t[k]) if state is not None and _is_over(state, k, at_s) else None
    group = "located" if _there(log, f"uuv/{i}/located") is not None else "belief"
    sd = _value(log, f"uuv/{i}/{group}", "sd", at_s, absolute=True, width=2)
    off = _value(log, f"uuv/{i}/{group}", "off_norm", at_s)
    before = [end for _, end in lives.gaps(i) if end is not None and end <= _ns(at_s)]
    since_s = before[-1] / 1e9 if before else log.begin
    return VehicleThen(i, 1 + len(before), since_s, silent, heard, off, sd, dict(list(shown.items())[:_MOST_SIGNALS]))


def _heard(log: Log, src: int, packets: _Packets, at_s: float) -> Heard:
    sent = packets.last_arrived()
    if sent is None:
        return Heard(src, None, None, None)
    told, moved = _told(packets.newest), None
    if told is not None and (state := _there(log, f"uuv/{src}/state")) is not None and (k := _sample(state, at_s)) >= 0:
        moved = hypot(*(float(state[name][k]) - p for name, p in zip("xyz", told, strict=True)))
    return Heard(src, sent, at_s - sent, moved)


def _told(data: bytes | None) -> tuple[float, float, float] | None:
    """The place in a state message; None: it is no state message, or a compact one without an absolute place."""
    if data is None:
        return None
    try:
        message = decode_located(data).state if is_located(data) else payload.decode(data)
    except PayloadError:
        return None
    x, y, z = message.position
    return x, y, z


def _there(log: Log, name: str) -> Topic | None:
    return log[name] if name in log and len(log[name]) else None


def _sample(topic: Topic, at_s: float) -> int:
    return int(np.searchsorted(topic.t, at_s + 1e-9, "right")) - 1


def _is_over(topic: Topic, k: int, at_s: float) -> bool:
    """Whether a sample is so old at a time that whoever reports it was silent then: its value ended with it."""
    step = float(np.median(np.diff(topic.t))) if len(topic) > 1 else 0.0
    return k >= 0 and at_s - float(topic.t[k]) > 2.5 * step


def _value(log: Log, name: str, field: str, at_s: float, *, absolute: bool = False, width: int = 0) -> float | None:
    """A signal at a time; None: it has no finite value, or nobody reports it any more."""
    if (topic := _there(log, name)) is None:
        return None
    if field not in topic:  # the component of a vector
        field, _, part = field.rpartition("_")
        if field not in topic or not part.isdecimal():
            return None
    else:
        part = ""
    try:
        values: Any = topic[field]
    except LogReadError:
        return None
    if (k := _sample(topic, at_s)) < 0 or _is_over(topic, k, at_s):
        return None
    found = np.atleast_1d(values[k])
    if part:
        found = found[int(part) : int(part) + 1]
    found = found[:width] if width else found
    if not len(found) or (len(found) > 1 and not absolute):
        return None  # a vector has no one value
    value = hypot(*map(float, found)) if absolute else float(found[0])
    return value if isfinite(value) else None
