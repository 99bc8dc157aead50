"""How long losses last: the lengths of bursts, and of the gaps between them, of a trace and of models of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from fleet.addons.pictures.look import column_in
from fleet.addons.pictures.style import Provenance, format_of, legend, line, panels, plain_decades, save_as

Array = np.ndarray[Any, np.dtype[np.float64]]


def survival(lengths: Array) -> tuple[Array, Array]:
    """Lengths n = 1, 2 ... up to the longest, and the share of runs of n or more packets."""
    ordered, n = np.sort(lengths), np.arange(1.0, lengths.max() + 1.0)
    return n, 1.0 - np.searchsorted(ordered, n, "left") / len(ordered)


def draw_bursts(
    path: Path, what: str, measured: Mapping[str, Array], models: Mapping[str, Mapping[str, Array]]
) -> None:
    """Write the picture, as wide as a column: one panel for each kind of run. `measured` has lengths of runs in packets
    by kind; `models`, by name, for each kind the probability of n or more packets, n = 1, 2 ... Raises FleetError if
    the file cannot be written, or its suffix is none of a picture.
    """
    format_of(path)  # before the work
    figure, axes = panels(len(measured), 1, column_in(), 2.1 * len(measured) + 0.4, share=False)
    for ax, (kind, lengths) in zip(axes, measured.items(), strict=True):
        _panel(ax, what, lengths, {name: kinds[kind] for name, kinds in models.items()})
        ax.set_xlabel(f"{kind}: n [packets]")
        ax.set_ylabel("share of n or more")
    legend(figure, axes[0], 1)
    save_as(figure, path, Provenance(f"Bursts of losses: {what}"))


def _panel(ax: Axes, what: str, lengths: Array, models: Mapping[str, Array]) -> None:
    n, shares = survival(lengths)
    ax.plot(n, shares, color="0.2", marker="o", markersize=2.5, linestyle="", label=what)
    for number, (name, curve) in enumerate(models.items()):
        line(ax, number, np.arange(1, len(curve) + 1), curve, name)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(0.9, 1.15 * max(2.0, n[-1]))
    ax.set_ylim(0.5 * float(shares.min()), 1.3)  # below one run of the trace, a model has nothing to be compared with
    plain_decades(ax.xaxis)
    plain_decades(ax.yaxis)
