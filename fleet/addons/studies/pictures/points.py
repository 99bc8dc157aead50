"""The source of a study's pictures: at each point an estimate of a number, and the number of runs that lack it."""

from __future__ import annotations

import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite, nan, prod
from typing import Any, Literal, NamedTuple

import numpy as np
import yaml

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import CHECK, MEASURES
from fleet.addons.studies.plan import MOST_RUNS
from fleet.addons.studies.signal_measures import find_columns
from fleet.addons.studies.statistics import Estimate, median, pass_rate
from fleet.addons.studies.store import Store
from fleet.addons.studies.summary import DEFAULT
from fleet.mcap.records import Array

PASSED = "passed"
Value = float | str
Key = tuple[Value, ...]  # of a point: the values of the dimensions
NOT_NEEDED, NOT_MADE, NO_RESULT, MADE = range(4)  # the states of a run


def is_share(name: str) -> bool:
    """Whether a column says of each run if it passed."""
    return name == PASSED or name.startswith(CHECK)


class Lack(NamedTuple):
    """How many runs of a point do not have a number, by the reason."""

    not_made: int
    failed: int  # without a result
    without: int  # with a result that does not have it, as the settling time of what never settled


@dataclass(frozen=True, slots=True)
class VariedKey:
    """A varied key: its values, numbers in ascending order. If they are words, `unit` is None."""

    key: str
    unit: str | None
    values: Key

    @property
    def name(self) -> str:
        return key_words(self.key)

    def shown(self, value: Value) -> str:
        return value_words(value) if isinstance(value, str) else f"{value:.4g} {self.unit or ''}".rstrip()


