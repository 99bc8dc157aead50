"""What stands in for the parts of Python that ask the host for time, chance, processes or the terminal."""

from __future__ import annotations

import datetime as real_datetime
import os as real_os
import sys as real_sys
import time as real_time
from collections.abc import Callable, Mapping, Sequence
from io import TextIOBase
from random import Random
from types import ModuleType
from typing import Any

from fleet.addons.programs.turns import NS, Turns

EPOCH_NS = 1_767_225_600 * NS  # 2026-01-01 00:00 UTC is time.time() at the beginning of a run: an assumption
_MOST_LINE = 2000  # characters of one printed line

NO_PROCESSES = "a program in lockstep has no processes of its own: start them as agents, or use fleet netem"
NO_SOCKETS = "a program in lockstep has datagrams (UDP) and no streams: use fleet netem for programs that need them"
REFUSED: Mapping[str, str] = {
    **dict.fromkeys(("subprocess", "multiprocessing", "pty", "_posixsubprocess"), NO_PROCESSES),
    **dict.fromkeys(("ssl", "socketserver", "http", "ftplib", "smtplib", "imaplib", "telnetlib", "xmlrpc"), NO_SOCKETS),
    **dict.fromkeys(("zenoh.ext", "zenoh.shm"), "what zenoh adds to its core is not in lockstep; use fleet netem"),
    "ctypes": "what a library in C does is not in lockstep; use fleet netem",
    "trio": "only asyncio has a stand-in for its clock; use fleet netem",
}


def stand_in(real: ModuleType, **own: Any) -> ModuleType:
    """A module that is as a real one, or an empty one, but for what a program has of its own."""
    made = ModuleType(real.__name__)
    vars(made).update(vars(real) | own)
    return made


def time_module(turns: Turns) -> ModuleType:
    """The module `time`: the clock of the program, and waits that give its turn away."""

    def sleep(seconds: float) -> None:
        if seconds < 0:
            raise ValueError("sleep length must be non-negative")
        turns.wait(turns.now_ns + max(1, round(min(seconds, 1e9) * NS)))  # 0 s: until the next tick

    def time_s() -> float:
        return (EPOCH_NS + turns.now_ns) / NS

    def of_now(function: Callable[..., Any], now: Callable[[], Any] = time_s, place: int = 0) -> Function:
        def call(*arguments: Any) -> Any:
            given = arguments[place] if len(arguments) > place else None
            return function(*arguments[:place], now() if given is None else given)

        return Function(call)

    gmtime = of_now(real_time.gmtime)
    return stand_in(
        real_time, time=time_s, time_ns=lambda: EPOCH_NS + turns.now_ns, sleep=sleep, gmtime=gmtime,
        localtime=gmtime, ctime=of_now(real_time.ctime), asctime=of_now(real_time.asctime, gmtime),
        strftime=of_now(real_time.strftime, gmtime, 1), clock_gettime=lambda _: turns.now_ns / NS,
        clock_gettime_ns=lambda _: turns.now_ns,
        **{name: lambda: turns.now_ns / NS for name in _CLOCKS},
        **{f"{name}_ns": lambda: turns.now_ns for name in _CLOCKS},
    )  # fmt: skip


class Function:
    """A function that is no method where a class holds it, as those in C are none (`logging.Formatter.converter`)."""

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)


_CLOCKS = ("monotonic", "perf_counter", "process_time", "thread_time")


def datetime_module(turns: Turns) -> ModuleType:
    """The module `datetime`, whose now is that of the program; local time is UTC."""

    def now_s() -> float:
        return (EPOCH_NS + turns.now_ns) / NS

    class datetime(real_datetime.datetime):  # noqa: N801 (its name)
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return cls.fromtimestamp(now_s(), tz or real_datetime.UTC).replace(tzinfo=tz)

        today = now

        @classmethod
        def utcnow(cls) -> Any:
            return cls.now()

    class date(real_datetime.date):  # noqa: N801
        @classmethod
        def today(cls) -> Any:
            return datetime.now().date()

    return stand_in(real_datetime, datetime=datetime, date=date)


def random_module(plain: ModuleType, chance: Random) -> ModuleType:
    """The module `random`, loaded for this program alone, whose generators without a seed take theirs from `chance`."""
    seeded: Any = plain.Random.seed

    def seed(self: Any, a: Any = None, version: int = 2) -> None:
        seeded(self, chance.getrandbits(64) if a is None else a, version)

    plain.Random.seed = seed
    plain._inst.seed()
    return plain


def os_module(chance: Random, number: int) -> ModuleType:
    """The module `os`: random bytes by the seed of the run, and no processes."""

    def refuse(*_: Any, **__: Any) -> Any:
        raise OSError(NO_PROCESSES)

    environment = dict(real_os.environ)
    return stand_in(
        real_os, **dict.fromkeys(_STARTERS & vars(real_os).keys(), refuse), register_at_fork=lambda **_: None,
        urandom=chance.randbytes, getrandom=lambda size, flags=0: chance.randbytes(size), environ=environment,
        getenv=environment.get, getpid=lambda: 1000 + number, getppid=lambda: 1, cpu_count=lambda: 1,
    )  # fmt: skip


_STARTERS = {
    *("abort", "fork", "forkpty", "kill", "killpg", "popen", "posix_spawn", "posix_spawnp", "startfile", "system"),
    "_exit",
    *(name for name in dir(real_os) if name.startswith(("exec", "spawn"))),
}


def signal_module() -> ModuleType:
    """The module `signal`: handlers are taken and never called, because a kill ends a program at once."""
    import signal as real_signal

    handlers: dict[Any, Any] = {}
    return stand_in(
        real_signal, signal=lambda number, handler: handlers.update({number: handler}), getsignal=handlers.get,
        alarm=lambda _: 0, setitimer=lambda *_: (0.0, 0.0), pause=lambda: None, raise_signal=lambda _: None,
    )  # fmt: skip


class Output(TextIOBase):
    """A standard stream of a program, whose lines go to whoever reads them."""

    encoding = "utf-8"

    def __init__(self, hear: Callable[[str], None]) -> None:
        self._hear, self._line = hear, ""

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        *lines, self._line = (self._line + text).split("\n")
        for line in lines:
            self._hear(line[:_MOST_LINE])
        self._line = self._line[:_MOST_LINE]
        return len(text)

    def flush(self) -> None: ...


def sys_module(arguments: Sequence[str], modules: Mapping[str, ModuleType], path: list[str], out: Output) -> ModuleType:
    """The module `sys`: the program's arguments, modules and streams."""

    class NoInput(TextIOBase):
        def readable(self) -> bool:
            return True

        def readline(self, size: int | None = -1) -> str:  # type: ignore[override]
            return ""

        def read(self, size: int | None = -1) -> str:
            return ""

    return stand_in(
        real_sys, argv=[*arguments], orig_argv=["python", *arguments], modules=modules, path=path, stdin=NoInput(),
        stdout=out, stderr=out, __stdout__=out, __stderr__=out, setswitchinterval=lambda _: None,
        settrace=lambda _: None, setprofile=lambda _: None,
    )  # fmt: skip


def print_to(out: Output) -> Callable[..., None]:
    """The function `print` of a program."""

    def print_(
        *words: Any, sep: str | None = " ", end: str | None = "\n", file: Any = None, flush: bool = False
    ) -> None:
        (out if file is None else file).write(
            (" " if sep is None else sep).join(map(str, words)) + ("\n" if end is None else end)
        )

    return print_
