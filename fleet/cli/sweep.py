"""The command `fleet sweep`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fleet.cli.completion import studies
from fleet.cli.documents.output import json_option, print_document
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import OVERRIDES, Duration, Whole, disturbances, is_given
from fleet.terminal.folding import say, stdout

if TYPE_CHECKING:
    from fleet.scenario.text.overrides import Override
    from fleet.study.plan import Plan
    from fleet.study.statistics import Estimate
    from fleet.study.store import Store
    from fleet.study.sweep import Progress
    from world.plugins.trust import Trust


_MOST_TOLD = 10  # logs that are not kept


@click.command(cls=TrustingCommand)
@click.argument("scenario", metavar="SCENARIO|STUDY|DIR", shell_complete=studies)
@click.option("--vary", metavar="KEY=VALUES", multiple=True, help="What varies over which values; repeatable.")
@click.option("--zip", "zipped", is_flag=True, help="Values go together, first with first; else each with each.")
@click.option("--seeds", metavar="SEEDS", default="10", show_default=True,
              help="How many runs each point has, or their seeds: 20, 5..24 or 3,7,9.")  # fmt: skip
@click.option("--draw", type=Whole(0), default=1, show_default=True, help="Seed of values that are drawn.")
@OVERRIDES
@disturbances
@click.option("--measure", "measures", metavar="NAME", multiple=True,
              help="What the table shows; repeatable. An unknown name lists all that are measured; 'p95 |error.e|' "
              "and the like measure a signal.")  # fmt: skip
@click.option("--until", metavar="'pass ±5 %'",
              help="Add seeds to each point until half its interval is no wider, e.g. 'e_rms_m ±10 %'.")  # fmt: skip
@click.option("--most-seeds", metavar="N", type=Whole(1, 1_000_000), default=1000, show_default=True,
              help="How many a point may have with --until.")  # fmt: skip
@click.option("--budget", metavar="TIME", type=Duration(1),
              help="Wall time after which no run is made any more, e.g. '10 min'.")  # fmt: skip
@click.option("--keep-logs", type=click.Choice(["none", "failed", "all"]), default="none", show_default=True,
              help="Keep the logs of runs that failed, or of all, below the study.")  # fmt: skip
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path, file_okay=False), default=Path("studies"),
              show_default=True, help="Where studies go, each in a directory of its own.")  # fmt: skip
@click.option("--workers", metavar="N", type=Whole(1, 1024), help="Runs at a time; by default one per core.")
@click.option("--scheduler", metavar="ADDRESS", help="Use a Dask cluster that is there, e.g. tls://host:8786.")
@click.option("--timeout", metavar="TIME", type=Duration(1), help="Wall time that one run may take, e.g. '5 min'.")
@trust_option
@click.option("--show-config", is_flag=True, help="Print the study as a file, with the options in it, and stop.")
@json_option
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but the study's directory, and failures on stderr.")
def sweep(
    scenario: str,
    vary: tuple[str, ...],
    zipped: bool,
    seeds: str,
    draw: int,
    overrides: tuple[str, ...],
    fault: tuple[Override, ...],
    net: tuple[Override, ...],
    measures: tuple[str, ...],
    until: str | None,
    most_seeds: int,
    budget: int | None,
    keep_logs: str,
    out: Path,
    workers: int | None,
    scheduler: str | None,
    timeout: int | None,
    trust: Trust,
    show_config: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Run SCENARIO at every combination of some values, several times each, and say how sure the answer is.

    A study that ships (fleet list) or a file with the key `study` says all this itself; options add to it, and overrule
    it. With the directory of a study, go on with what is missing: a study may be interrupted at any time.

    \b
    VALUES are a list (nboc,bc), a range with a step (0 %..90 %/10 %), with a count
    (100 ms..2 s log 8, 0..1 lin 5), or drawn (0 %..50 % random 100, ... latin 100).
    A name that is no key of the scenario fills {name} in --set, --net and --fault.

    \b
    Examples:
      fleet sweep rough-sea --vary 'network.links.*.loss=0 %..90 %/30 %' --seeds 5
      fleet sweep paper --vary 'loss=0 %,30 %' --vary 'delay=0 s,1 s' --net '* loss {loss} delay {delay}'
      fleet sweep rough-sea --vary controller=nboc,bc --seeds 20 --measure e_rms_m --measure 'p95 |error.e|'
      fleet sweep rough-sea --vary 'network.links.*.loss=0 %..90 %/30 %' --until 'pass ±10 %' --budget '20 min'
      fleet sweep loss-delay --seeds 2
      fleet sweep paper --vary 'network.period=100 ms,1 s' --show-config > my-study.yaml
      fleet sweep studies/rough-sea-20261122-101500
    """
    if as_json and show_config:
        raise click.UsageError("--show-config prints YAML: not together with --json")
    from fleet.study.engine import need_extra

    need_extra()
    from fleet.quantities import show_time
    from fleet.scenario.catalogue import shipped_scenarios
    from fleet.scenario.trust import TYPED
    from fleet.study.catalogue import shipped_studies
    from fleet.study.errors import StudyError
    from fleet.study.load_points import load_points
    from fleet.study.local_engine import engine_of
    from fleet.study.signal_measures import find_columns
    from fleet.study.spec import StudySpec, set_values, varied
    from fleet.study.store import Store
    from fleet.study.study import new_directory
    from fleet.study.study_file import NamedStudy, study_named
    from fleet.study.summary import DEFAULT
    from fleet.study.sweep import declared, logs_to_make, modules_again, prepare, refuse_border, run_study

    keys = {"seeds": seeds, "draw": draw, "until": until, "most_seeds": most_seeds}
    chosen_keys: dict[str, Any] = {key: value for key, value in keys.items() if is_given(key)}
    later: dict[str, Any] = {
        "measures": list(measures) or None,
        "timeout": None if timeout is None else show_time(timeout),
        "budget": None if budget is None else show_time(budget),
        "keep_logs": keep_logs if is_given("keep_logs") else None,
    }
    store, origin = None, TYPED
    if Path(scenario).is_dir() and scenario not in (*shipped_scenarios(), *shipped_studies()):
        if vary or overrides or fault or net or zipped or chosen_keys or is_given("out"):
            raise click.UsageError(f"{scenario} is a study: what it runs is settled; only the missing runs are made")
        store = Store.open(Path(scenario))
        refuse_border(store)
        if show_config and store.record.spec is None:
            raise StudyError(f"{scenario}: the fleet that made this study did not write down what was asked")
        spec = (store.record.spec or StudySpec(store.record.scenario)).changed(
            **later | {"budget": later["budget"] or ""}
        )
    else:
        spec, origin = study_named(scenario) or NamedStudy(StudySpec(scenario))
        spec = spec.changed(
            vary=varied(vary),
            set=set_values(overrides),
            net=[change.text for change in net],
            fault=[change.text for change in fault],
            zip=zipped,
            **chosen_keys,
            **later,
        )
    if is_given("most_seeds") and not spec.until:
        raise click.UsageError("--most-seeds is for studies that add seeds: give --until, too")
    if show_config:
        if store is None:
            declared(spec.plan(origin), load_points(spec.plan(origin), trust, refused=[]))
        click.echo(spec.to_yaml(), nl=False)
        return
    modules = None  # those of a study that is whole are not needed
    if store is None:
        if not spec.vary:
            _nothing_varied(spec.plan(origin), trust, quiet=quiet)
        store, modules = prepare(spec.plan(origin), new_directory(scenario, out), trust, spec)
    shown = find_columns(store.record.settings.measures or DEFAULT, store.record.columns)
    missing = store.missing
    if not quiet:
        say(_announced(store, missing), err=True)
    if missing or logs_to_make(store, spec.keep_logs):
        if modules is None:
            modules = modules_again(store, trust)
        with _showing(quiet) as tell, engine_of(workers, scheduler) as engine:
            try:
                progress = run_study(
                    store, engine, tell, modules=modules, timeout_s=spec.timeout_s, budget_s=spec.budget_s,
                    logs=spec.keep_logs,
                )  # fmt: skip
            except KeyboardInterrupt:
                _tell_what_is_missing(store, spec.keep_logs, [])
                raise
        _tell_what_is_missing(store, spec.keep_logs, progress.not_kept)
    if as_json:
        from fleet.cli.documents.study import swept

        print_document(swept(store, shown))
    elif quiet:
        click.echo(store.directory)
    else:
        _show(store, shown)


