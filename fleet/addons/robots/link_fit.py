"""`fleet fit`: the link states of a scenario that lose and delay packets as a trace did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fleet.addons.robots.hidden_markov import Array, HiddenMarkov, fit_states
from fleet.errors import FleetError
from fleet.quantities import show_time
from fleet.scenario.sections.trace_table import TraceTable
from netem.condition import Condition
from netem.grammar import print_condition

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
    """Fit states to what a trace says was delivered and how late; rates are means over the packets of each state.
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
    delay = np.array(
        [np.nan if row.delay_ns is None or not row.delivered else row.delay_ns / 1e9 for row in table.rows]
    )
    model, independent = fit_states(lost, delay, count), fit_states(lost, delay, 1)
    generator, lag = _generator(model)
    leave = np.maximum(-np.diag(generator), _FAST)
    mean = [min(_MOST_DAYS_NS, _round_ns(interval / rate)) for rate in leave.tolist()]
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
        delay_ns, jitter_ns = _round_ns(delay, 10**4), _round_ns(jitter, 10**4)
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


def _round_ns(ns: float, least: int = 1) -> int:
    """A time with four significant digits, in steps of `least` ns at least."""
    step: int = max(least, 10 ** max(0, len(str(int(ns))) - 4))
    return round(ns / step) * step


def _percent(follows: dict[str, float], name: str) -> dict[str, str]:
    """Probabilities in percent that sum up to 100 exactly; the largest takes what rounding leaves."""
    hundredths = {other: round(10_000 * p) for other, p in follows.items() if other != name}
    hundredths[max(hundredths, key=hundredths.__getitem__)] += 10_000 - sum(hundredths.values())
    return {other: f"{n / 100:g} %" for other, n in hundredths.items()}
