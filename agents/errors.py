"""The errors of this package; what they are about is in fields, so that callers can word their own messages."""

from __future__ import annotations


class AgentError(Exception):
    """Base of every error of this package."""


class PayloadError(AgentError):
    """A payload from the network cannot be used.

    Attributes:
        cause: `length`, `checksum`, `version` or `not_finite`.
        reason: what was expected and what came.
    """

    def __init__(self, cause: str, reason: str) -> None:
        super().__init__(f"payload refused ({cause}): {reason}")
        self.cause = cause
        self.reason = reason


class ControllerError(AgentError):
    """An agent cannot answer a sample: measurement or answer cannot be used. `where` is the file and line at fault, or
    "".
    """

    def __init__(self, agent: int, tick: int, problem: str, where: str = "") -> None:
        super().__init__(f"agent {agent}, tick {tick}: {problem}" + (f" ({where})" if where else ""))
        self.agent = agent
        self.tick = tick
        self.problem = problem
        self.where = where
