"""The logins that the router refuses, one line each, taken from zenoh's own log. The rest of that log is left out.

Zenoh reports refusals only in its log, which it writes to stdout: `auth_identifier` of a link is empty for passwords.
Here stdout is a socket, and a thread reads it. A pipe that does not block would lose lines, and a file would grow
without end. Refused messages are not read. Zenoh reports them only at level trace, beside a line for every allowed
message, which cost a tenth of the speed.

If the socket's buffer is full, the thread that writes a line waits. Any thread of the router may write, even while it
holds Python's lock. So the reader only reads and counts. Another thread sends the reports, because each report is a put
and makes zenoh write further lines. No thread waits longer than WRITE_S. Then the line is lost.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import struct
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue

from netem.wire.session import log_zenoh

log = logging.getLogger(__name__)

LEVELS = "error,zenoh_transport::unicast::establishment::accept=debug,zenoh_link_tls::unicast=warn"
MOST_KINDS = 200  # kinds of refusals that are counted apart
MOST_LINE = 1000  # bytes of a line that are looked at
WRITE_S = 0.05
BUFFER = 1 << 20  # bytes between zenoh and the reader

_LOGIN = re.compile(r"UsrPwd extension - Recv \w+\. (.+?)\.? at /")
_TLS = re.compile(r"zenoh_link_tls::unicast: (.+?)\. Hint: ")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_LOGINS = {
    "Invalid password": "a login with a wrong password",
    "Invalid user": "a login of an unknown user",
    "Expected extension": "a login without credentials",
}


class Refusals:
    """Reads zenoh's log line by line, counts what was refused by kind, and reports the first of each kind."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._unreported: SimpleQueue[str] = SimpleQueue()  # each kind once
        self._reporter: threading.Thread | None = None

    def report_to(self, report: Callable[[str], None]) -> None:
        """Call `report` with the first refusal of each kind, past ones included, on a thread of its own."""
        assert self._reporter is None

        def serve() -> None:
            while True:
                report(self._unreported.get())

        self._reporter = threading.Thread(target=serve, name="refusals", daemon=True)
        self._reporter.start()

    def line(self, line: str) -> bool:
        """Take one line; False if it is about something else, and worth keeping."""
        line = _COLOUR.sub("", line)
        if "establishment::accept: " in line:
            if (login := _LOGIN.search(line)) is not None:
                self._count(f"refused {_LOGINS.get(login[1], f'a login ({login[1]})')}")
            return True
        if "zenoh_link_tls::unicast: " in line:
            if (tls := _TLS.search(line)) is not None:
                self._count(f"a TLS handshake failed: {tls[1]}")
            return "ERROR" not in line
        return False

    def _count(self, what: str) -> None:
        """Called on the reader's thread alone."""
        if what not in self.counts and len(self.counts) >= MOST_KINDS:
            what = "refused more kinds of logins"
        self.counts[what] += 1
        if self.counts[what] == 1:
            log.warning("%s", what)
            self._unreported.put(what)


def listen(refusals: Refusals) -> None:
    """Start zenoh's log and feed it to `refusals`; lines about anything else go where stdout went before.

    With RUST_LOG set, zenoh's log goes to stdout as it is: the operator wants to see all of it.
    """
    if os.environ.get("RUST_LOG"):
        log_zenoh("error")
        return
    stdout = os.dup(1)
    reader, writer = socket.socketpair()
    with writer:
        writer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        writer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", 0, int(WRITE_S * 1e6)))
        os.dup2(writer.fileno(), 1)

    def read() -> None:
        with reader:  # if it ends, writes of zenoh fail at once
            _follow(reader.fileno(), stdout, refusals)

    threading.Thread(target=read, name="refusals of zenoh", daemon=True).start()
    log_zenoh(LEVELS)


def _follow(source: int, stdout: int, refusals: Refusals) -> None:
    rest = b""
    while data := os.read(source, 1 << 16):
        *lines, rest = (rest + data).split(b"\n")
        rest = rest[:MOST_LINE]
        for line in lines:
            if not refusals.line(line[:MOST_LINE].decode("utf-8", "replace")):
                # Whatever becomes of the line (the disk may be full), zenoh would wait if this thread did not read on.
                with suppress(OSError):
                    os.write(stdout, line + b"\n")
