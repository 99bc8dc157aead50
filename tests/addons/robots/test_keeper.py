"""The process that keeps programs: it starts, kills, pauses and stops them, reads what they print, leaves nobody."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic_ns
from typing import Any

import psutil
import pytest
from free_ports import free_port
from live import gone
from waiting import wait_for

from fleet.addons.robots import keeper
from fleet.addons.robots.keeper import MOST_LINE, MOST_LOG, TAIL, _holds, descendants

LIMIT_S = 60.0
FOREVER = "exec sleep 1000"
PRINTS = 'trap "echo stopped; exit 0" TERM; echo begins; sleep 1000 & while :; do wait; done'


class Keeping:
    """A keeper, and what it has said."""

    def __init__(self, folder: Path, *programs: dict[str, Any]) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [sys.executable, "-I", keeper.__file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )
        assert self.process.stdout is not None
        os.set_blocking(self.process.stdout.fileno(), False)
        self.said: list[dict[str, Any]] = []
        self.until = 0
        self._rest = b""
        self.tell(programs=[self.values(**{"name": f"m{n}"} | one) for n, one in enumerate(programs, start=1)])

    def values(self, name: str, **values: Any) -> dict[str, Any]:
        """The values of a program, as the console gives them; `run`: a line for the shell."""
        argv = ["sh", "-c", values.pop("run", FOREVER)]
        usual = {
            "name": name, "node": name.partition("/")[0], "argv": argv, "env": dict(os.environ), "folder": ".",
            "nice": 0, "signals": [], "log": str(self.folder / f"{name}.log"), "line": None, "port": None,
            "after_ns": None, "enter": [], "stop": "TERM", "stop_within_ns": 60 * 10**9,
        }  # fmt: skip
        return usual | values

    def tell(self, **values: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(values).encode() + b"\n")

    def plan(self, dead: Any = None, paused: Any = None) -> None:
        """What the console says of faults; times [ns]."""
        self.tell(dead=dead or {}, paused=paused or {})

    def hear(self) -> None:
        assert self.process.stdout is not None
        while data := self.process.stdout.read(1 << 16):
            *lines, self._rest = (self._rest + data).split(b"\n")
            for said in map(json.loads, lines):
                self.until = said.get("until", self.until)
                if "until" not in said:
                    self.said.append(said)

    def find(self, what: str, name: str = "m1") -> list[dict[str, Any]]:
        self.hear()
        return [one for one in self.said if one.get(what) == name]

    def wait(self, what: str, name: str = "m1", count: int = 1) -> dict[str, Any]:
        """Wait until it has said that of a program so often; returns the last one."""
        wait_for(lambda: len(self.find(what, name)) >= count, LIMIT_S, f"{count} {what} of {name} in {self.said}")
        return self.find(what, name)[count - 1]

    def started(self, name: str = "m1", count: int = 1) -> psutil.Process:
        return psutil.Process(self.wait("started", name, count)["pid"])

    def file(self, name: str) -> psutil.Process:
        """The process whose number a program has written into a file."""
        path = self.folder / name
        return psutil.Process(int(wait_for(lambda: path.exists() and path.read_text().strip(), LIMIT_S, name)))

    def leave(self) -> None:
        """Close its pipe, as the end of the console does."""
        assert self.process.stdin is not None
        with suppress(OSError):
            self.process.stdin.close()

    def stop(self) -> None:
        self.tell(stop=True)
        self.process.wait(LIMIT_S)
        self.hear()


@contextmanager
def keeping(folder: Path, *programs: dict[str, Any]) -> Iterator[Keeping]:
    found = Keeping(folder, *programs)
    try:
        yield found
    finally:
        found.leave()
        try:
            found.process.wait(LIMIT_S)
        finally:
            found.process.kill()
            found.process.wait()
            found.process.stdout.close()  # type: ignore[union-attr]


def test_a_span_holds_from_its_begin_on_and_without_its_end() -> None:
    """An end that is open is never reached, and no span holds at no time."""
    assert [_holds([[5, 7], [9, None]], now) for now in (4, 5, 6, 7, 8, 9, 10**18)] == [
        False, True, True, False, False, True, True,
    ]  # fmt: skip
    assert not _holds([], 5)


def test_programs_are_ready_when_their_condition_holds(tmp_path: Path) -> None:
    """By a line, a port, a time after the start, or at once; and not before."""
    port = free_port()
    listens = f"import socket, time; s = socket.create_server(('127.0.0.1', {port})); time.sleep(1000)"
    programs: list[dict[str, Any]] = [
        {"run": "echo almost; echo it is up; exec sleep 1000", "line": "is up$"},
        {"argv": [sys.executable, "-c", listens], "port": port},
        {"after_ns": 150_000_000},
        {},
        {"line": "never printed", "run": "echo something; exec sleep 1000"},
    ]
    with keeping(tmp_path, *programs) as kept:
        for name in ("m1", "m2", "m3", "m4"):
            assert kept.wait("ready", name)["at"] >= kept.wait("started", name)["at"]
        assert kept.find("ready", "m3")[0]["at"] - kept.find("started", "m3")[0]["at"] >= 150_000_000
        assert not kept.find("ready", "m5")
        kept.stop()
    (used,) = [one["cpu_s"] for one in kept.said if "cpu_s" in one]
    assert used > 0.0


def test_a_program_is_killed_and_started_and_suspended_at_the_times_of_a_plan(tmp_path: Path) -> None:
    """Also all that it has started; what has ended by itself comes back when it is asked for."""
    run = "sh -c 'echo $$ > child; exec sleep 1000' & wait"
    with keeping(tmp_path, {"run": run, "folder": str(tmp_path)}, {"run": "exit 3"}) as kept:
        first, child = kept.started(), kept.file("child")
        now = monotonic_ns()
        (tmp_path / "child").unlink()
        kept.plan(dead={"m1": [[now + 100_000_000, now + 300_000_000]]})
        assert kept.wait("killed")["at"] >= now + 100_000_000
        assert gone(first) and gone(child)
        second = kept.started(count=2)
        assert kept.find("started")[1]["at"] >= now + 300_000_000
        child = kept.file("child")
        now = monotonic_ns()
        kept.plan(paused={"m1": [[now, None]]})
        kept.wait("paused")
        wait_for(lambda: {one.status() for one in (second, child)} == {psutil.STATUS_STOPPED}, LIMIT_S, "a pause")
        kept.plan()
        kept.wait("resumed")
        wait_for(lambda: {one.status() for one in (second, child)} == {psutil.STATUS_SLEEPING}, LIMIT_S, "its end")
        kept.plan(dead={"m1": [[0, None]]}, paused={"m1": [[0, None]]})  # a program that is suspended can be killed
        kept.wait("killed", count=2)
        assert kept.wait("ended", "m2")["code"] == 3
        kept.tell(again="m2")
        kept.wait("ended", "m2", count=2)
        kept.stop()
        assert len(kept.find("started")) == 2
        assert len(kept.find("started", "m2")) == 2


def test_the_end_of_a_program_is_told_with_its_last_lines(tmp_path: Path) -> None:
    """They hold no control characters, no line that nobody can read, and no more lines than fit on a screen."""
    long = "x" * 1000
    run = f"for i in $(seq 30); do echo $i; done; printf '\\033[31mred\\033[0m\\r\\n{long}\\nlast \\377'; exit 7"
    programs: list[dict[str, Any]] = [
        {"run": run},
        {"folder": str(tmp_path / "nowhere")},
        {"argv": ["no-such-program-of-ours"]},
        {"run": "kill -9 $$"},
        {"argv": ["a\0b"]},
    ]
    with keeping(tmp_path, *programs) as kept:
        ended = kept.wait("ended")
        assert (ended["code"], len(ended["tail"])) == (7, TAIL)
        assert ended["tail"][-4:] == ["30", "?[31mred?[0m", "x" * 400, "last \N{REPLACEMENT CHARACTER}"]
        folder, unknown, killed, strange = (kept.wait("ended", f"m{n}") for n in (2, 3, 4, 5))
        assert (folder["code"], folder["tail"]) == (127, ["sh: No such file or directory"])
        assert (unknown["code"], unknown["tail"]) == (
            127, ["no-such-program-of-ours: No such file or directory"],
        )  # fmt: skip
        assert (killed["code"], killed["tail"]) == (-9, [])
        assert strange["code"] == 127
        lines = (tmp_path / "m1.log").read_text("utf-8").splitlines()
        assert (lines[0], lines[-1], len(lines)) == ("- 1", "- last \N{REPLACEMENT CHARACTER}", 33)
        kept.stop()


def test_numbers_are_told_that_lines_hold(tmp_path: Path) -> None:
    """The number of lines begins again with each life; a match without a number is none; times are those of the run.
    The log says where a life begins, and that is no line of the program.
    """
    run = "exec 3<>begun; for line in x=1 x=nan y:x=oops x=2e3 y:x=4; do read go <&3; echo $line; done; read go <&3"
    signals = [[4, r"x=(?P<value>\S+)", False], [7, "y", True], [8, "again", True]]
    expected = ["4 1.0", "4 nan", "7 1.0", "4 2000.0", "4 4.0;7 2.0"]
    os.mkfifo(tmp_path / "begun")
    with keeping(tmp_path, {"run": run, "signals": signals, "folder": str(tmp_path)}) as kept:
        kept.tell(begin=monotonic_ns())
        for life in range(2):
            kept.started()
            for numbers in expected:
                kept.said.clear()
                (tmp_path / "begun").write_text("go\n")
                wait_for(lambda: kept.find("told"), LIMIT_S, numbers)
                assert ";".join(f"{one['signal']} {one['value']}" for one in kept.find("told")) == numbers
            (tmp_path / "begun").write_text("go\n")
            assert kept.wait("ended")["code"] == 0
            kept.said.clear()
            if not life:  # else a third life sometimes begins before the end
                kept.tell(again="m1")
        kept.stop()
    lines = (tmp_path / "m1.log").read_text().splitlines()
    assert [float(line.split()[0]) >= 0.0 for line in lines] == [True] * 11
    assert [n for n, line in enumerate(lines) if line.endswith(" --- started again ---")] == [5]


def test_a_pattern_with_endless_ways_to_fit_a_line_holds_up_nobody(tmp_path: Path) -> None:
    """Such a search takes years, and the keeper of all programs makes it."""
    run = f"echo {'a' * 60}!; echo x=7; read go"
    signals = [[0, "(a+)+$", True], [1, "x=(?P<value>[0-9]+)", False]]
    with keeping(tmp_path, {"run": run, "signals": signals, "line": "(a|aa)+$"}) as kept:
        assert kept.wait("told") | {"at": 0} == {"at": 0, "told": "m1", "signal": 1, "value": 7.0}
        assert {one["what"] for one in kept.find("slow")} == {0, "ready"}
        kept.stop()


def test_of_many_lines_at_once_the_last_number_is_told(tmp_path: Path) -> None:
    """A check looks at the last one only, and a flood of numbers would hold up the console."""
    signals = [[0, "y", True], [1, "(?P<value>[0-9]+)", False]]
    run = "yes | head -30000 | nl -ba"
    with keeping(tmp_path, {"run": run, "signals": signals}) as kept:
        kept.wait("ended")
        kept.stop()
        told = [[one["value"] for one in kept.find("told") if one["signal"] == number] for number in (0, 1)]
        assert told[0] == told[1] == sorted(told[0])
        assert told[0][-1] == 30_000 > 50 * len(told[0])


def test_programs_stop_by_their_signal_and_are_killed_when_they_take_too_long(tmp_path: Path) -> None:
    """A suspended one, too; and one that ignores the signal is killed when its own time is over."""
    interrupted = PRINTS.replace("TERM", "INT")
    programs: list[dict[str, Any]] = [
        {"run": PRINTS, "line": "begins"},
        {"run": interrupted, "line": "begins", "stop": "INT"},
        {"run": PRINTS.replace("echo stopped; exit 0", ""), "line": "begins", "stop_within_ns": 100_000_000},
        {"run": PRINTS, "line": "begins"},
    ]
    with keeping(tmp_path, *programs) as kept:
        for n in range(1, 5):
            kept.wait("ready", f"m{n}")
        kept.plan(paused={"m4": [[0, None]]})
        kept.wait("paused", "m4")
        kept.stop()
        codes = {n: kept.find("ended", f"m{n}")[0]["code"] for n in range(1, 5)}
        assert codes == {1: 0, 2: 0, 3: -signal.SIGKILL, 4: 0}
        assert kept.find("ended", "m4")[0]["tail"] == ["begins", "stopped"]


DAEMON = """\
import os, sys, time
for leave in (lambda: None, os.setpgrp, os.setsid):
    if not os.fork():
        leave()
        if leave is os.setsid and os.fork():
            os._exit(0)  # as a daemon does, whose parent is gone
        sys.stdout = open(os.devnull, "w")
        open(f"left-{os.getpid()}", "w").close()
        time.sleep(1000)
