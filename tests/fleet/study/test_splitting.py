"""Splitting against a model with a known answer: a random walk that has to reach a height before its time is over."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb
from random import Random

import pytest

from fleet.study.splitting import Ask, SplitPath, Splitting, interval

STEPS = 60


def walk(asks: Sequence[Ask], height: int, *, frozen: bool = False) -> list[SplitPath]:
    """Walks of +1 or -1; the margin is how far below the height its highest point was, less a half."""
    return [_one(ask, height, frozen=frozen) for ask in asks]


def _one(ask: Ask, height: int, *, frozen: bool) -> SplitPath:
    step, at = (int(part) for part in (ask.start.state or b"0 0").split())
    draws, best, places, begin = Random(0 if frozen else ask.salt), ask.start.best, [], step
    while step < STEPS:
        step, at = step + 1, at + draws.choice((-1, 1))
        if (margin := height - 0.5 - at) < best:
            best = margin
            places.append((best, f"{step} {at}".encode()))
            if ask.level is not None and best <= ask.level:
                break
    return SplitPath(best, places, step - begin)


def known(height: int) -> float:
    """P(max of the walk >= height), by reflection: P(end >= height) + P(end > height)."""

    def ends(least: int) -> float:
        return sum(comb(STEPS, (STEPS + end) // 2) for end in range(-STEPS, STEPS + 1, 2) if end >= least) / 2**STEPS

    return ends(height) + ends(height + 1)


@pytest.mark.parametrize(("height", "repeats"), [(8, 20), (24, 20), (32, 25)])
def test_it_estimates_what_is_known(height: int, repeats: int) -> None:
    splitting = Splitting(effort=100)
    levels, _, spread = splitting.levels(lambda asks: walk(asks, height), 1)
    assert spread and list(levels) == sorted(levels, reverse=True) and levels[-1] == 0
    found = [splitting.repeat(lambda asks: walk(asks, height), levels, 100 + n) for n in range(repeats)]
    _, low, high = interval([one.probability for one in found], 0.999)
    assert low < known(height) < high < 5 * known(height)


def test_it_is_unbiased_even_with_little_effort() -> None:
    found = [
        Splitting(effort=6).repeat(lambda asks: walk(asks, 14), (8.0, 4.0, 0.0), seed).probability
        for seed in range(1200)
    ]
    _, low, high = interval(found, 0.999)
    assert low < known(14) < high and high - low < 0.6 * known(14)


def test_draws_on_the_way_that_change_nothing_are_told() -> None:
    levels, _, spread = Splitting(effort=10).levels(lambda asks: walk(asks, 8, frozen=True), 1)
    assert (levels, spread) == ((0.0,), False)


def test_the_interval_is_that_of_student() -> None:
    mean, low, high = interval([1.0, 2.0, 3.0, 4.0, 5.0])
    assert (mean, high - mean) == (3.0, pytest.approx(2.776 * 2.5**0.5 / 5**0.5, rel=1e-2))
    assert low == pytest.approx(6.0 - high)
