"""A log becomes a movie: its pictures, their number and size, and what is left when it fails."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from shutil import which
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone, log_of
from marks import slow
from PIL import Image, ImageChops
from refusals import check_refusals
from small_scenario import small

from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.movie import write
from fleet.addons.page.movie_scene import SCENE_PT, Camera, MovieScene
from fleet.addons.page.view_state import ViewState
from fleet.errors import FleetError
from fleet.logs.fault_intervals import FaultMessage
from fleet.recorder.scene.link_state import LinkState
from fleet.recorder.scene.styles import PRINT
from fleet.scenario.loading import load_scenario
from fleet.scenario.sections.fault_entry import vehicle_entry

CUT = PRINT.links[LinkState.CUT].colour
SHORT = ("duration=1 s", "faults=[{at: 400 ms, for: 400 ms, id: cut, partition: halves}]", "checks={tumbled: waived}")


@pytest.fixture
def log(alone: Alone) -> Path:
    return log_of(alone("paper", *SHORT))


def made(log: Path, out: Path, **options: Any) -> list[float]:
    """The shares that were told."""
    told: list[float] = []
    write(log, out, told.append, **({"fps": 2, "width": 320} | options))
    return told


@pytest.mark.parametrize("view", ["3d", *slow("above")])
def test_a_gif_has_its_pictures_and_the_same_bytes_again(log: Path, tmp_path: Path, view: str) -> None:
    out = tmp_path / "a.gif"
    assert made(log, out, view=view) == pytest.approx([1 / 3, 2 / 3, 1.0])
    made(log, tmp_path / "b.gif", view=view)
    assert out.read_bytes() == (tmp_path / "b.gif").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "b.gif"]
    with Image.open(out) as movie:
        assert (movie.size, movie.n_frames, movie.info["duration"]) == ((320, 240), 3, 500)
        pictures = []
        for k in range(3):
            movie.seek(k)
            pictures.append(movie.convert("RGB"))
    assert all(ImageChops.difference(a, b).getbbox() for a, b in pairwise(pictures))


def drawn_at(log: Path, at_s: float, *, above: bool = True) -> MovieScene:
    feed = LogFeed(log)
    scene = MovieScene(feed.picture, 0.0, 1.0, 1.0, above=above)
    feed.forward(at_s)
    scene.draw(feed.picture.frame(), at_s)
    return scene


def texts(scene: MovieScene) -> list[str]:
    return [text.get_text() for text in scene.figure.findobj(matplotlib.text.Text)]


def colours(scene: MovieScene) -> set[str]:
    """Of the lines on the scene."""
    lines = scene.figure.findobj(matplotlib.collections.LineCollection)
    return {matplotlib.colors.to_hex(colour).upper() for some in lines for colour in some.get_colors()}


def test_a_picture_names_the_time_and_the_faults_and_draws_links_by_their_state(log: Path) -> None:
    before, cut = drawn_at(log, 0.3), drawn_at(log, 0.6)
    assert {"t = 0.6 s", "partition halves, 0.2 s left", "paper"} <= set(texts(cut)), texts(cut)
    assert "t = 0.3 s" in texts(before) and not [text for text in texts(before) if "left" in text]
    assert CUT in colours(cut) and CUT not in colours(before)
    assert PRINT.links[LinkState.DELIVERING].colour in colours(before)


def test_vehicles_with_roll_are_drawn(alone: Alone) -> None:
    scene = drawn_at(log_of(alone("remus", "duration=500 ms", "checks={}")), 0.4)
    assert {"1", "2", "3", "4"} <= set(texts(scene))


@pytest.mark.parametrize("above", [True, False])
def test_obstacles_are_drawn_where_they_are(above: bool, alone: Alone) -> None:
    cylinder = "keep_apart={distance: 1 m, obstacles: [{at: 12 -4 m, radius: 2 m}]}"
    log = log_of(alone("paper", "duration=500 ms", "checks={}", "profile=hardened", cylinder))
    scene, plain = drawn_at(log, 0.4, above=above), drawn_at(log_of(alone("paper", *SHORT)), 0.4, above=above)
    assert "obstacle" in texts(scene) and "obstacle" not in texts(plain)
    assert not rings(plain)
    low, high = rings(scene)  # on the floor, and above
    centres = scene._camera.project([(12.0, -4.0, down) for down in (0.0, 20.0)])
    if above:
        radius = 2.0 * scene._camera.scale
        assert np.hypot(*(low - centres[0, :2]).T) == pytest.approx(np.full(len(low), radius))
        assert low == pytest.approx(high)
    else:
        assert low[:, 1].max() < high[:, 1].min()
        assert [ring[:, 0].mean() for ring in (low, high)] == pytest.approx(centres[:, 0], abs=1.0)


def rings(scene: MovieScene) -> list[Any]:
    """The points of the circles of obstacles."""
    found = scene.figure.findobj(matplotlib.collections.PolyCollection)
    paths = [path.vertices for some in found for path in some.get_paths()]
    return [points for points in paths if len(points) == 38]


def test_errors_are_those_of_the_frame(log: Path) -> None:
    feed = LogFeed(log)
    scene = MovieScene(feed.picture, 0.0, 1.0, 1.0, above=True)
    found = []
    for at_s in (0.5, 1.0):
        feed.forward(at_s)
        frame = feed.picture.frame()
        scene.draw(frame, at_s)
        found.append(frame["errors"][2])
    line = scene.figure.axes[1].lines[2]
    assert list(line.get_xdata()) == [0.5, 1.0] and list(line.get_ydata()) == found


def test_a_fleet_that_is_nowhere_leaves_the_scene_empty() -> None:
    picture = ViewState(small())
    scene = MovieScene(picture, 0.0, 1.0, 1.0, above=False)
    scene.draw(picture.frame(), 0.0)
    scene.figure.canvas.draw()
    assert "t = 0.0 s" in texts(scene)


@pytest.mark.parametrize(("scenario", "rings"), [("acoustic-s2c", 1), ("paper", 0)])
def test_sound_spreads_from_who_sends(scenario: str, rings: int) -> None:
    """One ring, however many hear it; none of a packet that its sender could not send."""
    picture = ViewState(load_scenario(scenario))
    scene = MovieScene(picture, 0.0, 10.0, 1.0, above=True)
    links = picture.setup()["links"]
    heard = [[k, 1.0, 0.5, "arrived"] for k, (src, _) in enumerate(links) if src == 2]
    cut = [[k, 1.0, 0.5, "cut"] for k, (src, _) in enumerate(links) if src == 3]
    rows = [[i, 10.0 * i, 0.0, 5.0, 0.0, 0.0, 0.5] for i in range(1, 5)]
    scene.draw(picture.frame() | {"uuv": rows, "packets": heard + cut}, 1.6)
    assert len(circles(scene)) == rings
    scene.draw(picture.frame() | {"uuv": rows, "packets": []}, 3.0)
    assert not circles(scene)


def circles(scene: MovieScene) -> list[Any]:
    lines = scene.figure.findobj(matplotlib.collections.LineCollection)
    return [path for some in lines for path in some.get_segments() if len(path) == 37]


def test_a_long_fault_is_cut_short() -> None:
    picture = ViewState(small())
    groups = ",".join(map(str, range(100)))
    lasts = {"from_s": 0.0, "to_s": 1.0, "until_healed": False}
    picture.faults([{"id": "f1", "what": f"partition {groups} / 100", "entry": "", **lasts}])
    scene = MovieScene(picture, 0.0, 1.0, 1.0, above=True)
    scene.draw(picture.frame(), 0.0)
    (said,) = [text for text in texts(scene) if text.startswith("partition 0,1,2,3,")]
    assert len(said) == 70 and said.endswith(" ...")


def test_a_part_of_a_log_at_a_rate(log: Path, tmp_path: Path) -> None:
    assert len(made(log, tmp_path / "a.gif", window=(0.5, None), speed=0.5)) == 3
    assert len(made(log, tmp_path / "b.gif", window=(0.5, 0.75), speed=0.5)) == 2


def test_what_cannot_be_drawn_is_said(log: Path, tmp_path: Path) -> None:
    cases = [
        ("a.webm", {}),
        ("a", {}),
        ("a.gif", {"window": (0.5, 2.0)}),
        ("a.gif", {"window": (1.0, None)}),
        ("a.gif", {"speed": 0.001, "fps": 50}),
        ("none/a.gif", {}),
    ]
    check_refusals(
        "view/movies", lambda out, options: made(log, tmp_path / out, **options), cases, hide={str(tmp_path): "HERE"}
    )
    assert not list(tmp_path.iterdir())


def test_a_log_without_places_is_refused(alone: Alone, tmp_path: Path) -> None:
    log = log_of(alone("paper", *SHORT, "log.transforms=0 ticks"))
    with pytest.raises(FleetError, match="does not tell where the vehicles are"):
        made(log, tmp_path / "a.gif")


@pytest.mark.parametrize("form", ["gif", "mp4"])
def test_ctrl_c_leaves_what_was_there(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    fake_ffmpeg(tmp_path / "bin", "cat > /dev/null", monkeypatch)
    out = tmp_path / f"a.{form}"
    out.write_text("old")

    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(log, out, interrupt, fps=4, width=320)
    assert out.read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"a.{form}", "bin"]


def fake_ffmpeg(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program in its place, which is told what to do."""
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", str(program))


