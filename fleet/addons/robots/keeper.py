"""The process that keeps the programs of a stack: it starts, kills, pauses and stops them, and reads what they print.

It is a script of its own, with Python's standard library alone: it starts in 30 ms, and takes no memory that a program
could miss. The console writes lines of JSON into it, and it answers with such lines. When that pipe ends, the console
is gone, also by SIGKILL: then every program ends, with all that it has started, and containers are brought down.

It is no child of the fork server as the other processes of a run are. The kernel ends those at once with the console,
and nobody would be left to end what a program such as `ros2 launch` has started.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import resource
import selectors
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from time import monotonic_ns
from typing import Any, TextIO

MARK_NS = 20_000_000  # how often the console is told up to when it knows everything
PORT_NS = 50_000_000  # how often a port is tried
WAITS_NS = 50_000_000  # how often it is read how long threads have waited for a processor
TREES_NS = 10**9  # how often it is looked which processes the programs have started
MOST_LINE = 65_536  # bytes; a longer line is cut
MOST_MATCH_S = 0.2  # for one pattern in one line: some patterns have more ways to fit a line than anybody can try
MOST_LOG = 16 * 2**20  # bytes of one program that are kept; so it cannot fill the disk
MOST_READ = 1 << 16  # a pipe holds no more, so that one reading takes all that was in it
TAIL = 12
DOWN_S = 120.0  # for docker to bring containers down, if the console cannot
AGAIN = "--- started again ---"  # a line of the log, where another life begins
IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_LIBC = ctypes.CDLL(None, use_errno=True)


def _give_up(*_: object) -> None:
    """End a search that takes too long: Python looks for signals while it matches."""
    raise TimeoutError


def _send_signal(pid: int, number: int) -> bool:
    """Whether a process could be sent a signal, or is gone: that of another user, as `sudo` starts one, cannot."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False
    return True


class Keeper:
    """All programs of a run."""

    def __init__(self, programs: list[dict[str, Any]]) -> None:
        self.begin_ns: int | None = None  # tick 0
        self.stopping = False
        self._out = bytearray()
        self._selector = selectors.DefaultSelector()
        self._programs = [KeptProgram(self, values) for values in programs]
        self._by_pid: dict[int, KeptProgram] = {}
        self._commands = b""
        self._marked_ns = 0
        self._waits = Waits()
        os.set_blocking(0, False)
        os.set_blocking(1, False)
        self._selector.register(0, selectors.EVENT_READ, self._hear)

    def serve(self) -> None:
        """Keep the programs until the console says stop, or is gone."""
        try:
            while not (self.stopping and all(program.process is None for program in self._programs)):
                now = monotonic_ns()
                due = min([now + MARK_NS, *(program.act(now) for program in self._programs)])
                self._look(max(0, due - monotonic_ns()))
                if now - self._marked_ns >= MARK_NS:
                    self._marked_ns = now
                    self.say(until=now)
                    self._measure(now)
                self._reap()
        except EOFError:
            self._out.clear()
        finally:
            self._end_all()
        used = [resource.getrusage(who) for who in (resource.RUSAGE_CHILDREN, resource.RUSAGE_SELF)]
        self.say(cpu_s=sum(one.ru_utime + one.ru_stime for one in used))
        os.set_blocking(1, True)
        with suppress(OSError):
            while self._out:
                del self._out[: os.write(1, self._out)]

    def say(self, **values: Any) -> None:
        """Tell the console something. What does not fit into the pipe waits here, and holds up no program."""
        self._out += json.dumps(values).encode() + b"\n"

    def began(self, program: KeptProgram, output: int) -> None:
        """Read what a program prints, and notice its end."""
        self._by_pid[program.process.pid] = program
        self._selector.register(output, selectors.EVENT_READ, program.read)

    def closes(self, output: int) -> None:
        self._selector.unregister(output)
        os.close(output)

    def _look(self, wait_ns: int) -> None:
        """Take what there is to read."""
        if self._out:
            with suppress(BlockingIOError):
                del self._out[: os.write(1, self._out)]
        for key, _ in self._selector.select(min(wait_ns, 10_000_000 if self._out else wait_ns) / 1e9):
            key.data()

    def _measure(self, now: int) -> None:
        """Tell how long the programs have waited for a processor since tick 0."""
        has_begun = self.begin_ns is not None and self.begin_ns <= now
        if has_begun and not self.stopping and (waits := self._waits.look(self._programs)):
            self.say(waits=waits)

    def _hear(self) -> None:
        data = os.read(0, MOST_READ)
        if not data:
            raise EOFError
        *lines, self._commands = (self._commands + data).split(b"\n")
        for line in lines:
            self._obey(json.loads(line))

    def _obey(self, command: dict[str, Any]) -> None:
        self.begin_ns = command.get("begin", self.begin_ns)
        if command.get("stop"):
            self.stopping = True
        for program in self._programs:
            program.plan(command, monotonic_ns())

    def _reap(self) -> None:
        with suppress(ChildProcessError):
            while True:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if not pid:
                    return
                if (program := self._by_pid.pop(pid, None)) is not None:
                    program.has_ended(os.waitstatus_to_exitcode(status))

    def _end_all(self) -> None:
        """Kill everything that was started here, also what has left the session of its program."""
        while pids := list(descendants([os.getpid()])):
            sent = [_send_signal(pid, signal.SIGKILL) for pid in pids]
            if not any(sent):
                return  # they are another user's
            with suppress(ChildProcessError):
                os.waitpid(-1, 0)


