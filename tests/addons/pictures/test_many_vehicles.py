"""Pictures, tables and words of a run of many vehicles: few are named, and the others are together."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from in_process_runs import Alone
from matplotlib.collections import LineCollection

from fleet.addons.pictures import exchange, gallery, track
from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.report import MOST_ROWS, _tables
from fleet.addons.pictures.runs import LoggedRun, View, load
from fleet.logs.info import info_text, read_info

N = 60
LINKS = 2 * (N - 1)
BAD = "30->31"
WHOLE = View(None, None, None)


@pytest.fixture(scope="module")
def directory(made: Alone) -> Path:
    settings = [f"vehicles={N}", "tick=100 ms", "duration=2 s", "checks={}"]
    return made("paper", *settings, f"network.links={{'{BAD}': loss 90%}}").directory


@pytest.fixture(scope="module")
def run(directory: Path) -> LoggedRun:
    (found,) = load([directory])
    return found


@pytest.mark.parametrize("draw", [track.top, track.space])
def test_tracks_name_the_worst_and_draw_the_others_together(run: LoggedRun, draw: object) -> None:
    figure = draw([run], WHOLE)
    found = [str(gid) for artist in figure.findobj() if (gid := artist.get_gid())]
    assert sum(gid.startswith("vehicle-") for gid in found) == 3
    assert found.count("others") == 1
    (others,) = [artist for artist in figure.findobj(LineCollection) if artist.get_gid() == "others"]
    assert len(others._paths if draw is track.top else others._segments3d) == N - 3


def test_the_oldest_links_have_a_row(run: LoggedRun) -> None:
    figure = exchange.ages([run], WHOLE)
    names = [label.get_text() for label in figure.axes[1].get_yticklabels()]
    assert len(names) == 36
    assert names[0] == BAD.replace("->", "→")
    assert figure.axes[1].get_ylabel() == f"link\nthe 36 oldest of {LINKS}"


def test_links_without_a_loss_are_not_the_worst(run: LoggedRun) -> None:
    """At the end of a run something is in flight on every link."""
    figure = gallery.timeline([run], WHOLE)
    names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert names == [BAD.replace("->", "→"), f"{LINKS - 1} others"]


def test_a_report_has_rows_of_the_worst(run: LoggedRun) -> None:
    ((_, vehicles), (_, links)) = _tables(run, {})
    errors = [float(row[2]) for row in vehicles.rows[:-1]]
    assert len(errors) == MOST_ROWS
    assert errors == sorted(errors, reverse=True)
    assert vehicles.rows[-1] == (f"{N - MOST_ROWS} more, whose formation error is smaller",)
    assert links.rows[1][0] == BAD
    assert links.rows[-1] == (f"{LINKS - MOST_ROWS} more, whose age stayed lower",)


def test_info_folds_topics_that_differ_by_numbers(directory: Path) -> None:
    info = read_info(directory)
    text = info_text(info)
    assert len(text.splitlines()) < 30
    states = sum(count for topic, (_, count) in info.topics.items() if re.fullmatch(r"uuv/\d+/state", topic))
    assert re.search(rf"uuv/\*/state \({N} topics\) +{states}  uuv_fleet.State", text)
    assert re.search(rf"link/\*-\* \({LINKS} topics\)", text)


def test_messages_are_those_about_the_worst_link(run: LoggedRun) -> None:
    figure = exchange.spacetime([run], WHOLE)
    names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert len(names) == 20
    assert {"UUV 30", "UUV 31"} <= set(names)
    assert f"20 of {N} vehicles" in caption_of(figure)