def test_ffmpeg_gets_every_picture(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_ffmpeg(tmp_path / "bin", 'for last; do :; done; wc -c > "$last"', monkeypatch)
    made(log, tmp_path / "a.mp4")
    assert int((tmp_path / "a.mp4").read_text()) == 3 * 320 * 240 * 4  # RGBA


@pytest.mark.parametrize("script", ["cat > /dev/null", "exec 0<&-"])
def test_what_ffmpeg_complains_of_is_said(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str
) -> None:
    fake_ffmpeg(tmp_path / "bin", f"{script}; echo Unknown encoder h264 >&2; exit 1", monkeypatch)
    with pytest.raises(FleetError, match=r"could not write .*a\.mp4: Unknown encoder h264"):
        made(log, tmp_path / "a.mp4")
    assert not (tmp_path / "a.mp4").exists()


def test_without_ffmpeg_it_is_said_what_to_install(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", str(tmp_path / "ffmpeg"))
    with pytest.raises(FleetError, match=r"apt install ffmpeg, or write a \.gif"):
        made(log, tmp_path / "a.mp4")


@pytest.mark.skipif(which("ffmpeg") is None, reason="there is no ffmpeg")
def test_ffmpeg_makes_an_mp4(log: Path, tmp_path: Path) -> None:
    made(log, tmp_path / "a.mp4")
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"


def test_signals_that_checks_name_are_drawn_for_all_vehicles_whole_numbers_as_steps() -> None:
    picture = ViewState(small())
    names = {i: f"uuv/{i}/control.holds" for i in (1, 2, 3)}
    scene = MovieScene(picture, 0.0, 1.0, 1.0, above=True, charted={"control.holds": ("1", names)},
                       verdict={"passed": False, "text": "1 of 2 checks failed"})  # fmt: skip
    picture.event(0.1, FaultMessage("tumbled-2", "begins", "tumbled 2", vehicle_entry("tumbled", 2)))
    scene.draw(picture.frame() | {"signals": {names[2]: [(0.0, 0.0), (0.4, 2.0)]}}, 0.5)
    line = scene.figure.axes[2].lines[1]
    assert list(line.get_ydata()) == [0.0, 2.0] and line.get_drawstyle() == "steps-post"
    assert "control.holds" in texts(scene) and "1 of 2 checks failed" not in texts(scene)  # nobody knows it yet
    scene.draw(picture.frame() | {"t": 0.9, "signals": {names[2]: [(0.6, 0.5)]}}, 0.6)
    assert "1 of 2 checks failed" in texts(scene)
    assert line.get_drawstyle() == "default"


def test_what_happened_is_counted_up_to_the_time_of_the_picture() -> None:
    picture = ViewState(small())
    for k, at_s in enumerate((0.1, 0.2, 0.8)):
        picture.event(at_s, FaultMessage(f"tumbled-2-{k}", "begins", "tumbled 2", vehicle_entry("tumbled", 2)))
    scene = MovieScene(picture, 0.0, 1.0, 1.0, above=True)
    for at_s, line in ((0.1, "tumbled 2: at 0.1 s"), (0.5, "tumbled 2: 2 times, first at 0.1 s")):
        scene.draw(picture.frame() | {"t": at_s}, at_s)
        assert line in [text.get_text() for text in scene.figure.texts]


def test_a_fleet_in_a_column_stays_below_the_texts_and_above_the_legend() -> None:
    camera = Camera(above=True)
    column = np.array([[0.0, 0.0, 5.0], [40.0, 0.0, 5.0]])
    camera.follow(column)
    scene = MovieScene(ViewState(small()), 0.0, 1.0, 1.0, above=True)
    lowest_text = min(text.get_position()[1] for text in scene.figure.texts)
    scene_y0, scene_height = scene.figure.axes[0].get_position().y0, scene.figure.axes[0].get_position().height
    low, high = sorted(scene_y0 + y / SCENE_PT[1] * scene_height for y in camera.project(column)[:, 1])
    assert scene_y0 + 12 / SCENE_PT[1] * scene_height < low and high < lowest_text


@given(
    st.tuples(st.floats(60.0, SCENE_PT[0] - 60.0), st.floats(40.0, SCENE_PT[1] - 40.0)),
    st.floats(-np.pi, np.pi),
    st.floats(10.0, 45.0),
)
def test_a_label_hides_no_link_if_a_corner_is_free(at: tuple[float, float], turn: float, wide: float) -> None:
    """Of five vehicles in a row the labels hid all links."""
    scene: Any = SimpleNamespace(_corners={})
    away = np.linspace(13.0, 100.0, 60)[:, None] * (np.cos(turn), np.sin(turn))
    links = np.concatenate([np.array(at) + away, np.array(at) - away])  # through the vehicle, as in a row
    x, y = MovieScene._corner(scene, 1, np.array(at), wide, links)
    inside = (links[:, 0] > x) & (links[:, 0] < x + wide) & (links[:, 1] > y - 9.0) & (links[:, 1] < y + 8.0)
    assert not inside.any()
    assert 0.0 <= x <= SCENE_PT[0] - wide and 0.0 <= y <= SCENE_PT[1]
    assert (MovieScene._corner(scene, 1, np.array(at), wide, links) == (x, y)).all()  # it stays
    near = np.array([SCENE_PT[0] - 5.0, SCENE_PT[1] - 5.0])
    x, y = MovieScene._corner(scene, 2, near, wide, np.empty((0, 2)))
    assert x + wide <= SCENE_PT[0] and y <= SCENE_PT[1]
