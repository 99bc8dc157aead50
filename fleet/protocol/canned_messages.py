"""The bad input of `fleet protocol check`: payloads that a network has damaged, and bytes that are no message."""

from __future__ import annotations

import msgpack

from agents import payload
from netem.wire.messages import Delivery


def damaged(src: int, sent: int, eta: tuple[float, ...]) -> tuple[Delivery, ...]:
    """A neighbour's payloads of a tick, and the same payloads after a damaging network.

    Args:
        eta: the pose of who receives it [m, rad]; the neighbour is 5 m to its north.
    """
    good = payload.encode(payload.StateMessage(src, sent, (eta[0] + 5.0, eta[1], eta[2]), (0.5, 0.0, 0.0)))
    flipped = bytes([good[0], good[1] ^ 0x40, *good[2:]])
    payloads = [good, flipped, good[:15], b"", bytes(range(63)), b"\xff" * 200]
    return tuple(Delivery(sent + 1, sent, src, seq, 0, data) for seq, data in enumerate(payloads))


def junk_of(life: int) -> tuple[bytes, ...]:
    """Bytes that are no message: no MessagePack, no array, no kind, too short, of wrong types, of an unknown kind."""
    return (
        b"",
        b"\xc1",
        b"\xff" * 40,
        msgpack.packb({"nav": 1}),
        msgpack.packb([]),
        msgpack.packb(["nav", life]),
        msgpack.packb(["nav", life, "now", [0.0] * 5, [0.0] * 5]),
        msgpack.packb(["rx", life, None, False, []]),
        msgpack.packb(["weather", life, 1, [], []]),
    )
