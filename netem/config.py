"""What netem is told before a run: the directed links and the condition of each at the start."""

from __future__ import annotations

from dataclasses import dataclass, field

Link = tuple[int, int]  # (src, dst), vehicle numbers


@dataclass(frozen=True, slots=True)
class Condition:
    """The impairment of one directed link; the default is a perfect link (least latency: one tick)."""

    delay_ns: int = 0
    jitter_ns: int = 0  # uniform in [-jitter, +jitter] around the delay
    loss: float = 0.0  # Bernoulli probability in [0, 1]
    up: bool = True


@dataclass(frozen=True, slots=True)
class NetemConfig:
    """Everything that determines netem's part of a run."""

    seed: int
    tick_ns: int
    round_ticks: int
    vehicles: tuple[int, ...]
    links: tuple[Link, ...]  # (j, i): j's payloads reach i, i.e. a_ij > 0
    conditions: dict[Link, Condition] = field(default_factory=dict)
    ideal: bool = False  # zero latency: due in the sending tick itself (in-process only)
