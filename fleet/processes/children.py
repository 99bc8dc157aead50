"""The processes of a run: started by one preloaded fork server, watched, and ended with the console.

The fork server of multiprocessing imports everything once, so a child costs milliseconds and shares pages. Every wait
for it is bounded, because a suspended one reports nothing.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import multiprocessing.forkserver
import multiprocessing.process
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import setproctitle

from fleet.errors import RunBroken
from fleet.processes.child_start import (
    CONSOLE_PID_VARIABLE,
    PRELOAD_VARIABLE,
    children_ignore_the_folder,
    die_with_parent,
    without_main,
)
from fleet.processes.interrupts import deferring_interrupts, out_of_reach
from fleet.processes.limits import allow_most_open_files, start_thread
from fleet.processes.run_folder import own_folder_for_multiprocessing
from netem.errors import BusError

GRACE_S = 1.0
START_S = 20.0  # the fork server imports everything first, and the machine may be busy
FORKSERVER_LOST = 255  # multiprocessing's exit code for a child whose forkserver is gone
TAIL_LINES = 12


@dataclass(frozen=True, slots=True)
class Exit:
    """The end of a process: its role, its exit code (negative: the signal that killed it) and its process id."""

    role: str
    code: int
    pid: int


@dataclass(frozen=True, slots=True)
class Child:
    """One running process and where its output goes."""

    role: str
    process: BaseProcess
    log_path: Path

    @property
    def pid(self) -> int:
        assert self.process.pid is not None
        return self.process.pid

    def tail(self) -> list[str]:
        try:
            lines = self.log_path.read_text("utf-8", "replace").splitlines()
        except OSError:
            return []
        return lines[-TAIL_LINES:]


class Children:
    """Starts processes, calls `on_exit` for each that ends (on a thread of its own), and ends them all."""

    def __init__(self, on_exit: Callable[[Exit], None]) -> None:
        self._on_exit = on_exit
        self._context = multiprocessing.get_context("forkserver")
        self.by_role: dict[str, Child] = {}
        self._forkserver: int | None = None  # the one that started them: they have ended if it has
        self._stopping = threading.Event()
        self._watcher: threading.Thread | None = None

    def start(self, role: str, title: str, log_path: Path, target: Callable[..., None], *args: Any) -> None:
        """Start `target(*args)` as a process of its own, with `title` in `ps` and its output in `log_path`; the role of
        a process that has ended may be used again.

        Raises TimeoutError if the fork server did not answer, and was ended; OSError or EOFError if it has ended, and
        so what it started before, or there is no room for another process; KeyboardInterrupt that came meanwhile, when
        the process was started; RunBroken if the system gives no thread.
        """
        _set_preload()
        process = self._context.Process(
            target=_child, args=(title, str(log_path), target, args), name=role, daemon=True
        )
        # A process that is there is known, and so will be ended, before an interrupt is raised. The block alone does
        # not see to that: another thread may take the signal, and then Python raises in this one.
        with deferring_interrupts():
            # multiprocessing would start another fork server, and how this one ended would stay unknown.
            if self._forkserver is not None and (death := forkserver_death()) is not None:
                raise ChildProcessError(death)
            with _forkserver_starting(), _bounded_wait():
                process.start()
            self.by_role[role] = Child(role, process, log_path)
            started_by = _forkserver_pid()
            if self._forkserver not in (None, started_by):  # the fork server ended in between
                raise ChildProcessError(f"the fork server (pid {self._forkserver}) is gone")
            self._forkserver = started_by

    def watch(self) -> None:
        """Begin to call `on_exit`, also for processes that are started later. Raises RunBroken: no thread for it."""
        watcher = threading.Thread(target=self._watch, name="exit-watch", daemon=True)
        start_thread(watcher)
        self._watcher = watcher  # `stop` waits for it, and can only wait for one that was started

    def stop(self) -> None:
        """End every process with SIGTERM, then with SIGKILL, which ends suspended processes, too. The fork server
        reports the ends. If it does not, it is suspended, and is ended as well.
        """
        self._stopping.set()
        if self._watcher is not None:
            self._watcher.join()
        processes = [child.process for child in self.by_role.values()]
        for process in processes:
            process.terminate()
        remaining = _wait_for_end(processes)
        for process in remaining:
            process.kill()
        if _wait_for_end(remaining):
            _kill_forkserver()
        for process in processes:
            process.join(GRACE_S)

    def _watch(self) -> None:
        ended: set[int] = set()
        while not self._stopping.is_set():
            running: dict[Any, Child] = {
                child.process.sentinel: child for child in list(self.by_role.values()) if child.pid not in ended
            }
            for sentinel in wait(list(running), timeout=0.1):
                child = running[sentinel]
                ended.add(child.pid)
                child.process.join()
                code = child.process.exitcode
                self._on_exit(Exit(child.role, FORKSERVER_LOST if code is None else code, child.pid))


def start_forkserver(modules: str | None = None) -> None:
    """Start the fork server, which imports what all processes need while its caller does something else, and ends with
    this process. `Children.start` does so, too, if no caller did before; it must be called on the same thread, the main
    one. Raises OSError if there is no room for another process.

    Args:
        modules: names of the modules that its children run, with spaces between. None: those of a run of vehicles.
    """
    allow_most_open_files()  # how many vehicles there will be is not known yet
    _set_preload()
    with deferring_interrupts(), _forkserver_starting(modules):
        multiprocessing.forkserver.ensure_running()


def _set_preload() -> None:
    assert threading.current_thread() is threading.main_thread(), "PDEATHSIG follows the forking thread"
    children_ignore_the_folder()
    multiprocessing.forkserver.set_forkserver_preload(["fleet.processes.preload"])


@contextlib.contextmanager
def _forkserver_starting(modules: str | None = None) -> Iterator[None]:
    own_folder_for_multiprocessing()
    told = {CONSOLE_PID_VARIABLE: str(os.getpid())} | ({} if modules is None else {PRELOAD_VARIABLE: modules})
    with without_main(), out_of_reach(), _telling(told):
        yield


def _wait_for_end(processes: list[BaseProcess]) -> list[BaseProcess]:
    remaining: dict[Any, BaseProcess] = {process.sentinel: process for process in processes}
    while remaining and (ended := wait(list(remaining), timeout=GRACE_S)):
        for sentinel in ended:
            remaining.pop(sentinel)
    return list(remaining.values())


@contextlib.contextmanager
def _telling(variables: dict[str, str]) -> Iterator[None]:
    # The fork server alone gets them: any other process with the first would expect to be our child, and end at once.
    os.environ.update(variables)
    try:
        yield
    finally:
        for name in variables:
            del os.environ[name]


@contextlib.contextmanager
def _bounded_wait() -> Iterator[None]:
    """Raise TimeoutError where a fork server does not answer in time; it is ended."""
    why: list[str] = []

    def give_up() -> None:
        pid = _forkserver_pid()
        how = "is suspended" if pid and is_suspended(pid) else "does not answer"
        why.append(f"the fork server (pid {pid}) {how}, for {START_S:g} s now")
        _kill_forkserver()  # the thread that waits for its answer gets an end of file

    patience = threading.Timer(START_S, give_up)
    patience.daemon = True
    start_thread(patience)
    try:
        yield
    except (EOFError, OSError) as error:
        if why:
            raise TimeoutError(why[0]) from error
        raise
    finally:
        patience.cancel()


def _kill_forkserver() -> None:
    """SIGKILL also ends a suspended one; its children end with it (`fleet.processes.child_start`)."""
    pid = _forkserver_pid()
    if pid is not None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _forkserver_pid() -> int | None:
    return getattr(multiprocessing.forkserver._forkserver, "_forkserver_pid", None)


def forkserver_death(patience_s: float = 0.0) -> str | None:
    """How the fork server ended; None: it lives. Its sockets close a moment before it can be reaped."""
    pid = _forkserver_pid()
    if pid is None:
        return None
    deadline = time.monotonic() + patience_s
    try:
        # Without reaping it: its number stays its own, and multiprocessing sees that a next run needs another one.
        while (found := os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is None:
            if time.monotonic() >= deadline:
                return None
            time.sleep(0.005)
    except ChildProcessError:
        return f"the fork server (pid {pid}) is gone"
    code = found.si_status if found.si_code == os.CLD_EXITED else -found.si_status
    return f"the fork server (pid {pid}) {describe_exit(code)}"


def forkserver_suspended() -> str:
    """Words that the fork server, which reports all ends, is suspended; empty: it is not."""
    pid = _forkserver_pid()
    return f"the fork server (pid {pid}) is suspended" if pid is not None and is_suspended(pid) else ""


def is_suspended(pid: int) -> bool:
    """Whether a process is stopped, by a forgotten SIGSTOP for instance."""
    return _status(pid) in ("stopped", "tracing-stop")


def has_ended(pid: int) -> bool:
    """Whether a process has ended and was not reaped."""
    return _status(pid) == "zombie"


def _status(pid: int) -> str:
    import psutil  # only when a run stands still

    try:
        return str(psutil.Process(pid).status())
    except psutil.Error:
        return ""


def describe_exit(code: int) -> str:
    """An exit code in words: `exited with status 1`, `was killed by SIGKILL`."""
    if code >= 0:
        return f"exited with status {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"was killed by {name}"


def _child(title: str, log_path: str, target: Callable[..., None], args: tuple[Any, ...]) -> None:
    from fleet.processes.preload import FORKSERVER_PID

    die_with_parent(FORKSERVER_PID)
    setproctitle.setproctitle(title)
    # Python's own handler would run only between two bytecodes; the default action ends even a hung process.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        descriptor = os.open(log_path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    except FileNotFoundError:  # the run's directory was removed: the run was ended before this process had begun
        os._exit(1)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    os.close(descriptor)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    code = 1
    try:
        start_thread(threading.Thread(target=_end_with_console, name="console-watch", daemon=True))
        target(*args)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except (BusError, RunBroken) as error:
        print(error, file=sys.stderr)  # about the run, not about our code: it says all
    except BaseException:
        traceback.print_exc()
    finally:
        # At once: the interpreter's own way out joins zenoh's threads, which may wait for others of the run.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _end_with_console() -> None:
    # Besides PDEATHSIG: end of file on the console's pipe.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
