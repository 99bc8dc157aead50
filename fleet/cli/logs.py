"""The commands that show a log: plot, export, report, info, movie; and fit, which reads a trace of a link."""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click

from fleet.cli import completion
from fleet.cli.declare import command
from fleet.cli.documents.output import print_result
from fleet.cli.log_argument import Log, newest_log
from fleet.cli.types import (
    FILE,
    FOLDER,
    TIME,
    VEHICLES,
    WINDOW,
    Folder,
    Force,
    NoProgress,
    PictureWords,
    Whole,
    Words,
    is_given,
)
from fleet.errors import FleetError
from fleet.option import Option
from fleet.terminal.status_line import showing, showing_steps
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.addons.robots.link_fit import LinkFit
    from fleet.addons.studies.store import Store

KINDS = ("track", "error", "inputs", "links", "messages", "ages", "checks", "timing")
PARTS = ("track-3d", "formation")  # single pictures of track and error
FORMATS = ("png", "svg", "pdf")
OTHER_FORMATS = ("bmp", "eps", "gif", "jpeg", "jpg", "ps", "tif", "tiff", "webp")  # of pictures, which are not written
_OF_LOGS = ("what", "compare", "vehicles", "window")
_OF_STUDIES = ("measures",)


@dataclass(frozen=True, slots=True)
class PictureChoice:
    """What pictures of a log, or of a study, show."""

    measures: Annotated[tuple[str, ...], Option(
        "For a study: another measure to show; repeatable. An unknown name lists them.", "NAME",
        "--measure")] = ()  # fmt: skip
    vehicles: Annotated[tuple[int, ...] | None, VEHICLES, Option("Only these, e.g. 1,3-5.")] = None
    log_scale: Annotated[bool | None, Option(
        "Errors, other signals and ages on a logarithmic axis, or all on a linear one. By default errors are "
        "logarithmic, and a study's measures that span much.", flag="--log-scale/--linear")] = None  # fmt: skip
    window: Annotated[tuple[float, float] | None, WINDOW, Option(
        "Only this time, e.g. 20s..40s. By default `messages` shows some rounds, and the other pictures the whole "
        "run.")] = None  # fmt: skip


PictureFormats = Annotated[tuple[str, ...], Words(FORMATS)]


class _PicturesFolder(Folder):
    """A folder for pictures; refused is what looks like a picture's file."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        folder = Path(super().convert(value, param, ctx))  # type: ignore[arg-type]
        if folder.suffix.lower()[1:] in (*FORMATS, *OTHER_FORMATS) and not folder.is_dir():
            self.fail(
                f"expected a folder, because there are several pictures, got {str(folder)!r}; choose their format with "
                f"--format: {', '.join(FORMATS)}",
                param,
                ctx,
            )
        return folder


@command()
def plot(
    log: Log,
    *,
    out: Annotated[Path | None, _PicturesFolder(path_type=Path, file_okay=False), Option(
        "The folder for pictures; by default `plots` next to the log.", flag="-o --out")] = None,
    what: Annotated[tuple[str, ...], PictureWords(KINDS, "all", PARTS), completion.pictures, Option(
        f"Some of {', '.join(KINDS)}; or all; track-3d, formation: that part of track, of error. Also any signal of "
        "the log: control.leads, command.tau_0, '|error.e|'.")] = KINDS,
    formats: Annotated[PictureFormats, Option("Some of png, svg, pdf.", flag="--format")] = ("png",),
    compare: Annotated[tuple[Path, ...], Option("Another run on the same axes; repeatable.", "LOG2")] = (),
    shown: PictureChoice,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Draw pictures of LOG (an MCAP file, or a run directory), as wide as a column of a journal.

    The pictures are: tracks, consensus and formation errors with the limits of the checks, inputs with their limits,
    shares of packets by fate, messages in space and time, ages of information, the signals that the checks name, and
    any other signal. Faults are shaded. Prints the files.

    For the directory of a study it draws the pass rate and measures with intervals, as heat maps, curves or boxes,
    and differences in pairs of runs with the same seed. Hatched areas have runs without the number.

    \b
    Examples:
      fleet plot
      fleet plot --what error,inputs --format svg,pdf --linear
      fleet plot --what messages --window 20s..22s
      fleet plot --what state.z --vehicles 1,4
      fleet plot runs/a --compare runs/b --what error -o compared
      fleet plot studies/rough-sea-20261122-101500 --measure e_rms_m
    """
    if is_study(log):
        check_options(log, _OF_LOGS, "logs")
        _print(plot_study(log, out, shown.measures, formats, shown.log_scale))
        return
    check_options(log, _OF_STUDIES, "studies")
    from fleet.addons.pictures.gallery import check_signals, write
    from fleet.addons.pictures.runs import View, check_view, load
    from fleet.logs.reader import log_path

    said: list[str] = []
    with showing("reading") as tell:
        runs = load([log, *compare], tell)
    view = View(shown.vehicles, shown.log_scale, shown.window)
    check_view(runs, view)
    check_signals(what, runs)
    with showing("drawing") as tell:
        paths = write(what, runs, view, out or log_path(log).parent / "plots", formats, said.append, tell)
    cut = [f"{run.label}: {run.log.missing}" for run in runs if run.log.missing]
    for note in dict.fromkeys([*cut, *(note for run in runs for note in run.notes), *said]):
        say(f"fleet: {note}", err=True)
    _print(paths)


