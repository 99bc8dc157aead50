"""The measurements of `fleet bench` as one document: every figure with its repeated measurements and its baseline."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from statistics import median
from typing import Annotated

from msgspec import Meta, Struct, field

from fleet.cores import cores

FORMAT = 1  # of the document; another one cannot be compared with this
_PACKAGES = ("uuv-fleet", "eclipse-zenoh", "piqp", "numpy", "mcap", "msgspec")


class Figure(Struct, forbid_unknown_fields=True):
    """One figure, measured several times; beside each measurement a baseline that knows nothing of fleets."""

    name: Annotated[str, Meta(description="What was measured.")]
    unit: Annotated[str, Meta(description="Unit of the samples.")]
    higher_is_better: Annotated[bool, Meta(description="Whether more is faster.")]
    samples: Annotated[list[float], Meta(description="Every measurement, in the order of time.", min_length=1)]
    baseline: Annotated[str, Meta(description="Name of the baseline; empty: none, the samples are compared.")] = ""
    ratios: Annotated[
        list[float], Meta(description="Each sample in relation to the baseline of the same minute [1].")
    ] = field(default_factory=list)
    of_machine: Annotated[
        bool, Meta(description="Whether it only says how fast the machine is, so that it is not judged.")
    ] = False

    @property
    def best(self) -> float:
        """The best sample: other work on the machine only ever makes a measurement worse."""
        return max(self.samples) if self.higher_is_better else min(self.samples)

    @property
    def ratio(self) -> float:
        """The middle one of the ratios."""
        return median(self.ratios)


class Machine(Struct, forbid_unknown_fields=True):
    """The machine that was measured."""

    cpus: Annotated[int, Meta(description="Processors that the system counts.")]
    processor: Annotated[str, Meta(description="Name of the processor; empty: the system does not say.")]
    system: Annotated[str, Meta(description="Operating system with its version.")]
    python: Annotated[str, Meta(description="Version of Python.")]
    busy: Annotated[float, Meta(description="Load average of the last minute when it began, per processor [1].")]


class Change(Struct, forbid_unknown_fields=True):
    """One figure in two measurements."""

    name: Annotated[str, Meta(description="What was measured.")]
    compared: Annotated[str, Meta(description="ratio (to the baseline) or value.")]
    old: Annotated[float, Meta(description="The median before.")]
    new: Annotated[float, Meta(description="The median now.")]
    times_slower: Annotated[float, Meta(description="How much slower or larger it became; below 1: faster [1].")]
    noise: Annotated[float, Meta(description="Within one measurement: the larger of both, of range to median [1].")]
    verdict: Annotated[str, Meta(description="slower, faster, or same: no more than the noise.")]

    @property
    def factor(self) -> float:
        """By how much it changed, in either direction: at least 1."""
        return max(self.times_slower, 1 / self.times_slower)


class FiguresComparison(Struct, forbid_unknown_fields=True):
    """Changes since another measurement."""

    with_: Annotated[str, Meta(description="The file of that measurement.")] = field(name="with")
    warnings: Annotated[list[str], Meta(description="Why the two may not be comparable.")]
    changes: Annotated[list[Change], Meta(description="All figures that both have.")]
    missing: Annotated[list[str], Meta(description="Figures that only one of them has.")]

    @property
    def slower(self) -> list[Change]:
        return [change for change in self.changes if change.verdict == "slower"]


class ComparedFiles(Struct):
    """`fleet bench compare --json`: what changed between two measurements."""

    comparison: Annotated[FiguresComparison, Meta(description="What changed.")]


class Measured(Struct, forbid_unknown_fields=True):
    """`fleet bench --json`: how fast this machine and this version are."""

    format: Annotated[int, Meta(description="Version of this document.")]
    began: Annotated[str, Meta(description="When, UTC, as ISO 8601 writes it.")]
    command: Annotated[str, Meta(description="The command that measured.")]
    machine: Annotated[Machine, Meta(description="The machine.")]
    versions: Annotated[dict[str, str], Meta(description="Versions of packages.")]
    cores: Annotated[str, Meta(description="`compiled` or `plain Python`: the cores of world, agents and netem.")]
    quick: Annotated[bool, Meta(description="Whether it was measured with --quick, which says little.")]
    figures: Annotated[list[Figure], Meta(description="The figures.")]
    comparison: Annotated[FiguresComparison | None, Meta(description="With --compare; else null.")] = None

    def figure(self, name: str) -> Figure | None:
        """The figure of this name, if it was measured."""
        return next((figure for figure in self.figures if figure.name == name), None)


class Collector:
    """Takes measurements one by one and makes figures of them. Their order is that of the first measurement of each."""

    def __init__(self) -> None:
        self._figures: dict[str, Figure] = {}

    def add(
        self,
        name: str,
        unit: str,
        sample: float,
        baseline: str = "",
        of_baseline: float = 0.0,
        *,
        higher: bool = True,
        of_machine: bool = False,
    ) -> None:
        """Add a measurement.

        Args:
            baseline: the name of a baseline, if there is one.
            of_baseline: what the baseline measured at this time: the ratio is `sample / of_baseline`.
        """
        figure = self._figures.setdefault(name, Figure(name, unit, higher, [], baseline, of_machine=of_machine))
        figure.samples.append(sample)
        if baseline:
            figure.ratios.append(sample / of_baseline)

    def measured(self, *, quick: bool, machine: Machine, began: str) -> Measured:
        """All of them, with what they were measured on."""
        versions = {name: version(name) for name in _PACKAGES}
        command = shlex.join(["fleet", *sys.argv[1:]])
        return Measured(FORMAT, began, command, machine, versions, cores(), quick, [*self._figures.values()])


def this_machine() -> Machine:
    """The machine, and how busy it is now."""
    cpus = os.cpu_count() or 1
    return Machine(cpus, _processor(), platform.platform(), platform.python_version(), os.getloadavg()[0] / cpus)


def now() -> str:
    """The date and time for a document."""
    return datetime.now(UTC).isoformat(timespec="seconds")  # noqa: TID251  for people who read the file


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            lines = [line for line in file if line.startswith("model name")]
    except OSError:
        return ""
    return lines[0].partition(":")[2].strip() if lines else ""