while True:
    time.sleep(0.01)
    if sum(name.startswith("left-") for name in os.listdir()) == 3:
        break
print("all", flush=True)
time.sleep(float(sys.argv[1]))
"""


@pytest.mark.parametrize("how", ["stop", "pipe", "dead"])
def test_nobody_is_left_whatever_ends_it(how: str, tmp_path: Path) -> None:
    """Also what has left the process group, the session or the parent of its program; `pipe`: the console is gone."""
    (tmp_path / "daemon.py").write_text(DAEMON)
    program = {"argv": [sys.executable, "daemon.py", "1000"], "folder": str(tmp_path), "line": "all"}
    with keeping(tmp_path, program) as kept:
        kept.wait("ready")
        left = [kept.started(), *(psutil.Process(int(path.name[5:])) for path in tmp_path.glob("left-*"))]
        assert len(left) == 4
        assert {one.pid for one in left} <= set(descendants([kept.process.pid]))
        if how == "stop":
            kept.stop()
        elif how == "pipe":
            kept.leave()
        else:
            kept.plan(dead={"m1": [[0, None]]})
            kept.wait("killed")
            assert sum(map(gone, left)) >= 3  # a daemon without parent lives to the end of the run
            kept.stop()
        kept.process.wait(LIMIT_S)
        wait_for(lambda: all(map(gone, left)), LIMIT_S, f"the end of {left}")


def test_what_belongs_to_somebody_else_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that `sudo` has started cannot be killed by who started it; that ended the keeper."""

    def refuse(pid: int, number: int) -> None:
        raise PermissionError(pid, number)

    asked = iter([[7, 8], [7, 8]])
    monkeypatch.setattr(keeper, "descendants", lambda _: next(asked))
    monkeypatch.setattr(keeper.os, "kill", refuse)
    keeper.Keeper._end_all(keeper.Keeper.__new__(keeper.Keeper))
    assert next(asked) == [7, 8]


