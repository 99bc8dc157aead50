"""How what is drawn looks: the colours and lines of each theme, and what the state of a link means in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fleet.palette import COLOURS
from fleet.recorder.scene.link_state import ARRIVED, BEHIND, CUT, DAMAGED, GONE, LinkState

VEHICLE, PACKET = "vehicle", "packet"  # begin colour words such as `vehicle 3` and `packet lost`
COURSE, OBSTACLE, REFERENCE_POINT, FAULT, NO_AGENT = "course", "obstacle", "reference", "fault", "no agent"

LINK_MEANINGS = {
    LinkState.DELIVERING: "everything arrives in time",
    LinkState.LATE: "arrives after the next one was sent",
    LinkState.LOSING: "some of the last ten packets were lost",
    LinkState.CUT: "cut, or five packets in a row were lost",
    LinkState.STALE: "nothing has arrived for long",
    LinkState.SILENT: "nothing was sent yet",
}


class Stroke(NamedTuple):
    """How a line is drawn."""

    colour: str
    width: float  # pixels on a screen, points in print
    dash: tuple[float, ...] = ()  # lengths of dashes and gaps; none: solid


class Theme(NamedTuple):
    """The colours and lines of one kind of renderer."""

    vehicles: tuple[str, ...]  # colours of vehicles, which repeat
    links: Mapping[LinkState, Stroke]
    colours: Mapping[str, str]  # colours of all other colour words

    def colour(self, word: str) -> str:
        kind, _, number = word.partition(" ")
        return self.vehicle(int(number)) if kind == VEHICLE else self.colours[word]

    def vehicle(self, i: int) -> str:
        return self.vehicles[(i - 1) % len(self.vehicles)]


# The hues of print, lighter, because the sea is dark on the page.
PAGE = Theme(
    ("#4fa8e0", "#ff8a3d", "#2fce9f", "#e09ac4", "#9adcff", "#f5c04a"),
    {
        LinkState.DELIVERING: Stroke("#7cc4f2", 1.6),
        LinkState.LATE: Stroke("#ffe08a", 2, (10, 3)),
        LinkState.LOSING: Stroke("#ffa94d", 2.2, (5, 4)),
        LinkState.CUT: Stroke("#ff5c6c", 3, (3, 4)),
        LinkState.STALE: Stroke("#93a1b2", 2, (2, 5)),
        LinkState.SILENT: Stroke("#4a5d73", 1),
    },
    {
        f"{PACKET} {ARRIVED}": "#d6f0ff",
        f"{PACKET} {BEHIND}": "#ffe08a",
        f"{PACKET} {DAMAGED}": "#e09ac4",
        f"{PACKET} {GONE}": "#ffa94d",
        f"{PACKET} {CUT}": "#ff5c6c",
        COURSE: "#6f8aa3",
        OBSTACLE: "#dce4ec",
        REFERENCE_POINT: "#ffffff",
        FAULT: "#ff5c6c",
        NO_AGENT: "#93a1b2",
    },
)
PRINT = Theme(
    COLOURS,
    {
        LinkState.DELIVERING: Stroke("#0072B2", 0.9),
        LinkState.LATE: Stroke("#E69F00", 1.3, (7, 2)),
        LinkState.LOSING: Stroke("#E69F00", 1.5, (3, 2)),
        LinkState.CUT: Stroke("#C1272D", 2.0, (1, 1.2)),
        LinkState.STALE: Stroke("#808080", 1.2, (1, 2.5)),
        LinkState.SILENT: Stroke("#C8C8C8", 0.6),
    },
    {
        f"{PACKET} {ARRIVED}": "#0072B2",
        f"{PACKET} {BEHIND}": "#E69F00",
        f"{PACKET} {DAMAGED}": "#CC79A7",
        f"{PACKET} {GONE}": "#E69F00",
        f"{PACKET} {CUT}": "#C1272D",
        COURSE: "#666666",
        OBSTACLE: "#808080",
        REFERENCE_POINT: "#1A1A1A",
        FAULT: "#C1272D",
        NO_AGENT: "#808080",
    },
)
# No black, which vanishes in a viewer's dark theme. In the log a link has four states: the others need a clock.
FOXGLOVE = Theme(
    tuple(colour for colour in COLOURS if colour != "#000000"),
    {
        LinkState.DELIVERING: Stroke("#56B4E9", 2.0),
        LinkState.LOSING: Stroke("#E69F00", 3.0),
        LinkState.CUT: Stroke("#D55E00", 5.0),
        LinkState.SILENT: Stroke("#808080", 1.0),
    },
    {REFERENCE_POINT: "#808080", NO_AGENT: "#808080"},
)
