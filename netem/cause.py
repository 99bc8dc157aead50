"""The fates of a packet: the causes of a loss, delivery, and "in flight" at the end of the run."""

from __future__ import annotations

from enum import StrEnum


class Cause(StrEnum):
    """The fate of a packet: delivered, in flight when the run ended, or the cause of its loss."""

    # The causes of a loss, in the order of the ledger's columns.
    LOSS = "loss"
    DOWN = "down"
    PARTITION = "partition"
    MUTE = "mute"
    QUEUE = "queue"
    # Only the acoustic channel has these causes.
    REPLACED = "replaced"
    MTU = "mtu"
    RANGE = "range"
    HALF_DUPLEX = "half duplex"
    COLLISION = "collision"
    SNR = "snr"
    DEAD_SENDER = "dead sender"
    # Every network has these causes.
    DEAF = "deaf"
    DEAD_RECEIVER = "dead receiver"
    RECEIVER = "receiver"  # with `fleet netem`: a program did not take the message

    DELIVERED = "delivered"
    IN_FLIGHT = "in flight"


LOSSES = tuple(cause for cause in Cause if cause not in (Cause.DELIVERED, Cause.IN_FLIGHT))
