"""`fleet protocol check` and the agent in docs/examples, which is written with zenoh and msgpack alone.

The example passes every check and completes a real run as an external vehicle. Each way of breaking it fails the check
that is about that, and no agent can make the check hang.
"""

from __future__ import annotations

import ast
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from free_ports import free_port
from live import LiveRun
from repository import ROOT
from waiting import wait_for

from fleet.addons.hosts.protocol import conformance
from fleet.addons.hosts.protocol.conformance import CHECKS, Examination, ProtocolCheck
from fleet.errors import FleetError
from fleet.execution.rendezvous import JoinFolder, KeyPair, Rendezvous
from fleet.repeat.verify import verification_lines, verify
from fleet.scenario.loading import load_scenario

EXAMPLE = ROOT / "docs" / "examples" / "foreign_agent.py"
SOURCE = EXAMPLE.read_text("utf-8")
LIMIT_S = 60.0


def start(*arguments: str) -> subprocess.Popen[str]:
    """A Python process that does not find this project's packages, unless they are asked for."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
    )


def examine(file: Path, *agent: str, port: int | None = None) -> dict[str, ProtocolCheck]:
    """The verdicts on an agent that is started once the join file is there."""
    started: list[subprocess.Popen[str]] = []
    try:
        examination = Examination(load_scenario("paper"), 3, file, port=port)
        found = examination.run(LIMIT_S, lambda _: started.append(start(*agent, str(file))))
    finally:
        for process in started:
            process.kill()
            print(process.communicate()[0])
    assert not file.exists()
    assert [check.what for check in found] == list(CHECKS)
    return {check.what: check for check in found}


def test_the_example_needs_nothing_of_ours_and_is_short() -> None:
    imported = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(SOURCE))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names])
    }
    assert imported - set(sys.stdlib_module_names) == {"zenoh", "msgpack"}
    assert len(SOURCE.splitlines()) < 100


def test_the_example_and_our_agent_pass(tmp_path: Path) -> None:
    agents = [str(EXAMPLE)], ["-m", "fleet", "agent", "--join"]
    with ThreadPoolExecutor() as pool:
        both = [pool.submit(examine, tmp_path / f"{n}.json", *agent) for n, agent in enumerate(agents)]
    for found in both:
        assert [str(check) for check in found.result().values() if not check.passed] == []


# What is changed in the example, and the check that must notice.
BROKEN = {
    "answers before its inbox is there": ("nav <= known", "True", conformance.LATE),
    "takes a part for the whole": ("known if more else until", "until", conformance.PARTS),
    "sends nothing": ('if tick % own["round_ticks"] == 0:', "if False:", conformance.TRANSMITS),
    "sends at every tick": ('if tick % own["round_ticks"] == 0:', "if True:", conformance.TRANSMITS),
    "transmits after its command": (
        "            if tick %",
        '            cmd(msgpack.packb(["cmd", life, tick, tau, []]))\n            if tick %',
        conformance.TRANSMITS,
    ),
    "answers twice": (
        "            nav = None",
        '            nav = None\n            cmd(msgpack.packb(["cmd", life, tick, tau, []]))',
        conformance.UNASKED,
    ),
    "does not look for damage": (
        'if len(data) == 63 and zlib.crc32(data[:-4]) == int.from_bytes(data[-4:], "little"):',
        "if True:",
        conformance.DAMAGED,
    ),
    "dies of junk": ("    except Exception as error:", "    except ImportError as error:", conformance.MALFORMED),
    "answers for an earlier life": ("fields[0] == life and", "", conformance.EARLIER),
    "says hello without end": ("in (cmd, tx):", "in (cmd, tx) * 100:", conformance.HELLO),
    "is of another life": ('told["incarnation"]', "0", conformance.HELLO),
    "commands one number less": ("tau, velocity = law", "(*tau, _), velocity = law", conformance.FORM),
    "commands a life that it has not": ('["cmd", life,', '["cmd", life + 1,', conformance.COMMANDS),
    "has no token": ("token = session.liveliness", "token = lambda *_: session.liveliness", conformance.TOKEN),
    "does not see the echoes": ('{"world", "netem"}:', '{"somebody else"}:', conformance.READY),
    "stays": ("session.close()\nprint", "import time; time.sleep(100)\nprint", conformance.ENDS),
}


HOWS = [pytest.param(how, marks=[pytest.mark.slow] if "echoes" in how else []) for how in BROKEN]
PATIENCES_S = (1.0, 10.0, 60.0)  # for those that never answer; more of it on a machine on which all answer late


def examine_broken(how: str, folder: Path, port: int) -> list[ProtocolCheck]:
    """The checks that an agent fails that is broken in one way."""
    before, after, _ = BROKEN[how]
    assert before in SOURCE
    program = folder / "broken.py"
    program.write_text(SOURCE.replace(before, after), "utf-8")
    found = examine(folder / "join-3.json", str(program), port=port)
    return [check for check in found.values() if check.passed is False]


Examined = Callable[[str, float], list[ProtocolCheck]]


@pytest.fixture(scope="module")
def examined(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Examined:
    """Examines an agent with a given patience. With the least patience, it examines all agents at the same time."""
    mine = [item for item in request.session.items if item.path == request.path]
    wanted = [how for how in BROKEN if any(item.name.endswith(f"[{how}]") for item in mine)]
    folders = {how: tmp_path_factory.mktemp("broken") for how in BROKEN}
    known: dict[str, list[ProtocolCheck]] = {}

    def examine_all(hows: list[str], patience_s: float) -> None:
        ports: set[int] = set()
        while len(ports) < len(hows):
            ports.add(free_port())
        with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor(len(hows)) as pool:
            patch.setattr(conformance, "ANSWER_S", patience_s)
            patch.setattr(conformance, "SILENCE_S", 0.1)
            found = pool.map(examine_broken, hows, map(folders.__getitem__, hows), ports)
            known.update(zip(hows, found, strict=True))

    def examined(how: str, patience_s: float) -> list[ProtocolCheck]:
        if not known:
            examine_all(wanted, PATIENCES_S[0])
        if patience_s > PATIENCES_S[0]:
            examine_all([how], patience_s)
        return known[how]

    return examined


@pytest.mark.parametrize("how", HOWS)
def test_a_broken_agent_fails_the_right_check(how: str, examined: Examined) -> None:
    blamed = BROKEN[how][2]
    for patience_s in PATIENCES_S:
        failed = examined(how, patience_s)
        assert all(check.expected and check.got for check in failed)
        if blamed in (whats := [check.what for check in failed]):
            break
    assert blamed in whats, failed


def test_a_slow_agent_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that answers too early, but later than the least silence: as on a busy machine."""
    monkeypatch.setattr(conformance, "SILENCE_S", 0.05)
    before, after, blamed = BROKEN["takes a part for the whole"]
    slow = SOURCE.replace(before, after).replace(
        "tau, velocity = law", "_ = __import__('time').sleep(0.2)\n            tau, velocity = law"
    )
    program = tmp_path / "slow.py"
    program.write_text(slow, "utf-8")
    assert examine(tmp_path / "join-3.json", str(program))[blamed].passed is False


