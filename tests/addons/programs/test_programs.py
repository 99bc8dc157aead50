"""What a scenario says of a program: its file, its keys, what lies beside it, and who may run it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from textwrap import dedent

import pytest
from own_program import RunProgram, lines, scenario
from tool import invoke

import fleet
from fleet.errors import ScenarioError
from fleet.result.result import Result, Status

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
END = "end: exit status 0"


def test_time_is_simulated_and_chance_is_seeded(run: RunProgram) -> None:
    text = """
        import datetime, os, random, secrets, sys, time, uuid
        print(time.monotonic(), time.time() - 1767225600)
        time.sleep(0.5)
        print(time.perf_counter(), time.monotonic_ns(), datetime.datetime.now(), time.strftime("%Y %H:%M:%S"))
        print(random.random(), random.Random().random(), uuid.uuid4(), uuid.uuid1(), secrets.token_hex(2))
        print(os.urandom(2))
        print(sys.argv[1:], os.getpid(), f"{int(sys.argv[1])} v")
    """
    first = run(text)
    assert first.status is Status.PASS, (first.reason, first.lines)
    one = lines(first)
    assert one[0].startswith("1000.0 0.0")
    assert one[1] == "1000.5 1000500000000 2026-01-01 00:00:00.500000 2026 00:00:00"
    assert one[4] == "['1'] 1001 1 v"
    assert lines(run(text)) == one and one[2] != lines(first, 2)[2]


def test_a_signal_has_no_value_before_its_line(run: RunProgram) -> None:
    result = run("import time\ntime.sleep(1)\nprint('-1 v')\ntime.sleep(9)\n")
    assert result.directory is not None
    values = fleet.open_log(result.directory)["uuv/1/control"]["v"]
    assert values[0] != values[0] and values[-1] == -1.0


def test_a_program_that_was_changed_a_moment_ago_is_the_new_one(run: RunProgram) -> None:
    """Python's cache knows a file by its size and the second."""
    assert [lines(run(f"print({n})")) for n in range(3)] == [[str(n), END] for n in range(3)]


def test_modules_beside_it_are_the_programs_own(run: RunProgram, tmp_path: Path) -> None:
    """Each agent, and each life, has its own state."""
    (tmp_path / "beside").mkdir()
    (tmp_path / "beside" / "__init__.py").write_text("from .state import seen\n")
    (tmp_path / "beside" / "state.py").write_text("import time\nseen = []\nloaded = time.monotonic()\n")
    text = """
        import sys, json
        import beside.state as state
        from beside import seen
        seen.append(sys.argv[1])
        print(seen is state.seen, seen, state.loaded, json.dumps([1]), f"{len(seen)} v")
    """
    result = run(text)
    assert [lines(result, agent)[0] for agent in (1, 2)] == [f"True ['{i}'] 1000.0 [1] 1 v" for i in (1, 2)]
    assert "beside" not in sys.modules and not (tmp_path / "beside" / "__pycache__").exists()


def test_a_module_of_a_package_is_a_program(run: RunProgram, tmp_path: Path) -> None:
    (tmp_path / "pack" / "deep").mkdir(parents=True)
    for name in ("pack/__init__.py", "pack/deep/__init__.py"):
        (tmp_path / name).write_text("")
    (tmp_path / "pack" / "other.py").write_text("WORD = 'relative'\n")
    (tmp_path / "pack" / "deep" / "node.py").write_text(
        "from ..other import WORD\nprint(WORD, __name__, __package__)\n"
    )
    run("pass")
    text = (tmp_path / "own.yaml").read_text().replace("program: program.py", "program: {module: pack.deep.node}")
    (tmp_path / "own.yaml").write_text(text)
    assert lines(fleet.run("own.yaml", out=tmp_path / "runs")) == ["relative __main__ pack.deep", END]
    (tmp_path / "own.yaml").write_text(text.replace("pack.deep.node", "pack.none"))
    with pytest.raises(ScenarioError, match=r"pack/none\.py"):
        fleet.run("own.yaml")


