"""The picture of an explanation: which links were silent and why, and the signal that the check looks at, over time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from fleet.addons.pictures.caption import write_caption
from fleet.addons.pictures.look import label_pt, page_in
from fleet.addons.pictures.runs import with_gaps
from fleet.addons.pictures.shades import shade
from fleet.addons.pictures.style import THIN, Provenance, format_of, legend, line, panels, save_as
from fleet.addons.studies.explanation.evidence import ON_THE_WAY, TOPICS
from fleet.addons.studies.explanation.why import Why, link_name, name_of
from fleet.logs.open_log import Log, open_log
from fleet.logs.records import Array
from fleet.palette import COLOURS
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import parse_name

_MOST_LINKS, _MOST_VEHICLES = 20, 12
_CAUSES = ("#3B3B3B", "#8C6D31", "#6A51A3", "#637939", "#843C39", "#17858B")  # none is that of a vehicle
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
    below.set_ylabel(_draw_signal(below, why, log))
    below.set_xlim(log.begin, scenario.duration_ns / 1e9)
    for ax in (above, below):
        ax.axvline(why.failed_s, color=_FAILED, linewidth=1.2, label="the check had failed")
        if why.no_return.passes_s is not None:
            ax.axvline(why.no_return.passes_s, color=_PASSES, linewidth=1.2, linestyle=(0, (4, 2)),
                       label="healed here, it passes")  # fmt: skip
    numbered = shade([above, below], log.faults)
    below.set_xlabel("time [s]")
    legend(figure, below, 5)
    write_caption(figure, numbered)
    causes = dict.fromkeys(gap.cause for gap in why.gaps)
    if causes:
        handles = [Patch(color=_colour(cause, causes), label=cause) for cause in list(causes)[:6]]
        above.legend(handles=handles, loc="upper left", fontsize=label_pt(), ncols=len(handles), frameon=True)
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
    ax.set_yticks(list(rows.values()), [link_name(link, why) for link in rows], fontsize=label_pt())
    ax.set_ylim(-0.8, len(links) + 0.9)
    ax.set_ylabel("silent links" if links else "no link was silent")


def _colour(cause: str, causes: dict[str, None]) -> str:
    return "0.7" if cause == ON_THE_WAY else _CAUSES[list(causes).index(cause) % len(_CAUSES)]


def _lanes(ax: Axes, series: Mapping[int, tuple[Array, Array]]) -> None:
    """A lane for each vehicle, filled while its signal is 1: as lines they would hide each other."""
    for k, (vehicle, (t, shown)) in enumerate(reversed([*series.items()])):
        colour = COLOURS[(vehicle - 1) % len(COLOURS)]
        ax.fill_between(t, k, k + 0.7 * shown, step="post", color=colour, alpha=0.4, linewidth=0, gid=f"lane-{vehicle}")
        ax.plot(t, k + 0.7 * shown, color=colour, linewidth=THIN, drawstyle="steps-post", gid=f"step-{vehicle}")
    ax.set_yticks(
        [k + 0.35 for k in range(len(series))], [f"vehicle {i}" for i in reversed([*series])], fontsize=label_pt()
    )
    ax.set_ylim(-0.2, len(series))
    ax.grid(axis="y", visible=False)


def _draw_signal(ax: Axes, why: Why, log: Log) -> str:
    """Draw the first signal that the words name, of each vehicle; returns what it is, with its unit."""
    text = next((name for then in why.vehicles for name in then.signals), "")
    name = parse_name(text)
    if name is None:
        return "no signal of the check in the log"
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
    if known and all(np.isin(values, (0, 1)).all() for values in known):
        _lanes(ax, series)
        return text
    whole = all((values == np.rint(values)).all() for values in known)
    for vehicle, (t, shown) in series.items():
        line(ax, vehicle - 1, t, shown, name_of(vehicle, why), linewidth=THIN,
             drawstyle="steps-post" if whole else "default")  # fmt: skip
    return text + (f" [{unit}]" if unit not in ("", "1") else "")
