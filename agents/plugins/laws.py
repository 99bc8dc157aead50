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
    """Import the class of a user's law, and check it.

    Args:
        kind: controller, guidance, tracking or agent.
        law: its name is `package.module:Class`, or that of an entry point in group `uuv_fleet.controllers`.

    Raises:
        UntrustedError: the module is not installed, and `admit` has not allowed it.
        PluginError: the class does not exist, lacks a method, or does not take these parameters.
    """
    return load_class(kind, law.name, lambda law_class: _check(kind, law, law_class))


def _check(kind: str, law: Law, law_class: Any) -> None:
    check_class(kind, law.name, law_class, METHODS[kind], law.parameters, "the agent's own slice of the scenario")
    # A guidance law's signals share their topic with what every agent reports.
    taken = frozenset(signal.name for signal in (*HEARD, *COMMANDED)) if kind == "guidance" else frozenset[str]()
    check_signals(kind, law.name, getattr(law_class, "signals", None), taken)