def _nothing_varied(plan: Plan, trust: Trust, *, quiet: bool) -> None:
    """Say that runs differ by their seeds alone.

    Raises:
        click.UsageError: they do not even differ by these.
    """
    from fleet.analysis.seed import seeded
    from fleet.study.load_points import load_points

    how = "--vary varies a key: --vary 'loss=0 %..60 %/20 %' --net '* loss {loss}' varies the loss of all links"
    (scenario,) = load_points(plan, trust)
    if len(plan.seeds) > 1 and not seeded(scenario):
        raise click.UsageError(
            f"nothing is varied, and nothing in {scenario.name} depends on the seed: all {len(plan.seeds)} runs would "
            f"be the same. {how}"
        )
    if not quiet:
        say(f"fleet: nothing is varied, so the runs differ by their seeds alone; {how}", err=True)


def _announced(store: Store, missing: int) -> str:
    """What is going to be run."""
    points, seeds, until = store.point_count, len(store.record.seeds), store.record.settings.until
    made = sum(store.needed().values()) - missing
    runs = f"= {points * seeds} runs" if until is None else f"at first, until {until}"
    return f"{store.directory}: {points} points x {seeds} seeds {runs}" + (f", {made} of them made" if made else "")


def _tell_what_is_missing(store: Store, logs: Any, not_kept: list[str]) -> None:
    from fleet.study.sweep import logs_to_make

    for sentence in not_kept[:_MOST_TOLD]:
        say(sentence, err=True)
    if missing := store.missing:
        say(f"{missing} runs are missing; fleet sweep {store.directory} makes them", err=True)
    elif left := len(logs_to_make(store, logs)) - len(not_kept):
        say(f"{left} logs are missing; fleet sweep {store.directory} --keep-logs {logs} makes them", err=True)
    if short := store.short():
        most, until = len(store.seeds), store.record.settings.until
        say(f"{short} points have {most} seeds, and are not yet known to {until}; see --most-seeds", err=True)


