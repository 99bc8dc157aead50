"""Files of nodes in simulated time: the programs of the examples, unchanged, with the same words and verdicts."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from repository import ROOT
from study_engine import Here, Rows
from tool import invoke

import fleet
from fleet.addons.programs.udp_ways import UdpWays
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import CheckRow, Row
from fleet.addons.studies.shrink import Shrinker
from fleet.errors import ScenarioError
from fleet.quantities import show_time
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.trust import Policy

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
EXAMPLES = ROOT / "docs" / "examples"
SIMULATED = {"clock": "simulated"}


@pytest.fixture
def stack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Copies an example, and goes into its folder."""

    def copied(name: str) -> Path:
        shutil.copytree(EXAMPLES / name, tmp_path / name)
        monkeypatch.chdir(tmp_path / name)
        return tmp_path / name / "stack.yaml"

    return copied


def made(**changes: Any) -> Result:
    return fleet.run("stack.yaml", set=SIMULATED | changes, out="runs")


def verdict(result: Result, check: str) -> tuple[bool, str]:
    found = next(one for one in result.checks if one.check == check)
    return found.passed, found.found


@needs_cc
def test_udp_as_on_the_wall_clock_and_the_same_bytes_twice(stack: Any) -> None:
    """Blocks go over our ports, and acknowledgements go to the sender, which is our port that leads back."""
    stack("socket_stack")
    first, second = made(), made()
    assert first.status is Status.PASS and first.digest == second.digest
    assert verdict(first, "programs") == (True, "all 2")
    assert verdict(first, "arrives")[1].startswith("after ")
    assert [link for link in first.ledger if link != "*"] == ["shore->robot", "robot->shore"]
    command = invoke("netem", "stack.yaml", "--clock", "simulated", "--quiet")
    assert command.exit_code == 0, command.output
    run = Path(command.stdout.strip())
    assert json.loads((run / "result.json").read_text())["digest"] == first.digest
    assert invoke("verify", run).exit_code == 0
    assert invoke("run", "stack.yaml", "--in-process", "--quiet").exit_code == 0


@needs_cc
@pytest.mark.parametrize(
    ("checks", "words"),
    [
        ({"programs": {"shore": "running"}}, "shore ended at 4.20 s"),
        ({"programs": {"robot": "done"}}, "robot did not end"),
    ],
)
def test_programs_are_judged_by_the_names_of_nodes(checks: dict[str, Any], words: str, stack: Any) -> None:
    stack("socket_stack")
    passed, found = verdict(made(checks=json.dumps(checks)), "programs")
    assert not passed and words in found


@needs_cc
def test_the_moment_at_which_a_program_failed_is_that_of_the_check(stack: Any) -> None:
    """Without one, `fleet why` explained a failure at 4.2 s by what there was at 0 s."""
    stack("socket_stack")
    result = made(checks=json.dumps({"programs": {"*": "running"}}))
    check = next(one for one in result.checks if one.check == "programs")
    assert check.moment is not None and 4 < check.moment.at_s < 5 and check.moment.vehicles == [1]
    assert check.margin is not None and check.margin.value == -1


class AlwaysFails(Here):
    """Says of every valid run that its programs failed."""

    def rows(self, task: Task) -> Rows:
        try:
            parse_scenario(task.text, task.name, policy=Policy(""))
        except ScenarioError:
            return [Row(key=task.key, seed=task.seed, status="failed")]
        checks = {"programs": CheckRow(passed=False, value=1.0)}
        return [Row(key=task.key, seed=task.seed, status="check_failed", passed=False, checks=checks)]


