"""What the router refused, in a line each: taken from zenoh's own log, all else of which is left out.

Zenoh refuses silently but for its log: a login at level debug, once per connection, and what access control decides
at level trace, a line per message, allowed or not. Refused logins are therefore always told, and refused messages
when a run is audited, which costs about a tenth of its speed. Zenoh writes to stdout; here that is a pipe, which a
thread reads.
"""

from __future__ import annotations

import logging
import os
import re
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress

from netem.bus import log_zenoh

log = logging.getLogger(__name__)

LOGINS = "error,zenoh_transport::unicast::establishment::accept=debug"
DECISIONS = LOGINS + ",zenoh::net::routing::interceptor::access_control=trace"
MOST_ENDED = 1000  # sessions that are remembered
MOST_KINDS = 200  # of refusals that are told apart
_ACTIONS = 9  # that access control decides on for a key in advance, in a row, when it is declared

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_LOGIN = re.compile(r"establishment::accept: UsrPwd extension - Recv \w+\. (.+?)\.? at /")
_THREAD = re.compile(r"ThreadId\((\d+)\)")
_ADVANCE = re.compile(r"access_control: ACL \((?:in|e)gress\): caching permissions for ")
_DECISION = re.compile(
    r"access_control: (Using cached result: )?([0-9a-f]+)(.*) is (un)?authorized to (.+) \(ingress\) on (.+)"
)
_USER = re.compile(r"Username\(([^)]*)\)")
_LOGINS = {
    "Invalid password": "a login with a wrong password",
    "Invalid user": "a login of an unknown user",
    "Expected extension": "a login without credentials",
}


class Refusals:
    """Reads zenoh's log line by line, counts what was refused by kind, and tells the first of each kind."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._tell: Callable[[str], None] = lambda _: None
        self._lock = threading.Lock()
        self._users: dict[str, str] = {}  # by zenoh id of the session
        self._ended: dict[str, None] = {}  # zenoh ids of sessions, in the order in which they ended
        self._skip: dict[str, int] = {}  # by thread: decisions in advance still to come

    def tell(self, tell: Callable[[str], None]) -> None:
        """From now on call `tell` with the first of each kind; at once with those that were before."""
        with self._lock:
            self._tell = tell
            for what in self.counts:
                tell(what)

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
        return False

    def end(self, session: str) -> None:
        """A session has ended: its user may log in again. Zenoh's log may still tell of it for a while."""
        self._ended[session] = None
        if len(self._ended) > MOST_ENDED:
            oldest = next(iter(self._ended))
            del self._ended[oldest]
            self._users.pop(oldest, None)

    def _decision(self, line: str) -> None:
        found = _THREAD.search(line)
        thread = "" if found is None else found[1]
        if _ADVANCE.search(line):
            self._skip[thread] = _ACTIONS
            return
        in_advance = self._skip.get(thread, 0) > 0 and "Using cached" not in line
        if in_advance:
            self._skip[thread] -= 1
        if (decision := _DECISION.search(line)) is None:
            return
        _, session, about, un, action, key = decision.groups()
        if (user := _USER.search(about)) is not None and self._users.get(session) != user[1]:
            self._meet(session, user[1])
        if un and not in_advance:
            self._refuse(f"{self._users.get(session, 'somebody')}: {action.lower()} on {key}")

    def _meet(self, session: str, user: str) -> None:
        self._users[session] = user
        others = [s for s, name in self._users.items() if name == user and s != session]
        # An agent has one session at a time; operators come and go.
        if user.startswith("agent-") and not self._ended.keys() >= {*others}:
            self._count(f"{user}: logged in twice")

    def _refuse(self, what: str) -> None:
        self._count(f"refused {what}")

    def _count(self, what: str) -> None:
        with self._lock:
            if what not in self.counts and len(self.counts) >= MOST_KINDS:
                what = "refused more kinds of messages"
            self.counts[what] += 1
            if self.counts[what] == 1:
                log.warning("%s", what)
                self._tell(what)


def listen(refusals: Refusals, *, decisions: bool) -> None:
    """Start zenoh's log and feed it to `refusals`; lines about anything else go where stdout went before.

    With RUST_LOG set, zenoh's log goes to stdout as it is: somebody wants to see all of it.
    """
    if os.environ.get("RUST_LOG"):
        log_zenoh("error")
        return
    stdout = os.dup(1)
    source, sink = os.pipe()
    os.dup2(sink, 1)
    os.close(sink)
    threading.Thread(target=_follow, args=(source, stdout, refusals), name="audit", daemon=True).start()
    log_zenoh(DECISIONS if decisions else LOGINS)


def _follow(source: int, stdout: int, refusals: Refusals) -> None:
    rest = b""
    while data := os.read(source, 1 << 16):
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            if b" is authorized to " in line and b"Username" not in line:
                continue  # nearly all of them, when decisions are logged
            if not refusals.line(line.decode("utf-8", "replace")):
                # Whatever becomes of the line (the disk may be full), zenoh would wait for ever if nobody read on.
                with suppress(OSError):
                    os.write(stdout, line + b"\n")
