"""The channels of recorded zenoh traffic: what a sample is beside its payload."""

from __future__ import annotations

from mcap.records import Channel

KIND, ENCODING = "zenoh.kind", "zenoh.encoding"  # keys of a channel's metadata
PUT, DELETE, ATTACHMENT = "put", "delete", "attachment"


def is_attachment(channel: Channel) -> bool:
    """Whether a channel has the attachments of the samples of its topic: they are no messages of their own."""
    return channel.metadata.get(KIND) == ATTACHMENT