@contextmanager
def _showing(quiet: bool) -> Iterator[Callable[[Progress], None]]:
    """A function that shows where a study is; call it as often as you like."""
    from rich.console import Console as Terminal

    from fleet.cli.study_output import progress_pieces
    from fleet.terminal.fitting import Piece
    from fleet.terminal.status_line import StatusLine

    with StatusLine(Terminal(stderr=True), quiet=quiet) as line:

        def tell(progress: Progress) -> None:
            if not line.due():
                return
            share = progress.made / max(1, progress.runs)
            left = f"{timedelta(seconds=round(progress.left_s))} left" if isfinite(progress.left_s) else ""
            drawn, rate, failed = progress_pieces(line, share, progress)
            line.show(
                [
                    Piece(0, [f"{progress.made} / {progress.runs} {progress.doing}"]),
                    drawn,
                    rate,
                    Piece(2, [left, ""]),
                    Piece(4, [f"passed {_share(progress.passing)}", f"passed {progress.passing.value:.0%}", ""]),
                    failed,
                ]
            )

        yield tell


def _show(store: Store, measures: Any) -> None:
    """The table of a study, and where it is."""
    from fleet.cli.study_output import axis_columns
    from fleet.study.statistics import LEAST, levels
    from fleet.study.summary import summarise
    from fleet.terminal.table import TerminalColumn, show

    rows = summarise(store, measures)
    columns = axis_columns(store.record.axes, [row.values for row in rows])
    columns.append(TerminalColumn("runs", [str(row.runs) for row in rows], 3))
    if any(row.failed for row in rows):
        columns.append(TerminalColumn("without\nresult", [str(row.failed) for row in rows], 0))
    columns.append(TerminalColumn("passed\n95 % interval", [_share(row.passed) for row in rows], 0))
    for rank, (name, unit) in enumerate(((measure.name, measure.unit) for measure in measures), start=4):
        level = levels(row.medians[name] for row in rows)
        heading = f"{name}\nmedian" + (f" [{unit}]" if unit else "") + (level and f", {level}")
        columns.append(TerminalColumn(heading, [_number(row.medians[name], row.passed.runs) for row in rows], rank))
    counts = sorted({row.runs for row in rows}) or [0]
    seeds = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    title = f"{store.record.scenario}, {seeds} seeds per point"
    show(columns, title, stdout(), "fleet.open_study has all")
    if any(0 < found.runs < LEAST for row in rows for found in row.medians.values()):
        say(f"A median of fewer than {LEAST} runs has no interval: none would hold the true median with 95 %.")
    say(str(store.directory))


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


COMMANDS = (sweep,)
