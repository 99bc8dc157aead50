"""The common part of a study's pictures: safe texts, colours, and hatching for runs that lack a number."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import floor, isfinite, isinf, log10
from typing import Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import Transform

from fleet.addons.pictures.look import legend_pt
from fleet.addons.studies.pictures.points import (
    Cell,
    Key,
    Quantity,
    Value,
    VariedKey,
    key_words,
    short_words,
    value_words,
)
from fleet.addons.studies.record import AxisRecord
from fleet.addons.studies.statistics import CONFIDENCE, LEAST, Estimate, levels
from fleet.errors import printable
from fleet.palette import COLOURS

LONGEST_NAME = 30  # characters
WRAPPED = 36  # characters of a line along an axis
BAND = 0.2  # opacity
_MUCH = 30.0  # times
NOTHING, _INK = "0.93", "0.45"  # the greys behind a hatch, and of its lines
_HATCHES = ("////", "xxxx", "....")
REASONS = ("not made yet", "without a result", "without this number")  # as the fields of Lack
DIVERGING = LinearSegmentedColormap.from_list("differences", (COLOURS[0], "#f4f4f4", COLOURS[1]))

Rectangle = tuple[float, float, float, float]  # left, bottom, width, height


def text(words: str, most: int = LONGEST_NAME) -> str:
    """Words of a study as a picture shows them: short, without control characters and formulas."""
    words = printable(words)
    words = words if len(words) <= most else f"{words[: most - 1]}…"
    return words.replace("$", r"\$") if not words.startswith("_") else f" {words}".replace("$", r"\$")


def axis_label(axis: VariedKey | AxisRecord) -> str:
    return text(key_words(axis.key)) + (f" [{text(axis.unit)}]" if axis.unit else "")


def wrapped(words: str, width: int = WRAPPED) -> str:
    """Words in lines that fit along an axis."""
    return "\n".join(textwrap.wrap(text(words, 4 * width), width))


def quantity_label(quantity: Quantity, width: int = WRAPPED) -> str:
    label = wrapped(quantity.what, width)
    if quantity.kind == "difference":
        label += f"\n{text(value_words(quantity.pair), width) if quantity.pair else 'difference of pairs'}"
    return label


def interval_label(quantity: Quantity) -> str:
    if quantity.kind == "share":
        return f"{100 * CONFIDENCE:g} % interval"
    level = levels(cell.estimate for cell in quantity.cells.values())
    return f"{level} interval" if level else f"no interval: fewer than {LEAST} runs"


def estimate_words(quantity: Quantity) -> str:
    """What a number of a picture is, of how many runs, and what its interval is."""
    runs = sorted({len(cell.values) for cell in quantity.cells.values() if cell.values})
    count = "" if not runs else f"n = {runs[0]}" if len(runs) == 1 else f"n = {runs[0]} to {runs[-1]}"
    each = "pairs with the same seed" if quantity.kind == "difference" else "runs"
    what = "share" if quantity.kind == "share" else "median"
    kind = " (Wilson)" if quantity.kind == "share" else " (order statistics)"
    if not count:
        return f"{what} of {each} at each point: none is made yet"
    return (
        f"{what} of {each} at each point, {count}, {interval_label(quantity)}{kind if has_interval(quantity) else ''}"
    )


def has_interval(quantity: Quantity) -> bool:
    """Whether any number of a picture has one."""
    return any(isfinite(cell.estimate.level) for cell in quantity.cells.values())


def columns_of(panels: int) -> int:
    return 2 if panels == 4 else min(3, panels)


def scale(quantity: Quantity) -> float:
    return 100.0 if quantity.kind == "share" else 1.0


def _decimals(value: float) -> int:
    size = floor(log10(abs(value))) if value else 0
    return max(0, 2 - max(size, 0)) if size >= -1 else 1 - size


class Digits:
    """Numbers and intervals for small texts: no number has more decimals than the usual one of them needs."""

    def __init__(self, values: Sequence[float], factor: float) -> None:
        self._factor = factor
        usual = float(np.percentile(np.abs(values), 75)) if values else 0.0
        self._most = 0 if factor != 1.0 else min(4, _decimals(usual))

    def _shown(self, value: float) -> str:
        if isinf(value):
            return "∞" if value > 0.0 else "-∞"
        value *= self._factor
        return f"{value:.{min(self._most, _decimals(value))}f}"

    def value(self, estimate: Estimate) -> str:
        return self._shown(estimate.value)

    def interval(self, estimate: Estimate) -> str:
        return f"{self._shown(estimate.low)}..{self._shown(estimate.high)}"


class Lacks:
    """Gathers the rectangles of runs that lack a number, and draws them hatched."""

    def __init__(self) -> None:
        self._seen: set[int] = set()
        self._gathered: dict[tuple[Axes, int, str], list[Rectangle]] = {}

    def add(self, ax: Axes, cell: Cell, rectangle: Rectangle, colour: str = _INK) -> None:
        """Hatch a rectangle from below, as high as the share of the runs that lack the number."""
        left, bottom, width, height = rectangle
        for kind, count in enumerate(cell.lack):
            if count:
                part = height * count / cell.runs
                self._gathered.setdefault((ax, kind, colour), []).append((left, bottom, width, part))
                bottom += part
                self._seen.add(kind)

    def draw(self, transform: Callable[[Axes], Transform] = lambda ax: ax.transData) -> None:
        """Draw what was gathered, above all else. `transform`: of the rectangles of an axis."""
        for (ax, kind, colour), rectangles in self._gathered.items():
            x, y, w, h = np.array(rectangles).T
            corners = np.stack([np.stack([x, x + w, x + w, x], 1), np.stack([y, y, y + h, y + h], 1)], 2)
            found = PolyCollection(
                list(corners), hatch=_HATCHES[kind], facecolor=NOTHING, edgecolor=colour, linewidth=0.3,
                transform=transform(ax), zorder=3, gid="lack",
            )  # fmt: skip
            ax.add_collection(found, autolim=False)

    def handles(self) -> list[Artist]:
        return [
            Patch(facecolor=NOTHING, edgecolor=_INK, linewidth=0.3, hatch=_HATCHES[kind], label=REASONS[kind])
            for kind in sorted(self._seen)
        ]


def used_axes(axes: Sequence[Axes], shown: Sequence[Panel]) -> Iterator[tuple[int, Axes, Panel]]:
    """The axes that have a panel, with its title; the others are not seen."""
    for ax in axes[len(shown) :]:
        ax.set_visible(False)
    for number, (ax, panel) in enumerate(zip(axes, shown, strict=False)):
        if panel.title:
            ax.set_title(panel.title)
        yield number, ax, panel


def room(ax: Axes, axis: Literal["x", "y"], share: float) -> None:
    """Leave a share of an axis free of what is drawn: of x at the right, of y below."""
    low, high = ax.get_xlim() if axis == "x" else ax.get_ylim()
    transform = (ax.xaxis if axis == "x" else ax.yaxis).get_transform()
    low, high = transform.transform([low, high])
    more = share / (1.0 - share) * (high - low)
    ends = transform.inverted().transform([low, high + more] if axis == "x" else [low - more, high])
    (ax.set_xlim if axis == "x" else ax.set_ylim)(*ends)


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """One legend above everything, in as many columns as fit; the figure gets higher by it."""
    if handles:
        longest = max(len(str(handle.get_label())) for handle in handles)
        columns = max(1, int(figure.get_figwidth() * 72.0 / (legend_pt() * (0.52 * longest + 4.5))))
        columns = min(columns, len(handles))
        figure.legend(handles=list(handles), loc="outside upper center", ncols=columns)
        rows = -(-len(handles) // columns)
        figure.set_figheight(figure.get_figheight() + (1.3 * rows + 1.0) * legend_pt() / 72.0)


def logarithmic(values: Iterable[float]) -> bool:
    """Whether numbers are spread more evenly on a logarithmic axis than on a linear one."""
    found = np.unique(np.fromiter(values, float))
    if len(found) < 3 or found[0] <= 0.0 or found[-1] < 8.0 * found[0]:
        return False
    even = np.linspace(0.0, 1.0, len(found))
    off = [np.abs((each - each[0]) / (each[-1] - each[0]) - even).max() for each in (found, np.log(found))]
    return bool(off[1] < off[0])


def spans_much(values: Iterable[float]) -> bool:
    """Whether numbers differ so much that a linear axis shows the largest ones only; infinite ones do not count."""
    found = [value for value in values if isfinite(value)]
    return bool(found) and min(found) > 0.0 and max(found) > _MUCH * min(found)


def few_ticks(axis: Axis, names: Sequence[str], most: int) -> None:
    """Ticks at 0, 1, 2, ... with names; of many only every second, third, ..."""
    step = -(-len(names) // most)
    axis.set_ticks(range(0, len(names), step), labels=names[::step])


MOST_PANELS = 12  # of one picture; more go to further ones


@dataclass(frozen=True, slots=True)
class Panel:
    """One part of a picture: the values of the dimensions that are neither axes nor lines."""

    title: str
    fixed: dict[int, Value]  # by place of the dimension


@dataclass(frozen=True, slots=True)
class Layout:
    """How a study is shown best: which varied key becomes which part of a picture, and a key with one value none."""

    kind: Literal["heat", "curve", "boxes"]  # a map over two numbers, a curve over one, or boxes over words
    dimensions: tuple[VariedKey, ...]
    axes: tuple[int, ...]  # places in `dimensions`: x, or x and y
    lines: int | None  # place of the key with a line, or a colour of boxes, for each value
    panels: tuple[Panel, ...]  # in the order of the page

    def key(self, panel: Panel, values: dict[int, Value]) -> Key:
        given = panel.fixed | values
        return tuple(given.get(k, each.values[0]) for k, each in enumerate(self.dimensions))


def layout_of(quantity: Quantity) -> Layout:
    dimensions = quantity.dimensions
    left = [k for k, dimension in enumerate(dimensions) if len(dimension.values) > 1]
    numbers = [k for k in left if dimensions[k].unit is not None]
    kind: Literal["heat", "curve", "boxes"] = "heat" if len(numbers) > 1 else "curve" if numbers else "boxes"
    if kind == "boxes":
        axes = tuple(left[:1])
    else:
        axes = tuple(sorted(numbers, key=lambda k: -len(dimensions[k].values))[:2])
        axes = tuple(sorted(axes))
    left = [k for k in left if k not in axes]
    lines = None
    if kind != "heat":
        lines = next((k for k in left if len(dimensions[k].values) <= len(COLOURS)), None)
        left = [k for k in left if k != lines]
    return Layout(kind, dimensions, axes, lines, tuple(_panels(dimensions, left)))


def _panels(dimensions: tuple[VariedKey, ...], places: list[int]) -> Iterator[Panel]:
    for values in product(*(dimensions[k].values for k in places)):
        fixed = dict(zip(places, values, strict=True))
        title = ", ".join(
            f"{text(short_words(dimensions[k].key))} {text(dimensions[k].shown(value))}" for k, value in fixed.items()
        )
        yield Panel(title, fixed)
