"""The row of a run: what it came to, as workers send it and as a study keeps it.

It also has what is made of several rows: whether two runs of the same agree, and how often a check with `sometimes` was
reached. No single run fails for such a check. If none of many runs reaches it, a search gives no bound: its runs never
came where a failure could be.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import nan

from msgspec import Struct, structs

from fleet.result.result import Status
from fleet.scenario.scenario import Scenario

FAILED = "failed"  # the status of a run that has no result
LATE = "late"  # of one whose host was late, so that it says nothing about its programs
STATUSES = (FAILED, LATE, *Status)
_JUDGED = frozenset({"pass", "check_failed"})  # of one that came to its end


def run_name(point: int, seed: int) -> str:
    """The name of the directory of a run that a study has kept."""
    return f"point-{point}-seed-{seed}"


PREFIX = "sometimes."  # of the number that is 1 in runs that reached a check, and 0 in others


class CheckRow(Struct, frozen=True):
    """The verdict of one check; of several of one name the worst."""

    passed: bool | None  # None: not judged
    value: float | None = None
    margin: float | None = None

    def and_then(self, other: CheckRow) -> CheckRow:
        values = [value for value in (self.value, other.value) if value is not None]
        margins = [margin for margin in (self.margin, other.margin) if margin is not None]
        passed = min(self.passed, other.passed, key=(False, None, True).index)
        return CheckRow(passed, max(values, default=None), min(margins, default=None))


class PartRow(Struct, frozen=True):
    """What a part of a run came to: the least margin, (margin, tick) on the way to it, and the ticks it took."""

    best: float
    places: list[tuple[float, int]]
    ticks: int


class Row(Struct, kw_only=True):
    point: int = 0
    seed: int
    status: str  # one of `STATUSES`
    key: str = ""  # names the run: see `plan.run_key`
    reason: str = ""
    passed: bool | None = None
    checks: dict[str, CheckRow] = {}
    numbers: dict[str, float] = {}  # by measure; one that is missing is NaN
    digest: str | None = None  # of the log
    version: str = ""  # of fleet
    cores: str = ""
    part: PartRow | None = None
    futures: list[Row] = []  # of a task that asked for several futures of a run

    @property
    def has_result(self) -> bool:
        return self.status not in (FAILED, LATE)

    @property
    def judged(self) -> bool:
        """Whether the run came to its end."""
        return self.status in _JUDGED

    def verdict(self, check: str) -> bool | None:
        """Whether the run passed a check; empty: all of them. None: that was not judged."""
        if not check:
            return self.passed
        return self.checks[check].passed if check in self.checks else None

    @property
    def failed_checks(self) -> list[str]:
        return [name for name, check in self.checks.items() if check.passed is False]

    def number(self, name: str) -> float:
        """A measure; NaN: the run does not have it."""
        return self.numbers.get(name, nan)

    def compare(self, again: Row) -> Row:
        """The row of a run that failed and was repeated, with a digest if either has one; if both disagree, a row
        without a result that says so.

        A run is a function of scenario and seed, so both must agree.
        """
        if again.judged and self.failed_checks == again.failed_checks:
            return self if self.digest is not None else structs.replace(again, key=self.key)
        failed = ", ".join(self.failed_checks)
        if again.judged:
            got = f"failed {', '.join(again.failed_checks) or 'none'} when it was repeated"
        else:
            got = f"had no result when it was repeated: {again.reason}"
        logs = ""
        if self.digest is not None and again.digest is not None:
            logs = f", with {'the same' if self.digest == again.digest else 'another'} log"
        text = f"not reproduced: the run with seed {self.seed} failed {failed}, and {got}{logs}"
        why = "One of the scenario's plug-ins depends on more than the seed, or this is a defect of uuv-fleet"
        return structs.replace(
            self, status=FAILED, reason=f"{text}. {why}", passed=None, checks={}, numbers={}, digest=None
        )


VOTES = 3  # of runs on the wall clock, which repeat well, and not exactly


def majority(rows: Sequence[Row], check: str = "") -> tuple[Row, int, int]:
    """What most of some runs of the same came to.

    Args:
        rows: the runs, of which some may have no verdict.
        check: what has to fail; empty: any.

    Returns:
        One of the rows that stands for them: one that failed, if more than half of those with a verdict did. Then how
        many failed, and how many had a verdict.
    """
    judged = [row for row in rows if row.judged]
    failed = [row for row in judged if (check in row.failed_checks if check else row.failed_checks)]
    if not judged:
        return rows[0], 0, 0
    most = failed if 2 * len(failed) > len(judged) else [row for row in judged if row not in failed]
    return (most or judged)[0], len(failed), len(judged)


def sometimes_names(scenarios: Iterable[Scenario]) -> list[str]:
    """The names of the checks of these scenarios that some run must reach."""
    checks = (check for scenario in scenarios for check in scenario.spec.checks.own())
    return list(dict.fromkeys(check.name for check in checks if check.sometimes))


@dataclass(slots=True)
class Reached:
    """How often a check that some run must reach was reached."""

    name: str
    runs: int = 0  # in which it was judged
    hits: int = 0  # of these, that reached it
    seed: int | None = None  # the least that reached it

    def count(self, row: Row) -> None:
        reached = row.number(PREFIX + self.name)
        if reached == reached:
            self.note(row.seed, reached=bool(reached))

    def note(self, seed: int, *, reached: bool) -> None:
        self.runs += 1
        if reached:
            self.hits += 1
            self.seed = seed if self.seed is None else min(self.seed, seed)

    @property
    def words(self) -> str:
        if not self.hits:
            return f"{self.name} was reached in none of {self.runs} runs"
        return f"{self.name} was reached in {self.hits} of {self.runs} runs, the first seed is {self.seed}"


class Covered(Struct, frozen=True):
    """The episodes of a search, what was drawn in them, and how likely they held given patterns."""

    episodes: int
    kinds: dict[str, int]  # episodes: of `isolations`, of `splits`, and `mixed`
    faults: dict[str, int]  # by kind
    unit_s: float
    stated_by: str  # what states the unit
    two: float | None  # probability of a pattern of two vehicles that are cut off, each in a given unit of one episode
    three: float | None  # None: no partition is drawn
