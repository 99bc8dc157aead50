"""Faults over a time axis: their shade does not add up, their words do not cover one another."""

from __future__ import annotations

from itertools import combinations

import pytest
from matplotlib.text import Text

from fleet.addons.pictures.look import COLUMN_IN
from fleet.addons.pictures.shades import shade, union, words
from fleet.addons.pictures.style import panels
from fleet.scenario.sections.timeline import FaultInterval
from tests.support.intervals import interval


def drawn(faults: list[FaultInterval]) -> tuple[list[Text], list[str], list[tuple[float, float]]]:
    """The words above the axis, the lines that explain numbers, and the shades."""
    figure, (ax,) = panels(1, 1, COLUMN_IN)
    ax.set_xlim(0.0, 100.0)
    listed = shade([ax], faults)
    figure.draw_without_rendering()
    shades = [patch.get_extents().transformed(ax.transData.inverted()) for patch in ax.patches]
    texts = [text for text in ax.texts if text.get_gid() == "fault-name"]
    for a, b in combinations(texts, 2):
        assert not a.get_window_extent().overlaps(b.get_window_extent()), (a, b)
    return texts, listed, [(round(box.x0, 6), round(box.x1, 6)) for box in shades]


def test_shades_of_faults_that_overlap_do_not_add_up() -> None:
    """Each time is shaded once."""
    faults = [
        interval("f1", 10.0, 30.0, "kill 3"),
        interval("f2", 20.0, 40.0, "down 1<->2"),
        interval("tumbled-3", 25.0, 26.0, "tumbled 3"),
        interval("f3", 60.0, 70.0, "kill 1"),
    ]
    texts, listed, shades = drawn(faults)
    assert shades == [(10.0, 40.0), (60.0, 70.0), (25.0, 26.0)]
    assert [text.get_text() for text in texts] == ["kill 3", "down 1<->2", "kill 1"]
    assert listed == ["tumbled 3: at 25 s"]


def test_union() -> None:
    assert union([(3.0, 4.0), (0.0, 2.0), (1.0, 2.5), (2.5, 2.6)]) == [(0.0, 2.6), (3.0, 4.0)]
    assert union([]) == []


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (interval("f1", 0.0, 1.0, "kill 3"), "kill 3"),
        (interval("nemesis-2", 0.0, 1.0, "partition halves"), "partition halves"),
        (interval("split", 0.0, 1.0, "partition halves"), "split: partition halves"),
        (interval("f1", 0.0, 1.0, "link *: " + "delay 300ms " * 9), "link *: delay 300ms delay 300ms d…"),
    ],
)
def test_words_of_a_fault(fault: FaultInterval, expected: str) -> None:
    """What it does, and its id if somebody chose that."""
    assert words(fault) == expected


def test_many_faults_are_numbered() -> None:
    what = "link {}<->9: delay 300ms loss 60%"
    many = [interval(f"f{n}", 5.0 * n, 5.0 * n + 4.0, what.format(n)) for n in range(14)]
    texts, listed, _ = drawn(many)
    assert [text.get_text() for text in texts] == [str(n) for n in range(1, 15)]
    assert listed[0].startswith("1 link 0<->9: delay 300ms loss 60%")
    assert listed[-1].endswith("and 2 more")
    texts, listed, _ = drawn([interval(f"f{n}", 0.1 * n, 50.0, "kill 1") for n in range(200)])
    assert (texts, listed) == ([], ["200 faults, too many to name"])


def test_tumbles_are_told_below_in_one_line_per_vehicle() -> None:
    """And not above, where faults are named: thirty of them cover none."""
    tumbles = [
        interval(f"tumbled-{i}-{n}", 10.0 + 3.0 * n + i, 11.0 + 3.0 * n + i, f"tumbled {i}")
        for i in range(1, 8)
        for n in range(5)
    ]
    texts, listed, shades = drawn([interval("f1", 10.0, 20.0, "kill 3"), *tumbles])
    assert [text.get_text() for text in texts] == ["kill 3"]
    assert listed == [f"tumbled {i}: 5 times, first at {10 + i} s" for i in range(1, 6)] + ["and 2 more vehicles"]
    assert len(shades) > 1
