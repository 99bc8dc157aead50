"""How many runs does it take to find a border? Methods compared over borders of which the truth is known.

    pip install questplus adaptive scikit-learn
    python docs/examples/boundary_methods.py          # the table of docs/background/decisions.md; minutes
    python docs/examples/boundary_methods.py --quick  # fewer borders
    python docs/examples/boundary_methods.py --runs studies/DIR  # a sweep over one key in place of curves
    python docs/examples/boundary_methods.py --coverage 300      # how often an interval holds the truth

Each border is drawn at random: the pass rate falls along a logistic curve, or along another one that no method assumes.
Every method asks for runs at places of its choice, and is measured by how far its estimate is off after so many.
With a sweep, runs are drawn from its rows, and its own border is that of a logistic fit to all of them.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import bisect
from scipy.stats import norm

from fleet.addons.studies.psychometric import RISING, PsychometricCurve, Walk, steepest_rise
from fleet.addons.studies.statistics import pass_rate

COUNTS = (12, 20, 40, 60, 100)
GRID_COUNTS = (*COUNTS, 200, 400)
SHAPES = ("s = 1 %", "s = 3 %", "s = 10 %", "Gumbel", "5 % lapses")
CURVE = PsychometricCurve(np.linspace(0.0, 1.0, 65).tolist())
Ask = Callable[[float], bool]  # a run at a position from 0 to 1: whether it passed


class Truth(NamedTuple):
    """A border, and runs on both of its sides."""

    border: float
    ask: Ask


def drawn(shape: str, seed: int) -> Truth:
    """A border somewhere in the middle 80 % of the range."""
    rng = np.random.default_rng(seed)
    border = rng.uniform(0.1, 0.9)

    def rate(x: float) -> float:
        if shape == "Gumbel":  # falls slowly, then fast; a half at the border
            return float(np.exp(-np.log(2.0) * np.exp((x - border) / 0.05)))
        if shape == "5 % lapses":
            return 0.05 + 0.9 / (1.0 + np.exp(min(500.0, (x - border) / 0.03)))
        scale = float(shape.split()[2]) / 100.0
        return 1.0 / (1.0 + np.exp(min(500.0, (x - border) / scale)))

    return Truth(border, lambda x: bool(rng.random() < rate(x)))


SLOPES = (0.01, 0.03, 0.1)  # of a logistic curve, and about as steep others
FALLS: dict[str, Callable[[float], float]] = {  # of u = (x - middle) / slope; a half at 0
    "logistic": lambda u: 1.0 / (1.0 + np.exp(min(500.0, u))),
    "probit": lambda u: float(norm.cdf(-u / 1.7)),
    "complementary log-log": lambda u: 1.0 - np.exp(-np.log(2.0) * np.exp(min(500.0, -u))),
    "Gumbel": lambda u: float(np.exp(-np.log(2.0) * np.exp(min(500.0, u)))),
    "linear": lambda u: float(np.clip(0.5 - u / 8.0, 0.0, 1.0)),
    "step": lambda u: float(u < 0.0),
}
ENDS = {  # in words the best and the worst pass rate
    **{name: (name, 1.0, 0.0) for name in FALLS},
    "logistic, best 0.7": ("logistic", 0.7, 0.0),
    "logistic, worst 0.2": ("logistic", 1.0, 0.2),
    "logistic, 0.85 to 0.15": ("logistic", 0.85, 0.15),
    "step, best 0.7": ("step", 0.7, 0.0),
    "step, worst 0.2": ("step", 1.0, 0.2),
}


def ending(shape: str, seed: int, slopes: tuple[float, ...] = SLOPES) -> Truth:
    """A border in the middle 80 % of the range, of a curve of one of the slopes between some ends."""
    rng = np.random.default_rng(seed)
    name, best, worst = ENDS[shape]
    while True:
        slope, middle = rng.choice(slopes), rng.uniform(0.0, 1.0)
        rate = partial(_rate, FALLS[name], slope, middle, best, worst)
        border = float(bisect(lambda x, rate=rate: rate(x) - 0.5, -2.0, 3.0))
        if 0.1 <= border <= 0.9:
            return Truth(border, lambda x, rate=rate: bool(rng.random() < rate(x)))


def _rate(falls: Callable[[float], float], slope: float, middle: float, best: float, worst: float, x: float) -> float:
    return worst + (best - worst) * falls((x - middle) / slope)


def print_coverage(borders: int) -> None:
    """How often the interval of `fleet boundary` holds the border, with its defaults: 16 places, 60 runs at most."""
    walk = Walk(PsychometricCurve(np.linspace(0.0, 1.0, 16).tolist()), 0.1)
    print(f"{borders} borders of each row; early: of those with fewer than 60 runs; all but runs in %\n")
    print("| curve | held | early | runs | bias | rms error | width |\n|---|---|---|---|---|---|---|")
    rows = [(f"logistic, slope {100 * slope:g} %", "logistic", (slope,)) for slope in SLOPES]
    for title, shape, slopes in [*rows, *((shape, shape, SLOPES) for shape in ENDS)]:
        held, early, used, off, widths = [], [], 0, [], []
        for seed in range(borders):
            truth, made = ending(shape, seed, slopes), []
            while len(made) < 60 and (asked := walk.next_runs(made)):
                made += [(k, truth.ask(walk.curve.positions[k])) for k in asked]
            found = walk.curve.belief(walk.curve.posterior(made))
            outside = max(found.below, found.above) > 0.95
            low, high = (-1.0 if found.low < 0.0 else found.low), (2.0 if found.high > 1.0 else found.high)
            held.append(not outside and low <= truth.border <= high)
            if len(made) < 60:
                early.append(held[-1])
            used += len(made)
            off.append(found.border - truth.border)
            widths.append(found.high - found.low)
        error, width = np.sqrt(np.mean(np.square(off))), np.mean(widths)
        print(f"| {title} | {_share(held)} | {_share(early)} | {used / borders:.1f} "
              f"| {100 * np.mean(off):+.1f} | {100 * error:.1f} | {100 * width:.0f} |", flush=True)  # fmt: skip


def _share(held: list[bool]) -> str:
    rate = pass_rate(sum(held), len(held))
    return f"{100 * rate.value:.1f} ({100 * rate.low:.0f} to {100 * rate.high:.0f}) of {len(held)}"


def posterior_median(runs: list[tuple[int, bool]]) -> float:
    return CURVE.belief(CURVE.posterior(runs)).border


def nearest(x: float) -> int:
    return int(np.argmin(np.abs(CURVE.positions - x)))


def grid(points: int) -> Callable[[Truth, int], Iterator[tuple[int, float]]]:
    """As many runs at each of some places, and the same fit as `ours`."""

    def method(truth: Truth, _: int) -> Iterator[tuple[int, float]]:
        places = [nearest(x) for x in np.linspace(0.0, 1.0, points)]
        runs: list[tuple[int, bool]] = []
        while len(runs) < GRID_COUNTS[-1]:
            for k in places:
                runs.append((k, truth.ask(CURVE.positions[k])))
                yield len(runs), posterior_median(runs) if len(runs) in GRID_COUNTS and k == places[-1] else np.nan

    return method


def ours(batch: int) -> Callable[[Truth, int], Iterator[tuple[int, float]]]:
    """fleet boundary: both ends and two places between, then batches that say most about the border."""

    def method(truth: Truth, _: int) -> Iterator[tuple[int, float]]:
        runs: list[tuple[int, bool]] = []
        while len(runs) < COUNTS[-1]:
            asked = CURVE.most_informative(CURVE.posterior(runs), batch) if runs else [0, 21, 43, 64]
            runs += [(k, truth.ask(CURVE.positions[k])) for k in asked]
            yield len(runs), posterior_median(runs)

    return method


def staircase(truth: Truth, _: int) -> Iterator[tuple[int, float]]:
    """One up, one down, the step halved at the first reversals; the mean of the later places."""
    x, step, last = 0.5, 0.25, None
    places: list[float] = []
    for n in range(1, COUNTS[-1] + 1):
        passed = truth.ask(x)
        if last is not None and passed != last:
            step = max(step / 2.0, 1.0 / 64.0)
        last = passed
        x = float(np.clip(x + (step if passed else -step), 0.0, 1.0))
        places.append(x)
        yield n, float(np.mean(places[n // 3 :]))


def probabilistic_bisection(truth: Truth, _: int) -> Iterator[tuple[int, float]]:
    """Waeber, Frazier and Henderson (2013): ask at the median, an answer is taken to be right with chance 0.65."""
    cells = np.full(1024, 1.0 / 1024)
    middles = (np.arange(1024) + 0.5) / 1024
    for n in range(1, COUNTS[-1] + 1):
        median = middles[np.searchsorted(np.cumsum(cells), 0.5)]
        beyond = middles > median
        cells *= np.where(beyond == truth.ask(median), 0.65, 0.35)
        cells /= cells.sum()
        yield n, float(middles[np.searchsorted(np.cumsum(cells), 0.5)])


def quest_plus(truth: Truth, _: int) -> Iterator[tuple[int, float]]:
    """The package questplus: cumulative normal, minimum entropy, posterior mean."""
    import questplus

    found = questplus.QuestPlus(
        stim_domain={"intensity": CURVE.positions}, stim_scale="linear", func="norm_cdf",
        param_domain={"mean": np.linspace(-0.5, 1.5, 201), "sd": np.geomspace(0.005, 0.6, 8),
                      "lower_asymptote": [0.01], "lapse_rate": [0.01]},
        outcome_domain={"response": ["fails", "passes"]}, stim_selection_method="min_entropy",
        param_estimation_method="mean",
    )  # fmt: skip
    for n in range(1, COUNTS[-1] + 1):
        stimulus = found.next_stim
        passed = truth.ask(float(stimulus["intensity"]))
        found.update(stim=stimulus, outcome={"response": "passes" if passed else "fails"})
        yield n, float(found.param_estimate["mean"])


def adaptive_learner(truth: Truth, seed: int) -> Iterator[tuple[int, float]]:
    """The package adaptive, AverageLearner1D on 0 and 1; the same fit as `ours`."""
    from adaptive import AverageLearner1D

    learner = AverageLearner1D(lambda _: 0.0, bounds=(0.0, 1.0), delta=0.2, min_samples=4)
    runs: list[tuple[int, bool]] = []
    while len(runs) < COUNTS[-1]:
        points, _ = learner.ask(4)
        for point in points:
            passed = truth.ask(point[1])
            learner.tell(point, float(passed))
            runs.append((nearest(point[1]), passed))
        yield len(runs), posterior_median(runs)


def straddle(truth: Truth, _: int) -> Iterator[tuple[int, float]]:
    """scikit-learn's Gaussian process on 0 and 1, asked where 1.96 sd - |mean - 0.5| is largest (Bryan, 2005)."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, WhiteKernel

    x, y = [0.0, 1 / 3, 2 / 3, 1.0], []
    y = [float(truth.ask(at)) for at in x]
    places = CURVE.positions[:, None]
    kernel = RBF(0.2, (0.03, 1.0)) + WhiteKernel(0.1, (1e-3, 0.3))
    for n in range(5, 42):  # more takes too long
        model = GaussianProcessRegressor(kernel, normalize_y=True).fit(np.array(x)[:, None], y)
        latent = model.predict(places)
        noise = np.exp(model.kernel_.theta[-1]) * np.var(y)
        deviation = np.sqrt(np.maximum(model.predict(places, return_std=True)[1] ** 2 - noise, 0.0))
        under = np.flatnonzero(latent < 0.5)
        yield n - 1, float(places[under[0], 0]) if len(under) else 1.0
        at = float(places[int(np.argmax(1.96 * deviation - np.abs(latent - 0.5))), 0])
        x.append(at)
        y.append(float(truth.ask(at)))


