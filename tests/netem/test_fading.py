"""Fading: its distribution and its correlation, compared with theory."""

from __future__ import annotations

from math import exp, sqrt
from statistics import NormalDist

import numpy as np
import pytest
from samples import samples

from netem.propagation import fading_gain_db

SECOND = 1_000_000_000
COUNT, PACKETS = samples(10_000), samples(100_000)


def test_shadowing_has_the_deviation_and_the_correlation_that_are_asked_for() -> None:
    """Many links: sigma of 6 dB, and a correlation of exp(-(lag/tau)^2) between two times of one link."""
    at = [round(s * SECOND) for s in (100.0, 103.0, 110.0, 125.0)]
    gains = np.array([[fading_gain_db(1, src, 2, t, 6.0, 10 * SECOND, None) for t in at] for src in range(COUNT)])
    assert np.abs(gains.mean(axis=0)).max() < 4 * 6.0 / sqrt(COUNT)
    assert np.abs(gains.std(axis=0) / 6.0 - 1.0).max() < 4 / sqrt(2 * COUNT)
    found = np.corrcoef(gains.T)[0]
    for r, lag in zip(found, (0.0, 3.0, 10.0, 25.0), strict=True):
        assert abs(r - exp(-((lag / 10.0) ** 2))) < 4 / sqrt(COUNT)


def test_shadowing_without_a_correlation_time_stays() -> None:
    assert fading_gain_db(3, 1, 2, 0, 4.0, 0, None) == fading_gain_db(3, 1, 2, 10**12, 4.0, 0, None)
    assert fading_gain_db(3, 1, 2, 0, 4.0, 0, None) != fading_gain_db(3, 2, 1, 0, 4.0, 0, None)


@pytest.mark.parametrize("fade_db", [-20.0, -10.0, -3.0, 0.0, 3.0])
def test_rayleigh_powers_are_exponential(fade_db: float) -> None:
    """The share of packets below a power x is 1 - exp(-x)."""
    gains = _packets(0.0)
    x = 10 ** (fade_db / 10)
    expected = 1 - exp(-x)
    assert abs((gains < fade_db).mean() - expected) < 4 * sqrt(expected * (1 - expected) / gains.size)


def test_rician_powers_have_mean_one_and_the_variance_of_theory() -> None:
    """Of the power: mean 1, variance (1 + 2 K) / (1 + K)^2."""
    for k in (1.0, 4.0, 16.0):
        power = 10 ** (_packets(k) / 10)
        variance = (1 + 2 * k) / (1 + k) ** 2
        assert abs(power.mean() - 1.0) < 4 * sqrt(variance / power.size)
        assert abs(power.var() / variance - 1.0) < 0.05


def test_a_loss_probability_follows_from_shadowing() -> None:
    """A link 5 dB above its threshold with 6 dB of shadowing is below it with probability Phi(-5/6)."""
    gains = np.array([fading_gain_db(2, 1, 2, 40 * SECOND * n, 6.0, SECOND, None) for n in range(COUNT)])
    expected = NormalDist().cdf(-5.0 / 6.0)
    assert abs((gains < -5.0).mean() - expected) < 4 * sqrt(expected * (1 - expected) / COUNT)


_SEEN: dict[float, np.ndarray] = {}


def _packets(k: float) -> np.ndarray:
    if k not in _SEEN:
        _SEEN[k] = np.array([fading_gain_db(7, 1, 2, n * 1000, 0.0, 0, k) for n in range(PACKETS)])
    return _SEEN[k]
