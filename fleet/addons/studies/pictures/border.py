"""Borders as a picture: where the pass rate falls through a level, how sure that is, and what theory says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fleet.addons.pictures.axes import marks_legend
from fleet.addons.pictures.caption import write_caption
from fleet.addons.pictures.look import column_in, page_in
from fleet.addons.pictures.style import NORMAL, STYLES, Provenance, panels, save
from fleet.addons.studies.borders import Border, Borders, Run, Theory
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.pictures.marks import axis_label, text
from fleet.addons.studies.pictures.points import short_words, value_words
from fleet.addons.studies.record import AxisRecord
from fleet.errors import printable
from fleet.palette import COLOURS

MOST_PANELS = 16
_MOST_WORDS = 200  # characters of a title
_MOST_RULES = 8
MOST_ROWS = 60  # of borders below each other
_MARKS = "osDPXhp"  # no triangle: those point outside
PASSED, FAILED = COLOURS[0], COLOURS[1]


class _One(NamedTuple):
    border: Border
    runs: list[Run]
    theory: Theory


def draw_borders(borders: Borders, theories: Sequence[Theory]) -> Figure:
    """The borders of a study. `theories`: what theory says, border by border. Raises StudyError: there is too much for
    one picture, or the study is damaged."""
    runs = [borders.verdicts(rows.values()) for rows in borders.rows()]
    every = [_One(*one) for one in zip(borders.estimates(), runs, theories, strict=True)]
    per = borders.store.record.axes[:-1]
    varied = [axis for axis in per if len({one.border.values[axis.key] for one in every}) > 1]
    across = next((axis for axis in varied if axis.unit is not None), None)
    figure = _stack_borders(borders, every, varied) if across is None else _across(borders, every, varied, across)
    write_caption(figure, [printable(borders.title)[:_MOST_WORDS], *_shunting(borders, every, varied)])
    return figure


def write_borders(borders: Borders, theories: Sequence[Theory], formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draw a study of a border as `border.png`, or in other formats, in its directory; see `draw_borders`. Returns the
    paths. Raises StudyError: as `draw_borders`, or a file cannot be written."""
    figure = draw_borders(borders, theories)
    stem = borders.store.directory / "border"
    origin = Provenance(borders.title, (("scenario", borders.store.record.scenario),))
    try:
        return save(figure, stem, formats, origin)
    except OSError as error:
        raise StudyError(f"cannot write {stem}: {error.strerror}") from None


def _across(borders: Borders, every: Sequence[_One], varied: Sequence[AxisRecord], across: AxisRecord) -> Figure:
    *outer, lines = [axis for axis in varied if axis is not across] or [across]
    columns = _kinds(every, outer[:1])
    rows = _kinds(every, outer[1:])
    if len(rows) * len(columns) > MOST_PANELS:
        raise StudyError(f"these are {len(rows) * len(columns)} panels, and a picture has {MOST_PANELS} at most")
    width = page_in() if len(columns) > 1 else column_in()
    figure, axes = panels(len(rows), len(columns), width, 2.3 * len(rows) + 0.9)
    values = sorted({float(one.border.values[across.key]) for one in every})
    kinds = _kinds(every, [] if lines is across else [lines])
    value_pt = (width / len(columns) - 0.6) * 72.0 / len(values)  # of a value to the next one
    for number, ax in enumerate(axes):
        row, column = divmod(number, len(columns))
        here = [one for one in every if _is(one, rows[row]) and _is(one, columns[column])]
        for k, kind in enumerate(kinds):
            line = sorted((one for one in here if _is(one, kind)), key=lambda one: one.border.values[across.key])
            shift = 0.16 * (k - (len(kinds) - 1) / 2)
            colour = COLOURS[k % len(COLOURS)] if len(kinds) > 1 else "black"  # the dots of runs have colours, too
            at = [values.index(float(one.border.values[across.key])) for one in line]
            _line(ax, borders, line, at, k, shift, colour)
            if len(kinds) == 1:
                for x, one in zip(at, line, strict=True):
                    for place, away, shade in _stack_dots(one.runs, 4.0 / value_pt, 2.2 / value_pt, 0.45):
                        ax.plot([x + away], [borders.places[place]], ".", color=shade, markersize=3)
        ax.set_xticks(range(len(values)), [f"{value:g}" for value in values])
        ax.set_ylim(*_limits(borders))
        ax.set_title(", ".join(filter(None, (_words(borders, columns[column]), _words(borders, rows[row])))))
        if row == len(rows) - 1:
            ax.set_xlabel(axis_label(across))
        if column == 0:
            ax.set_ylabel(axis_label(borders.along))
    colour = "black" if len(kinds) == 1 else "0.3"
    mark = _MARKS[0] if len(kinds) == 1 else "|"
    border = Line2D([], [], color=colour, linewidth=NORMAL, marker=mark, markersize=4)
    _legend(borders, figure, kinds, every, border, ("v", "^"))
    return figure


