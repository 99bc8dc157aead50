"""The curves of a whole log, thin enough for a page: formation errors, ages, lost packets and signals."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fleet.logs.open_log import Log, Opening
from fleet.logs.reader import LogReadError
from fleet.logs.records import Array
from fleet.logs.topic import Topic
from fleet.logs.topic_names import link_topic
from fleet.view.chart_signals import ChartSignal
from netem.fault_kinds import Cause

MOST_SAMPLES = 600  # of a curve
MOST_VALUES = 60_000  # of all curves of one chart
LEAST_SAMPLES = 100
LEAST_S = 0.2  # between two samples
LOSS_S = 1.0  # over which the share of lost packets is taken, at least
_LINK = frozenset({"sent", "due", "fate", "corrupted"})
Points = list[list[float | None]]


def samples(path: Path, end_s: float, vehicles: int, neighbours: Mapping[int, Collection[int]]) -> list[list[Any]]:
    """Samples over a whole log, in the form of `ViewState.history` but without places.

    Args:
        end_s: of the log.
        vehicles: how many there are.
        neighbours: whom each vehicle hears.

    Returns:
        nothing, if the log does not have the errors of the vehicles.

    Raises:
        LogReadError: the log cannot be read.
    """
    names = [f"uuv/{i}/error" for i in range(1, vehicles + 1)]
    log = Opening(path, [*names, "link/*"], drawn={"uuv/*": frozenset({"formation_norm"}), "link/*": _LINK}).read()
    at = np.linspace(0.0, end_s, 1 + max(1, min(_most(vehicles), round(end_s / LEAST_S))))
    errors = [_at(at, _column(log, name, "formation_norm")) for name in names]
    if not any(np.isfinite(some).any() for some in errors):
        return []
    links = {(src, dst): _link(log, link_topic((src, dst))) for dst, sources in neighbours.items() for src in sources}
    ages = [_age(at, [links[src, i] for src in sources]) for i, sources in neighbours.items()]
    share = _lost(at, [link for link in links.values() if link is not None])
    return [
        [round(float(t), 3), _plain(each), _plain(old), _number(lost), []]
        for t, each, old, lost in zip(at, np.transpose(errors), np.transpose(ages), share, strict=True)
    ]


def curves(path: Path, signals: Collection[ChartSignal]) -> dict[str, Points]:
    """The values of signals over a whole log, times in s, by their names.

    Raises:
        LogReadError: the log cannot be read.
    """
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

    Returns:
        None: never, as far as is known.

    Raises:
        LogReadError: the log cannot be read.
    """
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
    """The numbers of a signal, of the values of its field."""
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
    """Times [s] and values; none if the log has none that can be read."""
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


def _at(at: Array, column: tuple[Array, Array]) -> Array:
    t, values = column
    return np.interp(at, t, values, left=np.nan, right=np.nan) if len(t) else np.full(len(at), np.nan)


def _age(at: Array, links: Collection[Topic | None]) -> Array:
    """How old the oldest news of a neighbour is."""
    oldest = np.full(len(at), np.nan)
    for link in links:
        newest = np.zeros(len(at))
        if link is not None:
            whole = (link["fate"] == Cause.DELIVERED) & ~np.asarray(link["corrupted"], bool)
            due, sent = link["due"][whole], link["sent"][whole]
            order = np.argsort(due, kind="stable")
            heard = np.searchsorted(due[order], at, "right")
            newest = np.concatenate([[0.0], np.maximum.accumulate(sent[order])])[heard]
        oldest = np.fmax(oldest, np.maximum(0.0, at - newest))
    return oldest


def _lost(at: Array, links: Collection[Topic]) -> Array:
    """The share of the packets around each time that did not arrive whole."""
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
