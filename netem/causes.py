"""What may become of a packet: the causes of a loss in the order of the ledger's columns, and the other fates."""

from __future__ import annotations

# The declared causes of a loss, in the order of the ledger's columns.
LOSS, DOWN, QUEUE = "loss", "down", "queue"
PARTITION, MUTE, DEAF, DEAD_RECEIVER = "partition", "mute", "deaf", "dead receiver"
REPLACED, MTU, RANGE, HALF_DUPLEX = "replaced", "mtu", "range", "half duplex"
COLLISION, SNR, DEAD_SENDER = "collision", "snr", "dead sender"
CAUSES: tuple[str, ...] = (
    LOSS, DOWN, PARTITION, MUTE, QUEUE,
    REPLACED, MTU, RANGE, HALF_DUPLEX, COLLISION, SNR, DEAD_SENDER,  # of the acoustic channel
    DEAF, DEAD_RECEIVER,
)  # fmt: skip
DELIVERED, IN_FLIGHT = "delivered", "in flight"
