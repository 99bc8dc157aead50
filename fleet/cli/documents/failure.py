"""The output with `--json` of every command that fails before it has a result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta, Struct

from fleet.errors import MOST_SHOWN, Problem, ScenarioError


class ProblemRow(Struct):
    """One mistake in a scenario."""

    file: Annotated[str, Meta(description="Where it is: a path, or an option with its text, as in `--set seed=x`.")]
    line: Annotated[int, Meta(description="From 1; 0: no line is to blame.")]
    column: Annotated[int, Meta(description="From 1; 0: no line is to blame.")]
    key: Annotated[str, Meta(description="Key of the scenario, as `--set` writes it; empty: of no key.")]
    message: str
    hint: Annotated[str, Meta(description="May be empty.")]


class FailedCommand(Struct):
    """The output with `--json` in place of a document when a command fails. Stderr says the same in words."""

    error: str
    exit: int
    problems: Annotated[list[ProblemRow], Meta(description="The first 200.")]


def failure(error: Exception, message: str, status: int) -> FailedCommand:
    """The document of an error."""
    problems = error.problems[:MOST_SHOWN] if isinstance(error, ScenarioError) else ()
    return FailedCommand(message, status, problem_rows(problems))


def problem_rows(problems: Sequence[Problem]) -> list[ProblemRow]:
    """Mistakes in a scenario as they are printed."""
    return [ProblemRow(p.file, p.line, p.column, p.key, p.message, p.hint) for p in problems]
