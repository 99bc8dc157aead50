"""Which pictures a study gets, how large they are, and that nothing of it is cut off or silently left out."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_study import CONTROLLER, DELAY, EXTRAPOLATE, LOSS, made_up, usual, with_holes
from marks import slow
from matplotlib.figure import Figure

from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.look import COLUMN_IN, PAGE_IN
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.pictures.gallery import draw, plot, write
from fleet.addons.studies.pictures.marks import REASONS
from fleet.addons.studies.pictures.points import MADE, Points, VariedKey, joined, load
from fleet.addons.studies.signal_measures import more_is_better
from fleet.addons.studies.store import Store
from fleet.errors import FleetError

pytestmark = pytest.mark.usefixtures("coarse")

SAMPLE = ("network.links.*.loss=0 %..60 % latin 6", "network.links.*.delay=50 ms..1 s latin 6")
STUDIES: dict[str, tuple[str, ...]] = {
    "heat": (LOSS, DELAY),
    "heats": (LOSS, DELAY, CONTROLLER, EXTRAPOLATE),
    "curve": (LOSS, CONTROLLER),
    "curves": (LOSS, CONTROLLER, EXTRAPOLATE),
    "boxes": (CONTROLLER, EXTRAPOLATE),
    "one": (),
    "sample": (*SAMPLE, CONTROLLER),
}


Made = Callable[[str, Callable[..., Any]], dict[str, Figure]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The pictures of a kind of study, which are drawn once."""
    known: dict[tuple[str, Any], dict[str, Figure]] = {}

    def make(kind: str, row: Callable[..., Any]) -> dict[str, Figure]:
        if (kind, row) not in known:
            store = made_up(tmp_path_factory.mktemp(kind) / "s", *STUDIES[kind], row=row)
            known[kind, row] = figures(store, "formation_final_m")
        return known[kind, row]

    return make


def drawn(store: Store, *measures: str, log_scale: bool | None = None) -> dict[str, Figure | str]:
    return {name: figure for name, _, figure in draw(load(store, measures), log_scale)}


def figures(store: Store, *measures: str) -> dict[str, Figure]:
    return {name: figure for name, figure in drawn(store, *measures).items() if isinstance(figure, Figure)}


def artists(figure: Figure, gid: str) -> list[Any]:
    return figure.findobj(lambda artist: artist.get_gid() == gid)


def words(figure: Figure) -> list[str]:
    return [text.get_text() for text in artists(figure, "cell")]


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("row", [usual, *slow(with_holes)])
@pytest.mark.parametrize("kind", STUDIES)
def test_no_text_is_cut_off_and_every_picture_fits_a_column_or_a_page(
    kind: str, row: Callable[..., Any], made: Made
) -> None:
    """At 300 dpi a column is 1050 pixels."""
    found = made(kind, row)
    names = set() if kind == "sample" else {"passed", "formation_final_m"}
    if CONTROLLER in STUDIES[kind]:
        names.add("compare-controller-formation_final_m")
    assert set(found) == names
    for name, figure in found.items():
        width = figure.get_figwidth()
        panels = len([ax for ax in figure.axes if ax.get_title()])
        assert width == (PAGE_IN if panels else COLUMN_IN)
        figure.draw_without_rendering()
        box = figure.get_tightbbox()
        assert box.x0 >= -0.02 and box.x1 <= figure.get_figwidth() + 0.02, name
        assert box.y0 >= -0.02 and box.y1 <= figure.get_figheight() + 0.02, name


def test_a_cell_has_its_value_and_interval(made: Made, tmp_path: Path) -> None:
    found = made("heat", usual)
    assert words(found["passed"])[:2] == ["100", "44..100"]
    assert words(found["formation_final_m"])[:2] == ["0.22", "0.52"]  # three runs are too few for an interval
    assert len(found["passed"].axes) == 2  # the map and the bar
    of_six = figures(made_up(tmp_path / "s", *STUDIES["heat"], row=usual, seeds=6), "formation_final_m")
    assert words(of_six["formation_final_m"])[:2] == ["0.24", "0.21..0.26"]


