"""The transmissions in water that a log tells of: which packets belong to one, and when it began.

A log has the end of each packet at each receiver. The beginning follows from that.
"""

from __future__ import annotations

from collections.abc import Callable
from math import floor

from netem.cause import Cause
from netem.condition import Link
from netem.modem import AcousticConfig

# The modem has never sent these; or the log does not say whether it had begun when the run ended.
UNSENT = frozenset({Cause.MTU, Cause.REPLACED, Cause.DEAD_SENDER, Cause.QUEUE, Cause.MUTE, Cause.IN_FLIGHT})
# They are decided when a transmission begins: nothing of it is heard.
AT_START = frozenset({Cause.PARTITION, Cause.DOWN, Cause.LOSS})


def name_of(link: Link, seq: int, acoustic: AcousticConfig) -> tuple[int, ...]:
    """What the packets of one transmission have in common: a modem with `tries` sends to each neighbour by itself."""
    src, dst = link
    return (src, seq, dst) if acoustic.modem_of(src).tries else (src, seq)


def end_of(sent: float, due: float, delay: float, fate: str) -> float:
    """When a packet was usable, before rounding up to ticks, if it arrived; otherwise when it was lost. Times in s, as
    the log has them.
    """
    return sent + delay if fate == Cause.DELIVERED else due


def begin_of(
    link: Link, airtime: float, end: float, fate: str, flight: Callable[[float], float], acoustic: AcousticConfig,
    tick_s: float,
) -> float:  # fmt: skip
    """When a transmission began [s]: a whole tick. What is cut off has it in the log, what arrived leads to it exactly,
    and what was lost at a receiver but for a tick.

    Args:
        link: sender and receiver.
        airtime: of the packet [s].
        end: by `end_of` [s].
        fate: none of UNSENT.
        flight: how long sound takes from sender to receiver, for what is sent at a time [s].
        acoustic: the channel.
        tick_s: of the run.
    """
    if fate in AT_START:
        return end
    arrived = fate == Cause.DELIVERED
    near = end - airtime - (acoustic.modem_of(link[1]).processing if arrived else 0.0)
    near -= flight(near)
    return (round(near / tick_s) if arrived else floor(near / tick_s + 1e-6)) * tick_s
