"""Programs and libraries of others, unchanged: each does its work in simulated time, with the same bytes each time.

Those that need packages: `pip install -r tests/addons/programs/corpus/requirements.txt`, and of Debian
redis-server, mosquitto, iperf3, socat, ncat. What is not there is skipped, with its name.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pytest
import yaml

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario
from world.plugins.trust import trusting

CORPUS = Path(__file__).parent / "corpus"
ENTRIES: list[dict[str, Any]] = json.loads((CORPUS / "programs.json").read_text("utf-8"))
COMMANDS = {"redis-server": "redis-server", "mosquitto-clients": "mosquitto_pub", "nats-server": "nats-server"}
COMPILERS = {"c_threads": "cc", "c_timerfd": "cc", "cxx_condition": "c++"}

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")


def missing(entry: dict[str, Any]) -> str:
    """What an entry needs and is not there; "": nothing."""
    for need in entry["needs"]:
        kind, _, name = need.partition(":")
        if kind == "pip":
            try:
                version(name)
            except PackageNotFoundError:
                return need
        elif kind == "npm" or shutil.which(COMMANDS.get(name, name)) is None:
            return need
    command = entry["run"][0]
    known = command == "{python}" or (CORPUS / command).exists() or command in COMPILERS
    return "" if known or shutil.which(command) else command


def scenario(entry: dict[str, Any], folder: Path, loss: str) -> Path:
    """Write a scenario whose agents all run an entry."""
    command, *rest = entry["run"]
    agent: dict[str, Any] = {"process": True, "env": {"PYTHON": sys.executable}}
    if command in COMPILERS:
        (source,) = CORPUS.glob(f"{command}.c*")
        program = folder / command
        subprocess.run([COMPILERS[command], "-O1", "-pthread", "-o", str(program), str(source)], check=True)
    elif (CORPUS / command).exists():
        program = CORPUS / command
    else:
        agent["interpreter"] = sys.executable if command == "{python}" else command
        program, rest = CORPUS / rest[0], rest[1:]
    network = {"period": "10 ms", "links": {"*": f"delay 10ms loss {loss}"}}
    text = {
        "name": "corpus", "title": entry["name"], "vehicles": entry["agents"], "moored": True, "tick": "10 ms",
        "duration": f"{entry['seconds'] + 4} s", "graph": {"shape": "complete"}, "network": network,
        "agent": agent | {"program": str(program), "arguments": rest},
    }  # fmt: skip
    path = folder / "corpus.yaml"
    path.write_text(yaml.safe_dump(text))
    return path


def printed(result: Result) -> str:
    assert result.directory is not None
    logs = sorted((result.directory / "log").glob("agent-*.log"))
    return re.sub(r"(?m)^[\d.]+ (err: )?", "", "\n".join(path.read_text("utf-8", "replace") for path in logs))


@pytest.mark.parametrize(
    "entry",
    [pytest.param(each, id=each["name"]) for each in ENTRIES],
)
def test_it_does_its_work_and_repeats(entry: dict[str, Any], tmp_path: Path) -> None:
    if lacks := missing(entry):
        pytest.skip(f"{lacks} is not there")
    path = scenario(entry, tmp_path, "0%")
    first = fleet.run(path, out=tmp_path / "runs", trust=True)
    text = printed(first)
    if entry.get("go"):
        assert "is a program of Go, which is refused in simulated time" in text
        return
    assert first.status is Status.PASS, (first.reason, text[-2000:])
    assert not [line for line in entry["expect"] if not re.search(line, text, re.MULTILINE)], text[-2000:]
    if entry.get("reads_host"):
        return  # it sends figures of the host, such as the memory that it has
    assert fleet.run(path, out=tmp_path / "runs", trust=True).digest == first.digest
    if entry["needs"]:
        with trusting(True):
            distributed = execute(load_scenario(str(path)), Options(tmp_path / "runs", quiet=True))
        assert distributed.digest == first.digest
        path = scenario(entry, tmp_path, "20%")
        once, again = (fleet.run(path, out=tmp_path / "runs", trust=True) for _ in range(2))
        assert once.digest == again.digest and printed(once) == printed(again)
