"""An event loop for asyncio in simulated time: asyncio's own, which gives the turn away where it would wait."""

from __future__ import annotations

import asyncio
import sys
from asyncio import base_events, events
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from random import Random
from types import ModuleType
from typing import Any

from fleet.addons.programs.datagrams import Address, Datagrams
from fleet.addons.programs.standard import NO_PROCESSES, NO_SOCKETS, stand_in
from fleet.addons.programs.turns import NS, ProgramThread, Turns

_Base: Any = base_events.BaseEventLoop  # its methods differ in their types from version to version


@contextmanager
def loop_aside() -> Iterator[None]:
    """Take the running loop and the hooks of asyncio from this thread, and give them back afterwards.

    Who runs a program may have a loop, and each program that waits in the same thread may have one.
    """
    running, hooks = events._get_running_loop(), sys.get_asyncgen_hooks()
    events._set_running_loop(None)
    sys.set_asyncgen_hooks(None, None)
    try:
        yield
    finally:
        events._set_running_loop(running)
        sys.set_asyncgen_hooks(*hooks)


class _Shuffled(deque[Any]):
    """Callbacks that are ready, in an order by chance: a program may not count on theirs."""

    def __init__(self, chance: Random) -> None:
        super().__init__()
        self._chance = chance

    def popleft(self) -> Any:
        self.rotate(-self._chance.randrange(len(self)))
        return super().popleft()


class ProgramLoop(_Base):  # type: ignore[misc]
    """An event loop of a program."""

    def __init__(self, turns: Turns, datagrams: Datagrams, shuffle: Random | None) -> None:
        """Make a loop that is not running.

        Args:
            turns: the program's threads.
            datagrams: its sockets.
            shuffle: orders callbacks that are ready at the same time; None: the order in which they became so.
        """
        super().__init__()
        self._turns, self._datagrams = turns, datagrams
        self._thread: ProgramThread | None = None
        turns.at_end.append(self._forget)
        self._selector = self
        self._asleep = False
        if shuffle is not None:
            self._ready = _Shuffled(shuffle)

    def time(self) -> float:
        """The program's clock [s]."""
        return self._turns.now_ns / NS

    def select(self, timeout: float | None) -> list[Any]:
        """Wait, in place of a selector of files: until a callback is due, or something has come."""
        if timeout is not None and timeout <= 0:
            return []
        self._thread, self._asleep = self._turns.current, True
        try:
            with loop_aside():
                self._turns.wait(None if timeout is None else self._turns.now_ns + max(1, round(timeout * NS)))
        finally:
            self._asleep = False
        return []

    def _forget(self) -> None:
        """Say nothing about tasks that were under way, and of being closed by nobody: the program has ended."""
        for task in asyncio.all_tasks(self):
            task._log_destroy_pending = False  # type: ignore[attr-defined]
        self._closed = True

    def _process_events(self, event_list: Any) -> None: ...

    def _write_to_self(self) -> None:
        if self._asleep and self._thread is not None:
            self._turns.wake(self._thread)

    def call_from_outside(self, callback: Callable[..., object], *arguments: Any) -> None:
        """Call something in the loop, and end its wait."""
        if not self.is_closed():
            self.call_soon(callback, *arguments)
            self._write_to_self()

    def run_in_executor(self, executor: Any, func: Callable[..., Any], *args: Any) -> Any:
        """Call a function in a thread of the program. Computing takes no simulated time, and waiting does."""
        future = self.create_future()

        def settle(set_it: Callable[[Any], object], value: Any) -> None:
            if not future.done():  # who awaited it may have been cancelled
                set_it(value)

        def work() -> None:
            try:
                result = func(*args)
            except Exception as error:
                self.call_from_outside(settle, future.set_exception, error)
            else:
                self.call_from_outside(settle, future.set_result, result)

        self._turns.start(work)
        return future

    async def shutdown_default_executor(self, timeout: Any = None) -> None:
        """There is none."""

    def add_signal_handler(self, sig: Any, callback: Any, *args: Any) -> None:
        """Take a handler that is never called, because a kill ends a program at once."""

    def remove_signal_handler(self, sig: Any) -> bool:
        """Nothing is to be removed."""
        return False

    async def create_datagram_endpoint(
        self, protocol_factory: Any, local_addr: Any = None, remote_addr: Any = None, **_: Any
    ) -> Any:
        """A transport of datagrams between agents."""
        protocol = protocol_factory()
        transport = DatagramEndpoint(self, self._datagrams, protocol, local_addr, remote_addr)
        made = self.create_future()

        def begin() -> None:  # one callback, since others may run in an order by chance
            try:
                protocol.connection_made(transport)
            finally:
                made.set_result(None)

        self.call_soon(begin)
        await made
        return transport, protocol

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise NotImplementedError(NO_SOCKETS)

    create_connection = create_server = create_unix_connection = create_unix_server = connect_accepted_socket = _refuse
    sock_connect = sock_accept = sock_recv = sock_sendall = start_tls = _refuse
    add_reader = add_writer = remove_reader = remove_writer = connect_read_pipe = connect_write_pipe = _refuse

    async def subprocess_exec(self, *_: Any, **__: Any) -> Any:
        """Refuse."""
        raise NotImplementedError(NO_PROCESSES)

    subprocess_shell = subprocess_exec


