"""`fleet sweep` as people type it: its table, its errors, and a study that goes on."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from small_scenario import SMALL
from study_engine import Here

from fleet.cli.main import cli
from fleet.study.store import Store

VARY = ["--vary", "network.links.*.loss=0 %,80 %", "--set", "network.links={'*': loss 1%}", "--seeds", "2"]


@pytest.fixture(autouse=True)
def engines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Here]:
    """The engines that were used; runs are made in this process."""
    used: list[Here] = []

    def engine_of(*_: Any, **__: Any) -> Any:
        used.append(Here())
        return nullcontext(used[-1])

    monkeypatch.setattr("fleet.study.study.engine_of", engine_of)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(SMALL, "utf-8")
    return used


def sweep(*args: str) -> Result:
    return CliRunner().invoke(cli, ["sweep", *args])


def test_the_table_and_the_directory(engines: list[Here]) -> None:
    result = sweep("small.yaml", *VARY, "--measure", "loss_share")
    assert result.exit_code == 0, result.output
    (directory,) = Path("studies").iterdir()
    assert result.stdout.splitlines()[-1] == str(directory)
    assert f"{directory}: 2 points x 2 seeds = 4 runs" in result.stderr
    first, second = result.stdout.splitlines()[3:5]
    assert first.split()[:2] == ["0", "2"]
    assert second.split()[:2] == ["80", "2"]
    assert {"0..66", "34..100%"} & {"".join(line.split()[4:6]) for line in (first, second)}  # Wilson, of two runs


def test_a_study_that_is_whole_starts_no_worker(engines: list[Here]) -> None:
    quiet = sweep("small.yaml", *VARY, "-q")
    assert quiet.exit_code == 0
    assert quiet.stderr == ""
    directory = quiet.stdout.strip()
    again = sweep(directory)
    assert "4 runs, 4 of them made" in again.stderr
    assert len(engines) == 1
    part = next((Path(directory) / "runs").iterdir())
    part.unlink()
    assert Store.open(Path(directory)).missing == 4
    sweep(directory)
    assert len(engines[1].tasks) == 4
    assert Store.open(Path(directory)).missing == 0


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["small.yaml", "--vary", "loss"], "expected KEY=VALUES"),
        (["small.yaml", "--vary", "loss=0 %..9 %/1 %"], "unknown key"),
        (["small.yaml", *VARY, "--net", "* loss 1%"], "two points are the same scenario, network.links.*.loss=0 % and"),
        (["small.yaml", "--set", "per_vehicle={3: {external: true}}"], "somebody else"),
        (["small.yaml", "--vary", "status=0 %,9 %", "--net", "* loss {status}"], "status is a column of every study"),
        (["small.yaml", "--seeds", "none"], "expected a number of seeds"),
        (["small.yaml", "--measure", "e_rms"], 'did you mean "e_rms_m"?'),
        (["nosuch", "--seeds", "1"], "there is no such shipped scenario"),
        (["."], "is no study: it has no study.json"),
        ([".", "--seeds", "1"], "what it runs is settled"),
        ([".", "--vary", "a=1,2"], "what it runs is settled"),
    ],
)
def test_mistakes_are_usage(args: list[str], message: str) -> None:
    result = sweep(*args)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not Path("studies").exists()


def test_without_the_extra_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.study.engine.NEEDED", ("no_such_library",))
    result = sweep("small.yaml")
    assert result.exit_code == 2
    assert result.stderr == "fleet: studies need no_such_library: pip install 'uuv-fleet[study]'\n"
