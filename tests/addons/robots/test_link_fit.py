"""Fits of link states: the recursions against plain sums, and parameters that made a trace against those found."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import log
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenario import small
from tool import invoke

from fleet.addons.robots import link_fit
from fleet.addons.robots.hidden_markov import _expect, fit_states
from fleet.addons.robots.verbs.fit import fit_lines
from fleet.errors import FleetError
from fleet.scenario.sections.trace_table import TraceRow, TraceTable, read_csv
from fleet.scenario.text.yaml_reader import Source, plain, read
from fleet.scenario.text.yaml_writer import inline
from netem.condition import Condition
from netem.grammar import print_condition
from netem.link_states import LinkStates, StateProcess

pytestmark = pytest.mark.usefixtures("coarse")

SECOND = 10**9


def trace_of(states: LinkStates, packets: int, every_ns: int = SECOND // 2) -> TraceTable:
    """A trace that such states made."""
    process, rng = StateProcess(1, states, (1, 2)), np.random.default_rng(1)
    rows = []
    for n in range(packets):
        condition = process.condition(n * every_ns, n)
        lost = bool(rng.random() < condition.loss)
        rows.append(TraceRow(n * every_ns, not lost, None if lost else condition.delay_ns))
    return TraceTable(("time", "delivered", "delay"), tuple(rows))


def states_of(section: dict) -> LinkStates:
    return small(f"network.links={inline({'*': section})}").netem_config.changing[1, 2]


def inline_states(good: str, bad: str) -> dict:
    """A good state of 8 s and a bad one of 2 s."""
    return {"states": {"good": {"condition": good, "mean": "8 s"}, "bad": {"condition": bad, "mean": "2 s"}}}


TWO = {"states": {"good": {"condition": "loss 2% delay 50ms", "mean": "8 s"},
                  "bad": {"condition": "loss 80% delay 400ms", "mean": "3 s"}}}  # fmt: skip
THREE = {
    "states": {
        "good": {"condition": "loss 1%", "mean": "60 s", "next": {"fair": "90 %", "bad": "10 %"}},
        "fair": {"condition": "loss 30%", "mean": "20 s", "next": {"good": "50 %", "bad": "50 %"}},
        "bad": {"condition": "loss 95%", "mean": "10 s", "next": {"fair": "100 %"}},
    }
}


@pytest.mark.parametrize("packets", [1, 2, 3, 7])
def test_the_recursions_are_the_sums_over_all_paths(packets: int) -> None:
    """Likelihood, posteriors and moves of a chain that is short enough to sum over every sequence of its states."""
    lost = np.array([1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0])[:packets]
    moves, loses, first = np.array([[0.9, 0.1], [0.3, 0.7]]), np.array([0.1, 0.8]), np.array([0.6, 0.4])
    posterior, pairs, total = np.zeros((packets + 1, 2)), np.zeros((2, 2)), 0.0
    for path in product((0, 1), repeat=packets + 1):
        p = first[path[0]]
        for n, y in enumerate(lost):
            p *= moves[path[n], path[n + 1]] * (loses[path[n + 1]] if y else 1.0 - loses[path[n + 1]])
        total += p
        for n, state in enumerate(path):
            posterior[n, state] += p
        for n in range(packets):
            pairs[path[n], path[n + 1]] += p
    found = _expect(np.where(lost[:, None] > 0.5, loses, 1.0 - loses), moves, first)
    assert found[0] == pytest.approx(log(total))
    np.testing.assert_allclose(found[1], posterior[0] / total)
    np.testing.assert_allclose(found[2], posterior[1:] / total)
    np.testing.assert_allclose(found[3], pairs / total)


def test_two_states_are_found_again_and_the_entry_can_be_pasted() -> None:
    """10,000 packets, one every 0.5 s; tolerances of about four standard errors of 450 cycles."""
    found = link_fit.fit(trace_of(states_of(TWO), 10_000), 2)
    assert found.names == ("good", "bad")
    assert found.interval_ns == SECOND // 2
    assert not found.uneven
    assert found.mean_ns == pytest.approx((8e9, 3e9), rel=0.2)
    assert [c.loss for c in found.conditions] == pytest.approx([0.02, 0.8], abs=0.03)
    assert found.model.log_likelihood > found.independent.log_likelihood + 500
    assert found.model.bic < found.independent.bic
    bursts = link_fit.runs(found.lost)
    assert found.model.bursts(1)[1] == pytest.approx(bursts.mean(), rel=0.05)
    assert found.model.gaps(1)[1] == pytest.approx(link_fit.runs(1.0 - found.lost).mean(), rel=0.05)
    pasted = states_of(found.section())
    assert pasted.mean_ns == found.mean_ns
    assert pasted.conditions == found.conditions


def test_delays_carry_over_with_their_tail() -> None:
    """States that overlap in what they lose differ by their delays: the spreads that were put in come out, and the
    delay that one packet in twenty exceeds is that of the trace. By losses alone it was 256 ms for 357 ms."""
    two = inline_states("delay 80ms 15ms distribution normal loss 2%", "delay 400ms 60ms distribution normal loss 75%")
    states, rng = states_of(two), np.random.default_rng(1)
    process, rows = StateProcess(1, states, (1, 2)), []
    for n in range(10_000):
        c = process.condition(n * SECOND // 10, n)
        lost, delay = rng.random() < c.loss, max(0.0, rng.normal(c.delay_ns, c.jitter_ns))
        rows.append(TraceRow(n * SECOND // 10, not lost, None if lost else int(delay)))
    found = link_fit.fit(TraceTable(("time", "delivered", "delay"), tuple(rows)), 2)
    assert [c.jitter_ns / 1e6 for c in found.conditions] == pytest.approx([15, 60], rel=0.1)
    assert [c.delay_ns / 1e6 for c in found.conditions] == pytest.approx([80, 400], rel=0.03)
    measured = np.quantile([row.delay_ns / 1e6 for row in rows if row.delay_ns is not None], 0.95)
    share = np.array([p * (1 - c.loss) for p, c in zip(found.shares, found.conditions, strict=True)])
    bad = rng.random(100_000) < share[1] / share.sum()
    drawn = [rng.normal(c.delay_ns, c.jitter_ns, 100_000) / 1e6 for c in found.conditions]
    assert np.quantile(np.where(bad, drawn[1], drawn[0]), 0.95) == pytest.approx(measured, rel=0.05)


@pytest.mark.parametrize("delay", ["7", "inf", "1e300"])
def test_delays_that_are_equal_or_huge_are_fitted(delay: str) -> None:
    rows = "".join(f"{n},{int(n % 20 < 12)},{delay if n % 20 < 12 else ''}\n" for n in range(400))
    try:
        found = link_fit.fit(read_csv("time [s],delivered,delay [ms]\n" + rows, "t.csv"), 2)
    except FleetError:
        return  # the reader refuses it
    assert found.conditions[0].delay_ns == 7_000_000


@pytest.mark.slow  # as two states
def test_three_states_are_found_again() -> None:
    found = link_fit.fit(trace_of(states_of(THREE), 6_000, 2 * SECOND), 3)
    assert found.lag < 0.01
    assert [c.loss for c in found.conditions] == pytest.approx([0.01, 0.3, 0.95], abs=0.05)
    assert found.mean_ns == pytest.approx((60e9, 20e9, 10e9), rel=0.35)
    pasted = states_of(found.section())
    assert pasted.shares == pytest.approx(found.shares, abs=0.02)
    assert sum(round(100 * p, 2) for p in pasted.following[0]) == pytest.approx(100)


def test_bursts_of_independent_losses() -> None:
    """One state: a burst has n or more packets with probability p^(n-1), and 1 / (1 - p) on average."""
    lost = (np.random.default_rng(2).random(2_000) < 0.3).astype(float)
    model, p = fit_states(lost, np.full(2_000, np.nan), 1), lost.mean()
    survival, mean = model.bursts(4)
    np.testing.assert_allclose(survival, p ** np.arange(4))
    assert mean == pytest.approx(1 / (1 - p))
    assert model.log_likelihood == pytest.approx(len(lost) * (p * log(p) + (1 - p) * log(1 - p)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time [s],delay [ms]\n" + "0,1\n" * 30, "no such column: delivered"),
        ("time [s],delivered\n" + "0,1\n" * 30, "some lost and some not; got 30 packets, of which 0 were lost"),
        ("time [s],delivered\n0,1\n1,0\n", "at least 20 packets"),
        ("delivered\n" + "0\n0\n1\n1\n" * 10, "--interval"),
        ("time [s],delivered\n" + "0,0\n0,0\n0,1\n0,1\n" * 10, "all packets have the same time"),
        ("time [s],delivered\n" + "".join(f"{n},{n % 2}\n" for n in range(60)), "losses do not come in bursts"),
    ],
)
def test_what_cannot_be_fitted_says_why(text: str, words: str) -> None:
    with pytest.raises(FleetError, match=words):
        link_fit.fit(read_csv(text, "t.csv"), 2)


@given(st.floats(0.0, 0.9), st.integers(0, 10**6))
def test_one_state_is_one_condition_also_without_losses(share: float, seed: int) -> None:
    lost = np.random.default_rng(seed).random(200) < share
    rows = "".join(f"{n},{int(not gone)},{'' if gone else 7}\n" for n, gone in enumerate(lost))
    if not lost.all():
        found = link_fit.fit(read_csv("time [s],delivered,delay [ms]\n" + rows, "t.csv"), 1)
        assert found.section() == print_condition(Condition(delay_ns=7_000_000, loss=round(float(lost.mean()), 5)))
        assert fit_lines(found, Path("t.csv"))[0].endswith(f"{100 * lost.mean():.3g} % lost")


def test_a_fit_that_is_not_exact_says_by_how_much() -> None:
    found = replace(link_fit.fit(trace_of(states_of(TWO), 200), 2), lag=0.03)
    assert "differ by up to 3 %; try" in fit_lines(found, Path("t.csv"))[-1]


def test_on_the_command_line(tmp_path: Path) -> None:
    """YAML on stdout, which a scenario takes; the rest on stderr; a picture with the same bytes each time."""
    trace = tmp_path / "modem-log.csv"
    trace.write_text(trace_of(states_of(TWO), 1_000).text())
    pictures = [tmp_path / "a.png", tmp_path / "b.png"]
    results = [invoke("fit", trace, "--picture", path) for path in pictures]
    assert results[0].exit_code == 0, results[0].output
    assert pictures[0].read_bytes() == pictures[1].read_bytes() and results[0].stdout == results[1].stdout
    network = plain(read(Source("y", results[0].stdout))[0])
    assert isinstance(states_of(network["network"]["links"]["*"]).conditions[0], Condition)
    for words in ("1000 packets, one every 0.5 s", "log-likelihood", "mean burst of losses", "bad:"):
        assert words in results[0].stderr
    failed = invoke("fit", trace, "--picture", "x.txt")
    assert failed.exit_code == 2 and "ends in one of" in failed.output
