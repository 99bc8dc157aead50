"""The journal of a run on zenoh, while it goes on, or nothing of the kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fleet.replay.publisher import LivePublisher
from fleet.result.result import Published


class NoPublication:
    """A run that is not published."""

    publisher = None

    def open(self) -> None:
        """Begin to publish."""

    def wait(self) -> None:
        """Wait for a subscriber, if the run is to."""

    def close(self) -> None:
        """End."""

    def summary(self) -> Published | None:
        """The result's entry about it."""
        return None


class Publication:
    """A run that is published."""

    def __init__(
        self, run: str, observe: Path, scenario: str, print_line: Callable[[str], None], *, wait: bool
    ) -> None:
        """Prepare it; nothing is started.

        Args:
            run: its id; its keys begin with fleet/<run>/.
            observe: the file that says, while the run lives, where and as whom to subscribe.
            scenario: of the run, as YAML.
            print_line: shows the operator a line that stays.
            wait: the run begins when there is a subscriber.
        """
        self.publisher = LivePublisher(run, observe, scenario, wait=wait)  # what the log writer hands each message
        self._observe, self._print_line = observe, print_line

    def open(self) -> None:
        """Begin to publish. Raises FleetError: that is not possible."""
        self.publisher.open()
        where = f"fleet/{self.publisher.run}/log/** at {self.publisher.endpoint}"
        self._print_line(f"publishing {where}; how to join: {self._observe}")

    def wait(self) -> None:
        """Wait for a subscriber, if the user asked for that. Raises FleetError: the publisher ended meanwhile."""
        if self.publisher.wait:
            self._print_line("waiting for a subscriber")
            self.publisher.heard()

    def close(self) -> None:
        """End, once everything is published."""
        self.publisher.close()

    def summary(self) -> Published | None:
        """The result's entry about it."""
        return Published(self.publisher.published, self.publisher.dropped)
