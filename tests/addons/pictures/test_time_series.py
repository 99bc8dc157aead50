"""Errors with what the checks ask, inputs within their limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from in_process_runs import Alone
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from fleet.addons.pictures import time_series
from fleet.addons.pictures.runs import LoggedRun, View, load
from fleet.addons.pictures.style import panels
from fleet.addons.pictures.thresholds import Threshold, draw_thresholds, thresholds
from tests.support.intervals import interval

CHECKS = (
    "checks={formation_error: {below: 50 cm, after: 3 s}, "
    "recovery_time: {fault: crash, below: 2 s, within: 10 cm, error: formation}}"
)


@pytest.fixture(scope="module")
def run(made: Alone) -> LoggedRun:
    return load([made("paper", "duration=5 s", "faults=[{at: 1 s, for: 1 s, id: crash, kill: 2}]", CHECKS).directory])[
        0
    ]


def lines(ax: Axes, gid: str) -> list[Any]:
    return [line for line in ax.get_lines() if str(line.get_gid() or "").startswith(gid)]


def test_the_checks_of_an_error_are_drawn_where_they_hold(run: LoggedRun) -> None:
    (ax,) = time_series.formation([run], View()).axes
    drawn = {(*line.get_xdata(), line.get_ydata()[0]) for line in lines(ax, "check")}
    assert drawn == {(4.0, 5.0, 0.1), (3.0, 5.0, 0.5)}
    told = [text.get_text() for text in ax.texts if text.get_gid() == "check-name"]
    assert told == ["check: below 0.1 m 2 s after crash", "check: below 0.5 m from 3 s"]
    assert not lines(time_series.consensus([run], View()).axes[0], "check")
    assert not lines(time_series.formation([run], View(window=(0.0, 2.0))).axes[0], "check")
    assert len(thresholds([run, run], "formation")) == 2  # each once


def test_limits_are_those_of_the_window(run: LoggedRun) -> None:
    """What happened before is not on the axis."""
    for log in (None, False):
        (ax,) = time_series.formation([run], View(log_scale=log, window=(1.5, 2.5))).axes
        seen = [np.asarray(line.get_ydata()) for line in lines(ax, "paper-vehicle")]
        assert ax.get_ylim()[1] < 1.6 * max(np.nanmax(values) for values in seen)
        error = run.log["uuv/1/error"]
        inside = (error.t >= 1.5) & (error.t <= 2.5)
        line = lines(ax, "paper-vehicle-1")[0]
        assert set(error.formation_norm[inside]) <= set(line.get_ydata())
        assert len(line.get_ydata()) <= inside.sum() + 2


def test_no_line_of_an_input_reaches_beyond_its_limit(run: LoggedRun) -> None:
    """Not even with its width: beyond the limit every pixel is without colour."""
    figure = time_series.inputs([run], View())
    figure.set_dpi(300)
    canvas = FigureCanvasAgg(figure)
    for place, ax in enumerate(figure.axes):
        for line in [*lines(ax, "bound"), *lines(ax, "failed-check")]:
            line.set_visible(False)
        means = {str(some.get_gid()).removesuffix("-envelope") for some in ax.collections}  # of what is too fast
        held = [line for line in lines(ax, "paper-vehicle") if line.get_gid() not in means]
        assert held and all(line.get_drawstyle() == "steps-post" for line in held)
        assert place >= 3 or lines(ax, "paper-vehicle-1-saturated")
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3].astype(int)
    for ax in figure.axes:
        box = ax.get_window_extent()
        left, right, top = int(box.x0) + 4, int(box.x1) - 4, int(box.y1) - 4
        limit = ax.transData.transform((0.0, 20.0))[1]

        def coloured(low: int, high: int, left: int = left, right: int = right) -> bool:
            part = pixels[low:high, left:right]
            return bool((part.max(axis=2) - part.min(axis=2) > 30).any())

        assert not coloured(int(limit) + 2, top)
        assert ax in figure.axes[3:] or coloured(int(limit) - 6, int(limit))


def test_every_recovery_has_a_line_until_the_next_fault(run: LoggedRun) -> None:
    text = run.log.scenario_text.replace("fault: crash", "fault: every")
    other = LoggedRun(run.log, "other")
    other.log.__dict__.pop("scenario", None)
    other.log.__dict__["_intervals"] = [
        interval("a", 0.5, 1.0, "kill 1"),
        interval("b", 4.0, 4.5, "kill 2"),
    ]
    before, other.log.scenario_text = other.log.scenario_text, text
    try:
        found = [one for one in thresholds([other], "formation") if "after" in one.words]
        assert [(one.begin, one.end) for one in found] == [(3.0, 4.0)]
    finally:
        other.log.scenario_text = before
        for name in ("_intervals", "scenario"):
            other.log.__dict__.pop(name, None)


def test_an_input_beyond_the_limit_is_shown(run: LoggedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    """A line is cut off at a limit that it keeps, and not at one that it does not."""
    strong = LoggedRun(run.log, "strong")
    found = run.series(1, "command", "applied")
    series = strong.series
    monkeypatch.setattr(
        LoggedRun, "series",
        lambda self, i, group, name: (
            (found[0], 1.5 * found[1]) if (self is strong and (i, name) == (1, "applied")) else series(i, group, name)
        ),
    )  # fmt: skip
    figure = time_series.inputs([strong], View())
    figure.draw_without_rendering()
    for i, cut in ((1, False), (2, True)):
        ax = figure.axes[3 * (i - 1) + 1]
        (line,) = [one for one in ax.get_lines() if one.get_gid() == f"strong-vehicle-{i}"]
        top = line.get_clip_box().transformed(ax.transData.inverted()).y1
        assert (top == pytest.approx(20.0)) == cut


def test_checks_of_one_value_are_one_line() -> None:
    """Dashes that are drawn twice fill each other's gaps."""
    _, (ax,) = panels(1, 1)
    ax.set_xlim(0.0, 90.0)
    asked = [(80.0, 90.0), (65.0, 90.0), (10.0, 20.0)]
    draw_thresholds(ax, [Threshold(0.1, begin, end, "", "below 0.1 m") for begin, end in asked])
    assert [list(line.get_xdata()) for line in lines(ax, "check")] == [[10.0, 20.0], [65.0, 90.0]]


def test_no_heavy_line_joins_the_two_limits(made: Alone) -> None:
    """A command that goes from one limit to the other between two samples of a thin log."""
    run = load([made("paper", "checks={}", "vehicles=20", "duration=1 s", "log={every: 20 ticks}").directory])[0]
    figure = time_series.inputs([run], View(vehicles=(14,)))
    heavy = [
        line for ax in figure.axes for line in ax.get_lines() if str(line.get_gid()).endswith(time_series.HEAVY_SUFFIX)
    ]
    values = [np.asarray(line.get_ydata(), float) for line in heavy]
    assert {float(np.sign(v)) for found in values for v in found[np.isfinite(found)]} == {1.0, -1.0}
    assert all(len({float(np.sign(v)) for v in found[np.isfinite(found)]}) == 1 for found in values)
