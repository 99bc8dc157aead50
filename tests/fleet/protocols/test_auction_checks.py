"""The checks of the auction, on histories that are written down here."""

from __future__ import annotations

from typing import Any

import pytest

from fleet.checks.api import Facts, Failure, Tick
from fleet.protocols.checks import AllVisited, NoConflict

LINE = ((1, 2), (2, 1), (2, 3), (3, 2))
FACTS = Facts("three", 1, 3, 10.0, 0.1, 0.0, LINE, {})
PLACES = [[10, 0, 5], [20, 0, 5]]


class Seen:
    def __init__(self, number: int, values: dict[str, Any] | None) -> None:
        self.id, self.alive, self._values = number, values is not None, values or {}

    def __getitem__(self, signal: str) -> Any:
        return self._values.get(signal)


def failure(check: Any, history: list[tuple[Any, ...]], make: Any) -> tuple[float, Failure] | None:
    """Feed it [t, per vehicle a value; None: it is dead]."""
    for t, *values in history:
        seen = tuple(Seen(k, None if value is None else make(value)) for k, value in enumerate(values, 1))
        if (found := check.step(Tick(round(10 * t), t, seen, (), ()))) is not None:
            return t, found
    return None


def believed(winners: Any) -> dict[str, Any]:
    return {"control.winner": winners and (*winners, *[0.0] * 30)}


BOTH, OTHER = (1.0, 1.0), (0.0, 2.0)


@pytest.mark.parametrize(
    ("history", "at"),
    [
        ([(0.0, BOTH, OTHER, BOTH), (0.5, BOTH, OTHER, BOTH)], None),  # two places by two hops, and one round: 0.5 s
        ([(0.0, BOTH, OTHER, BOTH), (0.6, BOTH, OTHER, BOTH)], 0.6),
        ([(0.0, BOTH, OTHER, BOTH), (0.4, BOTH, BOTH, BOTH), (0.8, BOTH, OTHER, BOTH)], None),  # two short ones
        ([(0.0, BOTH, OTHER, BOTH), (0.6, BOTH, None, BOTH)], None),  # the other one is dead
        ([(0.0, BOTH, OTHER, BOTH), (0.6, BOTH, (), BOTH)], None),  # it has reported nothing yet
        ([(0.0, BOTH, BOTH, BOTH), (9.0, (2.0, 2.0), BOTH, BOTH)], None),  # they disagree, and nobody claims
    ],
)
def test_no_conflict(history: list[Any], at: float | None) -> None:
    found = failure(NoConflict(FACTS, places=PLACES, bundle=2), history, believed)
    assert (found and found[0]) == at
    if found:
        assert (found[1].vehicles, found[1].values) == ((1, 2), {"place": 2.0})


def at(position: tuple[float, float, float]) -> dict[str, Any]:
    return dict(zip(("state.x", "state.y", "state.z"), position, strict=True))


FAR, FIRST, SECOND = (0.0, 0.0, 5.0), (9.0, 0.0, 5.0), (20.0, 1.0, 6.0)


@pytest.mark.parametrize(
    ("history", "found"),
    [
        ([(0.0, FIRST, FAR), (9.0, FAR, SECOND), (10.0, FAR, FAR)], "all 2 places, the last at 9 s"),
        ([(0.0, FIRST, FAR), (10.0, FAR, FAR)], Failure("1 of 2 places not visited: 2")),
        ([(0.0, FAR, FAR), (4.0, FAR, FAR)], Failure("2 of 2 places not visited: 1, 2")),
    ],
)
def test_all_visited(history: list[Any], found: Any) -> None:
    check = AllVisited(FACTS, places=PLACES)
    failed = failure(check, history, at)
    assert (failed and failed[1]) == (found if isinstance(found, Failure) and history[-1][0] == 10.0 else None)
    assert check.verdict() == found


def test_all_visited_in_time() -> None:
    history = [(0.0, FIRST, FAR), (5.0, FAR, FAR), (6.0, FAR, SECOND)]
    failed = failure(AllVisited(FACTS, places=PLACES, by="5 s"), history, at)
    assert failed is not None and failed[0] == 5.0
