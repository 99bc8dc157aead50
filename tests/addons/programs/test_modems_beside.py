"""Modems of programs in simulated time: three languages, by port and by terminal, with the same bytes each time."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
import yaml
from repository import ROOT
from tool import invoke

import fleet
from fleet.addons.pictures.channel import transmissions
from fleet.addons.pictures.runs import load
from fleet.errors import ScenarioError
from fleet.result.file import read_result
from fleet.result.result import Result, Status

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
LESSON = (ROOT / "docs" / "learn" / "9-your-modem-code.md").read_text("utf-8")
BLOCKS = dict(re.findall(r"```(yaml|python)\n(.*?)```", LESSON, re.DOTALL)[::-1])  # the first of each language
WATER = {"acoustic": {"modem": "s2c", "queue": 4}}
PLACES = {"a": "0 0 10 m", "b": "900 0 10 m"}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def made(modems: dict[str, Any], programs: dict[str, Any], **more: Any) -> Result:
    nodes = {name: {"modem": modem, "place": PLACES[name]} for name, modem in modems.items()}
    stack: dict[str, Any] = {
        "title": "Modems", "clock": "simulated", "nodes": nodes, "programs": programs, "network": WATER,
        "duration": "12 s", "checks": {"programs": dict.fromkeys(programs, "done")},
    }  # fmt: skip
    Path("stack.yaml").write_text(yaml.safe_dump(stack | more), "utf-8")
    return fleet.run("stack.yaml", out="runs")


def printed(result: Result, agent: int) -> list[str]:
    assert result.directory is not None
    text = (result.directory / "log" / f"agent-{agent}.log").read_text("utf-8")
    return [re.sub(r"^[\d.]+ ", "", line) for line in text.splitlines()]


def test_the_lesson_in_simulated_time_the_same_bytes_in_each_way() -> None:
    pytest.importorskip("unetpy")
    Path("transfer.py").write_text(BLOCKS["python"], "utf-8")
    Path("water.yaml").write_text(BLOCKS["yaml"], "utf-8")
    first, again = (fleet.run("water.yaml", set={"clock": "simulated"}, out="runs") for _ in range(2))
    assert first.status is Status.PASS and first.digest == again.digest
    assert first.ledger["auv1->auv2"].delivered == 3
    command = invoke("run", "water.yaml", "--set", "clock=simulated", "--quiet")  # each agent a process of its own
    assert command.exit_code == 0, command.output
    assert read_result(Path(command.stdout.strip())).digest == first.digest
    assert invoke("verify", command.stdout.strip()).exit_code == 0
    assert first.directory is not None
    drawn = load([first.directory])[0]
    assert drawn.scenario is not None and drawn.scenario.acoustic is not None
    longest = drawn.scenario.acoustic.modem.airtime_ns(61) / 1e9  # a block and its number: the envelope weighs nothing
    assert max(one.airtime for one in transmissions(drawn, drawn.log.links)) == pytest.approx(longest)
    lost = fleet.run("water.yaml", set={"clock": "simulated"}, fault=["at 1s for 3s mute auv2"], out="runs")
    assert [one.check for one in lost.checks if one.failed] == ["not-too-long"]


MICROMODEM = """
    import os, sys, tty
    path, own, other = sys.argv[1:]
    port = os.open(path, os.O_RDWR | os.O_NOCTTY)
    os.write(port, f"$CCCFG,SRC,{own}\\r\\n".encode())
    rest, asked = b"", own == "2"
    while b"$CAMPR" not in rest and b"$CAMPA" not in rest:
        rest += os.read(port, 4096)
        if not asked and b"CACFG" in rest:
            asked = True
            os.write(port, f"$CCMPC,1,{other}\\r\\n".encode())
    print(next(line for line in rest.decode().splitlines() if line.startswith("$CAMP") and "CAMPC" not in line))
