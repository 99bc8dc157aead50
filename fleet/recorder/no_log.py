"""The stand-in for a log in a run with `log: none`: it computes the digest, and writes nothing."""

from __future__ import annotations

from collections.abc import Mapping

from fleet.logs.batch import Batch
from fleet.logs.digest import Digest
from fleet.logs.schemas import Schema


class NoLog:
    """Takes the messages of a log as `LogFile` does, and counts and digests them. Its memory does not grow."""

    size = 0  # bytes

    def __init__(self) -> None:
        self.messages = 0
        self._digest = Digest()
        self._topics: list[bytes] = []

    @property
    def digest(self) -> str:
        """The digest that a log would have: see `LogFile`."""
        return self._digest.hexdigest()

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Nothing to do: the digest is of messages."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Nothing to do: the digest is of messages."""

    def channel(self, topic: str, schema: Schema) -> int:
        """Number a topic."""
        self._topics.append(topic.encode())
        return len(self._topics) - 1

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Count and digest a message; both times in ns of simulated time."""
        self._digest.add(self._topics[channel], log_ns, publish_ns, sequence, data)
        self.messages += 1

    def batch(self, batch: Batch) -> None:
        """Count and digest messages that have their times in common."""
        self._digest.add_batch(batch.digested.tobytes())
        self.messages += len(batch.channels)

    def flush(self, at_ns: int) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to do."""

    def abandon(self) -> None:
        """Nothing to do."""