METHODS: dict[str, tuple[Callable[[Truth, int], Iterator[tuple[int, float]]], int]] = {  # and one of so many borders
    "grid of 10, logistic fit": (grid(10), 1),
    "grid of 20, logistic fit": (grid(20), 1),
    "staircase": (staircase, 1),
    "probabilistic bisection": (probabilistic_bisection, 1),
    "questplus 2023.1": (quest_plus, 6),
    "adaptive 1.5, AverageLearner1D": (adaptive_learner, 1),
    "scikit-learn GP, straddle": (straddle, 6),
    "information, 1 run at a time": (ours(1), 1),
    "information, batches of 4": (ours(4), 1),
    "information, batches of 2": (ours(2), 1),
}


def errors(name: str, truths: Callable[[int], Truth], borders: int) -> dict[int, float]:
    """By number of runs the root mean square of what the estimate is off, in % of the range."""
    method, every = METHODS[name]
    off: dict[int, list[float]] = {}
    for seed in range(0, borders, every):
        truth = truths(seed)
        for n, estimate in method(truth, seed):
            if n in GRID_COUNTS and np.isfinite(estimate):
                off.setdefault(n, []).append(estimate - truth.border)
    return {n: 100.0 * float(np.sqrt(np.mean(np.square(values)))) for n, values in off.items()}


