"""How a study is shown best: which of its dimensions are axes, lines or panels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Literal

from fleet.palette import COLOURS
from fleet.study.pictures.marks import text
from fleet.study.pictures.points import Key, Quantity, Value, VariedKey
from fleet.study.pictures.words import short_words

MOST_PANELS = 12  # of one picture; more go to further ones


@dataclass(frozen=True, slots=True)
class Panel:
    """One part of a picture: the values of the dimensions that are neither axes nor lines."""

    title: str
    fixed: dict[int, Value]  # by place of the dimension


@dataclass(frozen=True, slots=True)
class Layout:
    """Which varied key becomes which part of a picture. A key with one value becomes none.

    Attributes:
        kind: a `heat` map over two numbers, a `curve` over one, or `boxes` over words.
        dimensions: the varied keys.
        axes: places in `dimensions` of the keys along the axes: x, or x and y.
        lines: place of the key with one line, or one colour of boxes, for each value. None: there is no such key.
        panels: the panels in the order of the page.
    """

    kind: Literal["heat", "curve", "boxes"]
    dimensions: tuple[VariedKey, ...]
    axes: tuple[int, ...]
    lines: int | None
    panels: tuple[Panel, ...]

    def key(self, panel: Panel, values: dict[int, Value]) -> Key:
        """The key of a point of a panel."""
        given = panel.fixed | values
        return tuple(given.get(k, each.values[0]) for k, each in enumerate(self.dimensions))


def layout_of(quantity: Quantity) -> Layout:
    """The layout of a quantity whose dimensions are a product."""
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