def test_what_the_check_needs(tmp_path: Path) -> None:
    """Somebody who comes, and a folder that is not in the way."""
    file = tmp_path / "join-3.json"
    with pytest.raises(FleetError, match=r"^no agent came within 0\.05 s"):
        Examination(load_scenario("paper"), 3, file).run(0.05, lambda _: None)
    assert not file.exists()

    file.with_suffix("").mkdir()  # where an agent with a certificate would find what it needs
    with pytest.raises(FleetError, match="no agent came"):
        Examination(load_scenario("paper"), 3, file).run(0.05, lambda _: None)
    meeting = Rendezvous(folders={3: JoinFolder(3, (), 0, "", KeyPair("", ""))})
    with pytest.raises(FleetError, match=r"join-3 is there already"):
        Examination(load_scenario("paper"), 3, file, meeting=meeting)


@pytest.mark.slow
def test_the_example_completes_a_run(tmp_path: Path) -> None:
    """A fleet with a stranger in it: it forms, every packet is accounted for, and its topics without telemetry stay
    empty."""
    arguments = ["--set", "per_vehicle={3: {external: true}}", "--duration", "12 s"]
    arguments += ["--set", "checks={formation_error: {below: 3 m, after: 10 s}, ledger: balanced}"]
    with LiveRun(tmp_path / "runs", "paper", *arguments, "--set", "log={every: 10 ticks, command: 1 tick}") as run:
        path = run.out / "latest" / "join-3.json"
        wait_for(lambda: run.over or path.exists(), LIMIT_S, "the join file")
        process = start(str(EXAMPLE), str(path))
        said, _ = process.communicate(timeout=LIMIT_S)
        assert (process.returncode, said) == (0, "the run is over\n")
        assert run.status() == 0, run.printed
        result = json.loads((run.directory / "result.json").read_text())
        assert (result["rejected"], result["notes"]) == ({}, [])
        assert result["vehicles"]["3"]["u_cmd_max_mps"] is None
        found = verify(run.log)
        assert (found.reproduced, found.external) == (True, (3,)), verification_lines(found)


@pytest.mark.slow
def test_the_example_takes_part_on_a_wall_clock_and_leaves_on_ctrl_c(tmp_path: Path) -> None:
    arguments = ["--set", "per_vehicle={3: {external: true}}", "--duration", "8 s", "--max-missed", "1"]
    conformance = "checks={tumbled: waived, deaths: {at_most: 1}}"  # its own
    arguments += ["--set", conformance, "--clock", "real", "--speed", "2", "--set", "on_death=continue"]
    with LiveRun(tmp_path / "runs", "paper", *arguments) as run:
        path = run.out / "latest" / "join-3.json"
        wait_for(lambda: run.over or path.exists(), LIMIT_S, "the join file")
        process = start(str(EXAMPLE), str(path))
        run.until_running(3.0)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=LIMIT_S)
        assert process.returncode == 130
        assert run.status() == 0, run.printed
    result = json.loads((run.directory / "result.json").read_text())
    assert result["deaths"] == {"3": ["left: its session ended"]}
    kept = result["timing"]["vehicles"]["3"]
    # It does not wait for what is not said: then it would answer nothing. How much comes in time is the machine's.
    assert 300 <= kept["asked"] < 800 and kept["missed"] < kept["asked"]