def intervals(truths: Callable[[int], Truth], borders: int, runs: int) -> tuple[float, float, float]:
    """Of batches of 4 until the interval is narrow, `runs` at most: how often the interval holds the truth, the runs,
    and how often the curve is said not to fall."""
    held, used, alarms = 0, 0, 0
    walk = Walk(CURVE, 0.1)
    for seed in range(borders):
        truth = truths(seed)
        made: list[tuple[int, bool]] = []
        while len(made) < runs and (asked := walk.next_runs(made)):
            made += [(k, truth.ask(CURVE.positions[k])) for k in asked]
        found = CURVE.belief(CURVE.posterior(made))
        held += found.low <= truth.border <= found.high
        used += len(made)
        alarms += steepest_rise(made).chance <= RISING
    return held / borders, used / borders, alarms / borders


def of_sweep(directory: str) -> Callable[[int], Truth]:
    """Runs drawn from the rows of a sweep over one key."""
    from fleet.addons.studies.study import open_study

    frame = open_study(directory).to_pandas()
    (key,) = open_study(directory).axes
    values = np.sort(frame[key].unique())
    passed = [frame[frame[key] == value]["passed"].to_numpy() for value in values]
    places = (values - values[0]) / (values[-1] - values[0])
    every = [(nearest(x), bool(one)) for x, of in zip(places, passed) for one in of]
    border = posterior_median(every)
    print(f"{len(frame)} runs of {directory}: the border is at {values[0] + border * (values[-1] - values[0]):.4g}")

    def truth(seed: int) -> Truth:
        rng = np.random.default_rng(seed)

        def ask(x: float) -> bool:  # between two values one of the two, the nearer the likelier
            at = np.interp(x, places, np.arange(len(places)))
            k = int(at) + int(rng.random() < at % 1.0)
            return bool(rng.choice(passed[k]))

        return Truth(border, ask)

    return truth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", metavar="DIR")
    parser.add_argument("--coverage", metavar="BORDERS", type=int)
    asked = parser.parse_args()
    if asked.coverage:
        print_coverage(asked.coverage)
        return
    warnings.simplefilter("ignore")
    borders = 12 if asked.quick else 48
    cases = {asked.runs: of_sweep(asked.runs)} if asked.runs else {}
    for shape in () if asked.runs else SHAPES:
        cases[shape] = lambda seed, shape=shape: drawn(shape, seed)
    for case, truths in cases.items():
        print(f"\n{case}: RMS error of the border after so many runs [% of the range]\n")
        print("| method | " + " | ".join(map(str, GRID_COUNTS)) + " |")
        print("|---|" + "---|" * len(GRID_COUNTS))
        for name in METHODS:
            found = errors(name, truths, borders)
            cells = [f"{found[n]:.1f}" if n in found else "" for n in GRID_COUNTS]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
        held, used, alarms = intervals(truths, borders, 100)
        print(f"\nuntil the interval is 10 % wide: {used:.0f} runs; it holds the truth in {100 * held:.0f} %; "
              f"said not to fall: {100 * alarms:.1f} %", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