def _line(
    ax: Axes, borders: Borders, line: Sequence[_One], at: Sequence[int], k: int, shift: float, colour: str
) -> None:
    bottom, top = borders.places[0], borders.places[-1]
    x = [place + shift for place in at]
    y = [_clip(one.border, bottom, top) for one in line]
    low = [max(bottom, min(one.border.low, top)) for one in line]
    high = [min(top, max(one.border.high, bottom)) for one in line]
    ax.fill_between(x, low, high, color=colour, alpha=0.12, linewidth=0)
    ax.plot(x, y, color=colour, linestyle=STYLES[k % len(STYLES)], linewidth=NORMAL)
    for place, one, value, least, most in zip(x, line, y, low, high, strict=True):
        mark = {"above": "^", "below": "v"}.get(one.border.where, _MARKS[k % len(_MARKS)])
        ax.plot([place, place], [least, most], color=colour, linewidth=NORMAL)
        face = "white" if one.theory.stable is False else colour
        ax.plot([place], [value], mark, color=colour, markerfacecolor=face, markersize=4, clip_on=False, zorder=4)
    rule = [(place, one.theory.reckoning) for place, one in zip(at, line, strict=True)]
    known = [(place, borders.places[min(end, len(borders.places) - 1)]) for place, end in rule if end is not None]
    if known:
        ax.plot(*zip(*known, strict=True), color="0.3", linestyle=":", linewidth=NORMAL + 0.4, zorder=3)


def _stack_borders(borders: Borders, every: Sequence[_One], varied: Sequence[AxisRecord]) -> Figure:
    if len(every) > MOST_ROWS:
        raise StudyError(f"these are {len(every)} borders, and a picture has {MOST_ROWS} below each other at most")
    figure, (ax,) = panels(1, 1, column_in(), 0.45 * len(every) + 1.5)
    bottom, top = borders.places[0], borders.places[-1]
    for row, one in enumerate(every):
        low, high = max(bottom, min(one.border.low, top)), min(top, max(one.border.high, bottom))
        ax.plot([low, high], [row, row], color="black", linewidth=2.0, solid_capstyle="butt")
        mark = {"above": ">", "below": "<"}.get(one.border.where, "o")
        face = "white" if one.theory.stable is False else "black"
        ax.plot([_clip(one.border, bottom, top)], [row], mark, color="black", markerfacecolor=face, markersize=4,
                clip_on=False, zorder=4)  # fmt: skip
        if one.theory.reckoning is not None and one.theory.reckoning < len(borders.places):
            ax.plot([borders.places[one.theory.reckoning]] * 2, [row - 0.4, row + 0.4], ":", color="0.3")
        for place, away, colour in _stack_dots(one.runs, 0.17, 0.07, 0.45):
            ax.plot([borders.places[place]], [row + away], ".", color=colour, markersize=3)
    ax.set_yticks(range(len(every)), [_words(borders, kind) for kind in _kinds(every, varied)])
    ax.set_ylim(len(every) - 0.4, -0.6)
    ax.set_xlim(*_limits(borders))
    ax.set_xlabel(axis_label(borders.along))
    border = Line2D([], [], color="black", linewidth=2.0, marker="o", markersize=4)
    _legend(borders, figure, [{}], every, border, ("<", ">"))
    return figure


