"""The picture of a what-if: the recorded commands and the others, over time."""

from __future__ import annotations

from pathlib import Path

from fleet.logs.fault_intervals import FaultInterval
from fleet.pictures.shades import shade
from fleet.pictures.style import COLUMN_IN, Provenance, format_of, legend, limit, line, panels, save_as
from fleet.repeat.what_if import COMPONENTS, WhatIf
from fleet.scenario.scenario import timeline


def draw(found: WhatIf, path: Path, digest: str) -> None:
    """Write the picture, as wide as a column. `digest`: of the log that the agent heard. Raises FleetError if the file
    cannot be written, or its suffix is none of a picture.
    """
    format_of(path)  # before the work
    figure, axes = panels(3, 1, COLUMN_IN, 4.6)
    for k, (ax, (name, unit)) in enumerate(zip(axes, COMPONENTS, strict=True)):
        line(ax, 0, found.t, found.recorded[:, k], f"agent {found.agent} of {found.scenario.name}, recorded")
        line(ax, 1, found.t, found.found[:, k], "what if, open loop")
        most = found.scenario.controls[found.agent - 1].tau_max[k]
        if (
            abs(found.recorded[:, k]).max(initial=0.0) > 0.5 * most
            or abs(found.found[:, k]).max(initial=0.0) > 0.5 * most
        ):
            limit(ax, most, "limit" if k == 0 else None)
            limit(ax, -most)
        ax.set_ylabel(f"{name} [{unit}]")
    axes[0].set_xlim(float(found.t[0]), float(found.t[-1]))
    numbered = shade(axes, [FaultInterval(*fault) for fault in timeline(found.scenario)])
    axes[-1].set_xlabel("\n".join(["time [s]", *numbered]))
    legend(figure, axes[0], 1)
    facts = (("scenario", found.scenario.name), ("seed", str(found.scenario.seed)), ("digest", digest))
    save_as(figure, path, Provenance(f"What if: agent {found.agent}", facts))
