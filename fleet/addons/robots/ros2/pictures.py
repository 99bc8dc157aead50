"""Pictures of bags of ROS 2: where things went, and the numbers of each topic over time; and a page with them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fleet.addons.pictures.axes import FEW, marks_legend
from fleet.addons.pictures.caption import write_caption
from fleet.addons.pictures.labels import distinct
from fleet.addons.pictures.look import column_in
from fleet.addons.pictures.page import Heading, Paragraph, Table, from_here, images, render, write_page
from fleet.addons.pictures.runs import with_gaps
from fleet.addons.pictures.style import STYLES, THIN, Drawn, Provenance, panels
from fleet.addons.robots.ros2.columns import RosColumns, ros_columns
from fleet.errors import FleetError, printable
from fleet.logs.info import Info, read_info
from fleet.logs.open_log import Log, Opening
from fleet.mcap.reader import LogReader, OnProgress, log_path
from fleet.mcap.records import Array
from fleet.palette import COLOURS
from netem.parsing import nearest

TRACK = "track"
# By type where the position of a message is: x, y and z of it.
POSITIONS = {
    "nav_msgs/msg/Odometry": "pose.pose.position",
    "geometry_msgs/msg/PoseStamped": "pose.position",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose.position",
    "geometry_msgs/msg/PointStamped": "point",
    "geometry_msgs/msg/TransformStamped": "transform.translation",
}
MOST_TRACKS, MOST_AXES, MOST_PICTURES = 14, 8, 40
_UNITS = {
    r"\b(position|translation|point)\.[xyz]$": "m", r"\btwist\.linear\.[xyz]$": "m/s", r"\bforce\.[xyz]$": "N",
    r"\b(twist\.angular|angular_velocity)\.[xyz]$": "rad/s", r"\blinear_acceleration\.[xyz]$": "m/s²",
    r"\btorque\.[xyz]$": "N m", r"\bfluid_pressure$": "Pa", r"\b(latitude|longitude)$": "deg", r"\baltitude$": "m",
}  # fmt: skip
_LONGEST = 60  # characters of a name
_STAMP = re.compile(r"(.*\.)?stamp$|.*covariance.*")


@dataclass
class DrawnBag:
    """A bag, of which topics with known numbers are read."""

    path: Path
    label: str
    info: Info
    log: Log
    types: dict[str, RosColumns] = field(default_factory=dict)  # by topic
    begin_s: float = 0.0  # of its first message, since 1970 as a rule

    def series(self, topic: str, name: str, window: tuple[float, float] | None) -> tuple[Array, Array]:
        """Times since the first message [s] and values of a field, in a window."""
        t, values = self.log[topic].t - self.begin_s, self.log[topic][name].astype(np.float64)
        inside = slice(None) if window is None else (t >= window[0]) & (t <= window[1])
        return t[inside], values[inside]

    def numbers(self, topic: str) -> list[str]:
        """The fields of a topic that are one number each, without stamps."""
        return [one.name for one in self.types[topic].columns if one.is_number and not _STAMP.match(one.name)]


def load(
    paths: Sequence[Path], labels: Sequence[str | None] = (), share: OnProgress = lambda _: None
) -> list[DrawnBag]:
    """Read bags. `labels`: None: the name of the directory. Raises LogReadError: one cannot be read."""
    named = [*labels, *[None] * (len(paths) - len(labels))]
    names = distinct([label or printable(path.resolve().name) for label, path in zip(named, paths, strict=True)])
    return [_load(path, name, share) for path, name in zip(paths, names, strict=True)]


def _load(path: Path, label: str, share: OnProgress) -> DrawnBag:
    info = read_info(path)
    reader = LogReader(log_path(path))
    for _ in reader.blocks():  # schemas may stand anywhere
        pass
    types: dict[str, RosColumns] = {}
    for channel in reader.channels.values():
        schema = reader.schemas.get(channel.schema_id)
        if schema is None or not info.topics.get(channel.topic, ("", 0))[1]:
            continue
        known = ros_columns(channel.topic, channel.message_encoding, schema)
        if known is not None and any(one.is_number for one in known.columns):
            types[channel.topic] = known
    kept = {topic: frozenset(one.name for one in known.columns if one.is_number) for topic, known in types.items()}
    log = Opening(path, list(types), share, drawn=kept).read()
    return DrawnBag(path, label, info, log, types, info.start_s)


def draw(bags: Sequence[DrawnBag], what: Sequence[str], window: tuple[float, float] | None) -> Iterator[Drawn]:
    """The pictures: of all topics, or of `track`, `/topic` and `/topic.field`. Raises FleetError: there is no such."""
    topics = list(dict.fromkeys(topic for bag in bags for topic in bag.types))
    wanted = [_find_field(bags, topics, word) for word in what] or [(TRACK, ""), *((topic, "") for topic in topics)]
    for topic, name in wanted[:MOST_PICTURES]:
        if topic == TRACK:
            called, title, figure = TRACK, "Positions from above, and z over time", _track(bags, window)
        else:
            called = re.sub(r"[^\w.-]+", "-", f"{topic}.{name}" if name else topic).strip("-")[:120] or "topic"
            title, figure = f"{topic} {name}".strip(), _signals(bags, topic, name, window)
        yield called, figure, partial(_origin, bags, printable(title))
    if len(wanted) > MOST_PICTURES:
        yield (
            "others",
            f"{len(wanted) - MOST_PICTURES} more topics; choose with --what /topic",
            partial(_origin, bags, ""),
        )


def _origin(bags: Sequence[DrawnBag], title: str) -> Provenance:
    return Provenance(title, (("bag", " and ".join(bag.label for bag in bags)),
                              ("digest", " and ".join(bag.log.digest for bag in bags))))  # fmt: skip


def _find_field(bags: Sequence[DrawnBag], topics: Sequence[str], word: str) -> tuple[str, str]:
    if word == TRACK:
        return TRACK, ""
    topic, _, name = word.partition(".")
    if topic not in topics:
        hint = nearest(topic, [TRACK, *topics]) or f"there are {', '.join([TRACK, *topics][:12])}"
        raise FleetError(f"the bag has no numbers {printable(word)!r}; {printable(hint)}")
    fields = [known for bag in bags if topic in bag.types for known in bag.numbers(topic)]
    if name and name not in fields:
        hint = nearest(name, fields) or f"it has {', '.join(fields[:12])}"
        raise FleetError(f"{printable(topic)} has no number {printable(name)!r}; {printable(hint)}")
    return topic, name


def _track(bags: Sequence[DrawnBag], window: tuple[float, float] | None) -> Figure | str:
    every = [(bag, topic, POSITIONS[bag.info.topics[topic][0]]) for bag in bags for topic in bag.types
             if bag.info.topics[topic][0] in POSITIONS]  # fmt: skip
    if not every:
        return "no topic has positions: nav_msgs/msg/Odometry or another pose with a stamp"
    figure = Figure(figsize=(column_in(), 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, height_ratios=(3.0, 1.0))
    handles: list[Any] = []
    for (bag, topic, place), colour, style in zip(every[:MOST_TRACKS], cycle(COLOURS), _dashes(), strict=False):
        (t, x), (_, y), (_, z) = (bag.series(topic, f"{place}.{axis}", window) for axis in "xyz")
        if not len(t):
            continue
        look: dict[str, Any] = {"color": colour, "linestyle": style, "linewidth": THIN}
        above.plot(x, y, gid=f"{bag.label}{topic}", **look)
        above.plot(x[:1], y[:1], "o", color=colour, markersize=3.5, markerfacecolor="white")
        above.plot(x[-1:], y[-1:], "o", color=colour, markersize=3.5)
        below.plot(*_broken(t, z), **look)
        handles.append(Line2D([], [], label=_name(bags, bag, topic), **look))
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel("x [m]")
    above.set_ylabel("y [m]")
    below.set_xlabel("time [s]")
    below.set_ylabel("z [m]")
    marks_legend(figure, handles)
    notes = ["circle: start, dot: end; x, y and z as in the messages, each in its frame"]
    if len(every) > MOST_TRACKS:
        notes.append(f"the first {MOST_TRACKS} of {len(every)} topics")
    write_caption(figure, notes)
    return figure


def _signals(bags: Sequence[DrawnBag], topic: str, name: str, window: tuple[float, float] | None) -> Figure | str:
    having = [bag for bag in bags if topic in bag.types]
    fields = [name] if name else list(dict.fromkeys(known for bag in having for known in bag.numbers(topic)))
    if not name:
        fields = [one for one in fields if any(_moves(bag, topic, one, window) for bag in having)]
    if not fields:
        return "none of its numbers changes"
    shown = fields[:MOST_AXES]
    figure, axes = panels(len(shown), 1, column_in(), 1.1 * len(shown) + 0.8)
    for ax, one in zip(axes, shown, strict=True):
        for bag, colour, style in zip(having, COLOURS, STYLES, strict=False):
            if one in bag.numbers(topic):
                _line(ax, *bag.series(topic, one, window), color=colour, linestyle=style, gid=bag.label)
        ax.set_ylabel(_short(one), parse_math=False)
    axes[-1].set_xlabel("time [s]")
    if len(bags) > 1:
        marks_legend(figure, [Line2D([], [], color=c, linestyle=s, label=bag.label)
                              for bag, c, s in zip(having, COLOURS, STYLES, strict=False)])  # fmt: skip
    notes = [f"{topic}: {having[0].info.topics[topic][0]}"]
    if len(fields) > MOST_AXES:
        notes.append(f"the first {MOST_AXES} of {len(fields)} numbers that change; others: {topic}.{fields[MOST_AXES]}")
    write_caption(figure, [printable(note) for note in notes])
    figure.align_ylabels(axes)
    return figure


def _moves(bag: DrawnBag, topic: str, name: str, window: tuple[float, float] | None) -> bool:
    if name not in bag.numbers(topic):
        return False
    _, values = bag.series(topic, name, window)
    good = values[np.isfinite(values)]
    return len(good) > 1 and bool((good != good[0]).any())


def _line(ax: Axes, t: Array, values: Array, **look: Any) -> None:
    ax.plot(*_broken(t, values), linewidth=THIN, marker="." if len(t) < FEW else "", markersize=3, **look)


def _broken(t: Array, values: Array) -> tuple[Array, Array]:
    """The line, broken where much more time than usual is without a message."""
    at, found = with_gaps(t, values[:, np.newaxis], 4.0 * float(np.median(np.diff(t))) if len(t) > 2 else 0.0)
    return at, found[:, 0]


def _dashes() -> Iterator[Any]:
    """Other dashes once all colours have been there."""
    return (style for style in cycle(STYLES) for _ in COLOURS)


def _name(bags: Sequence[DrawnBag], bag: DrawnBag, topic: str) -> str:
    text = printable(f"{bag.label}: {topic}" if len(bags) > 1 else topic)
    return text if len(text) <= _LONGEST else f"…{text[1 - _LONGEST :]}"


def _short(name: str) -> str:
    """The end of a field's name, which is what an axis has room for, with the unit that ROS prescribes (REP 103)."""
    unit = next((unit for pattern, unit in _UNITS.items() if re.search(pattern, name)), "")
    return "\n".join(name.split(".")[-2:]) + (f" [{unit}]" if unit else "")


