"""The document of `python -m benchmarks`, its tables, and what changed between two of them.

A figure is compared as its ratio to the baseline of the same minute, where it has one, since the machine itself may
have become slower. It changed if two conditions hold. The repeats of the two measurements do not overlap: the worst of
one is better than the best of the other. And the medians are further apart than the repeats of either measurement, and
than `LEAST`. With five repeats each, chance alone separates two equal figures once in 126 times; the two other
conditions keep small and large drifts of the machine out.
"""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from statistics import median

import msgspec
from msgspec import Struct, field
from rich.console import Console as Terminal

from fleet.cores import cores, processor
from fleet.errors import FleetError
from fleet.terminal.table import columns, show

FORMAT = 2  # of the document; another one cannot be compared with this
LEAST = 0.10  # a smaller change counts as noise, however well the repeats agree
FEWEST = 3  # repeats, or the noise is not known
BUSY = 0.5  # load per processor before a measurement from which on it says so
_PACKAGES = ("uuv-fleet", "eclipse-zenoh", "piqp", "numpy", "mcap", "msgspec")


class Figure(Struct, forbid_unknown_fields=True):
    """One figure, measured several times; beside each measurement a baseline that knows nothing of fleets."""

    name: str
    unit: str
    higher_is_better: bool
    samples: list[float]  # in the order of time
    baseline: str = ""  # its name; empty: none, the samples are compared
    ratios: list[float] = field(default_factory=list)  # each sample by the baseline of the same minute
    of_machine: bool = False  # it only says how fast the machine is, and is not judged

    @property
    def best(self) -> float:
        """The best sample: other work on the machine only ever makes a measurement worse."""
        return max(self.samples) if self.higher_is_better else min(self.samples)


class Change(Struct):
    """One figure in two measurements: medians of its ratios, or of its samples where it has no baseline."""

    name: str
    compared: str  # ratio or value
    old: float
    new: float
    times_slower: float  # or larger; below 1: faster
    noise: float  # the larger one of both, of range to median
    verdict: str  # slower, faster, or same: no more than the noise


class Comparison(Struct):
    """Changes since another measurement, and figures that only one of them has."""

    with_: str = field(name="with")
    warnings: list[str]
    changes: list[Change]
    missing: list[str]

    @property
    def slower(self) -> int:
        """How many figures got slower."""
        return sum(change.verdict == "slower" for change in self.changes)


class Measured(Struct, forbid_unknown_fields=True):
    """How fast this machine and this version are."""

    format: int
    began: str  # UTC, as ISO 8601 writes it
    command: str
    machine: dict[str, str]
    busy: float  # load average per processor when it began
    versions: dict[str, str]
    figures: list[Figure]
    comparison: Comparison | None = None


class Collector:
    """Takes measurements one by one and makes figures of them, in the order of the first measurement of each."""

    def __init__(self, *, quick: bool) -> None:
        cpus = os.cpu_count() or 1
        machine = {
            "processors": str(cpus), "processor": processor(), "system": platform.platform(),
            "Python": platform.python_version(), "cores": cores(), "quick": str(quick),
        }  # fmt: skip
        began = datetime.now(UTC).isoformat(timespec="seconds")  # noqa: TID251  for people who read the file
        versions = {name: version(name) for name in _PACKAGES}
        command = shlex.join(["python", "-m", "benchmarks", *sys.argv[1:]])
        self.measured = Measured(FORMAT, began, command, machine, os.getloadavg()[0] / cpus, versions, [])

    def add(
        self,
        name: str,
        unit: str,
        sample: float,
        baseline: tuple[str, float] = ("", 0.0),
        *,
        higher: bool = True,
        of_machine: bool = False,
    ) -> None:
        """Add a measurement; with a baseline, by its name and what it measured at this time."""
        figures = self.measured.figures
        found = next((figure for figure in figures if figure.name == name), None)
        if found is None:
            found = Figure(name, unit, higher, [], baseline[0], of_machine=of_machine)
            figures.append(found)
        found.samples.append(sample)
        if baseline[0]:
            found.ratios.append(sample / baseline[1])


def read(path: Path) -> Measured:
    """The document that `-o` wrote.

    Raises:
        FleetError: it cannot be read, or is something else.
    """
    try:
        measured = msgspec.json.decode(path.read_bytes(), type=Measured)
        if measured.format != FORMAT:
            raise FleetError(f"{path}: expected format {FORMAT}, got {measured.format}; measure again")
    except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise FleetError(f"{path}: expected the figures that -o wrote: {error}") from error
    for figure in measured.figures:
        values = (*figure.samples, *figure.ratios)
        if not figure.samples or len(figure.ratios) not in (0, len(figure.samples)) or min(values) <= 0:
            raise FleetError(f"{path}: expected positive samples, with a ratio each or none, of {figure.name[:80]!r}")
    return measured


