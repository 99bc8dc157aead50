"""The plan of a study: which runs it has, each a scenario with a few changes and a seed, in a fixed order."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import prod

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import STANDING
from fleet.addons.studies.spec import LARGEST_SEED, MOST_ALLOWED, BoundarySpec, StudySpec
from fleet.addons.studies.values import Axis, AxisValue, axis
from fleet.scenario.text.overrides import FAULT, NET, SET, Override
from fleet.scenario.trust import TYPED, OverrideOrigin

MOST_RUNS = 10_000_000
MOST_POINTS = 100_000  # which are one file, and are all checked before the first run
# Columns that every study has besides those of checks; `seed` has an error of its own.
TAKEN = frozenset({"key", "point", "scenario", "status", "reason", "passed", "digest", "version", "cores"}) | {
    column.name for column in STANDING
}
_SEED = re.compile(r"[0-9]{1,19}")
_NAME = re.compile(r"\{([A-Za-z_][A-Za-z0-9_]*)\}")


@dataclass(frozen=True, slots=True)
class Point:
    """One combination of values; its runs differ in their seeds only."""

    number: int  # from 0 on
    values: Mapping[str, AxisValue]  # by key of the axis
    changes: tuple[Override, ...]

    @property
    def shown(self) -> str:
        """`loss=10 %, delay=1 s`; empty if nothing is varied."""
        return ", ".join(f"{key}={value.text}" for key, value in self.values.items())


@dataclass(frozen=True, slots=True)
class Plan:
    """The runs of a study, planned."""

    scenario: str  # a shipped name or a file
    changes: tuple[Override, ...] = ()  # of every run; `{name}` stands for the value of the axis of that name
    axes: tuple[Axis, ...] = ()
    zipped: bool = False  # the n-th values of all axes make the n-th point, else every combination is one
    seeds: tuple[int, ...] = (1,)  # of the runs of each point: the same ones, so points can be compared in pairs
    draw: int = 1  # the seed of drawn axes
    origin: OverrideOrigin = TYPED  # of changes and axes; it decides which laws they may name
    most_seeds: int | None = None  # of a point, if seeds are added
    points: tuple[Point, ...] = field(init=False)

    def __post_init__(self) -> None:
        keys = [axis.key for axis in self.axes]
        if twice := next((key for key in keys if keys.count(key) > 1), None):
            raise StudyError(f"{twice} is varied twice: give all its values at once")
        if taken := next((key for key in keys if key in TAKEN), None):
            raise StudyError(f"{taken} is a column of every study: choose another name for the template")
        if "seed" in keys:
            raise StudyError("seeds are varied with --seeds, so that all points have the same ones")
        self._check_names(set(keys))
        lengths = [len(axis.values) for axis in self.axes if not axis.sampled]
        points = max(lengths, default=1) if self.zipped else prod(lengths)
        points *= next((axis.count for axis in self.axes if axis.sampled), 1)
        if points > MOST_POINTS:
            raise StudyError(f"{points} points are too many: at most {MOST_POINTS} are possible")
        seeds = len(self.seeds)
        if self.most_seeds is not None:
            if seeds > self.most_seeds:
                raise StudyError(f"each point begins with {seeds} seeds, and {self.most_seeds} at most are allowed")
            seeds = self.most_seeds
        if seeds > MOST_ALLOWED:
            raise StudyError(f"each point has {seeds} seeds: at most {MOST_ALLOWED} are possible")
        if points * seeds > MOST_RUNS:
            raise StudyError(f"{points * seeds} runs are too many: at most {MOST_RUNS} are possible")
        combinations = self._combinations()
        object.__setattr__(self, "points", tuple(self._point(n, row) for n, row in enumerate(combinations)))

    def __len__(self) -> int:
        return len(self.points) * len(self.seeds)

    def _combinations(self) -> Iterator[tuple[AxisValue, ...]]:
        sampled = [axis for axis in self.axes if axis.sampled]
        grid = [axis for axis in self.axes if not axis.sampled]
        groups: list[list[dict[str, AxisValue]]] = []
        if sampled:
            groups.append(_draw_samples(sampled, self.draw))
        if self.zipped:
            _check_equal({a.key: len(a.values) for a in grid}, "zipped keys need as many values as each other")
            groups.append(
                [
                    dict(zip((axis.key for axis in grid), row, strict=True))
                    for row in zip(*(a.values for a in grid), strict=True)
                ]
            )
        else:
            groups += [[{axis.key: value} for value in axis.values] for axis in grid]
        for parts in product(*groups):
            row: dict[str, AxisValue] = {}
            for part in parts:
                row |= part
            yield tuple(row[axis.key] for axis in self.axes)

    def _point(self, number: int, row: Sequence[AxisValue]) -> Point:
        values = {axis.key: value for axis, value in zip(self.axes, row, strict=True)}
        names = {name for change in self.changes for name in _NAME.findall(change.text)}
        filled = [Override(c.option, _NAME.sub(lambda name: values[name[1]].text, c.text)) for c in self.changes]
        keys = [
            Override(SET, f"{axis.key}={value.text}", f"{axis.option} {axis.key}={value.text}")
            for axis, value in zip(self.axes, row, strict=True)
            if axis.key not in names
        ]
        return Point(number, values, (*filled, *keys))

    def _check_names(self, keys: set[str]) -> None:
        for change in self.changes:
            for name in _NAME.findall(change.text):
                if name not in keys:
                    raise StudyError(
                        f"{change.name}: {{{name}}} stands for the value of --vary {name}=..., which is not there"
                    )


def plan_of(spec: StudySpec, origin: OverrideOrigin = TYPED) -> Plan:
    """The plan of a study's runs. `origin`: where it comes from. Raises StudyError: the values are none, or do not fit
    together."""
    axes = tuple(axis(key, text) for key, text in spec.vary.items())
    most_seeds = spec.most_seeds if spec.until else None
    return Plan(spec.scenario, changes_of(spec), axes, spec.zip, parse_seeds(spec.seeds), spec.draw, origin, most_seeds)


def changes_of(spec: StudySpec | BoundarySpec) -> tuple[Override, ...]:
    keys = (Override(SET, f"{key}={text}") for key, text in spec.set.items())
    return (*keys, *(Override(NET, text) for text in spec.net), *(Override(FAULT, text) for text in spec.fault))


def run_key(text: str) -> str:
    """The name of a run: the first 32 digits of the SHA-256 of its whole scenario."""
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def parse_seeds(text: str) -> tuple[int, ...]:
    """`20`: the seeds 1 to 20; `5..24`: those; `3,7,9`: those. Raises StudyError: it is none of them."""
    words = re.split(r"\.\.|,", text)
    numbers = [int(word) for word in words if _SEED.fullmatch(word.strip())]
    seeds: Sequence[int] = ()
    if len(numbers) == len(words) and max(numbers) <= LARGEST_SEED:
        if ".." in text:
            if "," not in text and len(numbers) == 2 and numbers[1] - numbers[0] < MOST_RUNS:
                seeds = range(numbers[0], numbers[1] + 1)
        elif "," in text:
            seeds = list(dict.fromkeys(numbers))
        elif numbers[0] <= MOST_RUNS:
            seeds = range(1, numbers[0] + 1)
    if not seeds:
        raise StudyError(f"expected a number of seeds such as 20, or seeds such as 5..24 or 3,7,9, got '{text[:40]}'")
    return tuple(seeds)


def _check_equal(counts: Mapping[str, int], otherwise: str) -> None:
    if len(set(counts.values())) > 1:
        raise StudyError(f"{otherwise}: {', '.join(f'{key} {count}' for key, count in counts.items())}")


def _draw_samples(axes: Sequence[Axis], seed: int) -> list[dict[str, AxisValue]]:
    """Samples of all sampled axes together: each is one value of each axis.

    Samples that are equal after rounding count as one.
    """
    from scipy.stats import qmc

    counts = {axis.key: axis.count for axis in axes}
    _check_equal(counts, "keys that are drawn are drawn together, so they need the same count")
    kinds = {axis.how for axis in axes}
    if len(kinds) > 1:
        raise StudyError("keys that are drawn are drawn together: all random, or all latin")
    import numpy as np

    generator = np.random.default_rng(seed)
    shape = axes[0].count, len(axes)
    shares = (
        generator.random(shape) if kinds == {"random"} else qmc.LatinHypercube(shape[1], rng=generator).random(shape[0])
    )
    drawn = dict.fromkeys(tuple(axis.at(float(share)) for axis, share in zip(axes, row, strict=True)) for row in shares)
    return [dict(zip(counts, values, strict=True)) for values in drawn]
