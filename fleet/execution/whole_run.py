"""A whole run in this process, from its first tick to its result, for scripts and studies."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Never

from fleet.execution.directory import RunDirectory
from fleet.execution.stepped_run import Changes, Run, Watcher, load_for
from fleet.execution.triggered import resolve_triggers
from fleet.recorder.log_file import LogFile, NoLog
from fleet.result.file import write_result
from fleet.result.result import Result
from fleet.scenario.scenario import Scenario
from world.plugins.output import lines_go_into


def run(
    scenario: str | Path | Scenario,
    *,
    set: Changes = (),
    net: Iterable[str] = (),
    fault: Iterable[str] = (),
    seed: int | None = None,
    trust: bool = False,
    out: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
    **unknown: Never,
) -> Result:
    """Run a scenario in this process and judge it.

    The result is that of `fleet run --in-process --set ...`, to the digest of the log, written or not.

    Example:
        >>> result = fleet.run("paper", set={"duration": "30 s"}, out="runs")
        >>> log = fleet.open_log(result.directory)

    Args:
        scenario: a shipped name, a file, or a loaded scenario.
        set: changes, as `--set`: a mapping such as `{"network.links": {"*": "loss 30 %"}, "duration": "20 s"}`,
            or texts such as `"duration=20 s"`.
        net: conditions of links, as `--net`: `["1->2 loss 30%"]`.
        fault: further faults, as `--fault`: `["at 10 s for 5 s down 1<->2"]`.
        seed: replaces the scenario's seed.
        trust: run modules, too, that are neither installed nor the user's own.
        out: the folder for a run directory, as `--out`; `latest` in it is then this run. None: no file is written, and
            `runs/latest` is still the run before.
        progress: called with the simulated time [s] during the run.

    Returns:
        The verdicts and all numbers. A run that breaks is a result, too: its `status` and `reason` say why.

    Raises:
        ScenarioError: with every mistake that was found.
        LogError: the log cannot be written.
        FleetError: somebody else is to start an agent, or the run directory cannot be made.
        TypeError: an argument is unknown; keys of the scenario go into `set`.
    """
    found = load_for(run, scenario, set, net, fault, seed, trust, unknown)
    if out is None:
        return run_loaded(found, progress)
    found = resolve_triggers(found)  # the record has the faults that triggers began
    with closing(RunDirectory(Path(out), found.name, found.seed)) as directory:
        directory.write_scenario(found.to_yaml())
        with lines_go_into(directory.path / "log"):
            result = run_loaded(found, progress, log=LogFile(directory.log))
        result.run, result.directory = directory.path.name, directory.path
        try:
            write_result(result, directory.path)
        except OSError as error:
            result.lines.append(f"result.json could not be written: {error.strerror}")
            directory.remove_result()
    return result


def run_loaded(
    scenario: Scenario,
    progress: Callable[[float], None] | None = None,
    watcher: Watcher | None = None,
    log: LogFile | NoLog | None = None,
) -> Result:
    """The result of a scenario that is loaded; see `run`.

    Args:
        scenario: what is run.
        progress: called with the simulated time [s] during the run.
        watcher: sees every frame.
        log: where the run is recorded; None: nowhere, with the digest that a log would have.

    Returns:
        The verdicts and all numbers. A run that breaks is a result, too.

    Raises:
        LogError: the log cannot be written.
        CheckError: a check in Python cannot be made.
    """
    with Run.prepared(scenario, log, watcher) as run:
        return run.to_end(progress)
