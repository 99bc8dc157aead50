"""A state message as bytes of the payload that the scenario names: one object per way, chosen when an agent is made."""

from __future__ import annotations

from agents import compact, payload
from agents.config import AgentConfig
from agents.localization import payload as located
from agents.localization.localizer import Localizer
from agents.payload import StateMessage


class FullCodec:
    """`full`: the state in 63 bytes, as it is."""

    def encode(self, message: StateMessage) -> bytes:
        """The payload of a message, or OutOfRange if it cannot hold this state."""
        return payload.encode(message)

    def decode(self, data: bytes, now: int, ahead: int) -> StateMessage:
        """The message in a payload, also in a located one, or PayloadError. `now` is the receiver's tick at its
        reception; the sender's clock may be up to `ahead` ticks ahead of it.
        """
        return located.decode(data).state if located.is_located(data) else payload.decode(data)


class CompactCodec(FullCodec):
    """`compact`: the state in 15 bytes, rounded."""

    def __init__(self, round_ticks: int) -> None:
        self._round_ticks = round_ticks

    def encode(self, message: StateMessage) -> bytes:
        return compact.encode(message, self._round_ticks)

    def decode(self, data: bytes, now: int, ahead: int) -> StateMessage:
        if located.is_located(data):
            return located.decode(data).state
        return compact.decode(data, now, self._round_ticks, ahead)


class LocatedCodec(FullCodec):
    """`located`: the state in 42 bytes, with the covariance that a localizer knows."""

    def __init__(self, localizer: Localizer) -> None:
        self._localizer = localizer

    def encode(self, message: StateMessage) -> bytes:
        return located.encode(self._localizer.message(message))


def codec(config: AgentConfig, localizer: Localizer | None = None) -> FullCodec:
    """The codec of an agent. With `located` and without a localizer it only decodes."""
    if config.codec == "compact":
        return CompactCodec(config.round_ticks)
    return FullCodec() if localizer is None else LocatedCodec(localizer)
