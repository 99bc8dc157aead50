"""The fields of messages of UnetStack, read from what programs say: numbers, bytes and places.

A field that is clearly a whole number is one, also as "2" or 2.0, as for the JSON reader of Java that fjage uses
(gson). Everything else is refused: a message for an address that nobody can read would go to everybody.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from fleet.addons.modems.modem import FIRST_OWN
from fleet.errors import FleetError
from netem.endpoint import EVERYBODY

CONTROL, DATA = 1, 2  # types of frames, and the indices of their parameters
_FARTHEST_M = 1e7  # from the origin
_MOST_DIGITS = 20


class WrongFieldError(FleetError):
    """A field that cannot be understood: which, what it holds, and what was expected."""


class UnetFrame(NamedTuple):
    """What a request wants to be sent."""

    to: int  # an address; EVERYBODY: all
    payload: bytes
    what: int  # protocol number
    kind: int  # CONTROL or DATA
    reliable: bool
    at_us: int | None  # when it begins, by the modem's clock; None: when it is its turn


def read_frame(data: Mapping[str, Any]) -> UnetFrame:
    """Read a DatagramReq or a TxFrameReq.

    Args:
        data: the fields of the message.

    Returns:
        what it wants to be sent.

    Raises:
        WrongFieldError: a field cannot be understood, or has no such value.
    """
    to, what = read_number(data, "to"), read_number(data, "protocol") or 0
    kind, payload = read_number(data, "type"), payload_of(data.get("data"))
    reliable = data.get("reliability")
    if payload is None:
        raise WrongFieldError("the data are no bytes: they are base64, or a list of numbers")
    if not 0 <= what < FIRST_OWN:
        raise WrongFieldError(f"there is no protocol {what}: they are 0 to {FIRST_OWN - 1}")
    if kind not in (None, CONTROL, DATA):
        raise WrongFieldError(f"there is no frame type {kind}: they are {CONTROL} (CONTROL) and {DATA} (DATA)")
    if reliable is not None and not isinstance(reliable, bool):
        raise WrongFieldError(f"reliability is true or false, got {_show(reliable)}")
    at_us = read_number(data, "txTime")
    return UnetFrame(EVERYBODY if to is None else to, payload, what, kind or DATA, bool(reliable), at_us)


def read_number(data: Mapping[str, Any], name: str) -> int | None:
    """Read a field that holds a whole number.

    Args:
        data: the fields of a message.
        name: of the field.

    Returns:
        its number; None: the message has no such field.

    Raises:
        WrongFieldError: it holds something else.
    """
    if (value := data.get(name)) is None:
        return None
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, str) and len(value) <= _MOST_DIGITS and value.isascii():
        with suppress(ValueError):
            return int(value)
    raise WrongFieldError(f"{name} is a whole number, got {_show(value)}")


def _show(value: Any) -> str:
    """A value as an error shows it."""
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def place_of(value: Any) -> list[float] | None:
    """Three lengths [m] that a vehicle may be at; None: it is something else."""
    if not isinstance(value, list) or len(value) != 3:
        return None
    with suppress(TypeError, ValueError, OverflowError):
        found = [float(length) for length in value]
        return found if all(abs(length) <= _FARTHEST_M for length in found) else None
    return None


def payload_of(data: Any) -> bytes | None:
    """The bytes of a message: base64 or a list of numbers, signed as Java has them; None: it has none of that kind."""
    try:
        if data is None:
            return b""
        if isinstance(data, dict):
            return base64.b64decode(data.get("data") or "")
        if isinstance(data, list):
            return bytes(int(number) & 255 for number in data)
    except (ValueError, TypeError, OverflowError):
        return None
    return None
