"""Hidden Markov models of a link: each hidden state has a probability of loss, and a delay, of its own.

With two states and losses alone this is the model of Gilbert (1960) and Elliott (1963). The parameters are fitted by
expectation maximisation (Baum and Welch; L. R. Rabiner, Proceedings of the IEEE 77, 1989, equations 37 to 40).

| symbol | meaning | shape |
|---|---|---|
| N, S | packets, states | |
| y_n | whether packet n was lost | (N,) |
| d_n | delay of packet n; nan: not known, as of one that was lost | (N,) |
| A | A_ij: probability that the next packet meets state j, after one in state i | (S, S) |
| e | probability that a packet is lost in each state | (S,) |
| mu, sd | mean and standard deviation of the delay in each state | (S,) |
| b_ni | probability (density) of what is known of packet n in state i | (N, S) |
| pi | distribution of the state one packet before the first | (S,) |
| gamma_ni | probability of state i at packet n, given all packets | (N, S) |

Delays must take part: found by losses alone, states mix packets of both, and the long delays of a bad state are
averaged away. The delay of a state is normal, as that of the condition is; a heavy tail takes a state of its own.

The recursions run over blocks of about sqrt(N) packets. A block maps the distribution before it to the one after it
by a matrix. So all blocks advance together, and only their matrices are applied one after the other. (hmmlearn has
neither this mixed emission nor missing values: we should write all but the recursions, and need scikit-learn.)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt, sqrt
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
_FIRST_STEPS, _MOST_STEPS = 30, 500  # from every place where the search begins; from the best of them
_ENOUGH = 1e-4  # of the logarithm of the likelihood: a step that gains less is the last
_LEAST = 1e-9  # of every probability, so that no state dies while it is looked for
_NARROWEST = 0.01  # sd of a state, of that of all packets: equal delays would have an endless density
# Where the search begins: the probability to stay in a state, and by which factors states lose less or more than all.
_STAYS = (0.8, 0.95, 0.99)
_FACTORS = {1: ((1.0,),), 2: ((0.2, 2.0), (0.5, 5.0)), 3: ((0.1, 1.0, 3.0), (0.2, 1.5, 8.0))}


class _Delays(NamedTuple):
    """Normal delays of each state."""

    mean: Array  # mu
    sd: Array


@dataclass(frozen=True)
class HiddenMarkov:
    """A fitted model; states in the order of their losses."""

    moves: Array  # A
    lost: Array  # e
    first: Array  # pi
    delays: _Delays | None  # None: no packet has a delay
    log_likelihood: float
    posterior: Array  # gamma

    @property
    def states(self) -> int:
        return len(self.lost)

    @property
    def bic(self) -> float:
        """The information criterion of Bayes and Schwarz: the less, the better."""
        parameters = self.states * self.states if self.states > 1 else 1  # losses, and S - 1 moves of each state
        parameters += 0 if self.delays is None else 2 * self.states
        return parameters * float(np.log(len(self.posterior))) - 2.0 * self.log_likelihood

    def stationary(self) -> Array:
        """The share of packets that meets each state in the long run, shape (S,)."""
        count = self.states
        equations = np.vstack([self.moves.T - np.eye(count), np.ones(count)])
        shares: Array = np.linalg.lstsq(equations, np.append(np.zeros(count), 1.0), rcond=None)[0]
        return shares

    def bursts(self, longest: int) -> tuple[Array, float]:
        """P(a burst of losses has n or more packets), n = 1 ... longest, and the mean length of bursts."""
        return self._runs(self.lost, longest)

    def gaps(self, longest: int) -> tuple[Array, float]:
        """The same of the packets delivered between two bursts."""
        return self._runs(1.0 - self.lost, longest)

    def _runs(self, inside: Array, longest: int) -> tuple[Array, float]:
        """Lengths of runs of what has the probability `inside`: v_1 begins a run, v_(n+1) = v_n A diag(inside)."""
        v = (self.stationary() * (1.0 - inside)) @ self.moves * inside
        v = v / v.sum()
        step = self.moves * inside
        mean = float(np.linalg.solve((np.eye(self.states) - step).T, v).sum())
        survival = np.empty(longest)
        for n in range(longest):
            survival[n] = v.sum()
            v = v @ step
        return survival, mean


def fit_states(lost: Array, delay: Array, states: int) -> HiddenMarkov:
    """Fit the model with the largest likelihood that the search finds from a few fixed places.

    Args:
        lost: whether each packet was lost, shape (N,), N >= 1; some were and not all.
        delay: of each packet, shape (N,), in any unit; nan where it is not known.
        states: 1 (independent losses), 2 or 3.
    """
    known = ~np.isnan(delay)
    places = [
        (*_begin(lost, stay, factors), delays)
        for factors in _FACTORS[states]
        for stay in _STAYS
        for delays in (_split(delay[known], states) if known.any() else [None])
    ]
    found = [_improve(lost, delay, *place, _FIRST_STEPS) for place in places]
    best = max(found, key=lambda model: model.log_likelihood)
    best = _improve(lost, delay, best.moves, best.lost, best.first, best.delays, _MOST_STEPS)
    order = np.argsort(best.lost, kind="stable")
    moves, posterior = best.moves[np.ix_(order, order)], best.posterior[:, order]
    delays = best.delays and _Delays(best.delays.mean[order], best.delays.sd[order])
    return HiddenMarkov(moves, best.lost[order], best.first[order], delays, best.log_likelihood, posterior)


def _begin(lost: Array, stay: float, factors: tuple[float, ...]) -> tuple[Array, Array, Array]:
    """A place where the search begins: A, e, pi."""
    count = len(factors)
    leave = (1.0 - stay) / max(1, count - 1)
    moves = np.full((count, count), leave) + np.eye(count) * (1.0 - count * leave)
    return moves, np.clip(np.mean(lost) * np.array(factors), 1e-3, 0.95), np.full(count, 1.0 / count)


def _split(known: Array, states: int) -> list[_Delays]:
    """Where the search begins for delays: all alike, so that losses decide; long where much is lost, or little."""
    spread = float(np.std(known))
    alike = _Delays(np.full(states, np.mean(known)), np.full(states, spread or 1.0))
    if states == 1 or not spread:
        return [alike]
    rising = np.quantile(known, (np.arange(states) + 0.5) / states)
    return [alike, *(_Delays(mean, np.full(states, spread / states)) for mean in (rising, rising[::-1]))]


def _improve(
    lost: Array, delay: Array, moves: Array, loses: Array, first: Array, delays: _Delays | None, steps: int
) -> HiddenMarkov:
    known = ~np.isnan(delay)
    narrowest = _NARROWEST * (float(np.std(delay[known])) or 1.0) if known.any() else 0.0
    before = -np.inf
    for step in range(steps + 1):
        told = _emission(lost, delay, loses, delays)
        likelihood, first_after, posterior, pairs = _expect(told, moves, first)
        if likelihood - before < _ENOUGH or step == steps:
            break
        before = likelihood
        moves = _normalise(pairs)
        loses = np.clip(lost @ posterior / posterior.sum(axis=0), _LEAST, 1.0 - _LEAST)
        first = _normalise(first_after)
        if delays is not None:
            delays = _delays(delay[known], posterior[known], narrowest)
    return HiddenMarkov(moves, loses, first, delays, likelihood, posterior)


def _emission(lost: Array, delay: Array, loses: Array, delays: _Delays | None) -> Array:
    """b, shape (N, S)."""
    told: Array = np.where(lost[:, None] > 0.5, loses, 1.0 - loses)
    if delays is not None:
        off = (delay[:, None] - delays.mean) / delays.sd
        # A delay that fits no state must not end the search, and may not choose one by what is left of a rounded zero.
        density = np.exp(-0.5 * np.minimum(off * off, 600.0)) / (delays.sd * sqrt(2.0 * np.pi))
        told = told * np.where(np.isnan(delay)[:, None], 1.0, density)
    return told


def _delays(known: Array, weights: Array, narrowest: float) -> _Delays:
    """The delays of each state: moments of the known ones, each by its probability, weights of shape (known, S)."""
    weights = weights + _LEAST
    mean = known @ weights / weights.sum(axis=0)
    variance = ((known[:, None] - mean) ** 2 * weights).sum(axis=0) / weights.sum(axis=0)
    return _Delays(mean, np.maximum(np.sqrt(variance), narrowest))


def _normalise(weights: Array) -> Array:
    raised = np.maximum(weights, _LEAST)
    normalised: Array = raised / raised.sum(axis=-1, keepdims=True)
    return normalised


def _expect(b: Array, moves: Array, first: Array) -> tuple[float, Array, Array, Array]:
    """Logarithm of the likelihood, gamma before the first packet, gamma, and how often i moves to j, shape (S, S)."""
    total, count = b.shape
    length = isqrt(total - 1) + 1
    blocks = -(-total // length)
    told = np.ones((blocks * length, count))  # what is behind the last packet tells nothing
    told[:total] = b
    emits = told.reshape(blocks, length, count).swapaxes(0, 1)  # (length, blocks, S)

    product = np.tile(np.eye(count), (blocks, 1, 1))  # what each block makes of what is before it
    for n in range(length):
        product = (product @ moves) * emits[n][:, None, :]
        product /= product.sum(axis=(1, 2), keepdims=True)
    entering = np.empty((blocks, count))
    entering[0] = first
    for k in range(1, blocks):
        entering[k] = entering[k - 1] @ product[k - 1]
        entering[k] /= entering[k].sum()
    leaving = np.empty((blocks, count))  # probability of all that follows on a block
    leaving[-1] = 1.0
    for k in range(blocks - 1, 0, -1):
        leaving[k - 1] = product[k] @ leaving[k]
        leaving[k - 1] /= leaving[k - 1].sum()

    forward, scales, backward = np.empty(emits.shape), np.empty((length, blocks)), np.empty(emits.shape)
    state = entering
    for n in range(length):
        state = (state @ moves) * emits[n]
        scales[n] = state.sum(axis=1)
        state = state / scales[n][:, None]
        forward[n] = state
    state = leaving
    for n in range(length - 1, -1, -1):
        backward[n] = state
        state = (state * emits[n]) @ moves.T
        state = state / state.sum(axis=1, keepdims=True)
    return _statistics(moves, first, forward, backward, emits, scales, total)


def _statistics(
    moves: Array, first: Array, forward: Array, backward: Array, emits: Array, scales: Array, total: int
) -> tuple[float, Array, Array, Array]:
    """The values of `_expect`, from the recursions in blocks, shapes (length, blocks, S)."""
    count = len(moves)
    alpha, beta, told = (a.swapaxes(0, 1).reshape(-1, count)[:total] for a in (forward, backward, emits))
    posterior = alpha * beta
    posterior = posterior / posterior.sum(axis=1, keepdims=True)
    before, after = np.vstack([first, alpha[:-1]]), beta * told
    weights = np.einsum("ni,ij,nj->n", before, moves, after)
    pairs = moves * ((before / weights[:, None]).T @ after)
    began = first * (moves @ after[0])
    likelihood = float(np.log(scales.swapaxes(0, 1).reshape(-1)[:total]).sum())
    return likelihood, began / began.sum(), posterior, pairs