def test_a_program_whose_keeper_is_killed_ends(tmp_path: Path) -> None:
    with keeping(tmp_path, {}) as kept:
        program = kept.started()
        kept.process.kill()
        wait_for(lambda: gone(program), LIMIT_S, "its end")


def test_the_end_of_a_program_is_told_though_a_child_holds_its_pipe_and_floods_it(tmp_path: Path) -> None:
    """The child ends with it: it would speak in its name."""
    with keeping(tmp_path, {"run": "yes & echo $! > child; sleep 0.2; exit 5", "folder": str(tmp_path)}, {}) as kept:
        assert kept.wait("ended")["code"] == 5
        child = int((tmp_path / "child").read_text())
        wait_for(lambda: not psutil.pid_exists(child) or gone(psutil.Process(child)), LIMIT_S, "its end")
        kept.stop()


def known(kept: Keeping, at: int) -> Callable[[], bool]:
    """Whether everything up to a time has been told."""

    def found() -> bool:
        kept.hear()
        return kept.until >= at

    return found


def test_a_program_that_prints_without_end_holds_up_nobody(tmp_path: Path) -> None:
    """The console gets to know how far everything is told, memory and disk stay small, and the others go on."""
    programs: list[dict[str, Any]] = [{"argv": ["yes"]}, {"run": PRINTS, "line": "begins"}]
    with keeping(tmp_path, *programs) as kept:
        kept.wait("ready", "m2")
        log = tmp_path / "m1.log"
        wait_for(lambda: log.exists() and log.stat().st_size > 100_000, LIMIT_S, "its lines")
        wait_for(known(kept, monotonic_ns()), LIMIT_S, "what is told")
        kept.stop()
        assert kept.find("ended", "m2")[0]["tail"] == ["begins", "stopped"]


