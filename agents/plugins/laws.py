"""The methods and values that a class needs to be used as a law."""

from __future__ import annotations

from typing import Any

from agents.config import Law
from agents.signals import COMMANDED, HEARD
from world.plugins.checks import check_class, check_signals
from world.plugins.loading import load_class

# What a class of each kind must be able to do, and with what it is called.
METHODS: dict[str, dict[str, tuple[str, ...]]] = {
    "controller": {"step": ("sample",)},
    "guidance": {"step": ("sample",)},
    "tracking": {"step": ("sample", "command")},
    "agent": {"transmit": ("nav",), "decide": ("nav", "deliveries")},
}


def load(kind: str, law: Law) -> type[Any]:
    """The class of a law that is not ours, checked.

    Args:
        kind: controller, guidance, tracking or agent.
        law: `package.module:Class`, or the name of an entry point in group `uuv_fleet.controllers`.

    Raises:
        UntrustedError: its module is not installed, and was not let in with `admit`.
        PluginError: there is no such class, or it cannot be used.
    """
    return load_class(kind, law.name, lambda law_class: _check(kind, law, law_class))


def _check(kind: str, law: Law, law_class: Any) -> None:
    check_class(kind, law.name, law_class, METHODS[kind], law.parameters, "the agent's own slice of the scenario")
    # A guidance law's signals share their topic with what every agent reports.
    taken = frozenset(signal.name for signal in (*HEARD, *COMMANDED)) if kind == "guidance" else frozenset[str]()
    check_signals(kind, law.name, getattr(law_class, "signals", None), taken)
