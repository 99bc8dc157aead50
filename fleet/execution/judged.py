"""A run that is judged, at once or step by step: for scripts and studies, in one process, with a log if asked for."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Never

from fleet.execution.external_agents import refuse
from fleet.execution.stepped_run import SteppedRun
from fleet.recorder.journal import Watcher
from fleet.recorder.log_file import LogFile
from fleet.result.result import Result
from fleet.scenario.loading import changed, load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.spec import ScenarioSpec
from world.plugins.trust import trusting

Changes = Mapping[str, Any] | Iterable[str]


def run(
    scenario: str | Path | Scenario,
    *,
    set: Changes = (),
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
    return judged(loaded("run", scenario, set, seed, trust, unknown), progress)


def stepping(
    scenario: str | Path | Scenario,
    *,
    set: Changes = (),
    seed: int | None = None,
    trust: bool = False,
    log: str | Path | None = None,
    **unknown: Never,
) -> SteppedRun:
    """A run of a scenario in this process, tick by tick: grant one, look, inject.

    `docs/guide/stepping.md` is the guide.

    Args:
        scenario: a shipped name, a file, or a loaded scenario.
        set: changes, as for `run`.
        seed: replaces the scenario's seed.
        trust: as for `run`.
        log: a new file that records the run. None: the run is not recorded.

    Returns:
        The run before its first tick. Its result is that of `run`, to the digest.

    Raises:
        ScenarioError: with every mistake that was found.
        LogError: the log cannot be created.
        FleetError: somebody else is to start an agent.
        TypeError: an argument is unknown; keys of the scenario go into `set`.
    """
    found = loaded("stepping", scenario, set, seed, trust, unknown)
    refuse(found, "a run in one process")
    return SteppedRun(found, None if log is None else LogFile(Path(log)))


def loaded(
    function: str,
    scenario: str | Path | Scenario,
    set: Changes,
    seed: int | None,
    trust: bool,
    unknown: Mapping[str, Any] | None = None,
) -> Scenario:
    """The scenario that a function was given, with the changes.

    Raises:
        ScenarioError: with every mistake that was found.
        TypeError: an argument is unknown.
    """
    if unknown:
        keys = {key: unknown[key] for key in unknown if key in ScenarioSpec.model_fields}
        hint = f"; keys of the scenario go into set={keys}" if keys else ""
        raise TypeError(f"{function}() has no argument {next(iter(unknown))!r}{hint}")
    changes = override_texts(set)
    if seed is not None:
        changes.append(f"seed={seed}")
    with trusting(trust):
        if not isinstance(scenario, Scenario):
            return load_scenario(scenario, changes)
        return changed(scenario, changes) if changes else scenario


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
    with SteppedRun(scenario, log, watcher) as run:
        return run.to_end(progress)


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
