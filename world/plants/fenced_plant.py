"""A plant behind the fence of plug-ins: made, started and moved, with every answer checked."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from math import cos, isfinite, sin
from pathlib import Path
from typing import Any

from world.api import PlantConfig, PlantState, Water
from world.config import PlantSetup
from world.errors import PlantError
from world.plants.classes import plant_class
from world.plugins.checks import MAX_NUMBERS
from world.plugins.fence import Fence, numbers_of, show_value
from world.plugins.trust import allow_file
from world.signal import Signal
from world.vectors import Vec2, Vec3, Vec6

_TOLERANCE = 1e-3  # by how much a plant may begin elsewhere than it was told [m, rad]


class FencedPlant:
    """The plant of one vehicle, at the tick that the vehicle has reached. Every failure is a PlantError."""

    def __init__(self, setup: PlantSetup, config: PlantConfig) -> None:
        """Make the plant; `start` puts it into the water. Raises PluginError: there is no such plant, or
        it cannot be used; PlantError: it cannot be made, or has limits that are none."""
        self.name = setup.name
        self.notes: list[tuple[int, str]] = []  # (tick, text) for a person; the reader clears it
        self.state: PlantState = ()
        self.pose: Vec6 = (0.0,) * 6
        self.velocity: Vec6 = (0.0,) * 6
        self.reported: tuple[float, ...] = ()  # the values of its signals
        if setup.file:
            allow_file(setup.name, Path(setup.file))
        plant = plant_class(setup.name, setup.parameters)
        self._signals: tuple[Signal, ...] = getattr(plant, "signals", ())
        failure = partial(PlantError, config.vehicle)
        if setup.file:  # no line of a program is at fault
            failure = partial(_failure_without_line, config.vehicle)
        self._fence = Fence(setup.name, setup.budget_s, self.notes, failure)
        self._plant = self._fence.make(plant, config, setup.parameters)
        self.limits = self._limits()

    @property
    def roll(self) -> Vec2:
        """True roll phi [rad] and roll rate p [rad/s]."""
        return self.pose[3], self.velocity[3]

    @property
    def pitch(self) -> Vec2:
        """True pitch theta [rad] and how fast it changes [rad/s]: where it is rolled, this is not q."""
        phi, (_, _, _, _, q, r) = self.pose[3], self.velocity
        return self.pose[4], q * cos(phi) - r * sin(phi)

    def start(self, tick: int, pose: Vec6, velocity: Vec6) -> None:
        """Put the vehicle into the water. `pose`: x, y, z [m, NED], phi, theta, psi [rad]. `velocity`: u, v, w [m/s,
        body, over ground], p, q, r [rad/s]. Raises PlantError: what it returned is no state, or one at another
        place."""
        fence, plant = self._fence, self._plant
        state = fence.call(tick, plant.start, pose, velocity)
        numbers = _numbers(state)
        if not numbers or len(numbers) > MAX_NUMBERS:
            text = f"returned the state {show_value(state)}: expected 1 to {MAX_NUMBERS} numbers"
            raise fence.wrong(tick, plant.start, text)
        self.state = (0.0,) * len(numbers)  # the next states must be as long as this one
        self._take(tick, plant.start, fence.call(tick, self._observed, numbers))
        if any(abs(a - b) > _TOLERANCE for a, b in zip(self.pose, pose, strict=True)):
            found, expected = _list_words(self.pose), _list_words(pose)
            text = f"has the pose {found} at its start: expected {expected}, what start was called with"
            raise fence.wrong(tick, plant.start, text)

    def advance(self, tick: int, tau: Vec3, current: Vec3, wrenches: Iterable[Vec6], dt: float) -> None:
        """Move the vehicle to the next tick.

        Args:
            tick: the present tick.
            tau: surge force [N], pitch and yaw moment [N m], constant over the tick.
            current: velocity of the water [m/s, NED], constant over the tick.
            wrenches: the disturbance of each step: X, Y, Z [N], K, M, N [N m] in body axes.
            dt: length of a step [s].

        Raises:
            PlantError: the plant failed. Its state is the same as before the call.
        """
        self._take(tick, self._plant.step, self._fence.call(tick, self._moved, tau, current, wrenches, dt))

    @property
    def holds(self) -> bool:
        """Whether it holds something that `close` ends."""
        return callable(getattr(self._plant, "close", None))

    def close(self) -> None:
        """Let the plant end everything that it holds. It is not used afterwards."""
        if callable(close := getattr(self._plant, "close", None)):
            with suppress(Exception, SystemExit):  # the run is over, and its result stands
                close()

    def _moved(self, tau: Vec3, current: Vec3, wrenches: Iterable[Vec6], dt: float) -> tuple[Any, Any, Any, Any]:
        state, step, size = self.state, self._plant.step, len(self.state)
        for wrench in wrenches:
            answer = step(state, tau, Water(current, wrench), dt)
            state = _numbers(answer)
            if len(state) != size or not all(map(isfinite, state)):
                return answer, None, None, None
        return self._observed(state)

    def _observed(self, state: PlantState) -> tuple[Any, Any, Any, Any]:
        plant = self._plant
        return state, plant.pose(state), plant.velocity(state), plant.report(state) if self._signals else {}

    def _take(self, tick: int, method: Any, said: tuple[Any, Any, Any, Any]) -> None:
        fence, plant = self._fence, self._plant
        state, size = _numbers(said[0]), len(self.state)
        if len(state) != size:
            what = f"a state of {len(state)} numbers" if state else f"the state {show_value(said[0])}"
            text = f"returned {what}: expected {size} numbers, as the state before has"
            raise fence.wrong(tick, method, text)
        if not all(map(isfinite, state)):
            raise fence.wrong(tick, method, f"returned the state {show_value(state)}: every number must be finite")
        pose = self._six(tick, plant.pose, "pose (x, y, z, phi, theta, psi)", said[1])
        velocity = self._six(tick, plant.velocity, "velocity (u, v, w, p, q, r)", said[2])
        if self._signals:
            self.reported = fence.telemetry(tick, plant.report, self._signals, said[3])
        self.state, self.pose, self.velocity = state, pose, velocity

    def _six(self, tick: int, method: Any, what: str, value: Any) -> Vec6:
        numbers = _numbers(value)
        if len(numbers) != 6 or not all(map(isfinite, numbers)):
            raise self._fence.wrong(tick, method, f"returned {show_value(value)}: expected {what}, six finite numbers")
        a, b, c, d, e, f = numbers
        return a, b, c, d, e, f

    def _limits(self) -> Vec3:
        plant, fence = self._plant, self._fence
        limits = fence.call(0, getattr, plant, "limits", None)
        if limits is None:
            raise fence.wrong(0, type(plant), "has no limits: largest surge force [N], pitch and yaw moment [N m]")
        found = _numbers(limits)
        if len(found) != 3 or not all(isfinite(limit) and limit >= 0.0 for limit in found):
            text = f"has the limits {show_value(limits)}: expected three finite numbers, none below 0"
            raise fence.wrong(0, type(plant), text)
        return found[0], found[1], found[2]


def _failure_without_line(vehicle: int, tick: int, problem: str, where: str) -> PlantError:
    return PlantError(vehicle, tick, problem, "")


def _numbers(value: Any) -> tuple[float, ...]:
    if type(value) is tuple and all(type(number) is float for number in value):
        return value
    return tuple(numbers_of(value))


def _list_words(numbers: Iterable[float]) -> str:
    return f"({', '.join(f'{number:.4g}' for number in numbers)})"
