"""A log as a page shows it: played, paused, at any time, at any rate."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fleet.addons.page.chart_signals import ChartSignal, Signals
from fleet.addons.page.feed import (
    FAULTS,
    MOST_CHARTED,
    TRANSFORMS,
    checks_asked,
    checks_judged,
    fault_message,
    is_lost,
    take,
)
from fleet.addons.page.view_state import HISTORY_S, NOT_PLACED, Row, ViewState, fault_row
from fleet.logs.difference import begin_ns
from fleet.logs.fault_intervals import FaultMessage, intervals
from fleet.logs.open_log import Log, Opening
from fleet.logs.run_name import run_name
from fleet.logs.topic import Topic
from fleet.logs.topic_names import believer_of, link_of, link_topic
from fleet.mcap.reader import LogReadError
from fleet.mcap.records import Array
from fleet.mcap.seekable_log import SeekableLog, Track
from fleet.quantities import vehicle_numbers
from fleet.repeat.recorded_run import read_recorded_run
from fleet.replay.player import Player
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.fault_entry import TUMBLED
from fleet.scenario.sections.signal_checks import checked_signals
from netem.cause import Cause
from netem.limits import LOG_FAULTS

MOST_SAMPLES = 600  # of a curve
MOST_VALUES = 60_000  # of all curves of one chart
LEAST_SAMPLES = 100
LEAST_S = 0.2  # between two samples
LOSS_S = 1.0  # over which the share of lost packets is taken, at least
_LINK = frozenset({"sent", "due", "fate", "corrupted"})
Points = list[list[float | None]]


def samples(path: Path, end_s: float, vehicles: int, neighbours: Mapping[int, Collection[int]]) -> list[list[Any]]:
    """Samples over a whole log, in the form of `ViewState.history` but without places. `neighbours`: whom each vehicle
    hears. Returns nothing, if the log has neither errors of vehicles nor packets. Raises LogReadError: it cannot be
    read."""
    names = [f"uuv/{i}/error" for i in range(1, vehicles + 1)]
    log = Opening(path, [*names, "link/*"], drawn={"uuv/*": frozenset({"formation_norm"}), "link/*": _LINK}).read()
    at = np.linspace(0.0, end_s, 1 + max(1, min(_most(vehicles), round(end_s / LEAST_S))))
    columns = [_column(log, name, "formation_norm") for name in names]
    unknown = np.full(len(at), np.nan)
    errors = [np.interp(at, t, v, left=np.nan, right=np.nan) if len(t) else unknown for t, v in columns]
    links = {(src, dst): _link(log, link_topic((src, dst))) for dst, sources in neighbours.items() for src in sources}
    if not any(np.isfinite(some).any() for some in errors) and not any(link is not None for link in links.values()):
        return []
    ages = [_age(at, [links[src, i] for src in sources], log.begin) for i, sources in neighbours.items()]
    share = _lost(at, [link for link in links.values() if link is not None])
    for column in (*ages, share):
        column[at < log.begin] = np.nan
    return [
        [round(float(t), 3), _plain(each), _plain(old), _number(lost), []]
        for t, each, old, lost in zip(at, np.transpose(errors), np.transpose(ages), share, strict=True)
    ]


def curves(path: Path, signals: Collection[ChartSignal]) -> dict[str, Points]:
    """The values of signals over a whole log, times in s, by their names. Raises LogReadError: the log cannot be
    read."""
    if not signals:
        return {}
    fields = {one.topic: frozenset(other.field for other in signals if other.topic == one.topic) for one in signals}
    log = Opening(path, list(fields), drawn=fields).read()
    most = _most(len(signals))
    found: dict[str, Points] = {}
    for signal in signals:
        t, values = _column(log, signal.topic, signal.field)
        one = _one(signal, values)
        kept = thinned(one, most)
        found[signal.name] = [
            [round(x, 3), _number(y)] for x, y in zip(t[kept].tolist(), one[kept].tolist(), strict=True)
        ]
    return found


def thinned(values: Array, most: int) -> Array:
    """The numbers of at most about `most` values that show the same curve: the ends and the extremes of short spans."""
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), max(1, most // 4) + 1).astype(int)
    kept = {0, len(values) - 1}
    for first, stop in pairwise(edges.tolist()):
        some = np.nan_to_num(values[first:stop])
        kept |= {first, stop - 1, int(first + some.argmin()), int(first + some.argmax())}
    return np.array(sorted(kept))


def first_above(path: Path, vehicles: Collection[int], limit: float, after_s: float) -> float | None:
    """When the formation error of one of these vehicles is not below a limit [m] for the first time after a time.
    Returns None: never, as far as is known. Raises LogReadError: the log cannot be read."""
    names = [f"uuv/{i}/error" for i in vehicles]
    log = Opening(path, names, drawn={"uuv/*": frozenset({"formation_norm"})}).read()
    times = []
    for name in names:
        t, error = _column(log, name, "formation_norm")
        times += t[(t >= after_s) & ~(error < limit)][:1].tolist()
    return min(times, default=None)


def _most(curves: int) -> int:
    return max(LEAST_SAMPLES, min(MOST_SAMPLES, MOST_VALUES // max(1, curves)))


def _one(signal: ChartSignal, values: Array) -> Array:
    if not len(values):
        return np.empty(0)
    wide = values.reshape(len(values), -1)
    if signal.component is None:
        return np.linalg.norm(wide, axis=1) if signal.absolute else wide[:, 0]
    if signal.component >= wide.shape[1]:
        return np.full(len(wide), np.nan)
    one = wide[:, signal.component]
    return np.abs(one) if signal.absolute else one


def _column(log: Log, name: str, field: str) -> tuple[Array, Array]:
    try:
        topic = log[name]
        if len(topic) and np.issubdtype(topic[field].dtype, np.number) and topic[field].size:
            return topic.t, topic[field].astype(float)
    except LogReadError:
        pass
    return np.empty(0), np.empty(0)


def _link(log: Log, name: str) -> Topic | None:
    try:
        topic = log[name]
        numbers = all(np.issubdtype(topic[field].dtype, np.number) for field in ("sent", "due"))
        return topic if len(topic) and numbers and all(len(topic[field]) for field in _LINK) else None
    except LogReadError:
        return None


def _age(at: Array, links: Collection[Topic | None], begin_s: float) -> Array:
    first = np.nan if begin_s else 0.0  # what was heard before a run that went on from another is not in its log
    oldest = np.full(len(at), np.nan)
    for link in links:
        newest = np.full(len(at), first)
        if link is not None:
            whole = (link["fate"] == Cause.DELIVERED) & ~np.asarray(link["corrupted"], bool)
            due, sent = link["due"][whole], link["sent"][whole]
            order = np.argsort(due, kind="stable")
            heard = np.searchsorted(due[order], at, "right")
            newest = np.concatenate([[first], np.maximum.accumulate(sent[order])])[heard]
        oldest = np.fmax(oldest, np.maximum(0.0, at - newest))
    return oldest


def _lost(at: Array, links: Collection[Topic]) -> Array:
    every = max(1, round(LOSS_S / max(1e-9, float(at[1] - at[0]))))
    edges = np.append(at[:-1:every], np.inf)
    lost, total = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    for link in links:
        known = link["fate"] != Cause.IN_FLIGHT
        gone = known & ((link["fate"] != Cause.DELIVERED) | np.asarray(link["corrupted"], bool))
        total += np.histogram(link.t[known], edges)[0]
        lost += np.histogram(link.t[gone], edges)[0]
    share = np.divide(lost, total, out=np.zeros(len(total)), where=total > 0)
    return np.append(np.repeat(share, every)[: len(at) - 1], share[-1])


def _plain(values: Array) -> list[float | None]:
    return [_number(value) for value in values.tolist()]


def _number(value: float) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None


MOST_AT_ONCE = 20_000  # messages between two pictures, and those that a jump looks back on


class LogFeed:
    live = False

    def __init__(self, path: Path, rate: float = 1.0, *, loop: bool = False) -> None:
        """Read it through. `rate`: of the playback, times its own pace. `loop`: begin again at the end. Raises
        LogReadError: it cannot be read; FleetError: it holds no scenario of ours."""
        self.path = path
        self._loop = loop
        self.name = run_name(path)
        run = read_recorded_run(path)
        self.scenario: Scenario = run.script()
        self._begin_s = begin_ns(run.reader) / 1e9
        self._log = SeekableLog(run.path)
        self._topics = {n: channel.topic for n, channel in self._log.channels.items()}
        self.signals = Signals(self._log.channels.values(), self._log.schemas)
        self.picture = ViewState(self.scenario)
        self.picture.faults(self._all_faults())
        self.missing = self._log.missing
        judged = checks_judged(path)
        self.checks = judged if judged and judged["rows"] else checks_asked(self.scenario)
        looked_at = [name for row in self.checks["rows"] for name in row.get("signals", ())]
        checked = map(str, checked_signals(self.scenario.spec.checks, looked_at))
        self.charted = [name for name in checked if self.signals.of_all(name)][:MOST_CHARTED]
        self._track = self._tracked()
        self._beliefs = [(len(numbers), Track(self._log, numbers)) for numbers in self._believers()]
        self.end_s = self._log.end_ns / 1e9
        self.player = self._player(0, rate)
        self._jumped = False
        self.seek(0.0)

    def _believers(self) -> list[list[int]]:
        """The channels of what vehicles believe: by navigator, and by ranges, which may come at another rate."""
        found: dict[str, list[int]] = {}
        for number, topic in self._topics.items():
            if believer := believer_of(topic):
                found.setdefault(believer[1], []).append(number)
        return list(found.values())

    def _tracked(self) -> Track:
        more = self.signals.followed
        chosen = [n for n, t in self._topics.items() if t == TRANSFORMS or link_of(t) is not None or t in more]
        return Track(self._log, chosen)

    def _player(self, at_ns: int, rate: float = 1.0, *, paused: bool = True) -> Player:
        now = time.monotonic_ns()
        track = self._track
        player = Player(track, 0, self._log.end_ns, rate=rate, paused=paused, now=now, before=track.before)
        player.seek(now, at_ns)
        return player

    def _all_faults(self) -> list[Row]:
        """Every fault that the log tells of, with its end. Raises LogReadError: they are more than anybody could look
        at."""
        happened: list[tuple[float, FaultMessage]] = []
        held = 0  # bytes
        track = Track(self._log, [n for n, topic in self._topics.items() if topic == FAULTS])
        for _, entry in track.entries(range(len(track))):
            held += len(entry.data)
            if len(track) > LOG_FAULTS.items or held > LOG_FAULTS.bytes:
                most = f"{LOG_FAULTS.items} messages or {LOG_FAULTS.bytes} bytes"
                raise LogReadError(f"{self.path} tells of more faults than are shown: expected at most {most}")
            if (event := fault_message(entry.data, self.scenario.nodes)) is not None:
                happened.append((entry.log_ns / 1e9, event))
        return [fault_row(one) for one in intervals(happened, self._log.end_ns / 1e9)]

    def advance(self) -> bool:
        """Take what is due; whether there is something new to show."""
        now = time.monotonic_ns()
        some = self.player.due(now, MOST_AT_ONCE)
        self._take(some, moving=True)
        if not self.picture.placed:  # else time is that of the places
            self.picture.at_s = min(self.player.position(now) / 1e9, self.end_s)
        self._take_beliefs()
        new = bool(some) or self._jumped or not self.picture.placed
        self._jumped = False
        if self.player.over and not self.player.paused:
            self.player.pause(now)
            new = True
            if self._loop:
                self.toggle()
        return new

    def _take(self, some: range, *, moving: bool) -> None:
        for _, entry in self._track.entries(some):
            take(self.picture, entry.channel.topic, entry.log_ns / 1e9, entry.data, self.signals, moving=moving)

    def _take_beliefs(self) -> None:
        """Take the newest of each vehicle: they are many, and a picture shows one."""
        for vehicles, track in self._beliefs:
            stop = track.before(int(self.picture.at_s * 1e9) + 1)
            for _, entry in track.entries(range(max(0, stop - vehicles), stop)):
                take(self.picture, entry.channel.topic, entry.log_ns / 1e9, entry.data)

    def clock(self) -> Row:
        player = self.player
        over = player.over
        text = "at the end" if over else "paused" if player.paused else f"{player.rate:g} x real time"
        note = f"The log is not whole: {self.missing}" if self.missing else ""
        note = note or ("" if self.picture.placed else NOT_PLACED)
        return {"text": text, "paused": player.paused, "rate": player.rate, "over": over, "waiting": "", "note": note}

    def toggle(self) -> None:
        """Play or pause; from the end it begins again."""
        if self.player.over:
            self.seek(0.0)
        self.player.toggle(time.monotonic_ns())

    def set_rate(self, rate: float) -> None:
        self.player.set_rate(time.monotonic_ns(), rate)

    def seek(self, at_s: float) -> None:
        """Go to a time; what charts show is looked up from the minute before it."""
        at_s = min(max(at_s, 0.0), self.end_s)
        track, at_ns = self._track, int(at_s * 1e9)
        stop = track.before(at_ns + 1)
        first = max(track.before(int(max(0.0, at_s - HISTORY_S) * 1e9)), stop - MOST_AT_ONCE)
        self.picture.clear(self._begin_s if not first else track[first] / 1e9)
        self._take(range(first, stop), moving=False)
        self.picture.at_s = at_s
        self._take_beliefs()
        self.player.seek(time.monotonic_ns(), at_ns)
        self._jumped = True

    def first_failure_s(self) -> float:
        """When the first of the failed checks failed, as far as that is known; 0: none did. Each of these checks knows
        then when it failed, as `at_s`. Raises LogReadError: the log cannot be read."""
        failed = [row for row in self.checks["rows"] if row["passed"] is False]
        for row in failed:
            row["at_s"] = self._failed_s(row)
        known = [row["at_s"] for row in failed if row["at_s"] is not None and 0.0 <= row["at_s"] <= self.end_s]
        return min(known, default=self.end_s if failed else 0.0)

    def _failed_s(self, row: Row) -> float | None:
        if row.get("at_s") is not None:
            return float(row["at_s"])
        section = self.scenario.spec.checks
        if row["check"] == TUMBLED:
            return min((one.first_s for one in self.picture.vehicle_events), default=None)
        if row["check"] == "formation_error" and (asked := section.formation_error) is not None:
            everyone = range(1, self.scenario.vehicles + 1)
            who = everyone if asked.vehicles is None else vehicle_numbers(asked.vehicles)
            return first_above(self.path, who, asked.below, asked.after / 1e9)
        return None

    def whole(self, names: Collection[str] = ()) -> Row:
        """The data of charts over the whole log: samples, and the values of signals. Raises LogReadError: the log
        cannot be read."""
        return {
            "samples": self._samples,
            "signals": curves(self.path, [self.signals.by_name[name] for name in sorted(names)]),
        }

    @cached_property
    def _samples(self) -> list[list[Any]]:
        return samples(self.path, self.end_s, self.scenario.vehicles, self.picture.neighbours)

    def forward(self, at_s: float) -> None:
        """Take everything up to a later time, as if it had been played until then."""
        before = self._track.before
        self._take(range(before(int(self.picture.at_s * 1e9) + 1), before(int(at_s * 1e9) + 1)), moving=True)
        self.picture.at_s = at_s
        self._take_beliefs()

    def next_fault(self) -> float | None:
        """When the next fault begins or ends [s]; None: none does."""
        t = self.picture.at_s + 1e-6
        times = [at for row in self.picture.known_faults for at in (row["from_s"], row["to_s"])]
        return min((at for at in times if t < at < self.end_s), default=None)

    def next_loss(self) -> float | None:
        """When the next packet is lost [s]; None: none is."""
        track = self._track
        for _, entry in track.entries(range(track.before(int(self.picture.at_s * 1e9) + 1), len(track))):
            if link_of(entry.channel.topic) is None:
                continue
            if is_lost(entry.data):
                return entry.log_ns / 1e9
        return None

    def follow(self, names: Collection[str]) -> None:
        """Bring these signals and no others into the picture. Raises KeyError: there is none of a name."""
        self.signals.follow(names)
        self.picture.follow(names)
        at_s, player = self.picture.at_s, self.player
        self._track = self._tracked()
        self.player = self._player(int(at_s * 1e9), player.rate, paused=player.paused)
        self.seek(at_s)

    def close(self) -> None:
        """End."""
