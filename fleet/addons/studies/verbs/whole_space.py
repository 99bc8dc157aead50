"""`fleet search --all`: every member of a small space of faults, and what that says."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.addons.studies.verbs.study_options import WorkerOptions
from fleet.cli.documents.output import json_is_asked, print_document
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.addons.studies.engine_interface import Engine
    from fleet.addons.studies.modules import Modules
    from fleet.addons.studies.shrink import Shrunk
    from fleet.addons.studies.small_space import Space, WholeSpace
    from fleet.scenario.scenario import Scenario

MOST_MEMBERS = 20_000  # unless --budget gives more
MOST_RUNS = 2000  # that make a failure smaller

Write = Callable[["Scenario"], None]
Show = Callable[["Scenario", "Shrunk", Path], None]


def search_space(
    scenario: Scenario, modules: Modules, text: str, check: str | None, most: float | None, path: Path,
    how: WorkerOptions, write: Write, show: Show,
) -> None:  # fmt: skip
    """Make every run of a space, or stop at the first that fails and make that one small.

    Args:
        scenario: whose faults the members are added to.
        modules: that its runs need.
        text: the space, as it was typed.
        check: that must fail; None: any that the scenario states.
        most: runs that are made at most; None: `MOST_MEMBERS`.
        path: of the least scenario.
        how: workers.
        write, show: what is done with a least scenario.

    Raises:
        StudyError: the space cannot be read, or is too large; or no run came to its end.
        SystemExit: with 1, as a member fails.
    """
    from fleet.addons.studies.errors import StudyError
    from fleet.addons.studies.small_space import run_all, space_of

    space = space_of(text)
    size, limit = space.size(scenario.vehicles), MOST_MEMBERS if most is None else most
    words = f"{size:,} runs: every set of up to {space.most} of {space.count(scenario.vehicles):,} faults"
    if size > limit:
        raise StudyError(f"{words}, and {limit:,g} are made at most: --budget {size} makes them all")
    least = None
    with how.engine(modules) as engine:
        carried = engine.carry(modules)
        took_s = _took_s(scenario, space, engine, carried)
        say(f"{words}; one took {took_s:.2g} s, so with one worker all take about {_span(took_s * size)}", err=True)
        with how.showing(_pieces(size)) as on_progress:
            found = run_all(scenario, space, engine, lambda made: on_progress("", made), check=check, modules=carried)
        if found.scenario is not None:
            from fleet.addons.studies.shrink import Shrinker

            with how.showing(lambda _, doing, runs: [Piece(0, [f"{runs} runs"]), Piece(1, [doing])]) as on_progress:
                least = Shrinker(found.scenario, engine, on_progress, carried).shrink(found.check, MOST_RUNS)
            write(least.scenario)
    _print(scenario, found, least, check, path, show)
    if found.scenario is not None:
        sys.exit(1)
    if not found.runs:
        raise StudyError(f"no run came to its end, so nothing is known: {found.reason}")


def _took_s(scenario: Scenario, space: Space, engine: Engine, modules: Modules) -> float:
    """How long the member without faults takes [s], with reading it."""
    from fleet.addons.studies.small_space import run_all

    began = time.monotonic()
    run_all(scenario, space._replace(most=0), engine, lambda _: None, modules=modules)
    return time.monotonic() - began


def _print(
    scenario: Scenario, found: WholeSpace, least: Shrunk | None, check: str | None, path: Path, show: Show
) -> None:
    if json_is_asked():
        from fleet.addons.studies.verbs.documents import whole_space

        print_document(whole_space(scenario, found, least, path))
        return
    if found.without:
        say(f"{found.without:,} runs have no result, the first one because of: {found.reason}", err=True)
    if found.scenario is not None and least is not None:
        show(found.scenario, least, path)
        return
    which = f"the check {check}" if check else "a check"
    made = f"all {found.size:,} were made" if not found.without else f"{found.runs:,} of {found.size:,} have a result"
    say(f"{made}; none fails {which}. Other seeds draw other losses and delays")


def _pieces(size: int) -> Callable[[StatusLine, str, int], list[Piece]]:
    began = time.monotonic()

    def shown(line: StatusLine, _: str, made: int) -> list[Piece]:
        took_s = time.monotonic() - began
        left = [f"{_span(took_s * (size - made) / made)} left", ""] if made else [""]
        return [Piece(0, [f"{made:,} of {size:,} runs"]), Piece(2, left)]

    return shown


def _span(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