@dataclass(frozen=True, slots=True)
class Cell:
    estimate: Estimate
    values: tuple[float, ...]  # of the runs that have it
    lack: Lack

    @property
    def runs(self) -> int:
        """How many were asked for."""
        return len(self.values) + sum(self.lack)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number at every point."""

    name: str  # of the measure
    kind: Literal["share", "number", "difference"]  # of runs that passed; else medians, a `difference` of pairs of runs
    what: str  # in words, with its unit
    dimensions: tuple[VariedKey, ...]
    cells: Mapping[Key, Cell]
    pair: str = ""  # the difference in words, if there is only one


@dataclass(frozen=True)
class Points:
    """The runs of a study as arrays of (points, seeds); NaN where a run does not have the number.

    Infinite: it does not have it, and that counts as larger than every number, as a time that never came.
    """

    dimensions: tuple[VariedKey, ...]
    keys: tuple[Key, ...]  # of the points
    state: Array
    numbers: Mapping[str, Array]  # by column: `passed` as 0 or 1, and measures
    units: Mapping[str, str]  # of the measures
    check: str = ""  # that says whether a run passed; empty: all do
    seeds: tuple[int, ...] = ()  # of the columns
    _known: dict[str, Quantity] = field(default_factory=dict, repr=False)

    @cached_property
    def product(self) -> bool:
        """Whether every value of a number was run with every value of the others: no sample, and not zipped."""
        places = [k for k, dimension in enumerate(self.dimensions) if dimension.unit is not None]
        found = {tuple(key[k] for k in places) for key in self.keys}
        return len(found) == prod(len(self.dimensions[k].values) for k in places)

    def words(self, name: str) -> str:
        if is_share(name):
            check = self.check if name == PASSED else name.removeprefix(CHECK)
            return f"runs that passed{check and ' '}{check} [%]"
        what = MEASURES[name].what if name in MEASURES else name
        return f"{what} [{self.units[name]}]" if self.units[name] else what

    def quantity(self, name: str) -> Quantity:
        kind: Literal["share", "number"] = "share" if is_share(name) else "number"
        if name not in self._known:  # intervals take a while
            rows = zip(self.keys, self.state, self.numbers[name], strict=True)
            cells = {key: _cell(kind, *row) for key, *row in rows}
            self._known[name] = Quantity(name, kind, self.words(name), self.dimensions, cells)
        return self._known[name]

    def pairs(self, place: int) -> list[tuple[Key, int, int]]:
        """Every point but those with the first value of a dimension: its key, its number, that of the first value."""
        first, numbers = self.dimensions[place].values[0], {key: k for k, key in enumerate(self.keys)}
        found = [(key, k, numbers.get((*key[:place], first, *key[place + 1 :]))) for key, k in numbers.items()]
        return [(key, k, base) for key, k, base in found if base is not None and base != k]

    def differences(self, place: int, name: str) -> Quantity:
        """A column of the other values of a dimension minus that of its first value, run by run with the same seed.

        In a sampled study the dimensions that are numbers are left out, and so all pairs make one cell.
        """
        dimension, column = self.dimensions[place], self.numbers[name]
        first, *others = dimension.values
        gathered: dict[Key, list[tuple[Array, Array]]] = {}
        kept = [k for k, each in enumerate(self.dimensions) if self.product or each.unit is None]
        for key, k, base in self.pairs(place):
            named = (*key[:place], minus(key[place], first), *key[place + 1 :])
            with np.errstate(invalid="ignore"):
                difference = np.where(column[k] == column[base], 0.0, column[k] - column[base])
            pair = np.minimum(self.state[k], self.state[base]), difference
            gathered.setdefault(tuple(named[i] for i in kept), []).append(pair)
        both = VariedKey(dimension.key, None, tuple(minus(other, first) for other in others))
        dimensions = [both if k == place else self.dimensions[k] for k in kept]
        cells = {
            key: _cell("difference", *(np.concatenate(each) for each in zip(*rows, strict=True)))
            for key, rows in gathered.items()
        }
        only = str(both.values[0]) if len(others) == 1 else ""
        return Quantity(name, "difference", self.words(name), tuple(dimensions), cells, only)


def factors(points: Points) -> list[int]:
    """The dimensions whose values can be compared in pairs, by place: words, and more than one."""
    return [k for k, each in enumerate(points.dimensions) if each.unit is None and len(each.values) > 1]


def load(store: Store, measures: Sequence[str] = ()) -> Points:
    """The points of a study with some measures; none: those of the table of `fleet sweep`. Raises StudyError: there is
    no such measure, or the study is damaged."""
    asked = measures or store.record.measures or DEFAULT
    columns = {column.name: column for column in find_columns(asked, store.record.every_column)}
    axes, seeds = store.record.axes, store.seeds
    keys = tuple(tuple(point.values[axis.key] for axis in axes) for point in store.points)
    if len(set(keys)) < len(keys):
        raise StudyError(f"{store.directory} is damaged: one of its points is there twice")
    if not all(isfinite(value) for key in keys for value in key if not isinstance(value, str)):
        raise StudyError(f"{store.directory} is damaged: a value of a point is no number")
    place = {seed: k for k, seed in enumerate(seeds)}
    at, point, made = array("q"), array("q"), array("b")
    read = {name: array("d") for name in (PASSED, *columns)}
    for row in store.rows([*columns]):
        at.append(place[row.seed])
        point.append(row.point)
        made.append(MADE if row.has_result else NO_RESULT)
        read[PASSED].append(nan if row.passed is None else row.passed)
        for name in columns:
            read[name].append(row.number(name))
    wanted = store.needed_seeds()
    needed = np.array([wanted[k] for k in range(len(keys))], int)
    most = max(int(needed.max(initial=0)), max(at, default=0) + 1)
    if not keys or len(keys) * most > MOST_RUNS:
        raise StudyError(f"{store.directory} is damaged: it has {len(keys)} points and {most} seeds")
    state = np.where(np.arange(most) < needed[:, None], NOT_MADE, NOT_NEEDED)
    state[point, at] = made
    numbers = {}
    for name, values in read.items():
        numbers[name] = np.full(state.shape, np.nan)
        numbers[name][point, at] = values
        numbers[name][~np.isfinite(numbers[name])] = np.nan
        if name in columns and columns[name].missing_is_largest:
            numbers[name][np.isnan(numbers[name]) & (state == MADE)] = np.inf
    varied: list[dict[Any, None]] = [dict.fromkeys(key[k] for key in keys) for k in range(len(axes))]
    dimensions = tuple(
        VariedKey(axis.key, axis.unit, tuple(some if axis.unit is None else sorted(some)))
        for axis, some in zip(axes, varied, strict=True)
    )
    units = {name: column.unit for name, column in columns.items()}
    columns_of = (*seeds, *range(-1, len(seeds) - most - 1, -1))[:most]  # a seed that is not known yet has no pair
    return Points(dimensions, keys, state, numbers, units, store.record.check, columns_of)


def joined(each: Sequence[Points], names: Sequence[str]) -> Points:
    """Several studies as one, in which the first thing that is varied is the study. Runs with the same seed are pairs.

    Raises StudyError: the studies vary other things, or other checks say what passed.
    """
    first = each[0]
    for other, name in zip(each[1:], names[1:], strict=True):
        axes = [[(axis.key, axis.unit) for axis in one.dimensions] for one in (first, other)]
        if axes[0] != axes[1]:
            shown = [", ".join(key for key, _ in axis) or "nothing" for axis in axes]
            raise StudyError(f"{names[0]} varies {shown[0]}, and {name} varies {shown[1]}: compare studies of the same")
        if first.check != other.check:
            checks = [one.check or "all checks" for one in (first, other)]
            raise StudyError(
                f"{checks[0]} tells what passed in {names[0]}, and {checks[1]} in {name}: compare alike ones"
            )
    seeds = tuple(dict.fromkeys(seed for one in each for seed in one.seeds))
    place = {seed: k for k, seed in enumerate(seeds)}
    keys = tuple((name, *key) for one, name in zip(each, names, strict=True) for key in one.keys)
    columns = [name for name in first.numbers if all(
        name in one.numbers and one.units.get(name) == first.units.get(name) for one in each)]  # fmt: skip

    def gathered(tables: Sequence[Array], empty: float) -> Array:
        found: Array = np.full((len(keys), len(seeds)), empty, tables[0].dtype)
        row = 0
        for one, table in zip(each, tables, strict=True):
            found[row : row + len(table), [place[seed] for seed in one.seeds]] = table
            row += len(table)
        return found

    together: list[dict[Any, None]] = [dict.fromkeys(key[k] for key in keys) for k in range(len(keys[0]))]
    varied = (VariedKey("study", None, ()), *first.dimensions)
    dimensions = tuple(
        VariedKey(axis.key, axis.unit, tuple(values if axis.unit is None else sorted(values)))
        for axis, values in zip(varied, together, strict=True)
    )
    numbers = {name: gathered([one.numbers[name] for one in each], np.nan) for name in columns}
    state = gathered([one.state for one in each], NOT_NEEDED)
    return Points(dimensions, keys, state, numbers, first.units, first.check, seeds)


def minus(value: Value, first: Value) -> str:
    return f"{value} - {first}"


def _cell(kind: str, state: Array, values: Array) -> Cell:
    finite, made = values[np.isfinite(values)], int((state == MADE).sum())
    lack = Lack(int((state == NOT_MADE).sum()), int((state == NO_RESULT).sum()), made - len(finite))
    found = tuple(map(float, finite))
    if kind == "share":
        return Cell(pass_rate(round(sum(found)), len(found)), found, lack)
    return Cell(median(values[~np.isnan(values)].tolist()), found, lack)


_KEYS = {
    "vehicles": "number of vehicles",
    "network.period": "time between rounds",
    "network.acoustic": "acoustic channel",
    "neighbours.extrapolate": "extrapolation of neighbours",
    "neighbours.horizon": "horizon of the extrapolation",
}
_LINKS = re.compile(r"network\.links\.(?P<links>[^.]+)(?:\.states\.(?P<state>[^.]+))?\.(?P<what>\w+)")
_MAP = re.compile(r"\{[^{}]*\}")
_NUMBER = re.compile(r"[-+.]?\d")


def key_words(key: str) -> str:
    """A key in words, for axes, legends and titles: `network.links.*.loss` is `loss of every link`."""
    if key in _KEYS:
        return _KEYS[key]
    link = _LINKS.fullmatch(key)
    if link is not None:
        links = "every link" if link["links"] == "*" else f"link {link['links']}"
        state = f" in state {link['state']}" if link["state"] else ""
        return f"{link['what'].replace('_', ' ')}{state} of {links}"
    return key.replace(".", " ").replace("_", " ")


def short_words(key: str) -> str:
    """The last word of a key, for titles that have no room for more."""
    return key.rpartition(".")[2].replace("_", " ")


def value_words(value: Any) -> str:
    """A value in words: `{modem: fsk-80, slot: 3 s}` is `fsk-80, slot 3 s`; also within a difference."""
    return _MAP.sub(lambda found: _map_words(found[0]), str(value))


def _map_words(text: str) -> str:
    if "&" in text or len(text) > 1000:  # a study may come from anybody, and an anchor may stand for millions of words
        return text
    try:
        values = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
    if not isinstance(values, dict) or not values:
        return text
    return ", ".join(_pair(str(key).replace("_", " "), value) for key, value in values.items())


def _pair(key: str, value: Any) -> str:
    if isinstance(value, bool):
        return key if value else f"no {key}"
    if isinstance(value, str) and not _NUMBER.match(value):
        return value
    return f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
