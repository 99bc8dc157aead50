"""The world's core: the true state of every vehicle, what its sensors say, and its motion over one tick.

Vehicles touch each other only through the network, never through the water. So each has its own tick and may
run ahead of the others within a network round; the order in which they are advanced cannot change a bit.
No clock, no I/O: a run is a function of the configuration and the commands.
"""

from __future__ import annotations

from functools import lru_cache
from math import isfinite
from typing import Any, NamedTuple

from world.config import VehicleSetup, WorldConfig
from world.disturbance import disturbance
from world.dynamics import Coefficients, State, coefficients, rk4_step
from world.errors import CommandError, NonFiniteStateError, PitchSingularityError, UnknownVehicleError
from world.sensors import measure
from world.vehicle import Vec3, Vec5


class _Vehicle(NamedTuple):
    """What does not change about one vehicle."""

    k: Coefficients
    tau_max: Vec3


class World:
    """Truth, sensors, actuators and integration of every vehicle of one run."""

    def __init__(self, config: WorldConfig) -> None:
        self.config = config
        self.ids: tuple[int, ...] = tuple(sorted(setup.id for setup in config.vehicles))
        self._fixed = {s.id: _Vehicle(coefficients(s.params), s.tau_max) for s in config.vehicles}
        self._ticks = dict.fromkeys(self.ids, 0)
        self._states: dict[int, State] = {s.id: _initial(s) for s in config.vehicles}
        self._h = config.tick_ns / 1e9 / config.substeps
        # Every vehicle feels the same disturbance and all pass the same ticks, some ahead of others.
        self._stage_forces = lru_cache(maxsize=4 * max(config.round_ticks, 8))(self._stage_forces_at)

    def tick(self, i: int) -> int:
        """The tick up to which vehicle i has been integrated."""
        self._known(i)
        return self._ticks[i]

    def state(self, i: int) -> tuple[Vec5, Vec5]:
        """True eta [m, rad] and nu [m/s, rad/s] of vehicle i at its tick."""
        self._known(i)
        x, y, z, theta, psi, u, v, w, q, r = self._states[i]
        return (x, y, z, theta, psi), (u, v, w, q, r)

    def position(self, i: int) -> Vec3:
        """True x, y, z [m, NED] of vehicle i at its tick."""
        self._known(i)
        state = self._states[i]
        return state[0], state[1], state[2]

    def sense(self, i: int) -> tuple[Vec5, Vec5]:
        """Measured eta and nu of vehicle i at its tick."""
        eta, nu = self.state(i)
        return measure(eta, nu, self.config.noise, self.config.seed, i, self._ticks[i])

    def actuate(self, i: int, tau: tuple[float, ...]) -> Vec3:
        """What the actuators of vehicle i make of a command: each element within +-tau_max [N, N m].

        Raises:
            CommandError: not three finite numbers.
        """
        self._known(i)
        if len(tau) != 3 or not all(map(isfinite, tau)):
            raise CommandError(i, self._ticks[i], tau)
        t1, t2, t3 = tau
        l1, l2, l3 = self._fixed[i].tau_max
        return max(-l1, min(l1, t1)), max(-l2, min(l2, t2)), max(-l3, min(l3, t3))

    def advance(self, i: int, tau: Vec3) -> None:
        """Integrate vehicle i, and it alone, to its next tick with `tau` [N, N m] held.

        Raises:
            PitchSingularityError: the vehicle stands vertical; its state stays that of the tick before.
            NonFiniteStateError: the motion left the range of finite numbers; likewise.
        """
        self._known(i)
        k = self._fixed[i].k
        tick = self._ticks[i]
        state = self._states[i]
        current = self.config.current
        h = self._h
        try:
            for d in self._stage_forces(tick):
                state = rk4_step(k, state, tau, d, h, current)
        except PitchSingularityError as error:
            raise PitchSingularityError(error.reason, error.theta, i, tick) from None
        except (OverflowError, ValueError):
            # math.sin of an infinite angle is a ValueError, not a NaN.
            raise NonFiniteStateError("the motion left the finite numbers", state[3], i, tick) from None
        if not isfinite(sum(state)):
            raise NonFiniteStateError("the motion left the finite numbers", state[3], i, tick)
        self._states[i] = state
        self._ticks[i] = tick + 1

    def hold(self, i: int) -> None:
        """Pass a tick without integrating vehicle i: it is lost and stays where it was."""
        self._known(i)
        self._ticks[i] += 1

    def state_values(self) -> dict[str, Any]:
        """Everything that changes, as plain MessagePack values; `restore` takes it back."""
        return {"vehicles": [[i, self._ticks[i], *self._states[i]] for i in self.ids]}

    def restore(self, values: dict[str, Any]) -> None:
        """Continue from `state_values()` of a world with the same configuration.

        Raises:
            UnknownVehicleError: a vehicle that this world was not set up with.
        """
        for i, tick, x, y, z, theta, psi, u, v, w, q, r in values["vehicles"]:
            self._known(i)
            self._ticks[i] = tick
            self._states[i] = (x, y, z, theta, psi, u, v, w, q, r)

    def _known(self, i: int) -> None:
        if i not in self._fixed:
            raise UnknownVehicleError(i, self.ids)

    def _stage_forces_at(self, tick: int) -> tuple[tuple[Vec5, Vec5, Vec5], ...]:
        """The disturbance at start, middle and end of each RK4 step of a tick."""
        config = self.config
        n = config.substeps
        t = tick * config.tick_ns / 1e9
        d = [disturbance(config.disturbance, t + j * 0.5 * self._h) for j in range(2 * n + 1)]
        return tuple((d[2 * j], d[2 * j + 1], d[2 * j + 2]) for j in range(n))


def _initial(setup: VehicleSetup) -> State:
    x, y, z, theta, psi = map(float, setup.eta0)
    u, v, w, q, r = map(float, setup.nu0)
    return x, y, z, theta, psi, u, v, w, q, r
