"""An agent's answer to one sample."""

from __future__ import annotations

from typing import NamedTuple

from world.vectors import Vec3


class Decision(NamedTuple):
    """The command to the vehicle, and the values for the log."""

    tau: Vec3  # surge force [N], pitch and yaw moment [N m], within the actuators' limits
    telemetry: tuple[float, ...]  # the values of the declared signals, in order


class Step(NamedTuple):
    """A decision, and what to send to the neighbours."""

    tau: Vec3
    telemetry: tuple[float, ...]
    payloads: tuple[bytes, ...]  # none between round ticks
