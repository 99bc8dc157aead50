"""The controllers by name. A controller is a guidance law followed by a tracking law.

A guidance law turns the consensus error into a commanded velocity, a tracking law turns its speed and
direction into forces; either can be combined with any other, and the agent runs them in this order.
"""

from __future__ import annotations

from collections.abc import Callable

from agents.backstepping import NeurodynamicTracking
from agents.config import AgentConfig
from agents.errors import UnknownNameError
from agents.guidance import OptimalGuidance


def _nboc(config: AgentConfig) -> tuple[OptimalGuidance, NeurodynamicTracking]:
    return (
        OptimalGuidance(config.guidance, config.reference.velocity),
        NeurodynamicTracking(config.tracking, config.vehicle),
    )


CONTROLLERS: dict[str, Callable[[AgentConfig], tuple[OptimalGuidance, NeurodynamicTracking]]] = {
    "nboc": _nboc,
}


def build(config: AgentConfig) -> tuple[OptimalGuidance, NeurodynamicTracking]:
    """The guidance and tracking laws of the controller that the configuration names.

    Raises:
        UnknownNameError: there is no such controller.
    """
    if config.controller not in CONTROLLERS:
        raise UnknownNameError("controller", config.controller, tuple(CONTROLLERS))
    return CONTROLLERS[config.controller](config)
