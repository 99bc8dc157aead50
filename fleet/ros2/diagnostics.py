"""Faults and checks of a run as ROS's diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from fleet.ros2.mapping import MessageMaker

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # diagnostic_msgs/DiagnosticStatus
MOST = 10_000  # faults that are kept: a log may come from a stranger


class Diagnostics:
    """The present knowledge of the faults and checks of one run."""

    def __init__(self, maker: MessageMaker) -> None:
        self._maker = maker
        self._faults: dict[str, tuple[int, str]] = {}
        self._checks: list[tuple[int, str, str]] = []

    def fault(self, event: Any) -> None:
        """Take a message of the topic `faults`."""
        lasts = event.action == "begins"
        if lasts and len(self._faults) >= MOST:
            del self._faults[next(iter(self._faults))]
        if lasts or event.fault in self._faults:
            self._faults[event.fault] = (WARN, event.what) if lasts else (OK, f"over: {event.what}")

    def checks(self, rows: Iterable[Mapping[str, Any]]) -> bool:
        """Take the checks as they stand; whether that is something new.

        Args:
            rows: each with `check`, `asked`, `found` and `passed`, which is None until it is judged.
        """
        new = [_check(row) for row in rows]
        changed = new != self._checks
        self._checks = new
        return changed

    def message(self, ns: int) -> Any:
        """All of it."""
        rows = [(level, f"fault {name}", text) for name, (level, text) in self._faults.items()]
        return self._maker.types.new(
            "diagnostic_msgs/msg/DiagnosticArray",
            header=self._maker.header(ns, ""),
            status=[self._status(*row) for row in (*rows, *self._checks)],
        )

    def _status(self, level: int, name: str, text: str) -> Any:
        return self._maker.types.new(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level, name=f"uuv_fleet: {name}", message=text, hardware_id="uuv-fleet", values=[],
        )  # fmt: skip


def _check(row: Mapping[str, Any]) -> tuple[int, str, str]:
    passed = row.get("passed")
    level = STALE if passed is None else OK if passed else ERROR
    return level, f"check {row.get('check', '')}", f"{row.get('asked', '')}: {row.get('found') or 'not judged yet'}"
