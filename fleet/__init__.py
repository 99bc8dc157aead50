"""The operator: scenarios, launch and supervision, the clock, the log and the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fleet.logs.open_log import Log as Log
    from fleet.logs.open_log import open_log as open_log

__all__ = ["Log", "open_log"]


def __getattr__(name: str) -> Any:
    # Every command imports this package; numpy and protobuf come with the first use.
    if name in __all__:
        from fleet.logs import open_log as arrays

        return getattr(arrays, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