def compare(old: Measured, new: Measured, path: Path) -> Comparison:
    """Compare all figures that both have; the old ones come from `path`.

    Raises:
        FleetError: they have no figure in common.
    """
    before = {figure.name: figure for figure in old.figures}
    now = {figure.name: figure for figure in new.figures}
    common = [name for name in now if name in before and _kind(before[name]) == _kind(now[name])]
    if not common:
        raise FleetError(f"{path}: it has no figure that was measured now; measure both with the same options")
    changes = [_change(before[name], now[name]) for name in common]
    of_machine = [change for change in changes if now[change.name].of_machine]
    judged = [change for change in changes if not now[change.name].of_machine]
    missing = dict.fromkeys(name for name in (*before, *now) if name not in common)
    return Comparison(str(path), _warnings(old, new, of_machine), judged, list(missing))


def _kind(figure: Figure) -> tuple[str, bool, str]:
    return figure.unit, figure.higher_is_better, figure.baseline


def _change(old: Figure, new: Figure) -> Change:
    by_ratio = bool(old.ratios and new.ratios)
    before, now = (old.ratios, new.ratios) if by_ratio else (old.samples, new.samples)
    middle = median(before), median(now)
    slower = middle[0] / middle[1] if new.higher_is_better else middle[1] / middle[0]
    noise = max((max(values) - min(values)) / median(values) for values in (before, now))
    verdict = "same"
    apart = min(before) > max(now) or max(before) < min(now)
    if apart and max(slower, 1 / slower) > 1 + max(LEAST, noise) and min(len(before), len(now)) >= FEWEST:
        verdict = "slower" if slower > 1 else "faster"
    return Change(new.name, "ratio" if by_ratio else "value", *middle, slower, noise, verdict)


def _warnings(old: Measured, new: Measured, of_machine: Sequence[Change]) -> list[str]:
    """Why the two may not be comparable."""
    then, now = (measured.machine | measured.versions for measured in (old, new))
    told = [
        f"{what}: {then.get(what, 'none')} then, {now.get(what, 'none')} now"
        for what in dict.fromkeys([*then, *now])
        if then.get(what) != now.get(what)
    ]
    told += [
        f"the machine itself is {change.verdict} now: {change.name}, {change.times_slower:.2f} times the cost"
        for change in of_machine
        if change.verdict != "same"
    ]
    for which, measured in (("then", old), ("now", new)):
        if measured.busy > BUSY:
            told.append(f"the machine was busy {which}: load {measured.busy:.1f} per processor")
    if min(len(figure.samples) for measured in (old, new) for figure in measured.figures) < FEWEST:
        told.append(f"figures with fewer than {FEWEST} repeats: their noise is not known, so they count as same")
    return told


def show_figures(measured: Measured, terminal: Terminal) -> None:
    """Print the best sample of each figure, and the middle one of its ratios to its baseline."""
    rows = [
        (figure.name, f"{figure.best:.0f}" if figure.best >= 1000 else f"{figure.best:.3g}", figure.unit,
         f"{median(figure.ratios):.3g} x {figure.baseline}" if figure.ratios and "loop" not in figure.baseline else "")
        for figure in measured.figures
    ]  # fmt: skip
    show_rows({"figure": 0, "best": 0, "unit": 0, "ratio": 1}, rows, "", terminal)


def show_comparison(found: Comparison, terminal: Terminal) -> None:
    """Print what changed, worst first, and why the two may not be comparable."""
    for warning in found.warnings:
        terminal.print(f"warning: {warning}", highlight=False, markup=False)
    if found.missing:
        terminal.print(f"not compared, since only one has them: {', '.join(found.missing)}", highlight=False)
    changed = sorted((c for c in found.changes if c.verdict != "same"), key=lambda change: -change.times_slower)
    rows = [
        (
            change.verdict,
            change.name,
            f"{max(change.times_slower, 1 / change.times_slower):.2f} x",
            *(f"{value:.3g}" for value in (change.old, change.new)),
            f"{change.noise:.0%}",
        )
        for change in changed
    ]
    if rows:
        headings = {"": 0, "figure": 0, "by": 0, "then": 2, "now": 2, "noise": 3}
        show_rows(headings, rows, f"compared with {found.with_}", terminal)
    same, slower = len(found.changes) - len(changed), found.slower
    terminal.print(
        f"{slower} slower, {len(changed) - slower} faster, {same} the same within the noise", highlight=False
    )


def show_rows(headings: dict[str, int], rows: Sequence[Sequence[str]], title: str, terminal: Terminal) -> None:
    """Print a table, whose columns of words are aligned to the left; `headings` have ranks."""
    words = {"", "figure", "unit", "ratio", "way"}
    found = columns(headings, rows)
    aligned = [replace(column, justify="left") if column.heading in words else column for column in found]
    show(aligned, title, terminal, "-o FILE")
