"""How modems measure ranges, as configured; `netem.ranges` measures them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from netem.draws import undecided

Method = Literal["one-way", "two-way"]
NOISE, OUTLIER, EXCESS = "range noise", "range outlier", "range excess"  # purposes of draws


@dataclass(frozen=True, slots=True)
class RangingConfig:
    """How modems measure ranges."""

    method: Method = "one-way"
    noise: float = 0.5  # m, standard deviation
    outliers: float = 0.0  # probability
    excess: float = 0.0  # m, by which an outlier is too long on average
    request: int = 0  # bytes of a request, and of a reply; two-way
    turn_ns: int = 0  # after which the next receiver of the same packet sends its request; two-way


def draws(config: RangingConfig | None) -> list[str]:
    """The purposes of the draws on which measured ranges depend."""
    if config is None:
        return []
    found = [NOISE] if config.noise else []
    if config.outliers:
        found += [OUTLIER, EXCESS] if undecided(config.outliers) else [EXCESS]
    return found
