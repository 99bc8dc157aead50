"""What checks ask of errors and of other signals, in every picture of them, and where vehicles failed it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from small_scenario import small

from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.gallery import WHAT, draw
from fleet.addons.pictures.report import telling
from fleet.addons.pictures.runs import LoggedRun, View, load
from fleet.addons.pictures.style import panels
from fleet.addons.pictures.thresholds import Threshold, draw_thresholds
from fleet.execution.execute import execute
from fleet.execution.options import Options

CHECKS = (
    "{name: near, topic: error.formation_norm, below: 1 cm, after: 200 ms}",
    '{name: agreed, topic: "|error.e|", below: 2 cm, vehicles: 2}',
    "{name: soon, topic: state.z, below: 3 m, after: 100 ms, eventually_within: 300 ms}",
    "{name: together, topic: state.z, spread_below: 40 m}",
    "{name: shallow, topic: state.z, below: 1 km}",
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> LoggedRun:
    checks = f"checks={{signal: [{', '.join(CHECKS)}], formation_error: {{below: 1 mm}}}}"
    options = Options(tmp_path_factory.mktemp("runs"), in_process=True, quiet=True)
    directory: Path = execute(small(checks), options).directory
    return load([directory])[0]


def drawn(run: LoggedRun, what: list[str], view: View | None = None) -> dict[str, Figure]:
    return {name: found for name, _, found in draw(what, [run], view or View()) if isinstance(found, Figure)}


def asked(ax: Axes) -> dict[float, tuple[float, float]]:
    """Value of each limit, and from when to when it holds [s]."""
    lines = [line for line in ax.get_lines() if line.get_gid() == "check"]
    return {float(np.asarray(line.get_ydata())[0]): tuple(map(float, np.asarray(line.get_xdata()))) for line in lines}


def crosses(ax: Axes) -> dict[str, set[tuple[float, float]]]:
    """Time [s] and value of the failures of each vehicle."""
    found: dict[str, set[tuple[float, float]]] = {}
    for line in ax.get_lines():
        if str(line.get_gid()).startswith("failed-") and line.get_marker() == "x":
            place = float(np.asarray(line.get_xdata())[0]), float(np.asarray(line.get_ydata())[0])
            found.setdefault(str(line.get_gid()), set()).add(place)
    return found


@pytest.mark.parametrize("name", ["formation", "error.formation_norm", "|error.formation|"])
def test_a_check_of_the_formation_error_has_a_limit_and_a_cross(name: str, run: LoggedRun) -> None:
    """A check of its own or one of the signal, and whatever the signal is called."""
    (figure,) = drawn(run, [name]).values()
    (ax,) = figure.axes
    assert asked(ax) == {0.001: (0.0, 1.0), 0.01: (0.2, 1.0)}
    first = {verdict.check: verdict.moment for verdict in run.verdicts}
    seen = {place for places in crosses(ax).values() for place in places}
    assert {at for at, _ in seen} == {first["near"].at_s, first["formation_error"].at_s}
    for name, places in crosses(ax).items():
        error = run.log[f"uuv/{name.removeprefix('failed-')}/error"]
        assert all(value == pytest.approx(np.interp(at, error.t, error.formation_norm)) for at, value in places)


def test_a_norm_is_the_signal_that_the_log_has(run: LoggedRun) -> None:
    """A check of `|error.e|` is one of `error.e_norm`, which has a picture of its own."""
    for name in ("error", "|error.e|", "error.e_norm"):
        (ax,) = drawn(run, [name])[{"|error.e|": "norm-error.e"}.get(name, name)].axes
        assert asked(ax) == {0.02: (0.0, 1.0)} and set(crosses(ax)) == {"failed-2"}
    assert not crosses(drawn(run, ["error"], View(vehicles=(1,)))["error"].axes[0])  # of a vehicle that is not shown


def test_the_ages_have_the_limit_of_their_check(run: LoggedRun) -> None:
    other = small("checks={max_age: {below: 80 ms, after: 300 ms, links: '1<->2'}}")
    judged = LoggedRun(run.log, "other")
    judged.__dict__["scenario"] = other
    figure = drawn(judged, ["checks"])["ages"]
    assert asked(figure.axes[0]) == {0.08: (0.3, 1.0)}
    assert "check: below 0.08 s from 0.3 s, links 1<->2" in [text.get_text() for text in figure.axes[0].texts]


def test_checks_are_pictures_of_errors_too(run: LoggedRun) -> None:
    assert list(drawn(run, ["checks"])) == ["error", "formation", "state.z"]
    everything = list(drawn(run, [*WHAT]))
    assert len(everything) == len(set(everything)) and {"error", "formation", "state.z"} <= {*everything}
    assert list(dict.fromkeys(telling(run)))[:2] == ["formation", "error"]


def test_a_condition_that_has_to_come_true_is_drawn_while_it_may(run: LoggedRun) -> None:
    """A limit of vehicles together is no line, and one that is far from all of them leaves no room for them."""
    figure = drawn(run, ["state.z"])["state.z"]
    (ax,) = figure.axes
    assert asked(ax) == {3.0: (0.1, 0.4)}
    words = caption_of(figure)
    assert "check: spread over the vehicles below 40 m" in words and "outside: check: below 1 km" in words
    assert ax.get_ylim()[1] < 4.0


@pytest.mark.parametrize(
    ("limits", "sides"), [((10.0,), ["top"]), ((0.0,), ["bottom"]), ((4.0, 6.0), ["top", "bottom"])]
)
def test_words_on_a_limit_stay_inside_the_axis(limits: tuple[float, ...], sides: list[str]) -> None:
    """Those on a limit at the top stood on the frame."""
    _, (ax,) = panels(1, 1)
    ax.plot([0.0, 1.0], [0.0, 10.0])
    draw_thresholds(ax, [Threshold(value, 0.0, 1.0, "", f"below {value:g} m") for value in limits])
    assert [text.get_verticalalignment() for text in ax.texts] == sides


def test_a_limit_far_away_is_said() -> None:
    for scale, values, near, far in (
        ("linear", (5.0, 5.1), 12.0, 100.0),
        ("log", (0.5, 2.0), 0.01, 1e7),
        ("linear", (-3.0, 40.0), -20.0, -200.0),
    ):
        _, (ax,) = panels(1, 1)
        ax.plot([0.0, 1.0], values)
        ax.set_yscale(scale)
        words = draw_thresholds(ax, [Threshold(value, 0.0, 1.0, "", f"below {value:g} m") for value in (near, far)])
        assert asked(ax).keys() == {near} and words == [f"outside: check: below {far:g} m"]
