"""Every picture of a run: which there are, drawn and written."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from fleet.errors import FleetError
from fleet.logs.reader import Tell
from fleet.logs.topic import TooLargeError
from fleet.pictures import exchange, shares, signals, timing, track
from fleet.pictures.runs import NothingToDraw, Run, View, origin
from fleet.pictures.style import save

Draw = Callable[[Sequence[Run], View], Figure]
# What one can ask for -> the pictures that answer: (name of the file, what it shows, how). By the name of its file one
# can ask for a single picture, too.
WHAT: dict[str, tuple[tuple[str, str, Draw], ...]] = {
    "track": (
        ("track", "The vehicles' ways from above, in north and east", track.top),
        ("track-3d", "The same in three dimensions", track.space),
    ),
    "error": (
        ("error", "Consensus error of each vehicle, from true positions", signals.consensus),
        ("formation", "Distance of each vehicle from its place in the formation", signals.formation),
    ),
    "velocity": (("velocity", "Velocity tracking errors z", signals.velocity),),
    "attitude": (("attitude", "Roll, pitch and heading of the hulls", signals.attitude),),
    "inputs": (("inputs", "Force and moments as applied, limits, and where a limit was met", signals.inputs),),
    "commands": (("commands", "Velocity commands and the bounds that the optimisation keeps", signals.commands),),
    "gains": (("gains", "Gains that the optimisation chooses, and their bounds", signals.gains),),
    "links": (("links", "What became of the packets of each link, as shares over time", shares.timeline),),
    "messages": (("messages", "Messages between the agents in space and time", exchange.spacetime),),
    "ages": (("ages", "Age of what was last heard on each link", exchange.ages),),
    "timing": (("timing", "On a wall clock: how late agents answered, what delays became", timing.punctuality),),
}
# Those that are left out where everything is asked for, if they hold for none of the runs.
_ONLY_IF: dict[str, Callable[[Run], bool]] = {"timing": timing.on_wall_clock, "attitude": signals.rolls}
PER_RUN = frozenset({"links", "messages", "timing"})  # those that show one run only: of several, each has its own


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
        for name, title, make in WHAT.get(kind) or single[kind]:
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
        PictureError: the folder cannot be written.
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
        raise PictureError(
            f"cannot write pictures to {folder}: {error.strerror}; choose another place with -o DIR"
        ) from error
    return paths


class PictureError(FleetError):
    """The pictures cannot be written."""
