"""The processes of one program, in simulated time: they are granted moments, one process at a time.

The library that is preloaded into each (`preload`) tells over a channel what it sends, and until when it waits.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

from fleet.addons.programs.attachment import Attachment, start_gdb, take_terminal
from fleet.addons.programs.home import Home
from fleet.addons.programs.kernel import cpu_s, memory_kb, process_group, wait_for_end
from fleet.addons.programs.library import compile_library
from fleet.addons.programs.ports import Ports
from fleet.addons.programs.program_output import ProgramOutput
from fleet.errors import FleetError

NEVER = 2**63 - 1
EPOCH_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00 UTC
MOST_PROCESSES = 256  # of one program at a time
MEMORY_MB = 2048  # in use by all its processes together, and in a file: run times reserve terabytes of addresses
LOOK_S = 0.25  # of wall time between two looks at what its processes use
CPU_S = 10.0  # of computing in one turn
MOST_S = 20.0  # of wall time, too
STUCK_S = 60.0  # of wall time in which a process neither answers nor computes
MOST_TURNS = 20_000  # of one moment: processes that wake each other go on at the next tick
MOST_FULL = 100  # moments with so many turns, one after the other: they wake each other without an end
_DID_SOMETHING, _ONLY_INSIDE = 1, 2
_HAS_TERMINAL = 2  # of the configuration
_CONFIGURATION = struct.Struct("<qqqQIIIIII")
_HEAD = struct.Struct("<IB")
_PART = 1 << 14  # bytes that are read at once: for more, each read would ask the system for memory
_LOOK = struct.pack("ll", 0, round(LOOK_S * 1e6))  # a timeval
_KEPT = ("PATH", "OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE")  # of our environment; runs depend on the rest no more
_OF_EVERYBODY = ("/", "/tmp", "/home", "/var/tmp", "/run", "/dev/shm")
# One thread in place of five pools of zenoh: they would wake each other, and no two threads run at a time anyway.
_ZENOH_RUNTIME = (
    "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app), app: (worker_threads: 1))"
)


class ProgramEnded(FleetError):
    """A program has ended, in a way that is no good end."""


@dataclass
class Process:
    """One process, and its end of the channel."""

    pid: int  # the number that the program knows
    channel: socket.socket
    family: int  # which first process it comes from: 0 is the program, others are helpers of ours beside it
    meets: int  # a family whose processes may wait for what it does, as they share files: the own one, or 0
    parent: int = 0
    deadline: int = 0
    inside: bool = False  # it waits for nothing that could come from outside
    did_something: bool = False
    buffer: bytearray = field(default_factory=bytearray)
    inbox: bytearray = field(default_factory=bytearray)
    real: int = 0
    alive: bool = True
    executions: int = 0
    began: bool = False  # an executable, in this turn


Told = Callable[
    [Process, int, bytes], None
]  # what a process tells: the message's kind and its bytes; 0: it has no sockets


class Processes:
    """A program that runs: its first process, and those that it has started."""

    def __init__(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        files: Sequence[Path],
        *,
        agent: int,
        agents: int,
        seed: int,
        tick_ns: int,
        now_ns: int,
        told: Told,
        epoch_ns: int = EPOCH_NS,
        other_addresses: bool = False,
        disk: Path | None = None,
        disk_before: Path | None = None,
        attached: Attachment | None = None,
        processors: int = 1,
    ) -> None:
        """Start it; nothing of it runs before `begin`.

        Args:
            command: its command line.
            environment: variables beside those that every program gets.
            files: files and folders that are copied into its home.
            agent: number of the agent.
            agents: how many there are.
            seed: of all that is chance in it.
            tick_ns: the time that passes for a program which looks at the clock again and again [ns].
            now_ns: the time of its beginning [ns].
            told: takes what is not for the processes themselves, such as datagrams.
            epoch_ns: the real time at the beginning of a run [ns since 1970].
            other_addresses: agents have other addresses, too, than those of their nodes.
            disk, disk_before: see `Home`.
            attached: who sits at it; None: nobody.
            processors: how many it sees. One thread runs at a time, whatever it sees.

        Raises:
            NoLibraryError: programs cannot run here.
            ProgramEnded: it cannot be started.
        """
        self._owner = os.getpid()
        self._agent, self._agents, self._seed, self._tick_ns, self._epoch_ns = agent, agents, seed, tick_ns, epoch_ns
        self.now_ns, self._told = now_ns, told
        self._flags = int(other_addresses) | processors << 8
        self._attached = attached
        self._gdb: subprocess.Popen[bytes] | None = None
        if attached is not None and not attached.gdb:
            self._flags |= _HAS_TERMINAL
        self._closed = False
        self._home = Home(files, agent, agents, epoch_ns, processors, disk, disk_before)
        self._processes: dict[int, Process] = {}
        self._ports = Ports()
        self._next_pid = 1000 + agent
        self._looked = monotonic()
        self._full = 0  # moments with too many turns, one after the other
        self.status: int | None = None  # of the first process, as of subprocess.Popen; None: it runs
        self.refused = ""  # what the library has refused, in its words
        self._texts = [ProgramOutput(), ProgramOutput()]
        self._may_have_printed = False
        self._visible = _visible([*command, *environment.values()])
        self._popens: list[subprocess.Popen[bytes]] = []  # of the first process of each family
        self._first = self._start(command, environment, *(text.file for text in self._texts))

    def begin(self) -> None:
        """Let the program run until it waits for the first time. Raises ProgramEnded, as `advance`."""
        self._read_turn(self._first)
        if self.status == 0 and not self._first.executions:
            raise ProgramEnded("the library was not loaded into it: it ran outside of simulated time")

    def begin_helper(
        self, command: Sequence[str], environment: Mapping[str, str] | None = None, *, shares_files: bool = False
    ) -> int:
        """Start a program of ours beside it, with the same addresses, and let it run until it waits.

        It is no part of the program: it has none of its signals, and ends with it. What it prints goes to the program's
        errors. `shares_files`: it and the program wait for what the other does to files, such as a terminal.

        Returns:
            The helper's family, see `send`.

        Raises:
            ProgramEnded: as `advance`.
        """
        err = self._texts[1].file
        self._visible += [each for each in _visible(command) if each not in self._visible]
        process = self._start(command, environment or {}, err, err)
        process.meets = 0 if shares_files else process.family
        self._read_turn(process)
        return process.family

    def _start(self, command: Sequence[str], environment: Mapping[str, str], out: int, err: int) -> Process:
        library, launcher = compile_library()
        ours, its = socket.socketpair()
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _LOOK)
        variables = _environment(self._seed) | dict(environment)
        at_terminal = bool(self._flags & _HAS_TERMINAL) and not self._popens
        outputs = ("-", "-") if at_terminal else (out, err)
        start = [launcher, its.fileno(), *outputs, self._home.path, library, MEMORY_MB, self._owner, "--", *command]
        try:
            popen = subprocess.Popen(
                [*map(str, start)],
                env=dict(sorted(variables.items())),  # its order is seen in memory
                pass_fds=sorted({its.fileno(), out, err}),
                stdin=None if at_terminal else subprocess.DEVNULL,
            )
        except OSError as error:
            ours.close()
            self.close()
            raise ProgramEnded(f"it cannot be started: {error}") from None
        finally:
            its.close()
        self._popens.append(popen)
        process = self._add(ours, 0, len(self._popens) - 1)
        process.real = popen.pid
        return process

    def _add(self, channel: socket.socket, parent: int, family: int) -> Process:
        process = Process(self._next_pid, channel, family, family, parent)
        self._next_pid += 1000  # so that agents and their processes have numbers of their own
        self._processes[process.pid] = process
        return process

    def _configuration(self, process: Process) -> bytes:
        process.executions += 1
        chance = (self._seed * 1_000_003 + process.pid * 101 + process.executions) & (2**64 - 1)
        prefix = 24 if self._agents < 255 else 16
        numbers = (self.now_ns, self._tick_ns, self._epoch_ns, chance)
        head = _CONFIGURATION.pack(
            *numbers, process.pid, process.parent or 1, self._agent, prefix, self._agents, self._flags
        )
        return head + b"\0".join([os.fsencode(self._home.path), *map(os.fsencode, self._visible)]) + b"\0\0"

    def advance(self, until_ns: int, before_last: Callable[[], object] | None = None) -> None:
        """Let time pass up to a moment, each timer at its own. What was sent before comes at the first one.

        Args:
            until_ns: the moment [ns].
            before_last: called after each moment but the last one, while `now_ns` is its time.

        Raises:
            ProgramEnded: a process computes without an end, or does not answer.
        """
        while self._processes and (due := min(p.deadline for p in self._processes.values())) < until_ns:
            self._moment(max(due, self.now_ns))
            if before_last is not None:
                before_last()
        self._moment(until_ns)

    def jump(self, now_ns: int) -> None:
        """Let time be another one [ns], without the moments between: what was due then is due now, all at once.

        Raises:
            ProgramEnded: as `advance`.
        """
        self._moment(now_ns)

    def send(
        self,
        kind: int,
        data: bytes,
        *,
        to: int = 0,
        but: int = 0,
        family: int | None = None,
        outside: int | None = None,
    ) -> None:
        """Hand a message to processes with their next turn, in this moment.

        Args:
            kind: of the message.
            data: its bytes.
            to: number of the only process that gets it; 0: all.
            but: number of one that does not get it.
            family: only processes of this family get it; None: of all.
            outside: no process of this family gets it; None: of all.
        """
        message = _HEAD.pack(1 + len(data), kind) + data
        if to:
            if process := self._processes.get(to):
                process.inbox += message
            return
        for process in self._processes.values():
            if process.pid != but and family in (None, process.family) and process.family != outside:
                process.inbox += message

    def _moment(self, now_ns: int) -> None:
        self.now_ns = now_ns
        turns = 0
        while due := [p for p in self._processes.values() if p.inbox or p.deadline <= now_ns or p.did_something]:
            if turns > MOST_TURNS:
                self._go_on_later(due)
                return
            # What one has done, such as to write into a pipe, others may be waiting for.
            again = {p.meets for p in due if p.did_something}
            for process in self._processes.values():
                process.did_something = False
            for process in [p for p in self._processes.values() if p.meets in again or p in due] if again else due:
                turns += 1
                if process.alive:
                    self._turn(process)
            if monotonic() - self._looked > LOOK_S:
                self._check_memory()
        self._full = 0

    def _go_on_later(self, due: Sequence[Process]) -> None:
        """Let processes that have had many turns at one moment go on at the next tick, as a loop does."""
        self._full += 1
        if self._full > MOST_FULL:
            text = "its processes wake each other without an end"
            raise ProgramEnded(f"{text}: {MOST_TURNS} turns at each of {MOST_FULL} moments")
        for process in due:
            process.deadline = self.now_ns + self._tick_ns

    def _turn(self, process: Process) -> None:
        data = bytes(process.inbox) + _HEAD.pack(9, ord("T")) + struct.pack("<q", self.now_ns)
        process.inbox.clear()
        process.did_something = False
        self._debug(process)
        try:
            process.channel.sendall(data)
        except OSError:
            self._ended(process)
            return
        self._read_turn(process)

    def _read_turn(self, process: Process) -> None:
        """Take what a process tells until its turn is over."""
        self._may_have_printed = True
        buffer, begun = process.buffer, None
        while True:
            while len(buffer) >= 5:
                length, kind = _HEAD.unpack_from(buffer)
                if len(buffer) < 4 + length:
                    break
                data = bytes(buffer[5 : 4 + length])
                del buffer[: 4 + length]
                if kind == 73:  # I: it waits
                    process.deadline, flags = struct.unpack("<qB", data)
                    process.inside = bool(flags & _ONLY_INSIDE)
                    did = bool(flags & _DID_SOMETHING) or process.began  # an exec closes files, too
                    process.did_something, process.began = did and self._has_relatives(process), False
                    return
                self._take(process, kind, data)
            try:
                data, control, _, _ = process.channel.recvmsg(_PART, 64)
            except BlockingIOError:
                begun = self._look_after(process, begun)
                continue
            except OSError:
                data, control = b"", []
            if control:
                self._adopt(process, control)
            if not data:
                self._ended(process)
                return
            buffer += data

    def _has_relatives(self, process: Process) -> bool:
        return len(self._processes) > 1 and any(
            p.meets == process.meets and p is not process for p in self._processes.values()
        )

    def _take(self, process: Process, kind: int, data: bytes) -> None:
        if kind == 72:  # H: the library is loaded
            process.began = True
            self._debug(process)
            self._ports.on_process_ended(process.pid)
            if process.executions:
                self._told(process, 0, b"")  # its sockets are not known to what it executes
            self._answer(process, b"J" + self._configuration(process))
        elif kind == 71:  # G: a signal for another process
            which, number = struct.unpack("<qB", data)
            self._answer(process, b"U" + bytes((self._kill(process, which, number),)))
        elif kind == 66:  # B: it binds a socket
            self._answer(process, b"U" + self._ports.book(process.pid, data))
        elif kind == 67:  # C: it closes one
            self._ports.leave(process.pid, data)
        elif kind == 89:  # Y: the kernel's number of a process that it has started
            number, real = struct.unpack("<II", data)
            if number in self._processes:
                self._processes[number].real = real
        elif kind == 82:  # R: it does something that is not emulated
            self.refused = data.decode("utf-8", "replace")
        elif kind != 78:  # N comes with a descriptor, see `_adopt`
            self._told(process, kind, data)

    def answer(self, process: Process, data: bytes) -> None:
        """Answer a question that a process has asked in its turn."""
        self._answer(process, data)

    def _answer(self, process: Process, data: bytes) -> None:
        with suppress(OSError):
            process.channel.sendall(len(data).to_bytes(4, "little") + data)

    def _adopt(self, parent: Process, control: list[tuple[int, int, bytes]]) -> None:
        """A process starts another one, and has sent the other's end of a channel."""
        (descriptor,) = struct.unpack("i", control[0][2][:4])
        if len(self._processes) >= MOST_PROCESSES:
            os.close(descriptor)
            self._answer(parent, b"J" + bytes(_CONFIGURATION.size) + b"\0\0")
            return
        channel = socket.socket(fileno=descriptor)
        channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _LOOK)
        child = self._add(channel, parent.pid, parent.family)
        child.meets = parent.meets
        child.deadline = 0
        self._answer(parent, b"J" + self._configuration(child))

    def _kill(self, sender: Process, which: int, number: int) -> bool:
        relatives = [p for p in self._processes.values() if p.family == sender.family]
        found = [p for p in relatives if which in (p.pid, -1) or (which == -p.pid)]
        for process in found:
            if process is sender or not number:
                continue
            if number == signal.SIGKILL:
                self._kill_now(process)
            else:
                process.inbox += _HEAD.pack(2, ord("G")) + bytes((number,))
        return bool(found)

    def _kill_now(self, process: Process) -> None:
        if process.real:
            with suppress(OSError):
                os.kill(process.real, signal.SIGKILL)
        self._ended(process)

    def _ended(self, process: Process) -> None:
        process.alive = False
        process.channel.close()
        self._told(process, 0, b"")
        self._ports.on_process_ended(process.pid)
        self._processes.pop(process.pid, None)
        if process is self._first:
            self.status = self._popens[0].wait()
        elif process.real:
            wait_for_end(process.real)
        self.send(ord("C"), process.pid.to_bytes(4, "little"), family=process.family)

    def _look_after(self, process: Process, begun: tuple[float, float] | None) -> tuple[float, float]:
        """Called again and again while a process does not answer."""
        if self._attached is not None:
            return 0.0, 0.0  # somebody thinks
        self._check_memory()
        leader = self._popens[process.family].pid
        used = sum(map(cpu_s, process_group(leader)))
        if begun is None:
            return used, monotonic()
        first, since = begun
        # Beside other work a process gets little of the processor, and the run would end before it has had 10 s.
        long = monotonic() - since > MOST_S and used - first > 0.2 * CPU_S
        if used - first > CPU_S or long:
            self._show_stack(leader, signal.SIGXCPU)
            raise ProgramEnded(f"it computed for {CPU_S:g} s and did not wait")
        if monotonic() - since > STUCK_S and used - first < 0.1 * CPU_S:
            self._show_stack(leader, signal.SIGABRT)
            raise ProgramEnded("it waits in the kernel for something that is not emulated")
        return begun

    def _debug(self, process: Process) -> None:
        """Attach the debugger that is asked for, if it is time."""
        at = self._attached
        if at is None or not at.gdb or self._gdb is not None or self.now_ns < at.at_ns or process is not self._first:
            return
        self._gdb = start_gdb(process.real)

    def _check_memory(self) -> None:
        """Raise ProgramEnded if its processes use too much, before the machine has none left."""
        self._looked = monotonic()
        pids = [process.real for process in self._processes.values() if process.real]
        most_kb = MEMORY_MB << 10
        # What processes share counts for each of them at first; the exact figure takes the kernel long.
        if sum(memory_kb(pid, "status", ("RssAnon:", "RssShmem:")) for pid in pids) <= most_kb:
            return
        if (used := sum(memory_kb(pid, "smaps_rollup", ("Pss_Anon:", "Pss_Shmem:")) for pid in pids)) > most_kb:
            raise ProgramEnded(f"it uses {used >> 10} MiB of memory; {MEMORY_MB} MiB are the most of an agent")

    def _show_stack(self, leader: int, number: int) -> None:
        with suppress(OSError):
            os.kill(leader, number)
        with suppress(subprocess.TimeoutExpired):
            next(popen for popen in self._popens if popen.pid == leader).wait(3)

    @property
    def soonest_ns(self) -> int:
        """Until when all processes wait, unless something comes [ns]."""
        return min((p.deadline for p in self._processes.values()), default=NEVER)

    @property
    def count(self) -> int:
        """How many processes there are."""
        return len(self._processes)

    @property
    def running(self) -> bool:
        """Whether any process of the program is left."""
        return self.family_runs(0)

    def family_runs(self, family: int) -> bool:
        """Whether any process of a family is left, see `begin_helper`."""
        return any(p.family == family for p in self._processes.values())

    @property
    def next_family(self) -> int:
        """The family of the helper that is begun next, see `begin_helper`."""
        return len(self._popens)

    @property
    def is_dead(self) -> bool:
        """Whether no thread of any process can ever run again: nothing that they wait for can come."""
        own = [p for p in self._processes.values() if p.meets == 0]
        return bool(own) and all(p.inside and p.deadline == NEVER for p in own)

    @property
    def problem(self) -> str:
        """Why its end is no good one; "": it is one."""
        if self.refused or not self.status:
            return self.refused
        if self.status == -signal.SIGXFSZ:
            return f"a file of it has more than {MEMORY_MB} MiB, the most of an agent"
        return f"exit status {self.status}" if self.status > 0 else f"ended by signal {-self.status}"

    def show_threads(self) -> None:
        """Let the processes print where their threads wait, and end."""
        for process in self._processes.values():
            with suppress(OSError):
                process.channel.sendall(_HEAD.pack(1, ord("B")))
        deadline = monotonic() + 3
        for process in self._processes.values():
            process.channel.settimeout(max(0.05, deadline - monotonic()))
            with suppress(OSError):
                while process.channel.recv(1 << 16):
                    pass

    def lines(self) -> list[tuple[str, str]]:
        """What has been printed since the last call: the stream, `out` or `err`, and a line."""
        over = not self.running
        if not (self._may_have_printed or over):
            return []  # to look costs two calls of the kernel
        self._may_have_printed = False
        out = [("out", line) for line in self._texts[0].lines(over)]
        return out + [("err", line) for line in self._texts[1].lines(over)]

    def close(self) -> None:
        """End all that runs, and delete the home. In a copy of the process that has started it: nothing."""
        if os.getpid() != self._owner or self._closed:
            return
        self._closed = True
        if self._gdb is not None:
            self._gdb.wait()
        elif self._attached is not None and self._attached.gdb:
            os.write(1, b"gdb was not attached: the program had ended before.\n")
        if self._flags & _HAS_TERMINAL:
            take_terminal()
        for popen in self._popens:
            for pid in process_group(popen.pid):
                with suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            with suppress(OSError):
                os.killpg(popen.pid, signal.SIGKILL)
            with suppress(OSError):
                popen.kill()
            popen.wait()
        for process in self._processes.values():
            process.channel.close()
        self._processes.clear()
        for text in self._texts:
            text.close()
        self._home.close()


