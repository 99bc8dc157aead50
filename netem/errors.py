"""The errors of the network side. Their data are in fields, so that callers can print words of their own."""

from __future__ import annotations

from collections.abc import Sequence


class NetemError(Exception):
    """Base of every error of this package."""


class TextError(NetemError):
    """A text of a user that cannot be read.

    Args:
        message: what is wrong: expected against got.
        column: of the character where it is wrong, counted from 0 within the text.
        hint: what to write instead; may be empty.
    """

    def __init__(self, message: str, column: int = 0, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.column = column
        self.hint = hint


class SelectorError(TextError):
    """A text that should name vehicles or links, and does not. Who knows what the vehicles are called says it with
    `in_names`.
    """

    def in_names(self, names: Sequence[str]) -> str:
        """What is wrong, for vehicles that have names.

        Args:
            names: of all vehicles, in the order of their numbers; fewer than two: they have none.

        Returns:
            The message, in one line.
        """
        return self.message if len(names) < 2 else self._in_names(names)

    def _in_names(self, names: Sequence[str]) -> str:
        raise NotImplementedError


class MalformedMessage(NetemError):
    """Bytes that are no message of ours, or a message whose fields are out of their declared range."""

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(f"malformed {kind} message: {reason}")
        self.kind = kind
        self.reason = reason


class BusError(NetemError):
    """The zenoh session could not be opened or used."""


class OutOfPlace(NetemError):
    """A well-formed message that does not belong where it arrived (wrong tick, sender or incarnation)."""

    def __init__(self, what: str, expected: object, got: object) -> None:
        super().__init__(f"{what}: expected {expected}, got {got}")
        self.what = what
        self.expected = expected
        self.got = got
