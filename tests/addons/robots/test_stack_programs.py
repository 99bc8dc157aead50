"""Runs whose programs are started with them: who runs, what they tell, who is killed, and that nobody is left."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from free_ports import free_port
from live import READY_S, LiveRun
from refusals import CommandRefused, type_command
from tool import invoke
from waiting import wait_for

from fleet.result.file import read_result
from fleet.result.verdict import Verdict

LIMIT_S = 60.0
NO_ROUTER = {"m1": {}, "m2": {}, "m3": {}}
UNHURRIED = {"punctual": {"late": "1 min"}}  # whatever else the machine does

# Prints what it is told by the run, and then a number ten times a second.
COUNTS = """\
import os, sys, time
print("told", os.environ["FLEET_NODE"], os.environ.get("OWN"), os.getcwd(), os.nice(0), *sys.argv[1:], flush=True)
n = 0
while True:
    n += 1
    print(f"x={n}", flush=True)
    time.sleep(0.05)
"""
# Puts numbers as JSON, with zenoh and nothing of ours.
PUTS = """\
import json, sys, time
import zenoh
config = zenoh.Config()
for key, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session:
    while True:
        session.put("depth/" + sys.argv[2], json.dumps({"z": [0, 4.5]}))
        time.sleep(0.05)
"""
ENDS = "import sys, time\nprint('hello')\ntime.sleep(float(sys.argv[1]))\nprint('goodbye')\nsys.exit(int(sys.argv[2]))"


def udp(*names: str) -> dict[str, Any]:
    """Nodes in a ring that know datagrams alone, so that no router is needed."""
    return {
        name: {"udp": {str(free_port()): f"{names[n - 1]}:{free_port()}"}} for n, name in enumerate(names)
    }  # fmt: skip


def written(folder: Path, **sections: Any) -> Path:
    for name, text in {"counts": COUNTS, "puts": PUTS, "ends": ENDS}.items():
        (folder / f"{name}.py").write_text(text)
    file = folder / "stack.yaml"
    sections = {"title": "A stack"} | sections
    sections["checks"] = UNHURRIED | sections.get("checks", {})
    file.write_text(json.dumps(sections), "utf-8")
    return file


def stack(folder: Path, *options: str, environment: dict[str, str] | None = None, **sections: Any) -> LiveRun:
    """A run of a stack file in a folder; the user lets its programs run."""
    file = written(folder, **sections)
    return LiveRun(folder / "runs", str(file), "--trust", *options, verb="netem", environment=environment)


def checks(run: LiveRun) -> dict[str, Verdict]:
    return {verdict.check: verdict for verdict in read_result(run.directory).checks}


def tell(run: LiveRun, *words: str) -> str:
    """A command for this run, as from another terminal."""
    done = invoke(*words, "--run", run.directory)
    assert done.exit_code == 0, done.output
    return done.stdout


def begun(run: LiveRun) -> LiveRun:
    wait_for(lambda: run.over or (run.out / "latest" / "connection.json").exists(), READY_S, "its begin")
    assert not run.over, run.printed
    run.family()
    return run


@pytest.fixture(scope="module")
def lively(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveRun]:
    """A run that is interrupted when all that it shows was seen."""
    folder = tmp_path_factory.mktemp("lively")
    (folder / "sub").mkdir()
    nodes = {"m1": {}, **udp("m2", "m3", "m4")}
    counts = "python ../counts.py {node} {number} {seed} {duration_s} {domain} {dir} '{\"a\": {number}}'"
    with stack(
        folder, "--seed", "7",
        nodes=nodes,
        graph={"edges": ["m2->m4", "m3->m2", "m4->m3", "m1-m2"]},
        programs={
            "m*": {"run": counts, "in": "sub", "nice": 2, "env": {"OWN": "{node}!"}, "ready": {"line": "^x="}},
            "m3/short": {"run": ["python", "ends.py", 0.1, 0]},
            "m3": {"run": "python counts.py"},
            "m1": {"run": "python puts.py {listen} {node}", "ready": {"key": "depth/{node}"}},
        },
        signals={
            "x": {"of": "m[24]", "line": r"^x=(?P<value>\d+)"},
            "lines": {"of": "m3", "line": "x=|goodbye", "count": "yes"},
            "depth": {"of": "m1", "message": "depth/*", "json": "z[1]", "unit": "m"},
        },
        faults=[{"at": "200 ms", "for": "300 ms", "kill": "m2"}],
        checks={
            "programs": {"*": "running", "m3/short": "done"},
            "signal": [
                {"name": "counted", "topic": "x", "above": 0},
                {"name": "lines", "topic": "lines", "above": 3, "after": "1 s"},
                {"name": "depth", "topic": "depth", "equals": "4.5 m", "within": "1 mm"},
                {"name": "young", "topic": "x", "below": 7, "vehicles": "m2", "sometimes": True, "after": "400 ms"},
            ],
        },
    ) as run:  # fmt: skip
        yield begun(run)


def lines(run: LiveRun, name: str, word: str) -> list[str]:
    """The lines that a program has printed so far, without their times, with a word in them."""
    file = run.directory / "log" / f"{name}.log"
    found = file.read_text().splitlines() if file.exists() else []
    return [line.split(maxsplit=1)[1] for line in found if word in line]


def test_a_run_starts_watches_kills_and_judges_its_programs(lively: LiveRun) -> None:
    """By its file and by the operator, until Ctrl-C, which ends it as a run that came to its end."""
    told = wait_for(lambda: len(found := lines(lively, "m2", "told")) == 2 and found, LIMIT_S, "its second life")
    sub, own = lively.out.parent / "sub", lively.directory
    assert {*told} == {
        f'told m2 m2! {sub} {os.nice(0) + 2} m2 2 7 86400 {os.environ.get("ROS_DOMAIN_ID", "0")} {own} {{"a": 2}}'
    }
    tell(lively, "inject", "kill", "m4")
    wait_for(lambda: "m4 (not running)" in tell(lively, "status"), LIMIT_S, "that it does not run")
    tell(lively, "inject", "pause", "m1")
    tell(lively, "heal")
    wait_for(lambda: len(lines(lively, "m4", "told")) == 2, LIMIT_S, "its second life")
    lively.family()
    lively.until_running(1.2)
    lively.send(signal.SIGINT)
    lively.ends(0)
    found = checks(lively)
    failed = {name: verdict.words for name, verdict in found.items() if verdict.failed}
    assert failed == {}
    assert (found["programs"].asked, found["programs"].found) == ("running, m3/short done", "all 5")
    assert found["young"].reached  # it counts from 1 on in its second life
    faults = [one.what for one in read_result(lively.directory).faults if one.action == "begins"]
    assert faults == ["kill m2", "kill m4", "pause m1"]


@pytest.mark.parametrize("users", [{}, {"PYTHONSAFEPATH": "1"}])
def test_a_program_imports_what_lies_beside_it_unless_its_user_forbids_it(
    users: dict[str, str], tmp_path: Path
) -> None:
    """Our own processes look into no folder of the user. Programs inherited that, and found no module of theirs."""
    (tmp_path / "ours.py").write_text("print('imported', flush=True)")
    (tmp_path / "imports.py").write_text("import ours")
    programs = {"m*": {"run": "python ends.py 9 0"}, "m1": {"run": "python imports.py"}}
    with stack(
        tmp_path, nodes=NO_ROUTER, programs=programs, duration="1 s", environment=users,
        checks={"programs": {"*": "running", "m1": "done"}},
    ) as run:  # fmt: skip
        if users:  # it may fail before the run begins, which breaks the run, or after, which fails the check
            assert run.status() != 0
            assert "No module named 'ours'" in run.printed
        else:
            run.ends(0)


def test_who_does_not_want_to_wait_for_the_end_of_programs_kills_them(tmp_path: Path) -> None:
    """By another Ctrl-C, of which the user is told. The run is judged all the same, and nobody is left."""
    deaf = {"run": "sh -c 'trap : TERM; echo up; while :; do sleep 1; done'", "ready": {"line": "up"}}
    with stack(
        tmp_path, nodes=udp("m1", "m2"), programs={"m1": deaf | {"stop": {"within": "10 min"}}}
    ) as run:  # fmt: skip
        begun(run).until_running(0.2)
        run.send(signal.SIGINT)
        run.until("programs have 600 s to stop; Ctrl-C kills them at once")
        run.send(signal.SIGINT)
        run.ends(0)
        assert checks(run)["programs"].passed


DOCKER = """\
#!/bin/sh
echo "$@" >> {log}
case "$*" in
    *refused*up*) echo "no such image" >&2; exit 1;;
    *slow*up*) exec sleep 1000;;
