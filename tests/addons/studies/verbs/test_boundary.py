"""`fleet boundary` as people type it: its table, its document, its errors, and a study that goes on."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import msgspec
import pytest
from made_up_study import damage
from study_engine import Drawn, made_here
from tool import invoke

from fleet.addons.studies.verbs.documents import BoundaryFound

ARGS = [
    "small.yaml",
    "--along",
    "loss=0 %..90 %/10 %",
    "--per",
    "delay=0 s,1 s",
    "--net",
    "* loss {loss} delay {delay}",
]
boundary = partial(invoke, "boundary")


@pytest.fixture(autouse=True)
def engines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Drawn]:
    """The engines that were used: with a delay of 1 s everything fails, else what has 40 % of loss or more."""
    monkeypatch.setenv("COLUMNS", "80")
    losses = [f"loss {percent}%" for percent in (0, 10, 20, 30)]
    return made_here(
        tmp_path, monkeypatch, engine=lambda: Drawn(lambda text, _: "1s" not in text and any(s in text for s in losses))
    )


def test_the_table_the_picture_and_the_directory() -> None:
    result = boundary(*ARGS)
    assert result.exit_code == 0, result.output
    (directory,) = Path("studies").iterdir()
    lines = result.stdout.splitlines()
    assert lines[0] == "small: where the pass rate falls through 50 %"
    assert lines[-1] == str(directory)
    first, second = lines[3:5]
    assert first.split()[0] == "0"
    low, high = map(float, first.split()[2].split(".."))
    assert low < 35.0 < high
    assert second.split() == ["1", "under", "0", "8", "0", "0..43"]
    assert (directory / "border.png").read_bytes().startswith(b"\x89PNG")


def test_a_study_that_is_whole_starts_no_worker_and_prints_a_document(engines: list[Drawn]) -> None:
    directory = boundary(*ARGS).stdout.splitlines()[-1]
    result = boundary(directory, "--json")
    assert len(engines) == 1
    found = msgspec.json.decode(result.stdout, type=BoundaryFound)
    assert found.directory == directory
    assert [border.where for border in found.borders] == ["within", "below"]
    assert found.borders[1].value is None
    assert found.borders[1].first.high == pytest.approx(0.434, abs=0.001)
    damage(Path(directory), "DELETE FROM runs WHERE seed <= 4")
    boundary(directory)
    assert len(engines[1].tasks) == 8  # the first round of both


def test_the_answer_is_there_without_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.addons.studies.pictures.border.MOST_PANELS", 0)
    result = boundary(*ARGS)
    assert result.exit_code == 0, result.output
    assert "there is no picture: these are 1 panels" in result.stderr
    directory = result.stdout.splitlines()[-1]
    assert result.stdout.startswith("small: where the pass rate falls")
    document = msgspec.json.decode(boundary(directory, "--json").stdout, type=BoundaryFound)
    assert (document.picture, len(document.borders)) == (None, 2)


def test_the_time_of_a_run_is_kept_and_may_be_given_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    directory = boundary(*ARGS, "--timeout", "90 s").stdout.splitlines()[-1]
    damage(Path(directory), "DELETE FROM runs")
    limits: list[float] = []
    monkeypatch.setattr(
        "fleet.addons.studies.borders.find_borders", lambda *_, timeout_s, **__: limits.append(timeout_s)
    )
    boundary(directory)
    boundary(directory, "--timeout", "5 s")
    assert limits == [90.0, 5.0]