class Waits:
    """How long threads of programs that could run have waited for a processor, as the kernel tells it.

    A program that waits is late, and its messages with it, and no relay can see that: to it they come late. The kernel
    has a sum for each thread, so what a thread has waited between two looks counts as one wait. A share of all times
    that a thread got a processor was tried first: a message passes several threads, and each gets a processor several
    times, so that 31 % late messages were 2 % of these. A thread that computes all the time and shares its processor
    counts as one that waits, as it does.
    """

    def __init__(self) -> None:
        self._next_ns = self._seen_ns = 0
        self._trees: dict[str, list[int]] = {}  # by node
        self._known: dict[tuple[int, int], tuple[int, int]] | None = None  # by process and thread: waited [ns], slices

    def look(self, programs: list[KeptProgram]) -> dict[str, int]:
        """By node of which some thread ran since the last look: the longest that one of them has waited [ns]."""
        now = monotonic_ns()
        if now < self._next_ns:
            return {}
        if now - self._seen_ns >= TREES_NS:
            self._seen_ns, all_now = now, processes()
            self._trees = {}
            for one in programs:
                if one.process is not None:
                    pid = one.process.pid
                    self._trees.setdefault(one.node, []).extend(descendants([pid], session=pid, among=all_now))
        found: dict[str, int] = {}
        known, before = {}, self._known
        for node, pids in self._trees.items():
            for thread, (waited_ns, slices) in _threads(pids):
                known[thread] = waited_ns, slices
                if before is None:
                    continue
                old_ns, old = before.get(thread, (0, 0))
                if slices > old:
                    found[node] = max(found.get(node, 0), waited_ns - old_ns)
        self._known = known
        self._next_ns = now + max(WAITS_NS, 50 * (monotonic_ns() - now))  # so that it takes two percent at most
        return found


