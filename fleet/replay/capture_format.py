"""How zenoh traffic of any kind stands in an MCAP file: payloads as they came, everything else beside them.

One channel per key, zenoh encoding and kind, without a schema. The topic is the key; the channel's metadata hold
`zenoh.kind` (put, delete or attachment) and `zenoh.encoding`. `log_time` is when the recorder received the sample,
`publish_time` zenoh's timestamp if the sample has one, both ns since 1970; `sequence` numbers the samples from 0. A
sample with an attachment is two messages with the same sequence: the attachment, on a channel of that kind, then the
payload. So payloads stay what they are, and any viewer that knows their encoding reads them.
"""

from __future__ import annotations

PROFILE = "zenoh"
KIND, ENCODING = "zenoh.kind", "zenoh.encoding"
PUT, DELETE, ATTACHMENT = "put", "delete", "attachment"

# https://mcap.dev/spec/registry#message-encodings against zenoh's predefined encodings
_WELL_KNOWN = {
    "json": "application/json",
    "protobuf": "application/protobuf",
    "cbor": "application/cbor",
    "cdr": "application/cdr",
}
_OF_ZENOH = {zenoh: mcap for mcap, zenoh in _WELL_KNOWN.items()} | {"text/json": "json"}


def message_encoding(encoding: str) -> str:
    """MCAP's name of a zenoh encoding, or zenoh's own where MCAP has none, or where it would ask for a schema."""
    name = _OF_ZENOH.get(encoding.split(";")[0], encoding)
    return encoding if name in ("protobuf", "cdr") else name


def zenoh_encoding(name: str, schema: str) -> str:
    """Zenoh's encoding for a message encoding and the name of its schema: `application/protobuf;foxglove.Log`."""
    encoding = _WELL_KNOWN.get(name, name or "zenoh/bytes")
    return f"{encoding};{schema}" if schema and ";" not in encoding else encoding