esac
"""


def docker(folder: Path) -> dict[str, str]:
    """An environment with a docker that writes down how it is called."""
    places = folder / "bin"
    places.mkdir()
    (places / "docker").write_text(DOCKER.format(log=folder / "called"))
    (places / "docker").chmod(0o755)
    return {"PATH": f"{places}:{os.environ['PATH']}"}


def test_a_run_fails_for_programs_that_end_or_do_not_and_says_how(tmp_path: Path) -> None:
    """With their status and last lines; a program that knows when t = 0 is, and a compose file, are there as well."""
    with stack(
        tmp_path, environment=docker(tmp_path),
        nodes=udp("m1", "m2", "m3"), duration="800 ms", compose="services.yaml", begin="200 ms",
        programs={
            "m1": {"run": "python ends.py 1.0 3"},
            "m2": {"run": "python counts.py {begin_s}"},
            "m3": {"run": ["sh", "-c", "echo begins; sleep 1; kill -9 $$"]},
            "m1/deaf": {"run": "sh -c 'trap : TERM; while :; do sleep 1; done'", "stop": {"within": "50 ms"}},
        },
        checks={"programs": {"m2": "done"}, "signal": {"topic": "s", "above": 0, "after": "700 ms"}},
        signals={"s": {"of": "m1", "line": "hel(?P<value>)lo"}},
    ) as run:  # fmt: skip
        run.ends(1)
        found, result, said = checks(run), read_result(run.directory), run.said
    words = found["programs"].found
    assert words.startswith("m1 exited with status 3 at 0.") and '": "goodbye"' not in words
    assert ': "goodbye"; m2 did not end; m3 was killed by SIGKILL at 0.' in words
    assert words.endswith(': "begins"')
    assert [note for note in result.notes if "no program sent" not in note] == [
        "signal s: no line of m1 had a number", "m1/deaf did not stop in time and had to be killed: see stop",
    ]  # fmt: skip
    assert [death[1:] for death in result.deaths.values()] == [["hello", "goodbye"], ["begins"]]
    assert "m1 exited with status 3 at t = 0." in said and "goodbye" in said
    told = next(line for line in (run.directory / "log/m2.log").read_text().splitlines() if "told" in line)
    assert float(told.split()[-1]) > 0.0
    called = (tmp_path / "called").read_text().splitlines()
    project = f"compose -p fleet-{run.directory.name} -f {tmp_path / 'services.yaml'}".lower()
    assert [line.lower() for line in called] == [f"{project} up -d --wait", f"{project} down"]


def test_what_a_compose_file_has_begun_is_brought_down_though_it_is_refused(tmp_path: Path) -> None:
    """The run breaks, with the words of docker."""
    with stack(
        tmp_path, environment=docker(tmp_path), nodes=udp("m1", "m2"), duration="1 s", compose="refused.yaml",
        programs={"m1": {"run": "sleep 100"}},
    ) as run:  # fmt: skip
        run.ends(3)
        assert "no such image" in run.said
    assert [line.split()[5] for line in (tmp_path / "called").read_text().splitlines()] == ["up", "down"]


def test_a_program_that_is_not_ready_in_time_breaks_the_run(tmp_path: Path) -> None:
    """Who waits for a token is not ready with the first line. The last lines are shown, and nobody is left."""
    ready = {"token": "alive/{node}", "within": "300 ms"}
    with stack(
        tmp_path, nodes={"m1": {}, "m2": {}}, duration="1 s",
        programs={"m1": {"run": "sh -c 'echo on its way; sleep 1000'", "ready": ready}, "m2": {"run": "sleep 1000"}},
    ) as run:  # fmt: skip
        run.ends(3)
        assert "m1 was not ready within 0.3 s" in run.said and "on its way" in run.said


def test_nobody_is_left_when_the_console_is_killed(tmp_path: Path) -> None:
    """Neither programs, nor what they have started, nor keeper, nor relay."""
    run_it = "sh -c 'setsid sleep 1000 & echo $! > left; exec sleep 1000'"
    with stack(tmp_path, nodes=udp("m1", "m2"), programs={"m1": {"run": run_it}}) as run:
        begun(run)
        wait_for(lambda: (tmp_path / "left").exists() and (tmp_path / "left").read_text(), LIMIT_S, "its child")
        left = int((tmp_path / "left").read_text())
        names = {process.pid: " ".join(process.cmdline()) for process in run.family()}
        assert left in names
        assert any("keeper.py" in name for name in names.values())
        run.send(signal.SIGKILL)
        run.status()
        run.until_nobody_is_left()


@pytest.mark.parametrize("compose", ["services.yaml", "slow.yaml"])  # while they are up, and while they come up
def test_containers_are_brought_down_when_the_console_is_killed(compose: str, tmp_path: Path) -> None:
    with stack(
        tmp_path, environment=docker(tmp_path), nodes=udp("m1", "m2"), compose=compose,
        programs={"m1": {"run": "sleep 1000"}},
    ) as run:  # fmt: skip
        called = tmp_path / "called"
        wait_for(lambda: called.exists() and " up " in called.read_text(), LIMIT_S, "up")
        if compose == "services.yaml":
            begun(run)
        run.send(signal.SIGKILL)
        run.status()
        wait_for(lambda: called.read_text().split()[-1] == "down", LIMIT_S, "down")
        run.until_nobody_is_left()


def test_a_run_ends_with_a_line_when_its_keeper_is_killed(tmp_path: Path) -> None:
    run_it = "sh -c 'sleep 1000 & echo $! > left; exec sleep 1000'"
    with stack(tmp_path, nodes=udp("m1", "m2"), programs={"m1": {"run": run_it}}) as run:
        begun(run)
        wait_for(lambda: (tmp_path / "left").exists() and (tmp_path / "left").read_text(), LIMIT_S, "its child")
        (keeping,) = [process for process in run.family() if "keeper.py" in " ".join(process.cmdline())]
        keeping.kill()
        assert run.status() == 3
        assert "the keeper of the programs is gone" in run.said and "Traceback" not in run.said, run.said
        run.until_nobody_is_left()


GETTING_READY: dict[str, tuple[dict[str, Any], str]] = {
    "docker": ({"compose": "slow.yaml"}, "starting the programs"),
    "unready": ({"programs": {"m1": {"run": "sleep 1000", "ready": {"line": "never"}}}}, "waiting for m1 to be ready"),
    "begin": ({"begin": "1 h"}, "all programs are ready, and t = 0 comes in 3"),
}


@pytest.mark.parametrize("how", ["stop", pytest.param("ctrl-c", marks=pytest.mark.slow)])
@pytest.mark.parametrize("state", GETTING_READY)
def test_a_run_answers_while_its_programs_get_ready_and_says_what_its_end_ends(
    state: str, how: str, tmp_path: Path
) -> None:
    """Requests were answered from t = 0 on only, and so refused after five seconds; Ctrl-C said nothing."""
    sections, waits = GETTING_READY[state]
    program = {"programs": {"m1": {"run": "sleep 1000"}}}
    with stack(tmp_path, nodes=udp("m1", "m2"), environment=docker(tmp_path), **program | sections) as run:
        begun(run)
        wait_for(lambda: waits in tell(run, "status"), LIMIT_S, waits)
        tell(run, "inject", "down", "m1->m2")
        if state != "docker":  # it is waited for before it has begun
            wait_for(lambda: any("sleep" in one.name() for one in run.family()), LIMIT_S, "the program")
        run.family()
        if how == "stop":
            assert tell(run, "stop") == f"{run.directory.name}: stopping at t = 0.00 s\n"
        else:
            run.send(signal.SIGINT)
        run.ends(130)
        ended = "" if state == "docker" else ", and its programs with it: m1"
        (note,) = read_result(run.directory).notes
        assert note.startswith(f"the run ended before t = 0 ({waits}") and note.endswith(f"){ended}")
        assert f"note {note}" in run.said


def test_programs_of_a_strangers_file_need_the_users_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal says what would run, without what a terminal would obey, and nothing is started."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    file = written(tmp_path, nodes=NO_ROUTER, duration="1 s", programs={"m1": {"run": f"touch {tmp_path}/'a\x1b b'"}})
    with pytest.raises(CommandRefused) as caught:
        type_command("netem", str(file))
    assert (caught.value.status, "\x1b" in str(caught.value)) == (2, False)
    assert f"touch '{tmp_path}/a" in str(caught.value) and "--trust" in str(caught.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["counts.py", "ends.py", "here", "puts.py", "stack.yaml"]
    assert not list((tmp_path / "here").iterdir())


@pytest.mark.parametrize(
    ("sends", "note"),
    [
        ("m1", "nothing came from m2, and no packet of theirs was delayed or lost"),
        ("", "no program sent anything through this network: do they reach each other without it, by addresses of "
             "their own or by multicast?"),
    ],
)  # fmt: skip
def test_programs_that_send_nothing_through_the_network_are_told(sends: str, note: str, tmp_path: Path) -> None:
    """Two programs of DDS heard each other with every link at 100 % loss, and the run passed without a word."""
    port, quiet = free_port(), "import time; time.sleep(9)"
    send = "import socket, time; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
    send += f"while not s.sendto(b'x', ('127.0.0.1', {port})) or not time.sleep(0.05): pass"
    programs = {name: {"run": ["python", "-c", send if name == sends else quiet]} for name in ("m1", "m2")}
    nodes = {"m1": {"udp": {str(port): f"m2:{free_port()}"}}, "m2": {}}
    with stack(tmp_path, nodes=nodes, programs=programs, duration="500 ms", begin="300 ms") as run:
        run.ends(0 if sends else 1)
        result = read_result(run.directory)
        assert result.notes[:1] == [note]
        said = [one.found for one in result.checks if one.check == "programs"]
        assert said == ["all 2" if sends else "all 2, and none of them sent or printed anything"]
