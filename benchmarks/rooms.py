"""The rooms of the code as one SVG: how large each is, and what each imports.

    python benchmarks/rooms.py > docs/rooms.svg

A row and a column stand for a room, in the order of the floors in `pyproject.toml`, the highest first. A cell says how
often modules of the row import modules of the column, so all that goes down stands to the right of the diagonal.
"""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import grimp

ROOT = Path(__file__).parents[1]
PACKAGES = ("fleet", "agents", "world", "netem")
CELL, NAME, BAR, MARGIN = 21, 190, 150, 8  # pixels: a cell; room for names, bars, and around everything
BELOW = "fleet.quantities"  # the floor at which the modules of `fleet` itself stand


def rooms() -> dict[str, int]:
    """Lines of each room, without the rooms within it, the highest floor first."""
    sizes = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("__init__.py")):
            name = ".".join(path.parent.relative_to(ROOT).parts)
            sizes[name] = sum(len(file.read_text("utf-8").splitlines()) for file in path.parent.glob("*.py"))
    order = _floors()
    return dict(sorted(sizes.items(), key=lambda room: (_floor(room[0], order), room[0])))


def _floors() -> list[str]:
    """The floors of all contracts, the highest first, `fleet` spelled out."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    layers = [contract for contract in contracts if "layers" in contract]
    packages, fleet = (
        next(each["layers"] for each in layers if key in each["layers"]) for key in ("agents", "fleet.cli")
    )
    (addons,) = (each["layers"] for each in layers if each.get("containers") == ["fleet.addons"])
    spelt = [" | ".join(f"fleet.addons.{name}" for name in floor.split(" | ")) for floor in addons]
    return [*spelt, *fleet, *(layer for layer in packages if layer != "fleet")]


def _floor(room: str, order: Sequence[str]) -> int:
    parts = room.split(".")
    top = ".".join(parts[: 3 if room.startswith("fleet.addons.") else 2 if room.startswith("fleet.") else 1])
    known = (k for k, floor in enumerate(order) if (BELOW if top == "fleet" else top) in floor.split(" | "))
    return next(known, -1)  # templates, which nobody imports


def imports(names: Sequence[str]) -> Counter[tuple[str, str]]:
    """How often modules of one room import modules of another."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)

    def room_of(module: str) -> str:
        return module if module in names else module.rpartition(".")[0]

    found: Counter[tuple[str, str]] = Counter()
    for module in graph.modules:
        for imported in graph.find_modules_directly_imported_by(module):
            if room_of(module) != room_of(imported):
                found[room_of(module), room_of(imported)] += 1
    return found


def svg(sizes: Mapping[str, int], counts: Mapping[tuple[str, str], int]) -> str:
    """The picture."""
    names, order = list(sizes), _floors()
    left, above = MARGIN + NAME + BAR, MARGIN + NAME
    width, height = left + CELL * len(names) + MARGIN, above + CELL * len(names) + MARGIN + 24
    parts = [f'<rect width="{width}" height="{height}" fill="white"/>']
    longest = max(sizes.values())
    for k, name in enumerate(names):
        x, y = left + CELL * k, above + CELL * k
        if k and _floor(name, order) != _floor(names[k - 1], order):  # a new floor
            parts.append(f'<path d="M{MARGIN} {y}H{width - MARGIN}M{x} {MARGIN}V{height - 32}" stroke="#999"/>')
        parts.append(_text(MARGIN, y + 15, name))
        parts.append(f'<g transform="translate({x + 15} {above - 6}) rotate(-90)">{_text(0, 0, name)}</g>')
        parts.append(f'<rect x="{x}" y="{y}" width="{CELL}" height="{CELL}" fill="#bbb"/>')
        bar = (BAR - 50) * sizes[name] / longest
        parts.append(f'<rect x="{MARGIN + NAME}" y="{y + 4}" width="{bar:.1f}" height="{CELL - 8}" fill="#0072B2"/>')
        parts.append(_text(MARGIN + NAME + bar + 3, y + 15, f"{sizes[name]}"))
    for (row, column), count in sorted(counts.items()):
        x, y = left + CELL * names.index(column), above + CELL * names.index(row)
        depth = min(1.0, 0.15 + count / 30)
        place = f'x="{x + 1}" y="{y + 1}" width="{CELL - 2}" height="{CELL - 2}"'
        cell = f'<rect {place} fill="#D55E00" fill-opacity="{depth:.2f}"/>'
        number = _text(x + CELL / 2, y + 15, f"{count}", "middle")
        parts.append(f"<g><title>{row} imports {column}: {count}</title>{cell}{number}</g>")
    parts.append(_text(MARGIN, height - 10, "lines of each room, and how often modules of the row import the column"))
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    return "\n".join([f'{head} font-family="sans-serif" font-size="12">', *parts, "</svg>\n"])


def _text(x: float, y: float, words: str, anchor: str = "start") -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(words)}</text>'


def named(picture: str) -> set[str]:
    """The rooms that a picture names."""
    return set(re.findall(r">([a-z][a-z0-9_.]*)</text>", picture))


if __name__ == "__main__":
    lines = rooms()
    print(svg(lines, imports(list(lines))), end="")
