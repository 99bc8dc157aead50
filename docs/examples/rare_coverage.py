"""How often does the interval of `fleet rare` hold the true probability?

    python docs/examples/rare_coverage.py          # the table of docs/background/rare-figures.md; five minutes
    python docs/examples/rare_coverage.py --quick  # fewer repeats

A random walk of 60 steps has to reach a height; the probability is known by reflection. A row makes many independent
repeats of splitting, then draws groups of them, and counts the groups whose 95 % interval holds the probability. For
comparison the same is done with Student's interval.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from math import comb, sqrt
from random import Random
from statistics import NormalDist, fmean, stdev

from fleet.addons.studies.row import PartRow
from fleet.addons.studies.splitting import Ask, Splitting, interval

STEPS = 60
CASES = ((16, 100), (24, 100), (24, 40), (32, 100), (32, 40))  # height, effort
GROUPS = 2000
STUDENT = {8: 2.365, 20: 2.093, 50: 2.010, 100: 1.984}  # 97.5 % quantile, by the number of repeats


def walk(height: int, asks: Sequence[Ask]) -> list[PartRow]:
    """Walks of +1 or -1; the margin is how far below `height` the highest place was, less a half."""
    rows = []
    for ask in asks:
        step, at = (int(part) for part in (ask.start.state or b"0 0").split())
        begin, bits = step, Random(ask.salt).getrandbits(STEPS)
        best, places = ask.start.best, list[tuple[float, bytes]]()
        while step < STEPS:
            at += 1 if bits >> step & 1 else -1
            step += 1
            if height - 0.5 - at < best:
                best = height - 0.5 - at
                places.append((best, b"%d %d" % (step, at)))
                if ask.level is not None and best <= ask.level:
                    break
        rows.append(PartRow(best, places, step - begin))
    return rows


def known(height: int) -> float:
    """The probability that the walk reaches a height."""

    def ends(least: int) -> float:
        return sum(comb(STEPS, (STEPS + end) // 2) for end in range(-STEPS, STEPS + 1, 2) if end >= least) / 2**STEPS

    return ends(height) + ends(height + 1)


def student(estimates: Sequence[float], quantile: float) -> tuple[float, float]:
    half = quantile * stdev(estimates) / sqrt(len(estimates))
    return fmean(estimates) - half, fmean(estimates) + half


def share(hits: int) -> str:
    """A share of the groups in %, and half of its 95 % interval."""
    rate = hits / GROUPS
    return f"{100 * rate:.1f} ± {100 * NormalDist().inv_cdf(0.975) * sqrt(rate * (1 - rate) / GROUPS):.1f} %"


def main(repeats: int) -> None:
    print("| probability | effort | spread | repeats | held | too low | too high | Student's held |")
    print("|---|---|---|---|---|---|---|---|")
    for height, effort in CASES:
        make, true, splitting, draws = partial(walk, height), known(height), Splitting(effort), Random(1)
        levels, _, _ = splitting.levels(make, 0)
        pool = [splitting.repeat(make, levels, 1 + n).probability for n in range(repeats)]
        for size, quantile in STUDENT.items():
            too_low = too_high = student_held = 0
            for _ in range(GROUPS):
                group = draws.choices(pool, k=size)
                _, low, high = interval(group)
                too_low, too_high = too_low + (high < true), too_high + (low > true)
                low, high = student(group, quantile)
                student_held += low <= true <= high
            print(f"| {true:.2g} | {effort} | {stdev(pool) / true:.2f} | {size} "
                  f"| {share(GROUPS - too_low - too_high)} | {100 * too_low / GROUPS:.1f} % "
                  f"| {100 * too_high / GROUPS:.1f} % | {share(student_held)} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    main(200 if parser.parse_args().quick else 2000)
