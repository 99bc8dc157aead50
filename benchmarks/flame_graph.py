"""A flame graph as one SVG: width is time, a function stands on its caller, a tooltip says how much time it was."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from colorsys import hls_to_rgb
from dataclasses import dataclass, field
from xml.sax.saxutils import escape
from zlib import crc32

WIDTH, ROW, MARGIN = 1200, 16, 8  # pixels
LETTER = 6.6  # width of a character
LEAST = 0.002  # narrower boxes, as a share of the whole, are left out


@dataclass(frozen=True, slots=True)
class Frame:
    """One function in a stack."""

    name: str
    kind: str  # decides its colour; grey without one

    @property
    def colour(self) -> str:
        hue, light = crc32(self.kind.encode()) % 360 / 360, 0.70 + sum(map(ord, self.name)) % 12 / 100
        return "#" + "".join(f"{round(255 * part):02x}" for part in hls_to_rgb(hue, light, 0.6 if self.kind else 0.0))


@dataclass(slots=True)
class _Node:
    seconds: float = 0.0
    below: dict[Frame, _Node] = field(default_factory=dict)


def flame_graph(title: str, stacks: Iterable[tuple[tuple[Frame, ...], float]]) -> str:
    """Draw stacks.

    Args:
        stacks: the outermost function first, and how long the stack was seen [s].
    """
    root = _Node()
    for frames, seconds in stacks:
        node = root
        node.seconds += seconds
        for frame in frames:
            node = node.below.setdefault(frame, _Node())
            node.seconds += seconds
    boxes = list(_boxes(root, root.seconds, 0.0, 0))
    kinds = sorted({frame.kind: frame for _, _, frame, _ in boxes if frame.kind}.values(), key=lambda frame: frame.kind)
    depth = 1 + max((level for level, *_ in boxes), default=0)
    height = (depth + 2) * ROW + 3 * MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}"',
        'font-family="monospace" font-size="11">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
        f'<text x="{MARGIN}" y="{ROW}" font-size="13">{escape(title)}</text>',
        *_legend(kinds),
    ]
    for level, begin, frame, seconds in boxes:
        x, width = MARGIN + begin * (WIDTH - 2 * MARGIN), seconds / root.seconds * (WIDTH - 2 * MARGIN)
        y = height - MARGIN - (level + 1) * ROW
        told = escape(
            f"{frame.name}{f' ({frame.kind})' if frame.kind else ''}: {seconds:.2f} s, {seconds / root.seconds:.1%}"
        )
        box = f'<rect x="{x:.1f}" y="{y}" width="{width:.1f}" height="{ROW - 1}" fill="{frame.colour}"/>'
        room = int(width / LETTER) - 1
        word = f'<text x="{x + 2:.1f}" y="{y + 11}">{escape(_cut(frame.name, room))}</text>' if room >= 3 else ""
        lines.append(f"<g><title>{told}</title>{box}{word}</g>")
    return "\n".join([*lines, "</svg>\n"])


def _boxes(node: _Node, whole: float, begin: float, level: int) -> Iterator[tuple[int, float, Frame, float]]:
    """(level, begin as a share of the whole, function, seconds) of everything that is wide enough, callers first."""
    for frame, inner in sorted(node.below.items(), key=lambda item: item[0].name):
        share = inner.seconds / whole
        if share >= LEAST:
            yield level, begin, frame, inner.seconds
            yield from _boxes(inner, whole, begin, level + 1)
        begin += share


def _legend(kinds: Iterable[Frame]) -> Iterator[str]:
    x = float(MARGIN)
    for frame in kinds:
        yield f'<rect x="{x:.1f}" y="{ROW + MARGIN}" width="10" height="10" fill="{frame.colour}"/>'
        yield f'<text x="{x + 14:.1f}" y="{ROW + MARGIN + 9}">{escape(frame.kind)}</text>'
        x += 14 + (len(frame.kind) + 2) * LETTER


def _cut(text: str, room: int) -> str:
    return text if len(text) <= room else text[: room - 1] + "…"
