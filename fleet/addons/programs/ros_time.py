"""Times, durations and clocks of rclpy, by the clock of the program."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from fleet.addons.programs.standard import EPOCH_NS
from fleet.addons.programs.turns import NS, Turns


class Time:
    """A time of the program's clock."""

    def __init__(self, *, seconds: float = 0, nanoseconds: int = 0, clock_type: Any = None) -> None:
        self.nanoseconds = round(seconds * NS) + nanoseconds
        self.clock_type = clock_type

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Whole seconds, and the rest."""
        return divmod(self.nanoseconds, NS)

    def to_msg(self) -> Any:
        """As a message."""
        from fleet.addons.programs.ros_messages import interfaces

        name = "builtin_interfaces/msg/Duration" if isinstance(self, Duration) else "builtin_interfaces/msg/Time"
        sec, nanosec = divmod(self.nanoseconds, NS)
        return interfaces().message_class(name)(sec=sec, nanosec=nanosec)

    @classmethod
    def from_msg(cls, msg: Any, clock_type: Any = None) -> Time:
        """From a message."""
        return cls(nanoseconds=msg.sec * NS + msg.nanosec)

    def __sub__(self, other: Any) -> Any:
        left = self.nanoseconds - other.nanoseconds
        return (
            Time(nanoseconds=left)
            if isinstance(other, Duration) and not isinstance(self, Duration)
            else Duration(nanoseconds=left)
        )

    def __add__(self, other: Any) -> Any:
        return type(self)(nanoseconds=self.nanoseconds + other.nanoseconds)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Time) and self.nanoseconds == other.nanoseconds

    def __lt__(self, other: Any) -> bool:
        return bool(self.nanoseconds < other.nanoseconds)

    def __le__(self, other: Any) -> bool:
        return bool(self.nanoseconds <= other.nanoseconds)

    def __hash__(self) -> int:
        return hash(self.nanoseconds)


class Duration(Time):
    """A time between two."""


class ClockType(IntEnum):
    """Which clock; all are the program's."""

    ROS_TIME, SYSTEM_TIME, STEADY_TIME = 1, 2, 3


class Clock:
    """The program's clock."""

    def __init__(self, turns: Turns) -> None:
        self._turns = turns

    def now(self) -> Time:
        """The time."""
        return Time(nanoseconds=EPOCH_NS + self._turns.now_ns)

    def sleep_for(self, duration: Duration) -> bool:
        """Wait."""
        self._turns.wait(self._turns.now_ns + max(1, duration.nanoseconds))
        return True
