"""Messages of one time, already encoded: as they stand in a chunk of an MCAP file, and as the digest takes them."""

from __future__ import annotations

from collections.abc import Iterator
from struct import Struct
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

MESSAGE = int(Opcode.MESSAGE)
HEAD = Struct("<BQHIQQ")  # opcode, length of the rest, channel, sequence, log time, publish time
STAMP_BYTES = HEAD.size - 9  # bytes of the head that count in the length of the rest


class Batch(NamedTuple):
    """Messages that have their times and their sequence number in common."""

    at_ns: int  # log time and publish time
    sequence: int
    channels: NDArray[np.uint16]  # channel of each message
    bounds: NDArray[np.int64]  # where in `records` each message begins, and behind them the end
    records: NDArray[np.uint8]
    digested: NDArray[np.uint8]  # what `fleet.mcap.records` hashes for them

    def messages(self) -> Iterator[tuple[int, int, int, int, bytes]]:
        """Channel, log time, publish time, sequence and data of one after the other."""
        records, bounds = self.records.tobytes(), self.bounds.tolist()
        for channel, begin, end in zip(self.channels.tolist(), bounds[:-1], bounds[1:], strict=True):
            yield channel, self.at_ns, self.at_ns, self.sequence, records[begin + HEAD.size : end]
