"""One vehicle of the linearised fleet over one round: what it does by itself, and what messages do to it.

`fleet.analysis.border` explains the symbols.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fleet.analysis.linear import Array, Linear

Complex = np.ndarray[Any, np.dtype[np.complex128]]
LOOPS = ("speed", "course", "pitch")  # they move a vehicle ahead, to starboard, down
MOST_CONDITION = 1e8  # of eigenvectors; in the scenarios that ship it is at most 1e6


class Link(NamedTuple):
    """A link into a vehicle."""

    sender: int  # counted from 0
    weight: float  # a_ij
    delay: int  # d [ticks]


@dataclass(frozen=True, eq=False, slots=True)
class Member:
    """A vehicle in the fleet's linear map."""

    linear: Linear
    b: float
    links: tuple[Link, ...]
    reckons: bool  # whether it extrapolates with the velocity that a neighbour sent
    age_cap: int | None  # ticks
    pattern: Array  # (3, 3): K is a number times this, path axes
    told: bool = True  # whether it knows v_d; otherwise v_d is the weighted mean of what its neighbours sent

    @property
    def c(self) -> float:
        """Total weight of its consensus error."""
        return self.b + sum(link.weight for link in self.links)


class VehicleRound:
    """A vehicle over one round, with its own feedback. Vehicles that differ only in their neighbours share one."""

    def __init__(self, member: Member, gain: float, m: int, tick_s: float, outputs: int) -> None:
        F, G, C = member.linear
        self.m, self.outputs = m, outputs
        self._C = C[:outputs]
        K = gain * member.pattern
        own = F + member.c * G @ K @ C[:3]
        # What a command at phase f has become at the end of the round: own^(m-1-f) G.
        self._later = np.empty((m, len(F), 3))
        after = G
        for f in range(m - 1, -1, -1):
            self._later[f] = after
            after = own @ after
        self._P = np.linalg.matrix_power(own, m)
        self._values, vectors = np.linalg.eig(self._P)
        self.unstable = int((np.abs(self._values) > 1.0).sum())
        self.growth = float(np.abs(self._values).max())
        # In terms of the eigenvectors of P the resolvent is a division. If eigenvalues meet, the vectors may not span
        # the space, and `resolvent` solves a linear system.
        self._outputs = self._C @ vectors
        simple = np.linalg.cond(vectors) < MOST_CONDITION
        self._inputs: Complex | None = np.linalg.inv(vectors) if simple else None
        self._K, self._heard = K, None if member.told else member.c - member.b
        self._reckons, self._cap, self._tick_s = member.reckons, member.age_cap, tick_s

    def own_mode(self) -> tuple[float, str]:
        """Angle of the largest eigenvalue of P, and the loop that it moves most."""
        at = int(np.argmax(np.abs(self._values)))
        moved = np.abs(self._outputs[:3, at])
        return abs(float(np.angle(self._values[at]))), LOOPS[int(np.argmax(moved))]

    def resolvent(self, z: Complex) -> Complex:
        """C (z - P)^-1 at every z."""
        if self._inputs is not None:
            shares: Complex = self._outputs / (z[:, None] - self._values)[:, None, :] @ self._inputs
            return shares
        matrices = z[:, None, None] * np.eye(len(self._P)) - self._P.T
        return np.swapaxes(np.linalg.solve(matrices, self._C.T.astype(complex)), 1, 2)

    def answer(self, resolvent: Complex, z: Complex, delay: int) -> Complex:
        """C (z - P)^-1 S(z) for a link with a delay [ticks]."""
        total = np.zeros((len(z), self.outputs, self.outputs), complex)
        phases = np.arange(self.m)
        back = -((phases - delay) // self.m)  # rounds since the message in use was sent
        ages = phases + back * self.m
        if self._cap is not None:
            ages = np.minimum(ages, self._cap)
        for h in sorted({*back.tolist()}):
            used = self._later[back == h]
            S = np.zeros((len(self._P), self.outputs))
            S[:, :3] = used.sum(axis=0) @ self._K
            if self._reckons:
                S[:, 3:] = np.tensordot(ages[back == h] * self._tick_s, used, 1) @ self._K
            if self._heard:
                S[:, 3:] += used.sum(axis=0) / self._heard
            total += (z ** float(-h))[:, None, None] * (resolvent @ S)
        return total