@needs_cc
@pytest.mark.parametrize(("wanted", "duration"), [("done", "1 s"), ("running", "10 ms")])
def test_a_run_in_which_a_program_must_end_is_not_shortened(
    wanted: str, duration: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`fleet shrink` kept 10 ms of a transfer that takes seconds, and said that no fault is needed."""
    monkeypatch.chdir(tmp_path)
    Path("p.py").write_text("")
    programs, more = '{"*": {run: [python, p.py]}}', f"checks: {{programs: {wanted}}}"
    scenario = parse_scenario(STACK.format(a="{}", programs=programs, more=more), "stack.yaml", policy=Policy(""))
    found = Shrinker(scenario, AlwaysFails(), lambda doing, runs: None).shrink("programs")
    assert show_time(found.scenario.duration_ns) == duration


@needs_cc
def test_commands_without_a_path_need_no_more_trust_than_on_the_wall_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = Path("stack.yaml")
    file.write_text(STACK.format(a="{}", programs='{"*": {run: [sh, -c, "echo hello"]}}', more=DONE))
    result = fleet.run("stack.yaml", out="runs")
    assert verdict(result, "programs") == (True, "all 2")
    assert invoke("verify", result.directory).exit_code == 0
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    with pytest.raises(ScenarioError, match="lies outside of the current directory"):
        fleet.run("../stack.yaml", out="runs")


COUNTS = """
import os, sys, time
for n in range(3):
    print("line", os.environ["WHO"], flush=True)
    time.sleep(0.1)
if sys.argv[1] == "b":
    sys.exit("it went wrong")
time.sleep(99)
"""


@needs_cc
def test_a_program_that_fails_is_named_and_lines_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.py").write_text(COUNTS)
    Path("stack.yaml").write_text("""
title: Two
nodes: {a: {}, b: {}}
programs: {"*": {run: [python, p.py, "{node}"], env: {WHO: "{number} of {address}"}}}
signals: {lines: {line: "line", count: yes}}
duration: 1 s
""")
    result = made()
    passed, found = verdict(result, "programs")
    assert not passed and found.startswith("b at 0.30 s: ") and "it went wrong" in found
    assert result.vehicles["1"].signals["lines"].value == 3.0
    assert result.directory is not None
    assert "line 1 of 10.0.0.1" in (result.directory / "log" / "agent-1.log").read_text()


BLOCKS = """
import socket, sys, time
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.bind(("", 9000))
while sys.argv[1] == "b":
    print("mixed" if len(set(sock.recv(9999))) > 1 else "whole", flush=True)
while True:
    sock.sendto(bytes([int(time.monotonic() - 1000)]) * 4000, ("10.0.0.2", 9000))
    time.sleep(0.05)
"""


@needs_cc
def test_a_program_that_begins_again_does_not_complete_datagrams_of_its_former_life(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It numbered them from 1 again, and the parts that had arrived of the old ones were taken for its own."""
    monkeypatch.chdir(tmp_path)
    Path("blocks.py").write_text(BLOCKS)
    Path("stack.yaml").write_text("""
title: Blocks of three fragments
nodes: {a: {}, b: {}}
programs: {"*": {run: [python, blocks.py, "{node}"]}}
signals: {whole: {of: b, line: whole, count: yes}, mixed: {of: b, line: mixed, count: yes}}
network: {links: {"*": loss 40%}}
faults: [{at: 2 s, for: 500 ms, kill: a}, {at: 4 s, for: 500 ms, kill: a}]
duration: 6 s
""")
    signals = made().vehicles["2"].signals
    assert signals["whole"].value and not signals["mixed"].value


@needs_cc
def test_a_fault_names_nodes_and_zenoh_needs_no_word_of_ours(stack: Any) -> None:
    """The election, unedited: a router of zenoh for each member, and a member that is killed."""
    stack("election_stack")
    result = made(duration="3 s", faults="[{at: 2 s, for: 500 ms, kill: m2}]", checks="{}")
    assert result.status is Status.PASS, result.lines
    assert all(result.ledger[f"m{i}->m{i % 5 + 1}"].delivered for i in range(1, 6))
    assert result.ledger["m1->m2"].lost["dead receiver"] > 0


STACK = "title: T\nduration: 1 s\nclock: simulated\nnodes: {{a: {a}, b: {{}}}}\nprograms: {programs}\n{more}\n"
DONE = "checks: {programs: done}"
TRUE = '{"*": {run: "true"}}'


@pytest.mark.parametrize(
    ("a", "programs", "more", "words"),
    [
        ("{listen: tcp/127.0.0.1:7501}", TRUE, "", "nodes.a.listen: is of a real host"),
        ("{isolate: yes}", TRUE, "", "isolate is for the wall clock"),
        ("{}", '{a: {run: "true"}}', "", "nodes.b: has no program, and nobody joins simulated time"),
        ("{}", TRUE, "compose: x.yaml", "compose: has no meaning in simulated time"),
        ("{}", '{"*": {run: "x {zenoh}"}}', "", r"\{zenoh\} is a file or port of a real host"),
        ("{}", TRUE, "signals: {s: {message: k, ros: data}}", "messages of ROS 2 are not read in simulated time"),
    ],
)
def test_what_needs_a_real_host_is_refused_in_words(a: str, programs: str, more: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        parse_scenario(STACK.format(a=a, programs=programs, more=more), "stack.yaml")


def test_without_an_end_or_without_nodes_there_is_no_simulated_time() -> None:
    text = STACK.format(a="{}", programs=TRUE, more="").replace("duration: 1 s\n", "")
    with pytest.raises(ScenarioError, match="simulated time needs an end"):
        parse_scenario(text, "stack.yaml")
    with pytest.raises(ScenarioError, match="clock: has no effect without nodes"):
        load_scenario("paper", ["clock=simulated"])


def test_ports_of_the_own_host_stand_for_those_of_others() -> None:
    ways = UdpWays({"9201": [2, 9202], "9203": [3, 0]})
    assert (ways.way(9201), ways.way(9202), bool(ways)) == ((2, 9202), None, True)
    assert ways.arrives(2, 9300) == (9300, 9201)  # an answer to it comes to us
    assert ways.arrives(3, 0) is None  # nothing of the own has been sent there yet
    ways.sends(3, 40_000)
    assert ways.arrives(3, 0) == (40_000, 9203)


SEVERAL = """
title: Two programs of a node
clock: simulated
nodes: {m1: {}, m2: {}}
programs:
  m1/nav: {run: [python, count.py, "3", nav, "0"]}
  m1/log: {run: [python, count.py, "100", log, "{number}"]}
  m2: {run: [python, count.py, "100", one, "0"]}
signals: {counted: {of: m1, line: 'log (?P<value>\\d+)'}}
duration: 6 s
"""
COUNT = """
import sys, time
for k in range(int(sys.argv[1])):
    print(sys.argv[2], k, flush=True)
    time.sleep(1)
sys.exit(int(sys.argv[3]))
"""


@needs_cc
@pytest.mark.parametrize(
    ("checks", "line", "found"),
    [
        ('programs: {"*": running, m1/nav: done}', "", "all 2"),
        ("programs: running", "", "m1 at 3.00 s: exit status 1: count.py ended by itself"),
        ('programs: {"*": running, m1/nav: done}', 'nav, "0"', "m1 at 3.00 s: exit status 1: count.py: exit status 3"),
        ('programs: {"*": done, m2: running}', "", "m1 did not end"),
    ],
)
def test_several_programs_of_a_node_are_judged_one_by_one(
    checks: str, line: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They share a host. One that ends as it may lets the others go on; one that does not is a failure that says so."""
    monkeypatch.chdir(tmp_path)
    Path("count.py").write_text(COUNT)
    text = SEVERAL.replace(line, line.replace("0", "3")) if line else SEVERAL
    Path("stack.yaml").write_text(f"{text}checks: {{{checks}}}\n")
    first, again = (fleet.run("stack.yaml", out="runs") for _ in range(2))
    assert verdict(first, "programs") == (found == "all 2", found) and first.digest == again.digest
    assert first.directory is not None
    said = (first.directory / "log" / "agent-1.log").read_text()
    assert "2.000 nav 2\n2.000 log 2\n" in said


SAYS = """
import json, socket, sys, time
import zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
session, udp = zenoh.open(config), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for k in range(8):
    session.put(f"m/{sys.argv[2]}/depth", json.dumps({"d": [0, k / 2]}))
    session.put("other", b"no json")
    udp.sendto(bytes([k, 7]), ("127.0.0.1", 9000))
    time.sleep(0.5)
time.sleep(100)
"""
MESSAGES = """
title: Signals of messages
clock: simulated
nodes: {m1: {udp: {"9000": "m2:9100"}}, m2: {}}
programs: {m1: {run: [python, says.py, "tcp/127.0.0.1:7447", "{number}"]}, m2: {run: [sleep, "100"]}}
signals:
  depth: {of: m1, message: "m/{number}/depth", json: "d[1]"}
  wrong: {of: m1, message: other, json: x}
  sent: {of: m1, message: udp/9000, count: yes}
  byte: {of: m1, message: udp/9000, struct: "<BB[0]"}
duration: 6 s
checks:
  signal:
    - {name: deep, topic: depth, below: 3.6}
    - {name: never, topic: depth, below: 3}
    - {name: all, topic: sent, equals: 8, within: 0, eventually_within: 5 s}
    - {name: first, topic: byte, equals: 7, within: 0, eventually_within: 5 s}
"""


@needs_cc
def test_messages_tell_signals_as_on_the_wall_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By zenoh and by UDP. A message without the number is told once."""
    monkeypatch.chdir(tmp_path)
    Path("says.py").write_text(SAYS)
    Path("stack.yaml").write_text(MESSAGES)
    result = fleet.run("stack.yaml", out="runs")
    assert [one.check for one in result.checks if one.failed] == ["never"]
    assert result.directory is not None
    said = (result.directory / "log" / "agent-1.log").read_text()
    assert said.count("signal wrong: other: is not json") == 1


WAITS = (
    "import socket, sys\ns = socket.socket(type=socket.SOCK_DGRAM)\ns.bind(('127.0.0.1', 9100))\n{first}\ns.recv(9)\n"
)


@needs_cc
@pytest.mark.parametrize("first", ["", "print('listens')"])
def test_programs_that_wait_for_each_other_and_say_nothing_have_failed(
    first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of two that neither sent nor printed anything passed, with a note."""
    monkeypatch.chdir(tmp_path)
    Path("waits.py").write_text(WAITS.format(first=first))
    Path("stack.yaml").write_text(STACK.format(a="{}", programs='{"*": {run: [python, waits.py]}}', more=""))
    result = fleet.run("stack.yaml")
    (programs,) = (one for one in result.checks if one.check == "programs")
    assert (programs.passed, programs.found) == (
        (True, "all 2") if first else (False, "all 2, and none of them sent or printed anything")
    )
    assert len(result.notes) == 1


@needs_cc
def test_a_program_finds_the_files_of_its_folder_and_what_it_writes_stays_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    Path("sub/depths.csv").write_text("1,2")
    Path("reads.py").write_text(
        "print(open('depths.csv').read(), file=open('out.txt', 'w'))\nprint(open('out.txt').read())"
    )
    Path("stack.yaml").write_text(
        "title: T\nclock: simulated\nduration: 1 s\nnodes: {a: {}, b: {}}\n"
        'programs: {"*": {run: [python, ../reads.py], in: sub}}\nchecks: {programs: done}\n'
    )
    result = fleet.run("stack.yaml", out="runs")
    assert result.status is Status.PASS and not Path("out.txt").exists() and not Path("sub/out.txt").exists()
    assert result.notes == ["nothing came from a, b, and no packet of theirs was delayed or lost"]
    assert result.directory is not None and "1,2" in (result.directory / "log" / "agent-1.log").read_text()


@needs_cc
def test_a_search_judges_programs_as_a_run_does(stack: Any) -> None:
    """A run without an emulator did not see how programs end, and its repetition did: "not reproduced"."""
    stack("socket_stack")
    nemesis = "nemesis={mode: episodes, unit: 1 s}"
    found = invoke("search", "stack.yaml", "--set", "clock=simulated", "--set", nemesis, "--set", "seed=7",
                   "--budget", 1, "--workers", 1, "--quiet")  # fmt: skip
    assert found.exit_code == 1, found.output
    assert "not reproduced" not in found.stderr and "fault" in found.stdout


READY = """
title: Ready
clock: simulated
nodes: {{a: {{}}, b: {{}}}}
programs:
  a: {{run: [python, count.py, "{times}", one, "0"], ready: {ready}}}
  b: {{run: [python, count.py, "9", two, "0"], ready: {{line: two 0}}}}
duration: 6 s
"""


@needs_cc
@pytest.mark.parametrize(
    ("times", "ready", "found"),
    [
        (9, "{line: one 2}", "all 2"),
        (9, "{line: one 2, within: 1 s}", "a was not ready within 1 s: it printed no line with 'one 2'"),
        (9, "{line: never}", "a was not ready within 5.98 s: it printed no line with 'never'"),
        (1, "{line: one 2}", "a was not ready before it ended: it printed no line with 'one 2'"),
    ],
)
def test_a_program_that_does_not_get_ready_fails(
    times: int, ready: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the wall clock the run would not begin; here it was silently one without that program."""
    monkeypatch.chdir(tmp_path)
    Path("count.py").write_text(COUNT)
    Path("stack.yaml").write_text(READY.format(times=times, ready=ready))
    passed, words = verdict(fleet.run("stack.yaml", out="runs"), "programs")
    assert passed == (found == "all 2") and found in words
