"""The condition of a directed link: what it does to the packets on it, in the words of tc-netem(8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import msgspec
from msgspec import Struct

Link = tuple[int, int]  # (src, dst), vehicle numbers
Distribution = Literal["uniform", "normal", "pareto", "paretonormal"]
DEFAULT_LIMIT = 1000  # packets, as in tc-netem(8)


class FourState(Struct, frozen=True, tag=True):
    """`loss state`: 1 good in a gap, 2 good in a burst, 3 lost in a burst, 4 lost alone; pXY from X to Y."""

    p13: float
    p31: float
    p32: float = 0.0
    p23: float = 1.0
    p14: float = 0.0


class GilbertElliott(Struct, frozen=True, tag=True):
    """`loss gemodel`: p from good to bad, r back; a packet is lost with `bad` (1-h) and `good` (1-k) in each."""

    p: float
    r: float
    bad: float = 1.0
    good: float = 0.0


@dataclass(frozen=True, slots=True)
class Condition:
    """The impairment of one directed link; the default is a perfect link (least latency: one tick).

    Probabilities and correlations are in [0, 1]. The words are those of tc-netem(8).
    """

    delay_ns: int = 0
    jitter_ns: int = 0  # scale of the distribution round the delay
    loss: float = 0.0
    up: bool = True  # False: nothing passes
    loss_correlation: float = 0.0
    loss_model: FourState | GilbertElliott | None = None  # a model in place of `loss`
    delay_correlation: float = 0.0
    distribution: Distribution = "uniform"
    duplicate: float = 0.0
    duplicate_correlation: float = 0.0
    corrupt: float = 0.0
    corrupt_correlation: float = 0.0
    reorder: float = 0.0
    reorder_correlation: float = 0.0
    gap: int = 0  # with reorder: at least 1
    rate_bit_s: int = 0  # 0: any
    rate_overhead: int = 0  # bytes per packet
    limit: int = DEFAULT_LIMIT
    seed: int | None = None  # seed of this link's draws; None: the scenario's


def condition_values(condition: Condition) -> dict[str, Any]:
    """A condition as plain values; the loss model as [name, values], as the console sends it."""
    values: dict[str, Any] = msgspec.to_builtins(condition)
    if (model := values["loss_model"]) is not None:
        values["loss_model"] = [model.pop("type"), model]
    return values


def condition_from_values(values: dict[str, Any]) -> Condition:
    """Read what `condition_values` has written.

    Raises:
        msgspec.ValidationError: a value does not have the type that is declared for it.
    """
    match values.get("loss_model"):
        case [name, {**model}]:
            values = values | {"loss_model": {"type": name, **model}}
    return msgspec.convert(values, Condition)
