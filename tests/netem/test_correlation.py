"""How often a correlated chance comes true, against closed forms and against a hundred thousand packets."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.condition import Condition, GilbertElliott
from netem.correlation import effective, share_below
from netem.impairment import LinkModel

PACKETS = 100_000


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_distribution_function(p: float, more: float, rho: float) -> None:
    """Symmetric about 1/2, rising, and exact at the ends and without a correlation."""
    share = share_below(p, rho)
    assert 0.0 <= share <= share_below(max(p, more), rho) + 1e-4
    assert share + share_below(1.0 - p, rho) == pytest.approx(1.0, abs=1e-9)
    assert share_below(p, 0.0) == share_below(p, 1.0) == p
    assert share_below(0.0, rho) == 0.0 and share_below(1.0, rho) == 1.0


def test_closed_forms() -> None:
    """With rho = 1/2 it is the distribution function of sum_j 2^-j u_j, which is the Fabius function."""
    for p, value in ((1 / 2, 1 / 2), (1 / 4, 5 / 72), (1 / 8, 1 / 288), (1 / 16, 143 / 2073600)):
        assert share_below(p, 0.5) == pytest.approx(value, abs=1e-10)
    # x has variance (1 - rho) / (1 + rho) / 12, and tends to a normal number as rho tends to 1.
    rho, z = 0.9999, 1.0
    sd = math.sqrt((1 - rho) / (1 + rho) / 12)
    assert share_below(0.5 + z * sd, rho) == pytest.approx(0.841345, abs=1e-4)


@pytest.mark.parametrize(
    ("condition", "cause"),
    [
        (Condition(loss=0.1, loss_correlation=0.25), "loss"),
        (Condition(loss=0.1, loss_correlation=0.5), "loss"),
        (Condition(loss=0.8, loss_correlation=0.5), "loss"),
        (Condition(10**6, reorder=0.25, reorder_correlation=0.5, gap=1), "reorder"),
        (Condition(10**6, reorder=0.4, reorder_correlation=0.25, gap=5), "reorder"),
        (Condition(corrupt=0.3, corrupt_correlation=0.25), "corrupt"),
        (Condition(duplicate=0.2, duplicate_correlation=0.1), "duplicate"),
    ],
)
def test_a_hundred_thousand_packets(condition: Condition, cause: str) -> None:
    (said,) = effective(condition)
    model = LinkModel(condition, 1, (1, 2))
    count = 0
    for k in range(PACKETS):
        verdicts = model.enter(k * 10**9, k, b"x")
        first = verdicts[0]
        count += {
            "loss": first.cause == "loss",
            "reorder": first.delay_ns == 0,
            "corrupt": first.corrupted,
            "duplicate": len(verdicts) == 2,
        }[cause]
    rho = said.correlation
    error = math.sqrt(said.share * (1.0 - said.share) / PACKETS * (1.0 + rho) / (1.0 - rho))
    assert said.word == cause and abs(said.share - said.probability) > 20 * error
    assert abs(count / PACKETS - said.share) < 3 * error


def test_only_what_a_correlation_changes_is_said() -> None:
    assert effective(Condition(loss=0.1, duplicate=0.2, loss_model=None)) == []
    assert effective(Condition(loss=1.0, loss_correlation=0.5)) == []
    assert effective(Condition(loss_correlation=0.5, loss=0.1, loss_model=GilbertElliott(0.1, 0.5))) == []
    two = Condition(loss=0.1, loss_correlation=0.25, corrupt=0.5, corrupt_correlation=0.25)
    assert [(e.word, round(e.share, 4)) for e in effective(two)] == [("loss", 0.0175), ("corrupt", 0.5)]
