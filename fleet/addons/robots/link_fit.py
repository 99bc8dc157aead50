"""`fleet fit`: the link states of a scenario that lose packets as a trace did."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt
from typing import Any

import numpy as np

from fleet.errors import FleetError
from fleet.quantities import show_time
from fleet.scenario.sections.trace_table import TraceTable
from netem.condition import Condition
from netem.grammar import print_condition

# --- hidden markov: hidden Markov models of losses: each hidden state loses packets with a probability of its own
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


NAMES = {1: ("always",), 2: ("good", "bad"), 3: ("good", "fair", "bad")}
LEAST_PACKETS = 20
_MOST_DAYS_NS = 30 * 86_400 * 10**9  # a mean beyond it says that the trace never left the state
_MIXED = 0.01  # below this eigenvalue of A a state is over before the next packet
_FAST = 1e-6  # 1/interval; slower moves are none


@dataclass(frozen=True)
class LinkFit:
    """States fitted to a trace, worst last; `states` holds per state what a scenario needs."""

    lost: Array  # the trace: whether each packet was lost
    interval_ns: int  # between two packets
    uneven: bool  # whether packets came at other distances in time
    model: HiddenMarkov
    independent: HiddenMarkov  # one state, to compare with
    names: tuple[str, ...]
    shares: tuple[float, ...]  # of the time
    mean_ns: tuple[int, ...]
    following: tuple[tuple[float, ...], ...]  # probability of each state to follow, shape (S, S)
    conditions: tuple[Condition, ...]
    lag: float  # by how much a move in one interval differs from the model's where no chain in time fits; 0: it does

    def section(self) -> Any:
        """The entry of `network.links`, in plain values; of one state, its condition alone."""
        if len(self.names) == 1:
            return print_condition(self.conditions[0])
        states: dict[str, Any] = {}
        for name, mean, follows, condition in zip(
            self.names, self.mean_ns, self.following, self.conditions, strict=True
        ):
            states[name] = {"condition": print_condition(condition), "mean": show_time(mean)}
            if len(self.names) > 2:
                states[name]["next"] = _percent(dict(zip(self.names, follows, strict=True)), name)
        return {"states": states}


def runs(flags: Array) -> Array:
    edges = np.flatnonzero(np.diff(np.concatenate([[0.0], flags, [0.0]])))
    lengths: Array = (edges[1::2] - edges[::2]).astype(np.float64)
    return lengths


def fit(table: TraceTable, count: int, interval_ns: int | None = None) -> LinkFit:
    """Fit states to what a trace says was delivered; delays and rates are means over the packets of each state.
    `count`: of states, 1 (one condition) to 3. `interval_ns`: between two packets; None: the median of those in the
    trace. Raises FleetError if the trace does not say what was delivered, or when; it is too short, or its losses come
    alone.
    """
    if "delivered" not in table.columns:
        raise FleetError(f"no such column: delivered, which a fit needs; the trace has {', '.join(table.columns)}")
    lost = np.array([not row.delivered for row in table.rows], np.float64)
    if len(lost) < LEAST_PACKETS or lost.all() or (count > 1 and not lost.any()):
        what = f"{len(lost)} packets, of which {int(lost.sum())} were lost"
        expected = "some lost and some not" if count > 1 else "some of them not lost"
        hint = "; --states 1 takes a trace without losses" if count > 1 and not lost.any() else ""
        raise FleetError(f"expected at least {LEAST_PACKETS} packets, {expected}; got {what}{hint}")
    interval, uneven = (interval_ns, False) if interval_ns is not None else _interval(table)
    model, independent = fit_losses(lost, count), fit_losses(lost, 1)
    generator, lag = _generator(model)
    leave = np.maximum(-np.diag(generator), _FAST)
    mean = [min(_MOST_DAYS_NS, _rounded(interval / rate)) for rate in leave.tolist()]
    following = np.maximum(generator / leave[:, None], 0.0) * (1.0 - np.eye(count))
    following /= np.maximum(following.sum(axis=1, keepdims=True), 1e-12)
    return LinkFit(
        lost, interval, uneven, model, independent, NAMES[count],
        tuple(model.stationary().tolist()), tuple(mean), tuple(map(tuple, following.tolist())),
        _conditions(table, model), lag,
    )  # fmt: skip


def _interval(table: TraceTable) -> tuple[int, bool]:
    """The time between two packets, and whether it is uneven: more than one in ten differs by a tenth. It is the
    median; where most packets share their time with the one before, the mean.
    """
    times = np.array([row.time_ns for row in table.rows if row.time_ns is not None], np.float64)
    if len(times) < 2:
        raise FleetError("the trace has no column time: give the interval between packets, as in --interval '1 s'")
    steps = np.diff(times)
    usual = float(np.median(steps)) or float(np.mean(steps))
    if not usual:
        raise FleetError("all packets have the same time: give the interval between packets, as in --interval '1 s'")
    return max(1, round(usual)), bool(np.mean(np.abs(steps - usual) > 0.1 * usual) > 0.1)


def _generator(model: HiddenMarkov) -> tuple[Array, float]:
    """Rates of moves [1/interval], shape (S, S): log A without negative ones; and how far their exponential is from A.
    Raises FleetError if some state is over before the next packet.
    """
    values, vectors = np.linalg.eig(model.moves)
    if min(value.real for value in values) < _MIXED:
        share = 100.0 * float(model.stationary() @ model.lost)
        raise FleetError(
            f"the losses do not come in bursts that {model.states} states explain: a state ends before the next "
            f"packet; try {'fewer states, or ' if model.states > 2 else ''}--states 1, one condition with loss "
            f"{share:.3g}%"
        )
    raw = ((vectors * np.log(values.astype(complex))) @ np.linalg.inv(vectors)).real
    rates: Array = np.maximum(raw * (1.0 - np.eye(model.states)), 0.0)
    rates -= np.diag(rates.sum(axis=1))
    return rates, float(np.abs(_exponential(rates) - model.moves).max())


def _exponential(rates: Array) -> Array:
    """exp of a matrix of rates, by squaring; what is left of the series is below 1e-16."""
    result: Array = np.eye(len(rates))
    term, small = np.eye(len(rates)), rates / 1024.0
    for n in range(1, 12):
        term = term @ small / n
        result = result + term
    return np.asarray(np.linalg.matrix_power(result, 1024))


def _conditions(table: TraceTable, model: HiddenMarkov) -> tuple[Condition, ...]:
    """The condition of each state: its loss, and the mean of delays and rates, each packet by its probability."""
    columns = {
        "delay": np.array([np.nan if row.delay_ns is None else float(row.delay_ns) for row in table.rows]),
        "rate": np.array([np.nan if row.rate_bit_s is None else float(row.rate_bit_s) for row in table.rows]),
    }
    found = []
    for state in range(model.states):
        delay, jitter = _moments(columns["delay"], model.posterior[:, state])
        rate, _ = _moments(columns["rate"], model.posterior[:, state])
        delay_ns, jitter_ns = _rounded(delay, 10**4), _rounded(jitter, 10**4)
        found.append(
            Condition(
                delay_ns=delay_ns,
                jitter_ns=jitter_ns,
                distribution="normal" if jitter_ns else "uniform",
                loss=round(float(model.lost[state]), 5),
                rate_bit_s=round(rate),
            )
        )
    return tuple(found)


def _moments(values: Array, weights: Array) -> tuple[float, float]:
    """Mean and standard deviation of the values that are known; 0 without any."""
    known = ~np.isnan(values) & (weights > 1e-6)
    if not known.any():
        return 0.0, 0.0
    mean = float(np.average(values[known], weights=weights[known]))
    return mean, float(np.sqrt(np.average((values[known] - mean) ** 2, weights=weights[known])))


def _rounded(ns: float, least: int = 1) -> int:
    """A time with four significant digits, in steps of `least` ns at least."""
    step: int = max(least, 10 ** max(0, len(str(int(ns))) - 4))
    return round(ns / step) * step


def _percent(follows: dict[str, float], name: str) -> dict[str, str]:
    """Probabilities in percent that sum up to 100 exactly; the largest takes what rounding leaves."""
    hundredths = {other: round(10_000 * p) for other, p in follows.items() if other != name}
    hundredths[max(hundredths, key=hundredths.__getitem__)] += 10_000 - sum(hundredths.values())
    return {other: f"{n / 100:g} %" for other, n in hundredths.items()}
