"""Studies from scripts."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from study_engine import made_here

import fleet
from fleet.addons.studies.store import Store
from fleet.addons.studies.study import new_directory
from fleet.errors import ScenarioError

STUDY = """\
study:
  scenario: small.yaml
  vary: {loss: [0 %, 80 %], profile: "paper, hardened"}
  net: "* loss {loss}"
  seeds: 5
  timeout: 90 s
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_here(tmp_path, monkeypatch)


def test_a_script_runs_the_file_of_a_study_with_changes() -> None:
    Path("my-study.yaml").write_text(STUDY, "utf-8")
    study = fleet.sweep("my-study.yaml", {"loss": ["0 %", "50 %"]}, seeds=[7], set={"profile": "hardened"}, draw=3)
    assert study.directory.name.startswith("my-study-")
    assert study.axes == {"loss": "%"}  # profile is set now
    assert study.seeds == [7]
    assert list(study.to_pandas()["loss"]) == [0.0, 50.0]
    spec = Store.open(study.directory).record.spec
    assert (spec.timeout, spec.draw, spec.seeds, spec.set) == ("90 s", 3, "7,7", {"profile": "hardened"})


def test_mistakes_in_the_file_are_raised() -> None:
    Path("my-study.yaml").write_text(STUDY.replace("seeds", "sees"), "utf-8")
    with pytest.raises(ScenarioError, match='unknown key "sees"'):
        fleet.sweep("my-study.yaml")


def test_a_time_limit_is_kept_with_the_study() -> None:
    study = fleet.sweep("small.yaml", seeds=1, timeout_s=1.5)
    spec = Store.open(study.directory).record.spec
    assert (spec.timeout, spec.seeds) == ("1.5 s", "1")


def test_two_studies_that_begin_in_one_second_have_two_directories(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "gmtime", lambda: time.struct_time((2026, 11, 22, 10, 15, 0, 6, 326, 0)))
    names = []
    for _ in range(3):
        directory = next(place for place in new_directory("rough-sea", tmp_path) if not place.exists())
        directory.mkdir()
        names.append(directory.name)
    assert names == ["rough-sea-20261122-101500", "rough-sea-20261122-101500-2", "rough-sea-20261122-101500-3"]
