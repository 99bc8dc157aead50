"""A real `fleet run` in a process group of its own, watched from outside."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import mkstemp
from time import monotonic
from typing import Any, Self

import psutil
from waiting import wait_for

from fleet.mcap.reader import LogReader

FORKSERVER = "forkserver"
# For a machine that does other things at the same time; what is promised is in the tests.
READY_S = 60.0


class Command:
    """`python -m fleet ...` in the background; nothing of it is left when the `with` block ends."""

    def __init__(
        self,
        *arguments: Any,
        environment: dict[str, str] | None = None,
        before: Sequence[str] = (),
        own_group: bool = False,
    ) -> None:
        """`before`: the words before the command, which limit it or make it run on another host."""
        descriptor, name = mkstemp(prefix="printed-")  # not where it writes, which may be a full disk
        self._printed = Path(name)
        with os.fdopen(descriptor, "wb") as printed:
            self._process = subprocess.Popen(
                [*before, sys.executable, "-m", "fleet", *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=subprocess.STDOUT,
                env=os.environ | (environment or {}),
                start_new_session=own_group,
            )
        self.pid = self._process.pid

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait(60)
        self._printed.unlink()

    @property
    def printed(self) -> str:
        """Everything it said, stdout and stderr."""
        return self._printed.read_text("utf-8", "replace")

    @property
    def over(self) -> bool:
        return self._process.poll() is not None

    def until(self, text: str) -> Self:
        """Wait until it has printed that."""
        wait_for(lambda: text in self.printed or self.over, READY_S, f"{text!r}")
        assert text in self.printed, self.printed
        return self

    def send(self, number: signal.Signals, *, group: bool = False) -> None:
        """A signal to it, or to its whole process group as a terminal would send it."""
        (os.killpg if group else os.kill)(self.pid, number)

    def status(self, limit: float = READY_S) -> int:
        """The exit status, a shell's 128 + n for death by signal n; waits for the end."""
        code = self._process.wait(limit)
        return code if code >= 0 else 128 - code


class LiveRun(Command):
    """`python -m fleet run ...` in a group of its own; none of its processes is left when the `with` block ends."""

    def __init__(
        self,
        out: Path,
        *arguments: str,
        verb: str = "run",
        environment: dict[str, str] | None = None,
        host: Sequence[str] = (),
    ) -> None:
        """`host`: the words before the command that make it run on another host."""
        self.out = out
        super().__init__(verb, *arguments, "--out", out, environment=environment, before=host, own_group=True)
        self._met: dict[int, psutil.Process] = {}

    def __exit__(self, *_: object) -> None:
        left = self.alive()
        super().__exit__()
        for process in left:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()

    @property
    def said(self) -> str:
        """The same with all white space as single blanks: tables break long lines."""
        return " ".join(self.printed.split())

    @property
    def directory(self) -> Path:
        return (self.out / "latest").resolve()

    @property
    def log(self) -> Path:
        return self.directory / "run.mcap"

    def family(self) -> list[psutil.Process]:
        """Every process met so far that the console or its fork server started."""
        with contextlib.suppress(psutil.NoSuchProcess):
            for process in psutil.Process(self.pid).children(recursive=True):
                self._met.setdefault(process.pid, process)
        return list(self._met.values())

    def role(self, name: str) -> psutil.Process:
        """The process of a role such as `agent 3`, `world` or `forkserver`."""
        for process in self.family():
            with contextlib.suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
                title = " ".join(process.cmdline())
                if title.startswith(f"fleet {name} [") or (name == FORKSERVER and "forkserver import main" in title):
                    return process
        raise AssertionError(f"no {name} among {[_title(p) for p in self.family()]}; printed: {self.printed}")

    def until_running(self, sim_s: float = 1.0) -> LiveRun:
        """Wait until `sim_s` seconds of sim time can be read from the log."""
        wait_for(lambda: self.over or self.logged_s() >= sim_s, READY_S, f"{sim_s:g} s in the log")
        assert not self.over, f"the run ended early: {self.printed}"
        self.family()
        return self

    def logged_s(self) -> float:
        """Sim time up to which the log can be read now."""
        if not self.log.exists() or not self.log.stat().st_size:
            return 0.0
        return max((record.log_ns for record in LogReader(self.log)), default=0) / 1e9

    def ends(self, status: int, limit: float = READY_S) -> None:
        """It does so soon, with this status, in words and not in a traceback; and nobody is left."""
        watch = Stopwatch()
        assert self.status(limit) == status, self.printed
        self.until_nobody_is_left()
        print(f"over after {watch.s:.2f} s")
        assert watch.s < limit
        assert "Traceback" not in self.said

    def until_nobody_is_left(self, limit: float = READY_S) -> None:
        """Wait until no process that belonged to the run is alive."""
        wait_for(lambda: not self.alive(), limit, f"the end of {[_title(p) for p in self.alive()]}")

    def alive(self) -> list[psutil.Process]:
        return [process for process in self.family() if not gone(process)]


def gone(process: psutil.Process) -> bool:
    """Whether it has ended. A zombie has: where PID 1 does not reap orphans, they stay as such."""
    try:
        return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def _title(process: psutil.Process) -> str:
    try:
        return f"{process.pid} {' '.join(process.cmdline())} ({process.status()})"
    except psutil.Error:
        return f"{process.pid} (gone)"


class Stopwatch:
    """Wall time since it was made."""

    def __init__(self) -> None:
        self._began = monotonic()

    @property
    def s(self) -> float:
        return monotonic() - self._began
