"""Mistakes in what a study is given, in words: the class and words of each, as `messages-study.txt` says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from refusals import check_refusals
from small_scenario import small

import fleet
from fleet.addons.studies.borders import parse_along
from fleet.addons.studies.failures import INDEX, FailureFolder, Regression
from fleet.addons.studies.option_values import set_values, varied_values
from fleet.addons.studies.plan import Plan, parse_seeds
from fleet.addons.studies.signal_measures import find_columns, signal_columns_of
from fleet.addons.studies.stopping import check_until
from fleet.addons.studies.study_file import parse_study
from fleet.addons.studies.sweep import load_points
from fleet.addons.studies.values import parse_axis
from fleet.errors import FleetError
from fleet.scenario.text.overrides import NET, SET, Override
from fleet.scenario.text.yaml_reader import Source


def points(*options: str) -> None:
    """The points of a study of two seconds of `rough-sea`; an option is its flag and its text."""
    typed = [option.split(" ", 1) for option in options]
    changes = [Override({"--net": NET, "--set": SET}[flag], text) for flag, text in typed if flag != "--vary"]
    axes = [parse_axis(text) for flag, text in typed if flag == "--vary"]
    load_points(Plan("rough-sea", (Override(SET, "duration=2 s"), *changes), tuple(axes)))


READERS: dict[str, Callable[..., object]] = {
    "axes": parse_axis,
    "borders": lambda text: parse_along(text, 0.1),
    "files": lambda text: parse_study(Source("my.yaml", text)),
    "keywords": lambda text: fleet.sweep("paper", **yaml.safe_load(text)),
    "measures": lambda text: find_columns([text]),
    "measures of signals": lambda text: signal_columns_of([text], [small()]),
    "points": points,
    "rules of stopping": check_until,
    "seeds": parse_seeds,
    "set": lambda text: set_values([text]),
    "varied": lambda *texts: varied_values(list(texts)),
}


@pytest.mark.parametrize("name", READERS)
def test_what_is_wrong_is_said(name: str) -> None:
    check_refusals(f"study/{name}", READERS[name])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("axes", f"loss=0 %..90 %{200 * ' '}/10 %"),
        ("axes", f"x=0..1 lin {'9' * 5000}"),
        ("measures of signals", f"max {200 * ' '} error.e_norm"),
        ("rules of stopping", f"pass {200 * ' '} ±5 %"),
    ],
)
def test_long_texts_of_a_stranger_take_no_hours(name: str, text: str) -> None:
    with pytest.raises(FleetError, match=r"expected|no measure of a signal"):
        READERS[name](text)


def test_a_folder_of_failures_may_come_from_anybody(tmp_path: Path) -> None:
    def read(index: str) -> None:
        (tmp_path / INDEX).write_text(index, "utf-8")
        Regression(FailureFolder(tmp_path))

    check_refusals("study/folders of failures", read, hide={str(tmp_path): "FOLDER"})
