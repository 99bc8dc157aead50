"""How modems measure ranges, as configured; `netem.ranges` measures them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Method = Literal["one-way", "two-way"]


@dataclass(frozen=True, slots=True)
class RangingConfig:
    """How modems measure ranges."""

    method: Method = "one-way"
    noise: float = 0.5  # m, standard deviation
    outliers: float = 0.0  # probability
    excess: float = 0.0  # m, by which an outlier is too long on average
    request: int = 0  # bytes of a request, and of a reply; two-way
    turn_ns: int = 0  # after which the next receiver of the same packet sends its request; two-way
