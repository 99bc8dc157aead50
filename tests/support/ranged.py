"""Short runs in which vehicles fuse positions by covariance intersection."""

from __future__ import annotations

# Changes to `locate-consistent`. There nobody is so unsure in the first seconds that a range helps. With these
# vehicle 2 uses one at 1.3 s and, after its death, one at 5.3 s.
UNSURE = ["seed=3", "navigation.start=10 m", "per_vehicle.1.navigation.start=1 m"]
DYING = [*UNSURE, "faults=[{at: 2 s, for: 2 s, kill: 2}]"]
