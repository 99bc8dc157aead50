"""All faults of a small space, run one after the other: the only search that can say that none of them fails.

A space has every set of up to so many faults, whose kinds, beginnings and lengths are listed. Members with fewer faults
come first, then those that begin earlier and last shorter, so that the first failure is among the smallest ones.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, islice, product
from math import comb, inf
from typing import Any, NamedTuple

from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import NO_MODULES, Modules
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.plan import run_key
from fleet.addons.studies.row import Row
from fleet.addons.studies.shrink import tree_of
from fleet.quantities import QuantityError, show_time, time_ns
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario

Fault = dict[str, Any]
OF_VEHICLES = ("kill", "pause", "mute", "deaf")
KINDS = ("partition", *OF_VEHICLES)
MOST_TIMES = 10_000  # beginnings, and lengths
EXAMPLE = "partition|kill, at 2s..10s/1s, for 1s..6s/1s, up to 2"
_PART = re.compile(r"\s*(?:(at|for)\s+(.+?)|up\s+to\s+(\d+)|([a-z|\s]+?))\s*")
_RANGE = re.compile(r"\s*(.+?)\s*(?:\.\.\s*(.+?)\s*/\s*(.+?))?\s*")


class Space(NamedTuple):
    """The faults of a space."""

    kinds: tuple[str, ...]
    begins_ns: tuple[int, ...]
    lasts_ns: tuple[int, ...]
    most: int  # faults of a member

    def faults(self, vehicles: int) -> list[Fault]:
        """Every single fault of a fleet of so many, the earliest and shortest first."""
        targets = [(kind, target) for kind in self.kinds for target in _targets(kind, vehicles)]
        return [
            {"at": show_time(at), "for": show_time(lasts), kind: target}
            for at, lasts, (kind, target) in product(self.begins_ns, self.lasts_ns, targets)
        ]

    def count(self, vehicles: int) -> int:
        """How many single faults there are. They are counted, and not made: a space may be far too large."""
        targets = sum(2 ** (vehicles - 1) - 1 if kind == "partition" else vehicles for kind in self.kinds)
        return len(self.begins_ns) * len(self.lasts_ns) * targets

    def size(self, vehicles: int) -> int:
        """How many members it has, with the one that has no fault."""
        return sum(comb(self.count(vehicles), k) for k in range(self.most + 1))

    def members(self, vehicles: int) -> Iterator[tuple[Fault, ...]]:
        """Every set of faults, the smallest first."""
        faults = self.faults(vehicles)
        for k in range(self.most + 1):
            yield from combinations(faults, k)


def space_of(text: str) -> Space:
    """Read a space such as `EXAMPLE`. Raises StudyError: it is none."""
    kinds, most = tuple[str, ...](), 1
    times: dict[str, tuple[int, ...]] = {}
    for part in text.split(","):
        found = _PART.fullmatch(part)
        if found is None:
            raise _wrong(f"cannot read {part.strip()!r:.60}")
        when, given, up_to, names = found.groups()
        if when:
            times[when] = _times(when, given)
        elif up_to:
            most = int(up_to)
        else:
            kinds = tuple(dict.fromkeys(name.strip() for name in names.split("|")))
    for kind in kinds:
        if kind not in KINDS:
            raise _wrong(f"there is no kind {kind!r:.40} here: {', '.join(KINDS)}")
    if not kinds or not times.keys() >= {"at", "for"} or not 1 <= most <= 4:
        raise _wrong("expected kinds of faults, when they begin, how long they last, and up to how many (4 at most)")
    if 0 in times["for"]:
        raise _wrong("a fault lasts longer than 0 s")
    return Space(kinds, times["at"], times["for"], most)


def _wrong(problem: str) -> StudyError:
    return StudyError(f"--all: {problem}; write for example --all '{EXAMPLE}'")


def _times(word: str, text: str) -> tuple[int, ...]:
    """`2s..10s/1s`, or a single time, as times [ns]."""
    found = _RANGE.fullmatch(text)
    try:
        if found is None:
            raise QuantityError(text)
        first, last, step = (None if each is None else time_ns(each) for each in found.groups())
    except (QuantityError, ValueError):
        raise _wrong(f"{word}: expected a time, or FIRST..LAST/STEP such as 2s..10s/1s; got {text!r:.40}") from None
    assert first is not None
    if last is None or step is None:
        return (first,)
    if step <= 0 or last < first or (last - first) // step >= MOST_TIMES:
        raise _wrong(f"{word}: expected at most {MOST_TIMES} times, upwards; got {text!r:.40}")
    return tuple(range(first, last + 1, step))


def _targets(kind: str, vehicles: int) -> Iterator[str]:
    """Each vehicle, or each way to cut a fleet into two parts."""
    if kind != "partition":
        yield from map(str, range(1, vehicles + 1))
        return
    for size in range(1, vehicles // 2 + 1):
        for part in combinations(range(1, vehicles + 1), size):
            if 2 * size < vehicles or 1 in part:  # of two halves, each cut once
                rest = (str(i) for i in range(1, vehicles + 1) if i not in part)
                yield f"{','.join(map(str, part))} / {','.join(rest)}"


class WholeSpace(NamedTuple):
    """What came of all members of a space."""

    size: int
    runs: int  # that were judged
    without: int  # runs without a result
    reason: str  # why the first of these has none
    scenario: Scenario | None  # the first member that fails; None: none does
    check: str  # that fails there


def run_all(
    scenario: Scenario,
    space: Space,
    engine: Engine,
    on_progress: Callable[[int], None],
    *,
    check: str | None = None,
    modules: Modules = NO_MODULES,
) -> WholeSpace:
    """Run members of a space until one fails a check, or all were made.

    Args:
        scenario: is run with its own faults and those of a member. Its nemesis is left out.
        space: has the members.
        engine: makes the runs.
        on_progress: gets the number of runs so far.
        check: must fail. None: any check that the scenario states.
        modules: may run besides installed ones.

    Raises:
        StudyError: there is no such check, or the space has no room in the run.
    """
    tree = tree_of(scenario)
    tree.pop("nemesis", None)
    own: list[Fault] = tree.get("faults") or []
    latest = max(space.begins_ns)
    if latest >= scenario.duration_ns:
        raise _wrong(f"a fault begins at {show_time(latest)}, and the run ends at {show_time(scenario.duration_ns)}")
    unstated, rows, failed = scenario.spec.checks.unstated, dict[int, Row](), set[int]()

    def text_of(faults: Sequence[Fault]) -> str:
        return json.dumps(tree | {"faults": [*own, *faults]})

    def tasks() -> Iterator[Task]:
        for number, faults in enumerate(space.members(scenario.vehicles)):
            if failed:
                return
            text, seed = text_of(faults), scenario.seed
            yield Task(run_key(text), number, seed, scenario.name, text, inf, modules, bare=True)

    def take(made: list[Row]) -> None:
        for row in made:
            rows[row.point] = row
            if row.judged and _failing(row, check, unstated):
                failed.add(row.point)
        on_progress(len(rows))

    engine.make(tasks(), take, lambda: on_progress(len(rows)))
    judged = [row for row in rows.values() if row.judged]
    if check is not None and judged and check not in judged[0].checks:
        raise StudyError(f"{scenario.name} has no check {check}")
    lost = [row for _, row in sorted(rows.items()) if not row.judged]
    first = min(failed, default=None)
    least, what = None, ""
    if first is not None:
        faults = next(islice(space.members(scenario.vehicles), first, None))
        least, what = parse_scenario(text_of(faults), scenario.name), _failing(rows[first], check, unstated)[0]
    size = space.size(scenario.vehicles)
    return WholeSpace(size, len(judged), len(lost), lost[0].reason if lost else "", least, what)


def _failing(row: Row, check: str | None, unstated: frozenset[str]) -> list[str]:
    return [one for one in row.failed_checks if (one == check if check is not None else one not in unstated)]