class DatagramEndpoint(asyncio.DatagramTransport):
    """A socket of the loop."""

    def __init__(
        self, loop: ProgramLoop, datagrams: Datagrams, protocol: Any, local: Address | None, remote: Address | None
    ) -> None:
        super().__init__()
        self._loop, self._datagrams, self._protocol, self._remote = loop, datagrams, protocol, remote
        self._closed = False
        self._port = datagrams.bind(local[1] if local else 0, self._hear)

    def _hear(self, data: bytes, source: Address) -> None:
        self._loop.call_from_outside(self._protocol.datagram_received, data, source)

    def sendto(self, data: Any, addr: Any = None) -> None:
        """Send a datagram; what cannot be sent is told to the protocol, as asyncio does."""
        if (to := addr or self._remote) is None:
            raise ValueError("no address to send to")
        try:
            self._datagrams.send(bytes(data), self._port, to)
        except OSError as error:
            self._protocol.error_received(error)

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Its addresses."""
        book = self._datagrams.book
        known = {"sockname": book.shown(book.own, self._port), "peername": self._remote}
        return known.get(name, default)

    def close(self) -> None:
        """Hear nothing more."""
        if not self._closed:
            self._closed = True
            self._datagrams.close(self._port)
            self._loop.call_soon(self._protocol.connection_lost, None)

    abort = close

    def is_closing(self) -> bool:
        """Whether it is closed."""
        return self._closed


class Loops:
    """The loops of one program, and which of them is its current one."""

    def __init__(self, make: Callable[[], ProgramLoop]) -> None:
        self.make = make
        self.current: ProgramLoop | None = None

    def get(self) -> Any:
        """The loop that runs, or else the current one; there is always one."""
        if (running := events._get_running_loop()) is not None:
            return running
        if self.current is None:
            self.current = self.make()
        return self.current

    def set(self, loop: Any) -> None:
        """Make a loop the current one."""
        self.current = loop

    def run(self, main: Any, *, debug: bool | None = None, **_: Any) -> Any:
        """Run a coroutine in a loop of its own."""
        with Runner(self, debug=debug) as runner:
            return runner.run(main)


class Runner:
    """As asyncio's, but for signals."""

    def __init__(self, loops: Loops, *, debug: bool | None = None, loop_factory: Any = None) -> None:
        self._loops, self._loop = loops, (loop_factory or loops.make)()
        if debug:
            self._loop.set_debug(True)

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def get_loop(self) -> Any:
        """Its loop."""
        return self._loop

    def run(self, coro: Any, *, context: Any = None) -> Any:
        """Run a coroutine to its end."""
        self._loops.set(self._loop)
        return self._loop.run_until_complete(self._loop.create_task(coro))

    def close(self) -> None:
        """Cancel what is left, and end the loop."""
        loop = self._loop
        if loop.is_closed():
            return
        left = asyncio.all_tasks(loop)
        for task in left:
            task.cancel()
        if left:
            loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
        loop.run_until_complete(loop.shutdown_asyncgens())
        loop.close()
        self._loops.set(None)


def asyncio_module(turns: Turns, datagrams: Datagrams, shuffle: Random | None) -> ModuleType:
    """The module `asyncio` of one program, whose loops are `ProgramLoop`."""
    loops = Loops(partial(ProgramLoop, turns, datagrams, shuffle))
    return stand_in(
        asyncio, run=loops.run, Runner=partial(Runner, loops), new_event_loop=loops.make, get_event_loop=loops.get,
        set_event_loop=loops.set, SelectorEventLoop=loops.make,
        set_event_loop_policy=lambda _: None,
    )  # fmt: skip
