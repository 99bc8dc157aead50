"""The ellipse that holds a vehicle with 95 %, and that every renderer has it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone, log_of
from matplotlib.figure import Figure
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from fleet.addons.page.log_feed import LogFeed
from fleet.addons.pictures.beliefs import beliefs
from fleet.addons.pictures.report import believed_errors
from fleet.addons.pictures.runs import LoggedRun, View, load
from fleet.addons.pictures.time_series import formation
from fleet.addons.pictures.track import _believed_ways, _tracks, space, top
from fleet.logs.open_log import open_log
from fleet.recorder.scene.belief import NewestBeliefs, PlaceBelief, belief_primitives, ellipse
from fleet.recorder.scene.primitives import AreaShape, CrossShape, Primitive, plain
from fleet.scenario.loading import load_scenario

PLACE = (1.0, 2.0, 3.0)
SIZE = st.floats(0.01, 100.0)


@given(SIZE, SIZE, st.floats(-1.5, 1.5))
def test_its_axes_are_those_of_the_covariance(a: float, b: float, bearing: float) -> None:
    turn = np.array([[np.cos(bearing), -np.sin(bearing)], [np.sin(bearing), np.cos(bearing)]])
    p = turn @ np.diag([a * a, b * b]) @ turn.T
    found = ellipse(3, PLACE, [p[0, 0], p[0, 1], p[1, 1]])
    assert found is not None
    assert found.colour == "vehicle 3"
    around = np.array([(point.north - 1.0, point.east - 2.0) for point in found.points])
    assert np.einsum("ki,ij,kj->k", around, np.linalg.inv(p), around) == pytest.approx(5.991, rel=1e-6)
    lengths = np.linalg.norm(around, axis=1)
    assert (lengths.max(), lengths.min()) == pytest.approx((5.991**0.5 * max(a, b), 5.991**0.5 * min(a, b)), rel=1e-6)


@pytest.mark.parametrize("value", [nan, inf, -1.0, 1e300])
def test_what_is_no_covariance_is_no_ellipse(value: float) -> None:
    assert ellipse(1, PLACE, [value, 0, 1]) is None
    assert ellipse(1, PLACE, []) is None


@pytest.fixture(scope="module")
def log(alone: Alone) -> Path:
    """Of vehicles that navigate, but for the second."""
    return log_of(alone("dead-reckoning", "duration=2 s", "checks={}", "per_vehicle.2.navigation=ideal"))


@pytest.mark.parametrize("picture", [top, space])
def test_the_tracks_show_them(picture: Callable[[list[LoggedRun], View], Figure], log: Path) -> None:
    drawn = [str(artist.get_gid()) for artist in picture(load([log]), View()).axes[0].get_children()]
    assert drawn.count("ellipse-1") == drawn.count("ellipse-4") == 5
    assert "belief-3" in drawn
    assert not [gid for gid in drawn if gid in ("ellipse-2", "belief-2")]


def test_the_picture_of_the_formation_shows_truth_and_belief(log: Path) -> None:
    true, believed = formation(load([log]), View()).axes
    assert len(true.get_lines()) == 4
    assert len(believed.get_lines()) == 3


def areas(things: list[Primitive]) -> dict[str, AreaShape]:
    return {thing.colour: thing for thing in things if isinstance(thing, AreaShape)}


def test_page_and_movie_show_the_newest(log: Path) -> None:
    feed = LogFeed(log)
    belief = open_log(log)["uuv/3/belief"]
    for at_s in (1.0, 0.5):
        feed.seek(at_s)
        shown = areas(feed.picture.moving())
        assert [*shown] == ["vehicle 1", "vehicle 3", "vehicle 4"]
        k = int(np.searchsorted(belief.t, at_s))
        wanted = ellipse(3, belief.off[k].tolist(), belief.covariance[k][[0, 1, 4]].tolist(), "uuv-3")
        assert shown["vehicle 3"] == wanted
        assert plain([shown["vehicle 3"]])[0] in feed.picture.frame()["moving"]


def test_the_belief_of_a_vehicle_that_nobody_asks_is_not_shown_for_long(log: Path) -> None:
    feed = LogFeed(log)
    feed.seek(1.0)
    feed.picture.at_s = 2.5
    assert not areas(feed.picture.moving())


def test_a_belief_that_is_no_number_is_not_drawn() -> None:
    assert belief_primitives(1, PlaceBelief((nan, 0.0, 0.0), (1.0, 0.0, 1.0))) == []
    (cross,) = belief_primitives(1, PlaceBelief.by_navigator((1.0, 0.0, 0.0), (nan,) * 10))  # that of a replayed error
    assert isinstance(cross, CrossShape)


def test_foxglove_shows_it(log: Path) -> None:
    """Every message has an entity for each vehicle that navigates; at the end nobody asks, and it is empty."""
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        scenes = [scene for _, _, _, scene in reader.iter_decoded_messages(["scene"])]
    found = [{one.id: one for one in scene.entities if one.id.startswith("belief")} for scene in scenes]
    assert {tuple(each) for each in found} == {("belief 1", "belief 3", "belief 4")}
    assert [len(each["belief 3"].lines) for each in found] == [2] * (len(found) - 1) + [0]
    points = found[0]["belief 3"].lines[0].points
    state, belief = (open_log(log)[f"uuv/3/{group}"] for group in ("state", "belief"))
    middle = np.mean([(p.y, p.x, -p.z) for p in points], axis=0)  # the reference begins in 0 0 20
    assert middle == pytest.approx([state.x[0], state.y[0], state.z[0] - 20.0] + belief.off[0], abs=1e-9)


@pytest.fixture(scope="module")
def ranged(alone: Alone) -> Path:
    """Of vehicles that measure ranges to the first one, which has fixes; `belief` has half the rate of `located`."""
    few = ("duration=20 s", "checks={}", "formation.changes=[]", "log.belief=10 ticks")
    return log_of(alone("navigation-aid", *few))


def by_ranges(log: Path, i: int, at_s: float) -> tuple[PlaceBelief, int]:
    """What vehicle i believes by its ranges, as the log has it, and which sample of `located` that is."""
    known = open_log(log)
    located, belief = known[f"uuv/{i}/located"], known[f"uuv/{i}/belief"]
    k, deep = (int(np.searchsorted(topic.t, at_s + 1e-6)) - 1 for topic in (located, belief))
    north, east = located.off[k].tolist()
    assert abs(north - belief.off[deep, 0]) > 0.1, "the ranges have changed nothing, so this would prove nothing"
    return PlaceBelief((north, east, float(belief.off[deep, 2])), located.covariance[k].tolist()), k


def test_page_and_movie_show_what_a_vehicle_believes_by_its_ranges(ranged: Path) -> None:
    feed = LogFeed(ranged)
    for at_s in (19.9, 18.3):
        feed.seek(at_s)
        things = feed.picture.moving()
        wanted = belief_primitives(3, by_ranges(ranged, 3, at_s)[0])
        assert len(wanted) == 2
        assert [one for one in things if one in wanted] == wanted


@pytest.mark.parametrize("picture", [top, space])
def test_the_tracks_show_what_a_vehicle_believes_by_its_ranges(
    picture: Callable[[list[LoggedRun], View], Figure], ranged: Path
) -> None:
    runs = load([ranged])
    ways = {way.vehicle: way for way in _believed_ways(_tracks(runs, View())[0], View())}
    located, state = (open_log(ranged)[f"uuv/3/{group}"] for group in ("located", "state"))
    assert len(ways[3].positions) == len(located)
    true = np.column_stack([state.x, state.y])[np.isin(state.t, located.t)]
    assert ways[3].positions[:, :2] == pytest.approx(true + located.off)
    last = ellipse(3, ways[3].positions[-1].tolist(), located.covariance[-1].tolist())
    assert ways[3].ellipses[-1] == last
    assert "belief-3" in [str(artist.get_gid()) for artist in picture(runs, View()).axes[0].get_children()]


def test_the_formation_error_as_believed_uses_the_ranges(ranged: Path) -> None:
    log = open_log(ranged)
    at = log["uuv/3/located"].t
    (error, located, belief) = (log[f"uuv/3/{group}"] for group in ("error", "located", "belief"))
    off = np.column_stack([located.off, np.interp(at, belief.t, belief.off[:, 2])])
    wanted = np.linalg.norm(error.formation[np.isin(error.t, at)] + off, axis=1)
    found = beliefs(log, 3)
    assert found is not None
    # The true error is between two samples of `belief` in half of the cases.
    assert found.formation_norm[::2][:-1] == pytest.approx(wanted[::2][:-1], abs=1e-9)
    assert believed_errors(load([ranged])[0], ["3"])["3"] == pytest.approx(found.formation_norm[-1])
    lines = formation(load([ranged]), View()).axes[1].get_lines()
    assert lines[2].get_ydata()[-1] == pytest.approx(found.formation_norm[-1])


def test_foxglove_shows_what_a_vehicle_believes_by_its_ranges(ranged: Path) -> None:
    with ranged.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        scenes = {message.log_time / 1e9: scene for _, _, message, scene in reader.iter_decoded_messages(["scene"])}
    at_s = max(t for t in scenes if t < 19.95)
    entity = next(one for one in scenes[at_s].entities if one.id == "belief 3")
    belief, k = by_ranges(ranged, 3, at_s)
    log = open_log(ranged)
    located, state = log["uuv/3/located"], log["uuv/3/state"]
    assert located.t[k] == pytest.approx(at_s)
    n = int(np.searchsorted(state.t, at_s - 1e-6))
    reference = log.scenario.reference.at(at_s).position
    middle = np.mean([(p.y, p.x) for p in entity.lines[0].points], axis=0) + reference[:2]
    assert middle == pytest.approx([state.x[n] + belief.off[0], state.y[n] + belief.off[1]], abs=1e-9)


def test_ranges_without_a_navigator_are_not_drawn_and_old_ones_are_forgotten() -> None:
    newest = NewestBeliefs(load_scenario("navigation-aid"))
    newest.take(2, "located", 1.0, (5.0, 6.0), (1.0, 0.0, 1.0))
    assert newest.at(1.0) == {}
    newest.take(2, "belief", 1.0, (1.0, 2.0, 3.0), (4.0,) * 10)
    assert newest.at(1.0) == {2: PlaceBelief((5.0, 6.0, 3.0), (1.0, 0.0, 1.0))}
    newest.take(2, "belief", 2.5, (1.0, 2.0, 3.0), (4.0,) * 10)
    assert newest.at(2.5) == {2: PlaceBelief((1.0, 2.0, 3.0), (4.0, 4.0, 4.0))}
    newest.clear()
    assert newest.at(2.5) == {}


def test_in_three_dimensions_no_label_is_cut(alone: Alone) -> None:
    """The layout of a figure leaves no room for them: that of the depth was outside by some pixels."""
    short = ("checks={}", "duration=30 s", "tick=100 ms", "log.every=20 ticks")
    figure = space(load([log_of(alone("formation-on-belief", *short))]), View())
    figure.draw_without_rendering()
    ax: Any = figure.axes[0]
    labels = [axis.label.get_window_extent() for axis in (ax.xaxis, ax.yaxis, ax.zaxis)]
    assert all(box.x0 > 0.0 and box.x1 < figure.bbox.width for box in labels)
    depths = [text.get_window_extent() for text in ax.get_zticklabels() if text.get_text()]
    assert depths and not any(box.overlaps(labels[2]) for box in depths)