def test_what_a_program_prints_fills_neither_memory_nor_disk(tmp_path: Path) -> None:
    """Of 100 MB the first ones are kept; a line without end is heard in pieces that fit."""
    prints = f"import sys\nfor _ in range(100): sys.stdout.write('x' * {10**6 - 1} + '\\n')\nprint('last')"
    endless = "import sys\nfor _ in range(300): sys.stdout.write('y' * 1000)\nsys.stdout.flush(); input()"
    programs: list[dict[str, Any]] = [
        {"argv": [sys.executable, "-c", prints]},
        {"argv": [sys.executable, "-c", endless]},
    ]
    with keeping(tmp_path, *programs) as kept:
        assert (kept.wait("ended")["code"], kept.find("ended")[0]["tail"][-1]) == (0, "last")
        assert psutil.Process(kept.process.pid).memory_info().rss < 100 << 20
        kept.wait("ended", "m2")  # it has no input
        kept.stop()
    kept_lines = (tmp_path / "m1.log").read_text().splitlines()
    assert (tmp_path / "m1.log").stat().st_size < MOST_LOG + MOST_LINE
    assert kept_lines[-1] == f"what it prints after {MOST_LOG} bytes is left out"
    pieces = [line.removeprefix("- ") for line in (tmp_path / "m2.log").read_text().splitlines()]
    assert max(map(len, pieces)) <= MOST_LINE
    assert sum(line.count("y") for line in pieces) > 100_000


