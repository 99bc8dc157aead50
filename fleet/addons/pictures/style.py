"""The style of pictures: sizes, colours that every reader can distinguish, units on every axis, equal bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import ceil, floor, log10
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.look import LEGEND_PT, TEXT_PT, current_look, page_in
from fleet.errors import FleetError
from fleet.palette import COLOURS
from netem.whole_file import whole_file

STYLES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (7, 2)))
STYLE_NAMES = ("solid", "dashed", "dash-dot", "dotted", "dash-dot-dot", "densely dotted", "long dashes")
DPI = 300
THIN, NORMAL, HEAVY = 0.7, 1.0, 3.0  # widths of lines [pt]: limits and many lines; few lines; what stands out
HALO = (withStroke(linewidth=1.5, foreground="white"),)  # of words on lines: a box would hide data
CAPTIONS = "captions.txt"  # what the pictures of a folder would say below themselves
FORMATS = ("png", "svg", "pdf")
_MOST_PLAIN = 4.0  # decades

# A `matplotlibrc` in the current directory would count, and could have LaTeX run over the names in a log.
matplotlib.rcdefaults()
matplotlib.rcParams.update(
    {
        "font.size": TEXT_PT,
        "axes.titlesize": TEXT_PT,
        "axes.labelsize": TEXT_PT,
        "legend.fontsize": LEGEND_PT,
        "xtick.labelsize": LEGEND_PT,
        "ytick.labelsize": LEGEND_PT,
        "lines.linewidth": NORMAL,
        "axes.linewidth": 0.6,
        "axes.grid": True,
        "grid.linewidth": 0.3,
        "grid.alpha": 0.5,
        "legend.frameon": False,
        "svg.hashsalt": "uuv-fleet",  # otherwise every file has other ids
        "svg.fonttype": "none",
        "pdf.fonttype": 42,  # TrueType: journals refuse the other kind
    }
)


def panels(
    rows: int,
    columns: int,
    width: float | None = None,
    height: float | None = None,
    ratios: Sequence[float] | None = None,
    share: bool | Literal["col"] = True,
) -> tuple[Figure, list[Axes]]:
    """A figure with a grid of axes, which share one horizontal axis, or with `col` one in each column. It is as wide as
    a page, if no width is given [inches].
    """
    figure = Figure(figsize=(width or page_in(), height or 1.6 * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, sharex=share, squeeze=False, height_ratios=ratios)
    return figure, [ax for row in axes for ax in row]


def line(ax: Axes, number: int, t: Any, values: Any, label: str, **style: Any) -> None:
    """The `number`-th line of a picture, in its own colour and dashes."""
    k = number % len(COLOURS)
    ax.plot(t, values, color=COLOURS[k], linestyle=STYLES[k], label=label, **style)


def limit(ax: Axes, value: float, label: str | None = None) -> None:
    """A bound as a thin grey dashed line."""
    ax.axhline(value, color="0.4", linewidth=THIN, linestyle=(0, (4, 3)), label=label, gid="bound")


def plain_decades(axis: Axis) -> None:
    """Numbers such as 0.2 on a logarithmic axis of few decades, and enough of them; more stay powers of ten."""
    low, high = axis.get_view_interval()
    decades = log10(high / low) if 0.0 < low < high else 0.0
    if decades > _MOST_PLAIN:
        return
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.0 else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def plain_numbers(axis: Axis, most: int) -> None:
    """Numbers such as 0.2 on a logarithmic axis, at most so many, but never fewer than two."""
    low, high = axis.get_view_interval()
    powers = range(floor(log10(low)), ceil(log10(high)) + 1)
    for digits in ((1, 2, 5), (1,)):
        numbers = [digit * 10.0**power for power in powers for digit in digits]
        found = [value for value in numbers if low * (1.0 - 1e-9) <= value <= high * (1.0 + 1e-9)]
        if len(found) <= most:
            break
    if len(found) > most:
        found = found[:: -(-len(found) // max(most, 2))]
    if len(found) < 2:
        found = [low, high]
    axis.set_major_locator(FixedLocator(found))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{float(f'{value:.2g}'):g}"))
    axis.set_minor_formatter(NullFormatter())


def legend(figure: Figure, ax: Axes, columns: int) -> None:
    """One legend for all axes, above them."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)


