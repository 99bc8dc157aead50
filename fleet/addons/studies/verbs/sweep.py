"""The command `fleet sweep`."""

from __future__ import annotations

from collections.abc import Collection
from datetime import timedelta
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.addons.studies.spec import KeepLogs, StudySpec
from fleet.addons.studies.verbs import junit_cases
from fleet.addons.studies.verbs.study_options import (
    MakingStudy,
    StudiesFolder,
    WorkerOptions,
    axis_columns,
    given_values,
    progress_pieces,
    show_failing_stacks,
    show_reached,
    studies,
    study_directory,
)
from fleet.cli import junit as cli_junit
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document
from fleet.cli.junit import Junit
from fleet.cli.types import is_given
from fleet.option import Option
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine
from fleet.terminal.table import TerminalColumn, show
from fleet.terminal.width import say, stdout

if TYPE_CHECKING:
    from fleet.addons.studies.measures import MeasureColumn
    from fleet.addons.studies.modules import Modules
    from fleet.addons.studies.statistics import Estimate
    from fleet.addons.studies.store import Store
    from fleet.addons.studies.study_file import NamedStudy
    from fleet.addons.studies.sweep import Progress

_MOST_TOLD = 10  # unsaved logs that are listed by name
_HOW_TO_VARY = "--vary varies a key: --vary 'loss=0 %..60 %/20 %' --net '* loss {loss}' varies the loss of all links"


@command(document="fleet.addons.studies.verbs.documents.Swept")
def sweep(
    scenario: Annotated[str, studies, Option("", "SCENARIO|STUDY|DIR")],
    *,
    asked: StudySpec,
    out: StudiesFolder = Path("studies"),
    junit: Junit = None,
    show_config: Annotated[bool, Option("Print the study as a file, with the options in it, and stop.")] = False,
    how: MakingStudy,
) -> None:
    """Run SCENARIO at every combination of some values, with several seeds each, and print results with intervals.

    A study that ships (fleet list), or a file with the key `study`, contains all settings; options add to them or
    replace them. With the directory of a study, sweep makes the runs that are missing. So you can interrupt a study at
    any time.

    It measures, so runs that fail are a result, and the exit status is 0; --junit shows points with such runs as
    failed.

    \b
    VALUES are a list (nboc,bc), a range with a step (0 %..90 %/10 %), with a count
    (100 ms..2 s log 8, 0..1 lin 5), or drawn (0 %..50 % random 100, ... latin 100).
    A name that is no key of the scenario fills {name} in --set, --net and --fault.

    \b
    Examples:
      fleet sweep rough-sea --vary 'network.links.*.loss=0 %..90 %/30 %' --seeds 5
      fleet sweep paper --vary 'loss=0 %,30 %' --vary 'delay=0 s,1 s' --net '* loss {loss} delay {delay}'
      fleet sweep lossy --vary controller=nboc,bc --seeds 20 --measure e_rms_m --measure 'p95 |error.e|'
      fleet sweep rough-sea --vary 'network.links.*.loss=0 %..90 %/30 %' --until 'pass ±10 %' --budget '20 min'
      fleet sweep loss-delay --seeds 2
      fleet sweep paper --vary 'network.period=100 ms,1 s' --show-config > my-study.yaml
      fleet sweep studies/rough-sea-20261122-101500
    """
    if json_is_asked() and show_config:
        raise click.UsageError("--show-config prints YAML, so it cannot be used together with --json")
    from fleet.addons.studies.engine_interface import require_extra

    require_extra()
    directory = study_directory(scenario, asked)
    if show_config:
        click.echo(_as_file(scenario, directory, asked), nl=False)
        return
    if directory is None:
        store, spec, modules = _prepare_study(scenario, asked, out, how)
    else:
        store, spec, modules = *_open_study(directory, asked), None
    shown = _columns(store, spec)
    _run(store, spec, modules, how)
    cli_junit.write(junit, store.record.scenario, junit_cases.study_cases(store))
    if json_is_asked():
        from fleet.addons.studies.verbs.documents import sweep_document

        print_document(sweep_document(store, shown))
    elif how.quiet:
        click.echo(store.directory)
    else:
        _tell_if_all_are_the_same(store)
        _show(store, shown, [column.name for column in shown] if spec.measures else ())


