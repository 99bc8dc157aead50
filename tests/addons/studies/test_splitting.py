"""Splitting against a model with a known answer: a random walk that has to reach a height before its time is over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb, exp
from random import Random

import pytest
from marks import slow

from fleet.addons.studies.row import PartRow
from fleet.addons.studies.splitting import Ask, Splitting, interval

STEPS = 60


def go_on(ask: Ask, until: int, move: Callable[[int, Random], int], most: int, *, frozen: bool = False) -> PartRow:
    """Steps behind the way to where a part begins; the margin is how far below `most` the highest place was, less a
    half. `frozen`: salts change nothing.
    """
    step = at = 0
    for salt, tick in ask.start.way or ():
        draws = Random(0 if frozen else salt)
        while step < tick:
            step, at = step + 1, move(at, draws)
    draws, best, begin = Random(0 if frozen else ask.salt), ask.start.best, step
    places: list[tuple[float, int]] = []
    while step < until:
        step, at = step + 1, move(at, draws)
        if (margin := most - 0.5 - at) < best:
            best = margin
            places.append((best, step))
            if ask.level is not None and best <= ask.level:
                break
    return PartRow(best, places, step - begin)


def either_way(at: int, draws: Random) -> int:
    return at + draws.choice((-1, 1))


def walk(asks: Sequence[Ask], height: int, *, frozen: bool = False) -> list[PartRow]:
    """Walks of +1 or -1."""
    return [go_on(ask, STEPS, either_way, height, frozen=frozen) for ask in asks]


def known(height: int) -> float:
    """P(max of the walk >= height), by reflection: P(end >= height) + P(end > height)."""

    def ends(least: int) -> float:
        return sum(comb(STEPS, (STEPS + end) // 2) for end in range(-STEPS, STEPS + 1, 2) if end >= least) / 2**STEPS

    return ends(height) + ends(height + 1)


@pytest.mark.parametrize(("height", "repeats"), [(8, 20), (24, 20), *slow((32, 25))])
def test_it_estimates_what_is_known(height: int, repeats: int) -> None:
    splitting = Splitting(effort=100)
    levels, _, spread = splitting.levels(lambda asks: walk(asks, height), 1)
    assert spread and list(levels) == sorted(levels, reverse=True) and levels[-1] == 0
    found = [splitting.repeat(lambda asks: walk(asks, height), levels, 100 + n) for n in range(repeats)]
    _, low, high = interval([one.probability for one in found], 0.999)
    assert low < known(height) < high < 5 * known(height)


def losses(asks: Sequence[Ask], most: int) -> list[PartRow]:
    """Rows of losses in a hundred rounds, of which each is lost with 10 %."""
    return [go_on(ask, 100, lambda row, draws: row + 1 if draws.random() < 0.1 else 0, most) for ask in asks]


def in_a_row(most: int) -> float:
    """P(so many losses in a row)."""
    rows = [1.0, *[0.0] * most]
    for _ in range(100):
        lost = [0.0, *(0.1 * p for p in rows[:most])]
        lost[0], lost[most] = 0.9 * sum(rows[:most]), lost[most] + rows[most]
        rows = lost
    return rows[most]


def test_a_margin_with_steps_that_few_paths_get_over() -> None:
    """A tenth of the paths gets over a step, less than a level lets pass."""
    splitting = Splitting(effort=60)
    levels, _, _ = splitting.levels(lambda asks: losses(asks, 8), 1)
    assert len(levels) >= 6
    found = [splitting.repeat(lambda asks: losses(asks, 8), levels, 100 + n).probability for n in range(60)]
    _, low, high = interval(found, 0.999)
    assert low < in_a_row(8) < high < 5 * in_a_row(8)


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


def test_the_interval_of_skewed_estimates_is_shifted_to_where_they_seldom_are() -> None:
    """Lognormal estimates as a rare failure has them. Student's interval holds their mean in 82 % of these cases, since
    it ends too low in 18 %."""
    draws, held, too_low = Random(3), 0, 0
    for _ in range(600):
        _, low, high = interval([draws.lognormvariate(0.0, 1.2) for _ in range(20)])
        held += low <= exp(0.72) <= high
        too_low += high < exp(0.72)
    assert held >= 0.87 * 600 and too_low <= 0.11 * 600


def test_the_interval_of_symmetric_estimates_is_that_of_student() -> None:
    mean, low, high = interval([1.0, 2.0, 3.0, 4.0, 5.0])
    assert (mean, high - mean) == (3.0, pytest.approx(2.776 * 2.5**0.5 / 5**0.5, rel=1e-2))
    assert low == pytest.approx(6.0 - high)
