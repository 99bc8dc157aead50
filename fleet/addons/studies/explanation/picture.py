"""The picture of an explanation: which links were silent and why, and the signal that the check looks at, over time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from fleet.addons.pictures.axes import marks_legend
from fleet.addons.pictures.caption import write_caption
from fleet.addons.pictures.look import label_pt, page_in
from fleet.addons.pictures.runs import LoggedRun, View, with_gaps
from fleet.addons.pictures.shades import shade
from fleet.addons.pictures.signal_limits import draw_limits
from fleet.addons.pictures.style import HALO, THIN, Provenance, format_of, line, panels, save_as
from fleet.addons.studies.explanation.evidence import ON_THE_WAY, TOPICS
from fleet.addons.studies.explanation.why import Why, link_name, name_of
from fleet.logs.open_log import Log, open_log
from fleet.mcap.records import Array
from fleet.palette import COLOURS
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import parse_name

_MOST_LINKS, _MOST_VEHICLES = 20, 12
_CAUSES = ("#3B3B3B", "#8C6D31", "#6A51A3", "#637939", "#843C39", "#17858B")  # none is that of a vehicle
_ROOM = 0.012  # of the axis: what a digit needs
_FAILED, _PASSES = "#c0392b", "#1e8449"


def draw(why: Why, log_path: Path, scenario: Scenario, path: Path) -> None:
    """Write the picture, as wide as a page. Raises FleetError if the file cannot be written, or its suffix is none of a
    picture.
    """
    format_of(path)  # before the work
    log = open_log(log_path, TOPICS)
    links = _silent(why)
    height = 0.5 + 0.14 * max(4, len(links))
    figure, (above, below) = panels(2, 1, page_in(), height + 3.0, [height, 1.9])
    _draw_gaps(above, why, links)
    below.set_xlim(log.begin, scenario.duration_ns / 1e9)
    words, notes = _draw_signal(below, why, log)
    below.set_ylabel(words)
    for ax in (above, below):
        ax.axvline(why.failed_s, color=_FAILED, linewidth=1.2, label="the check had failed")
        if why.no_return.passes_s is not None:
            ax.axvline(why.no_return.passes_s, color=_PASSES, linewidth=1.2, linestyle=(0, (4, 2)),
                       label="healed here, it passes")  # fmt: skip
    numbered = shade([above, below], log.faults)
    below.set_xlabel("time [s]")
    causes = dict.fromkeys(gap.cause for gap in why.gaps)
    handles = [Patch(color=_colour(cause, causes), label=cause) for cause in list(causes)[:6]]
    marks_legend(figure, [*handles, *below.get_legend_handles_labels()[0]])
    write_caption(figure, [*notes, *numbered])
    facts = (("scenario", why.scenario), ("seed", str(why.seed)), ("digest", log.digest))
    save_as(figure, path, Provenance(f"Why {why.check} failed", facts))


def _silent(why: Why) -> list[str]:
    silent: dict[str, float] = defaultdict(float)
    for gap in why.gaps:
        for link in gap.links:
            silent[link] += gap.to_s - gap.from_s + 1e-3
    worst = sorted(silent, key=lambda link: -silent[link])[:_MOST_LINKS]
    return sorted(worst, key=lambda link: [int(i) for i in link.split("->")])


def _draw_gaps(ax: Axes, why: Why, links: list[str]) -> None:
    causes = dict.fromkeys(gap.cause for gap in why.gaps)
    rows = {link: k for k, link in enumerate(reversed(links))}
    for gap in why.gaps:
        for link in gap.links:
            if link in rows:
                ax.plot([gap.from_s, gap.to_s], [rows[link]] * 2, color=_colour(gap.cause, causes), linewidth=4.0,
                        solid_capstyle="projecting", zorder=2)  # fmt: skip
    ax.set_yticks(list(rows.values()), [link_name(link, why).replace("->", "→") for link in rows], fontsize=label_pt())
    ax.set_ylim(-0.8, len(links) + 0.9)
    ax.set_ylabel("silent links" if links else "no link was silent")


def _colour(cause: str, causes: dict[str, None]) -> str:
    return "0.7" if cause == ON_THE_WAY else _CAUSES[list(causes).index(cause) % len(_CAUSES)]


def _lanes(ax: Axes, series: Mapping[int, tuple[Array, Array]]) -> None:
    """A lane for each vehicle, in which its signal has steps, and filled while it is not 0: as lines they would hide
    each other. Other whole numbers than 0 and 1 stand in the lane where they fit.
    """
    known = np.concatenate([shown[np.isfinite(shown)] for _, shown in series.values()])
    low, high = min(0.0, float(known.min())), max(1.0, float(known.max()))
    first, last = ax.get_xlim()
    for k, (vehicle, (t, shown)) in enumerate(reversed([*series.items()])):
        colour = COLOURS[(vehicle - 1) % len(COLOURS)]
        step = k + 0.7 * (shown - low) / (high - low)
        zero = k - 0.7 * low / (high - low)
        ax.fill_between(t, zero, step, step="post", color=colour, alpha=0.4, linewidth=0, gid=f"lane-{vehicle}")
        ax.plot(t, step, color=colour, linewidth=THIN, drawstyle="steps-post", gid=f"step-{vehicle}")
        if not np.isin(known, (0, 1)).all():
            for begin, end, value in _stretches(t, shown, first, last):
                if end - begin > _ROOM * len(f"{value:g}") * (last - first):
                    ax.text((begin + end) / 2, k + 0.35, f"{value:g}", ha="center", va="center", fontsize=label_pt(),
                            path_effects=HALO, gid=f"value-{vehicle}")  # fmt: skip
    ax.set_yticks(
        [k + 0.35 for k in range(len(series))], [f"vehicle {i}" for i in reversed([*series])], fontsize=label_pt()
    )
    ax.set_ylim(-0.2, len(series))
    ax.grid(axis="y", visible=False)


def _stretches(t: Array, values: Array, first: float, last: float) -> Iterator[tuple[float, float, float]]:
    """Begin, end [s] and value of each time in which a signal does not change, within limits."""
    begins = np.flatnonzero(np.append(True, values[1:] != values[:-1])) if len(t) else np.empty(0, int)
    for begin, end in zip(begins, np.append(begins[1:], len(t)), strict=True):
        if np.isfinite(values[begin]):
            until = t[end] if end < len(t) and np.isfinite(t[end]) else t[end - 1]
            yield max(float(t[begin]), first), min(float(until), last), float(values[begin])


def _draw_signal(ax: Axes, why: Why, log: Log) -> tuple[str, list[str]]:
    """Draw the first signal that the words name, of each vehicle, with what checks ask of it; returns what it is, with
    its unit, and words for below.
    """
    text = next((name for then in why.vehicles for name in then.signals), "")
    name = parse_name(text)
    if name is None:
        return "no signal of the check in the log", []
    group, _, field = name.name.partition(".")
    unit, series = "", dict[int, tuple[Array, Array]]()
    for then in why.vehicles[:_MOST_VEHICLES]:
        topic = f"uuv/{then.vehicle}/{group}"
        if topic not in log or field not in log[topic] or not len(log[topic]):
            continue
        t, values = with_gaps(log[topic].t, log[topic][field].reshape(len(log[topic]), -1))
        shown = np.linalg.norm(values, axis=1) if name.absolute else values[:, 0]
        unit = log[topic].units[field]
        series[then.vehicle] = t, shown
    known = [shown[np.isfinite(shown)] for _, shown in series.values()]
    label = text + (f" [{unit}]" if unit not in ("", "1") else "")
    if any(map(len, known)) and all((values == np.rint(values)).all() for values in known):
        _lanes(ax, series)
        return label, []
    for vehicle, (t, shown) in series.items():
        line(ax, vehicle - 1, t, shown, name_of(vehicle, why), linewidth=THIN)
    return label, draw_limits(ax, [LoggedRun(log, why.scenario)], View(tuple(series)), name._replace(vehicle=None))
