"""What can go wrong in an agent; data in fields, so that callers can print their own words."""

from __future__ import annotations


class AgentError(Exception):
    """Base of every error of this package."""


class PayloadError(AgentError):
    """Bytes from the network that are no state message of ours; `cause` is one of `payload.CAUSES`."""

    def __init__(self, cause: str, reason: str) -> None:
        super().__init__(f"payload refused ({cause}): {reason}")
        self.cause = cause
        self.reason = reason


class ControllerError(AgentError):
    """The controller cannot answer this sample: something it was given, or computed, makes no sense."""

    def __init__(self, agent: int, tick: int, what: str, value: object) -> None:
        super().__init__(f"agent {agent}, tick {tick}: {what} is {value!r}")
        self.agent = agent
        self.tick = tick
        self.what = what
        self.value = value


class UnknownNameError(AgentError):
    """A controller or profile that does not exist."""

    def __init__(self, kind: str, name: str, known: tuple[str, ...]) -> None:
        super().__init__(f"no {kind} is called {name!r}; there are {', '.join(known)}")
        self.kind = kind
        self.name = name
        self.known = known