def test_a_kill_runs_no_finally(run: RunProgram, tmp_path: Path) -> None:
    text = """
        import random, sys, time
        try:
            print("life", time.monotonic(), random.random())
            while True:
                time.sleep(0.1)
        finally:
            print("finally")
    """
    run(text)
    (tmp_path / "program.py").write_text(dedent(text))
    said = lines(fleet.run("own.yaml", out=tmp_path / "runs", fault=["at 1s for 500ms kill 1"]))
    assert [line.split()[:2] for line in said] == [["life", "1000.0"], ["life", "1001.5"]], said
    assert said[0].split()[2] != said[1].split()[2]


def test_the_template_runs_and_passes_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert invoke("new", "program", "greatest").exit_code == 0
    result = fleet.run("greatest.yaml")
    assert result.status is Status.PASS, (result.reason, result.checks)
    assert invoke("check", "greatest_stack.yaml").exit_code == 0


def test_mistakes_are_told_where_they_are(run: RunProgram) -> None:
    for key, value, words in (
        ("order", "seeded", "order: callbacks of asyncio run in asyncio's own order"),
        ("cost", "2 ms", "cost: computing takes no time"),
        ("cots", "1", "there is no key 'cots'"),
        ("interpreter", "nobody-has-this", "there is no command 'nobody-has-this'"),
        ("epoch", "yesterday", "epoch: Invalid isoformat string"),
        ("files", "[nope.txt]", "files: there is no nope.txt in"),
        ("env", "[A=1]", "env: expected {NAME: value}"),
        ("vehicle", "ros1", "vehicle: expected ros2"),
        ("law", "x", "agent.program and agent.law are both given"),
    ):
        with pytest.raises(ScenarioError, match=words):
            run("pass", **{key: value})
    with pytest.raises(ScenarioError, match="line is no regular expression"):
        run("pass", signal="(")


def test_keys_of_before_that_need_nothing_any_more_are_taken(run: RunProgram) -> None:
    assert lines(run("print('there')", order="ready", shared="[json]", process="yes")) == ["there", END]


def test_a_log_runs_no_program_of_mine_unasked(
    run: RunProgram, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result: Result = run("print('0 v')")
    mark, elsewhere = tmp_path / "mark", tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "program.py").write_text(f"open({str(mark)!r}, 'w')\n")
    assert result.directory is not None
    log = shutil.copytree(result.directory, elsewhere / "run")
    shutil.copy(elsewhere / "program.py", log)
    monkeypatch.chdir(elsewhere)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "of-somebody-else"))
    refused = invoke("verify", log)
    assert refused.exit_code == 2 and "--trust runs it" in refused.stderr, refused.output
    assert not mark.exists()


def test_programs_differ_by_vehicle_and_go_beside_laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.py").write_text("import time\ntime.sleep(1)\nprint('one')\n")
    (tmp_path / "two.sh").write_text("#!/bin/sh\nsleep 1\necho two $1\n")
    (tmp_path / "two.sh").chmod(0o755)
    (tmp_path / "own.yaml").write_text(
        dedent("""
        name: own
        title: two programs and a law
        vehicles: 3
        duration: 2 s
        reference: {start: 0 0 10 m, velocity: 0.5 0 0 m/s}
        formation: {shape: line, spacing: 8 m}
        graph: {shape: complete}
        network: {period: 100 ms, links: {"*": delay 20ms}}
        initial: {scatter: 0.5 m, around: reference}
        per_vehicle:
          1: {agent: {program: one.py}}
          2: {agent: {program: two.sh, arguments: ["{seed}"]}}
        """).strip()
    )
    result = fleet.run("own.yaml", out=tmp_path / "runs")
    assert lines(result) == ["one", END] and lines(result, 2) == ["two 1", END]
    assert result.directory is not None
    assert fleet.open_log(result.directory)["uuv/3/command"]["tau"][-1].any()  # the law steers


def test_vehicles_that_all_have_programs_need_no_other_agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.py").write_text("print('one')\n")
    (tmp_path / "own.yaml").write_text(
        "name: own\ntitle: all\nvehicles: 3\nduration: 1 s\nmoored: true\ngraph: {shape: complete}\n"
        'network: {period: 100 ms, links: {"*": delay 20ms}}\n'
        'per_vehicle: {1: {agent: {program: one.py}}, "2-3": {agent: {program: one.py}}}\n'
    )
    assert lines(fleet.run("own.yaml", out=tmp_path / "runs"), 3) == ["one", END]


