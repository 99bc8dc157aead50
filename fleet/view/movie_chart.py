"""The curves below the picture of a movie: formation errors so far, and signals that the checks name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fleet.pictures.shades import union
from fleet.pictures.style import LABEL_PT, THIN
from fleet.scene.styles import PRINT
from fleet.view.view_state import Row

MOST_SIGNALS = 2  # that have a chart of their own
LEFT, RIGHT, BOTTOM, HEIGHT, GAP = 0.06, 0.97, 0.095, 0.15, 0.06  # shares of the figure


class MovieChart:
    """Draws what is known so far, one line per vehicle."""

    def __init__(
        self,
        figure: Figure,
        window: tuple[float, float],
        vehicles: int,
        faults: Sequence[Row],
        signals: Mapping[str, tuple[str, Mapping[int, str]]],
    ) -> None:
        """Draw what stays.

        Args:
            figure: to draw in.
            window: of the movie [s of simulated time].
            vehicles: their number.
            faults: rows with from_s and to_s.
            signals: by their name for all vehicles: the unit, and the names by vehicle.
        """
        shown = dict(list(signals.items())[:MOST_SIGNALS])
        self._names = {
            name: (each, k) for k, (_, names) in enumerate(shown.values(), 1) for each, name in names.items()
        }
        self._whole = [False] + [True] * len(shown)  # whether all values so far are whole numbers: then they are steps
        labels = [
            "error [m]",
            *(f"{name}{'' if unit in ('', '1') else f' [{unit}]'}" for name, (unit, _) in shown.items()),
        ]
        width = (RIGHT - LEFT - GAP * len(shown)) / len(labels)
        self._axes: list[Axes] = []
        for k, label in enumerate(labels):
            ax = figure.add_axes((LEFT + k * (width + GAP), BOTTOM, width, HEIGHT))
            ax.set(xlim=window, xlabel="time [s]")
            # Above: beside the axis there is no room for the name of a signal.
            ax.set_title(label, loc="left", pad=2.0, size=LABEL_PT, parse_math=False)
            for begin, end in union([(row["from_s"], row["to_s"]) for row in faults]):
                ax.axvspan(begin, end, color="0.88", linewidth=0)
            self._axes.append(ax)
        self._lines = [
            [ax.plot([], [], color=PRINT.vehicle(i), linewidth=1.2)[0] for i in range(1, vehicles + 1)]
            for ax in self._axes
        ]
        self._values: list[list[tuple[list[float], list[float]]]] = [
            [([], []) for _ in range(vehicles)] for _ in self._axes
        ]
        self._now = [ax.axvline(window[0], color="0.3", linewidth=THIN) for ax in self._axes]

    def draw(self, frame: Row) -> None:
        """Draw up to a frame."""
        for (times, values), error in zip(self._values[0], frame["errors"], strict=True):
            times.append(frame["t"])
            values.append(np.nan if error is None else error)
        for name, points in frame.get("signals", {}).items():
            if name in self._names:
                i, k = self._names[name]
                times, values = self._values[k][i - 1]
                times += [t for t, _ in points]
                values += [value for _, value in points]
                self._whole[k] &= all(float(value).is_integer() for _, value in points)
        for k, (ax, lines) in enumerate(zip(self._axes, self._lines, strict=True)):
            for line, (times, values) in zip(lines, self._values[k], strict=True):
                line.set_data(times, values)
                line.set_drawstyle("steps-post" if self._whole[k] else "default")
            known = [value for _, values in self._values[k] for value in values if np.isfinite(value)]
            low, high = (0.0, 0.1) if k == 0 else (min(known, default=0.0), max(known, default=1.0))
            high = max(high, *known) if known else high
            margin = 0.08 * (high - low) or 0.5
            ax.set_ylim(0.0 if k == 0 else low - margin, high + margin)
            self._now[k].set_xdata([frame["t"], frame["t"]])
