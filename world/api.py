"""The interface of plants: the input and the output of a plant. It is the same for shipped plants and for yours.

A *plant* is the vehicle itself: the equations that turn a command and the water into motion. It replaces the built-in
5-DOF model of `world/dynamics.py`. It may have six degrees of freedom, actuators with lags, or anything else inside. A
plant needs no other module of this package. The names in `__all__` are stable. `docs/guide/your-vehicle.md` is the
guide; `fleet new plant NAME` writes a template.

The world makes a plant once per run and vehicle, as `MyPlant(config, **parameters)`, with the parameters that the
scenario gives it. A plant should remember nothing between its steps. The next step depends only on its state. The world
keeps this state, logs it and passes it to the next step. So a run can be resumed from its log, and is the same on every
machine.

| quantity | unit | frame |
|---|---|---|
| pose x, y, z; phi, theta, psi | m; rad | NED; roll, pitch (nose up > 0), heading (z-y-x, heading not wrapped) |
| velocity u, v, w; p, q, r | m/s; rad/s | body (forward, right, down), over ground |
| tau: surge force, pitch moment, yaw moment | N, N m, N m | body |
| water.current | m/s | NED |
| water.wrench X, Y, Z; K, M, N | N; N m | body |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from world.signal import Signal
from world.vectors import Vec3, Vec5, Vec6
from world.vehicle_params import VehicleParams

__all__ = ["Plant", "PlantConfig", "PlantState", "Report", "Signal", "Vec3", "Vec5", "Vec6", "VehicleParams", "Water"]

PlantState = tuple[float, ...]  # finite numbers, as many in every state of a run
Report = Mapping[str, float | Sequence[float]]  # by the name of a signal, in its unit


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """The part of the run that a plant may know."""

    vehicle: int  # number of the vehicle, from 1
    tick_s: float  # control period [s], for which tau is constant
    seed: int  # seed of the run
    model: VehicleParams  # the 5-DOF numbers that the controllers use: `vehicle.model` of the scenario


class Water(NamedTuple):
    """The effect of the sea on a vehicle during one step."""

    current: Vec3  # velocity of the water [m/s, NED]; it does not depend on the place, and is constant over a tick
    wrench: Vec6  # disturbance on the hull in body axes: X, Y, Z [N], K, M, N [N m]


class Plant(Protocol):
    """A vehicle: its equations of motion.

    A class may also have

    * `model: ClassVar[str]`: the vehicle file (as `vehicle.model`) that the controllers use if the scenario names none;
    * `signals: ClassVar[tuple[Signal, ...]]` and `report(state) -> Mapping`: further reported values, such as propeller
      revolutions. `report` returns a number, or `width` numbers, for each name;
    * `close()`: ends everything that it holds, such as a process. It is not used afterwards. In a distributed run the
      world's process ends without this call, and everything that the plant holds must end with it.
    """

    @property
    def limits(self) -> Vec3:
        """Limit the command. A plain attribute does, too.

        Returns:
            The largest |surge force| [N], |pitch moment| and |yaw moment| [N m] that the plant takes. The command is
            limited to the smaller of these and the scenario's limits.
        """

    def start(self, pose: Vec6, velocity: Vec6) -> PlantState:
        """Make the state at the beginning of a run.

        Args:
            pose: x, y, z [m, NED], phi, theta, psi [rad].
            velocity: u, v, w [m/s, body, over ground], p, q, r [rad/s].

        Returns:
            All that the next step depends on: finite numbers, as many in every state.
        """

    def step(self, state: PlantState, tau: Vec3, water: Water, dt: float) -> PlantState:
        """Move on. The world calls this `substeps` times per tick, with dt = tick / substeps.

        Args:
            state: the result of `start` or of the last step.
            tau: surge force [N], pitch moment and yaw moment [N m]. All limits and the faults of the actuators are
                applied already.
            water: the current during the step, and the disturbance at its middle.
            dt: length of the step [s].

        Returns:
            The state `dt` later: finite numbers, as many as before.
        """

    def pose(self, state: PlantState) -> Vec6:
        """Read the pose from a state.

        Args:
            state: the result of `start` or `step`.

        Returns:
            x, y, z [m, NED], phi, theta, psi [rad]; the heading goes on beyond a full turn.
        """

    def velocity(self, state: PlantState) -> Vec6:
        """Read the velocity from a state.

        Args:
            state: the result of `start` or `step`.

        Returns:
            u, v, w [m/s, body, over ground], p, q, r [rad/s].
        """
