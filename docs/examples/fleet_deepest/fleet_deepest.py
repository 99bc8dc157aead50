"""An add-on of somebody else: the verb `fleet deepest`, and `fleet export --svg DIR`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

import fleet
from fleet.addons.api import Exporter, Log, Option, Selection, command, print_result


class Deepest(msgspec.Struct):
    """`fleet deepest --json`: how deep each vehicle was at most."""

    depths_m: dict[str, float]


@command(document="fleet_deepest.Deepest")
def deepest(log: Log) -> None:
    """Say how deep each vehicle of LOG was at most."""
    found = fleet.open_log(log, ["uuv/*/state"])
    depths = {name.split("/")[1]: float(found[name]["z"].max()) for name in found}
    print_result(Deepest(depths), *(f"{name}: {depth:.1f} m" for name, depth in depths.items()))


@dataclass(frozen=True)
class SvgOptions:
    svg: Annotated[Path | None, Option("Write the tracks, seen from above, as a picture here.", "DIR")] = None


class Svg(Exporter):
    options_type = SvgOptions
    form = "--svg DIR"

    @property
    def folder(self) -> Path | None:
        return self.options.svg

    def write(self, log: Path, selection: Selection, *, force: bool) -> Iterable[Path]:
        found = fleet.open_log(log, ["uuv/*/state"])
        tracks = [zip(found[name]["y"], -found[name]["x"], strict=True) for name in found]
        lines = ["<polyline points='" + " ".join(f"{x:.1f},{y:.1f}" for x, y in track) + "'/>" for track in tracks]
        self.options.svg.mkdir(parents=True, exist_ok=True)
        file = self.options.svg / "tracks.svg"
        file.write_text(f"<svg xmlns='http://www.w3.org/2000/svg' fill='none' stroke='navy'>{''.join(lines)}</svg>\n")
        return [file]
