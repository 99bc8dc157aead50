"""Our types are of use to others: a project of somebody else's, checked strictly, that imports what the docs name."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path
from textwrap import dedent

import pytest
from repository import ROOT

CONTROLLER = """
    from typing import ClassVar

    from agents.api import AgentConfig, Controller, Sample, Signal


    class Steady:
        signals: ClassVar[tuple[Signal, ...]] = (Signal("count", "1", "samples so far"),)

        def __init__(self, config: AgentConfig) -> None:
            self.count = 0

        def step(self, sample: Sample) -> tuple[tuple[float, float, float], dict[str, float]]:
            self.count += 1
            return (1.0, 0.0, 0.0), {"count": self.count + sample.e[0]}


    def made(config: AgentConfig) -> Controller:
        return Steady(config)
"""
ANALYSIS = """
    import fleet
    from fleet import Log


    def end_s(directory: str) -> float:
        log: Log = fleet.open_log(directory)
        times = log["uuv/1/state"].t
        return float(times[-1])
"""
WRONG = """
    import fleet

    number: int = fleet.open_log("runs/latest")
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter that finds our packages among those installed, where mypy asks for `py.typed`."""
    folder = tmp_path_factory.mktemp("venv")
    venv.create(folder, with_pip=False)
    (site,) = (folder / "lib").glob("python*/site-packages")
    (site / "ours.pth").write_text(f"{ROOT}\n{sysconfig.get_path('purelib')}\n")
    return folder / "bin" / "python"


def mypy(python: Path, folder: Path, file: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", "cache", "--python-executable", str(python)]
    return subprocess.run([*command, file], cwd=folder, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.timeout(400)
def test_a_strict_project_of_somebody_else_accepts_our_types(python: Path, tmp_path: Path) -> None:
    """`py.typed` is found, and what it promises is there: right uses pass, a wrong one is found."""
    (tmp_path / "project").mkdir()
    for name, text in (("__init__", ""), ("controller", CONTROLLER), ("analysis", ANALYSIS), ("wrong", WRONG)):
        (tmp_path / "project" / f"{name}.py").write_text(dedent(text))
    (tmp_path / "mypy.ini").write_text("[mypy]\n")
    done = mypy(python, tmp_path, "project")
    wrong, last = done.stdout.splitlines()
    assert wrong.startswith("project/wrong.py:4: error:") and 'expression has type "Log"' in wrong, done.stdout
    assert last == "Found 1 error in 1 file (checked 4 source files)"


@pytest.mark.parametrize("package", ["netem", "world", "agents", "fleet"])
def test_the_marker_of_types_is_installed_with_each_package(package: str) -> None:
    assert (ROOT / package / "py.typed").exists()
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]
    assert "py.typed" in settings["package-data"][package]
