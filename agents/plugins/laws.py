"""Laws of the user: what a class needs to be one, and the fence that it runs behind."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from agents.config import AgentConfig, Law
from agents.errors import ControllerError
from agents.sample import Sample
from agents.signals import COMMANDED, HEARD
from world.errors import UntrustedError
from world.plugins.checks import check_class, check_signals
from world.plugins.fence import Fence, show_value
from world.plugins.loading import file_class, load_class, unit_file
from world.plugins.trust import permitted_file
from world.signal import Signal
from world.vectors import Vec3

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
        law: its name is `package.module:Class`, that of an entry point in group `uuv_fleet.controllers`, or a file:
            `program:FILE`.

    Returns:
        The class.

    Raises:
        UntrustedError: the module is not installed, and `admit` has not allowed it.
        PluginError: the class does not exist, lacks a method, or does not take these parameters.
    """
    if unit_file(kind, law.name):
        made: type[Any] = file_class(kind, law.name, law.parameters)
        _check(kind, law, made)
        return made
    return load_class(kind, law.name, lambda law_class: _check(kind, law, law_class))


def with_whole_path(law: Law) -> Law:
    """The same law; one that is a file which may run is named by its whole path, for the process that will run it."""
    if not unit_file("agent", law.name):
        return law
    try:
        path = permitted_file("agent", law.name)
    except UntrustedError:
        return law
    return replace(law, name=f"{law.name.partition(':')[0]}:{path}")


def _check(kind: str, law: Law, law_class: Any) -> None:
    check_class(kind, law.name, law_class, METHODS[kind], law.parameters, "the agent's own slice of the scenario")
    # A guidance law's signals share their topic with what every agent reports.
    taken = frozenset(signal.name for signal in (*HEARD, *COMMANDED)) if kind == "guidance" else frozenset[str]()
    check_signals(kind, law.name, getattr(law_class, "signals", None), taken)


def law_fence(config: AgentConfig, law: Law, notes: list[tuple[int, str]]) -> Fence:
    """The fence of one law of one vehicle: every failure is a ControllerError that names vehicle, tick and line."""
    return Fence(law.name, config.budget_s, notes, partial(ControllerError, config.id))


class FencedLaw:
    """A user's guidance, tracking or controller, called as ours are: `step` returns a flat tuple of telemetry."""

    def __init__(
        self, config: AgentConfig, law: Law, law_class: type[Any], what: str, notes: list[tuple[int, str]]
    ) -> None:
        self._fence = law_fence(config, law, notes)
        self._signals: tuple[Signal, ...] = law_class.signals
        self._law = self._fence.make(law_class, config, law.parameters)
        self._what = what

    def step(self, sample: Sample, *more: Any) -> tuple[Vec3, tuple[float, ...]]:
        """One sample, checked.

        Raises:
            ControllerError: the law raised, took too long, or returned what cannot be used.
        """
        fence, method, tick = self._fence, self._law.step, sample.tick
        answer = fence.call(tick, method, sample, *more)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise fence.wrong(tick, method, f"returned {show_value(answer)}: expected ({self._what}, telemetry)")
        vector = fence.vector(tick, method, self._what, answer[0])
        return vector, fence.telemetry(tick, method, self._signals, answer[1])
