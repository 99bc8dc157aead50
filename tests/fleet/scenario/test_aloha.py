"""How often vehicles talk with aloha and meet nobody: what is computed against the acoustic channel itself."""

from __future__ import annotations

import math

import pytest
from marks import slow

from fleet.scenario.sections.turns import talking
from netem.config import NetemConfig
from netem.modem import AcousticConfig, Modem
from netem.network import Netem

TICK_NS = 10_000_000
AIRED = 6000


def measured(round_ticks: int, airtime: int, backoff: int, vehicles: int, rounds: int) -> tuple[float, float, int]:
    """Mean from start to start [ticks], the share that meets nobody, and how many starts: everybody at one place, where
    no signal is stronger than another."""
    modem = Modem(1e6, airtime * TICK_NS / 1e9 - 8e-6, 26e3, 16e3, 200.0, 0.0, 1e5, 1e5, 64, 8.0, 8.0, 100.0)
    everyone = tuple(range(1, vehicles + 1))
    ring = tuple((i, i % vehicles + 1) for i in everyone)
    netem = Netem(
        NetemConfig(1, TICK_NS, round_ticks, everyone, ring, acoustic=AcousticConfig(modem, "aloha", backoff))
    )
    assert modem.airtime_ns(1) == airtime * TICK_NS
    causes: list[str] = []
    for k in range(rounds):
        sent = dict.fromkeys(everyone, (b"x",))
        causes += [
            f.cause for f in netem.exchange(k * round_ticks, sent, dict.fromkeys(everyone, (0.0, 0.0, 0.0))).fates
        ]
    aired = len(causes) - causes.count("replaced")
    return rounds * round_ticks * vehicles / aired, causes.count("delivered") / aired, aired


@pytest.mark.parametrize(
    ("round_ticks", "airtime", "backoff", "vehicles"),
    [
        (10, 14, 84, 2),  # always news, two vehicles: 0.537, where e^(-1/2) = 0.607 was said
        *slow((10, 14, 308, 6)),
        (100, 14, 190, 4),  # the scenario acoustic-s2c: news is waited for
        *slow((60, 14, 190, 4), (100, 50, 300, 2)),
        (500, 14, 190, 4),  # everybody begins with the round
        (100, 14, 20, 3),
        (300, 14, 0, 2),  # all at once
    ],
)
def test_against_the_channel(round_ticks: int, airtime: int, backoff: int, vehicles: int) -> None:
    mean, alone = talking(round_ticks, airtime, backoff, vehicles)
    rounds = int(AIRED * mean / vehicles / round_ticks)
    found_mean, found, aired = measured(round_ticks, airtime, backoff, vehicles, rounds)
    # Besides, up to one start per vehicle is missing at the end.
    within = 3 * (backoff + round_ticks) / math.sqrt(12 * aired) + mean * vehicles / aired
    assert abs(found_mean - mean) <= within < 0.05 * mean
    # What is lost is lost in pairs, at least: the error is that of half as many.
    assert abs(found - alone) <= 3 * math.sqrt(2 * alone * (1 - alone) / aired)


@pytest.mark.parametrize(("vehicles", "share"), [(2, 0.521), (3, 0.456), (4, 0.429), (10, 0.390), (1000, 0.368)])
def test_the_default_back_off(vehicles: int, share: float) -> None:
    """((4 n - 3)^2 / (4 n (4 n - 2)))^(n-1), where e^(-(n-1)/n) was said."""
    n, airtime = vehicles, 10_000
    alone = talking(1, airtime, 2 * airtime * (2 * n - 1), n).alone
    assert alone == pytest.approx(((4 * n - 3) ** 2 / (4 * n * (4 * n - 2))) ** (n - 1), abs=1e-3)
    assert alone == pytest.approx(share, abs=1e-3)


def test_the_forms_meet() -> None:
    """The chain of phases, with a round that is hardly longer than an airtime, and the closed form."""
    short, long = talking(20, 20, 120, 3), talking(21, 20, 120, 3)
    assert long.alone == pytest.approx(short.alone, rel=0.01) and long.mean == pytest.approx(short.mean, rel=0.01)
    fine, coarse = talking(2000, 280, 3800, 4), talking(100, 14, 190, 4)
    assert fine.mean == pytest.approx(20 * coarse.mean, rel=0.01) and fine.alone == pytest.approx(
        coarse.alone, abs=0.02
    )
    assert talking(100, 14, 190, 1).alone == pytest.approx(1.0)