def write_report(path: Path, out: Path, window: tuple[float, float] | None) -> None:
    """Write a page about a bag. Raises LogReadError: it cannot be read; FleetError: the place cannot be written."""
    write_page(out, lambda: _page(path, window))


def _page(path: Path, window: tuple[float, float] | None) -> str:
    (bag,) = load([path])
    top, others = images((name, origin().title, figure) for name, figure, origin in draw([bag], [], window))
    span = max(bag.info.end_s - bag.info.start_s, 0.0)
    rows = [
        (printable(topic), printable(kind), count, f"{(count - 1) / span:.3g}" if span and count > 1 else "-",
         ", ".join(bag.numbers(topic)[:12]) if topic in bag.types else "not read: its type is not known here"
         if count else "")
        for topic, (kind, count) in bag.info.topics.items()
    ]  # fmt: skip
    facts = [
        ("messages", bag.info.messages), ("topics", len(bag.info.topics)), ("duration", f"{span:.6g} s"),
        ("size", f"{bag.info.bytes / 1e6:.3g} MB"), ("digest", bag.log.digest),
    ]  # fmt: skip
    text = f"A bag of ROS 2: {printable(str(from_here(path)))}. It has no checks and no faults, so nothing is judged."
    blocks: list[Any] = [Paragraph(text), Table((), facts)]
    if bag.info.missing:
        blocks.append(Paragraph(f"The bag is not whole: {printable(bag.info.missing)}", "warn"))
    if top is not None:
        blocks.append(top)
    headings = ("topic", "type", "messages", "rate [1/s]", "numbers")
    blocks += [Heading("Topics"), Table(headings, rows, "last"), Heading("Numbers"), others]
    blocks.append(Paragraph(f"To draw one: `fleet plot {printable(str(from_here(path)))} --what /topic`"))
    return render(f"Bag {bag.label}", blocks)
