"""The names of runs that are compared, the look that a user chooses, and what Python can do of what the command can."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_process_runs import Alone
from made_up_study import LOSS, made_up, usual
from matplotlib.text import Text
from tool import invoke

import fleet
from fleet.addons.pictures.caption import caption_of, fitting, text_width_pt
from fleet.addons.pictures.gallery import draw
from fleet.addons.pictures.labels import differences, given_labels
from fleet.addons.pictures.look import Look, current_look, looking, parse_look, text_pt
from fleet.addons.pictures.runs import View, load
from fleet.errors import FleetError

pytestmark = pytest.mark.usefixtures("coarse")

BASE = "name: paper\nvehicles: 4\nneighbours: {heartbeat: 0}\nfaults: []\n"


@pytest.fixture(scope="module")
def pair(made: Alone) -> list[Path]:
    """Two runs that differ in a fault and a gain."""
    common = ("checks={formation_error: {below: 1 mm}}", "duration=1 s")
    one = made("paper", *common, "tracking.k_u=1 1/s")
    other = made("paper", *common, "tracking.k_u=2 1/s", "faults=[{at: 200 ms, for: 300 ms, kill: 2}]")
    return [one.directory, other.directory]


def test_runs_are_named_by_what_differs() -> None:
    def differ(*changes: tuple[str, str]) -> list[str]:
        text = BASE
        for old, new in changes:
            text = text.replace(old, new)
        return differences([BASE, text])

    assert differ(("heartbeat: 0", "heartbeat: 2")) == ["heartbeat 0", "heartbeat 2"]
    assert differ(("faults: []", "faults: [{at: 8 s, kill: 2}]")) == ["no faults", "at 8 s, kill 2"]
    assert differ(("faults: []", f"faults: {[{'kill': k} for k in range(30)]}")) == ["no faults", "30 faults"]
    assert differ(("heartbeat: 0", "heartbeat: true")) == ["heartbeat 0", "heartbeat"]
    many = "".join(f"k{k}: 1\n" for k in range(9))
    assert differences([f"law: a\n{many}", f"law: b\n{many.replace('1', '2')}"]) == ["law a", "law b"]
    assert differences([BASE, BASE]) == ["", ""]
    gains = [f"a: {a}\nb: {b}\nc: {a}\nchecks: {{x: {b}}}\n" for a, b in ((1, 1), (2, 1), (2, 2))]
    assert differences(gains) == ["a 1, b 1", "a 2, b 1", "a 2, b 2"]  # two keys tell three apart, and no check
    assert differences(["checks: {x: 1}\n", "checks: {x: 2}\n"]) == ["x 1", "x 2"]
    assert differences(["a: x\n", f"a: {'y' * 99}\n"]) == ["", ""]  # too long for a legend


def test_a_legend_names_what_differs_and_what_the_user_says(pair: list[Path]) -> None:
    assert [run.label for run in load(pair)] == ["k_u 1 1/s, no faults", "k_u 2 1/s, with faults"]
    assert [run.label for run in load(pair, labels={str(pair[1]): "new"})] == ["k_u 1 1/s, no faults", "new"]
    assert [run.label for run in load(pair, labels=["same", "same"])] == ["same", "same (2)"]
    assert given_labels([Path("runs/a"), Path("runs/b")], {"runs/b": "new\x1b[31m"}) == [None, "new�[31m"]
    assert given_labels([Path("x/a/run.mcap"), Path("y/b")], {"a": "new"}) == ["new", None]
    with pytest.raises(FleetError, match=r"'a' is 2 of what is drawn; write the path"):
        given_labels([Path("x/a"), Path("y/a")], {"a": "new"})
    with pytest.raises(FleetError, match=r"'runs/c' is none of what is drawn; there are a, b"):
        given_labels([Path("runs/a"), Path("runs/b")], {"runs/c": "new"})
    with pytest.raises(FleetError, match="expected 1 or fewer, got 2"):
        given_labels([Path("a")], ["x", "y"])


@pytest.mark.parametrize("labels", [(), ("a" * 39, "$\\frac" + "b" * 33)])
def test_nothing_below_a_picture_is_cut_off(labels: tuple[str, ...], pair: list[Path]) -> None:
    """The words were as long as they were, and stood at both edges."""
    runs = load(pair, labels=labels)
    for name, _, figure in draw(["error", "ages", "track"], runs, View()):
        assert not isinstance(figure, str), (name, figure)
        if name == "track-3d":  # whose box has blank corners
            continue
        figure.draw_without_rendering()
        box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
        assert box.x0 > -0.05 and box.y0 > -0.05 and box.x1 < width + 0.05 and box.y1 < height + 0.05, name
        assert runs[1].label[:30] in " ".join(caption_of(figure).split()) or name.startswith("track")


def test_words_are_broken_where_they_have_to_be() -> None:
    room = text_width_pt("as wide as this", 7.0)
    found = list(fitting("as wide as this as wide as this" + "w" * 40, room, 7.0))
    assert "".join(found).replace(" ", "") == "aswideasthisaswideasthis" + "w" * 40
    assert all(text_width_pt(line, 7.0) <= room for line in found) and found[0] == "as wide as this"
    assert list(fitting("", room, 7.0)) == [""]


def test_a_look_is_a_font_its_size_and_a_width(pair: list[Path]) -> None:
    look = parse_look("font=serif, size=10, width=88mm")
    assert (look.font, look.size_pt, look.width_in) == ("serif", pytest.approx(10.0), pytest.approx(88 / 25.4))
    assert parse_look("") == Look() == current_look()
    for text, said in (
        ("font=Serrif", "no font 'Serrif' is installed; did you mean \"serif\""),
        ("with=3mm", 'did you mean "width"'),
        ("width", "'width' is unknown"),
        ("width=1e9mm", "width: expected 38.1 to 355.6 mm"),
        ("size=200", "size: expected 5 to 20 pt"),
    ):
        with pytest.raises(FleetError, match="style: ") as caught:
            parse_look(text)
        assert said in str(caught.value)
    figure = fleet.plot(pair[0], "error", style="font=serif,size=10,width=88mm", caption=False)["error"]
    assert figure.get_figwidth() == pytest.approx(88 / 25.4) and figure.axes[0].xaxis.label.get_size() == 10.0
    texts = [one for one in figure.findobj(Text) if one.get_text()]
    assert texts and all(one.get_fontfamily() == ["serif", "DejaVu Sans"] for one in texts)
    assert not figure.get_supxlabel() and "fails at" in caption_of(figure)
    with pytest.raises(ZeroDivisionError), looking(look):
        raise ZeroDivisionError
    assert text_pt() == 8.0


def test_python_does_what_the_command_does(pair: list[Path], tmp_path: Path) -> None:
    found = fleet.plot(
        pair[0], "error", compare=pair[1], labels=["old", "new"], window=(0.2, 0.8), vehicles=[1, 3], linear=True
    )
    (ax,) = found["error"].axes
    assert ax.get_xlim() == (0.2, 0.8) and ax.get_yscale() == "linear"
    assert {str(line.get_gid()) for line in ax.get_lines() if "-vehicle-" in str(line.get_gid())} == {
        "old-vehicle-1", "old-vehicle-3", "new-vehicle-1", "new-vehicle-3",
    }  # fmt: skip
    with pytest.raises(FleetError, match="there is no vehicle 9"):
        fleet.plot(pair[0], "error", vehicles=[9])
    store = made_up(tmp_path / "s", LOSS, row=usual)
    assert {"passed", "e_rms_m"} == set(fleet.plot(store.directory, "e_rms_m", compare=[store.directory]))
    with pytest.raises(FleetError, match=r"s is a study, and .* a log: compare two of a kind"):
        fleet.plot(pair[0], compare=store.directory)


def test_captions_may_go_beside_the_pictures(pair: list[Path], tmp_path: Path) -> None:
    first, second = map(str, pair)
    done = invoke("plot", first, "--compare", second, "--label", f"{second}=new, {first}=old", "--what",
                  "formation", "--no-caption", "--style", "width=80mm", "-o", tmp_path, "--quiet")  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert done.stdout.split() == [str(tmp_path / name) for name in ("formation.png", "captions.txt")]
    text = (tmp_path / "captions.txt").read_text("utf-8")
    assert (
        text.startswith("formation: Distance of each vehicle")
        and "formation_error (old), formation_error (new)" in text
    )
    for label, said in (("a=", "expected names such as old,new"), ("a=b,c", "expected all names alone")):
        refused = invoke("plot", first, "--label", label)
        assert refused.exit_code == 2 and said in refused.stderr
