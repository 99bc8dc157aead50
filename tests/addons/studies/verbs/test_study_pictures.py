"""`fleet plot` and `fleet report` of the directory of a study."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_up_study import LOSS, made_up, usual, with_holes
from refusals import check_refusals, type_command
from tool import invoke

import fleet

pytestmark = pytest.mark.usefixtures("coarse")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up(tmp_path_factory.mktemp("studies") / "s", LOSS, row=with_holes).directory


def test_the_pictures_of_a_study_are_printed(study: Path, tmp_path: Path) -> None:
    found = invoke("plot", study, "--measure", "e_rms_m", "--format", "png,svg", "-o", tmp_path)
    assert found.exit_code == 0, found.output
    names = ["passed.png", "passed.svg", "e_rms_m.png", "e_rms_m.svg"]
    assert found.stdout.splitlines() == [str(tmp_path / name) for name in names]
    assert (tmp_path / "passed.png").stat().st_size > 1000  # a picture of nothing has 300


def test_without_a_place_they_go_into_the_study(tmp_path: Path) -> None:
    directory = made_up(tmp_path / "s", "controller=nboc, boc", row=usual, seeds=2).directory
    found = invoke("plot", directory, "--measure", "loss_share")
    assert found.stdout.splitlines() == [str(directory / "plots" / f"{name}.png") for name in ("passed", "loss_share")]
    said = "fleet: compare-controller-loss_share: not drawn: the runs of every pair are equal in it"
    assert said in found.stderr.splitlines()  # a slow machine shows progress, too


def test_the_page_replaces_nothing_without_force(study: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    assert invoke("report", study, "-o", out, "--measure", "e_rms_m").stdout == f"{out}\n"
    assert "uuv-fleet: study s" in out.read_text("utf-8")
    refused = invoke("report", study, "-o", out)
    assert refused.exit_code == 2 and "replace it with --force" in refused.stderr


def test_what_does_not_belong_together_is_said(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    places = {"STUDY": str(study), "HERE": str(tmp_path)}

    def typed(line: str) -> None:
        type_command(*(places.get(word, word) for word in line.split()))

    check_refusals("cli/pictures of studies", typed, hide={place: name for name, place in places.items()})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", ["plot", "report"])
def test_without_the_extra_one_line_says_what_to_install(
    study: Path, verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fleet.addons.studies.engine_interface.find_spec", lambda name: None)
    found = invoke(verb, study, "-o", tmp_path / "out")
    assert found.exit_code == 2
    assert found.stderr.splitlines()[0].endswith("pip install 'uuv-fleet[study]'")


@pytest.mark.parametrize("verb", ["plot", "report"])
def test_a_damaged_study_is_said_in_a_line(verb: str, tmp_path: Path) -> None:
    directory = made_up(tmp_path / "s", LOSS, row=usual).directory
    (directory / "study.sqlite").write_bytes(b"SQL")
    found = invoke(verb, directory, "-o", tmp_path / "out")
    assert found.exit_code == 2
    assert found.stderr.splitlines()[-1].startswith(f"fleet: {directory / 'study.sqlite'} is damaged: ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["x.bmp", "x.png", "X.JPG"])
def test_a_file_instead_of_a_folder_is_refused_with_the_known_formats(study: Path, tmp_path: Path, name: str) -> None:
    found = invoke("plot", study, "-o", tmp_path / name)
    assert found.exit_code == 2
    assert "expected a folder" in found.output and "png, svg, pdf" in found.output
    assert not list(tmp_path.iterdir())


def test_a_study_is_exported_with_units_and_read_back(study: Path, tmp_path: Path) -> None:
    import pandas as pd
    from pandas.testing import assert_frame_equal

    found = invoke("export", study, "--csv", tmp_path / "a", "--parquet", tmp_path / "b")
    assert found.stdout.splitlines() == [str(tmp_path / "a" / "s.csv"), str(tmp_path / "b" / "s.parquet")]
    frame = fleet.open_study(study).to_pandas()
    assert_frame_equal(pd.read_parquet(tmp_path / "b" / "s.parquet"), frame)
    table = pd.read_csv(tmp_path / "a" / "s.csv")
    assert table["network.links.*.loss [%]"].tolist() == frame["network.links.*.loss"].tolist()
    assert "s.csv is there already" in invoke("export", study, "--csv", tmp_path / "a").stderr
    assert "--topics: only for logs" in invoke("export", study, "--csv", tmp_path, "--topics", "a").stderr
