"""A run that is judged: one function for scripts and studies, in one process; a log is written only if it is wanted."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Never

from agents.errors import AgentError
from fleet.checks.own_checks import OwnChecks
from fleet.errors import RunBroken
from fleet.execution.clock import GrantPolicy
from fleet.execution.external_agents import refuse
from fleet.execution.in_process import InProcess
from fleet.execution.outcome import account_for, judge_run, settle
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.no_log import NoLog
from fleet.recorder.watched import WatchedLog, Watcher
from fleet.recorder.writer import LogWriter
from fleet.result.result import Result, Status, Wall
from fleet.scenario.loading import changed, load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.spec import ScenarioSpec
from world.errors import WorldError
from world.plugins.trust import NOTHING, Trust

Changes = Mapping[str, Any] | Iterable[str]


def run(
    scenario: str | Path | Scenario,
    *,
    set: Changes = (),
    seed: int | None = None,
    trust: Trust = NOTHING,
    progress: Callable[[float], None] | None = None,
    **unknown: Never,
) -> Result:
    """Run a scenario in this process and judge it; no file is written.

    The result is that of `fleet run --in-process --set ...`, to the digest of the log that is not written.

    Args:
        scenario: a shipped name, a file, or a scenario that is loaded.
        set: changes, as `--set`: a mapping such as `{"network.links": {"*": "loss 30 %"}, "duration": "20 s"}`,
            or texts such as `"duration=20 s"`.
        seed: in place of the scenario's.
        trust: modules that may run, in addition to installed ones and the user's own. The default for a loaded scenario
            is the trust that it was loaded with.
        progress: called with the simulated time [s] during the run.

    Returns:
        The verdicts and all numbers. A run that breaks is a result, too: its `status` and `reason` say why.

    Raises:
        ScenarioError: with every mistake that was found.
        FleetError: somebody else is to start an agent.
        TypeError: an argument is unknown; keys of the scenario go into `set`.
    """
    if unknown:
        given: dict[str, Any] = dict(unknown)
        keys = {key: given[key] for key in given if key in ScenarioSpec.model_fields}
        hint = f"; keys of the scenario go into set={keys}" if keys else ""
        raise TypeError(f"run() has no argument {next(iter(unknown))!r}{hint}")
    changes = override_texts(set)
    if seed is not None:
        changes.append(f"seed={seed}")
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario, changes, trust)
    elif changes:
        scenario = changed(scenario, changes, trust)
    return judged(scenario, progress)


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
    refuse(scenario, "a run in one process")
    file = log or NoLog()
    writer = LogWriter(file, scenario)
    recorded = writer if watcher is None else WatchedLog(writer, watcher)
    journal = Journal(scenario, recorded, checks=OwnChecks.asked(scenario))
    runner = InProcess(scenario, journal)
    result = Result(scenario=scenario.name, seed=scenario.seed, status=Status.PASS)
    tick_s = scenario.tick_ns / 1e9

    def tell() -> None:
        if progress is not None:
            progress(max(0, journal.written) * tick_s)

    began = time.monotonic()
    try:
        runner.serve(GrantPolicy.of(scenario), tell)
        tell()
    except RunBroken as error:
        result.status, result.reason, result.lines = Status.BROKEN, error.reason, error.lines
    except (AgentError, WorldError) as error:
        result.status, result.reason = Status.BROKEN, str(error)
    wall_s = time.monotonic() - began
    settle(journal, file, runner, result)
    judge_run(scenario, journal, result, lost=0)
    account_for(result, scenario, journal, file, runner, Wall(in_process=True, run_s=wall_s))
    return result


def override_texts(changes: Changes) -> list[str]:
    """Changes as the texts of `--set`.

    Raises:
        TypeError: they are neither a mapping nor texts.
    """
    if isinstance(changes, str):
        raise TypeError(f'set: expected a mapping or a list of texts such as ["duration=20 s"], got {changes!r}')
    if isinstance(changes, Mapping):
        # JSON is YAML, so a mapping or a list inside comes through.
        return [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in changes.items()]
    return [str(change) for change in changes]