def _as_file(name: str, directory: Path | None, asked: StudySpec) -> str:
    from fleet.addons.studies.plan import plan_of
    from fleet.addons.studies.study_file import study_yaml
    from fleet.addons.studies.sweep import load_points, measure_columns

    if directory is None:
        study = _asked_for(name, asked)
        measure_columns(study.spec, load_points(plan_of(*study), refused=[]))  # laws that may not run are no mistake
        return study_yaml(study.spec)
    return study_yaml(_open_study(directory, asked)[1])


def _open_study(directory: Path, asked: StudySpec) -> tuple[Store, StudySpec]:
    """The study of a directory, and its spec with what was asked now; a budget is that of one command."""
    from fleet.addons.studies.store import Store
    from fleet.addons.studies.sweep import refuse_border

    store = Store.open(directory)
    refuse_border(store)
    return store, store.record.rules.with_options(**{"budget": "", **given_values(asked)})


def _asked_for(name: str, asked: StudySpec) -> NamedStudy:
    from fleet.addons.studies.study_file import NamedStudy, study_named

    study = study_named(name) or NamedStudy(StudySpec(name))
    spec = study.spec.with_options(**given_values(asked))
    if is_given("most_seeds") and not spec.until:
        raise click.UsageError("--most-seeds is for studies that add seeds: give --until, too")
    return study._replace(spec=spec)


def _prepare_study(name: str, asked: StudySpec, out: Path, how: WorkerOptions) -> tuple[Store, StudySpec, Modules]:
    from fleet.addons.studies.plan import plan_of
    from fleet.addons.studies.study import new_directory
    from fleet.addons.studies.sweep import prepare

    study = _asked_for(name, asked)
    plan = plan_of(*study)
    store, modules = prepare(plan, new_directory(name, out), study.spec, warn=how.warn)
    if not study.spec.vary and not how.quiet:
        say(f"fleet: nothing is varied, so the runs differ only in their seeds; {_HOW_TO_VARY}", err=True)
    return store, study.spec, modules


def _columns(store: Store, spec: StudySpec) -> list[MeasureColumn]:
    """The measures that the table shows. Raises StudyError: the study does not have one."""
    from fleet.addons.studies.signal_measures import find_columns
    from fleet.addons.studies.summary import DEFAULT

    return find_columns(spec.measures or store.record.measures or DEFAULT, store.record.every_column)


def _run(store: Store, spec: StudySpec, modules: Modules | None, how: WorkerOptions) -> None:
    """Make the runs that are missing, then the logs. `modules`: that the runs need; None: they are looked for then."""
    from fleet.addons.studies.sweep import logs_to_make, modules_again, run_study

    missing = store.missing
    if not how.quiet:
        say(_announcement(store, missing), err=True)
    if not missing and not logs_to_make(store, spec.keep_logs):
        return
    if modules is None:
        modules = modules_again(store)
    with how.showing(_pieces) as on_progress, how.engine(modules) as workers:
        try:
            progress = run_study(
                store, workers, on_progress, modules=modules, timeout_s=spec.timeout_s, budget_s=spec.budget_s,
                logs=spec.keep_logs,
            )  # fmt: skip
        except KeyboardInterrupt:
            _tell_what_is_missing(store, spec.keep_logs, [])
            raise
    _tell_what_is_missing(store, spec.keep_logs, progress.not_kept)


def _tell_if_all_are_the_same(store: Store) -> None:
    """Of a study whose runs differ by their seeds alone. The first two logs that differ end the reading."""
    rows, runs = store.rows(details=True), sum(store.needed_seeds().values()) - store.missing
    digest = first.digest if len(store.points) == 1 and (first := next(rows, None)) else None
    if runs > 1 and digest is not None and all(row.digest == digest for row in rows):
        say(f"fleet: all {runs} runs have the same log: no draw of the seed matters", err=True)


def _announcement(store: Store, missing: int) -> str:
    points, seeds, until = len(store.points), len(store.record.seeds), store.record.rules.until
    made = sum(store.needed_seeds().values()) - missing
    runs = f"at first, until {until}" if until else f"= {points * seeds} runs"
    return f"{store.directory}: {points} points x {seeds} seeds {runs}" + (f", {made} of them made" if made else "")


