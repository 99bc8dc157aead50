"""A wheel with compiled cores: the same bytes as plain Python, and what a user may do with his laws stays possible."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from repository import ROOT

from fleet.run.execute import execute
from fleet.run.options import Options
from fleet.scenario.loading import load_scenario

pytestmark = [pytest.mark.slow, pytest.mark.timeout(500)]
COPIED = (".packaging", "agents", "fleet", "netem", "world", "pyproject.toml", "README.md", "LICENSE", "NOTICE")
# A law that fails at a tick, so that the line of its file has to be told.
FAILING = """\
class Failing:
    signals = ()

    def __init__(self, config):
        pass

    def step(self, sample):
        if sample.tick == 20:
            raise RuntimeError("enough")
        return (1.0, 0.0, 0.0), {}
"""


def build(tmp_path: Path, switch: str, **environment: str) -> Path:
    """A folder with the content of a wheel that was built from a copy of the sources."""
    sources = tmp_path / "sources"
    sources.mkdir()
    for name in COPIED:
        place = ROOT / name
        if place.is_dir():
            shutil.copytree(place, sources / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
        else:
            shutil.copy(place, sources)
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(sources)],
        env=os.environ | {"UUV_FLEET_COMPILE": switch} | environment,
        check=True,
        capture_output=True,
        timeout=400,
    )
    (wheel,) = tmp_path.glob("*.whl")
    part, unpacked = tmp_path / "part", tmp_path / "unpacked"
    with zipfile.ZipFile(wheel) as file:
        file.extractall(part)
    return part.rename(unpacked)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built once, also when several workers run these tests."""
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    base = tmp_path_factory.getbasetemp()
    place = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled"
    place.mkdir(exist_ok=True)
    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = place / "unpacked"
        return done if done.is_dir() else build(place, "yes")


def fleet(packages: Path, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "fleet", *arguments],
        env=os.environ | {"PYTHONPATH": f"{packages}{os.pathsep}{folder}"},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_it_says_that_it_is_compiled(compiled: Path, tmp_path: Path) -> None:
    assert fleet(compiled, "--version", folder=tmp_path).stdout.endswith("cores: compiled\n")
    assert list(compiled.glob("world/dynamics.*.so")) and (compiled / "world" / "dynamics.py").is_file()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, ["--in-process"]) for name in ("paper", "rough-sea", "nemesis", "acoustic-80bps", "kill-restart")),
        ("rough-sea", []),  # distributed
        ("nemesis", []),
    ],
)
def test_the_same_bytes_as_plain_python(name: str, options: list[str], compiled: Path, tmp_path: Path) -> None:
    changes = ["duration=20 s", "checks={}"]
    sets = [word for change in changes for word in ("--set", change)]
    result = fleet(compiled, "run", name, *sets, *options, "-q", "--out", str(tmp_path / "c"), folder=tmp_path)
    assert result.returncode == 0, result.stderr
    plain = execute(load_scenario(name, changes), Options(tmp_path / "p", in_process=True, quiet=True))
    directory = Path(result.stdout.strip())
    assert (directory / "run.mcap").read_bytes() == (plain.directory / "run.mcap").read_bytes()
    assert '"cores": "compiled"' in (directory / "result.json").read_text()


def test_a_snapshot_of_one_goes_on_in_the_other(compiled: Path, tmp_path: Path) -> None:
    changes = ["duration=10 s", "checks={}", "log.snapshot=2 s"]
    whole = execute(load_scenario("rough-sea", changes), Options(tmp_path / "p", in_process=True, quiet=True))
    result = fleet(compiled, "verify", str(whole.directory), folder=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    begin = f"{whole.directory}@5s"
    result = fleet(compiled, "run", "--from", begin, "-q", "--out", str(tmp_path / "c"), folder=tmp_path)
    assert result.returncode == 0, result.stderr
    result = fleet(compiled, "diff", str(whole.directory), result.stdout.strip(), folder=tmp_path)
    assert result.returncode == 0 and "the same bit for bit" in result.stdout


def test_a_law_of_the_user_runs_and_its_failure_names_the_line(compiled: Path, tmp_path: Path) -> None:
    made = fleet(compiled, "new", "controller", "mine", folder=tmp_path)
    assert made.returncode == 0, made.stderr
    result = fleet(compiled, "run", "mine.yaml", "--in-process", "-q", "--trust", folder=tmp_path)
    assert result.returncode == 0, result.stderr
    (tmp_path / "failing.py").write_text(FAILING)
    result = fleet(
        compiled,
        "run",
        "paper",
        "--set",
        "controller=failing:Failing",
        "--in-process",
        "-q",
        "--trust",
        folder=tmp_path,
    )
    assert result.returncode == 3 and "Traceback" not in result.stderr
    assert re.search(r"failing\.py[^\n]*(line |:)9", result.stderr), result.stderr


def test_an_agent_of_the_user_runs(compiled: Path, tmp_path: Path) -> None:
    made = fleet(compiled, "new", "controller", "whole", "--kind", "agent", folder=tmp_path)
    assert made.returncode == 0, made.stderr
    result = fleet(compiled, "run", "whole.yaml", "--in-process", "-q", "--trust", folder=tmp_path)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(("switch", "cc"), [("no", "cc"), ("auto", "false")])
def test_without_a_compiler_it_is_plain_python(switch: str, cc: str, tmp_path: Path) -> None:
    """Or without the wish for it."""
    unpacked = build(tmp_path, switch, CC=cc)
    assert not list(unpacked.rglob("*.so"))
    assert fleet(unpacked, "--version", folder=tmp_path).stdout.endswith("cores: plain Python\n")
