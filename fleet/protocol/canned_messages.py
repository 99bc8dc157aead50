"""What `fleet protocol check` sends that is not well: payloads that a network has damaged, and what is no message."""

from __future__ import annotations

import msgpack

from agents import payload
from netem.wire.messages import Delivery


def damaged(src: int, sent: int, eta: tuple[float, ...]) -> tuple[Delivery, ...]:
    """What a neighbour sent at a tick, and the same after a network has been at it.

    Args:
        eta: the pose of who receives it [m, rad]; the neighbour is 5 m to its north.
    """
    good = payload.encode(payload.StateMessage(src, sent, (eta[0] + 5.0, eta[1], eta[2]), (0.5, 0.0, 0.0)))
    flipped = bytes([good[0], good[1] ^ 0x40, *good[2:]])
    payloads = [good, flipped, good[:15], b"", bytes(range(63)), b"\xff" * 200]
    return tuple(Delivery(sent + 1, sent, src, seq, 0, data) for seq, data in enumerate(payloads))


def junk_of(life: int) -> tuple[bytes, ...]:
    """None of them is a message: no MessagePack, no array, no kind, too short, of wrong types, of an unknown kind."""
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
