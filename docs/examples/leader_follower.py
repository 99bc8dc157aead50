"""Vehicle 1 follows the reference, every other one the vehicle with the lowest number that it hears."""

from math import atan2, hypot

from agents.api import AgentConfig, Sample, Signal, flight_path, wrap


class LeaderFollower:
    """A PID on the position error gives a velocity; a PD on its speed and direction gives the forces."""

    signals = (Signal("error", "m", "distance to where the leader wants this vehicle"),)

    def __init__(self, config: AgentConfig, *, kp: float = 0.4, ki: float = 0.02, kd: float = 0.2, v_max: float = 0.8):
        self.leads, self.inertia = config.id == 1, config.vehicle.inertia
        self.kp, self.ki, self.kd, self.v_max = kp, ki, kd, v_max
        self.integral = [0.0, 0.0, 0.0]

    def step(self, sample: Sample):
        if self.leads or not sample.neighbours:
            place, velocity = sample.desired
        else:
            leader = sample.neighbours[0]  # in order of their numbers
            place = tuple(p + d for p, d in zip(leader.position, leader.offset))
            velocity = leader.velocity
        error = [p - x for p, x in zip(place, sample.eta[:3])]
        if hypot(*error) < 2.0:  # far away an integral would only wind up
            self.integral = [i + e * sample.dt for i, e in zip(self.integral, error)]
        correction = [self.kp * e + self.ki * i for e, i in zip(error, self.integral)]
        correction = [c + self.kd * (v - own) for c, v, own in zip(correction, velocity, sample.velocity)]
        shrink = min(1.0, self.v_max / max(1e-9, hypot(*correction)))
        north, east, down = (v + shrink * c for v, c in zip(velocity, correction))

        # Compare directions of motion, not of the hull: these vehicles drift sideways when they turn.
        (u, v, w, q, r), (m1, m2, m3, *_) = sample.nu, self.inertia
        own_speed, theta, psi = flight_path(sample.eta, sample.nu)
        pitch_error = -theta - atan2(down, hypot(north, east))
        yaw_error = wrap(atan2(east, north) - psi)
        surge = hypot(north, east, down) + 6.0 * (hypot(north, east, down) - own_speed)
        pitch = 15.0 * pitch_error - 10.0 * q - (m3 - m1) * u * w
        yaw = 10.0 * yaw_error - 8.0 * r - (m1 - m2) * u * v
        return (surge, pitch, yaw), {"error": hypot(*error)}
