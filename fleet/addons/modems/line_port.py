"""The port of a modem: clients on TCP, or one on a pseudo terminal, who speak in lines; served by one thread.

A client that sends rubbish, no line feed, or takes nothing hurts only itself: a line that is too long, and answers that
nobody takes, end its connection. A terminal has no connections, and stays for the next program: it forgets such a line,
and what is said while nobody reads is lost, as on a serial line.
"""

from __future__ import annotations

import errno
import os
import selectors
import socket
import traceback
import tty
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from typing import Any, Protocol

from netem.errors import BusError

MOST_LINE = 1 << 20  # bytes: a fjage message with a payload in text is far shorter
MOST_WAITING = 1 << 20  # bytes that a client leaves waiting
MOST_CLIENTS = 64
MOST_UNREAD = 1 << 12  # bytes on a terminal that nobody reads, beside what its kernel keeps
_READ = 1 << 16
_FULL = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)  # there is no room for one more connection
_REST_S = 0.5  # until a client that waits is looked for again


class Client:
    """One program that has opened the modem."""

    def __init__(self, descriptor: int, close: Callable[[], None], *, terminal: bool = False) -> None:
        self.descriptor, self.close, self.terminal = descriptor, close, terminal
        self.unfinished = b""  # the beginning of a line
        self.waiting = bytearray()  # what it has not taken yet
        self.state: Any = None  # the translator's own


class Translator(Protocol):
    """The language of a modem. All calls come on the thread of its port."""

    delimiter: bytes  # ends a line of a client

    def on_opened(self, client: Client) -> None:
        """A program has opened the modem."""

    def on_line(self, client: Client, line: bytes) -> None:
        """A program has said a line."""

    def on_partial(self, client: Client) -> None:
        """A program has said the beginning of a line, which is in `said`."""

    def on_closed(self, client: Client) -> None:
        """A program is gone."""


