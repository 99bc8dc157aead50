"""The examples in the help texts do what they say, on a run of a scenario that ships."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from fleet.cli.main import cli

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
# Names that stand for files and studies of the reader.
OWN = re.compile(r"my_module|my_checks|my\.yaml|my-study|studies/|runs/[ab]\b|\d{8}-\d{6}|\.mcap")


def invoke(command: str) -> Result:
    return CliRunner().invoke(cli, shlex.split(command)[1:], prog_name="fleet", terminal_width=400)


def examples(command: str) -> list[str]:
    """The lines of a help text that need nothing of the reader's own, without the words behind them."""
    found = re.findall(rf"^    (fleet {command}\b.*?)(?:   .*)?$", invoke(f"fleet {command} --help").output, re.M)
    assert found
    return [line for line in found if not OWN.search(line)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run in `runs`."""
    made = tmp_path_factory.mktemp("examples")
    done = invoke(f"fleet run paper --in-process --duration '25 s' --set checks={{}} --out {made / 'runs'}")
    assert done.exit_code == 0, done.output
    return made


def test_each_works_on_the_newest_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One after the other in one folder, as a reader tries them; none is in the way of the next."""
    monkeypatch.chdir(folder)
    for command in ("info", "export", "plot", "whatif"):
        for line in examples(command):
            done = invoke(line.partition(" > ")[0])  # what a shell does with it is not ours
            assert done.exit_code == 0, (line, done.output)


def test_the_points_of_each_study_are_valid() -> None:
    for line in examples("sweep"):
        done = invoke(line.partition(" > ")[0] + ("" if "--show-config" in line else " --show-config"))
        assert done.exit_code == 0, (line, done.output)


def test_what_is_shrunk_fails_that_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    named = [line.partition(" --check ") for line in examples("shrink") if "--check" in line]
    assert named
    for failing, _, check in named:
        done = invoke(failing.replace("fleet shrink", "fleet run --in-process"))
        assert re.search(rf"^FAIL  {check}: ", done.output, re.M), (failing, done.output)


def test_a_run_is_not_shorter_than_its_checks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for line in examples("run"):
        if "--duration" in line:
            done = invoke(f"{line} --in-process")
            assert done.exit_code == 0 and "cannot pass" not in done.output, (line, done.output)
