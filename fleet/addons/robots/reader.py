"""Bags of ROS 2, as commands take them: the core reads them as logs, and here is what a damaged one needs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.logs.other import OtherData

if TYPE_CHECKING:
    from fleet.logs.other import Recovered


class DamagedBag(OtherData):
    """The directory of a bag, which becomes a new bag."""

    name = "a bag of ROS 2"
    is_log = True

    def recognises(self, path: Path) -> bool:
        """Whether it is the directory of a bag."""
        return (path / f"{path.resolve().name}.mcap").is_file()

    def recover(self, path: Path, out: Path | None, on_progress: Callable[[float], None]) -> Recovered:
        """Write what is left. Raises LogReadError: it cannot be opened; FleetError: `out` cannot be written."""
        from fleet.addons.robots.ros2.bag import repair

        return repair(path, out, on_progress)
