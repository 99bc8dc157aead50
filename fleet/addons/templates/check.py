"""TheLaw: a check for uuv-fleet. Run it with: fleet run the_law.yaml"""

from __future__ import annotations

from fleet.checks.api import Facts, Failure, Tick, seconds


class TheLaw:
    """No two living vehicles are nearer than `distance` for longer than `grace`."""  # the verdict shows this line

    def __init__(self, facts: Facts, *, distance: float = 1.0, grace: str = "0 s") -> None:
        # `facts` is what is known of the scenario: vehicles, duration, links, units of signals, ...
        # What follows the star are parameters: `checks: {"the_law:TheLaw": {distance: 2, grace: 1 s}}`.
        self._distance = distance  # m
        self._grace = seconds(grace)
        self._since: dict[tuple[int, int], float] = {}  # pair -> when they came too near [s]
        self._least = float("inf")

    def step(self, tick: Tick) -> Failure | None:
        """One tick: all vehicles by number, the faults that are active, and packets whose fate has become final."""
        vehicles = [vehicle for vehicle in tick.vehicles if vehicle.alive]
        for k, a in enumerate(vehicles):
            for b in vehicles[k + 1 :]:
                # Signals have the names that the log has: state.z, error.e_norm, control.u_err, ...
                off = [a[f"state.{axis}"] - b[f"state.{axis}"] for axis in "xyz"]
                distance = sum(d * d for d in off) ** 0.5
                self._least = min(self._least, distance)
                if distance >= self._distance:
                    self._since.pop((a.id, b.id), None)
                elif tick.t - self._since.setdefault((a.id, b.id), tick.t) >= self._grace:
                    # The first failure decides. The run goes on, and its verdict names tick, vehicles and values.
                    return Failure("too near to each other", (a.id, b.id), {"distance [m]": distance})
        return None

    def verdict(self) -> str | Failure | None:
        """The finding, for the verdict: in words, or a failure that only the end of the run can show.

        You may leave this out. It is also asked while the run goes on, so it must change nothing.
        """
        return f"at least {self._least:.4g} m"
