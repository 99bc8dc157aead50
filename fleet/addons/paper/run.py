"""All cases in parallel, then the pictures, the verdicts and the report."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fleet.addons.paper.cases import CASES, Outcome, U, run_case
from fleet.addons.paper.claims import Claim, judge
from fleet.addons.paper.figures import FIGURES, draw
from fleet.addons.paper.report import write
from fleet.errors import FleetError
from fleet.processes.interrupts import HungUp
from fleet.processes.workers import TIMES, WorkerDied, Workers
from netem.private_folder import PrivateFolder

if TYPE_CHECKING:
    from fleet.result.result import Result


CHECK_S = 3  # simulated time of the distributed run that is compared with the in-process one

_shared: Any = None  # in a worker: simulated seconds of each case

OnProgress = Callable[[str, float], None]  # (what is going on, share of everything that is done)


def reproduce(
    folder: Path, jobs: int, names: Sequence[str], formats: tuple[str, ...], on_progress: OnProgress
) -> tuple[Path, list[Claim], dict[str, Outcome]]:
    """Run cases and write the report into `folder`. Raises FleetError: the folder cannot be written, or a worker
    died."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FleetError(f"cannot make {folder}: {error.strerror}") from None
    network = _network_check(on_progress) if any(CASES[name].group == "network" for name in names) else ""
    times = multiprocessing.get_context("spawn").Array("d", len(names))
    try:
        with Workers(jobs, partial(_share, times)) as workers:
            outcomes = _run_all(workers, names, times, on_progress)
            figures = [name for name in FIGURES if _possible(name, outcomes)]
            drawn = _draw_all(workers, figures, outcomes, folder, formats, on_progress)
    except WorkerDied:
        raise FleetError(f"a worker process died {TIMES} times; is there enough memory?") from None
    claims = judge(outcomes)
    try:
        return write(folder, outcomes, claims, network, drawn), claims, outcomes
    except OSError as error:
        raise FleetError(f"cannot write the report into {folder}: {error.strerror}") from None


def _share(times: Any) -> None:
    global _shared
    _shared = times


def _case(numbered: tuple[int, str]) -> Outcome:
    index, name = numbered

    def progress(seconds: float) -> None:
        _shared[index] = seconds

    return run_case(name, progress)


def _run_all(workers: Workers, names: Sequence[str], times: Any, on_progress: OnProgress) -> dict[str, Outcome]:
    lengths = [CASES[name].scenario().duration_ns / 1e9 for name in names]
    found: dict[str, Outcome] = {}

    def wait() -> None:
        simulated = sum(min(t, length) for t, length in zip(times, lengths, strict=True))
        on_progress(f"{len(found)} of {len(names)} runs, {simulated:.0f} of {sum(lengths):.0f} s simulated",
             0.85 * simulated / sum(lengths))  # fmt: skip

    for (index, name), future in workers.each(_case, enumerate(names), wait):
        found[name] = future.result()
        times[index] = lengths[index]
    return {name: found[name] for name in names}


def _possible(figure: str, outcomes: dict[str, Outcome]) -> bool:
    return any(CASES[name].sea == FIGURES[figure][1] for name in outcomes)


def _outcomes_for(figure: str, outcomes: dict[str, Outcome]) -> dict[str, Outcome]:
    sea = FIGURES[figure][1]
    hidden = ("sensitivity", "exact", "unlimited")
    return {
        name: outcome
        for name, outcome in outcomes.items()
        if CASES[name].sea == sea and CASES[name].group not in hidden
    }


def _draw_all(
    workers: Workers,
    figures: Sequence[str],
    outcomes: dict[str, Outcome],
    folder: Path,
    formats: tuple[str, ...],
    on_progress: OnProgress,
) -> list[str]:
    drawn: dict[str, bool] = {}
    items = ((name, _outcomes_for(name, outcomes)) for name in figures)
    for (name, _), future in workers.each(partial(draw, folder=folder, formats=formats), items):
        try:
            drawn[name] = future.result()
        except OSError as error:
            raise FleetError(f"cannot write {name} into {folder}: {error.strerror}") from None
        on_progress(f"{len(drawn)} of {len(figures)} pictures", 0.85 + 0.15 * len(drawn) / len(figures))
    return [name for name in figures if drawn[name]]


def _go_on(result: Result) -> None:
    """End everything if a signal ended a run. Raises KeyboardInterrupt, or the HungUp among them."""
    from fleet.result.result import Status

    if result.status is Status.HUNG_UP:
        raise HungUp
    if result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt


def _network_check(on_progress: OnProgress) -> str:
    """A few seconds of the network case as real processes over zenoh, against the same in this process."""
    from fleet.execution.execute import execute
    from fleet.execution.options import Options
    from fleet.result.result import Status
    from fleet.scenario.loading import load_scenario

    on_progress("a distributed run, to compare with the in-process one", 0.0)
    case = CASES[f"NBOC-network-{U}"]
    scenario = load_scenario("ideal", ["checks={}", *case.overrides, f"duration={CHECK_S} s"])
    with PrivateFolder() as place:
        run = partial(execute, scenario)
        began = time.monotonic()
        over_zenoh = run(Options(place, quiet=True))
        seconds = time.monotonic() - began
        _go_on(over_zenoh)
        plain = run(Options(place, in_process=True, quiet=True))
        _go_on(plain)
    if over_zenoh.status is not Status.PASS:
        return f"The distributed run broke: {over_zenoh.reason}. The numbers below are from one process."
    same = over_zenoh.digest == plain.digest
    return (
        "NBOC as a distributed fleet at its least latency: every agent sends at every tick, what it sends is usable "
        "one tick (10 ms) later, neighbours are extrapolated with the velocity they sent (dead reckoning). The runs of "
        f"60 s below were made in one process; {CHECK_S} s of the same were also run as {scenario.vehicles} agent "
        f"processes, a world and a network process over zenoh (in {seconds:.1f} s): "
        + (
            f"the same log, message for message (digest {plain.digest[:16]})."
            if same
            else f"**the logs differ** ({over_zenoh.digest[:16]} against {plain.digest[:16]}): please report this."
        )
    )
