"""A script in a checkout runs its sources, and is told so if a compiled install is there as well."""

from __future__ import annotations

import importlib.metadata
import sysconfig
from importlib.util import find_spec
from pathlib import Path

import pytest
from repository import ROOT

import fleet
from fleet import cores

COMPILED = "world/dynamics" + sysconfig.get_config_var("EXT_SUFFIX")


class Installed(importlib.metadata.Distribution):
    def __init__(self, folder: Path, names: list[str]) -> None:
        self._folder, self._names = folder, names
        for name in names:  # Python 3.12 leaves out files that are missing
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).touch()

    def read_text(self, filename: str) -> str | None:
        return "".join(f"{name},,\n" for name in self._names) if filename == "RECORD" else None

    def locate_file(self, path: object) -> Path:
        return self._folder / str(path)


@pytest.fixture(params=[[COMPILED, "world/dynamics.py"], ["world/dynamics.py"]])
def compiled(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    names: list[str] = request.param
    installed = Installed(tmp_path / "site-packages", names)
    monkeypatch.setattr(importlib.metadata, "distributions", lambda **_: [installed])
    monkeypatch.setattr(cores, "find_spec", lambda _: find_spec("fleet.errors"))
    fleet._warn_of_hidden_cores.cache_clear()
    return len(names) == 2


def test_a_compiled_install_that_is_hidden_is_named(compiled: bool, tmp_path: Path) -> None:
    words = cores.hidden_cores()
    assert bool(words) == compiled
    if compiled:
        assert str(ROOT) in words and str(tmp_path / "site-packages") in words and "start from another folder" in words


def test_a_script_is_warned_once(compiled: bool, recwarn: pytest.WarningsRecorder) -> None:
    assert fleet.Result is not fleet.open_log  # two names that are loaded when they are used
    assert [str(one.message) for one in recwarn] == ([cores.hidden_cores()] if compiled else [])


def test_plain_python_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installation without a compiler keeps the reason; sources have none."""
    monkeypatch.setattr(cores, "cores", lambda: "plain Python")
    monkeypatch.setattr(cores, "_NOTE", tmp_path / "not_compiled.txt")
    assert cores.cores_and_reason() == "plain Python (these are sources, as an editable install uses them)"
    (tmp_path / "not_compiled.txt").write_text("there is no C compiler (cc)\n", "utf-8")
    assert cores.cores_and_reason() == "plain Python (at the installation: there is no C compiler (cc))"
    monkeypatch.setattr(cores, "cores", lambda: "compiled")
    assert cores.cores_and_reason() == "compiled"
