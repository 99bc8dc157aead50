"""The scenarios of the sea trial MISSION 2012 against its table, and modems against what others published of theirs."""

from __future__ import annotations

import numpy as np
import pytest

from fleet.scenario.loading import load_scenario
from fleet.scenario.sections.modem_files import load_modem
from netem.cause import Cause
from netem.modem import AcousticConfig
from netem.network import Netem
from netem.propagation import fading_gain_db

# Loss (not detected or not decoded) from row to column, nodes 21, 22, 27, 28, 29: org-arl/unet-contrib,
# archive/samples/mission2012/Mission2012Channel.groovy, after Chitre et al., OCEANS 2013 Bergen.
LOSS = np.array(
    [
        [0, 0.157, 0.643, 0.197, 0.239],
        [0.184, 0, 0.870, 0.639, 0.435],
        [0.326, 0.826, 0, 0.975, 0.023],
        [0.038, 0.160, 0.760, 0, 0.900],
        [0.070, 0.070, 0.018, 0.871, 0],
    ]
)
NODES = np.array([[0, 0, -5], [398, -105, -18], [-434, -499, -12], [-32, 279, -20], [-199, -307, -12]])
RANGES = np.linalg.norm(NODES[:, None] - NODES[None], axis=2)
LINKS = ~np.eye(5, dtype=bool)


def asymmetry(loss: np.ndarray) -> float:
    """The mean difference of the two directions of a link."""
    return float(np.abs(loss - loss.T)[np.triu(LINKS)].mean())


def test_the_formation_has_the_distances_of_the_trial() -> None:
    for name in ("mission-2012", "mission-2012-model"):
        offsets = np.array([load_scenario(name).agent_config(i + 1).offset.start for i in range(5)])
        assert np.allclose(np.linalg.norm(offsets[:, None] - offsets[None], axis=2), RANGES)


def test_emulated_losses_lie_within_the_binomial_intervals_of_the_table() -> None:
    """100,000 packets over 20 links; four standard errors, which one link in 16,000 exceeds by chance."""
    config, rounds = load_scenario("mission-2012").netem_config, 5000
    netem, lost = Netem(config), np.zeros((5, 5))
    traffic = dict.fromkeys(range(1, 6), (b"fifteen bytes..",))
    for number in range(rounds):
        for fate in netem.exchange(number * config.round_ticks, traffic).fates:
            lost[fate.src - 1, fate.dst - 1] += fate.cause == Cause.LOSS
    error = np.sqrt(LOSS * (1 - LOSS) / rounds)
    assert (np.abs(lost / rounds - LOSS)[LINKS] < 4 * error[LINKS]).all()


def test_the_model_of_the_water_resembles_the_trial() -> None:
    """Mean loss, asymmetry and correlation with distance of the trial lie among those of 400 seeds of the model."""
    acoustic = load_scenario("mission-2012-model").netem_config.acoustic
    assert acoustic is not None and acoustic.modem.lost_below == acoustic.modem.clear_above
    margin = np.array([[acoustic.snr(r) - acoustic.modem.lost_below if r else 0.0 for r in row] for row in RANGES])
    means, differences, correlations = [], [], []
    for seed in range(1, 401):
        slow = [
            [fading_gain_db(seed, i, j, 0, acoustic.shadowing, 0, None) if i != j else 0.0 for j in range(5)]
            for i in range(5)
        ]
        loss = 1 - np.exp(-(10 ** (-(margin + slow) / 10)))  # Rayleigh: the power of a packet is exponential
        means.append(loss[LINKS].mean())
        differences.append(asymmetry(loss))
        correlations.append(np.corrcoef(loss[LINKS], RANGES[LINKS])[0, 1])
    measured = (LOSS[LINKS].mean(), asymmetry(LOSS), np.corrcoef(LOSS[LINKS], RANGES[LINKS])[0, 1])
    assert measured == pytest.approx((0.42, 0.18, 0.81), abs=0.01)
    for value, found in zip(measured, (means, differences, correlations), strict=True):
        low, high = np.percentile(found, [5, 95])
        assert low < value < high


def test_a_modem_of_a_kilobit_reaches_two_kilometres() -> None:
    """Subnero: more than 2 km at 1.3 kbit/s with at least 70 % of the packets (its own performance tests, 2020)."""
    modem = load_modem("mfsk-1066")
    assert 0.8 < modem.bit_rate / 1300 < 1.0
    assert 1 - AcousticConfig(modem).packet_error_rate(2000.0, 15) >= 0.7
