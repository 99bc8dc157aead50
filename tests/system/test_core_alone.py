"""The core needs no add-on: its main path works where `fleet.addons` cannot be imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from live import LiveRun

from fleet.logs.open_log import open_log

# Python imports a module of this name at each start, also in the processes of a run.
WITHOUT = """
import sys


class Refused:
    def find_spec(self, name, path=None, target=None):
        if name == "fleet.addons" or name.startswith("fleet.addons."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Refused())
"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a process that has no add-ons."""
    folder = tmp_path_factory.mktemp("without")
    (folder / "sitecustomize.py").write_text(WITHOUT)
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


def fleet(alone: dict[str, str], *words: object, status: int = 0) -> str:
    """What a command prints on stdout."""
    command = [sys.executable, "-m", "fleet", *map(str, words)]
    done = subprocess.run(command, env=os.environ | alone, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout if not status else done.stderr


def test_the_main_path(alone: dict[str, str], tmp_path: Path) -> None:
    """A live run with an injected fault, and then all that one does with its log."""
    out = tmp_path / "runs"
    with LiveRun(out, "paper", "--speed", "2", "--set", "checks={}", environment=alone) as run:
        run.until_running()
        fleet(alone, "inject", "kill", "2", "--run", out / "latest")
        fleet(alone, "stop", out / "latest")
        run.status()
    log = out / "latest"
    assert any(fault.what.startswith("kill") for fault in open_log(log).faults)
    assert json.loads(fleet(alone, "info", log, "--json"))["messages"] > 100
    assert json.loads(fleet(alone, "verify", log, "--json"))["reproduced"]
    fleet(alone, "replay", log, "--speed", "0", "-q")
    cut = tmp_path / "cut.mcap"
    whole = (log / "run.mcap").read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    fleet(alone, "recover", cut, status=3)
    assert fleet(alone, "export", log, "--csv", tmp_path / "tables").count(".csv") > 3


def test_a_verb_of_an_add_on_is_missed_with_the_reason(alone: dict[str, str]) -> None:
    assert "sweep" not in fleet(alone, "--help")
    said = fleet(alone, "sweep", "paper", status=2)
    assert "there is no command " in said and "add-ons that are left out: hosts, learning, page" in said
    assert "No module named 'fleet.addons'" in said
