"""What one directed link does to one packet.

A rule returns a verdict and moves no time: the caller (`netem.network`) owns ticks and queues. Every draw is
keyed by (seed, purpose, link, sequence number), so that changing one link never shifts another's draws.
"""

from __future__ import annotations

from typing import NamedTuple

from netem.config import Condition, Link
from netem.draws import uniform

# The declared causes of a loss, in the order of the ledger's columns. More come with more of the grammar.
LOSS, DOWN = "loss", "down"
CAUSES: tuple[str, ...] = (LOSS, DOWN)
DELIVERED, IN_FLIGHT = "delivered", "in flight"


class Verdict(NamedTuple):
    """The fate decided at the sending tick: the drawn delay, or the cause of the loss ("" if none)."""

    delay_ns: int
    cause: str


def judge(condition: Condition, seed: int, link: Link, seq: int) -> Verdict:
    """The verdict on packet `seq` of `link`, sent under `condition`.

    Loss is Bernoulli with probability `loss`. Delay is `delay +- jitter`, uniform, rounded to whole ns and
    never negative. Both as in tc-netem(8) without correlation.
    """
    if not condition.up:
        return Verdict(0, DOWN)
    if condition.loss > 0.0 and uniform(seed, "loss", *link, seq) < condition.loss:
        return Verdict(0, LOSS)
    delay_ns = condition.delay_ns
    if condition.jitter_ns:
        spread = 2.0 * uniform(seed, "delay", *link, seq) - 1.0
        delay_ns = max(0, delay_ns + round(spread * condition.jitter_ns))
    return Verdict(delay_ns, "")
