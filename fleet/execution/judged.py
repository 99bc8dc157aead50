"""A run that is judged: for scripts and studies, in one process, with a log if asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Never

from fleet.execution.stepped_run import Changes, Run, loaded
from fleet.recorder.journal import Watcher
from fleet.recorder.log_file import LogFile
from fleet.result.result import Result
from fleet.scenario.scenario import Scenario


def run(
    scenario: str | Path | Scenario,
    *,
    set: Changes = (),
    net: Iterable[str] = (),
    fault: Iterable[str] = (),
    seed: int | None = None,
    trust: bool = False,
    progress: Callable[[float], None] | None = None,
    **unknown: Never,
) -> Result:
    """Run a scenario in this process and judge it; no file is written.

    The result is that of `fleet run --in-process --set ...`, to the digest of the log that is not written.

    Args:
        scenario: a shipped name, a file, or a loaded scenario.
        set: changes, as `--set`: a mapping such as `{"network.links": {"*": "loss 30 %"}, "duration": "20 s"}`,
            or texts such as `"duration=20 s"`.
        net: conditions of links, as `--net`: `["1->2 loss 30%"]`.
        fault: further faults, as `--fault`: `["at 10 s for 5 s down 1<->2"]`.
        seed: replaces the scenario's seed.
        trust: run modules, too, that are neither installed nor the user's own.
        progress: called with the simulated time [s] during the run.

    Returns:
        The verdicts and all numbers. A run that breaks is a result, too: its `status` and `reason` say why.

    Raises:
        ScenarioError: with every mistake that was found.
        FleetError: somebody else is to start an agent.
        TypeError: an argument is unknown; keys of the scenario go into `set`.
    """
    return judged(loaded("run", scenario, set, net, fault, seed, trust, unknown), progress)


def judged(
    scenario: Scenario,
    progress: Callable[[float], None] | None = None,
    watcher: Watcher | None = None,
    log: LogFile | None = None,
) -> Result:
    """The result of a scenario that is loaded; see `run`.

    Args:
        watcher: sees every frame.
        log: where the run is recorded; None: nowhere.

    Raises:
        LogError: the log cannot be written.
        CheckError: a check in Python cannot be made.
    """
    with Run.prepared(scenario, log, watcher) as run:
        return run.to_end(progress)
