"""An add-on of somebody else, installed as a user would install it: its verb and its exporter are there."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from repository import ROOT

EXAMPLE = ROOT / "docs" / "examples" / "fleet_deepest"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What Python needs to find the add-on beside us, where pip has put it."""
    source, site = tmp_path_factory.mktemp("source") / "addon", tmp_path_factory.mktemp("site")
    shutil.copytree(EXAMPLE, source)
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--quiet", "--target", str(site), str(source)]
    subprocess.run(command, check=True, timeout=280)
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}


def fleet(environment: dict[str, str], *words: object) -> str:
    command = [sys.executable, "-m", "fleet", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=120).stdout


def test_its_verb_and_its_exporter(environment: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "runs"
    fleet(environment, "run", "paper", "--in-process", "--duration", "2 s", "--set", "checks={}", "--out", out, "-q")
    assert "\n  deepest     Say how deep each vehicle was.\n" in fleet(environment, "--help")
    assert fleet(environment, "deepest", out / "latest").count(" m\n") == 4
    assert json.loads(fleet(environment, "deepest", out / "latest", "--json"))["depths_m"].keys() == set("1234")
    assert '"depths_m"' in fleet(environment, "about", "--schemas", "deepest")
    (file,) = fleet(environment, "export", out / "latest", "--svg", tmp_path / "svg").splitlines()
    assert len(ElementTree.parse(file).getroot()) == 4
    assert "--svg DIR" in fleet(environment, "export", "--help")
