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
    def __init__(self, names: list[str]) -> None:
        self._names = names

    def read_text(self, filename: str) -> str | None:
        return "".join(f"{name},,\n" for name in self._names) if filename == "RECORD" else None

    def locate_file(self, path: object) -> Path:
        return Path("/env/site-packages") / str(path)


@pytest.fixture(params=[[COMPILED, "world/dynamics.py"], ["world/dynamics.py"]])
def compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    names: list[str] = request.param
    monkeypatch.setattr(importlib.metadata, "distributions", lambda **_: [Installed(names)])
    monkeypatch.setattr(cores, "find_spec", lambda _: find_spec("fleet.errors"))
    fleet._warn_of_hidden_cores.cache_clear()
    return len(names) == 2


def test_a_compiled_install_that_is_hidden_is_named(compiled: bool) -> None:
    words = cores.hidden_cores()
    assert bool(words) == compiled
    if compiled:
        assert str(ROOT) in words and "/env/site-packages" in words and "start from another folder" in words


def test_a_script_is_warned_once(compiled: bool, recwarn: pytest.WarningsRecorder) -> None:
    assert fleet.Result is not fleet.open_log  # two names that are loaded when they are used
    assert [str(one.message) for one in recwarn] == ([cores.hidden_cores()] if compiled else [])
