"""A vehicle that a program steers: where it is, told to the program, and what the program commands.

Both are JSON in datagrams of the loopback. A zenoh program has the same on keys of its endpoint, and a node of ROS 2 on
topics of `ros_vehicle`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from math import isfinite

from agents.api import AgentConfig, Nav, Vec3
from fleet.addons.programs.velocity import velocity_demand

_FORCES, _VELOCITIES = ("force", "pitch", "yaw"), ("surge", "pitch_rate", "yaw_rate")


def navigation(nav: Nav, now_ns: int) -> bytes:
    """Where a vehicle is, as its program gets it: `t` [s], `position` [m, NED], `theta`, `psi` [rad], `velocity` [m/s,
    body], `q`, `r` [rad/s]; with roll also `phi` [rad], `p` [rad/s].
    """
    (x, y, z, theta, psi), (u, v, w, q, r) = nav.eta, nav.nu
    values = {"t": now_ns / 1e9, "position": [x, y, z], "theta": theta, "psi": psi,
              "velocity": [u, v, w], "q": q, "r": r}  # fmt: skip
    if nav.roll:
        values["phi"], values["p"] = nav.roll
    return json.dumps(values).encode()


class SteeredVehicle:
    """What a program commands; the last command holds."""

    def __init__(self, config: AgentConfig) -> None:
        self._config = config
        self._commanded: Callable[[Nav], Vec3] | None = None  # None: it has commanded nothing yet

    def command(self, data: bytes) -> bool:
        """Take a command: `force` [N], `pitch`, `yaw` [N m], or `surge` [m/s], `pitch_rate`, `yaw_rate` [rad/s].

        Returns:
            Whether it was one. What is none, as after damage on its way, changes nothing.
        """
        try:
            values = json.loads(data)
            names = _VELOCITIES if any(name in values for name in _VELOCITIES) else _FORCES
            x, y, z = (float(values.get(name, 0.0)) for name in names)
        except (ValueError, TypeError, AttributeError):
            return False
        if not (isfinite(x) and isfinite(y) and isfinite(z)):
            return False
        if names is _FORCES:
            self._commanded = lambda _: (x, y, z)
        else:
            self._commanded = partial(velocity_demand, self._config.vehicle, (x, y, z))
        return True

    def demand(self, nav: Nav) -> Vec3 | None:
        """Surge force [N], pitch and yaw moment [N m]; None: the program has commanded nothing."""
        return None if self._commanded is None else self._commanded(nav)
