"""Payloads that are longer than a frame: they are sent in pieces, and put together where all of them arrive.

The head of a piece has the number of its payload, its own number, and how many pieces there are.
"""

from __future__ import annotations

from netem.endpoint import HeardFrame

MOST_PIECES = 64
_HEAD = 3  # bytes
_NUMBERS = 256
_MOST_COMING = 16  # payloads that are not complete; the oldest are forgotten


class PayloadPieces:
    """The pieces that one modem sends, and those that it has of others."""

    def __init__(self) -> None:
        self._count = 0
        self._coming: dict[tuple[int, int], dict[int, bytes]] = {}  # by sender and number

    def split(self, payload: bytes, room: int) -> list[tuple[bytes, bytes]]:
        """Cut a payload.

        Args:
            payload: at most MOST_PIECES times `room` bytes.
            room: bytes of a piece.

        Returns:
            head and data of each piece; of a payload that fits into one, the head is empty.
        """
        pieces = [payload[begin : begin + room] for begin in range(0, len(payload), room)]
        if len(pieces) < 2:
            return [(b"", payload)]
        self._count = (self._count + 1) % _NUMBERS
        return [(bytes((self._count, number, len(pieces))), piece) for number, piece in enumerate(pieces)]

    def join(self, frame: HeardFrame) -> bytes | None:
        """Take what has arrived.

        Args:
            frame: a piece, or a payload that fits into one.

        Returns:
            the whole payload; None: pieces are missing.
        """
        if len(frame.head) < _HEAD:
            return frame.payload
        number, piece, count = frame.head[:_HEAD]
        if piece >= count:
            return None  # no piece of ours
        have = self._coming.setdefault((frame.src, number), {})
        if piece == 0:
            have.clear()  # a number comes again, and the first piece comes first
        have[piece] = frame.payload
        if any(each not in have for each in range(count)):
            while len(self._coming) > _MOST_COMING:
                del self._coming[next(iter(self._coming))]
            return None
        del self._coming[frame.src, number]
        return b"".join(have[each] for each in range(count))
