"""Which messages of a log are kept: those of a time, and one in a number of each topic."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from fleet.logs.records import Block


class Part(NamedTuple):
    """Which messages of a log are kept."""

    start: float = 0.0  # s
    end: float = inf
    every: int = 1

    def within(self, block: Block) -> Block:
        """Those of the time."""
        if self.start <= 0.0 and self.end == inf:
            return block
        t = block.log_ns / 1e9
        return block.take((t >= self.start) & (t <= self.end))

    def thinned(self, block: Block, seen: int) -> Block:
        """The messages to keep of one topic's messages within the time; `seen` messages came before."""
        return block if self.every == 1 else block.take(np.arange(-seen % self.every, len(block), self.every))