def _threads(pids: list[int]) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Of each thread: process and number, how long it has waited [ns], and how often it got a processor."""
    for pid in pids:
        with suppress(OSError, ValueError):
            for thread in os.listdir(f"/proc/{pid}/task"):
                with open(f"/proc/{pid}/task/{thread}/schedstat", encoding="ascii") as file:
                    _, waited_ns, slices = map(int, file.read().split())
                yield (pid, int(thread)), (waited_ns, slices)


class KeptProgram:
    """One program, life after life."""

    def __init__(self, keeper: Keeper, values: dict[str, Any]) -> None:
        self._keeper, self._values = keeper, values
        self.name, self.node = values["name"], values["node"]
        self.process: Any = None
        self._ready_ns: int | None = None  # when it became ready
        self._started_ns = 0
        self._lives = 0
        self._over = False  # it has ended by itself
        self._killed = self._paused = False
        self._dead: list[list[int | None]] = []  # when it has to be gone: from and until [ns]; None: to the end
        self._held: list[list[int | None]] = []  # when it has to be suspended
        self._stop_ns: int | None = None  # when it is killed at the latest; None: it need not stop
        self._line = b""
        self._tail: deque[str] = deque(maxlen=TAIL)
        self._log: TextIO | None = None
        self._written = 0
        self._counts = [0] * len(values["signals"])
        self._told: dict[int, tuple[int, float]] = {}  # by signal: when it was told, and the number
        self._output = -1
        self._patterns = [(number, re.compile(text), counts) for number, text, counts in values["signals"]]
        self._tells = re.compile(values["line"]) if values["line"] is not None else None
        self._port_ns = 0
        self._slow: set[int | str] = set()  # signals whose pattern is not tried any more, and "ready"

    def plan(self, command: dict[str, Any], now: int) -> None:
        """Take what the console wants of it."""
        if "dead" in command:
            self._dead = command["dead"].get(self.node, [])
            self._held = command["paused"].get(self.node, [])
        if command.get("again") == self.node:
            self._over = False
        if command.get("stop") and self.process is not None and self._stop_ns is None:
            self._stop_ns = now + self._values["stop_within_ns"]
            self._signal_group(signal.SIGCONT)
            self._signal_group(getattr(signal, f"SIG{self._values['stop']}"))

    def act(self, now: int) -> int:
        """Make it as it has to be at a time [ns]. Returns when it has to be looked at again."""
        if self._keeper.stopping:
            if self.process is not None and self._stop_ns is not None and now >= self._stop_ns:
                self._kill()
            return self._stop_ns or now + MARK_NS
        dead, paused = _holds(self._dead, now), _holds(self._held, now)
        if dead and self.process is not None and not self._killed:
            self._killed = True
            self._kill()
        elif not dead and self.process is None and not self._over:
            self._start(now)
        elif self.process is not None and not self._killed and paused != self._paused:
            self._paused = paused
            for pid in self._tree():
                _send_signal(pid, signal.SIGSTOP if paused else signal.SIGCONT)
            self._keeper.say(at=now, **{"paused" if paused else "resumed": self.name})
        changes = [at for spans in (self._dead, self._held) for span in spans for at in span if at and at > now]
        return min([*changes, self._look_ready(now)], default=now + 10**9)

    def _look_ready(self, now: int) -> int:
        """Notice that it is ready. Returns when to look again."""
        after_ns, port = self._values["after_ns"], self._values["port"]
        if self._ready_ns is not None or self.process is None or self._tells is not None:
            return now + 10**9
        if after_ns is not None:
            if now < self._started_ns + after_ns:
                return self._started_ns + int(after_ns)
        elif port is not None:
            if now < self._port_ns:
                return self._port_ns
            self._port_ns = now + PORT_NS
            with socket.socket() as tried:
                tried.settimeout(0.02)
                if tried.connect_ex(("127.0.0.1", port)):
                    return self._port_ns
        self._is_ready(now)
        return now + 10**9

    def _is_ready(self, now: int) -> None:
        self._ready_ns = now
        self._keeper.say(at=now, ready=self.name)

    def _start(self, now: int) -> None:
        values = self._values
        self._killed = self._paused = False
        self._started_ns, self._ready_ns, self._line = now, None, b""
        self._counts = [0] * len(self._counts)
        ours, theirs = os.pipe()
        os.set_blocking(ours, False)
        try:
            self.process = subprocess.Popen(
                values["argv"], cwd=values["folder"], env=values["env"], stdin=subprocess.DEVNULL, stdout=theirs,
                stderr=theirs, start_new_session=True, preexec_fn=self._before,
            )  # fmt: skip
        except (OSError, subprocess.SubprocessError, ValueError) as error:
            os.close(ours)
            self._over = True
            problem = getattr(error, "strerror", None) or str(error)
            self._keeper.say(at=now, ended=self.name, code=127, tail=[f"{values['argv'][0]}: {problem}"])
            return
        finally:
            os.close(theirs)
        if self._lives:
            self._keep(now, AGAIN)
        self._lives += 1
        self._output = ours
        self._keeper.began(self, ours)
        self._keeper.say(at=now, started=self.name, pid=self.process.pid)

    def _before(self) -> None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)  # if somebody kills the keeper
        for number in IGNORED:  # a program would inherit that it ignores them
            signal.signal(number, signal.SIG_DFL)
        if self._values["nice"]:
            os.nice(self._values["nice"])
        # A network namespace, and without root the user namespace around it, from where the other is out of reach.
        for file in [os.open(path, os.O_RDONLY | os.O_CLOEXEC) for path in self._values["enter"]]:
            if _LIBC.setns(file, 0):
                raise OSError(ctypes.get_errno(), "a network namespace cannot be entered")
            os.close(file)

    def read(self) -> None:
        """Take what it has printed."""
        try:
            data = os.read(self._output, MOST_READ)
        except BlockingIOError:
            return
        if not data:
            self._close()
            return
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            self._hear(line)
        if len(self._line) > MOST_LINE:
            self._hear(self._line)
            self._line = b""
        self._tell()

    def _close(self) -> None:
        self._keeper.closes(self._output)
        self._output = -1
        if self._line:
            self._hear(self._line)
            self._line = b""
        self._tell()

    def _tell(self) -> None:
        """Tell what the lines that were there at a time said last, or a flood of them would hold up the console."""
        for number, (at, value) in self._told.items():
            self._keeper.say(at=at, told=self.node, signal=number, value=value)
        self._told.clear()

    def _hear(self, data: bytes) -> None:
        now, text = monotonic_ns(), data[:MOST_LINE].decode("utf-8", "replace").rstrip("\r")
        self._tail.append("".join(c if c.isprintable() else "?" for c in text[:400]))
        self._keep(now, text)
        if self._ready_ns is None and self._tells is not None and self._find("ready", self._tells, text):
            self._is_ready(now)
        for place, (number, pattern, counts) in enumerate(self._patterns):
            found = self._find(number, pattern, text)
            if found is None:
                continue
            self._counts[place] += 1
            with suppress(ValueError, TypeError):
                self._told[number] = now, float(self._counts[place]) if counts else float(found["value"])

    def _find(self, what: int | str, pattern: re.Pattern[str], text: str) -> re.Match[str] | None:
        """Look for a pattern in a line. One that takes too long is never tried again: it would hold up all others."""
        if what in self._slow:
            return None
        try:
            signal.setitimer(signal.ITIMER_REAL, MOST_MATCH_S)
            try:
                return pattern.search(text)
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
        except TimeoutError:
            self._slow.add(what)
            self._keeper.say(slow=self.name, what=what)
            return None

    def _keep(self, now: int, text: str) -> None:
        if self._written > MOST_LOG:
            return
        begin = self._keeper.begin_ns
        line = f"{'-' if begin is None else format((now - begin) / 1e9, '.3f')} {text}\n"
        self._written += len(line)
        if self._written > MOST_LOG:
            line = f"what it prints after {MOST_LOG} bytes is left out\n"
        try:
            if self._log is None:
                self._log = open(self._values["log"], "a", encoding="utf-8", errors="replace", buffering=1)  # noqa: SIM115
            self._log.write(line)
        except OSError:  # a full disk ends the lines, and no program
            self._written = MOST_LOG + 1

    def has_ended(self, code: int) -> None:
        """Its process has ended, and was reaped."""
        if self._output >= 0:
            self.read()
        if self._output >= 0:  # there was more to read than its end, or somebody whom it has started holds the pipe
            self._close()
        now, killed = monotonic_ns(), self._killed
        for pid in self._tree():  # what it leaves behind would speak in its name
            _send_signal(pid, signal.SIGKILL)
        self.process.returncode = code
        self.process = None
        if killed:
            self._keeper.say(at=now, killed=self.name)
            return
        self._over = True
        self._keeper.say(at=now, ended=self.name, code=code, tail=list(self._tail))

    def _signal_group(self, number: int) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, number)

    def _kill(self) -> None:
        for pid in self._tree():
            _send_signal(pid, signal.SIGKILL)

    def _tree(self) -> list[int]:
        """Its process and all that it has started, as far as it stays in its session or below it."""
        return list(descendants([self.process.pid], session=self.process.pid))


def _holds(spans: list[list[int | None]], now: int) -> bool:
    return any((begin or 0) <= now and (end is None or now < end) for begin, end in spans)


def processes() -> dict[int, tuple[int, int]]:
    """Parent and session of every process that is no zombie."""
    found = {}
    for name in os.listdir("/proc"):
        if not name.isdigit():
            continue
        with suppress(OSError), open(f"/proc/{name}/stat", encoding="utf-8", errors="replace") as file:
            state, parent, _, of = file.read().rpartition(")")[2].split()[:4]
            if state in "ZX":
                continue
            found[int(name)] = int(parent), int(of)
    return found


def descendants(
    roots: list[int], session: int | None = None, among: dict[int, tuple[int, int]] | None = None
) -> Iterator[int]:
    """The processes below some, and those of a session, with its root. `among`: what is known; None: look."""
    among = processes() if among is None else among
    found = set(roots) if session is None else {pid for pid, (_, of) in among.items() if of == session}
    more = True
    while more:
        below = {pid for pid, (parent, _) in among.items() if parent in found and pid not in found}
        found |= below
        more = bool(below)
    yield from sorted(found - set(roots) if session is None else found)


def main() -> None:
    _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    for number in IGNORED:  # the console ends us, with all programs
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, _give_up)
    down: list[str] = []
    is_alone = True  # the console is gone, and has not said that it brings its containers down itself
    try:
        while "programs" not in (first := _first_lines()):
            down = first.get("down", down)
            if first.get("stop"):
                is_alone = False
                return
        kept = Keeper(first["programs"])
        kept.serve()
        is_alone = not kept.stopping
    except EOFError:
        return
    finally:
        if is_alone and down:
            with suppress(OSError, subprocess.SubprocessError):
                subprocess.run(down, stdin=subprocess.DEVNULL, stdout=sys.stderr, timeout=DOWN_S, check=False)


def _first_lines() -> dict[str, Any]:
    """The next line before the keeper listens to all of them. Raises EOFError: the console is gone."""
    line = b""
    while not line.endswith(b"\n"):
        if not (data := os.read(0, 1)):
            raise EOFError
        line += data
    said: dict[str, Any] = json.loads(line)
    return said


if __name__ == "__main__":
    sys.path[:] = sys.path[1:]  # not the folder of this file, whose names are none of Python's modules
    main()