"""


@pytest.mark.parametrize("terminal", ["tty", "/tmp/ttyAUV"])  # the program's own /tmp
def test_a_micromodem_on_a_terminal_measures_a_range(terminal: str) -> None:
    """900 m are 0.6 s."""
    Path("ping.py").write_text(dedent(MICROMODEM), "utf-8")
    modems = {name: {"micromodem": terminal + name} for name in PLACES}
    programs = {"a": {"run": ["python", "ping.py", "{modem}", "1", "2"]},
                "b": {"run": ["python", "ping.py", "{modem}", "2", "1"]}}  # fmt: skip
    first, again = made(modems, programs), made(modems, programs)
    assert first.status is Status.PASS and first.digest == again.digest
    assert printed(first, 1)[0].startswith("$CAMPR,2,1,0.6000*") and printed(first, 2)[0].startswith("$CAMPA,1,2*")
    assert not Path("/tmp/ttyAUVa").is_symlink()


EVOLOGICS = """
    import socket, sys
    own, other = sys.argv[2:]
    modem = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
    if own == "1":
        modem.sendall(f"+++AT*SENDIM,5,{other},ack,hello\\n".encode())
    text = b""
    while b"DELIVEREDIM" not in text and b"RECVIM" not in text:
        text += modem.recv(4096)
    print(text.decode().strip().splitlines()[-1])
"""


def test_evologics_delivers_an_instant_message() -> None:
    Path("im.py").write_text(dedent(EVOLOGICS), "utf-8")
    modems = {"a": {"evologics": 0}, "b": {"evologics": 0}}
    programs = {name: {"run": ["python", "im.py", "{modem}", own, other]}
                for name, own, other in (("a", "1", "2"), ("b", "2", "1"))}  # fmt: skip
    result = made(modems, programs)
    assert result.status is Status.PASS
    assert "DELIVEREDIM" in printed(result, 1)[0]
    assert printed(result, 2)[0].startswith("+++AT") or "RECVIM" in printed(result, 2)[0]


def test_a_buoy_without_a_program_answers_and_a_modem_outlives_its_program() -> None:
    """The program gives its modem a request, and ends at once."""
    Path("once.py").write_text(dedent("""
        import os, sys
        port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
        os.write(port, b"$CCMPC,1,2\\r\\n")
    """), "utf-8")  # fmt: skip
    modems = {name: {"micromodem": f"tty{name}"} for name in PLACES}
    result = made(modems, {"a": {"run": ["python", "once.py", "ttya"]}})
    assert result.status is Status.PASS and printed(result, 1) == ["end: exit status 0"]
    assert (result.ledger["a->b"].delivered, result.ledger["b->a"].delivered) == (1, 1)


@pytest.mark.parametrize(
    ("modem", "words"),
    [
        ("unet", "modem: expected a language and a port, got 'unet'"),
        ({"unet": 0}, "modem: expected a language with a port that is not 0, or with a path"),
        ({"unit": 1100}, "modem.unit: "),
        ({"unet": 99999}, "modem.unet: "),
    ],
)
def test_a_modem_that_is_none_is_told(modem: Any, words: str) -> None:
    Path("p.py").write_text("", "utf-8")
    Path("one.yaml").write_text(yaml.safe_dump({
        "title": "one", "vehicles": 2, "moored": True, "duration": "1 s", "graph": {"shape": "complete"},
        "network": {"period": "100 ms"} | WATER, "agent": {"program": "p.py", "modem": modem},
    }), "utf-8")  # fmt: skip
    with pytest.raises(ScenarioError, match=re.escape(words)):
        fleet.run("one.yaml")


def test_the_example_of_modems_that_talk_at_random(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("unetpy")
    shutil.copytree(ROOT / "docs" / "examples" / "aloha_stack", tmp_path / "aloha")
    monkeypatch.chdir(tmp_path / "aloha")
    result = fleet.run("stack.yaml", set={"clock": "simulated", "duration": "20 s", "tick": "50 ms"}, out="runs")
    assert result.status is Status.PASS and result.notes == []
    sent = sum(link.sent for link in result.ledger.values())
    assert 0 < sum(link.delivered for link in result.ledger.values()) < sent
