"""`python -m benchmarks study`: what a run of a study costs beside the bare run, and what memory many runs take.

Each way of making runs is measured in turn with the bare run: the same work in this process, without workers.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from math import inf
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import psutil
from msgspec import Struct
from rich.console import Console as Terminal

from benchmarks.figures import show_rows
from fleet.addons.studies.engine import local_engine
from fleet.addons.studies.one_run import Task, make_run, scenario_of
from fleet.execution.whole_run import run_loaded
from fleet.processes.workers import Workers
from fleet.scenario.loading import load_scenario
from fleet.scenario.text.overrides import SET, Override
from netem.private_folder import PrivateFolder

if TYPE_CHECKING:
    from fleet.addons.studies.sweep import Progress

SCENARIO = "rough-sea"
CHANGES = ("checks={}", "log={every: 10 ticks}")
REPEATS = 3
SHORT_S = 0.2  # simulated: the run of which thousands are made
STEPS = 10  # rows of the table of memory

Make = Callable[[int], None]  # makes so many runs


class WayRow(Struct, frozen=True):
    """One way of making the runs of a study, and how many at a time."""

    way: str
    workers: int
    ready_s: float  # wall time until each worker had made a run; not counted below
    cpu_s: float  # of all processes per run, median of the repeats
    cpu_ratios: list[float]  # the same by that of the bare run beside it, each repeat
    wall_s: float  # per run, median of the repeats
    speed_ups: list[float]  # runs per wall time by that of the bare run, each repeat

    @property
    def overhead(self) -> float:
        """CPU time that is not that of the bare run, as a share of it."""
        return median(self.cpu_ratios) - 1.0


class MemoryRow(Struct, frozen=True):
    """Resident memory of the worker, and of the process that gives out the runs, after some of them."""

    runs: int
    worker_mb: float
    here_mb: float


class StudyMeasured(Struct):
    """What a run of a study costs beside the bare run, or what memory many runs take."""

    runs: int  # of each repeat; with `--memory` all
    duration_s: float  # of a run, simulated
    bare_cpu_s: float | None  # the median of all bare runs
    ways: list[WayRow]
    memory: list[MemoryRow]


class Cost(NamedTuple):
    """Of one run."""

    cpu_s: float
    wall_s: float


def measure_study(runs: int, duration_s: float, workers: int, *, say: Callable[[str], None]) -> StudyMeasured:
    """Measure each way, those with several workers too.

    Raises:
        StudyError: the extra `study` is not installed.
    """
    scenario = load_scenario(SCENARIO, [*CHANGES, f"duration={duration_s} s"])
    text = scenario.to_undrawn_yaml()

    def task(seed: int) -> Task:
        return Task(str(seed), 0, seed, scenario.name, text, inf)

    def bare(count: int) -> None:
        for seed in range(1, count + 1):
            run_loaded(scenario_of(task(seed)))

    ways: list[tuple[str, int, Callable[[], AbstractContextManager[Make]]]] = []
    for count in dict.fromkeys([1, workers]):
        ways.append(("concurrent.futures", count, lambda count=count: _futures(count, task)))  # type: ignore[misc]
        ways.append(("fleet search, shrink", count, lambda count=count: _local(count, task)))  # type: ignore[misc]
        ways.append(("fleet sweep", count, lambda count=count: _swept(count, duration_s)))  # type: ignore[misc]
    bare(1)
    every: list[Cost] = []
    rows = []
    for way, count, opened in ways:
        say(f"{way}, {count} worker{'s' * (count > 1)}")
        began = time.monotonic()
        with opened() as make:
            make(count)
            ready_s = time.monotonic() - began
            costs = []
            for _ in range(REPEATS):
                every.append(_cost(bare, runs))
                costs.append(_cost(make, runs))
        beside = every[-REPEATS:]
        rows.append(
            WayRow(
                way, count, ready_s,
                median(cost.cpu_s for cost in costs),
                [cost.cpu_s / other.cpu_s for cost, other in zip(costs, beside, strict=True)],
                median(cost.wall_s for cost in costs),
                [other.wall_s / cost.wall_s for cost, other in zip(costs, beside, strict=True)],
            )
        )  # fmt: skip
    return StudyMeasured(runs, duration_s, median(cost.cpu_s for cost in every), rows, [])


def measure_memory(runs: int) -> StudyMeasured:
    """Run a study of so many short runs with one worker, and look at its memory and ours.

    Raises:
        StudyError: the extra `study` is not installed.
    """
    rows: list[MemoryRow] = []
    pools: list[Workers] = []

    def look(progress: Progress) -> None:
        if progress.made < runs * (len(rows) + 1) / STEPS:
            return
        worker, here = (psutil.Process(pid).memory_info().rss / 1e6 for pid in (pools[0].pids[0], os.getpid()))
        rows.append(MemoryRow(progress.made, worker, here))

    with _study(1, "ideal", ("checks={}", f"duration={SHORT_S} s"), look, pools) as make:
        make(runs)
    return StudyMeasured(runs, SHORT_S, None, [], rows)


def show_study(measured: StudyMeasured, terminal: Terminal) -> None:
    """Print what each way costs."""
    headings = {"way": 0, "workers": 0, "CPU time\nper run [s]": 2, "overhead\n[%]": 0, "spread\n[%]": 1,
                "x bare\nruns/s": 0, "ready\n[s]": 3}  # fmt: skip
    cells = [
        (
            row.way, str(row.workers), f"{row.cpu_s:.3f}", f"{100 * row.overhead:.1f}",
            f"{100 * (max(row.cpu_ratios) - min(row.cpu_ratios)):.1f}", f"{median(row.speed_ups):.2f}",
            f"{row.ready_s:.1f}",
        )
        for row in measured.ways
    ]  # fmt: skip
    title = (
        f"{SCENARIO}, {measured.duration_s:g} s: {REPEATS} x {measured.runs} runs, "
        f"bare run {measured.bare_cpu_s or 0.0:.3f} s of CPU time"
    )
    show_rows(headings, cells, title, terminal)


def show_memory(measured: StudyMeasured, terminal: Terminal) -> None:
    """Print how memory grows."""
    cells = [(str(row.runs), f"{row.worker_mb:.1f}", f"{row.here_mb:.1f}") for row in measured.memory]
    headings = {"runs": 0, "worker\n[MB]": 0, "this process\n[MB]": 0}
    show_rows(headings, cells, "resident memory of a study with one worker", terminal)


def _cost(make: Make, runs: int) -> Cost:
    """Of this process and all below it."""
    cpu, wall = _cpu_s(), time.monotonic()
    make(runs)
    return Cost((_cpu_s() - cpu) / runs, (time.monotonic() - wall) / runs)


def _cpu_s() -> float:
    me = psutil.Process()
    return sum(sum(process.cpu_times()[:2]) for process in (me, *me.children(recursive=True)))


@contextmanager
def _futures(workers: int, task: Callable[[int], Task]) -> Iterator[Make]:
    spawn = multiprocessing.get_context("spawn")
    # Ctrl-C ends the wait for them here: a worker that gets it too prints a traceback.
    with ProcessPoolExecutor(workers, spawn, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        yield lambda runs: list(pool.map(make_run, map(task, range(1, runs + 1)))).clear()


@contextmanager
def _local(workers: int, task: Callable[[int], Task]) -> Iterator[Make]:
    with local_engine(workers) as engine:
        yield lambda runs: engine.make(map(task, range(1, runs + 1)), lambda _: None, lambda: None)


def _swept(workers: int, duration_s: float) -> AbstractContextManager[Make]:
    return _study(workers, SCENARIO, (*CHANGES, f"duration={duration_s} s"), lambda _: None)


@contextmanager
def _study(
    workers: int,
    scenario: str,
    changes: tuple[str, ...],
    on_progress: Callable[[Progress], None],
    pools: list[Workers] | None = None,
) -> Iterator[Make]:
    """Whole studies with their rows, by the same workers, which go to `pools`."""
    from fleet.addons.studies.plan import Plan
    from fleet.addons.studies.sweep import prepare, run_study

    overrides = tuple(Override(SET, change) for change in changes)
    with PrivateFolder("bench") as place, local_engine(workers) as engine:
        if pools is not None:
            pools.append(engine.workers)
        studies = 0

        def make(runs: int) -> None:
            nonlocal studies
            studies += 1
            plan = Plan(scenario, overrides, seeds=tuple(range(1, runs + 1)))
            store, modules = prepare(plan, place / str(studies))
            run_study(store, engine, on_progress, modules=modules)

        yield make
