"""The clock of a Micro-Modem: a date that a program may set, and that goes on with the run.

A new date is that of the next whole second of this machine's clock, as if a pulse per second drove the modem. Drivers
count on that: Goby3's mm_driver.cpp sends the second to come, and wants the modem's date to be right within a second.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from time import monotonic_ns

BEGIN = datetime(2026, 1, 1)  # as that of programs in lockstep


class ModemClock:
    """The date of one modem."""

    def __init__(self, begin_ns: int) -> None:
        """Begin.

        Args:
            begin_ns: when the clock shows BEGIN [ns, CLOCK_MONOTONIC].
        """
        self._begin_ns, self._ahead = begin_ns, timedelta()
        self.is_set = False  # whether a program has said the date

    def at(self, at_ns: int) -> datetime:
        """The date that it shows.

        Args:
            at_ns: a time [ns, CLOCK_MONOTONIC]. Before the clock begins it stands still.

        Returns:
            the date then.
        """
        return BEGIN + self._ahead + timedelta(microseconds=max(0, at_ns - self._begin_ns) // 1000)

    @property
    def now(self) -> datetime:
        """The date that it shows now."""
        return self.at(monotonic_ns())

    @staticmethod
    def wait_s() -> float:
        """Measure how long it takes until the next whole second [s]."""
        now = datetime.now(UTC)  # noqa: TID251  # drivers compare the date with that of this machine
        return 1.0 - now.microsecond / 1e6

    def set(self, date: datetime) -> None:
        """Show a date from now on.

        Args:
            date: the new one, in UTC if it has no zone.
        """
        plain = date if date.tzinfo is None else date.astimezone(UTC).replace(tzinfo=None)
        self._ahead += plain - self.now
        self.is_set = True
