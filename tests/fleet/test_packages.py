"""Packages that bear our names and are not ours are noticed before anything of them runs, with their owner."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from importlib.machinery import PathFinder
from pathlib import Path

import pytest
from marks import slow
from repository import ROOT
from spawned import python

from fleet import __main__ as packages
from fleet.__main__ import damaged_package, foreign

NAMES = ("agents", "world", "netem")
OURS = ("-c", "from fleet.__main__ import main; main()")
THEIRS = "raise RuntimeError('theirs has run')\n"


def ours(folder: Path) -> Path:
    for name in NAMES:
        (folder / name).mkdir(parents=True)
        shutil.copy(ROOT / name / "__init__.py", folder / name)
    return folder


def distribution(folder: Path, package: str) -> Path:
    """A distribution as pip installs it, whose package bears one of our names."""
    (folder / package).mkdir(parents=True, exist_ok=True)
    (folder / package / "__init__.py").write_text(THEIRS)
    info = folder / "impostor-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: impostor\nVersion: 1.0\n")
    (info / "top_level.txt").write_text(f"{package}\n")
    return folder


def at(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the packages be looked for in one place only."""
    monkeypatch.setattr(packages, "find_spec", lambda name: PathFinder.find_spec(name, [str(place)]))


def test_ours_are_ours_wherever_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert foreign() == ""
    at(ours(tmp_path / "folder"), monkeypatch)
    assert foreign() == ""
    archive = tmp_path / "app.zip"
    with zipfile.ZipFile(archive, "w") as file:
        for name in NAMES:
            file.write(ROOT / name / "__init__.py", f"{name}/__init__.py")
    at(archive, monkeypatch)
    assert foreign() == ""


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("agents", lambda folder: (folder / "__init__.py").write_text("from .theirs import *\n")),
        ("world", lambda folder: (folder / "__init__.py").unlink()),
        ("netem", shutil.rmtree),
    ],
    ids=["agents overwritten", "world without its __init__", "netem gone"],
)
def test_what_is_not_ours_is_named(
    name: str, change: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change(ours(tmp_path) / name)
    at(tmp_path, monkeypatch)
    text = foreign()
    place = f" in {tmp_path / name}" if (tmp_path / name).exists() else ""
    assert text.startswith(f"the package {name}{place} is not that of uuv-fleet, or not whole; install uuv-fleet into ")
    assert "\n" not in text


@pytest.mark.parametrize("name", ["agents", *slow("world", "netem")])
def test_the_command_says_whose_it_is(name: str, tmp_path: Path) -> None:
    """In one line, without running anything of theirs."""
    done = python(*OURS, "list", cwd=distribution(tmp_path, name), environment={"PYTHONPATH": str(tmp_path)})
    assert (done.returncode, done.stdout) == (3, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"fleet: the package {name} in {tmp_path / name} is that of impostor, or mixed ")


def test_files_that_are_missing_within_are_noticed_where_they_are_imported(tmp_path: Path) -> None:
    """Somebody else's package was in the same place, and was taken away with the files that both had."""
    shutil.copytree(ROOT / "agents", tmp_path / "agents", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "agents" / "plugins" / "laws.py").unlink()
    done = python(*OURS, "check", "paper", cwd=tmp_path, environment={"PYTHONPATH": str(tmp_path)})
    assert (done.returncode, len(done.stderr.splitlines())) == (3, 1), done.stderr
    assert "not whole: No module named 'agents.plugins.laws'; install uuv-fleet into " in done.stderr
    assert damaged_package(ImportError("no module", name="numpy")) == damaged_package(ImportError("no module")) == ""


def test_a_plug_in_notices_it_at_its_first_import(tmp_path: Path) -> None:
    """What is left of ours beside somebody else's files would seem to work."""
    shutil.copytree(ROOT / "agents", tmp_path / "agents", ignore=shutil.ignore_patterns("__pycache__"))
    there = {"cwd": tmp_path, "environment": {"PYTHONPATH": str(tmp_path)}}
    for begin, status in (('"""Agents: ours."""', 0), ("import logging", 1)):
        (tmp_path / "agents" / "__init__.py").write_text(f"{begin}\n")
        done = python("-c", "import agents.api", **there)
        assert done.returncode == status, done.stderr
    assert done.stderr.splitlines()[-1].startswith(f"ImportError: the package agents in {tmp_path / 'agents'} is not ")
    assert python("-OO", "-c", "import agents.api", **there).returncode == 0  # there docstrings are not kept