def _tell_what_is_missing(store: Store, logs: KeepLogs, not_kept: list[str]) -> None:
    from fleet.addons.studies.sweep import logs_to_make

    for sentence in not_kept[:_MOST_TOLD]:
        say(sentence, err=True)
    if missing := store.missing:
        say(f"{missing} runs are missing; fleet sweep {store.directory} makes them", err=True)
    elif left := len(logs_to_make(store, logs)) - len(not_kept):
        say(f"{left} logs are missing; fleet sweep {store.directory} --keep-logs {logs} makes them", err=True)
    if short := store.short():
        most, until = len(store.seeds), store.record.rules.until
        say(f"{short} points have {most} seeds, and are not yet known to {until}; see --most-seeds", err=True)


def _pieces(line: StatusLine, progress: Progress) -> list[Piece]:

    left = f"{timedelta(seconds=round(progress.left_s))} left" if isfinite(progress.left_s) else ""
    drawn, rate, failed = progress_pieces(line, progress.made / max(1, progress.runs), progress)
    made = Piece(0, [f"{progress.made} / {progress.runs} {progress.doing}"])
    passed = Piece(4, [f"passed {_share(progress.passing)}", f"passed {progress.passing.value:.0%}", ""])
    return [made, drawn, rate, Piece(2, [left, ""]), passed, failed]


def _show(store: Store, measures: list[MeasureColumn], asked: Collection[str]) -> None:
    """Print the table. `asked`: the names of measures that the user named; these have room."""
    from fleet.addons.studies.measures import CHECK
    from fleet.addons.studies.statistics import LEAST, levels
    from fleet.addons.studies.summary import judged_columns, summarise

    check = store.record.check
    judged = judged_columns([check] if check else store.record.checks)
    measures = list({measure.name: measure for measure in [*judged, *measures]}.values())
    rows = summarise(store, measures)
    columns = axis_columns(store.record.axes, [row.values for row in rows])
    columns.append(TerminalColumn("runs", [str(row.runs) for row in rows], 3))
    if any(row.failed for row in rows):
        columns.append(TerminalColumn("without\nresult", [str(row.failed) for row in rows], 0))
    if any(row.late for row in rows):
        columns.append(TerminalColumn("late", [str(row.late) for row in rows], 0))
    columns.append(
        TerminalColumn(f"passed{check and ' '}{check}\n95 % interval", [_share(row.passed) for row in rows], 0)
    )
    medians = [found for row in rows for name, found in row.medians.items() if not name.startswith(CHECK)]
    level = levels(medians)
    for rank, (name, unit) in enumerate(((measure.name, measure.unit) for measure in measures), start=4):
        found = [row.medians[name] for row in rows]
        if name.startswith(CHECK):
            heading, cells = f"passed {name.removeprefix(CHECK)}\n95 % interval", [_share(rate) for rate in found]
        else:
            heading = f"{_words_of(name)}\nmedian" + (f" [{unit}]" if unit else "")
            cells = [_number(one, row.runs - row.failed - row.late) for one, row in zip(found, rows, strict=True)]
        columns.append(TerminalColumn(heading, cells, 0 if name in asked else rank))
    counts = sorted({row.runs for row in rows}) or [0]
    seeds = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    title = f"{store.record.scenario}, {seeds} seeds per point" + (level and f"; medians with intervals of {level}")
    show(columns, title, stdout(), "fleet.open_study has all")
    if any(0 < found.runs < LEAST for found in medians):
        say(f"A median of fewer than {LEAST} runs has no interval: none would hold the true median with 95 %.")
    show_reached(store)
    show_failing_stacks(store)
    say(str(store.directory))


def _words_of(name: str) -> str:
    part, _, check = name.partition(".")
    return {"value": f"{check}, judged", "margin": f"margin of {check}"}.get(part, name)


def _share(rate: Estimate) -> str:
    if rate.runs == 0:
        return "-"
    return f"{100 * rate.value:.0f} %  {100 * rate.low:3.0f}..{100 * rate.high:3.0f} %"


def _number(found: Estimate, of: int) -> str:
    """A median; with the number of runs behind it, where some have no such number."""
    if found.runs == 0:
        return "-"
    text = f"{found.value:.3g}"
    if found.low != found.high and isfinite(found.low):
        text += f"  {found.low:.3g}..{found.high:.3g}"
    return text if found.runs == of else f"{text} ({found.runs} runs)"