class Provenance(NamedTuple):
    """Where a picture comes from, as its file says."""

    title: str
    facts: tuple[tuple[str, str], ...] = ()  # such as ("scenario", "paper"), ("seed", "1"), ("digest", "f7bb...")


NOWHERE = Provenance("")


def metadata(form: str, origin: Provenance = NOWHERE) -> dict[str, Any]:
    """The self-description of a file of a format: PNG's text, PDF's information, SVG's Dublin Core. Never a date."""
    said = ", ".join(f"{name} {value}" for name, value in origin.facts)
    about = [f"{name}={value}" for name, value in origin.facts]
    if form == "png":
        named = {name.capitalize(): value for name, value in origin.facts}
        return {"Software": "uuv-fleet", "Title": origin.title, "Description": said} | named
    if form == "svg":
        return {"Date": None, "Title": origin.title, "Description": said, "Keywords": about}
    dated = {"CreationDate": None, "ModDate": None}
    return dated | {"Title": origin.title, "Subject": said, "Keywords": "; ".join(about)}


def save(figure: Figure, stem: Path, formats: Sequence[str] = ("png",), origin: Provenance = NOWHERE) -> list[Path]:
    """Write a figure in the given formats; the same figure gives the same bytes."""
    paths = []
    for form in formats:
        path = stem.with_name(f"{stem.name}.{form}")
        with whole_file(path) as part:
            figure.savefig(part, format=form, dpi=DPI, metadata=metadata(form, origin))
        paths.append(path)
    return paths


# Of a picture its name, the figure or why there is none, and what makes its origin.
Drawn = tuple[str, Figure | str, Callable[[], Provenance]]


def words_of(text: str | Sequence[str]) -> list[str]:
    """A list that may be given as one text with commas, as on the command line."""
    return [word.strip() for word in text.split(",")] if isinstance(text, str) else [*text]


def figures(
    drawn: Iterable[Drawn], folder: Path | None, formats: Sequence[str], tell: Callable[[str], None]
) -> dict[str, Figure]:
    """The figures by name, written into a folder as well, if there is one. The rest is as for `save_all`."""
    every = [*drawn]
    if folder is not None:
        save_all(every, folder, formats, tell)
    else:
        for name, reason, _ in every:
            if isinstance(reason, str):
                tell(f"{name}: not drawn: {reason}")
    return {name: figure for name, figure, _ in every if not isinstance(figure, str)}


def save_all(
    drawn: Iterable[Drawn],
    folder: Path,
    formats: Sequence[str],
    tell: Callable[[str], None],
) -> list[Path]:
    """Write pictures into a folder, which is made if need be; returns the files. `tell`: called with a sentence about
    each that is not drawn. Raises FleetError: the folder cannot be written.
    """
    paths: list[Path] = []
    captions: list[str] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure, origin in drawn:
            if isinstance(figure, str):
                tell(f"{name}: not drawn: {figure}")
            else:
                paths += save(figure, folder / name, formats, origin())
                captions.append(f"{name}: {origin().title}\n{caption_of(figure)}\n")
        if captions and not current_look().caption:
            paths.append(folder / CAPTIONS)
            with whole_file(paths[-1]) as part:
                part.write_text("\n".join(captions), "utf-8")
    except OSError as error:
        raise FleetError(
            f"cannot write pictures to {folder}: {error.strerror}; choose another place with -o DIR"
        ) from error
    return paths


def format_of(path: Path) -> str:
    """The form of a picture. Raises FleetError: its suffix is none."""
    form = path.suffix.removeprefix(".")
    if form not in FORMATS:
        raise FleetError(f"{path}: a picture ends in one of {', '.join('.' + f for f in FORMATS)}")
    return form


def save_as(figure: Figure, path: Path, origin: Provenance) -> None:
    """Write a figure into one file. Raises FleetError: it cannot be written, or its suffix is none of a picture."""
    try:
        save(figure, path.with_suffix(""), (format_of(path),), origin)
    except OSError as error:
        raise FleetError(f"cannot write {path}: {error.strerror}") from None
