"""Packages of messages and services of ROS 2: which a program imports, and the definitions that lie beside it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.addons.programs.ros_messages import Definitions


def interface(name: str, folder: Path) -> ModuleType | None:
    """The module of messages or services of ROS 2, such as `std_msgs.msg`, or its package.

    Args:
        name: of the module.
        folder: where the program lies, with definitions of its own.

    Returns:
        The module; None: it is another one.
    """
    package, _, kind = name.partition(".")
    own = _files(folder if package == folder.name else folder / package)
    if not own and not package.endswith(("_msgs", "_srvs", "_interfaces")):
        return None
    if kind in ("msg", "srv"):
        from fleet.addons.programs.ros_messages import interface_module

        return interface_module(package, kind, own_definitions(folder, package))
    if kind or (folder / package / "__init__.py").exists():
        return None  # Python of the program's own, beside its definitions
    made = ModuleType(name)
    made.__path__ = []
    return made


def own_definitions(folder: Path, package: str) -> Definitions:
    """The definitions beside a program, of `PACKAGE/msg/NAME.msg` and `PACKAGE/srv/NAME.srv`.

    Args:
        folder: where the program lies.
        package: the package of those that lie in `msg` and `srv` of the folder itself.

    Returns:
        The names and texts, in the order of their names.
    """
    places = {folder: package} | {place: place.name for place in folder.iterdir()}
    return tuple(
        sorted(
            (f"{name}/{file.parent.name}/{file.stem}", file.read_text("utf-8"))
            for place, name in places.items()
            for file in _files(place)
        )
    )


def _files(place: Path) -> list[Path]:
    return [*place.glob("msg/*.msg"), *place.glob("srv/*.srv")]
