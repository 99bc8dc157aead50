"""Network namespaces of nodes: whom a packet is for, and an interface whose packets we carry by hand."""

from __future__ import annotations

import ctypes
import os
import socket
import struct
import subprocess
import sys
from threading import Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem import namespaces
from netem.errors import BusError
from netem.isolated import IpPacket, IsolatedRobots
from netem.robot_message import PACKET

_SAYS = """
import socket
s = socket.create_server(("10.0.0.2", 9000))
print("up", flush=True)
c, who = s.accept()
print(who[0], c.recv(99), flush=True)
c.sendall(b"and you")
"""
_ASKS = """
import socket
c = socket.create_connection(("10.0.0.2", 9000))
c.sendall(b"hello")
print(c.recv(99))
"""


def packet(to: str, protocol: int = 17, port: int = 9000, offset: int = 0) -> bytes:
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 28, 0, offset, 64, protocol, 0, bytes(4), socket.inet_aton(to))
    return head + struct.pack(">HHHH", 1, port, 8, 0)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (packet("10.0.0.2"), (2, "udp/9000", "10.0.0.2")),
        (packet("10.0.1.4", 6, 80), (260, "tcp/80", "10.0.1.4")),
        (packet("10.0.0.2", 17, 9000, offset=7), (2, "udp", "10.0.0.2")),  # only the first fragment has ports
        (packet("239.1.2.3"), (0, "udp/9000", "239.1.2.3")),
        (packet("255.255.255.255"), (0, "udp/9000", "255.255.255.255")),
        (packet("10.0.255.255", 1), (0, "icmp", "10.0.255.255")),
        (packet("8.8.8.8", 132), (None, "132", "8.8.8.8")),
        (packet("224.0.0.22", 2), None),  # hosts tell routers of groups
        (b"\x60" + bytes(39), None),  # IPv6
        (b"", None),
    ],
)
def test_whom_a_packet_is_for(data: bytes, expected: tuple[int | None, str, str] | None) -> None:
    assert namespaces.read(data) == expected


@given(st.binary(max_size=60))
def test_any_bytes_are_a_packet_or_none(data: bytes) -> None:
    found = namespaces.read(data)
    assert found is None or found.where.count(".") == 3


def test_a_packet_that_no_link_takes_is_told_in_words() -> None:
    robots = IsolatedRobots((), {1: "a", 2: "b", 3: "c"}, [(1, 2)])

    def judged(to: str) -> object:
        data = packet(to)
        whereto = namespaces.read(data)
        assert whereto is not None
        return robots.message(IpPacket(1, 7, data, whereto))

    message = judged("10.0.0.2")
    assert (message.kind, message.to, message.key) == (PACKET, 2, "udp/9000")  # type: ignore[attr-defined]
    assert judged("239.0.0.1").to is None  # type: ignore[attr-defined]
    assert judged("10.0.0.3") == "a sends to c, and no link leads there"
    assert judged("8.8.8.8") == "a sends to 8.8.8.8, which is none of the nodes"


def test_a_system_without_namespaces_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(namespaces, "DEVICE", "/no/such/device")
    with pytest.raises(BusError, match=r"No such file or directory \(/no/such/device\)|Operation not permitted"):
        namespaces.make_namespace(1)


def test_programs_of_two_namespaces_meet_when_somebody_carries_their_packets() -> None:
    try:
        ends = [namespaces.make_namespace(1), namespaces.make_namespace(2)]
    except BusError as error:
        pytest.skip(str(error))
    libc = ctypes.CDLL(None)

    def started(end: namespaces.Namespace, text: str) -> subprocess.Popen[str]:
        def enter() -> None:
            for file in end.enter:
                assert libc.setns(file, 0) == 0

        return subprocess.Popen(
            [sys.executable, "-c", text], preexec_fn=enter, pass_fds=end.enter, stdout=subprocess.PIPE, text=True
        )

    def carry(source: int, target: int) -> None:
        while data := os.read(source, 1 << 16):
            if namespaces.read(data) is not None:
                os.write(target, data)

    files = [end.packets for end in ends]
    for source, target in (files, files[::-1]):
        Thread(target=carry, args=(source, target), daemon=True).start()
    says = started(ends[1], _SAYS)
    assert says.stdout is not None and says.stdout.readline() == "up\n"
    asks = started(ends[0], _ASKS)
    assert asks.communicate(timeout=60)[0] == "b'and you'\n"
    assert says.communicate(timeout=60)[0] == "10.0.0.1 b'hello'\n"
