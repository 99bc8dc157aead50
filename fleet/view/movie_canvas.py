"""Where a movie is drawn: shapes and texts on one axes, which are gone with the next picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from fleet.logs.records import Array
from fleet.pictures.style import THIN
from fleet.scene.model import LegendRow
from fleet.scene.primitives import (
    AreaShape,
    CircleShape,
    CrossShape,
    CylinderShape,
    FramePoint,
    LineShape,
    Primitive,
)
from fleet.scene.styles import PRINT, LinkState
from fleet.view.movie_camera import Camera

TURNS = np.linspace(0.0, 2.0 * np.pi, 37)
OUTLINE = np.array([(0.0, 0.3), (0.1, 0.65), (0.25, 1.0), (0.75, 1.0), (0.92, 0.7), (1.0, 0.0)])  # along, half width


class Canvas:
    """Draws on axes that count in points."""

    def __init__(self, axes: Axes, camera: Camera, size: float) -> None:
        """`size`: of what is drawn of each vehicle, 1 where there is room."""
        self._axes, self._camera, self.size = axes, camera, size
        self._drawn: list[Artist] = []

    def clear(self) -> None:
        """Remove what was drawn."""
        for artist in self._drawn:
            artist.remove()
        self._drawn = []

    def _add(self, artist: Artist) -> None:
        self._axes.add_artist(artist)
        self._drawn.append(artist)

    def lines(self, parts: Sequence[Any], order: float, colours: Any, widths: Any, **style: Any) -> None:
        """Polylines (n, 2 or 3); the first two columns count."""
        segments = [np.asarray(part)[:, :2] for part in parts]
        self._add(LineCollection(segments, colors=colours, linewidths=widths, zorder=order, **style))

    def polygons(self, parts: Sequence[Any], order: float, **style: Any) -> None:
        """Filled outlines (n, 2)."""
        self._add(PolyCollection(parts, zorder=order, **style))

    def discs(self, points: Sequence[Array], size: float, order: float, **style: Any) -> None:
        """Circles around points, so wide."""
        circles = [Ellipse((float(x), float(y)), size, size) for x, y in points]
        self._add(PatchCollection(circles, zorder=order, **style))

    def crosses(self, points: Sequence[Array], size: float, colour: str) -> None:
        """Where something does not get through."""
        turns = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]]) * size
        self.lines([point + turn for point in points for turn in turns], 4.0, colour, 1.8)

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        """Words, which never are mathematics."""
        self._drawn.append(self._axes.text(x, y, text, clip_on=True, parse_math=False, **style))

    def paint(self, thing: Primitive, frames: Mapping[str, Array], deep: float) -> None:
        """Paint a primitive.

        Args:
            frames: where they are [m, NED].
            deep: where the floor is [m].
        """
        colour = PRINT.colour(thing.colour)
        match thing:
            case CylinderShape():
                self._cylinder(thing, colour, deep)
            case CircleShape(at=at):
                style = {"facecolor": "none", "edgecolor": colour, "linewidth": 0.9, "linestyle": "--"}
                self.discs([self._point(at, frames)], 10.0 * self.size, 2.0, **style)
            case CrossShape(at=at):
                x, y = self._point(at, frames)
                self.lines([[(x - 4, y), (x + 4, y)], [(x, y - 4), (x, y + 4)]], 2.0, colour, 1.0)
            case AreaShape(points=points) if all(point.frame in frames for point in points):
                corners = np.array([self._point(point, frames) for point in points])
                style = {"facecolor": to_rgba(colour, 0.13), "edgecolor": to_rgba(colour, 0.7), "linewidth": THIN}
                self.polygons([corners], 1.4, **style)
            case LineShape(points=points) if all(point.frame in frames for point in points):
                places = np.array([self._point(point, frames) for point in points])
                self.lines([places], 1.5, [(colour, 0.5)], THIN, linestyle="--")

    def _point(self, point: FramePoint, frames: Mapping[str, Array]) -> Array:
        return self._camera.project(frames[point.frame] + point[1:])[0, :2]

    def _cylinder(self, thing: CylinderShape, colour: str, deep: float) -> None:
        """Its circles on the floor and above, and the sides between."""
        top = max(0.0, self._camera.centre[2] - 1.5 * self._camera.radius)
        across = thing.north + thing.radius * np.cos(TURNS), thing.east + thing.radius * np.sin(TURNS)
        low, high = (self._camera.project(np.column_stack([*across, np.full_like(TURNS, z)])) for z in (deep, top))
        sides = [np.vstack([low[k : k + 2], high[[k + 1, k]]])[:, :2] for k in range(len(TURNS) - 1)]
        self.polygons(sides, -0.5, facecolor=colour, alpha=0.06)
        ends = [low[:, :2], high[:, :2]]
        self.polygons(ends, -0.5, facecolor=to_rgba(colour, 0.15), edgecolor=colour, linewidth=THIN)


def sample(row: LegendRow) -> Line2D:
    """The sample picture in a row of the legend."""
    if row.sign == "link":
        colour, width, dash = PRINT.links[LinkState(row.word)]
        return Line2D([], [], color=colour, linewidth=width, linestyle=(0, dash) if dash else "-", label=row.name)
    styles: dict[str, dict[str, Any]] = {
        "packet": {"marker": "o", "markersize": 3, "linestyle": "", "color": PRINT.colour(row.word)},
        "circle": {"marker": "o", "markersize": 7, "linestyle": "", "fillstyle": "none", "color": "0.3"},
        "cylinder": {"marker": "o", "markersize": 7, "linestyle": "", "color": "0.8"},
        "area": {"marker": "P", "markersize": 4, "linestyle": "", "color": PRINT.colour(row.word)},
        "line": {"linestyle": "--", "linewidth": THIN, "color": PRINT.colour(row.word), "alpha": 0.5},
    }
    return Line2D([], [], label=row.name, **styles[row.sign])


def hull(tail: Array, nose: Array, half: float) -> Array:
    """The outline of a torpedo between two points."""
    along = nose - tail
    aside = np.array([-along[1], along[0]]) / (np.linalg.norm(along) or 1.0) * half
    sides = [tail + share * along + sign * wide * aside for sign in (1, -1) for share, wide in OUTLINE[::sign]]
    return np.array(sides)


def lane(ends: Array, short: float, aside: float) -> Array:
    """The ends of a link, short of the hulls, and beside the lane of the other direction."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along)) or 1.0
    along = along / length
    keep = min(short, 0.4 * length)
    return np.array([ends[0] + keep * along, ends[1] - keep * along]) + aside * np.array([along[1], -along[0]])


def tip(begin: Array, end: Array, size: float) -> Array:
    """The head of an arrow."""
    along = (end - begin) / (np.linalg.norm(end - begin) or 1.0)
    aside = np.array([-along[1], along[0]])
    return np.array([end, end - size * (along + 0.4 * aside), end - size * (along - 0.4 * aside)])