@pytest.mark.parametrize(("seeds", "said"), [(3, "no interval: fewer than 6 runs"), (6, "96.9 % interval")])
def test_the_level_of_intervals_is_told(seeds: int, said: str, tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", *STUDIES["curve"], row=usual, seeds=seeds)
    found = figures(store, "formation_final_m")
    assert f"median of runs at each point, n = {seeds}, {said}" in caption_of(found["formation_final_m"])
    assert (said in legend_of(found["formation_final_m"])) == (not said.startswith("no"))  # no mark, no entry
    assert legend_of(found["passed"])[-1] == "95 % interval"
    assert caption_of(found["passed"]) == f"share of runs at each point, n = {seeds}, 95 % interval (Wilson)"


def points(rows: int, *dimensions: VariedKey, seeds: int = 3) -> Points:
    """Points without a study: every value with every other."""
    keys = tuple(product(*(each.values for each in dimensions)))
    assert len(keys) == rows
    numbers = {name: np.linspace(0.0, 1.0, rows * seeds).reshape(rows, seeds) for name in ("passed", "e_rms_m")}
    return Points(dimensions, keys, np.full((rows, seeds), MADE), numbers, {"e_rms_m": "m"})


ACROSS = VariedKey("network.links.*.loss", "%", tuple(map(float, range(0, 95, 5))))
UP = VariedKey("network.links.*.delay", "ms", (50.0, 200.0))


def test_where_the_interval_finds_no_room_its_width_is_a_map_of_its_own() -> None:
    found = {name: figure for name, _, figure in draw(points(38, ACROSS, UP, seeds=6))}["e_rms_m"]
    assert len([ax for ax in found.axes if ax.images]) == 2
    assert any("width of the 96.9 % interval" in ax.get_xlabel() for ax in found.axes)
    few = {name: figure for name, _, figure in draw(points(38, ACROSS, UP, seeds=3))}["e_rms_m"]
    assert len([ax for ax in few.axes if ax.images]) == 1  # there is no interval


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[] if kind in ("heat", "curve", "sample") else [pytest.mark.slow]) for kind in STUDIES],
)
def test_runs_without_a_number_are_hatched_and_explained(kind: str, made: Made) -> None:
    name = "compare-controller-formation_final_m" if kind == "sample" else "formation_final_m"
    assert not artists(made(kind, usual)[name], "lack")
    found = made(kind, with_holes)[name]
    hatches = {artist.get_hatch() for artist in artists(found, "lack")}
    reasons = {"not made yet", "without this number"} | (set() if kind in ("boxes", "one") else {"without a result"})
    if kind == "sample":  # no point has just this loss
        reasons = {"not made yet"}
    assert set(legend_of(found)) & set(REASONS) == reasons
    assert len(hatches) == len(reasons)


def test_a_study_without_a_row_is_hatched(tmp_path: Path) -> None:
    found = figures(made_up(tmp_path / "s", LOSS, CONTROLLER, row=lambda *_: None))
    assert legend_of(found["passed"]) == ["nboc", "boc", "not made yet"]
    sample = drawn(made_up(tmp_path / "sample", *SAMPLE, row=lambda *_: None))
    assert list(sample) == ["passed"] and "are a sample and no grid" in str(sample["passed"])


def test_what_is_equal_in_all_pairs_is_not_drawn(tmp_path: Path) -> None:
    found = drawn(made_up(tmp_path / "s", LOSS, CONTROLLER, row=usual), "loss_share")
    assert found["compare-controller-loss_share"] == "the runs of every pair are equal in it"


def test_a_curve_has_a_band_for_each_word_and_a_logarithmic_axis_for_equal_ratios(tmp_path: Path) -> None:
    found = figures(made_up(tmp_path / "s", LOSS, CONTROLLER, row=usual))["passed"]
    assert len(artists(found, "curve")) == len(artists(found, "band")) == 2
    assert found.axes[0].get_xscale() == "linear"
    ratios = VariedKey("network.links.*.delay", "ms", (10.0, 20.0, 40.0, 80.0, 160.0))
    scaled = {name: figure for name, _, figure in draw(points(5, ratios), log_scale=True)}["e_rms_m"]
    assert (scaled.axes[0].get_xscale(), scaled.axes[0].get_yscale()) == ("log", "log")


def test_many_panels_go_to_further_pictures_and_too_many_boxes_are_said() -> None:
    many = VariedKey("title", None, tuple(f"t{n}" for n in range(61)))
    some = VariedKey("title", None, many.values[:14])
    found = draw(points(56, VariedKey("speed", "m/s", (1.0, 2.0)), UP, some, seeds=1))
    assert [name for name, *_ in islice(found, 3)] == ["passed", "passed-2", "e_rms_m"]
    (passed, *_) = draw(points(61, many))
    assert "61 boxes do not fit" in str(passed.figure)


