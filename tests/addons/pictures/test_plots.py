"""Pictures, tables and reports of logs: what is on the axes, in the files and on the page; no pixel is compared."""

from __future__ import annotations

import csv
import errno
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from html_page import Page
from in_process_runs import Alone
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from msgspec.structs import replace
from repository import ROOT
from tool import invoke

import fleet
from fleet.addons.pictures import exchange
from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.gallery import PER_RUN, WHAT, draw
from fleet.addons.pictures.labels import labels_of
from fleet.addons.pictures.report import _from_log, links_table, page
from fleet.addons.pictures.report import write as write_report
from fleet.addons.pictures.runs import LoggedRun, View, load, with_gaps
from fleet.addons.pictures.style import panels, plain_decades, plain_numbers
from fleet.addons.pictures.verbs.choice import KINDS, PARTS
from fleet.errors import FleetError
from fleet.logs.export import export
from fleet.logs.run_name import run_name
from fleet.logs.table import columns
from fleet.result.file import read_result
from netem.cause import LOSSES, Cause
from netem.ledger import Account

pytestmark = pytest.mark.usefixtures("coarse")


@pytest.fixture(scope="module")
def directories(made: Alone, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Short runs, each with something that a picture must cope with."""

    def logged(name: str, *overrides: str) -> Path:
        return made(name, "checks={}", *overrides).directory

    faults = "faults=[{at: 1 s, for: 1 s, id: crash, kill: 2}, {at: 2500 ms, for: 200 ms, id: cut, partition: halves}]"
    links = "network.links={'*': delay 30ms loss 20% corrupt 10% duplicate 10%}"
    found = {
        "faulty": logged("paper", "duration=4 s", faults, links, "name=faulty"),
        "one": logged("paper", "duration=1 s", "vehicles=1", "name=one", "graph={shape: path, reference: all}",
                      "initial={scatter: 1 m, around: reference}"),
        "ideal": logged("ideal", "duration=1 s", "log={every: 10 ticks}"),
        "acoustic": logged("acoustic-80bps", "duration=20 s", "log={every: 50 ticks}"),
        "twenty": logged("paper", "vehicles=20", "duration=1 s", "log={every: 20 ticks}", "name=twenty"),
        "moored": logged("election", "moored=true", "duration=4 s", "tick=100 ms", "faults=[]"),
        "mixed": logged(str(LAW), "duration=500 ms", "per_vehicle={'1,2,4': {controller: nboc}}", "name=mixed"),
    }  # fmt: skip
    whole = (found["faulty"] / "run.mcap").read_bytes()
    found["cut"] = tmp_path_factory.mktemp("cut")
    (found["cut"] / "run.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    return found


@pytest.fixture(scope="module")
def runs(directories: dict[str, Path]) -> dict[str, LoggedRun]:
    return {name: load([path])[0] for name, path in directories.items()}


ALL = View()
LAW = ROOT / "docs" / "examples" / "leader_follower.yaml"  # a controller of a user's, who reports what he likes


DRAWN: dict[tuple[object, ...], dict[str, Figure | str]] = {}


def pictures(run: LoggedRun | list[LoggedRun], what: list[str], view: View = ALL) -> dict[str, Figure | str]:
    """What is drawn of some runs, once; nobody may change it."""
    runs = run if isinstance(run, list) else [run]
    key = *((one.label, one.log.path) for one in runs), *what, view
    if key not in DRAWN:
        DRAWN[key] = {name: figure for name, _, figure in draw(what, runs, view)}
    return DRAWN[key]


def figure_of(run: LoggedRun | list[LoggedRun], what: str, name: str, view: View = ALL) -> Figure:
    all_of_it = what in WHAT and isinstance(run, LoggedRun) and run.label in ("faulty", "one", "mixed") and view == ALL
    figure = pictures(run, list(WHAT) if all_of_it else [what], view)[name]
    assert isinstance(figure, Figure), figure
    return figure


def lines(ax: Axes, gid: str) -> list[Any]:
    return [line for line in ax.get_lines() if re.fullmatch(gid, str(line.get_gid() or ""))]


RUNS = ("faulty", "one", "ideal", "acoustic", "twenty", "mixed")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "twenty" else []) for name in RUNS]
)
def test_every_picture_of_every_run(name: str, runs: dict[str, LoggedRun]) -> None:
    """Drawn, or a sentence; every axis has a unit; no text is cut off by the picture's edge, and no box covers data."""
    for picture, figure in pictures(runs[name], list(WHAT)).items():
        if isinstance(figure, str):
            assert name == "one" and picture in ("links", "messages", "ages"), (picture, figure)
            continue
        for ax in figure.axes:
            assert ax.get_legend() is None and all(text.get_bbox_patch() is None for text in ax.texts), picture
        if name in ("faulty", "one", "twenty"):  # the others only differ in what is on the axes
            figure.draw_without_rendering()
        for label in filter(None, (label for ax in figure.axes for label in (ax.get_xlabel(), ax.get_ylabel()))):
            assert re.search(r"\[[^]]+\]|^link|^vehicle|^UUV", label), (picture, label)
        if picture != "track-3d" and name in ("faulty", "twenty"):
            width, height = figure.get_size_inches()
            assert width == (7.0 if picture == "inputs" and name == "faulty" else 3.5)  # a row for each vehicle
            box = figure.get_tightbbox()
            assert box.x0 > -0.05 and box.y0 > -0.05 and box.x1 < width + 0.05 and box.y1 < height + 0.05, picture


def test_faults_are_shaded_and_named_on_every_time_axis(runs: dict[str, LoggedRun]) -> None:
    for name, figure in pictures(runs["faulty"], list(WHAT)).items():
        if name in ("track", "track-3d", "messages"):  # messages are those of a part of the time
            continue
        timed = [ax for ax in figure.axes if ax.get_subplotspec() is not None and ax.get_label() != "<colorbar>"]
        for ax in timed:
            shaded = [patch for patch in ax.patches if patch.get_gid() in ("fault", "tumbled")]
            assert [patch.get_gid() for patch in shaded] == ["fault", "fault", "tumbled"], name  # 2 is without an agent
            assert shaded[2].get_facecolor()[0] > shaded[0].get_facecolor()[0]  # in red
            extent = shaded[0].get_extents().transformed(ax.transData.inverted())
            assert (extent.x0, extent.x1) == pytest.approx((1.0, 2.0))
        named = [text.get_text() for text in timed[0].texts if text.get_gid() == "fault-name"]
        assert named == ["crash: kill 2", "cut: partition halves"]
        assert timed[-1].get_xlabel() == "time [s]" and caption_of(figure).startswith("tumbled 2: at ")


def test_a_line_per_vehicle_that_breaks_where_the_agent_is_dead(runs: dict[str, LoggedRun]) -> None:
    figure = figure_of(runs["faulty"], "inputs", "inputs")
    # A row for each vehicle: in one axis their lines hid each other.
    assert [line.get_gid() for ax in figure.axes for line in lines(ax, r"faulty-vehicle-\d+")] == [
        f"faulty-vehicle-{i}" for i in range(1, 5) for _ in range(3)
    ]
    assert [ax.get_title() for ax in figure.axes[:3]] == ["surge force [N]", "pitch moment [N m]", "yaw moment [N m]"]
    assert [ax.get_ylabel() for ax in figure.axes[::3]] == [f"UUV {i}" for i in range(1, 5)]
    (dead,) = lines(figure.axes[3], "faulty-vehicle-2")
    t, values = dead.get_xdata(), dead.get_ydata()
    assert np.isnan(values).sum() == 1
    gap = int(np.flatnonzero(np.isnan(t))[0])
    assert t[gap - 1] < 1.02 and t[gap + 1] >= 2.0
    assert [len(lines(ax, "bound")) for ax in figure.axes] == [2] * 12
    assert [line.get_ydata()[0] for line in lines(figure.axes[0], "bound")] == [-20.0, 20.0]


def test_heavy_where_a_command_is_at_its_limit(runs: dict[str, LoggedRun]) -> None:
    figure = figure_of(runs["faulty"], "inputs", "inputs")
    drawn = [line for ax in figure.axes for line in lines(ax, ".*-saturated")]
    assert drawn
    assert all(np.nanmin(np.abs(line.get_ydata())) == pytest.approx(20.0) for line in drawn)
    assert "heavy: the command is at a limit" in caption_of(figure)


def test_logarithmic_errors(runs: dict[str, LoggedRun]) -> None:
    """Errors unless asked otherwise, other signals and ages only where asked."""
    for asked, scales in ((None, ["log", "log", "linear"]), (True, ["log"] * 3), (False, ["linear"] * 3)):
        drawn = pictures(runs["faulty"], ["error", "ages"] if asked is not None else list(WHAT), View(log_scale=asked))
        assert [drawn[name].axes[0].get_yscale() for name in ("error", "formation", "ages")] == scales


@pytest.mark.parametrize("kind", ["error", "inputs"])
def test_twenty_vehicles_are_a_band_and_three_names(kind: str, runs: dict[str, LoggedRun]) -> None:
    for figure in pictures(runs["twenty"], [kind]).values():
        for ax in figure.axes:
            assert len(lines(ax, r"twenty-vehicle-\d+")) == 3
            assert {c.get_gid() for c in ax.collections} == {"band-all", "band-most"}
            assert lines(ax, "median")
        named = [text.get_text() for text in figure.legends[0].get_texts()]
        assert named[:3] == ["median of 20", "10 to 90 %", "all"] and len(named) == 6
    some = pictures(runs["twenty"], [kind], View(vehicles=(3, 7)))
    figure = next(iter(some.values()))
    if kind == "inputs":
        assert [ax.get_ylabel() for ax in figure.axes] == ["UUV 3", "", "", "UUV 7", "", ""]
    else:
        assert [text.get_text() for text in figure.legends[0].get_texts()] == ["UUV 3", "UUV 7"]
    assert not figure.axes[0].collections


def test_two_runs_on_one_axis(directories: dict[str, Path]) -> None:
    both = load([directories["faulty"], directories["mixed"]])
    figure = figure_of(both, "error", "error")
    (ax,) = figure.axes
    # The vehicles by colour, the runs by dashes: in one colour for each run, vehicles could not be told apart.
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["UUV 1", "UUV 2", "UUV 3", "UUV 4", "solid: faulty", "dashed: mixed"]
    for i in range(1, 5):
        drawn = [line for run in both for line in lines(ax, f"{run.slug}-vehicle-{i}")]
        assert len({line.get_color() for line in drawn}) == 1 and len({line.get_linestyle() for line in drawn}) == 2
    assert len({line.get_color() for line in lines(ax, ".*vehicle.*")}) == 4
    assert [text.get_text() for text in ax.texts][:1] == ["crash: kill 2 (faulty)"]
    assert set(pictures(both, ["links", "ages"])) == {"links-faulty", "links-mixed", "ages"}
    same = load([directories["faulty"], directories["faulty"]])
    assert len({run.label for run in same}) == 2


def test_what_is_missing_is_said(runs: dict[str, LoggedRun]) -> None:
    """A controller that reports other signals, a log without links, one that was cut, one that is not ours."""
    figure = figure_of(runs["mixed"], "guidance.K", "guidance.K")
    assert "not reported by UUV 3" in caption_of(figure)
    own = pictures(runs["mixed"], ["guidance.K", "inputs"], View(vehicles=(3,)))
    assert "no vehicle reports it" in str(own["guidance.K"])
    assert isinstance(own["inputs"], Figure)
    assert pictures(runs["mixed"], ["error"], View(vehicles=(9,)))["error"] == "the log has no such vehicle"
    assert pictures(runs["one"], ["links"])["links"] == "the log has no links"
    cut = figure_of(runs["cut"], "error", "error")
    assert f"the log is not whole, it ends at {runs['cut'].log.end:g} s" in caption_of(cut)
    foreign = LoggedRun(fleet.open_log(runs["faulty"].log.path, ["uuv/*/state"]), "x")
    foreign.log.run = {}
    foreign.log.scenario_text = ""
    found = pictures(foreign, ["ages", "inputs", "track"])
    assert isinstance(found["track"], Figure)
    assert "not a log of uuv-fleet" in str(found["ages"])
    assert foreign.notes and "no limits and bounds" in foreign.notes[0]


def test_gaps() -> None:
    t, values = with_gaps(np.array([0.0, 1.0, 2.0, 5.0, 6.0]), np.arange(5.0).reshape(5, 1))
    assert np.isnan(t[3]) and np.isnan(values[3, 0]) and len(t) == 6
    t, _ = with_gaps(np.array([0.0, 1.0, 2.0, 2.5]), np.zeros((4, 1)))  # the state at the end is always logged
    assert not np.isnan(t).any()


def test_track_has_east_to_the_right_and_north_up(runs: dict[str, LoggedRun]) -> None:
    figure = figure_of(runs["faulty"], "track", "track")
    (ax,) = figure.axes
    state = runs["faulty"].log["uuv/1/state"]
    (line,) = lines(ax, "vehicle-1")
    assert (line.get_xdata() == state.y).all() and (line.get_ydata() == state.x).all()
    assert ax.get_xlabel() == "east [m]" and ax.get_ylabel() == "north [m]"
    assert ax.get_aspect() == 1.0
    assert lines(ax, "reference") and len(lines(ax, "formation")) == 5 * 3
    (dead,) = lines(ax, "agent dead-2")
    k = int(np.searchsorted(runs["faulty"].log["uuv/2/state"].t, 1.0))
    assert dead.get_xdata()[0] == runs["faulty"].log["uuv/2/state"].y[k]
    assert lines(ax, "tumbled-2") and not lines(ax, "agent dead-1")
    assert len(lines(ax, "place")) == 4 and len(lines(ax, "direction-1")) == 3
    words = caption_of(figure)
    assert "agent dead: UUV 2 at 1 s" in words and "tumbled: UUV 2 at" in words
    space: Any = figure_of(runs["faulty"], "track", "track-3d").axes[0]
    low, high = space.get_zlim()
    assert low > high  # depth grows downwards
    below = figure_of(runs["faulty"], "track", "track-3d")
    (told,) = re.findall(r"depth exaggerated (\d+) times|depth (to scale)", caption_of(below))
    factor = int(told[0] or 1)
    east, north = (np.ptp(limits) for limits in (space.get_xlim(), space.get_ylim()))
    drawn = space._box_aspect
    assert drawn[0] / east == pytest.approx(drawn[1] / north)
    assert drawn[2] / (low - high) == pytest.approx(factor * drawn[0] / east)


def test_track_shows_the_obstacles_of_the_scenario(made: Alone) -> None:
    obstacles = "keep_apart={distance: 1 m, obstacles: [{at: 20 -3 m, radius: 2 m}]}"
    (run,) = load([made("paper", "checks={}", "duration=500 ms", obstacles).directory])
    figure = figure_of(run, "track", "track")
    (drawn,) = (patch for patch in figure.axes[0].patches if patch.get_gid() == "obstacle")
    assert (drawn.center, drawn.radius) == ((-3.0, 20.0), 2.0)
    space = figure_of(run, "track", "track-3d")
    for one in (figure, space):
        assert "obstacle" in [text.get_text() for legend in one.legends for text in legend.get_texts()]
    assert [drawn.get_gid() for drawn in space.axes[0].collections] == ["obstacle"]
    (reference,) = lines(space.axes[0], "reference")
    axes: Any = space.axes[0]
    for values, limits in zip(
        reference.get_data_3d(), (axes.get_xlim(), axes.get_ylim(), axes.get_zlim()), strict=True
    ):
        assert min(limits) <= min(values) <= max(values) <= max(limits)


def test_every_fate_has_a_mark_of_its_own() -> None:
    assert set(exchange.FATES) == {Cause.DELIVERED, Cause.IN_FLIGHT, exchange.CORRUPTED, *LOSSES}
    assert len({mark for mark, _ in exchange.FATES.values()}) == len(exchange.FATES)
    assert len({colour for _, colour in exchange.FATES.values()}) == len(exchange.FATES)
    for fate in LOSSES:  # warm, where what arrives is blue
        red, _, blue = to_rgb(exchange.FATES[fate][1])
        assert red > blue or fate == Cause.REPLACED


def test_messages_in_space_and_time(runs: dict[str, LoggedRun]) -> None:
    (ax,) = figure_of(runs["faulty"], "messages", "messages", View(window=(0.8, 1.4))).axes
    assert ax.get_xlim() == (0.8, 1.4)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["UUV 1", "UUV 2", "UUV 3", "UUV 4"]
    drawn = {collection.get_gid(): collection for collection in ax.collections}
    for begin, end in drawn["fate-delivered"].get_segments():
        assert abs(end[1] - begin[1]) == 1.0  # neighbours on the path
        assert end[0] - begin[0] >= 0.03 - 1e-9  # the delay
    assert lines(ax, "absent-2") and not lines(ax, "absent-1")
    late = pictures(runs["faulty"], ["messages"], View(window=(90.0, 91.0)))["messages"]
    assert late == "no message was under way from 90 to 91 s"


@pytest.mark.parametrize("name", ["faulty", "acoustic", "twenty"])
def test_ages_are_those_of_the_result(name: str, runs: dict[str, LoggedRun], directories: dict[str, Path]) -> None:
    """An oracle: `netem.ages` counts them in closed form while the run goes on."""
    run = runs[name]
    result = json.loads((directories[name] / "result.json").read_text())["ages"]
    ticks = round(run.log.end / run.tick_s) + 1
    ticks = min(ticks, int(run.log.run["ticks"]))
    for link in run.log.links:
        ages = exchange.peak_ages(run, link, (np.arange(ticks + 1) - 0.5) * run.tick_s)
        told = result[f"{link[0]}->{link[1]}"]
        assert (ages.mean(), ages.max()) == pytest.approx((told["mean_s"], told["max_s"]))


@pytest.mark.parametrize("width", [1, 3, 7, 50])
def test_the_mean_age_of_an_interval_is_that_of_its_ticks(width: int, runs: dict[str, LoggedRun]) -> None:
    run = runs["faulty"]
    ticks = min(round(run.log.end / run.tick_s) + 1, int(run.log.run["ticks"])) // width * width
    edges = (np.arange(ticks + 1) - 0.5) * run.tick_s
    for link in run.log.links:
        each = exchange.peak_ages(run, link, edges)
        means = exchange.mean_ages(run, link, edges[::width])
        np.testing.assert_allclose(means, each.reshape(-1, width).mean(axis=1), atol=1e-9)


@pytest.mark.parametrize("window", [(0.5, 0.9), (0.3, 1.0), (1.0, 3.0)])
def test_no_interval_of_the_ages_is_shorter_than_a_tick(
    window: tuple[float, float], runs: dict[str, LoggedRun]
) -> None:
    """Such an interval held no tick, and was white: moored vehicles have ticks of 100 ms."""
    figure = figure_of(runs["moored"], "ages", "ages", View(window=window))
    mesh = figure.axes[1].collections[0].get_array()
    assert mesh.size and not np.ma.getmaskarray(mesh).any()


def test_each_of_as_many_intervals_as_ticks_holds_one(runs: dict[str, LoggedRun]) -> None:
    """An edge that lay above its tick by a rounding left an interval without one, which was white."""
    run = runs["moored"]
    last = round(run.log.end / run.tick_s)
    for first in range(last):
        for end in range(first + 1, last + 1):
            edges = np.linspace(first * run.tick_s, end * run.tick_s, end - first + 1)
            assert (np.diff(exchange._first_ticks(run, edges)[0]) == 1).all(), (first, end)


@pytest.mark.parametrize(
    ("limits", "most", "shown"),
    [
        ((0.1, 1.0), 4, "0.1 0.2 0.5 1"),
        ((0.1, 8.0), 4, "0.1 1"),
        ((0.1, 8.0), 6, "0.1 0.2 0.5 1 2 5"),
        ((0.3, 0.9), 4, "0.3 0.9"),
        ((0.03, 0.04), 4, "0.03 0.04"),
        ((1e-4, 1e4), 3, "0.0001 0.1 100"),
        ((0.2, 30.0), 2, "1 10"),
    ],
)
def test_a_short_axis_has_few_numbers(limits: tuple[float, float], most: int, shown: str) -> None:
    """The numbers beside a low bar of colours lay upon each other."""
    figure, (ax,) = panels(1, 1)
    ax.set_yscale("log")
    ax.set_ylim(*limits)
    plain_numbers(ax.yaxis, most)
    figure.canvas.draw()
    assert [t.label1.get_text() for t in ax.yaxis.get_major_ticks()] == shown.split()


def test_the_ages_say_what_is_drawn(runs: dict[str, LoggedRun]) -> None:
    figure = figure_of(runs["faulty"], "ages", "ages")
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["oldest link, peaks", "median link, means"]
    assert "peak and mean in bins of " in caption_of(figure)
    assert figure.axes[-1].get_ylabel() == "age [s], peaks"


def test_moored_vehicles_have_pictures_of_what_their_agents_do(runs: dict[str, LoggedRun]) -> None:
    drawn = pictures(runs["moored"], list(WHAT))
    assert list(drawn)[:3] == ["links", "messages", "ages"]
    assert all(name.startswith("control.") for name in list(drawn)[3:]) and "control.leads" in drawn
    assert next(iter(pictures([runs["moored"]], [kind for kind in WHAT if kind not in PER_RUN]))) == "ages"
    assert not isinstance(pictures(runs["moored"], ["track"])["track"], str)  # who asks for it gets it


def test_runs_that_are_compared_have_short_names_that_are_never_cut_off(directories: dict[str, Path]) -> None:
    faulty = directories["faulty"]
    same = load([faulty, faulty])
    assert [run.label for run in same] == [run_name(faulty / "run.mcap"), f"{run_name(faulty / 'run.mcap')} (2)"]
    (seed,) = (run.log.run["seed"] for run in same[:1])
    other = load([faulty])[0]
    other.log.run["seed"] = "77"
    assert labels_of([same[0].log, other.log]) == [f"faulty, seed {seed}", "faulty, seed 77"]
    shown = [LoggedRun(same[0].log, "a long name of a run-20261128-061251"), load([directories["one"]])[0]]
    (ax,) = figure_of(shown, "formation", "formation").axes
    names = [text.get_text() for text in ax.texts if text.get_gid() == "fault-name"]
    assert names and all(name.endswith("-061251)") and len(name) <= 34 for name in names)
    for ax, run in zip(figure_of(same, "ages", "ages").axes[1:3], same, strict=True):
        assert ax.get_title(loc="left") == run.label


def test_ledger_from_the_log_is_that_of_the_result(runs: dict[str, LoggedRun], directories: dict[str, Path]) -> None:
    result = read_result(directories["faulty"])
    ledger, ages = _from_log(runs["faulty"])
    assert ages == result.ages
    for link, account in ledger.items():  # the log says also of what was lost that it was damaged
        assert replace(account, corrupted=0) == replace(result.ledger[link], corrupted=0)


def test_what_can_be_asked_for_is_what_there_is() -> None:
    assert tuple(WHAT) == KINDS
    assert set(PARTS) == {name for pictures in WHAT.values() for name, _, _ in pictures} - set(WHAT)
    assert set(WHAT) >= PER_RUN


def test_a_single_picture_can_be_asked_for_and_none_is_drawn_twice(runs: dict[str, LoggedRun]) -> None:
    assert list(pictures(runs["one"], ["track-3d"])) == ["track-3d"]
    drawn = [name for name, _, _ in draw(["formation", "error", "error"], [runs["one"]], ALL)]
    assert drawn == ["formation", "error"]


# --- tables ----------------------------------------------------------------


def test_csv_reads_back_to_the_same_numbers(directories: dict[str, Path], tmp_path: Path) -> None:
    log = fleet.open_log(directories["faulty"])
    paths = export(log, tmp_path / "t", "csv")
    assert {path.name for path in paths} == {path.name for path in (tmp_path / "t").iterdir()}
    index = json.loads((tmp_path / "t" / "export.json").read_text())
    assert (index["run"]["scenario"], index["missing"]) == ("faulty", "")
    drawn = {"transforms", "scene"}
    assert index["left_out"].keys() == drawn
    assert {table["topic"] for table in index["tables"].values()} == {name for name in log if len(log[name])} - drawn
    for name, table in index["tables"].items():
        with (tmp_path / "t" / name).open(newline="") as file:
            heading, *rows = csv.reader(file)
        expected = columns(log[table["topic"]])
        assert heading == [column.heading for column in expected]
        assert len(rows) == table["rows"]
        for column, read in zip(expected, zip(*rows, strict=True), strict=True):
            if column.values.dtype == np.float64:
                assert np.array_equal(np.array(read, float), column.values, equal_nan=True)
            elif column.name == "payload":
                assert [bytes.fromhex(text) for text in read] == column.values.tolist()
            else:
                assert list(read) == [str(value) for value in column.values.tolist()]


def test_units_of_vectors_go_to_their_components(directories: dict[str, Path]) -> None:
    log = fleet.open_log(directories["faulty"])
    found = [column.heading for column in columns(log["uuv/1/command"])]
    assert found[:4] == ["t [s]", "tau_0 [N]", "tau_1 [N m]", "tau_2 [N m]"]
    assert [column.heading for column in columns(log["uuv/1/pose"])][1:4] == [
        "timestamp", "frame_id", "pose.position_0 [m]",
    ]  # fmt: skip


def test_export_replaces_nothing_unless_told(directories: dict[str, Path], tmp_path: Path) -> None:
    arguments = ["export", str(directories["one"]), "--csv", str(tmp_path), "--topics", "uuv/*/state"]
    first = invoke(*arguments)
    assert (first.exit_code, first.stderr) == (0, "")
    assert first.stdout.split() == [str(tmp_path / "uuv-1-state.csv"), str(tmp_path / "export.json")]
    (tmp_path / "uuv-1-state.csv").write_text("mine")
    again = invoke(*arguments)
    assert again.exit_code == 2
    assert "already holds uuv-1-state.csv" in again.stderr
    assert (tmp_path / "uuv-1-state.csv").read_text() == "mine"
    assert invoke(*arguments, "--force").exit_code == 0
    assert (tmp_path / "uuv-1-state.csv").read_text().startswith("t [s],x [m],")


def test_an_export_of_a_cut_log_says_so(directories: dict[str, Path], tmp_path: Path) -> None:
    cut = invoke("export", directories["cut"], "--csv", tmp_path, "--topics", "faults")
    assert cut.exit_code == 0
    assert "the file is cut" in cut.stderr


def test_parquet_reads_back(directories: dict[str, Path], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    log = fleet.open_log(directories["faulty"])
    export(log, tmp_path, "parquet")
    table = parquet.read_table(tmp_path / "uuv-1-command.parquet")
    assert table["tau_0"].to_pylist() == log["uuv/1/command"].tau[:, 0].tolist()
    assert table.schema.field("tau_1").metadata[b"unit"] == b"N m"
    link = parquet.read_table(tmp_path / "link-1-2.parquet")
    assert link["payload"].to_pylist() == log["link/1-2"].payload.tolist()
    assert link["fate"].to_pylist() == log["link/1-2"].fate.tolist()


# --- the command -----------------------------------------------------------


@pytest.mark.slow
def test_plot_command(directories: dict[str, Path], tmp_path: Path) -> None:
    what = ["--what", "error,links", "--format", "png,svg,pdf"]
    arguments = ["plot", str(directories["faulty"]), "-o", str(tmp_path), *what]
    result = invoke(*arguments)
    said = [line for line in result.stderr.splitlines() if not line.startswith(("reading", "drawing"))]
    assert (result.exit_code, said) == (0, [])
    assert result.stdout.split() == [
        str(tmp_path / f"{name}.{form}") for name in ("error", "formation", "links") for form in ("png", "svg", "pdf")
    ]
    assert (tmp_path / "error.pdf").read_bytes().startswith(b"%PDF")
    before = (tmp_path / "error.svg").read_bytes()
    invoke(*arguments)
    assert (tmp_path / "error.svg").read_bytes() == before


def test_plot_beside_the_log_and_of_a_cut_one(directories: dict[str, Path]) -> None:
    cut = invoke("plot", directories["cut"], "--what", "inputs", "--vehicles", "1,3-4")
    assert cut.exit_code == 0
    assert cut.stdout.strip() == str(directories["cut"] / "plots" / "inputs.png")
    assert "the file is cut" in cut.stderr
    none = invoke("plot", directories["one"], "--what", "links")
    assert (none.exit_code, none.stdout) == (1, "")
    assert "links: not drawn: the log has no links" in none.stderr


# --- the report ------------------------------------------------------------


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports with few pictures, which take most of the time."""
    monkeypatch.setattr("fleet.addons.pictures.report.WHAT", {"formation": ()})


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports that are words and tables."""
    monkeypatch.setattr("fleet.addons.pictures.report.WHAT", {})
    monkeypatch.setattr("fleet.addons.pictures.report.PER_RUN", set())


@pytest.mark.usefixtures("few")
def test_report_is_one_file_that_loads_nothing(directories: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    result = invoke("report", directories["faulty"], "-o", out)
    said = [line for line in result.stderr.splitlines() if not line.endswith(" %")]  # progress of a slow machine
    assert (result.exit_code, result.stdout, said) == (0, f"{out}\n", [])
    text = out.read_text("utf-8")
    found = Page(text)
    assert all(load.startswith("data:image/png;base64,") for load in found.loads)
    assert "http" not in re.sub(r'src="data:[^"]*"', "", text)
    assert "url(" not in text and "@import" not in text
    assert [tag for tag, _ in found.tags].count("img") == 1
    words = " ".join(found.words)
    values = json.loads((directories["faulty"] / "result.json").read_text())
    assert values["digest"] in words
    for word in ("crash", "partition halves", "lost: dead receiver", "fleet run again.yaml", "piqp", "name: faulty"):
        assert word in words
    assert "tumbled FAIL" in words


@pytest.mark.usefixtures("without_pictures")
def test_report_says_what_is_missing(directories: dict[str, Path], tmp_path: Path) -> None:
    words = " ".join(Page(page([*load([directories["cut"]])], View())).words)
    assert "There is no result.json beside this log" in words
    assert "The log is not whole" in words
    assert "from the log" in words
    other = tmp_path / "other"
    other.mkdir()
    (other / "run.mcap").write_bytes((directories["mixed"] / "run.mcap").read_bytes())
    (other / "result.json").write_bytes((directories["faulty"] / "result.json").read_bytes())
    assert "is of another log" in " ".join(Page(page(load([other]), View())).words)
    (other / "result.json").write_text("{")
    assert "result.json is damaged: not JSON" in " ".join(Page(page(load([other]), View())).words)


def test_a_report_that_finds_no_room_leaves_nothing(
    directories: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("fleet.addons.pictures.report.page", full)
    with pytest.raises(FleetError, match="No space left"):
        write_report(tmp_path / "r.html", load([directories["one"]]), View())
    assert list(tmp_path.iterdir()) == []


def test_tables_of_a_report() -> None:
    """Columns that hold nothing are left out, and what was replaced is not called lost."""
    table = links_table({"1->2": Account(sent=9, delivered=2, lost={"snr": 1, "replaced": 6})}, {})
    headings = ["link", "sent", "delivered", "replaced", "lost: snr", "mean age [s]", "95 % [s]", "max [s]"]
    assert list(table.headings) == headings
    assert [row[0] for row in table.rows] == ["all", "1->2"]


@pytest.mark.parametrize(
    ("low", "high", "shown"), [(0.15, 5.5, "0.2 0.5 1 2 5"), (0.02, 30.0, "0.1 1 10"), (1e-6, 9.0, None)]
)
def test_ticks_of_a_logarithmic_axis(low: float, high: float, shown: str | None) -> None:
    """Plain numbers over few decades, powers of ten over many."""
    figure, (ax,) = panels(1, 1)
    ax.set_yscale("log")
    ax.set_ylim(low, high)
    plain_decades(ax.yaxis)
    figure.canvas.draw()
    inside = [t.label1.get_text() for t in ax.yaxis.get_major_ticks() if low <= t.get_loc() <= high]
    assert " ".join(inside) == shown if shown else all("10^" in text for text in inside)


@pytest.mark.usefixtures("without_pictures")
def test_report_of_two_runs_with_verdicts_and_names_that_are_html(made: Alone) -> None:
    first = made("ideal", "duration=500 ms", "checks={formation_error: {below: 1 mm}}", 'title="<b>&</b>"')
    second = made("ideal", "checks={}", "duration=300 ms")
    both = load([first.directory, second.directory])
    text = page(both, View(log_scale=True))
    found = Page(text)
    assert "&lt;b&gt;&amp;&lt;/b&gt;" in text
    assert "FAIL" in found.words and "1 of 4 checks failed" in " ".join(found.words)
    assert "The runs together" in found.words
    names = [run_name(run.log.path) for run in both]
    for n, name in enumerate(names, start=1):
        assert f'<li><a href="#run-{n}">{name}</a>' in text and f'<h2 id="run-{n}">{name}</h2>' in text
    assert "largest final formation error [m]" in found.words
    assert [w for w in found.words if w in ("checks passed", "3 of 4", "never")][:2] == ["checks passed", "3 of 4"]
    assert len({run.label for run in both}) == 2


@pytest.mark.usefixtures("few")
def test_nothing_in_a_log_is_taken_for_markup(directories: dict[str, Path]) -> None:
    """A label, a cell, a path or a note with markup in it is shown as it is written."""
    (run,) = load([directories["one"]])
    (other,) = load([directories["one"]])
    run.label = '<img src="http://x">'
    run.notes.append("<script>1</script>")
    text = page([run, other], View())
    found = Page(text)  # refuses a script
    assert all(load.startswith(("data:image/png;base64,", "#")) for load in found.loads)
    assert run.label in found.words and "<script>" not in text
