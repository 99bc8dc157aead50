"""Network namespaces for programs: each node has an interface of its own, whose packets we read and write.

The kernel's interface is of the kind `tun`: its packets are those of IP, without frames of a cable. So there is nobody
to find by ARP, and whom a packet is for stands in it. (Rejected: `tap`, where each node asks for the others' hardware
addresses first, and veth pairs, which need a packet socket for the same.)

A namespace lives as long as somebody has it open: this process, by the files that are returned, and its programs.
Without root it lies in a user namespace, in which the user is nobody else than outside.
"""

from __future__ import annotations

import array
import ctypes
import fcntl
import os
import socket
import struct
from contextlib import suppress
from typing import NamedTuple

from netem.errors import BusError

NAME = "water0"
MTU = 1500
DEVICE = "/dev/net/tun"
_LIBC = ctypes.CDLL(None, use_errno=True)
_NEW_USER, _NEW_NET = 0x10000000, 0x40000000  # CLONE_NEWUSER, CLONE_NEWNET
_TUN, _NO_INFO = 0x0001, 0x1000  # IFF_TUN, IFF_NO_PI
_UP, _RUNNING = 0x1, 0x40  # IFF_UP, IFF_RUNNING
_SET_TUN, _GET_FLAGS, _SET_FLAGS = 0x400454CA, 0x8913, 0x8914
_SET_ADDRESS, _SET_MASK, _SET_MTU, _ADD_ROUTE = 0x8916, 0x891C, 0x8922, 0x890B


class Namespace(NamedTuple):
    """The namespace of one node.

    Attributes:
        packets: the file of its interface: a read gives a packet that its programs send, and a write hands one over.
        enter: files of the namespaces that a program enters, in this order.
    """

    packets: int
    enter: tuple[int, ...]

    def close(self) -> None:
        """Let it go; its programs keep it."""
        for file in (self.packets, *self.enter):
            with suppress(OSError):
                os.close(file)


def address(number: int) -> str:
    """The address of a node: as of programs in simulated time."""
    return f"10.0.{number >> 8}.{number & 255}"


def make_namespace(number: int) -> Namespace:
    """Make the namespace of a node.

    Args:
        number: of the node.

    Raises:
        BusError: this system gives none.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    # A process of its own enters it, and gives us the files: whoever has threads may enter no user namespace.
    if not (pid := os.fork()):
        try:
            ours.close()
            _make(number, theirs)
        except OSError as error:
            with suppress(OSError):
                theirs.sendall(f"{error.strerror}{f' ({error.filename})' if error.filename else ''}".encode())
        finally:
            os._exit(0)
    theirs.close()
    with ours:
        said, control, _, _ = ours.recvmsg(1024, socket.CMSG_SPACE(3 * 4))
        os.waitpid(pid, 0)
    files = array.array("i")
    for level, kind, data in control:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            files.frombytes(data[: len(data) - len(data) % files.itemsize])
    if said != b"." or not files:
        why = said.decode("utf-8", "replace") or "it could not be entered"
        raise BusError(f"no network namespace for a node: {why}; isolate needs {DEVICE} and `unshare -rn`, or root")
    return Namespace(files[0], tuple(files[1:]))


def _make(number: int, theirs: socket.socket) -> None:
    """In a process of its own: enter the namespace, set up its interface, and send the files."""
    user, group = os.geteuid(), os.getegid()
    kinds = _NEW_NET if user == 0 else _NEW_NET | _NEW_USER
    if _LIBC.unshare(kinds):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), "unshare")
    if kinds & _NEW_USER:
        for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            with open(f"/proc/self/{name}", "w", encoding="ascii") as file:
                file.write(text)
    tun = os.open(DEVICE, os.O_RDWR | os.O_CLOEXEC)
    fcntl.ioctl(tun, _SET_TUN, struct.pack("16sH22x", NAME.encode(), _TUN | _NO_INFO))
    with suppress(OSError), open("/proc/sys/net/ipv6/conf/all/disable_ipv6", "w", encoding="ascii") as file:
        file.write("1")  # programs would look for neighbours that are not there
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        _set(control, _SET_ADDRESS, NAME, _place(address(number)))
        _set(control, _SET_MASK, NAME, _place("255.255.0.0"))
        _set(control, _SET_MTU, NAME, struct.pack("i", MTU))
        for name in ("lo", NAME):
            flags = struct.unpack_from("H", _set(control, _GET_FLAGS, name, b""), 16)[0]
            _set(control, _SET_FLAGS, name, struct.pack("H", flags | _UP | _RUNNING))
        _route(control)
    names = ("net",) if user == 0 else ("user", "net")
    files = [tun, *(os.open(f"/proc/self/ns/{name}", os.O_RDONLY | os.O_CLOEXEC) for name in names)]
    theirs.sendmsg([b"."], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", files))])


def _place(text: str) -> bytes:
    """A `sockaddr_in`."""
    return struct.pack("HH4s8x", socket.AF_INET, 0, socket.inet_aton(text))


def _set(control: socket.socket, request: int, name: str, value: bytes) -> bytes:
    """Ask the kernel about an interface (`struct ifreq`)."""
    return fcntl.ioctl(control, request, struct.pack("16s24s", name.encode(), value))


def _route(control: socket.socket) -> None:
    """What is for nobody else, as multicast, leaves by our interface (`struct rtentry`)."""
    device = ctypes.create_string_buffer(NAME.encode())
    everywhere = _place("0.0.0.0")
    entry = struct.pack(
        "L16s16s16sHhLPhhhhPLLH", 0, everywhere, everywhere, everywhere, 1, 0, 0, None or 0, 0, 0, 0, 0,
        ctypes.addressof(device), 0, 0, 0,
    )  # fmt: skip
    fcntl.ioctl(control, _ADD_ROUTE, entry)


class Whereto(NamedTuple):
    """What a packet says of itself.

    Attributes:
        to: the number of a node; 0: everybody; None: nobody that is here.
        key: its protocol and port, as in `tcp/1883`.
        where: the address.
    """

    to: int | None
    key: str
    where: str


def read(packet: bytes) -> Whereto | None:
    """Whom a packet is for; None: it is none of IPv4, or one of those by which hosts speak with routers."""
    if len(packet) < 20 or packet[0] >> 4 != 4 or packet[9] == _IGMP:
        return None
    a, b, c, d = packet[16:20]
    everybody = a >> 4 == 14 or packet[16:20] in (b"\xff\xff\xff\xff", b"\x0a\0\xff\xff")
    to = 0 if everybody else c << 8 | d if (a, b) == (10, 0) else None
    name, at = _PROTOCOLS.get(packet[9], str(packet[9])), 4 * (packet[0] & 15)
    is_first = not int.from_bytes(packet[6:8], "big") & 0x1FFF
    port = int.from_bytes(packet[at + 2 : at + 4], "big") if packet[9] in (6, 17) and is_first else 0
    return Whereto(to, f"{name}/{port}" if port else name, socket.inet_ntoa(packet[16:20]))


_IGMP = 2
_PROTOCOLS = {1: "icmp", 6: "tcp", 17: "udp"}
