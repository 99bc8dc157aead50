"""Every picture of a run: which there are, drawn and written."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from fleet.errors import FleetError
from fleet.logs.reader import Tell
from fleet.logs.topic import TooLargeError
from fleet.pictures import any_signal, exchange, shares, time_series, timing, track
from fleet.pictures.runs import NothingToDraw, Run, View, origin
from fleet.pictures.style import save
from fleet.scenario.sections.signals import parse_name

Draw = Callable[[Sequence[Run], View], Figure]
_Picture = tuple[str, str, Draw]
# What one can ask for -> the pictures that answer: (name of the file, what it shows, how). By the name of its file one
# can ask for a single picture, too.
WHAT: dict[str, tuple[_Picture, ...]] = {
    "track": (
        ("track", "The vehicles' ways from above, in north and east", track.top),
        ("track-3d", "The same in three dimensions", track.space),
    ),
    "error": (
        ("error", "Consensus error of each vehicle, from true positions", time_series.consensus),
        ("formation", "Distance of each vehicle from its place in the formation", time_series.formation),
    ),
    "velocity": (("velocity", "Velocity tracking errors z", time_series.velocity),),
    "attitude": (("attitude", "Roll, pitch and heading of the hulls", time_series.attitude),),
    "inputs": (("inputs", "Force and moments as applied, limits, and where a limit was met", time_series.inputs),),
    "commands": (("commands", "Velocity commands and the bounds that the optimisation keeps", time_series.commands),),
    "gains": (("gains", "Gains that the optimisation chooses, and their bounds", time_series.gains),),
    "links": (("links", "What became of the packets of each link, as shares over time", shares.timeline),),
    "messages": (("messages", "Messages between the agents in space and time", exchange.spacetime),),
    "ages": (("ages", "Age of what was last heard on each link", exchange.ages),),
    "checks": (),  # a picture for each signal that the checks name
    "timing": (("timing", "On a wall clock: how late agents answered, what delays became", timing.punctuality),),
}
# Those that are left out where everything is asked for, if they hold for none of the runs.
_ONLY_IF: dict[str, Callable[[Run], bool]] = {"timing": timing.on_wall_clock, "attitude": time_series.rolls}
PER_RUN = frozenset({"links", "messages", "timing"})  # those that show one run only: of several, each has its own


def check_signals(what: Sequence[str], runs: Sequence[Run]) -> None:
    """Raises FleetError: a signal among what is asked for is in none of the logs."""
    single = {picture[0] for pictures in WHAT.values() for picture in pictures}
    for word in what:
        if word not in WHAT and word not in single and (name := parse_name(word)) is not None:
            any_signal.need(runs, name)


def draw(
    what: Sequence[str], runs: Sequence[Run], view: View, share: Tell = lambda _: None
) -> Iterator[tuple[str, str, Figure | str]]:
    """(file name, what it shows, the figure or why there is none) of everything that is asked for.

    Args:
        share: called before each with the share that is done.
    """
    for name, title, _, figure in _each(what, runs, view, share):
        yield name, title, figure


def _each(
    what: Sequence[str], runs: Sequence[Run], view: View, share: Tell
) -> Iterator[tuple[str, str, Sequence[Run], Figure | str]]:
    """As `draw`, with the runs that a picture shows."""
    asked_for_all = set(what) == set(WHAT)
    begun: set[str] = set()
    single = {picture[0]: (picture,) for pictures in WHAT.values() for picture in pictures}
    for number, kind in enumerate(what):
        share(number / len(what))
        if asked_for_all and kind in _ONLY_IF and not any(map(_ONLY_IF[kind], runs)):
            continue
        pictures = _pictures(kind, runs, single)
        if not pictures and not asked_for_all:
            yield kind, kind, runs, "no check of the scenario names a signal that has no picture of its own"
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


def _pictures(kind: str, runs: Sequence[Run], single: Mapping[str, tuple[_Picture, ...]]) -> Sequence[_Picture]:
    """The pictures of a kind, or of a signal."""
    if kind in WHAT or kind in single:
        named = any_signal.signals_of_checks(runs) if kind == "checks" else []
        found = WHAT.get(kind, ()) or single.get(kind, ())
    else:
        signal = parse_name(kind)
        named, found = [] if signal is None else [signal], ()
    own = [(any_signal.file_name(one), any_signal.title(runs, one), any_signal.picture(one)) for one in named]
    return [*found, *own]


def write(
    what: Sequence[str],
    runs: Sequence[Run],
    view: View,
    folder: Path,
    formats: Sequence[str],
    tell: Callable[[str], None],
    share: Tell = lambda _: None,
) -> list[Path]:
    """Draw into a folder, which is made if need be; returns the files.

    Args:
        tell: called with a sentence about each picture that could not be drawn.
        share: called before each picture with the share that is done.

    Raises:
        FleetError: the folder cannot be written.
    """
    paths: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, title, of, figure in _each(what, runs, view, share):
            if isinstance(figure, str):
                tell(f"{name}: not drawn: {figure}")
            else:
                paths += save(figure, folder / name, formats, origin(of, title))
    except OSError as error:
        raise FleetError(
            f"cannot write pictures to {folder}: {error.strerror}; choose another place with -o DIR"
        ) from error
    return paths