def _stack_dots(runs: Sequence[Run], first: float, step: float, last: float) -> Iterator[tuple[int, float, str]]:
    """Place, distance and colour of the dot of each run: those that passed on one side, and closer where many are."""
    for (place, passed), count in Counter(runs).items():
        near = min(step, (last - first) / max(1, count - 1))
        for k in range(count):
            yield place, (-1 if passed else 1) * (first + k * near), PASSED if passed else FAILED


def _legend(
    borders: Borders,
    figure: Figure,
    kinds: Sequence[dict[str, float | str]],
    every: Sequence[_One],
    border: Line2D,
    outside: tuple[str, str],
) -> None:
    """Name what is drawn: `border` looks as the borders do, and `outside` are the marks below and above the range."""
    single = len(kinds) == 1
    handles = [
        Line2D([], [], color=COLOURS[k % len(COLOURS)], linestyle=STYLES[k % len(STYLES)],
               marker=_MARKS[k % len(_MARKS)], markersize=4, label=_words(borders, kind))
        for k, kind in enumerate(kinds) if kind
    ]  # fmt: skip
    if single:
        handles += [
            Line2D([], [], color=colour, linestyle="", marker=".", label=label)
            for colour, label in ((PASSED, "run that passed"), (FAILED, "run that failed"))
        ]
    border.set_label("border and its interval, 95 %")
    handles.append(border)
    grey: dict[str, Any] = {"color": "0.3", "linestyle": "", "markersize": 4}
    if any(one.theory.stable is False for one in every):
        label = "linear loop unstable without loss"
        handles.append(Line2D([], [], marker="o", markerfacecolor="white", label=label, **grey))
    for where, mark in zip(("below", "above"), outside, strict=True):
        if any(one.border.where == where for one in every):
            handles.append(Line2D([], [], marker=mark, label=f"{where} the range", **grey))
    drawn = (end for one in every if (end := one.theory.reckoning) is not None)
    if any(end < len(borders.places) or not single for end in drawn):
        handles.append(Line2D([], [], color="0.3", linestyle=":", label="K τ ρ(A) = 1, τ: mean age under loss"))
    marks_legend(figure, handles)


def _shunting(borders: Borders, every: Sequence[_One], varied: Sequence[AxisRecord]) -> list[str]:
    """K lambda_max and a, once if all borders have the same, and else of each."""
    rules = [one.theory.shunting for one in every]
    if not all(rules):
        return []
    said = [f"K λ_max = {rule[0]:.3g}, a = {rule[1]:g} 1/s" for rule in rules if rule is not None]
    if len(set(said)) == 1:
        return said[:1]
    kinds = [_words(borders, {axis.key: one.border.values[axis.key] for axis in varied}) for one in every]
    return [f"{kind}: {rule}" for kind, rule in zip(kinds, said, strict=True)][:_MOST_RULES]


def _kinds(every: Sequence[_One], axes: Sequence[AxisRecord]) -> list[dict[str, float | str]]:
    found: list[dict[str, float | str]] = []
    for one in every:
        kind = {axis.key: one.border.values[axis.key] for axis in axes}
        if kind not in found:
            found.append(kind)
    return found


def _is(one: _One, kind: dict[str, float | str]) -> bool:
    return all(one.border.values[key] == value for key, value in kind.items())


def _clip(border: Border, bottom: float, top: float) -> float:
    if isfinite(border.value):
        return border.value
    return top if border.where == "above" or border.low > bottom else bottom


def _limits(borders: Borders) -> tuple[float, float]:
    room = 0.04 * (borders.places[-1] - borders.places[0])
    return borders.places[0] - room, borders.places[-1] + room


def _words(borders: Borders, kind: Mapping[str, float | str]) -> str:
    units = {axis.key: axis.unit for axis in borders.store.record.axes}
    shown = {k: value_words(v) if isinstance(v, str) else f"{v:g} {units[k]}".rstrip() for k, v in kind.items()}
    return ", ".join(f"{text(short_words(key))} {text(value)}" for key, value in shown.items())
