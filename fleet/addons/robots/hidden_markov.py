"""Hidden Markov models of losses: each hidden state loses packets with a probability of its own."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt
from typing import Any

import numpy as np

# With two states this is the model of Gilbert (1960) and Elliott (1963). The parameters are fitted by expectation
# maximisation (Baum and Welch; L. R. Rabiner, Proceedings of the IEEE 77, 1989, equations 37 to 40).
#
# | symbol | meaning | shape |
# |---|---|---|
# | N, S | packets, states | |
# | y_n | whether packet n was lost | (N,) |
# | A | A_ij: probability that the next packet meets state j, after one in state i | (S, S) |
# | e | probability that a packet is lost in each state | (S,) |
# | pi | distribution of the state one packet before the first | (S,) |
# | gamma_ni | probability of state i at packet n, given all packets | (N, S) |
#
# The recursions run over blocks of about sqrt(N) packets. A block maps the distribution before it to the one after it
# by a matrix. So all blocks advance together, and only their matrices are applied one after the other.


Array = np.ndarray[Any, np.dtype[np.float64]]
_FIRST_STEPS, _MOST_STEPS = 30, 500  # from every place where the search begins; from the best of them
_ENOUGH = 1e-4  # of the logarithm of the likelihood: a step that gains less is the last
_LEAST = 1e-9  # of every probability, so that no state dies while it is looked for
# Where the search begins: the probability to stay in a state, and by which factors states lose less or more than all.
_STAYS = (0.8, 0.95, 0.99)
_FACTORS = {1: ((1.0,),), 2: ((0.2, 2.0), (0.5, 5.0)), 3: ((0.1, 1.0, 3.0), (0.2, 1.5, 8.0))}


@dataclass(frozen=True)
class HiddenMarkov:
    """A fitted model; states in the order of their losses."""

    moves: Array  # A
    lost: Array  # e
    first: Array  # pi
    log_likelihood: float
    posterior: Array  # gamma

    @property
    def states(self) -> int:
        return len(self.lost)

    @property
    def bic(self) -> float:
        """The information criterion of Bayes and Schwarz: the less, the better."""
        parameters = self.states * self.states if self.states > 1 else 1  # losses, and S - 1 moves of each state
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


def fit_losses(lost: Array, states: int) -> HiddenMarkov:
    """The model of 1 (independent losses), 2 or 3 states with the largest likelihood that the search finds from a few
    fixed places. `lost`: of each packet, shape (N,), N >= 1; some and not all.
    """
    places = [_begin(lost, stay, factors) for factors in _FACTORS[states] for stay in _STAYS]
    found = [_improve(lost, *place, _FIRST_STEPS) for place in places]
    best = max(found, key=lambda model: model.log_likelihood)
    best = _improve(lost, best.moves, best.lost, best.first, _MOST_STEPS)
    order = np.argsort(best.lost, kind="stable")
    moves, posterior = best.moves[np.ix_(order, order)], best.posterior[:, order]
    return HiddenMarkov(moves, best.lost[order], best.first[order], best.log_likelihood, posterior)


def _begin(lost: Array, stay: float, factors: tuple[float, ...]) -> tuple[Array, Array, Array]:
    """A place where the search begins: A, e, pi."""
    count = len(factors)
    leave = (1.0 - stay) / max(1, count - 1)
    moves = np.full((count, count), leave) + np.eye(count) * (1.0 - count * leave)
    return moves, np.clip(np.mean(lost) * np.array(factors), 1e-3, 0.95), np.full(count, 1.0 / count)


def _improve(lost: Array, moves: Array, loses: Array, first: Array, steps: int) -> HiddenMarkov:
    before = -np.inf
    for step in range(steps + 1):
        likelihood, first_after, posterior, pairs = _expect(lost, moves, loses, first)
        if likelihood - before < _ENOUGH or step == steps:
            break
        before = likelihood
        moves = _normalised(pairs)
        loses = np.clip(lost @ posterior / posterior.sum(axis=0), _LEAST, 1.0 - _LEAST)
        first = _normalised(first_after)
    return HiddenMarkov(moves, loses, first, likelihood, posterior)


def _normalised(weights: Array) -> Array:
    raised = np.maximum(weights, _LEAST)
    normalised: Array = raised / raised.sum(axis=-1, keepdims=True)
    return normalised


def _expect(lost: Array, moves: Array, loses: Array, first: Array) -> tuple[float, Array, Array, Array]:
    """Logarithm of the likelihood, gamma before the first packet, gamma, and how often i moves to j, shape (S, S)."""
    total, count = len(lost), len(loses)
    length = isqrt(total - 1) + 1
    blocks = -(-total // length)
    told = np.ones((blocks * length, count))  # what is behind the last packet tells nothing
    told[:total] = np.where(lost[:, None] > 0.5, loses, 1.0 - loses)
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
