"""The values of zenoh as programs see them: samples, replies, encodings, channels and settings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any

from fleet.addons.programs.turns import Turns, Waiters
from netem.wire.key_expressions import key_expression


class ZenohError(Exception):
    """As zenoh's."""


class SampleKind(Enum):
    """What a sample says."""

    PUT = "PUT"
    DELETE = "DELETE"


class Priority(Enum):
    """Taken and not used: an agent's payloads have one order."""

    REAL_TIME, INTERACTIVE_HIGH, INTERACTIVE_LOW, DATA_HIGH, DATA, DATA_LOW, BACKGROUND = range(1, 8)
    DEFAULT = DATA


class CongestionControl(Enum):
    """Taken and not used."""

    DROP = 0
    BLOCK = 1
    DEFAULT = DROP


class Reliability(Enum):
    """Taken and not used."""

    BEST_EFFORT = 0
    RELIABLE = 1


class QueryTarget(Enum):
    """Taken and not used: all that match answer."""

    BEST_MATCHING, ALL, ALL_COMPLETE = range(3)
    DEFAULT = BEST_MATCHING


class ConsolidationMode(Enum):
    """Taken and not used: each reply is handed over."""

    AUTO, NONE, MONOTONIC, LATEST = range(4)
    DEFAULT = AUTO


class Encoding:
    """The name of a form of payloads."""

    def __init__(self, text: str = "zenoh/bytes") -> None:
        self._text = text

    def __str__(self) -> str:
        return self._text

    def __eq__(self, other: object) -> bool:
        return str(self) == str(other)

    def __hash__(self) -> int:
        return hash(self._text)

    def with_schema(self, schema: str) -> Encoding:
        """The same with the name of a schema."""
        return Encoding(f"{self._text};{schema}")


for _name in ("ZENOH_BYTES", "ZENOH_STRING", "APPLICATION_JSON", "APPLICATION_CBOR", "APPLICATION_PROTOBUF",
              "APPLICATION_OCTET_STREAM", "TEXT_PLAIN", "TEXT_JSON", "APPLICATION_CDR"):  # fmt: skip
    setattr(Encoding, _name, Encoding(_name.lower().replace("_", "/", 1).replace("_", "-")))


class ZBytes:
    """Bytes, as zenoh gives them."""

    def __init__(self, data: Any = b"") -> None:
        self._data: bytes = data.encode() if isinstance(data, str) else bytes(data)

    def to_bytes(self) -> bytes:
        """The bytes."""
        return self._data

    def to_string(self) -> str:
        """As UTF-8 text. Raises UnicodeDecodeError."""
        return self._data.decode()

    def __bytes__(self) -> bytes:
        return self._data

    def __len__(self) -> int:
        return len(self._data)

    def __bool__(self) -> bool:
        return bool(self._data)

    def __eq__(self, other: object) -> bool:
        return self._data == (other._data if isinstance(other, ZBytes) else other)

    def __hash__(self) -> int:
        return hash(self._data)


class Sample:
    """A message that has come."""

    def __init__(self, key: str, data: bytes, kind: SampleKind, encoding: str, attachment: bytes | None) -> None:
        self.key_expr, self.payload, self.kind = key_expression(key), ZBytes(data), kind
        self.encoding = Encoding(encoding)
        self.attachment = None if attachment is None else ZBytes(attachment)
        self.timestamp, self.priority, self.congestion_control = None, Priority.DATA, CongestionControl.DROP
        self.express = False


class Reply:
    """An answer to a query: a sample, or an error."""

    def __init__(self, ok: Sample | None, err: ReplyError | None = None) -> None:
        self._ok, self.err = ok, err

    @property
    def ok(self) -> Any:
        """The sample; None: it is an error."""
        return self._ok

    @property
    def result(self) -> Any:
        """The sample or the error."""
        return self._ok or self.err


class ReplyError:
    """What a queryable said in place of an answer."""

    def __init__(self, data: bytes, encoding: str) -> None:
        self.payload, self.encoding = ZBytes(data), Encoding(encoding)


@dataclass(frozen=True, slots=True)
class MatchingStatus:
    """Whether somebody listens to a publisher, or answers a querier."""

    matching: bool


class Channel:
    """What has come and waits to be taken."""

    def __init__(self, turns: Turns, most: int, *, ring: bool) -> None:
        self._most, self._ring = most, ring
        self._items: deque[Any] = deque()
        self._waiting = Waiters(turns)
        self.closed = False

    def put(self, item: Any) -> None:
        """Take one more. A ring forgets the oldest one, and a FIFO that is full the new one."""
        if len(self._items) >= self._most:
            if not self._ring:
                return
            self._items.popleft()
        self._items.append(item)
        self._waiting.wake(1)

    def close(self) -> None:
        """Nothing more will come."""
        self.closed = True
        self._waiting.wake()

    def recv(self) -> Any:
        """The next one; waits for it. Raises ZenohError: nothing more will come."""
        while not self._items:
            if self.closed:
                raise ZenohError("the channel is closed")
            self._waiting.wait()
        return self._items.popleft()

    def try_recv(self) -> Any:
        """The next one; None: there is none now."""
        return self._items.popleft() if self._items else None

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        try:
            return self.recv()
        except ZenohError:
            raise StopIteration from None


class FifoChannel:
    """A handler: a queue of so many."""

    ring = False

    def __init__(self, capacity: int = 256) -> None:
        self.capacity = capacity


class RingChannel(FifoChannel):
    """A handler: a queue of the newest."""

    ring = True


class Callback:
    """A handler: a function, and what is called at the end."""

    def __init__(
        self, call: Callable[[Any], Any], drop: Callable[[], Any] | None = None, indirect: bool = True
    ) -> None:
        self.call, self.drop = call, drop


class Config:
    """Taken and not used: programs meet through the emulated network."""

    def insert_json5(self, key: str, value: str) -> None:
        """Take a setting."""

    def get_json(self, key: str) -> str:
        """Nothing is known."""
        return "null"

    @classmethod
    def from_file(cls, path: Any) -> Config:
        """Take a file."""
        return cls()

    from_json5 = from_env = from_file


# What the module of a program has of these, with the handlers.
VALUES = {name: kind for name, kind in vars().items() if getattr(kind, "__module__", "") == __name__}
