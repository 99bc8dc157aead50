"""Claims and the checks they are broken into.

A check belongs to a reading (the printed cost, the corrected cost, ...), says what it asks, and has the numbers of
the runs beside it. It asks once per vehicle, or per vehicle and controller compared with: *yes* if every answer is,
*no* if none is, else *partly*. So is a claim: reproduced if every check is a yes, not if every one is a no.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from fleet.reproduce.cases import Outcome

CLOSE = 0.02  # numbers within 2 % of each other count as equal

Outcomes = Mapping[str, Outcome]


@dataclass(frozen=True, slots=True)
class ClaimCheck:
    """One question with its answers."""

    reading: str
    asks: str
    holds: tuple[bool, ...]
    numbers: str

    @property
    def answer(self) -> str:
        return "yes" if all(self.holds) else "partly" if any(self.holds) else "no"

    @property
    def answer_text(self) -> str:
        """The answer, and for *partly* the count."""
        return f"partly ({sum(self.holds)} of {len(self.holds)})" if self.answer == "partly" else self.answer


@dataclass(frozen=True, slots=True)
class Claim:
    """One sentence of the paper and what became of it."""

    text: str
    where: str
    checks: tuple[ClaimCheck, ...]
    remark: str = ""

    @property
    def verdict(self) -> str:
        return {"yes": "reproduced", "no": "not reproduced", "partly": "partly"}[_together(self.checks)]

    @property
    def readings(self) -> str:
        """Under which reading it holds, and under which it does not."""
        by_reading: dict[str, list[ClaimCheck]] = {}
        for check in self.checks:
            by_reading.setdefault(check.reading, []).append(check)
        return "; ".join(f"{reading}: {_summary(checks)}" for reading, checks in by_reading.items())


def _together(checks: Sequence[ClaimCheck]) -> str:
    answers = {check.answer for check in checks}
    return answers.pop() if len(answers) == 1 else "partly"


def _summary(checks: Sequence[ClaimCheck]) -> str:
    answers = [check.answer for check in checks]
    if len(set(answers)) == 1:
        return answers[0]
    return ", ".join(f"{answers.count(word)} {word}" for word in ("yes", "partly", "no") if word in answers)


def below(
    o: Outcomes,
    reading: str,
    asks: str,
    mine: str,
    others: Iterable[str],
    key: str,
    *,
    factor: float = 1.0 - CLOSE,
    channel: int | None = None,
    vehicles: slice = slice(None),
    form: str = ".4f",
    unit: str = "",
) -> ClaimCheck:
    """Whether a number of each vehicle is less than `factor` of the same vehicle's with each other controller."""
    own = each(o[mine], key, channel)[vehicles]
    holds: list[bool] = []
    texts = [f"{pretty(mine)} {show(own, form)} {unit if any(x is not None for x in own) else ''}".rstrip()]
    for other in others:
        theirs = each(o[other], key, channel)[vehicles]
        less = [x is not None and x < factor * (inf if y is None else y) for x, y in zip(own, theirs, strict=True)]
        texts.append(f"{pretty(other)} {show(theirs, form)} ({sum(less)} of {len(less)})")
        holds += less
    return ClaimCheck(reading, asks, tuple(holds), "; ".join(texts))


def limited(reading: str, asks: str, values: Sequence[float], limit: float, numbers: str) -> ClaimCheck:
    """Whether every one of some numbers is below a limit."""
    return ClaimCheck(reading, asks, tuple(value < limit for value in values), numbers)


def unbeaten(o: Outcomes, reading: str, what: str, mine: str, others: Iterable[str], sea: str, key: str) -> ClaimCheck:
    """Whether the mean of the fleet is nowhere better by more than 2 %; who has not settled is not the best."""
    own = mean(o[mine], key)
    theirs = {name: mean(o[f"{name}-{sea}"], key) for name in others}
    holds = tuple(isfinite(own) and own <= (1.0 + CLOSE) * value for value in theirs.values())
    form = ".2f" if key.endswith("_s") else ".3g"
    numbers = ", ".join(f"{pretty(name)} {_or_not(value, form)}" for name, value in {mine: own, **theirs}.items())
    return ClaimCheck(reading, f"{what}, mean of the fleet: nobody beats NBOC by more than {CLOSE:.0%}", holds, numbers)


def each(outcome: Outcome, key: str, channel: int | None = None) -> list[Any]:
    """A number of every vehicle."""
    return [row[key] if channel is None else row[key][channel] for row in outcome.metrics]


def mean(outcome: Outcome, key: str) -> float:
    """The mean over the fleet; infinite if a vehicle has not settled."""
    values = [inf if value is None else value for value in each(outcome, key)]
    return float(sum(values) / len(values))


def show(values: Sequence[float | None], form: str) -> str:
    """Numbers in a row."""
    if all(value is None for value in values):
        return "not settled"
    return (", " if None in values else " ").join(_or_not(inf if v is None else v, form) for v in values)


def _or_not(value: float, form: str) -> str:
    return "not settled" if value == inf else format(value, form)


def pretty(name: str) -> str:
    """A run's controller, with what is special about it."""
    words = name.split("-")
    special = {"consistent": " (corrected cost)", "k_max": " (no bound on K)"}
    return words[0] + "".join(text for word, text in special.items() if word in words)
