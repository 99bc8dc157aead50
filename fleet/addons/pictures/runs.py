"""The source of a picture: one or more logs with names, signals by vehicle, and the request."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from fleet.addons.pictures.labels import distinct, given_labels, labels_of
from fleet.addons.pictures.style import Provenance
from fleet.errors import FleetError
from fleet.logs.open_log import MOST_HELD, Log, Opening
from fleet.mcap.reader import check_readable
from fleet.mcap.records import Array
from fleet.result.file import ResultError, read_result
from fleet.result.verdict import Verdict
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import GROUPS
from netem.condition import Link

GAP = 1.5  # times the usual distance of two samples: more, and the line is broken


class NothingToDraw(FleetError):
    """The log does not hold what the picture shows; the text says what is missing."""


@dataclass(frozen=True, slots=True)
class View:
    """How to draw, as far as a user may choose."""

    vehicles: tuple[int, ...] | None = None  # None: all
    log_scale: bool | None = None  # None: errors on a logarithmic axis, all others on a linear one
    window: tuple[float, float] | None = None  # s


def check_view(runs: Sequence[LoggedRun], view: View) -> None:
    """Raises FleetError: there is no such vehicle, or the logs end before the window begins."""
    known = sorted({i for run in runs for i in run.log.vehicles})
    strangers = [i for i in view.vehicles or () if i not in known]
    if strangers:
        there = f"they are {first_words(known, 12)}" if known else "there are none in the log"
        raise FleetError(f"there is no vehicle {first_words(strangers)}: {there}")
    end = max(run.log.end for run in runs)
    if view.window is not None and view.window[0] >= end:
        raise FleetError(f"there is nothing from {view.window[0]:g} s on: the log ends at {end:g} s")


@dataclass
class LoggedRun:
    """One run to draw: `label` is its name in a legend, `notes` are lines for the user about parts that the picture
    lacks.
    """

    log: Log
    label: str
    notes: list[str] = field(default_factory=list)

    @property
    def slug(self) -> str:
        return re.sub(r"[^\w.-]+", "-", self.label)

    @cached_property
    def scenario(self) -> Scenario | None:
        """None if the log has none that could be used here; then there are no limits and bounds."""
        try:
            return self.log.scenario
        except FleetError as error:
            self.notes.append(f"{self.label}: no limits and bounds, {str(error).splitlines()[0]}")
            return None

    def vehicle_label(self, i: int) -> str:
        """`UUV 1`, or the name of a node, also in simulated time."""
        return self.scenario.vehicle_name(i) if self.scenario is not None and self.scenario.names else f"UUV {i}"

    def link_label(self, link: Link) -> str:
        """`1→2`, or with the names of nodes."""
        return "{}→{}".format(*(self.vehicle_label(i).removeprefix("UUV ") for i in link))

    @property
    def of_nodes(self) -> bool:
        """Whether it is of robots that are not ours, of which nothing is known but their packets."""
        return self.scenario is not None and bool(self.scenario.nodes)

    @property
    def moored(self) -> bool:
        """Whether its vehicles stay where they are, so that it is about their agents alone."""
        return self.scenario is not None and bool(self.scenario.spec.moored)

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """The checks as the result beside the log has them; empty: there is none, or it is of another log."""
        try:
            result = read_result(self.log.path.parent)
        except (FileNotFoundError, ResultError):
            return []
        return result.checks if result.digest == self.log.digest else []

    @property
    def failures(self) -> list[tuple[str, float]]:
        """Name and time [s] of each check that failed at a moment."""
        return [(one.check, one.moment.at_s) for one in self.verdicts if one.moment is not None]

    @cached_property
    def tick_s(self) -> float:
        """The tick [s]. Raises NothingToDraw if the log is not one of ours."""
        try:
            tick_s = int(self.log.run["tick_ns"]) / 1e9
            if not 0.0 < tick_s < inf:
                raise ValueError
            return tick_s
        except (KeyError, ValueError, OverflowError):
            raise NothingToDraw(f"{self.label} is not a log of uuv-fleet: it says nothing of a run") from None

    def vehicles(self, view: View) -> list[int]:
        return [i for i in self.log.vehicles if view.vehicles is None or i in view.vehicles]

    def series(self, i: int, group: str, name: str) -> tuple[Array, Array] | None:
        """Times [s] and values (samples, width) of a vehicle's signal, NaN in gaps; None if it is not reported."""
        topic = f"uuv/{i}/{group}"
        if topic not in self.log or not len(self.log[topic]) or name not in self.log[topic]:
            return None
        t, values = self.log[topic].t, self.log[topic][name]
        return with_gaps(t, values.reshape(len(t), -1), self.log[topic].step_ns / 1e9)


def load(
    paths: Sequence[Path],
    share: Callable[[float], None] = lambda _: None,
    most_held: int = MOST_HELD,
    labels: Mapping[str, str] | Sequence[str] = (),
) -> list[LoggedRun]:
    """Read logs, each with a name: `labels` as in `given_labels`, the others as in `labels_of`. Of each at most
    `most_held` bytes are held at once. Raises LogReadError if one of them cannot be read; FleetError: a label is of
    none of them.
    """
    given = given_labels(paths, labels)
    check_readable(paths)
    # Poses are states in another form.
    logs = [Opening(path, _WANTED, share, drawn=_DRAWN, most_held=most_held).read() for path in paths]
    names = [own or found for own, found in zip(given, labels_of(logs), strict=True)]
    return [LoggedRun(log, label) for log, label in zip(logs, distinct(names), strict=True)]


_WANTED = [*(f"uuv/*/{group}" for group in GROUPS), "faults", "link/*"]


_DRAWN = {"link/*": frozenset({"seq", "copy", "sent", "due", "delay", "fate", "size", "corrupted"})}  # without payloads


def with_gaps(t: Array, values: Array, step: float = 0.0) -> tuple[Array, Array]:
    """The same with a NaN wherever samples are missing, so that no line is drawn across. Samples may be `step` [s]
    apart, or as far as they usually are.
    """
    if len(t) < 3:
        return t, values
    steps = np.diff(t)
    if steps.max() <= GAP * max(step, float(steps.min())):  # a picture of a large fleet asks this thousands of times
        return t, values
    holes = np.flatnonzero(steps > GAP * max(step, float(np.median(steps))))
    if not len(holes):
        return t, values
    return np.insert(t, holes + 1, np.nan), np.insert(values, holes + 1, np.nan, axis=0)


def origin(runs: Sequence[LoggedRun], title: str) -> Provenance:
    """The origin written into a picture's file: scenario, seed and digest of each run."""
    facts = {
        "scenario": [run.log.run.get("scenario") or run.label for run in runs],
        "seed": [run.log.run.get("seed", "unknown") for run in runs],
        "digest": [run.log.digest for run in runs],
    }
    return Provenance(title, tuple((name, " and ".join(each)) for name, each in facts.items()))


def first_words(names: Sequence[Any], most: int = 6) -> str:
    shown = ", ".join(map(str, names[:most]))
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