def _environment(seed: int) -> dict[str, str]:
    """What every program finds in its environment."""
    kept = {key: value for key, value in os.environ.items() if key in _KEPT}
    return kept | {
        "HOME": "/home/auv", "USER": "auv", "LOGNAME": "auv", "TMPDIR": "/tmp", "LANG": "C.UTF-8", "TZ": "UTC",
        "OPENBLAS_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE", "KMP_BLOCKTIME": "0",  # one thread runs at a time
        "PYTHONHASHSEED": str(seed % 2**32), "PYTHONUNBUFFERED": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        "ZENOH_RUNTIME": _ZENOH_RUNTIME,
        "PYTHONFAULTHANDLER": "1",  # a stack when it computes without an end, or waits for ever
        "GLIBC_TUNABLES": "glibc.pthread.rseq=0",  # else the kernel writes the processor's number into each thread
        "OPENSSL_ia32cap": "~0x4000000000000000:~0x40000",  # no RDRAND and no RDSEED, which nobody can trap
    }  # fmt: skip


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a long text is no path
        return False


def _visible(command: Sequence[str]) -> list[str]:
    """Folders below /tmp and the like that the program is to see: its own file, this Python, and what it is told of.

    What is not there, such as a file that it will write, is one of its own disk.
    """
    found = [sys.prefix, sys.base_prefix]
    paths = [path for word in command if word.startswith("/") and _exists(path := Path(word))]
    if found_in_path := shutil.which(command[0]):
        paths.append(Path(found_in_path))
    for path in paths:
        for each in (path, path.resolve()):
            found.append(str(each))
            folder = each if each.is_dir() else each.parent
            found.append(str(folder.parent if folder.name == "bin" else folder))
    return [folder for folder in dict.fromkeys(found) if folder not in _OF_EVERYBODY]
