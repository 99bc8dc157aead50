"""The model of a scene says what there is to draw, and every renderer can paint it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from repository import ROOT
from small_scenario import small

from fleet.addons.page.movie_scene import Camera, Canvas, sample
from fleet.recorder.scene.model import SceneModel, depth_text
from fleet.recorder.scene.primitives import (
    NED,
    REFERENCE,
    AreaShape,
    CircleShape,
    CrossShape,
    CylinderShape,
    FramePoint,
    LineShape,
    Primitive,
    points_of,
)
from fleet.recorder.scene.styles import FOXGLOVE, PAGE, PRINT
from fleet.scenario.loading import load_scenario

PAGE_MODULES = ROOT / "fleet/addons/page/page/modules"
EXAMPLES: dict[type[Primitive], Primitive] = {
    CylinderShape: CylinderShape("obstacle", 1.0, 2.0, 3.0),
    AreaShape: AreaShape("vehicle 1", (FramePoint(NED), FramePoint(NED, 1.0), FramePoint(REFERENCE, 0.0, 1.0))),
    CircleShape: CircleShape("vehicle 2", FramePoint(REFERENCE, 1.0), 2),
    CrossShape: CrossShape("reference", FramePoint(REFERENCE), "reference"),
    LineShape: LineShape("course", (FramePoint(NED), FramePoint(REFERENCE))),
}
OBSTACLES = ("profile=hardened", "keep_apart={distance: 1 m, obstacles: [{at: 12 -4 m, radius: 2 m}]}")


@pytest.mark.parametrize("kind", Primitive.__subclasses__())
def test_the_page_and_the_movie_paint_every_kind(kind: type[Primitive]) -> None:
    painters = re.findall(r"^  (\w+)\(g, ", (PAGE_MODULES / "primitives.js").read_text(), re.MULTILINE)
    assert kind.__name__.removesuffix("Shape").lower() in painters
    axes = Figure().add_axes((0.0, 0.0, 1.0, 1.0))
    camera = Camera(above=True)
    camera.follow(np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 5.0]]))
    canvas = Canvas(axes, camera, 1.0)
    canvas.paint(EXAMPLES[kind], {NED: np.zeros(3), REFERENCE: np.array([5.0, 5.0, 5.0])}, 8.0)
    assert axes.collections
    canvas.clear()
    assert not axes.collections


def test_a_line_to_a_vehicle_that_is_nowhere_is_left_out() -> None:
    axes = Figure().add_axes((0.0, 0.0, 1.0, 1.0))
    camera = Camera(above=True)
    camera.follow(np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 5.0]]))
    away = LineShape("vehicle 1", (FramePoint(NED), FramePoint("uuv-1")))
    Canvas(axes, camera, 1.0).paint(away, {NED: np.zeros(3)}, 8.0)
    assert not axes.collections


def test_every_sign_of_the_legend_has_a_sample_and_every_word_a_colour() -> None:
    scene = SceneModel(load_scenario("paper", OBSTACLES))
    rows = [*scene.legend(), SceneModel(load_scenario("dead-reckoning")).legend()[-1]]
    samples = (PAGE_MODULES / "legend.js").read_text()
    assert [row.name for row in rows][-4:] == ["desired place", "course", "obstacle", "believed place"]
    for row in rows:
        assert sample(row).get_label() == row.name
        assert f"  {row.sign}: (" in samples
    for theme in (PAGE, PRINT):
        for thing in (*scene.standing, *scene.moving(0.0)):
            assert theme.colour(thing.colour).startswith("#")
    assert PAGE.colours.keys() == PRINT.colours.keys() and PAGE.links.keys() == PRINT.links.keys()
    assert FOXGLOVE.colours.keys() <= PAGE.colours.keys() and FOXGLOVE.links.keys() <= PAGE.links.keys()


def test_what_moves_is_where_the_scenario_says() -> None:
    scene = SceneModel(small())
    moving = scene.moving(2.0)
    circles = [thing for thing in moving if isinstance(thing, CircleShape)]
    assert [circle.at[1:] for circle in circles] == scene.offsets(2.0)
    assert {point.frame for thing in moving for point in points_of(thing)} == {"reference", "uuv-1", "uuv-2", "uuv-3"}
    (course,) = scene.standing
    assert points_of(course)[0][1:] == scene.reference(0.0)
    assert points_of(course)[-1][1:] == scene.reference(scene.scenario.duration_ns / 1e9)


def test_colours_of_vehicles_repeat() -> None:
    for theme in (PAGE, PRINT, FOXGLOVE):
        count = len(theme.vehicles)
        assert theme.colour("vehicle 1") == theme.vehicle(1) == theme.vehicle(count + 1) != theme.vehicle(2)


@pytest.mark.parametrize(
    ("down", "text"), [(12.34, "12.3 m deep"), (0.0, "0.0 m deep"), (-3.2, "3.2 m above the surface")]
)
def test_a_place_above_the_water_is_said(down: float, text: str) -> None:
    assert depth_text(down) == text