def _print(paths: Sequence[Path]) -> None:
    for path in paths:
        click.echo(path)
    if not paths:
        sys.exit(1)


@command()
def export(
    log: Log,
    *,
    csv: Annotated[Path | None, FOLDER, Option("Write CSV here.")] = None,
    parquet: Annotated[Path | None, FOLDER, Option("Write Parquet here; needs uuv-fleet[parquet].")] = None,
    netcdf: Annotated[Path | None, FOLDER, Option(
        "Write NetCDF here, by the CF conventions; needs uuv-fleet[tables].")] = None,
    traces: Annotated[Path | None, FOLDER, Option(
        "Write the fate of each packet here: a CSV file per directed link, or per key of a recording, which "
        "network.links can read.")] = None,
    sequence: Annotated[str | None, Option(
        "Traces of a recording: the field of JSON payloads that counts them.", "FIELD")] = None,
    period: Annotated[int | None, TIME, Option(
        "Traces of a recording: time between two messages of a key without numbers.")] = None,
    ros2: Annotated[Path | None, FOLDER, Option("Write a bag of ROS 2 here; needs uuv-fleet[ros2].")] = None,
    scenario: Annotated[bool, Option(
        "Print the scenario that runs LOG again, with all that was injected while it was made.")] = False,
    topics: Annotated[tuple[str, ...], Option(
        "Only topics such as 'uuv/*/state'; repeatable.", "PATTERN")] = (),
    exclude: Annotated[tuple[str, ...], Option("Not these topics; repeatable.", "PATTERN")] = (),
    force: Force = False,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Write LOG (an MCAP file, a run directory, or a bag of ROS 2) as tables, one file per topic, or print its
    scenario; or a study as one table of its runs.

    Times are in s. Units are in CSV's header, and in the metadata of the other formats; export.json describes each
    table. Numbers read back exactly; bytes are hexadecimal in CSV, and left out in NetCDF. Data that only 3D viewers
    need (transforms, scene) are left out. Prints the files.

    \b
    Examples:
      fleet export --csv tables
      fleet export --parquet errors --topics 'uuv/*/error' --topics 'link/*'
      fleet export --netcdf states --topics 'uuv/*/state'
      fleet export runs/latest --traces links
      fleet export tuesday.mcap --traces links --sequence seq
      fleet export runs/latest --ros2 bag
      fleet export studies/rough-sea-20261122-101500 --csv tables
      fleet export --scenario > again.yaml && fleet run again.yaml
    """
    tables = [(form, folder) for form, folder in (("csv", csv), ("parquet", parquet), ("netcdf", netcdf)) if folder]
    folders = [folder.absolute() for folder in (*(folder for _, folder in tables), traces, ros2) if folder is not None]
    if scenario:
        if folders or topics or exclude:
            raise click.UsageError("--scenario prints the scenario only, and writes no tables")
        _print_scenario(log)
        return
    if not folders:
        forms = "--csv DIR, --parquet DIR, --netcdf DIR, --traces DIR or --ros2 DIR"
        raise click.UsageError(f"no folder for the tables: give {forms}; or --scenario")
    if is_study(log):
        check_options(log, ("netcdf", "traces", "ros2", "topics", "exclude"), "logs")
        for form, folder in tables:
            click.echo(export_study(log, folder, form, force=force))
        return
    if (topics or exclude) and not tables and traces is None:
        raise click.UsageError("--topics and --exclude choose tables and traces, and --ros2 writes none")
    if (sequence is not None or period is not None) and traces is None:
        raise click.UsageError("--sequence and --period are for --traces")
    if period == 0:
        raise click.BadParameter("must be above 0", param_hint="--period")
    if len(set(folders)) < len(folders):
        raise click.UsageError("each form needs a folder of its own: export.json says what is in one")
    if traces is not None:
        _export_traces(log, traces, (topics, exclude, sequence, period), force=force)
    if ros2 is not None:
        _export_bag(log, ros2)
    if tables:
        _export_tables(log, tables, topics, exclude, force=force)


def _export_tables(
    log: Path, tables: Sequence[tuple[str, Path]], topics: tuple[str, ...], exclude: tuple[str, ...], *, force: bool
) -> None:
    from fleet.logs.dataset import fits
    from fleet.logs.export import export as write
    from fleet.logs.open_log import Opening

    with showing(f"reading {log}") as tell:
        found = Opening(log, topics or None, tell, exclude, hold_all=False).read()
    if topics and not len(found):
        but = f" and not like {', '.join(exclude)}" if exclude else ""
        raise click.BadParameter(f"no topic of {log} is like {', '.join(topics)}{but}", param_hint="--topics")
    if found.missing:
        say(f"fleet: {found.path}: {found.missing}", err=True)
    if left := [name for name in found if len(found[name]) and not fits(found[name])]:
        say(f"fleet: left out, being lists of messages and no tables: {', '.join(left)}", err=True)
    for form, folder in tables:
        with showing(f"writing {folder}") as tell:
            paths = write(found, folder, form, force=force, share=tell)
        for path in paths:
            click.echo(path)


def _print_scenario(log: Path) -> None:
    from fleet.repeat.recorded_run import script

    with showing(f"reading {log}") as tell:
        made = script(log, tell)
    click.echo(made.to_yaml(), nl=False)


def _export_bag(log: Path, folder: Path) -> None:
    from fleet.addons.robots.ros2.bag import write_bag
    from fleet.logs.reader import log_path

    with showing(f"writing {folder}") as tell:
        paths, missing = write_bag(log_path(log), folder, tell)
    if missing:
        say(f"fleet: {log}: {missing}", err=True)
    for path in paths:
        click.echo(path)


def _export_traces(log: Path, folder: Path, selected: tuple[Any, ...], *, force: bool) -> None:
    from fleet.addons.robots.field_traces import Selection, write_field_traces
    from fleet.logs.export import write_traces
    from fleet.logs.open_log import open_log

    def tell_user(text: str) -> None:
        say(f"fleet: {text}", err=True)

    with showing(f"reading {log}") as tell:
        found = open_log(log, ["link/*"], share=tell)
    if not found.run:
        with showing(f"reading {log}") as tell:
            paths = write_field_traces(log, folder, Selection(*selected), force=force, say=tell_user, tell=tell)
    elif any(selected):
        raise click.UsageError(f"{log} is the log of a run: its traces are those of all links, and take no options")
    else:
        if found.missing:
            tell_user(f"{found.path}: {found.missing}")
        paths = write_traces(found, folder, force=force, say=tell_user)
    for path in paths:
        click.echo(path)


@command()
def report(
    logs: Annotated[tuple[Path, ...], Option(
        "MCAP files or run directories; by default the newest run below runs.", "[LOG]...")] = (),
    *,
    out: Annotated[Path, FILE, Option("The page.", flag="-o --out")] = Path("report.html"),
    force: Force = False,
    shown: PictureChoice,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Write one self-contained HTML page about one LOG, or about several and what they have in common.

    The page has the scenario, conditions of the links, and faults. From result.json next to the log it takes verdicts,
    vehicles, ledger and ages. It ends with pictures, and how to repeat the run. It needs no network and no other file.

    The page about a study's directory has its settings and cost, pictures, every point with intervals, comparisons in
    pairs, and the reasons of runs without a result. It also says how to make a run again.

    \b
    Examples:
      fleet report
      fleet report runs/a runs/b -o compared.html --log-scale
      fleet report studies/rough-sea-20261122-101500 -o study.html
    """
    from fleet.addons.pictures.page import check_place
    from fleet.addons.pictures.report import write
    from fleet.addons.pictures.runs import View, check_view, load

    check_place(out, force=force)
    chosen = logs or (newest_log(),)
    if study := next(filter(is_study, chosen), None):
        if len(chosen) > 1:
            raise click.UsageError(f"{study} is a study: a page is about one study, or about logs")
        check_options(study, _OF_LOGS, "logs")
        report_study(study, out, shown.measures, shown.log_scale)
        click.echo(out)
        return
    check_options(chosen[0], _OF_STUDIES, "studies")
    with showing("reading") as tell:
        runs = load(chosen, tell)
    view = View(shown.vehicles, shown.log_scale, shown.window)
    check_view(runs, view)
    with showing("drawing and adding up") as tell:
        write(out, runs, view, tell)
    for run in runs:
        if run.log.missing:
            say(f"fleet: {run.label}: {run.log.missing}", err=True)
    click.echo(out)


@command(document="fleet.logs.info.Info")
def info(log: Log, *, quiet: NoProgress = False) -> None:
    """Summarise LOG (an MCAP file, a run directory, or a bag of ROS 2), also if it was cut short.

    \b
    Examples:
      fleet info
      fleet info runs/latest/run.mcap --json
    """
    from fleet.logs.info import info_text, read_info

    with showing(f"reading {log}") as tell:
        found = read_info(log, tell)
    print_result(found, info_text(found))


@command()
def movie(
    log: Log,
    *,
    out: Annotated[Path, FILE, Option(
        "The movie: a .gif, or an .mp4 if ffmpeg is installed.", flag="-o --out")] = Path("movie.gif"),
    force: Force = False,
    view: Annotated[Literal["above", "3d"], Option("From where.")] = "above",
    begin: Annotated[int, TIME, Option("Begin at this time, e.g. 20s.", flag="--from")] = 0,
    end: Annotated[int | None, TIME, Option(
        "End at this time; by default at the end of the log.", flag="--to")] = None,
    speed: Annotated[float | None, click.FloatRange(0.001, 1000.0), Option(
        "Times real time; by default so that the movie lasts 12 s, but never slower than real time.", "X")] = None,
    fps: Annotated[int, Whole(1, 50), Option("Pictures per second.", "N")] = 10,
    width: Annotated[int, Whole(320, 1920), Option(
        "In pixels, rounded down to a multiple of 8; the height is three quarters of it.", "PX")] = 800,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Make a movie of LOG (an MCAP file, or a run directory) as fleet view shows it, as a GIF or an MP4.

    It shows hulls, their ways and desired places; links by their arrivals, packets, and faults with their remaining
    time. Below are the formation errors so far. The same log gives the same bytes of a GIF. Prints the file.

    \b
    Examples:
      fleet movie
      fleet movie runs/latest -o heal.gif --view 3d
      fleet movie runs/latest -o cut.mp4 --from 5s --to 40s --speed 2 --fps 25
    """
    from fleet.addons.page.movie import write
    from fleet.addons.pictures.page import check_place
    from fleet.logs.reader import log_path

    check_place(out, force=force)
    window = begin / 1e9, None if end is None else end / 1e9
    with showing(f"drawing {out}") as tell:
        missing = write(
            log_path(log), out, tell, view=view, window=window, speed=speed, fps=fps, width=width - width % 8
        )
    if missing:
        say(f"fleet: {log}: {missing}", err=True)
    click.echo(out)


@command()
def fit(
    trace: Annotated[Path, FILE],
    *,
    states: Annotated[Literal["1", "2", "3"], Option(
        "How many states; 1 is one condition, for losses that come alone.")] = "2",
    interval: Annotated[int | None, TIME, Option("Between two packets; by default the median in the trace.")] = None,
    picture: Annotated[Path | None, FILE, Option(
        "Draw the lengths of bursts, of TRACE and of the fit, into this file (png, svg, pdf).")] = None,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Fit link states to what TRACE (CSV) says was delivered, and print them for a scenario.

    The states are those of a hidden Markov model (Gilbert and Elliott), fitted by expectation maximisation. So a long
    study need not repeat one afternoon. The entry of network.links is printed on stdout, all else on stderr.

    \b
    Examples:
      fleet fit modem-log.csv
      fleet fit modem-log.csv --states 3 --picture bursts.png
      fleet fit links/1-2.csv > links.yaml
    """
    from fleet.addons.robots.link_fit import fit as fitted
    from fleet.scenario.sections.link_conditions import read_trace
    from fleet.scenario.text.yaml_reader import yaml_text

    if trace.suffix != ".csv":
        raise click.BadParameter(f"expected a file that ends in .csv, got {trace}", param_hint="TRACE")
    if interval == 0:
        raise click.BadParameter("must be above 0", param_hint="--interval")
    if picture is not None and states == "1":
        raise click.UsageError("--picture compares bursts of losses: give --states 2 or 3")
    with showing_steps(f"{states} states"):
        try:
            found = fitted(read_trace(trace), int(states), interval)
        except FileNotFoundError:
            raise FleetError(f"trace {trace}: there is no such file") from None
    for text in fit_lines(found, trace):
        say(text, err=True)
    if picture is not None:
        _draw(found, trace, picture)
        say(str(picture), err=True)
    click.echo(yaml_text({"network": {"links": {"*": found.section()}}}), nl=False)


def fit_lines(found: LinkFit, trace: Path) -> list[str]:
    """The parameters of a fit in words, and how likely the trace is under it."""
    from fleet.addons.robots.link_fit import runs

    model, alone = found.model, found.independent
    every, share = found.interval_ns / 1e9, found.lost.mean()
    lines = [f"{trace}: {len(found.lost)} packets, one every {every:g} s, {100 * share:.3g} % lost"]
    if model.states > 1:
        lines += [
            f"log-likelihood {model.log_likelihood:.2f} with {model.states} states (BIC {model.bic:.1f}), "
            f"{alone.log_likelihood:.2f} with independent losses (BIC {alone.bic:.1f}); the lower BIC is the better",
            f"mean burst of losses: {runs(found.lost).mean():.3g} packets in the trace, {model.bursts(1)[1]:.3g} of "
            f"the fit, {1 / (1 - share):.3g} of independent losses",
        ]
    for k, name in enumerate(found.names):
        c = found.conditions[k]
        delay = f", delay {c.delay_ns / 1e6:.4g} ms, sd {c.jitter_ns / 1e6:.3g} ms" if c.delay_ns else ""
        rate = f", rate {c.rate_bit_s} bit/s" if c.rate_bit_s else ""
        lines.append(
            f"{name}: {100 * found.shares[k]:.3g} % of the time, mean {found.mean_ns[k] / 1e9:.4g} s, "
            f"loss {100 * c.loss:.3g} %{delay}{rate}"
        )
    if found.uneven:
        lines.append(
            "the packets are not evenly spaced: the states are fitted per packet, and times follow from the interval"
        )
    if found.lag > 0.01:
        lines.append(
            "no states in continuous time fit these changes from packet to packet exactly: probabilities differ by up "
            f"to {100 * found.lag:.2g} %; try --states 2"
        )
    return lines


def _draw(found: LinkFit, trace: Path, picture: Path) -> None:
    from fleet.addons.pictures.bursts import draw_bursts
    from fleet.addons.robots.link_fit import runs

    measured = {"burst of losses": runs(found.lost), "gap between bursts": runs(1.0 - found.lost)}
    longest = int(max(lengths.max() for lengths in measured.values())) + 1
    named = {f"fit of {found.model.states} states": found.model, "independent losses": found.independent}
    models = {
        name: dict(zip(measured, (model.bursts(longest)[0], model.gaps(longest)[0]), strict=True))
        for name, model in named.items()
    }
    draw_bursts(picture, trace.name, measured, models)


# --- pictures, reports and tables of a study


def is_study(path: Path) -> bool:
    """Whether it is the directory of a study."""
    return (path / "study.json").is_file()


def check_options(subject: Path, names: Collection[str], only_for: str) -> None:
    """Refuse options that were given, by their parameters, if they are for what the subject is not: UsageError."""
    options = click.get_current_context().command.params
    given = [each.opts[-1] for each in options if each.name in names and is_given(each.name)]
    if given:
        raise click.UsageError(f"{', '.join(given)}: only for {only_for}; {subject} is none")


def plot_study(
    directory: Path, out: Path | None, measures: Sequence[str], formats: Sequence[str], log_scale: bool | None
) -> list[Path]:
    """Draw a study; returns the files, and tells what could not be drawn.

    Raises StudyError: it is damaged, there is no such measure, or the extra `study` is not installed; FleetError: the
    place cannot be written.
    """
    store = _open(directory)
    from fleet.addons.studies.pictures.gallery import write

    said: list[str] = []
    with showing("drawing") as tell:
        paths = write(store, measures, out or directory / "plots", formats, log_scale, said.append, tell)
    for note in said:
        say(f"fleet: {note}", err=True)
    return paths


def report_study(directory: Path, out: Path, measures: Sequence[str], log_scale: bool | None) -> None:
    """Write the page about a study.

    Raises StudyError: it is damaged, there is no such measure, or the extra `study` is not installed; FleetError: the
    place cannot be written.
    """
    store = _open(directory)
    from fleet.addons.studies.pictures.report import write

    with showing("drawing and adding up") as tell:
        write(out, store, measures, log_scale, tell)


def export_study(directory: Path, folder: Path, form: str, *, force: bool) -> Path:
    """Write the rows of a study as `csv` or `parquet`; returns the file.

    Raises StudyError: it is damaged, or an extra is not installed; FleetError: something is in the way, or the place
    cannot be written.
    """
    from fleet.addons.studies.engine import need

    if form == "parquet":
        need(["pyarrow"], "Parquet needs", "parquet")
    frame, path = _open(directory).frame(), folder / f"{directory.resolve().name}.{form}"
    if path.exists() and not force:
        raise FleetError(f"{path} is there already: choose another place, or replace it with --force")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if form == "parquet":
            frame.to_parquet(path, index=False)
        else:
            units = frame.attrs["units"]
            header = [f"{name} [{units[name]}]" if name in units else name for name in frame.columns]
            frame.to_csv(path, index=False, header=header)
    except OSError as error:
        raise FleetError(f"cannot write {path}: {error.strerror}; choose another place") from error
    return path


def _open(directory: Path) -> Store:
    from fleet.addons.studies.engine import need_extra

    need_extra()
    from fleet.addons.studies.store import Store

    return Store.open(directory)


COMMANDS = (plot, export, report, info, movie, fit)
