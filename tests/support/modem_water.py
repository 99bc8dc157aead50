"""A modem that programs open, and a sea that keeps what it is given."""

from __future__ import annotations

import socket
from collections.abc import Callable
from time import monotonic_ns

from waiting import wait_for

from fleet.addons.modems.modem import ModemCore, ModemLanguage
from netem.endpoint import HeardFrame, Level, ModemChannel, ModemRequest, SentFrame
from netem.modem import Modem

LIMIT_S = 30.0
MODEM = Modem(800.0, 0.0, 25e3, 4e3, 190.0, 0.0, 3000.0, 6000.0, 64, 6.0, 10.0, 10.0)
SPEED = 1500.0
LEVEL = Level(120.0, 20.0)


class ModemClient:
    """A program that has opened a modem on TCP, as far as bytes go."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S)
        self.file = self.socket.makefile("rb")

    def close(self) -> None:
        self.file.close()
        self.socket.close()


class Water:
    """What a modem gives to the channel, and a hand that lets it happen."""

    def __init__(self, language: Callable[[], ModemLanguage], core: ModemCore | None = None) -> None:
        self.given: list[ModemRequest] = []
        self.moved: list[tuple[float, ...]] = []
        self.begin_ns = monotonic_ns()
        self.core = core or ModemCore(1, language)
        self.core.listen()
        channel = ModemChannel(MODEM, 64, 2, 0.0, SPEED, self.begin_ns, 1, "auv1", {"auv1": 1, "auv2": 2, "buoy": 3},
                  self.given.append, lambda: (10.0, 20.0, 5.0), self.moved.append)  # fmt: skip
        self.core.begin(channel)

    @property
    def port(self) -> int:
        """Where programs open the modem."""
        return self.core.line_port.port

    def close(self) -> None:
        self.core.close()

    def next(self) -> ModemRequest:
        """The next payload that the modem has given."""
        wait_for(lambda: self.given, LIMIT_S, "a payload")
        return self.given.pop(0)

    def sends(self, at_s: float = 1.0) -> ModemRequest:
        """Let the next payload be transmitted at a time."""
        request = self.next()
        self.core.on_sent(SentFrame(request.tag, self.at(at_s), 100_000_000))
        return request

    def at(self, s: float) -> int:
        return self.begin_ns + round(s * 1e9)

    def brings(
        self, src: int, payload: bytes, *, head: bytes = b"", to: int = 1, what: int = 0, left: float, came: float,
        level: Level = LEVEL, away: tuple[float, ...] | None = None,
    ) -> None:  # fmt: skip
        """Let a payload arrive."""
        times = (self.at(left), self.at(came), self.at(came + 0.1))
        self.core.on_heard(HeardFrame(src, to, what, payload, *times, head, level, away))
