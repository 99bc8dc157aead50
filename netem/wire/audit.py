"""The router's refusals, one line each, taken from zenoh's own log. The rest of that log is left out.

Zenoh reports refusals only in its log. At level debug it writes a line for each refused login. At level trace it writes
a line for each message, allowed or not. So refused logins are always reported. Refused messages are reported only if a
run is audited, since that costs about a tenth of its speed. Zenoh writes its log to stdout. Here stdout is a socket,
and a thread reads it.

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

from netem.wire.session import PIECE_BYTES, log_zenoh

log = logging.getLogger(__name__)

LOGINS = (
    "error,zenoh_transport::unicast::establishment::accept=debug,zenoh_transport::unicast::manager=debug,"
    "zenoh_transport::unicast::lowlatency::link=debug,zenoh_link_tls::unicast=warn"
)
DECISIONS = LOGINS + ",zenoh::net::routing::interceptor::access_control=trace"
MOST_ENDED = 1000  # sessions that are remembered
MOST_KINDS = 200  # of refusals that are counted apart
MOST_KEY = 200  # characters of a key that are reported
MOST_LINE = 1000  # bytes of a line that are looked at: a key may have 48,000
WRITE_S = 0.05
BUFFER = 1 << 20  # bytes between zenoh and the reader
_ACTIONS = 9  # that access control decides on for a key in advance, in a row, when it is declared

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_LOGIN = re.compile(r"establishment::accept: UsrPwd extension - Recv \w+\. (.+?)\.? at /")
_THREAD = re.compile(r"ThreadId\((\d+)\)")
_ADVANCE = re.compile(r"access_control: ACL \((?:in|e)gress\): caching permissions for ")
# Nothing before the key is of a client's choosing, so the first match counts: a key may contain all these words.
_DECISION = re.compile(
    r"access_control: (Using cached result: )?([0-9a-f]+)(.*?) is (un)?authorized to ([\w/ ]+?) \((in|e)gress\) on (.+)"
)
_STAMP = re.compile(r"\d{4}-\d\d-\d\dT[\d:.]+Z ")
_OPENED = re.compile(r"New transport opened between (\w+) and (\w+) - .* lowlatency: false")
_TLS = re.compile(r"zenoh_link_tls::unicast: (.+?)\. Hint: ")
CUT_OFF = f"cut off, as what came is no message or one of more than {PIECE_BYTES} bytes"
# A session that closes may say so as if it were not low-latency: two bytes of length, 2, and a byte 3, which read as a
# length are 196,610. Nothing is wrong then.
_TOO_LONG = re.compile(r"Rx task finished with result Err\(Batch len is invalid\. Received (?!196610 )")
_CUT_OFF = re.compile(r"<on rx exit> finalizing transport with peer: (\w+)")
# A certificate counts where there is no password: the router for agents with certificates only.
_USER = re.compile(r"(?:Username|CertCommonName)\(([^)]*)\)")
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
        self._users: dict[str, str] = {}  # by zenoh id of the session
        self._ended: dict[str, None] = {}  # zenoh ids of sessions, in the order in which they ended
        self._skip: dict[str, int] = {}  # by thread: decisions in advance still to come
        self._too_long: set[str] = set()  # threads that have logged a piece too long, and will log whose it is
        self._fragmenting: dict[str, None] = {}  # zenoh ids of sessions that are not low-latency, the oldest first
        self._universal: set[str] = set()  # zenoh ids of routers of ours whose sessions need not be

    def report_to(self, report: Callable[[str], None]) -> None:
        """Call `report` with the first refusal of each kind, past ones included, on a thread of its own."""
        assert self._reporter is None

        def serve() -> None:
            while True:
                report(self._unreported.get())

        self._reporter = threading.Thread(target=serve, name="refusals", daemon=True)
        self._reporter.start()

    def expect_universal(self, router: str) -> None:
        """A router of ours, by its zenoh id, speaks zenoh's universal transport: that is nothing to report."""
        self._universal.add(router)

    def line(self, line: str) -> bool:
        """Take one line; False if it is about something else, and worth keeping."""
        line = _COLOUR.sub("", line)
        if "access_control: " in line:
            self._decision(line)
            return True
        if "establishment::accept: " in line:
            if (login := _LOGIN.search(line)) is not None:
                self._refuse(_LOGINS.get(login[1], f"a login ({login[1]})"))
            return True
        if "unicast::manager: " in line:
            if (opened := _OPENED.search(line)) is not None and opened[1] not in self._universal:
                self._fragments(opened[2])
            return "ERROR" not in line
        if "zenoh_link_tls::unicast: " in line:
            if (tls := _TLS.search(line)) is not None:
                self._count(f"a TLS handshake failed: {tls[1]}")
            return "ERROR" not in line
        if "lowlatency::link: " in line:
            self._link(line)
            return "ERROR" not in line
        return False

    def end(self, session: str) -> None:
        """A session has ended: its user may log in again. Zenoh's log may still have lines about it for a while."""
        self._ended[session] = None
        if len(self._ended) > MOST_ENDED:
            oldest = next(iter(self._ended))
            del self._ended[oldest]
            self._users.pop(oldest, None)

    def _fragments(self, session: str) -> None:
        """A session that is not low-latency sends long messages in pieces. Zenoh drops them without a word, and leaves
        the session alone: only that it could happen can be reported."""
        self._fragmenting[session] = None
        if len(self._fragmenting) > MOST_ENDED:
            del self._fragmenting[next(iter(self._fragmenting))]
        self._count(f"{self._name(session)}: its session is not low-latency, and long messages of it are dropped")

    def _link(self, line: str) -> None:
        """Of two lines on one thread, the first says why a session is cut off, and the second whose it is."""
        if _TOO_LONG.search(line):
            self._too_long.add(_thread(line))
        elif (found := _CUT_OFF.search(line)) is not None and _thread(line) in self._too_long:
            self._too_long.discard(_thread(line))
            self._count(f"{self._name(found[1])}: {CUT_OFF}")

    def _name(self, session: str) -> str:
        return self._users.get(session, "somebody")

    def _decision(self, line: str) -> None:
        thread = _thread(line)
        if _ADVANCE.search(line):
            self._skip[thread] = _ACTIONS
            return
        in_advance = self._skip.get(thread, 0) > 0 and "Using cached" not in line
        if in_advance:
            self._skip[thread] -= 1
        if (decision := _DECISION.search(line)) is None:
            return
        _, session, about, un, action, way, key = decision.groups()
        if len(_STAMP.findall(line[: decision.start(7)])) > 1:
            self._count("zenoh's log was not read in time")  # two lines have become one
            return
        if way == "e":
            return
        if (user := _USER.search(about)) is not None and self._users.get(session) != user[1]:
            self._meet(session, user[1])
        if un and not in_advance:
            self._refuse(f"{self._name(session)}: {action.lower()} on {key[:MOST_KEY]}")

    def _meet(self, session: str, user: str) -> None:
        self._users[session] = user
        if session in self._fragmenting:
            self._fragments(session)  # now it has a name
        others = [s for s, name in self._users.items() if name == user and s != session]
        # An agent has one session at a time; operators come and go.
        if user.startswith("agent-") and not self._ended.keys() >= {*others}:
            self._count(f"{user}: logged in twice")

    def _refuse(self, what: str) -> None:
        self._count(f"refused {what}")

    def _count(self, what: str) -> None:
        """Called on the reader's thread alone."""
        if what not in self.counts and len(self.counts) >= MOST_KINDS:
            what = "refused more kinds of messages"
        self.counts[what] += 1
        if self.counts[what] == 1:
            log.warning("%s", what)
            self._unreported.put(what)


def listen(refusals: Refusals, *, decisions: bool) -> None:
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

    threading.Thread(target=read, name="audit", daemon=True).start()
    log_zenoh(DECISIONS if decisions else LOGINS)


def _follow(source: int, stdout: int, refusals: Refusals) -> None:
    rest = b""
    while data := os.read(source, 1 << 16):
        *lines, rest = (rest + data).split(b"\n")
        rest = rest[:MOST_LINE]
        for line in lines:
            head = line[:MOST_LINE]
            at = head.find(b"authorized to ")
            if (
                at > 0
                and head[at - 1 : at] == b" "
                and not any(who in head for who in (b"Username", b"CertCommonName"))
            ):
                continue  # nearly all of them, when decisions are logged
            if not refusals.line(head.decode("utf-8", "replace")):
                # Whatever becomes of the line (the disk may be full), zenoh would wait if this thread did not read on.
                with suppress(OSError):
                    os.write(stdout, line + b"\n")


def _thread(line: str) -> str:
    """The thread that wrote a line of the log."""
    found = _THREAD.search(line)
    return "" if found is None else found[1]
