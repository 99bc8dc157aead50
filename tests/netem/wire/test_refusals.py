"""The logins that the router refused, read from zenoh's log: what, how often; and nobody waits for it."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

from waiting import wait_for

from netem.wire.refusals import MOST_KINDS, Refusals, _follow

STAMP = "\x1b[2m2026-11-21T11:00:00.000000Z\x1b[0m \x1b[35mDEBUG\x1b[0m app-0 ThreadId(02) \x1b[1mdemux\x1b[0m: "
ACCEPT = STAMP + "zenoh_transport::unicast::establishment::accept: "
LOGIN = ACCEPT + "UsrPwd extension - Recv InitSyn. {} at /root/.cargo/git/usrpwd.rs:424."


def refusals(*lines: str) -> dict[str, int]:
    found = Refusals()
    for line in lines:
        found.line(line)
    return dict(found.counts)


def test_a_failed_handshake_is_told() -> None:
    tls = STAMP.replace("DEBUG", "WARN") + "zenoh_link_tls::unicast: "
    hint = ". Hint: increase the system open file limit."
    assert refusals(
        f"{tls}peer sent no certificates{hint}",
        f"{tls}invalid peer certificate: UnknownIssuer{hint}",
    ) == {
        "a TLS handshake failed: peer sent no certificates": 1,
        "a TLS handshake failed: invalid peer certificate: UnknownIssuer": 1,
    }  # fmt: skip


def test_telling_holds_up_nobody() -> None:
    """To tell is to put, which waits, and writes lines into the log that is being read."""
    found, (source, sink) = Refusals(), os.pipe()
    never = threading.Event()
    found.report_to(lambda _: bool(never.wait()))
    lines = "".join(f"{LOGIN.format(f'{n:0700}')}\n" for n in range(400)).encode()
    feeding = threading.Thread(target=lambda: os.write(sink, lines) and os.close(sink))
    feeding.start()
    reading = threading.Thread(target=_follow, args=(source, source, found), daemon=True)
    reading.start()
    reading.join(60)
    assert not reading.is_alive()
    assert sum(found.counts.values()) == 400


def test_nobody_waits_for_the_reader() -> None:
    """If the log is not read at all, a write ends after a moment; whoever wrote goes on."""
    script = """
import os, sys, threading
import netem.wire.refusals as refusals
refusals._follow = lambda *_: threading.Event().wait()
refusals.log_zenoh = lambda levels: None
refusals.listen(refusals.Refusals())
try:
    while True:
        os.write(1, bytes(10_000))
except BlockingIOError:
    sys.exit(0)
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)


def test_logins_are_told_in_words() -> None:
    words = ("Invalid password.", "Invalid user.", "Expected extension.", "Whatever comes next.")
    assert refusals(*map(LOGIN.format, words), f"{ACCEPT}New transport link accepted from 4bfa to 8706") == {
        "refused a login with a wrong password": 1,
        "refused a login of an unknown user": 1,
        "refused a login without credentials": 1,
        "refused a login (Whatever comes next)": 1,
    }


def test_a_flood_of_refusals_fills_nothing() -> None:
    """Ever new kinds are told apart up to a limit, and counted beyond; each is told once, also to who came late."""
    found, told = Refusals(), []
    for n in range(2 * MOST_KINDS):
        found.line(LOGIN.format(n))
        if n == 3:
            found.report_to(told.append)
    assert len(found.counts) == MOST_KINDS + 1
    assert found.counts["refused more kinds of logins"] == MOST_KINDS
    wait_for(lambda: told == list(found.counts), 60.0, "each kind, once")  # on a thread of its own


def test_other_lines_are_kept() -> None:
    assert not Refusals().line(STAMP + "zenoh::net::runtime: ERROR something else")


def test_a_full_disk_does_not_stop_the_reader() -> None:
    """Zenoh writes its log into a pipe: if nobody read on, the router would wait with it."""
    refusals, (source, sink) = Refusals(), os.pipe()
    lost, login = b"something else\n", LOGIN.format("Invalid password.").encode() + b"\n"
    os.write(sink, lost + login + lost + login)
    os.close(sink)
    full = os.open("/dev/full", os.O_WRONLY)
    _follow(source, full, refusals)
    os.close(full)
    os.close(source)
    assert refusals.counts == {"refused a login with a wrong password": 2}