def test_a_pause_is_a_gap_as_with_a_program_that_is_stopped(run: RunProgram, tmp_path: Path) -> None:
    """Its clock has gone on, its timers are late: it does not live again what it has missed."""
    text = """
        import threading, time
        def tick(name, s):
            while True:
                time.sleep(s)
                print(name, round(time.monotonic() - 1000, 2))
        threading.Thread(target=tick, args=("slow", 0.5)).start()
        tick("quick", 0.25)
    """
    run(text)
    (tmp_path / "program.py").write_text(dedent(text))
    said = lines(fleet.run("own.yaml", out=tmp_path / "runs", fault=["at 0.6s for 1.5s pause 1"]))
    quick = [float(line.split()[1]) for line in said if line.startswith("quick")]
    assert quick == [0.25, 0.5, 2.1, 2.35, 2.6, 2.85]
    assert [line.split()[1] for line in said if line.startswith("slow")] == ["0.5", "2.1", "2.6"]


def test_the_node_of_a_vehicle_that_ends_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here there is no rclpy for it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rclpy.py").write_text("raise ImportError('none is here')\n")
    (tmp_path / "program.py").write_text("import time\ntime.sleep(99)\n")
    (tmp_path / "own.yaml").write_text(scenario(vehicle="ros2", env=f"{{PYTHONPATH: {tmp_path}}}"))
    result = fleet.run("own.yaml", out=tmp_path / "runs")
    assert lines(result)[-1] == "failed: the node of its vehicle has ended, see its lines"
    assert "err: ImportError: none is here" in lines(result)


LAW = """
from agents.api import FormationAgent, Signal, UdpPort


class Talks:
    signals = (Signal("heard", "1", "answers of programs"),)

    def __init__(self, config):
        self._formation, self._port, self._heard = FormationAgent(config), UdpPort(config, 9000), 0

    def transmit(self, nav):
        return self._port.send(b"ping " + b"x" * 3000)

    def decide(self, nav, deliveries):
        self._heard += sum(one.data.startswith(b"pong") for one in self._port.receive(deliveries))
        return self._formation.decide(nav, ())[0], {"heard": self._heard}
"""
ANSWERS = """
import socket
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind(("", 9000))
for n in range(3):
    data, who = s.recvfrom(65536)
    print(len(data), who, flush=True)
    s.sendto(b"pong", who)
while True:
    s.recvfrom(65536)
"""


BOTH = """
title: A law and a program
vehicles: 2
moored: true
duration: 1 s
graph: {{shape: complete}}
network: {{period: 100 ms, links: {{"*": delay 20ms}}}}
agent: {agent}
per_vehicle: {{2: {{agent: {{program: {program}}}}}}}
"""


def test_laws_and_programs_of_one_scenario_hear_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both were accepted, and deaf to each other."""
    monkeypatch.chdir(tmp_path)
    Path("talks.py").write_text(LAW)
    Path("answers.py").write_text(ANSWERS)
    Path("both.yaml").write_text(BOTH.format(agent='{law: "talks:Talks"}', program="answers.py"))
    result = fleet.run("both.yaml", out=tmp_path / "runs", trust=True)
    assert result.status is Status.PASS, result.lines
    assert lines(result, 2)[:2] == ["3005 ('10.0.0.1', 9000)"] * 2
    assert result.vehicles["1"].signals["heard"].value == 3.0


def test_a_law_whose_payloads_no_program_hears_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("waits.py").write_text("import time\ntime.sleep(0.5)\n")
    law = "{law: 'fleet.protocols.average:ExactAverage'}"
    Path("both.yaml").write_text(BOTH.format(agent=law, program="waits.py"))
    result = fleet.run("both.yaml", out=tmp_path / "runs")
    assert result.directory is not None
    said = fleet.open_log(result.directory, ["said/*"])["said/2"]["message"].tolist()
    assert [text for text in said if "law of vehicle 1" in text] == [
        "no program hears what the law of vehicle 1 sends: UdpPort of agents.api makes packets"
    ]
