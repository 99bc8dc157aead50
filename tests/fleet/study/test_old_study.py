"""A study that an older fleet made is read, and made anew it has the same rows."""

from __future__ import annotations

import json
import shutil
from math import inf
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from pandas.testing import assert_frame_equal
from repository import EXPECTED
from study_engine import Here

from fleet.cli.main import cli
from fleet.study.errors import StudyError
from fleet.study.plan import plan_of
from fleet.study.spec import StudySpec
from fleet.study.store import Store
from fleet.study.study import Study, open_study
from fleet.study.sweep import prepare, run_study

# fleet sweep rough-sea --vary 'network.links.*.loss=0%,20%' --seeds 2 --set 'duration=5 s', at version 2 of study.json
OLD = EXPECTED / "study-version-2"
OF_THE_MACHINE = ["wall_s", "version", "cores"]
OF_THE_BYTES = ["key", "digest"]  # of a scenario's text and of a log, which other tests keep


def test_the_rows_of_a_study_are_as_before(tmp_path: Path) -> None:
    spec = StudySpec("rough-sea", vary={"network.links.*.loss": "0%,20%"}, seeds="2", set={"duration": "5 s"})
    store, _ = prepare(plan_of(spec), tmp_path / "study", spec=spec)
    run_study(store, Here(), lambda progress: None)  # type: ignore[arg-type]
    before, now = (study.to_pandas().drop(columns=OF_THE_MACHINE) for study in (open_study(OLD), Study(store)))
    now = now.drop(columns=[name for name in now.columns if name.startswith("margin.")])  # that version had none
    assert_frame_equal(before.drop(columns=OF_THE_BYTES), now.drop(columns=OF_THE_BYTES), rtol=1e-9)
    assert before.attrs == now.attrs


def old(folder: Path, **changes: Any) -> Path:
    """The old study with another study.json."""
    shutil.copytree(OLD, folder)
    record = json.loads((folder / "study.json").read_text("utf-8"))
    (folder / "study.json").write_text(json.dumps(record | changes), "utf-8")
    return folder


def test_the_settings_of_an_old_study_hold(tmp_path: Path) -> None:
    settings = {"measures": ["e_rms_m"], "until": "pass ±5 %", "most_seeds": 7, "keep_logs": "failed"}
    store = Store.open(old(tmp_path / "a", spec=None, settings=settings))
    assert (store.record.measures, store.record.spec) == (("e_rms_m",), None)
    rules = store.record.rules
    assert (rules.until, rules.most_seeds, rules.keep_logs, len(store.seeds)) == ("pass ±5 %", 7, "failed", 7)
    result = CliRunner().invoke(cli, ["sweep", str(tmp_path / "a"), "--show-config"])
    assert "did not save its settings" in result.stderr
    with pytest.raises(StudyError, match=r"study.json is damaged: .*most_seeds"):
        Store.open(old(tmp_path / "b", settings=settings | {"most_seeds": 0}))


def test_a_border_of_an_old_study_is_read(tmp_path: Path) -> None:
    border = Store.open(old(tmp_path / "a", border={"level": 0.9, "width": 0.2, "log": False})).record.border
    assert border is not None
    assert (border.level, border.width, border.timeout_s) == (0.9, 0.2, inf)
