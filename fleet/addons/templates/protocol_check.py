"""TheLawCheck: what the protocol TheLaw promises. The scenario the_law.yaml uses it."""

from __future__ import annotations

from fleet.checks.api import Facts, Failure, Tick, seconds


class TheLawCheck:
    """All vehicles agree on the count within some time after an agent ended or began."""  # the verdict shows this line

    def __init__(self, facts: Facts, *, within: str = "5 s") -> None:
        # `facts` is what is known of the scenario: vehicles, duration, links, units of signals, ...
        # What follows the star are parameters: `checks: {"the_law_check:TheLawCheck": {within: 8 s}}`.
        self._within = seconds(within)
        self._living: frozenset[int] = frozenset()
        self._since = facts.begin  # when this became so [s]
        self._slowest = 0.0  # s

    def step(self, tick: Tick) -> Failure | None:
        """One tick: all vehicles by number, the faults that are active, and packets whose fate has become final."""
        living = [vehicle for vehicle in tick.vehicles if vehicle.alive]
        numbers = frozenset(vehicle.id for vehicle in living)
        if numbers != self._living:
            self._living, self._since = numbers, tick.t
        # Signals have the names that the log has. None: an agent reports nothing now, because it is suspended.
        counted = {vehicle.id: vehicle["control.there"] for vehicle in living}
        wrong = {i: count for i, count in counted.items() if count is not None and count != len(living)}
        passed = tick.t - self._since
        if wrong and passed > self._within:
            # The first failure decides. The run goes on, and its verdict names tick, vehicles and values.
            return Failure(
                f"{len(living)} vehicles are there, and some count otherwise",
                tuple(wrong),
                {f"vehicle {i} counts": count for i, count in wrong.items()},
            )
        if wrong:
            self._slowest = max(self._slowest, passed)
        return None

    def verdict(self) -> str | Failure | None:
        """The finding, for the verdict. It is also asked while the run goes on, so it must change nothing."""
        return f"agreement after at most {self._slowest:.4g} s"
