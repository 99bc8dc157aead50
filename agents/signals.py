"""The declaration of what a control law reports at every tick, so that logs, tables and plots can name it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from world.signal import Signal


class SignalLayout(NamedTuple):
    """The telemetry of one agent: what its flat tuple of values holds, by the log's topic group, in order."""

    guidance: tuple[Signal, ...]  # what the agent knows and where it wants to go
    control: tuple[Signal, ...]  # how the controller gets it there

    @property
    def size(self) -> int:
        return sum(signal.width for group in self for signal in group)

    def signals(self) -> Iterator[tuple[str, Signal, slice]]:
        """(group, signal, where its values are) of every signal."""
        begin = 0
        for group, signals in zip(self._fields, self, strict=True):
            for signal in signals:
                yield group, signal, slice(begin, begin + signal.width)
                begin += signal.width

    def where(self, name: str) -> slice | None:
        """Where the values of a signal are; None if it is not reported."""
        return next((place for _, signal, place in self.signals() if signal.name == name), None)

    def group(self, name: str) -> slice:
        first = sum(signal.width for signal in self.guidance)
        return slice(0, first) if name == "guidance" else slice(first, self.size)


# What every agent that hears neighbours reports, whatever its controller.
HEARD = (
    Signal("e_used", "m", "consensus error from what the agent knows of its neighbours, NED", 3),
    Signal("neighbours_heard", "1", "neighbours heard at least once"),
    Signal("payloads_rejected", "1", "payloads refused by the codec since the start"),
)
# What every agent with a guidance law reports besides.
COMMANDED = (
    Signal("rho", "m/s", "commanded velocity, NED", 3),
    Signal("u_cmd", "m/s", "commanded speed after the floor"),
    Signal("theta_cmd", "rad", "commanded pitch of the velocity"),
    Signal("psi_cmd", "rad", "commanded course of the velocity"),
)
