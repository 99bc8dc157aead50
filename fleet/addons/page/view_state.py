"""From journal to picture: the messages of a run, live or logged, become what a page draws.

The state is a pure function of the messages that it was given: no clock, no socket. A frame is a dict of plain values
for JSON, small enough for twenty a second; what stays the same for the whole run is in `setup`, once. Positions are
in m, north-east-down; times in s of simulated time.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from math import dist
from typing import Any

from fleet.addons.page.on_air import OnAir
from fleet.logs.fault_intervals import FaultMessage
from fleet.logs.payload_kinds import DAMAGED, kind_of
from fleet.recorder.scene.belief import NewestBeliefs
from fleet.recorder.scene.link_state import ARRIVED, BEHIND, LinkHistory, LinkState, fate_of, stale_after
from fleet.recorder.scene.model import (
    CROWD,
    LEAST_FLIGHT_S,
    MANY,
    MOST_FLIGHT_S,
    SLENDER,
    STOPS,
    TRAIL_S,
    WORST,
    SceneModel,
    depth_text,
)
from fleet.recorder.scene.primitives import Primitive, plain
from fleet.recorder.scene.styles import LINK_MEANINGS, NO_AGENT
from fleet.recorder.transforms import angles
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.scenario import Scenario, timeline
from fleet.scenario.sections.fault_entry import DIVERGED, TUMBLED, entry_kind, entry_vehicles, is_fault
from fleet.scenario.sections.timeline import FaultInterval
from fleet.scenario.sections.vehicle_events import VehicleEvents, vehicle_events
from netem.condition import Link
from world.vectors import Vec3

HISTORY_S = 60.0  # that charts show
FARTHEST_M = 1e7  # that a vehicle can be from the origin: a page draws no other
SAMPLE_S = 0.2  # between two samples of charts
MOST_SAMPLES = int(HISTORY_S / SAMPLE_S)
MOST_PACKETS = 400  # of a frame: more nobody can follow
LOSS_SAMPLES = 5  # over which the share of lost packets is taken
NOT_PLACED = "The scenario logs no transforms (log: {transforms: 0 ticks}): where the vehicles are is not known."
Row = dict[str, Any]


class ViewState:
    """The present knowledge of a run at one time."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.scene = SceneModel(scenario)
        self.end_s = scenario.duration_ns / 1e9
        self.at_s = 0.0
        self.links: dict[Link, LinkHistory] = {}
        self._numbers = {link: k for k, link in enumerate(scenario.graph.links)}
        self._round_s = scenario.round_ticks * scenario.tick_ns / 1e9
        self._stale_s = stale_after(self._round_s)
        self._beliefs = NewestBeliefs(scenario)
        acoustic = scenario.acoustic
        self._on_air = None if acoustic is None else OnAir(acoustic, scenario.tick_ns / 1e9)
        self.known_faults: list[Row] = _planned_faults(scenario)  # over, active and to come
        self._events: dict[str, Row] = {}  # what happened to vehicles, by id
        self._told: list[VehicleEvents] | None = None  # the same as the console counts it; None: it was not asked
        self.changes = 0  # of `known`
        self.neighbours = {
            i: [src for src, dst in scenario.graph.links if dst == i] for i in range(1, scenario.vehicles + 1)
        }
        self.placed = bool(scenario.log_every.get("transforms", 1))  # whether messages say where the vehicles are
        self._frames = {f"uuv-{i}": i for i in self.neighbours}  # vehicles by name of their frame
        self._signals: dict[str, deque[tuple[float, float]]] = {}
        self._new: dict[str, deque[tuple[float, float]]] = {}  # since the last frame
        self.clear()

    def clear(self, at_s: float = 0.0) -> None:
        """Forget the content of messages, because the next ones are of another time; faults stay known.

        `at_s`: what was before this time is not known, such as the age of what was heard then.
        """
        self.at_s = self.since_s = at_s
        self.links = {link: LinkHistory(sent_s=None if at_s else 0.0, arrived_s=at_s) for link in self._numbers}
        self._places: dict[int, Vec3] = {}
        self._turns: dict[int, Vec3] = {}  # phi, theta, psi [rad]
        self._speeds: dict[int, float] = {}
        self._placed_s = -1.0
        self._beliefs.clear()
        if self._on_air is not None:
            self._on_air.clear()
        self._packets: deque[list[Any]] = deque(maxlen=MOST_PACKETS)
        self._samples: deque[list[Any]] = deque(maxlen=MOST_SAMPLES)
        self._fresh: deque[list[Any]] = deque(maxlen=MOST_SAMPLES)  # since the last frame
        self._counts: deque[tuple[int, int]] = deque(maxlen=LOSS_SAMPLES)  # lost, all
        self._count = [0, 0]
        self._kinds: deque[Counter[tuple[str, bool]]] = deque(maxlen=MOST_SAMPLES)  # packets of each sample: kind, lost
        self._kind: Counter[tuple[str, bool]] = Counter()  # since the last sample
        self._all_kinds: Counter[tuple[str, bool]] = Counter()  # the sum of both
        for values in (*self._signals.values(), *self._new.values()):
            values.clear()

    def transforms(self, at_s: float, message: Any) -> None:
        """Take a message of the topic `transforms`: where the vehicles are, and how they are turned."""
        elapsed = at_s - self._placed_s
        for transform in message.transforms:
            i = self._frames.get(transform.child_frame_id)
            if i is None:
                continue
            t, q = transform.translation, transform.rotation
            place = (t.x, t.y, t.z)
            if not all(abs(value) < FARTHEST_M for value in place):  # its motion has left the finite numbers
                self._places.pop(i, None)
                continue
            if i in self._places and elapsed > 0.0:
                self._speeds[i] = dist(place, self._places[i]) / elapsed
            self._places[i] = place
            self._turns[i] = angles(q.x, q.y, q.z, q.w)
        self._placed_s = at_s
        self.at_s = max(self.at_s, at_s)
        if not self._samples or at_s - self._samples[-1][0] >= SAMPLE_S - 1e-9:
            self._sample()

    def believes(self, i: int, group: str, at_s: float, message: Any) -> None:
        """Take a message of the topic `uuv/<i>/belief` or `uuv/<i>/located`; the group says which."""
        if i in self.neighbours:
            self._beliefs.take(i, group, at_s, tuple(message.off), tuple(message.covariance))

    def packet(self, link: Link, message: Any, *, moving: bool = True) -> None:
        """Take a message of a topic `link/<src>-<dst>`. `moving`: whether it is to be seen on its way; not while a
        moment of a log is looked up."""
        if link not in self.links or message.fate == "in flight":
            return
        fate = fate_of(message.fate, message.due - message.sent, message.corrupted, self._round_s)
        history = self.links[link]
        history.settle(fate, message.sent, message.due)
        lost = fate not in (ARRIVED, BEHIND)
        self._count[0] += lost
        self._count[1] += 1
        kind = DAMAGED if message.corrupted else kind_of(message.payload)
        self._kind[kind, lost] += 1
        self._all_kinds[kind, lost] += 1
        if self._on_air is not None:
            self._on_air.packet(link, message, self._places)
        if moving:
            late_s = round(message.due - message.sent, 4)
            self._packets.append([self._numbers[link], round(message.sent, 4), late_s, fate])

    def set_link_ages(self, at_s: float, rows: Iterable[Mapping[str, Any]]) -> None:
        """Take the time and how old the newest is that arrived on each link, as the console knows them. `rows`: src,
        dst and age_s, as `fleet status --all` has them."""
        if self._placed_s < 0.0:  # else time is that of the places
            self.at_s = max(self.at_s, at_s)
        for row in rows:
            if (history := self.links.get((row["src"], row["dst"]))) is not None:
                history.mark_sent(at_s - row["age_s"])

    def faults(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Take the list of faults, and of states of vehicles that last. `rows`: id, what, entry, from_s, to_s and
        until_healed, as `fleet status --all` has them."""
        keys = ("id", "what", "entry", "from_s", "to_s", "until_healed")
        plain = [{key: row[key] for key in keys} for row in rows]
        known = [row for row in plain if is_fault(row["entry"])]
        events = self._events | {row["id"]: row for row in plain if not is_fault(row["entry"])}
        if (known, events) != (self.known_faults, self._events):
            self.known_faults, self._events = known, events
            self.changes += 1

    def set_vehicle_events(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Take what happened to vehicles so far: rows with what, times and first_s, as the console counts it."""
        told = [VehicleEvents(row["what"], row["times"], row["first_s"]) for row in rows]
        if told != self._told:
            self._told = told
            self.changes += 1

    def event(self, at_s: float, message: FaultMessage) -> None:
        """Take a message of the topic `faults`: something begins or ends.

        `faults` has better data about lasting things.
        """
        row = {"id": message.fault, "what": message.what, "entry": message.entry, "from_s": at_s, "to_s": self.end_s}
        if is_fault(message.entry):
            known = next((row for row in self.known_faults if row["id"] == message.fault), None)
        else:
            known = self._events.get(message.fault)
        if message.action == "begins" and known is None:
            if is_fault(message.entry):
                self.known_faults = [*self.known_faults, row | {"until_healed": True}]
            else:
                self._events = self._events | {message.fault: row | {"until_healed": False}}
        elif message.action == "ends" and known is not None and (known["until_healed"] or at_s < known["to_s"]):
            known["to_s"] = min(at_s, self.end_s)
            known["until_healed"] = False
        else:
            return
        self.changes += 1

    def follow(self, names: Collection[str]) -> None:
        """Keep the values of these signals from now on, and of no others."""
        for values in (self._signals, self._new):
            for name in values.keys() - set(names):
                del values[name]
            for name in names:
                values.setdefault(name, deque(maxlen=4 * MOST_SAMPLES))

    def signal(self, name: str, at_s: float, value: float) -> None:
        """Take a value of a signal that is followed; of values that come faster, some are left out."""
        values = self._signals[name]
        if not values or at_s - values[-1][0] >= SAMPLE_S / 4 - 1e-9:
            values.append((round(at_s, 3), value))
            self._new[name].append((round(at_s, 3), value))

    def setup(self) -> Row:
        """The constant part: names, links, sizes, and the scene as `fleet.recorder.scene.model` has it."""
        scenario, scene = self.scenario, self.scene
        return {
            "scenario": scenario.name,
            "title": scenario.title,
            "end_s": self.end_s,
            "ends": scenario.ends,
            "vehicles": scenario.vehicles,
            "moored": bool(scenario.spec.moored),
            "guided": scene.guided,
            "names": [scenario.vehicle_name(i) for i in range(1, scenario.vehicles + 1)],
            "links": [list(link) for link in self._numbers],
            "both_ways": [link in scene.both_ways for link in self._numbers],
            "hulls_m": [_round_all((SLENDER * width, width)) for width in scene.diameters],
            "standing": plain(scene.standing),
            "moving": plain(scene.moving(0.0)),
            "legend": [row._asdict() for row in scene.legend()],
            "link_meanings": LINK_MEANINGS,
            "many": scenario.vehicles > MANY,
            "crowd": scenario.vehicles > CROWD,
            "trail_s": TRAIL_S,
            "flight": {"least_s": LEAST_FLIGHT_S, "most_s": MOST_FLIGHT_S, "stops": STOPS},
            "leaders": [i for i, b in enumerate(scenario.b, start=1) if b and scene.guided],
            "acoustic": scenario.acoustic is not None,
            "round_s": self._round_s,
            "placed": self.placed,
            "worst_first": list(LinkState),
        }

    def _vehicle(self, i: int) -> list[float]:
        """Number, x, y, z [m, NED], theta, psi [rad], speed [m/s], and the roll [rad] of a vehicle that has one."""
        phi, theta, psi = self._turns[i]
        roll = (phi,) if self.scenario.controls[i - 1].plant is not None else ()
        speed = round(self._speeds.get(i, 0.0), 3)
        return [i, *_round_all(self._places[i]), *_round_all((theta, psi)), speed, *_round_all(roll)]

    def _label(self, i: int, state: str) -> tuple[int, str, str]:
        depth = "" if self.scenario.vehicles > MANY else depth_text(self._places[i][2])
        name = self.scenario.vehicle_name(i)
        return i, f"{name}  {state}" if state else name, depth

    def frame(self) -> Row:
        t = self.at_s
        errors, states = _errors(self.errors()), self._states()
        row: Row = {
            "t": round(t, 4),
            "uuv": [self._vehicle(i) for i in sorted(self._places)],
            "ref": _round_all(self.scene.reference(t)),
            "links": [history.state(t, self._stale_s) for history in self.links.values()],
            "since": round(self.since_s, 2),
            "ages": [_hundredths(history.age_s(t)) for history in self.links.values()],
            "errors": errors,
            "states": states,
            "no_agent": [i for i, words in states.items() if NO_AGENT in words or DIVERGED in words],
            "labels": [self._label(i, states.get(i, "")) for i in sorted(self._places)],
            "labelled": _worst(errors) if self.scenario.vehicles > CROWD else sorted(self._places),
            "packets": list(self._packets),
            "samples": list(self._fresh),
            "faults": self.active_faults(),
            "losses": [history.lost_of_last for history in self.links.values()],
            "kinds": self.kinds(),
        }
        if self.scene.changes:
            row["moving"] = plain(self.moving())
        if any(self._new.values()):
            row["signals"] = {name: list(values) for name, values in self._new.items() if values}
            for values in self._new.values():
                values.clear()
        if self._on_air is not None:
            row["on_air"] = list(self._on_air.fresh)
            self._on_air.fresh.clear()
        self._packets.clear()
        self._fresh.clear()
        return row

    def moving(self) -> list[Primitive]:
        """The primitives that move with the fleet, for the present time, as the scene has them."""
        return self.scene.moving(self.at_s, self._beliefs.at(self.at_s))

    def history(self) -> Row:
        """The samples of the last minute, for a page that has just been opened, or that has jumped."""
        signals = {name: list(values) for name, values in self._signals.items()}
        on_air = [] if self._on_air is None else list(self._on_air.all)
        return {"samples": list(self._samples), "signals": signals, "on_air": on_air}

    def errors(self) -> list[float | None]:
        """The formation error of each vehicle [m], from the newest known places; None: not known yet."""
        t = max(self._placed_s, 0.0)
        x, y, z = self.scene.reference(t)
        found: list[float | None] = []
        for i, (dx, dy, dz) in enumerate(self.scene.offsets(t), start=1):
            found.append(dist(self._places[i], (x + dx, y + dy, z + dz)) if i in self._places else None)
        return found

    def active_faults(self) -> list[Row]:
        """The faults that are active now, and those that begin within the next minute, in order of their beginning."""
        t = self.at_s
        shown = [row for row in self.known_faults if row["from_s"] <= t + HISTORY_S and t < row["to_s"]]
        return [row | {"active": row["from_s"] <= t} for row in sorted(shown, key=lambda row: row["from_s"])]

    @property
    def vehicle_events(self) -> list[VehicleEvents]:
        """The events of vehicles, one row for each vehicle and kind of event."""
        if self._told is not None:
            return self._told
        return vehicle_events(self.happenings)

    @property
    def happenings(self) -> list[tuple[str, float]]:
        """The single events of vehicles: text and beginning [s]."""
        return [(row["what"], row["from_s"]) for row in self._events.values()]

    def known(self) -> Row:
        """All faults, and what happened to vehicles; `changes` says when there is something new."""
        events = [{"text": str(row), "at_s": row.first_s} for row in self.vehicle_events]
        return {"faults": self.known_faults, "events": events}

    def kinds(self) -> list[list[Any]]:
        """Packets of the last minute by kind of payload: kind, all, lost; the most frequent kind first."""
        counts = self._all_kinds
        kinds = {kind for (kind, _), count in counts.items() if count}
        rows = [[kind, counts[kind, False] + counts[kind, True], counts[kind, True]] for kind in kinds]
        return sorted(rows, key=lambda row: (-row[1], row[0]))

    def _states(self) -> dict[int, str]:
        found: dict[int, list[str]] = {}
        for row in (*self.known_faults, *self._events.values()):
            kind = entry_kind(row["entry"])
            word = kind if kind in (TUMBLED, DIVERGED) else KINDS[kind].shown if kind in KINDS else ""
            if word and row["from_s"] <= self.at_s < row["to_s"]:
                for i in entry_vehicles(row["entry"]):
                    found.setdefault(i, []).append(word)
        return {i: ", ".join(dict.fromkeys(some)) for i, some in found.items()}

    def _sample(self) -> None:
        t = self._placed_s
        ages = [_oldest([self.links[src, i].age_s(t) for src in sources]) for i, sources in self.neighbours.items()]
        self._counts.append((self._count[0], self._count[1]))
        self._count = [0, 0]
        if len(self._kinds) == MOST_SAMPLES:
            self._all_kinds.subtract(self._kinds[0])
        self._kinds.append(self._kind)
        self._kind = Counter()
        total = sum(count[1] for count in self._counts)
        share = sum(count[0] for count in self._counts) / total if total else 0.0
        errors = _errors(self.errors())
        places = [value for i in sorted(self._places) for value in (i, *_round_all(self._places[i]))]
        sample = [round(t, 3), errors, ages, round(share, 4), places]
        self._samples.append(sample)
        self._fresh.append(sample)


def _round_all(values: Iterable[float]) -> list[float]:
    return [round(value, 3) for value in values]


def _hundredths(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def _oldest(ages: Sequence[float | None]) -> float | None:
    """The greatest age; None: one is not known, or there is none."""
    known = [age for age in ages if age is not None]
    return _hundredths(max(known)) if known and len(known) == len(ages) else None


def _worst(errors: Sequence[float | None]) -> list[int]:
    known = [(-error, i) for i, error in enumerate(errors, start=1) if error is not None]
    return [i for _, i in sorted(known)[:WORST]]


def _errors(values: Iterable[float | None]) -> list[float | None]:
    return [None if value is None else round(value, 4) for value in values]


def _planned_faults(scenario: Scenario) -> list[Row]:
    end_s = scenario.duration_ns / 1e9
    return [fault_row(one._replace(end=min(one.end, end_s))) for one in timeline(scenario)]


def fault_row(one: FaultInterval) -> Row:
    """A fault whose times are known."""
    times = {"from_s": one.begin, "to_s": one.end, "until_healed": False}
    return {"id": one.id, "what": one.what, "entry": one.entry, **times}