def test_names_are_text_and_never_formulas(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", LOSS, "title=$x^2 $\\frac$, _b, " + 60 * "x", row=usual)
    found = figures(store)
    for figure in found.values():
        figure.draw_without_rendering()
    labels = legend_of(found["passed"])
    assert labels[:2] == [r"\$x^2 \$\frac\$", " _b"]
    assert len(labels[2]) == 30


def test_files_are_the_same_each_time_and_say_what_they_show(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", LOSS, row=with_holes)
    said: list[str] = []
    once, again = (write({"s": store}, ["e_rms_m"], tmp_path / name, ["png", "svg"], tell=said.append) for name in "ab")
    assert [path.name for path in once] == ["passed.png", "passed.svg", "e_rms_m.png", "e_rms_m.svg"]
    assert [path.read_bytes() for path in once] == [path.read_bytes() for path in again]
    assert b"network.links.*.loss" in once[1].read_bytes()
    (tmp_path / "file").write_text("")
    with pytest.raises(FleetError, match="choose another place with -o DIR"):
        write({"s": store}, [], tmp_path / "file")


def test_studies_are_compared_run_by_run(tmp_path: Path) -> None:
    """Each is a curve with its name, and runs with the same seed are pairs; the second has one seed more."""
    first = made_up(tmp_path / "a", LOSS, row=usual, seeds=7)
    second = made_up(tmp_path / "b", LOSS, row=lambda point, seed: usual(point, seed + 1), seeds=8)
    found = plot({"old": first, "new": second}, ["e_rms_m"], None, ["png"])
    assert legend_of(found["e_rms_m"])[:2] == ["old", "new"]
    both = joined([load(store, ["e_rms_m"]) for store in (first, second)], ["old", "new"])
    assert both.seeds == tuple(range(1, 9)) and both.dimensions[0] == VariedKey("study", None, ("old", "new"))
    differences = both.differences(0, "e_rms_m")
    for key, cell in differences.cells.items():
        loss = key[1]
        values = [usual({"network.links.*.loss": loss}, seed)["e_rms_m"] for seed in range(1, 9)]
        assert list(cell.values) == pytest.approx([b - a for a, b in pairwise(values)])
    assert {"compare-study-e_rms_m"} <= set(found) and differences.pair == "new - old"
    other = made_up(tmp_path / "c", DELAY, row=usual)
    with pytest.raises(StudyError, match=r"old varies .*loss, and other varies .*delay: compare studies of the same"):
        plot({"old": first, "other": other}, [], None, ["png"])


def test_a_measure_is_no_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not that of a signal of a vehicle, and not that of a stranger's study."""
    few = points(2, UP)
    names = ["final uuv/3/state.z", "../../../out-of-here", "p95 error.e", "p95 |error.e|"]
    numbers = dict.fromkeys(names, few.numbers["e_rms_m"])
    named = Points(few.dimensions, few.keys, few.state, numbers, dict.fromkeys(names, "m"))
    monkeypatch.setattr("fleet.addons.studies.pictures.gallery.load", lambda *_: named)
    store = made_up(tmp_path / "s", DELAY, row=usual)
    found = write({"s": store}, [], tmp_path / "plots", ["png"])
    stems = ["final-uuv-3-state.z", "out-of-here", "p95-error.e", "p95-error.e-2"]
    assert found == [tmp_path / "plots" / f"{stem}.png" for stem in stems]
    assert len(list((tmp_path / "plots").iterdir())) == 4


def test_bright_is_good_in_heat_maps(tmp_path: Path) -> None:
    """A high pass rate is bright, and so is a small error; axes have words."""

    def bright(name: str) -> tuple[float, float]:
        found = figures(made_up(tmp_path / f"{name}-study", LOSS, DELAY, row=usual), "formation_final_m")[name]
        image = found.axes[0].images[0]
        values = np.ma.masked_invalid(image.get_array())
        colours = [image.cmap(image.norm(value))[:3] for value in (values.min(), values.max())]
        assert found.axes[0].get_xlabel() == "loss of every link [%]"
        least, most = (0.299 * red + 0.587 * green + 0.114 * blue for red, green, blue in colours)
        return least, most

    least, most = bright("passed")
    assert least < most
    least, most = bright("formation_final_m")
    assert least > most
    assert more_is_better("separation_min_m") and not more_is_better("p95 |error.e|") and more_is_better("min nav.u")
