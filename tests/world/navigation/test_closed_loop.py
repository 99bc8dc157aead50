"""A vehicle that steers by its belief: the filter is consistent but for the bias in docs/guide/navigation.md."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from in_process_runs import Alone, log_of
from samples import samples

from fleet.logs.open_log import open_log

SEEDS, VEHICLES, SPEED_MPS, SECONDS = samples(12), 4, 0.7, 20
BIAS = 0.006  # of the way, ahead
FEW = (f"duration={SECONDS} s", "tick=50 ms", "per_vehicle={}", "navigation.start=0 m", "checks={}")


def test_the_error_on_each_axis_is_as_large_as_believed_and_has_the_stated_mean(alone: Alone) -> None:
    """The vehicle turns against the error of the DVL while that lasts, so the error goes ahead instead of aside: what
    the filter does not know. Without this part the error has the mean 0 and the believed variance on each axis."""
    ahead, rest, believed = [], [], []
    for seed in range(1, SEEDS + 1):
        log = open_log(log_of(alone("dead-reckoning", *FEW, f"seed={seed}")))
        for i in range(1, VEHICLES + 1):
            nav, state, belief = (log[f"uuv/{i}/{name}"] for name in ("nav", "state", "belief"))
            samples = min(len(nav.t), len(state.t))
            aside = nav.v[:samples] - state.v[:samples]
            ahead.append(-np.sum(np.sin(nav.psi[:samples]) * aside) * (nav.t[1] - nav.t[0]))
            rest.append(belief.off[-1] - [ahead[-1], 0.0, 0.0])
            believed.append(belief.covariance[-1, [0, 4, 7]])
    off, variance, count = np.array(rest), np.array(believed), SEEDS * VEHICLES
    assert np.mean(ahead) == pytest.approx(BIAS * SPEED_MPS * SECONDS, rel=0.4)
    assert np.all(abs(off.mean(0)) < 3.3 * np.sqrt(variance.mean(0) / count))
    assert np.mean(off**2 / variance, axis=0) == pytest.approx([1.0] * 3, abs=3.3 * sqrt(2.0 / count))
