"""How often something happens whose probability is correlated.

A correlated number x_n = (1 - rho) u_n + rho x_(n-1) lies near 1/2 more often than a uniform one. So x_n < p happens
less often than p says if p is below 1/2, and more often if p is above. In the long run x is (1 - rho) sum_j rho^j
u_j, a sum of independent uniform numbers of the widths a_j = (1 - rho) rho^j. It lies in [0, 1], so its density is
its Fourier series there, and the integral of that series is exact:

    P(x < p) = p + sum_(k >= 1) (-1)^k psi(k) sin(2 pi k p) / (pi k),   psi(k) = prod_j sin(pi k a_j) / (pi k a_j)

The sum ends when what is left is below 1e-12, and after 4096 terms, which only a rho below 0.5 % needs: then the
error is below 3e-5. With rho = 1 nothing ever changes: all or nothing, all with probability p.
"""

from __future__ import annotations

from math import exp, pi, sin
from typing import NamedTuple

from netem.condition import Condition, FourState, GilbertElliott

_TERMS = 4096
_NEGLIGIBLE = 1e-12
_SMALL = 0.1  # below this width the logarithm of sin(z)/z is its first four terms, of z^2, z^4, ...
_SERIES = ((2, 6.0), (4, 180.0), (6, 2835.0), (8, 37800.0))


class Effective(NamedTuple):
    """The share of packets that a condition asks for, and the share that it gets in the long run."""

    word: str
    probability: float
    correlation: float
    share: float


def share_below(p: float, rho: float) -> float:
    """Compute how often a correlated number lies below a bound.

    Args:
        p: the bound, a probability [1].
        rho: correlation of one number with the next [1].

    Returns:
        The share in the long run [1].
    """
    if not 0.0 < p < 1.0 or not 0.0 < rho < 1.0:
        return min(max(p, 0.0), 1.0)
    total = p
    for k in range(1, _TERMS + 1):
        psi, bound = _psi(k, rho)
        total += (-psi if k % 2 else psi) * sin(2.0 * pi * k * p) / (pi * k)
        if bound < _NEGLIGIBLE:
            break
    return min(max(total, 0.0), 1.0)


def _psi(k: int, rho: float) -> tuple[float, float]:
    """psi(k), and a bound of it that never grows with k."""
    width, psi, bound = k * (1.0 - rho), 1.0, 1.0
    while width > _SMALL and bound > _NEGLIGIBLE:
        z = pi * width
        psi *= sin(z) / z
        bound *= min(1.0 / z, exp(-z * z / 6.0) if width < 1.0 else 1.0)
        width *= rho
    rest = exp(-sum((pi * width) ** n / d / (1.0 - rho**n) for n, d in _SERIES))
    return psi * rest, bound * rest


def effective(condition: Condition) -> list[Effective]:
    """List what correlations change.

    Returns:
        Each probability of the condition that a correlation changes, in the order of the grammar.
    """
    c = condition
    asked = [
        ("loss", 0.0 if c.loss_model is not None else c.loss, c.loss_correlation),
        ("duplicate", c.duplicate, c.duplicate_correlation),
        ("corrupt", c.corrupt, c.corrupt_correlation),
        ("reorder", c.reorder, c.reorder_correlation),
    ]
    found = []
    for word, p, rho in asked:
        if 0.0 < p < 1.0 and rho > 0.0:
            share = share_below(p, rho)
            if word == "reorder" and c.gap > 1:  # after each that is sent at once, gap - 1 are not asked
                share /= 1.0 + (c.gap - 1) * share
            found.append(Effective(word, p, rho, share))
    return found


def lost_share(condition: Condition) -> float:
    """Compute how much a condition loses in the long run.

    Returns:
        The share of packets that are lost [1], without those that do not fit into the queue.
    """
    c = condition
    if not c.up:
        return 1.0
    match c.loss_model:
        case None:
            return share_below(c.loss, c.loss_correlation)
        case GilbertElliott() as model:
            bad = model.p / (model.p + model.r) if model.p else 0.0
            return bad * model.bad + (1.0 - bad) * model.good
        case FourState() as model:
            return _four_state_loss(model)


def _four_state_loss(model: FourState) -> float:
    gap, alone = 1.0, model.p14
    if not model.p13:
        burst = lost = 0.0
    elif model.p32 and not model.p23:
        return 0.0  # the model stays where packets of a burst arrive
    elif not model.p31:
        gap = alone = 0.0  # the model never leaves the burst
        lost, burst = 1.0, model.p32 / model.p23 if model.p32 else 0.0
    else:
        lost = model.p13 / model.p31
        burst = lost * model.p32 / model.p23 if model.p32 else 0.0
    return (lost + alone) / (gap + alone + lost + burst)
