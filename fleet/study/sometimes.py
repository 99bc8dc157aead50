"""Checks with `sometimes`: some run of many must reach them. They are counted over the runs of a study or a search.

A search that finds no failure says little if its runs never came where a failure could be. So a check with `sometimes`
names such a place. No single run fails for it. If none of many runs reaches it, the search gives no bound.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from fleet.scenario.scenario import Scenario

PREFIX = "sometimes."  # of a column that is 1 in runs that reached it, and 0 in others


def column_of(name: str) -> str:
    """The column of a check."""
    return PREFIX + name


def names_of(scenarios: Iterable[Scenario]) -> list[str]:
    """The names of the checks of these scenarios that some run must reach."""
    checks = (check for scenario in scenarios for check in scenario.spec.checks.own())
    return list(dict.fromkeys(check.name for check in checks if check.sometimes))


@dataclass(slots=True)
class Reached:
    """How often one such check was reached."""

    name: str
    runs: int = 0  # in which it was judged
    hits: int = 0  # of these, that reached it
    seed: int | None = None  # the least that reached it

    def count(self, row: Mapping[str, Any]) -> None:
        """Count a run."""
        reached = row.get(column_of(self.name))
        if reached is None:
            return
        self.note(row["seed"], reached=bool(reached))

    def note(self, seed: int, *, reached: bool) -> None:
        """Count a run by its seed."""
        self.runs += 1
        if reached:
            self.hits += 1
            self.seed = seed if self.seed is None else min(self.seed, seed)

    @property
    def words(self) -> str:
        """In words."""
        if not self.hits:
            return f"{self.name} was reached in none of {self.runs} runs"
        return f"{self.name} was reached in {self.hits} of {self.runs} runs, the first seed is {self.seed}"