class LinePort:
    """The clients of one modem, and the thread that serves them."""

    def __init__(self, translator: Translator, tick: Callable[[], float | None]) -> None:
        """Prepare it.

        Args:
            translator: understands what clients say.
            tick: called after each event; returns after how many seconds it has to be called again, or None.
        """
        self._translator, self._tick = translator, tick
        self._selector = selectors.DefaultSelector()
        self._events: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._wake, self._woken = os.pipe()[::-1]
        os.set_blocking(self._wake, False)
        os.set_blocking(self._woken, False)
        self._selector.register(self._woken, selectors.EVENT_READ, self._drain)
        self._thread = Thread(target=self._serve, daemon=True)
        self._over = False
        self._resting: tuple[socket.socket, float] | None = None  # who is not listened to, and until when [s]
        self.failed = False  # whether something that happened has found a defect of ours
        self._link: Path | None = None
        self._terminal = ""  # what the link leads to
        self.clients: list[Client] = []
        self.port = 0

    def listen(self, host: str, port: int) -> None:
        """Listen on TCP. Raises BusError: the port cannot be used."""
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, port))
        except OSError as error:
            listening.close()
            why = f"cannot listen on {host}:{port} for modem clients: {error.strerror}"
            raise BusError(f"{why}; give the modem another port, or 0 for a free one") from None
        listening.listen(16)
        listening.setblocking(False)
        self.port = listening.getsockname()[1]
        self._attend(listening)

    def open_terminal(self, path: Path) -> None:
        """Make a pseudo terminal that programs open by a path. Raises BusError: something else is there."""
        try:
            # A link to a terminal that is gone is that of a run that was killed. Links of others may lead to nothing,
            # too, such as the locks of browsers. It is asked first: the new terminal may have the old one's name.
            if path.is_symlink() and not path.exists() and os.readlink(path).startswith("/dev/pts/"):
                path.unlink()
            if path.is_symlink() or path.exists():
                raise BusError(f"cannot make the terminal {path}: something is there; remove it, or give another path")
            ours, theirs = os.openpty()
            tty.setraw(theirs)
            self._terminal = os.ttyname(theirs)
            path.symlink_to(self._terminal)
        except OSError as error:
            raise BusError(f"cannot make the terminal {path}: {error.strerror}") from None
        self._link = path
        os.set_blocking(ours, False)
        # `theirs` stays open: a terminal that nobody holds open gives an error to us when a client goes.
        self._add(Client(ours, lambda: None, terminal=True))

    def begin(self) -> None:
        """Serve from now on."""
        self._thread.start()

    def post(self, event: Callable[[], None]) -> None:
        """Let the thread of the port call something."""
        self._events.put(event)
        with suppress(BlockingIOError, OSError):
            os.write(self._wake, b"!")

    def say(self, client: Client, data: bytes) -> None:
        """Send a client something, at once or when it takes it."""
        if client not in self.clients or (client.terminal and len(client.waiting) > MOST_UNREAD):
            return
        client.waiting += data
        self._flush(client)
        if len(client.waiting) > MOST_WAITING:
            self.end(client)

    def end(self, client: Client) -> None:
        """End a connection; a terminal only forgets what was said."""
        if client.terminal:
            client.unfinished, client.waiting = b"", bytearray()
        if client.terminal or client not in self.clients:
            return
        self.clients.remove(client)
        with suppress(KeyError, ValueError):
            self._selector.unregister(client.descriptor)
        client.close()
        self._translator.on_closed(client)

    def close(self) -> None:
        """End everything."""
        self._over = True
        self.post(lambda: None)
        if self._thread.is_alive():
            self._thread.join(2.0)
        if self._resting is not None:
            self._resting[0].close()
        for key in list(self._selector.get_map().values()):
            with suppress(OSError):
                if isinstance(key.fileobj, socket.socket):
                    key.fileobj.close()
        for client in list(self.clients):
            client.close()
        with suppress(OSError):  # somebody has removed it, or put something else there
            if self._link is not None and os.readlink(self._link) == self._terminal:
                self._link.unlink()

    def _serve(self) -> None:
        while not self._over:
            wait_s = self._tick()
            if self._resting is not None:
                listening, until_s = self._resting
                left_s = until_s - monotonic()
                if left_s <= 0.0:
                    self._resting = None
                    self._attend(listening)
                else:
                    wait_s = left_s if wait_s is None else min(wait_s, left_s)
            for key, _ in self._selector.select(wait_s):
                key.data()

    def _attend(self, listening: socket.socket) -> None:
        self._selector.register(listening, selectors.EVENT_READ, lambda: self._accept(listening))

    def _drain(self) -> None:
        with suppress(BlockingIOError):
            os.read(self._woken, _READ)
        with suppress(Empty):
            while True:
                self.do(self._events.get_nowait())

    def do(self, event: Callable[[], None]) -> None:
        """Do something that a client did not ask for. A defect of ours ends that, and not the modem."""
        try:
            event()
        except Exception:
            traceback.print_exc()
            self.failed = True

    def _accept(self, listening: socket.socket) -> None:
        try:
            made, _ = listening.accept()
        except OSError as error:
            if error.errno in _FULL:  # the client waits still, so that the thread would try again without an end
                self._selector.unregister(listening)
                self._resting = listening, monotonic() + _REST_S
            return
        if len(self.clients) >= MOST_CLIENTS:
            made.close()
            return
        made.setblocking(False)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._add(Client(made.fileno(), made.close))

    def _add(self, client: Client) -> None:
        self.clients.append(client)
        self._selector.register(client.descriptor, selectors.EVENT_READ, lambda: self._ready(client))
        self._translator.on_opened(client)

    def _ready(self, client: Client) -> None:
        if client in self.clients:
            self._flush(client)
        if client not in self.clients:  # its descriptor may be another one's by now
            return
        try:
            data = os.read(client.descriptor, _READ)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.end(client)
            return
        *lines, client.unfinished = (client.unfinished + data).split(self._translator.delimiter)
        if len(client.unfinished) > MOST_LINE:
            self.end(client)
            return
        for line in lines:
            if client not in self.clients:
                return
            self._do_for(client, partial(self._translator.on_line, client, line))
        if client.unfinished and client in self.clients:
            self._do_for(client, partial(self._translator.on_partial, client))

    def _do_for(self, client: Client, event: Callable[[], None]) -> None:
        """Do what a client wants. A defect of ours at an odd line costs it alone; the relay's log has it."""
        try:
            event()
        except Exception:
            traceback.print_exc()
            self.end(client)

    def _flush(self, client: Client) -> None:
        try:
            while client.waiting:
                del client.waiting[: os.write(client.descriptor, client.waiting)]
        except BlockingIOError:
            pass
        except OSError:
            self.end(client)
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        with suppress(KeyError, ValueError):
            key = self._selector.get_key(client.descriptor)
            if key.events != wanted:
                self._selector.modify(client.descriptor, wanted, key.data)
