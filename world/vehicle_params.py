"""The numbers of the 5-DOF model of a vehicle.

| symbol | meaning | unit | paper |
|---|---|---|---|
| m, Iy, Iz | rigid-body mass, moments of inertia in pitch and yaw | kg, kg m^2 | Table I |
| beta_udot .. beta_rdot | added mass with the paper's sign (m1 = m - beta_udot) | kg, kg m^2 | Table I |
| beta_u .. beta_r | linear damping in surge, sway, heave, pitch, yaw | kg/s, kg m^2/s | Table I |
| beta_b | restoring moment coefficient in pitch | N m | Table I |
"""

from __future__ import annotations

from dataclasses import dataclass

from world.vectors import Vec5


@dataclass(frozen=True, slots=True)
class VehicleParams:
    """Parameters of the 5-DOF underactuated vehicle (eqs. 1-2); `world/vehicles` holds numbers with their sources."""

    m: float  # kg
    Iy: float  # kg m^2
    Iz: float
    beta_udot: float  # kg
    beta_vdot: float
    beta_wdot: float
    beta_qdot: float  # kg m^2
    beta_rdot: float
    beta_u: float  # kg/s
    beta_v: float
    beta_w: float
    beta_q: float  # kg m^2/s
    beta_r: float
    beta_b: float  # N m

    @property
    def inertia(self) -> Vec5:
        """Add the added mass up, as printed below eq. (2).

        Returns:
            The diagonal m1..m5 of the mass matrix [kg, kg, kg, kg m^2, kg m^2].
        """
        return (
            self.m - self.beta_udot,
            self.m - self.beta_vdot,
            self.m - self.beta_wdot,
            self.Iy - self.beta_qdot,
            self.Iz - self.beta_rdot,
        )
