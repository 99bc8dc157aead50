"""Every picture of a run: which there are, drawn and written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from fleet.addons.pictures import any_signal, channel, exchange, track
from fleet.addons.pictures.answer_times import has_wall_clock, punctuality
from fleet.addons.pictures.labels import given_labels
from fleet.addons.pictures.look import looking, parse_look
from fleet.addons.pictures.packet_shares import timeline
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View, check_view, load, origin
from fleet.addons.pictures.style import (
    Drawn,
    figures,
    save_all,
    words_of,
)
from fleet.addons.pictures.time_series import consensus, formation, inputs
from fleet.addons.pictures.verbs.choice import PictureChoice, find_common_drawer
from fleet.errors import FleetError
from fleet.logs.open_log import Log
from fleet.logs.topic import TooLargeError
from fleet.mcap.reader import OnProgress
from fleet.notebook import Pictures
from fleet.scenario.sections.signals import parse_name

Draw = Callable[[Sequence[LoggedRun], View], Figure]
_Picture = tuple[str, str, Draw]
# What one can ask for -> the pictures that answer: (name of the file, what it shows, how). By the name of its file one
# can ask for a single picture, too.
WHAT: dict[str, tuple[_Picture, ...]] = {
    "track": (
        ("track", "The vehicles' ways from above, in north and east", track.top),
        ("track-3d", "The same in three dimensions", track.space),
    ),
    "error": (
        ("error", "Consensus error of each vehicle, from true positions", consensus),
        ("formation", "Distance of each vehicle from its place in the formation", formation),
    ),
    "inputs": (("inputs", "Force and moments as applied, limits, and where a limit was met", inputs),),
    "links": (("links", "What became of the packets of each link, as shares over time", timeline),),
    "messages": (("messages", "Messages between the agents in space and time", exchange.spacetime),),
    "channel": (("channel", "The acoustic channel: what each modem transmits, hears and loses", channel.timeline),),
    "ages": (("ages", "Age of what was last heard on each link", exchange.ages),),
    "checks": (),  # a picture for each error that the checks are about, and for each signal that they name
    "timing": (("timing", "On a wall clock: how late agents answered, what delays became", punctuality),),
}
# Those that are left out where everything is asked for, if they hold for none of the runs.
_ONLY_IF: dict[str, Callable[[LoggedRun], bool]] = {
    "timing": lambda run: has_wall_clock(run) and not run.of_nodes,
    "channel": channel.is_acoustic,
    **dict.fromkeys(("track", "error", "inputs"), lambda run: not (run.of_nodes or run.moored)),
}
# Those that show one run only: of several, each has its own.
PER_RUN = frozenset({"links", "messages", "channel", "timing"})


def check_signals(what: Sequence[str], runs: Sequence[LoggedRun]) -> None:
    """Raises FleetError: a signal among what is asked for is in none of the logs."""
    single = {picture[0] for pictures in WHAT.values() for picture in pictures}
    for word in what:
        if word not in WHAT and word not in single and (name := parse_name(word)) is not None:
            any_signal.require_signal(runs, name)


def draw(
    what: Sequence[str], runs: Sequence[LoggedRun], view: View, share: OnProgress = lambda _: None
) -> Iterator[tuple[str, str, Figure | str]]:
    """(file name, what it shows, the figure or why there is none) of everything that is asked for. `share`: called
    before each with the share that is done.
    """
    for name, title, _, figure in _each(what, runs, view, share):
        yield name, title, figure


def _each(
    what: Sequence[str], runs: Sequence[LoggedRun], view: View, share: OnProgress
) -> Iterator[tuple[str, str, Sequence[LoggedRun], Figure | str]]:
    asked_for_all = {*what, *PER_RUN} >= set(WHAT)  # a report of several runs has those of one run elsewhere
    begun: set[str] = set()
    single = {picture[0]: (picture,) for pictures in WHAT.values() for picture in pictures}
    for number, kind in enumerate(what):
        share(number / len(what))
        if asked_for_all and kind in _ONLY_IF and not any(map(_ONLY_IF[kind], runs)):
            continue
        pictures = _pictures(kind, runs, single)
        if not pictures and not asked_for_all:
            yield kind, kind, runs, "no check of the scenario is about an error or names a signal"
        for name, title, make in pictures:
            if name in begun:
                continue
            begun.add(name)
            each = [[run] for run in runs] if kind in PER_RUN else [list(runs)]
            for some in each:
                called = name if len(each) == 1 else f"{name}-{some[0].slug}"
                shown = title if len(each) == 1 else f"{title}: {some[0].label}"
                try:
                    yield called, shown, some, make(some, view)
                except (NothingToDraw, TooLargeError) as reason:
                    yield called, shown, some, str(reason)


def _pictures(kind: str, runs: Sequence[LoggedRun], single: Mapping[str, tuple[_Picture, ...]]) -> Sequence[_Picture]:
    if kind in WHAT or kind in single:
        named = any_signal.signals_of_checks(runs) if kind == "checks" else []
        found = WHAT.get(kind, ()) or single.get(kind, ())
        if kind == "checks":
            found = tuple(picture for name in any_signal.pictures_of_checks(runs) for picture in single[name])
    else:
        signal = parse_name(kind)
        named, found = [] if signal is None else [signal], ()
    own = [(any_signal.file_name(one), any_signal.title(runs, one), any_signal.picture(one)) for one in named]
    return [*found, *own]


def write(
    what: Sequence[str],
    runs: Sequence[LoggedRun],
    view: View,
    folder: Path,
    formats: Sequence[str],
    tell: Callable[[str], None],
    share: OnProgress = lambda _: None,
) -> list[Path]:
    """Draw into a folder, which is made if need be; returns the files. `tell` gets a sentence about each picture that
    could not be drawn. Raises FleetError if the folder cannot be written.
    """
    return save_all(_with_origins(_each(what, runs, view, share)), folder, formats, tell)


def _with_origins(drawn: Iterable[tuple[str, str, Sequence[LoggedRun], Figure | str]]) -> Iterator[Drawn]:
    for name, title, of, figure in drawn:
        yield name, figure, partial(origin, of, title)


def plot(
    log: str | Path | Log,
    what: str | Sequence[str] = (),
    *,
    out: str | Path | None = None,
    format: str | Sequence[str] = "png",
    compare: str | Path | Sequence[str | Path] = (),
    labels: Mapping[str, str] | Sequence[str] = (),
    window: tuple[float, float] | None = None,
    vehicles: Sequence[int] | None = None,
    linear: bool | None = None,
    caption: bool = True,
    style: str = "",
) -> Pictures:
    """Draw pictures of a log or of a study, as `fleet plot` does.

    Example:
        >>> figure = fleet.plot("runs/latest", "error")["error"]
        >>> figure.set_size_inches(3.5, 2.5)
        >>> figure.savefig("error.pdf")

    Args:
        log: an MCAP file, a run directory, or a log that is open; or the directory of a study.
        what: as `--what`: `track`, `error`, `inputs` or another word, or signals such as `state.z`, as a list or with
            commas between them. Of a study its measures. Empty: all that there are data for.
        out: the folder into which they are written as well; None: no file is written.
        format: of the files: `png`, `svg`, `pdf`, or several of them.
        compare: other runs, or other studies, on the same axes.
        labels: the names in legends, in the order of the logs, or by their directories. By default what differs.
        window: only this time, from and to [s]; None: the whole run.
        vehicles: only these; None: all.
        linear: True: all axes are linear; False: errors, other signals and ages are logarithmic; None: errors are.
        caption: whether the words below a picture are in it. `figure.get_label()` has them in any case.
        style: font, size and width of a column, such as `font=serif,size=9pt,width=88mm`.

    Returns:
        The figures by name. A notebook shows them.

    Raises:
        LogReadError: a log cannot be read.
        FleetError: there is no such picture, signal, vehicle or font, it has no data, the logs are not alike, or the
            folder cannot be written.
    """
    look = replace(parse_look(style), caption=caption)
    others = [compare] if isinstance(compare, (str, Path)) else compare
    paths = [log.path if isinstance(log, Log) else Path(log), *map(Path, others)]
    words, formats, folder = words_of(what), words_of(format), None if out is None else Path(out)
    log_scale = None if linear is None else not linear
    if (other := find_common_drawer(paths)) is not None:
        shown = PictureChoice(measures=tuple(words), log_scale=log_scale, window=window)
        with looking(look):
            return Pictures(other.figures(paths, folder, shown, formats, given_labels(paths, labels), words))
    single = [name for pictures in WHAT.values() for name, *_ in pictures]
    if strange := [word for word in words if word not in (*WHAT, *single) and parse_name(word) is None]:
        raise FleetError(f"there is no picture {strange[0]!r}; expected some of {', '.join(WHAT)}, or a signal")
    runs = load(paths, labels=labels)
    view = View(None if vehicles is None else tuple(vehicles), log_scale, window)
    check_view(runs, view)
    check_signals(words, runs)
    said: list[str] = []
    with looking(look):
        drawn = _with_origins(_each(words or list(WHAT), runs, view, lambda _: None))
        found = figures(drawn, folder, formats, said.append)
    if words and said:
        raise FleetError("; ".join(said))
    return Pictures(found)