def test_what_cannot_be_written_holds_up_nobody(tmp_path: Path) -> None:
    with keeping(tmp_path, {"run": "echo x; exit 2", "log": str(tmp_path / "none" / "m1.log")}) as kept:
        assert (kept.wait("ended")["code"], kept.find("ended")[0]["tail"]) == (2, ["x"])
        kept.stop()


def test_a_program_has_the_signals_and_the_nice_value_of_a_shell(tmp_path: Path) -> None:
    """The keeper ignores signals that end the console, and its programs do not."""
    code = (
        "import os, signal; print(os.nice(0), *(signal.getsignal(n) is signal.SIG_DFL for n in (1, 15)), os.getcwd())"
    )
    with keeping(tmp_path, {"argv": [sys.executable, "-c", code], "nice": 3, "folder": str(tmp_path)}) as kept:
        assert kept.wait("ended")["tail"] == [f"{os.nice(0) + 3} True True {tmp_path}"]
        for number in keeper.IGNORED:
            kept.process.send_signal(number)
        kept.stop()
        assert kept.process.returncode == 0


def test_a_keeper_that_is_told_nothing_ends() -> None:
    words = [sys.executable, "-I", keeper.__file__]
    assert subprocess.run(words, stdin=subprocess.DEVNULL, check=False, timeout=LIMIT_S).returncode == 0


def test_the_longest_wait_of_a_thread_between_two_looks_is_that_of_its_node(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of the kernel become waits: of threads that ran since, also of those that are new."""
    sums = [{(1, 1): (5_000, 3), (1, 2): (0, 0), (2, 2): (70, 1)},
            {(1, 1): (5_900, 5), (1, 2): (0, 0), (2, 2): (70, 1)},
            {(1, 1): (6_000, 6), (1, 3): (400, 2), (2, 2): (99, 1)}]  # fmt: skip
    waits, now = keeper.Waits(), monotonic_ns()
    monkeypatch.setattr(keeper, "monotonic_ns", lambda: now)
    waits._trees, waits._seen_ns = {"a": [1], "b": [2]}, now  # as if it had looked for processes already
    found = []
    for known in sums:
        monkeypatch.setattr(keeper, "_threads", lambda pids, known=known: (k for k in known.items() if k[0][0] in pids))
        found.append(waits.look([]))
        assert waits.look([]) == {}  # too early
        now += keeper.WAITS_NS
    assert found == [{}, {"a": 900}, {"a": 400}]


def test_the_kernel_tells_how_long_our_own_threads_wait() -> None:
    threads = dict(keeper._threads([os.getpid(), 2**22 + 1]))
    waited_ns, slices = threads[os.getpid(), os.getpid()]
    assert waited_ns >= 0 and slices > 0
