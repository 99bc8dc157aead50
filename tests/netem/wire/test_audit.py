"""What the router refused, read from zenoh's log: who, what, how often; and nobody waits for it."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from time import process_time

import pytest
from waiting import wait_for

from netem.wire.audit import MOST_ENDED, MOST_KEY, MOST_KINDS, Refusals, _follow

Z = "4bfa"  # a zenoh id, shortened
STAMP = "\x1b[2m2026-11-21T11:00:00.000000Z\x1b[0m \x1b[35mTRACE\x1b[0m app-0 ThreadId(02) \x1b[1mdemux\x1b[0m: "
ACL = STAMP + "\x1b[2mzenoh::net::routing::interceptor::access_control\x1b[0m\x1b[2m:\x1b[0m "
WHO = f"{Z} on Interface(lo)+Username(agent-1)+Transport(Tcp)+{Z}"
ACCEPT = STAMP + "zenoh_transport::unicast::establishment::accept: "
ACTIONS = ["Query", "Reply", "Put", "Delete", "Declare/Undeclare Subscriber", "Declare/Undeclare Queryable",
           "Declare/Undeclare Liveliness Token", "Liveliness Query", "Declare Liveliness Subscriber"]  # fmt: skip


def refusals(*lines: str) -> dict[str, int]:
    found = Refusals()
    for line in lines:
        found.line(line)
    return dict(found.counts)


def test_what_zenoh_decides_in_advance_was_not_tried() -> None:
    """For a declared key it works out all nine actions at once; only a put that uses the result was tried."""
    ahead = [f"{ACL}ACL (ingress): caching permissions for `fleet/x/cmd/2` ..."]
    ahead += [f"{ACL}{WHO} is unauthorized to {action} (ingress) on fleet/x/cmd/2" for action in ACTIONS]
    assert refusals(*ahead) == {}
    put = f"{ACL}Using cached result: {Z} is unauthorized to Put (ingress) on fleet/x/cmd/2"
    assert refusals(*ahead, put, put) == {"refused agent-1: put on fleet/x/cmd/2": 2}
    plain = f"{ACL}{WHO} is unauthorized to Query (ingress) on fleet/x/cfg/2"
    assert refusals(*ahead, plain) == {"refused agent-1: query on fleet/x/cfg/2": 1}


@pytest.mark.parametrize(
    "words", ["is authorized to Put (ingress) on x", "access_control: 1 is authorized to", "Username"]
)
def test_a_key_hides_no_refusal(words: str) -> None:
    """A key is of the client's choosing, also one that reads like zenoh's own words."""
    source, sink = os.pipe()
    lines = [
        f"{ACL}{WHO} is unauthorized to Put (ingress) on fleet/{words}",
        f"{ACL}{WHO} is authorized to Put (egress) on k",
    ]
    os.write(sink, "".join(f"{line}\n" for line in lines).encode())
    os.close(sink)
    found = Refusals()
    _follow(source, source, found)
    os.close(source)
    assert found.counts == {f"refused agent-1: put on fleet/{words}": 1}
    assert refusals(f"{ACL}{WHO} is unauthorized to Put (egress) on k is unauthorized to Put (ingress) on k") == {}


def test_a_long_key_takes_no_time() -> None:
    """Only the beginning of a line is looked at: one of 48,000 characters that begins again and again like a decision
    would take longer than zenoh may be kept waiting."""
    begun = process_time()
    key = "access_control: 1 is authorized to " * 1300
    lines = (
        f"{ACL}{WHO} is unauthorized to Put (egress) on {key}\n{ACL}{WHO} is unauthorized to Put (ingress) on {key}\n"
    )
    found, (source, sink) = Refusals(), os.pipe()
    feeding = threading.Thread(target=lambda: os.write(sink, lines.encode()) and os.close(sink))
    feeding.start()
    _follow(source, source, found)
    feeding.join()
    os.close(source)
    assert process_time() - begun < 2.0
    assert found.counts == {f"refused agent-1: put on {key[:MOST_KEY]}": 1}


def test_two_lines_in_one_name_nobody() -> None:
    """A line that found no room was cut, and the next one follows it at once."""
    line = f"{ACL}{WHO} is unauthorized to Put (ingress) on k"
    assert refusals(line[: line.index("+Transport")] + line) == {"zenoh's log was not read in time": 1}


def test_who_sends_too_much_is_named() -> None:
    """Low-latency sessions announce the length and are cut off; of others it is said that they could."""
    link = STAMP.replace("TRACE", "DEBUG") + "zenoh_transport::unicast::lowlatency::link: [8706] "
    manager = STAMP.replace("TRACE", "DEBUG") + "zenoh_transport::unicast::manager: "
    known = f"{ACL}{WHO} is authorized to Put (ingress) on k"
    opened = f"{manager}New transport opened between 8706 and {Z} - whatami: client, qos: false, lowlatency: false"
    assert refusals(
        known,
        f"{link}Rx task finished with result Err(Batch len is invalid. Received 300008 but negotiated max len is 9.)",
        f"{link}<on rx exit> finalizing transport with peer: {Z}",
        f"{link}Rx task finished with result Err(Read error)",
        f"{link}<on rx exit> finalizing transport with peer: {Z}",
    ) == {"agent-1: cut off, as what came is no message or one of more than 65535 bytes": 1}  # fmt: skip
    assert refusals(  # seen at one in five commands of an operator
        f"{link}Rx task finished with result Err(Batch len is invalid. Received 196610 but negotiated max is 9.)",
        f"{link}<on rx exit> finalizing transport with peer: {Z}",
    ) == {}  # fmt: skip
    pieces = "its session is not low-latency, and long messages of it are dropped"
    assert refusals(opened, known) == {f"somebody: {pieces}": 1, f"agent-1: {pieces}": 1}
    assert refusals(opened.replace("lowlatency: false", "lowlatency: true")) == {}
    assert not Refusals().line(f"{manager.replace('DEBUG', 'ERROR')}something else")
    found = Refusals()
    found.expect_universal("8706")  # the router for agents with certificates, where they need not be
    found.line(opened)
    assert found.counts == {}


def test_who_has_a_certificate_and_no_password_is_named_by_it() -> None:
    tls = STAMP.replace("TRACE", "WARN") + "zenoh_link_tls::unicast: "
    hint = ". Hint: increase the system open file limit."
    assert refusals(
        f"{ACL}{Z} on Interface(lo)+CertCommonName(agent-3)+Transport(Tls)+{Z} is unauthorized to Put (ingress) on k",
        f"{tls}peer sent no certificates{hint}",
        f"{tls}invalid peer certificate: UnknownIssuer{hint}",
    ) == {
        "refused agent-3: put on k": 1,
        "a TLS handshake failed: peer sent no certificates": 1,
        "a TLS handshake failed: invalid peer certificate: UnknownIssuer": 1,
    }  # fmt: skip


def test_telling_holds_up_nobody() -> None:
    """To tell is to put, which waits, and writes lines into the log that is being read."""
    found, (source, sink) = Refusals(), os.pipe()
    never = threading.Event()
    found.report_to(lambda _: bool(never.wait()))
    lines = "".join(f"{ACL}{WHO} is unauthorized to Put (ingress) on fleet/x/{n:0900}\n" for n in range(400)).encode()
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
import netem.wire.audit as audit
audit._follow = lambda *_: threading.Event().wait()
audit.log_zenoh = lambda levels: None
audit.listen(audit.Refusals(), decisions=True)
try:
    while True:
        os.write(1, bytes(10_000))
except BlockingIOError:
    sys.exit(0)
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)


def test_what_is_allowed_or_withheld_is_no_refusal() -> None:
    assert refusals(
        f"{ACL}{WHO} is authorized to Put (ingress) on fleet/x/cmd/1",
        f"{ACL}{WHO} is unauthorized to Declare Subscriber (egress) on fleet/x/cmd/1",
        f"{ACL}Using cached result: {Z} is authorized to Put (ingress) on fleet/x/cmd/1",
        f"{ACCEPT}New transport link accepted from {Z} to 8706",
    ) == {}  # fmt: skip


def test_logins_are_told_in_words() -> None:
    where = "at /root/.cargo/git/usrpwd.rs:424."
    assert refusals(
        f"{ACCEPT}UsrPwd extension - Recv OpenSyn. Invalid password. {where}",
        f"{ACCEPT}UsrPwd extension - Recv OpenSyn. Invalid user. {where}",
        f"{ACCEPT}UsrPwd extension - Recv InitSyn. Expected extension. {where}",
        f"{ACCEPT}UsrPwd extension - Recv InitSyn. Whatever comes next. {where}",
    ) == {
        "refused a login with a wrong password": 1,
        "refused a login of an unknown user": 1,
        "refused a login without credentials": 1,
        "refused a login (Whatever comes next)": 1,
    }  # fmt: skip


def test_a_successor_is_no_thief() -> None:
    """An agent that is started again logs in again; while the session before it lasts, that is somebody else."""
    first, second = (f"{ACL}{z} on Username(agent-1) is authorized to Put (ingress) on k" for z in ("aa", "bb"))
    assert refusals(first, second) == {"agent-1: logged in twice": 1}
    found = Refusals()
    found.line(first)
    found.end("aa")
    found.line(second)
    assert found.counts == {}


def test_a_flood_of_refusals_fills_nothing() -> None:
    """Ever new keys are told apart up to a limit, and counted beyond; each kind is told once, also to who came late."""
    found, told = Refusals(), []
    for n in range(2 * MOST_KINDS):
        found.line(f"{ACL}{WHO} is unauthorized to Put (ingress) on fleet/x/{n}")
        if n == 3:
            found.report_to(told.append)
    assert len(found.counts) == MOST_KINDS + 1
    assert found.counts["refused more kinds of messages"] == MOST_KINDS
    wait_for(lambda: told == list(found.counts), 60.0, "each kind, once")  # on a thread of its own


def test_sessions_that_ended_are_forgotten_in_the_end() -> None:
    found = Refusals()
    for n in range(MOST_ENDED + 10):
        found.line(f"{ACL}{n:x} on Username(operator) is authorized to Put (ingress) on k")
        found.end(f"{n:x}")
    assert len(found._users) == len(found._ended) == MOST_ENDED


def test_other_lines_are_kept() -> None:
    assert not Refusals().line(STAMP + "zenoh::net::runtime: ERROR something else")


def test_a_full_disk_does_not_stop_the_audit() -> None:
    """Zenoh writes its log into a pipe: if nobody read on, the router would wait with it."""
    refusals, (source, sink) = Refusals(), os.pipe()
    lost = b"something else\n"
    login = b"unicast::establishment::accept: UsrPwd extension - Recv InitSyn. Invalid password. at /x\n"
    os.write(sink, lost + login + lost + login)
    os.close(sink)
    full = os.open("/dev/full", os.O_WRONLY)
    _follow(source, full, refusals)
    os.close(full)
    os.close(source)
    assert refusals.counts == {"refused a login with a wrong password": 2}
