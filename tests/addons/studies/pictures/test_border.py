"""Pictures of borders: what is drawn where, and what is too much."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from matplotlib.lines import Line2D
from small_scenario import small_file as small_file
from study_engine import Drawn

from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.look import COLUMN_IN
from fleet.addons.studies.borders import Borders, Theory, find_borders, parse_along, prepare_borders
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.pictures.border import PASSED, _stack_dots, draw_borders, write_borders
from fleet.addons.studies.pictures.gallery import plot
from fleet.addons.studies.plan import Plan
from fleet.addons.studies.spec import BoundarySpec
from fleet.addons.studies.values import parse_axis
from fleet.scenario.text.overrides import NET, SET, Override

DELAY, FEW, HOW = "delay=0 ms, 100 ms, 1 s", "delay=0 ms, 1 s", "neighbours.extrapolate=hold, neighbour"


pytestmark = pytest.mark.usefixtures("small_file")


def borders_of(per: Sequence[str], *, run: bool = True) -> Borders:
    """Borders at a loss of 50 %, and with a delay of 1 s below 0 %."""
    changes = (Override(NET, "* delay {delay} loss {loss}"), Override(SET, "duration=2 s"))
    axes = (*map(parse_axis, per), parse_along("loss=0 %..90 %/10 %", 0.1))
    if not any(text.startswith("delay") for text in per):
        changes = (Override(NET, "* loss {loss}"), changes[1])
    store, _ = prepare_borders(Plan("small.yaml", changes, axes, seeds=tuple(range(40))), BoundarySpec(), Path("study"))
    borders = Borders(store)
    if run:
        passes = Drawn(lambda text, _: "delay 1s" not in text and any(f"loss {k}%" in text for k in range(51)))
        find_borders(borders, passes, lambda *_, **__: None)
    return borders


def said(borders: Borders) -> list[Theory]:
    return [Theory((8.0, 10.0), number % 2 == 0, 30) for number in range(borders.count)]


def test_one_key_goes_to_the_right_and_runs_are_marked() -> None:
    borders = borders_of([DELAY])
    figure = draw_borders(borders, said(borders))
    (ax,) = figure.axes
    assert ax.get_xlabel() == "delay [ms]"
    assert ax.get_ylabel() == "loss [%]"
    assert [label.get_text() for label in ax.get_xticklabels()] == ["0", "100", "1000"]
    line = next(line for line in ax.lines if len(line.get_xdata()) == 3)
    heights = [float(y) for y in line.get_ydata()]
    assert heights[:2] == [pytest.approx(55.0, abs=5.0)] * 2
    assert heights[2] == 0.0
    dots = [line for line in ax.lines if line.get_marker() == "."]
    assert len(dots) == sum(border.runs for border in borders.estimates())
    # A reviewer wants no title and no bands, which no number stands for: the words are below.
    assert "a = 10" in caption_of(figure) and not ax.get_title() and not figure.get_suptitle() and not ax.patches


def test_further_keys_are_lines_columns_and_rows() -> None:
    borders = borders_of([FEW, "network.period=50 ms, 100 ms", HOW], run=False)
    figure = draw_borders(borders, said(borders))
    assert [ax.get_title().split("\n")[0] for ax in figure.axes] == ["period 50 ms", "period 100 ms"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()][:2] == ["extrapolate hold", "extrapolate neighbour"]


def test_words_alone_stand_below_each_other() -> None:
    borders = borders_of([HOW])
    figure = draw_borders(borders, said(borders))
    (ax,) = figure.axes
    assert [label.get_text() for label in ax.get_yticklabels()] == ["extrapolate hold", "extrapolate neighbour"]
    assert ax.get_xlabel() == "loss [%]"
    dots = [
        (line.get_xdata()[0], line.get_ydata()[0], line.get_color()) for line in ax.lines if line.get_marker() == "."
    ]
    assert len(set(dots)) == sum(border.runs for border in borders.estimates())  # none covers another one


def test_a_stack_of_many_runs_has_a_dot_for_each() -> None:
    stack = list(_stack_dots([(3, True)] * 40 + [(3, False)], 0.17, 0.07, 0.45))
    away = [y for _, y, colour in stack if colour == PASSED]
    assert len(set(away)) == 40 and min(away) == pytest.approx(-0.45) and max(away) == pytest.approx(-0.17)
    assert [y for _, y, colour in stack if colour != PASSED] == [0.17]


def test_the_legend_has_what_is_drawn_and_nothing_else() -> None:
    borders = borders_of([HOW])
    (legend,) = draw_borders(borders, [Theory(None, None, None)] * borders.count).legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "run that passed", "run that failed", "border and its interval, 95 %",
    ]  # fmt: skip


@pytest.mark.parametrize("per", [[DELAY], [HOW], [DELAY, HOW]])
def test_the_legend_shows_the_marks_that_are_drawn(per: list[str]) -> None:
    borders = borders_of(per)
    figure = draw_borders(borders, [Theory(None, None, None)] * borders.count)
    (legend,) = figure.legends
    named = {handle.get_marker() for handle in legend.legend_handles if isinstance(handle, Line2D)}
    drawn = {line.get_marker() for ax in figure.axes for line in ax.lines}
    assert drawn - {"None"} <= named
    assert named - drawn <= {"|"}  # of an interval whose colour says which
    single = [line for line in legend.legend_handles if line.get_label() == "border and its interval, 95 %"]
    assert len(per) == 2 or single[0].get_color() == "black"
    assert figure.get_figwidth() == COLUMN_IN


@pytest.mark.parametrize("per", [[DELAY], [HOW], [DELAY, HOW]])
def test_nothing_is_cut_off(per: list[str]) -> None:
    borders = borders_of(per)
    figure = draw_borders(borders, said(borders))
    figure.draw_without_rendering()
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert box.x0 >= 0.0 and box.y0 >= 0.0 and box.x1 <= width and box.y1 <= height


def test_the_dots_of_a_value_are_nearer_to_it_than_to_the_next_one() -> None:
    borders = borders_of([DELAY])
    (ax,) = draw_borders(borders, said(borders)).axes
    away = [abs(x - round(x)) for line in ax.lines if line.get_marker() == "." for x in line.get_xdata()]
    assert 0.0 < max(away) <= 0.45 and sorted(away)[len(away) // 2] < 0.15


def test_a_study_of_a_border_is_plotted_with_its_border() -> None:
    """In the look that is asked for; `fleet boundary` alone drew it."""
    found = plot({"s": borders_of([HOW]).store}, ["formation_final_m"], None, ["png"])
    (ax,) = found["border"].axes
    assert ax.get_xlabel() == "loss [%]" and next(iter(found)) == "border"


def test_a_border_has_the_formats_that_are_asked_for() -> None:
    borders = borders_of([HOW], run=False)
    files = write_borders(borders, said(borders), ("svg", "pdf"))
    assert [path.name for path in files] == ["border.svg", "border.pdf"] and all(path.is_file() for path in files)


def test_keys_and_names_are_text_and_never_formulas() -> None:
    borders = borders_of([HOW], run=False)
    borders.store.record.scenario = "a $\\frac$"
    borders.store.record.axes[0].key = borders.keys[0] = "d$\\frac$"
    for point in borders.points:
        point.values["d$\\frac$"] = point.values["neighbours.extrapolate"]
    borders.along.key = "e$\\frac$"
    draw_borders(borders, said(borders)).draw_without_rendering()


def test_too_much_for_a_picture_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.addons.studies.pictures.border.MOST_PANELS", 1)
    borders = borders_of([FEW, "network.period=50 ms, 100 ms", HOW], run=False)
    with pytest.raises(StudyError, match="these are 2 panels, and a picture has 1 at most"):
        draw_borders(borders, said(borders))
