"""Link states: a link is in one of some named states at a time, and each state has a condition of its own.

A state lasts for an exponentially distributed time, so the states of a link are a Markov chain in continuous time.
Loss, delay and rate change together, because they belong to one condition.

| symbol | meaning | unit |
|---|---|---|
| m_i | mean time that state i lasts | ns |
| p_ij | probability that state j follows on state i; p_ii = 0 | 1 |
| q_ij = p_ij / m_i | rate of the transitions from i to j | 1/ns |
| pi_i | share of the time that the chain is in state i: sum_i pi_i q_ij = pi_j / m_j, sum_i pi_i = 1 | 1 |

The chain starts with a state drawn from pi. An exponential time has no memory, so what is left of the first state is
distributed as a whole one, and the chain is stationary from the start. The n-th state and its time are draws with the
key (link, n): what a link is at a time depends neither on its packets nor on those of others.

A run that goes on keeps nothing of the states. It counts again from the start, which takes 8 us per transition. A mean
below one tick is refused, which bounds the number of transitions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import fsum, log1p

from netem.condition import Condition, Link
from netem.draws import pack_numbers, unit

STATE, STAY = "link state", "stay in link state"  # purposes of draws
SHARED = "shared "  # begins the purposes of states that several links share


@dataclass(frozen=True, slots=True)
class LinkStates:
    """The states of a link, or of several links together; every sequence has one entry per state."""

    names: tuple[str, ...]
    conditions: tuple[Condition, ...]
    mean_ns: tuple[int, ...]  # m_i
    following: tuple[tuple[float, ...], ...]  # p_ij
    shares: tuple[float, ...]  # pi_i
    shared: tuple[int, ...] | None = None  # key of the draws of links that share their state; None: the link's own


def stationary(mean: Sequence[float], following: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """The share pi of the time that a chain is in each state; every state must lead to every other in the end.

    By the algorithm of Grassmann, Taksar and Heyman (Operations Research 33, 1985), which never subtracts and so
    keeps its digits however different the times are.

    Args:
        mean: mean time m_i of each state, all in one unit, above 0.
        following: probabilities p_ij, shape (states, states); what is on the diagonal is not looked at.
    """
    count = len(mean)
    q = [[p / mean[i] for p in following[i]] for i in range(count)]
    for k in range(count - 1, 0, -1):
        out = fsum(q[k][:k])
        for i in range(k):
            q[i][k] /= out
            for j in range(k):
                if i != j:
                    q[i][j] += q[i][k] * q[k][j]
    weights = [1.0]
    for k in range(1, count):
        weights.append(fsum(weights[i] * q[i][k] for i in range(k)))
    total = fsum(weights)
    return tuple(weight / total for weight in weights)


class StateProcess:
    """The state of a link as time goes on. Times before the last one may be asked for, but take long."""

    def __init__(self, seed: int, states: LinkStates, link: Link) -> None:
        self._states = states
        self._key = pack_numbers(seed, *(states.shared or link))  # the beginning of the key of all draws
        prefix = SHARED if states.shared else ""
        self._of_state, self._of_stay = prefix + STATE, prefix + STAY
        self._begin_ns = self._end_ns = 0  # when the state that is known begins and ends
        self._restart()

    def state(self, at_ns: int) -> int:
        if at_ns < self._begin_ns:
            self._restart()
        while at_ns >= self._end_ns:
            self._enter(self._number + 1, self._drawn(self._number + 1, self._states.following[self._state]))
        return self._state

    def condition(self, at_ns: int, seq: int) -> Condition:
        return self._states.conditions[self.state(at_ns)]

    def _restart(self) -> None:
        self._end_ns = 0
        self._enter(0, self._drawn(0, self._states.shares))

    def _enter(self, number: int, state: int) -> None:
        u = unit(self._key + pack_numbers(number), self._of_stay)
        self._number, self._state, self._begin_ns = number, state, self._end_ns
        self._end_ns += max(1, round(-self._states.mean_ns[state] * log1p(-u)))

    def _drawn(self, number: int, chances: Sequence[float]) -> int:
        if 1.0 in chances:  # of two states the other follows
            return chances.index(1.0)
        u = unit(self._key + pack_numbers(number), self._of_state)
        last = 0
        for state, chance in enumerate(chances):
            if chance > 0.0:
                if u < chance:
                    return state
                u -= chance
                last = state
        return last
