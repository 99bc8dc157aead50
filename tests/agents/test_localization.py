"""Localisation by ranges: the payload, the fusion against what it must be, and the estimate over histories."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import cos, exp, hypot, sin, sqrt
from random import Random
from typing import NamedTuple, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from marks import slow
from msgspec import structs
from small_scenario import small

from agents.api import FormationAgent
from agents.config import AgentConfig, LocalizationParams, Method
from agents.errors import PayloadError
from agents.localization import payload
from agents.localization.localizer import Localizer
from agents.localization.mirror_image import MirrorImage, PlaceEstimate
from agents.localization.range_fusion import fuse_range, grown
from agents.payload import StateMessage
from netem.wire.messages import Delivery, Nav

TICK_S, ROUND = 0.01, 10
METHODS = get_args(Method)
angles = st.floats(0.0, 6.28)
variances = st.floats(0.01, 400.0)


def config(method: Method | None = "consistent") -> AgentConfig:
    params = None if method is None else LocalizationParams(method, 10.83, nis=True)
    return replace(small().agent_config(2), codec="located", localization=params)


def nav(tick: int, x: float, y: float, variance: float = 25.0, u: float = 1.0) -> Nav:
    belief = (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.01, 0.0, 0.001)
    return Nav(0, tick, (x, y, 5.0, 0.0, 0.0), (u, 0.0, 0.0, 0.0, 0.0), (), None, belief)


def said(
    src: int, sent: int, x: float, y: float, variance: float, range_m: float, fixed: bool = True, at: int | None = None
) -> Delivery:
    state = StateMessage(src, sent, (x, y, 5.0), (1.0, 0.0, 0.0))
    data = payload.encode(payload.LocatedMessage(state, (variance, 0.0, variance), fixed))
    return Delivery(sent + 5, sent, src, sent, 0, data, range_m, 0.5, sent if at is None else at)


@given(st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6), variances, variances, st.floats(-0.99, 0.99))
def test_a_message_comes_back_to_the_millimetre(v: list[float], nn: float, ee: float, rho: float) -> None:
    state = StateMessage(3, 77, (v[0], v[1], v[2]), (v[3] / 1e3, v[4] / 1e3, v[5] / 1e3))
    data = payload.encode(payload.LocatedMessage(state, (nn, rho * sqrt(nn * ee), ee), True))
    found = payload.decode(data)
    assert len(data) == payload.SIZE == 42 and payload.is_located(data)
    assert found.state.position == pytest.approx(state.position, abs=6e-4)
    assert found.covariance == pytest.approx((nn, rho * sqrt(nn * ee), ee), rel=1e-6, abs=1e-6)
    for bad in (data[:-1], data[:9] + bytes([data[9] ^ 1]) + data[10:], b"\x03" + data[1:]):
        with pytest.raises(PayloadError):
            payload.decode(bad)


@given(angles, variances, variances, st.floats(0.0, 400.0))
def test_a_range_makes_no_estimate_worse_and_intersection_is_less_sure(
    a: float, own: float, other: float, error: float
) -> None:
    where = (200.0 * cos(a), 200.0 * sin(a))
    given_ = ((0.0, 0.0), (own, 0.0, own), where, (other, 0.0, other), 0.0, 200.0 + 0.01 * error, 0.25)
    alone = fuse_range(*given_, independent=True)
    assert alone is not None
    assert alone.covariance[0] + alone.covariance[2] < 2 * own
    across = fuse_range(*given_, independent=False)
    if across is not None:
        assert alone.covariance[0] + alone.covariance[2] < across.covariance[0] + across.covariance[2] < 2 * own
    assert (
        fuse_range((0.0, 0.0), (own, 0.0, own), (0.0, 0.05), (1.0, 0.0, 1.0), 0.0, 1.0, 0.25, independent=True) is None
    )


def test_a_covariance_grows_in_the_directions_in_which_the_other_grew() -> None:
    assert grown((1.0, 0.0, 1.0), (4.0, 0.0, 4.0), (5.0, 0.5, 6.0)) == pytest.approx((2.0, 0.5, 3.0))
    assert grown((1.0, 0.0, 1.0), (4.0, 0.0, 4.0), (3.0, 0.0, 2.0)) == (1.0, 0.0, 1.0)
    assert grown((1.0, 0.0, 1.0), (4.0, 0.0, 4.0), (5.0, 0.0, 2.0)) == pytest.approx((2.0, 0.0, 1.0))


def test_who_hears_nobody_has_its_navigators_position() -> None:
    localizer = Localizer(config())
    for tick in range(300):
        asked = nav(tick, tick * TICK_S, 0.0, 1.0 + 0.01 * tick if tick < 200 else 0.5)
        assert localizer.absorb(asked, []) == asked


@pytest.mark.parametrize("method", [*METHODS, None])
def test_which_messages_each_method_uses(method: Method | None) -> None:
    for fixed, used in ((True, ("aid", "naive", "consistent")), (False, ("naive", "consistent"))):
        localizer = Localizer(config(method))
        localizer.absorb(nav(0, 0.0, 0.0), [])
        found = localizer.absorb(nav(10, 0.1, 0.0), [said(1, 0, 100.0, 0.0, 0.01, 103.0, fixed)])
        assert (localizer.used == 1) == (method in used)
        if method in used:  # 3 m farther than believed: nearly all of it is the own error
            assert found.eta[0] == pytest.approx(0.1 - 3.0, abs=0.4)
            assert found.belief[0] < 1.0 and found.belief[4] > 20.0


def test_a_late_range_corrects_the_place_where_the_vehicle_was() -> None:
    """Ten seconds on, the same correction: the way since then is known."""
    prompt, late = Localizer(config("aid")), Localizer(config("aid"))
    for tick in range(1001):
        asked = nav(tick, tick * TICK_S, 0.0)
        heard = said(1, 0, 100.0, 0.0, 0.01, 103.0)
        one = prompt.absorb(asked, [heard] if tick == 10 else [])
        other = late.absorb(asked, [heard] if tick == 1000 else [])
    assert other.eta[:2] == pytest.approx(one.eta[:2], abs=1e-6)
    assert late.absorb(nav(1001, 10.0, 0.0), [said(1, 990, 100.0, 0.0, 0.01, 150.0)]).eta[0] == pytest.approx(
        other.eta[0] + 0.01, abs=1e-6
    )
    assert late.refused == 1  # an outlier


def test_one_range_counts_once() -> None:
    localizer = Localizer(config("aid"))
    localizer.absorb(nav(0, 0.0, 0.0), [said(1, 0, 100.0, 0.0, 0.01, 103.0, at=0)])
    assert (localizer.used, localizer.refused) == (1, 0)


@given(st.floats(-6.0, 6.0), st.tuples(*[st.floats(-50.0, 50.0)] * 4), st.tuples(*[st.floats(0.1, 9.0)] * 4))
def test_the_spread_is_that_of_both_places(odds: float, at: tuple[float, ...], variances: tuple[float, ...]) -> None:
    """The oracle: the mean square distance to the estimate of a mixture of both."""
    own = PlaceEstimate((at[0], at[1]), (variances[0], 0.05, variances[1]))
    mirror = MirrorImage()
    assert mirror.spread(own) == own.covariance
    mirror.other, mirror.odds = PlaceEstimate((at[2], at[3]), (variances[2], -0.05, variances[3])), odds
    w = mirror.probability
    assert w == pytest.approx(1.0 / (1.0 + exp(odds)))
    off = np.array([at[2] - at[0], at[3] - at[1]])
    one, other = ([[c[0], c[1]], [c[1], c[2]]] for c in (own.covariance, mirror.other.covariance))
    whole = (1.0 - w) * np.array(one) + w * (np.array(other) + np.outer(off, off))
    assert mirror.spread(own) == pytest.approx((whole[0, 0], whole[0, 1], whole[1, 1]))


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_nis_shows_a_range_whose_noise_is_larger_than_its_modem_knows(share: float) -> None:
    """The mean is 1 (standard deviation sqrt(2 / 400)). With twice the noise it is 2.5, as the gate cuts off more."""
    draw, localizer = Random(5), Localizer(config("aid"))
    assert localizer.telemetry()[-1] == 0.0
    for tick in range(0, 4000, ROUND):
        north = tick * TICK_S
        far = hypot(30.0 + north, 20.0) + draw.gauss(0.0, 0.5 / share)
        localizer.absorb(nav(tick, north, 0.0), [said(1, tick, -30.0, -20.0, 1e-6, far, at=tick)])
    signals = Localizer.signals_of(LocalizationParams("aid", 10.83, nis=True))
    assert sum(signal.width for signal in signals) == len(localizer.telemetry())
    assert localizer.telemetry()[-1] == pytest.approx(0.99 if share == 1.0 else 2.49, rel=0.25)


class Hardship(NamedTuple):
    """Of two vehicles that tell each other where they are."""

    loss: float = 0.0
    delay: int = 0  # [ticks]
    dead: range = range(0)  # ticks in which the second one has no agent; after them it has one without memory


SIGMA = (1.0, 4.0)  # of the error of each one's navigator, which stays as it is [m]
SPEED = (1.0, 3.0)


def exchanged(method: Method, seed: int, hardship: Hardship) -> list[list[tuple[float, float]]]:
    """NEES and variance of two vehicles, one of which passes the other. They speak as often as they can."""
    draw = Random(seed)
    both = [Localizer(config(method)) for _ in SIGMA]
    off = [(draw.gauss(0, sigma), draw.gauss(0, sigma)) for sigma in SIGMA]
    found: list[list[tuple[float, float]]] = [[], []]
    under_way: list[tuple[int, Delivery]] = []  # to whom
    for tick in range(0, 3000, ROUND):
        if tick == hardship.dead.stop:
            both[1] = Localizer(config(method))
        alive = [0] if tick in hardship.dead else [0, 1]
        true = [(x + u * tick * TICK_S, y) for (x, y), u in zip([(0.0, 0.0), (-30.0, 20.0)], SPEED, strict=True)]
        asked = [nav(tick, true[i][0] + off[i][0], true[i][1] + off[i][1], SIGMA[i] ** 2, SPEED[i]) for i in (0, 1)]
        for i in alive:
            far = hypot(true[0][0] - true[1][0], true[0][1] - true[1][1]) + draw.gauss(0, 0.5)
            state = StateMessage(i + 1, tick, both[i].locate(asked[i]).eta[:3], (SPEED[i], 0.0, 0.0))  # type: ignore[arg-type]
            data = payload.encode(both[i].message(state))
            if draw.random() >= hardship.loss:
                due = tick + hardship.delay
                under_way.append((1 - i, Delivery(due, due, i + 1, tick, 0, data, far, 0.5, tick)))
        for i in alive:
            both[i].absorb(asked[i], [heard for to, heard in under_way if (to, heard.due_tick) == (i, tick)])
            x, y, nn, ne, ee = *both[i].locate(asked[i]).eta[:2], *both[i].telemetry()[3:6]
            dx, dy = x - true[i][0], y - true[i][1]
            found[i].append(((ee * dx * dx - 2 * ne * dx * dy + nn * dy * dy) / (nn * ee - ne * ne), nn + ee))
    return found


def mean(values: Iterable[float]) -> float:
    some = list(values)
    return sum(some) / len(some)


@pytest.mark.parametrize(
    "hardship", [*slow((Hardship(),)), pytest.param(Hardship(0.2, 5 * ROUND, range(1000, 1600)))], ids=["none", "all"]
)
def test_naive_becomes_overconfident_and_intersection_stays_consistent(hardship: Hardship) -> None:
    """Two vehicles without fixes cannot learn where both are: over 20 seeds a mean of 2 is right, and less is safe.

    It stays so under loss and delay, and after the second one has died and come back without memory. Yet it gains
    by the first one, which drifts less, before and after.
    """
    runs = {method: [exchanged(method, seed, hardship) for seed in range(20)] for method in METHODS[1:]}
    nees = {m: [mean(nees for run in of for nees, _ in run[i]) for i in (0, 1)] for m, of in runs.items()}
    assert max(nees["consistent"]) < 3.0 < 10.0 < min(nees["naive"])
    variances = [[variance for _, variance in run[1]] for run in runs["consistent"]]
    assert mean(v[-1] for v in variances) < 0.75 * 2 * SIGMA[1] ** 2
    for v in variances if hardship.dead else []:
        back = v[hardship.dead.start // ROUND :]  # without memory it knows what its navigator knows
        assert v[99] < 0.9 * back[0] and back[0] == pytest.approx(2 * SIGMA[1] ** 2) and v[-1] < 0.9 * back[0]


@pytest.mark.parametrize("fixes", [True, False])
def test_a_vehicle_that_small_fixes_keep_as_sure_as_it_is_stays_an_aid(fixes: bool) -> None:
    """In the long run a fix lessens the variance by no more than it has grown since the one before."""
    localizer, round_s = Localizer(config("aid")), 0.1
    state = StateMessage(2, 0, (0.0, 0.0, 5.0), (1.0, 0.0, 0.0))
    for k in range(6000):
        t = k * round_s
        variance = 0.2 * (1.001 if k % 10 else 1.0) if fixes else 1.0 + (0.035 * t) ** 2
        localizer.locate(nav(round(t / TICK_S), t, 0.0, variance))
        if t > 100.0:
            assert localizer.message(state).fixed == fixes, t


def test_an_agent_of_ones_own_gets_the_position_by_ranges_from_the_agent_within() -> None:
    """What a protocol needs of the localiser: so `agents.api` has no name for it."""
    agent = FormationAgent(config("aid"))
    assert "located" in [signal.name for signal in agent.signals]
    _, known = agent.decide(nav(0, 0.0, 0.0), [])
    assert known["located"] == pytest.approx((0.0, 0.0, 5.0))
    agent.transmit(nav(10, 0.1, 0.0))
    _, known = agent.decide(nav(10, 0.1, 0.0), [said(1, 0, 100.0, 0.0, 0.01, 103.0)])
    north, east, depth = known["located"]  # type: ignore[misc]
    assert north == pytest.approx(-2.9, abs=0.2) and (east, depth) == pytest.approx((0.0, 5.0))
    assert known["ranges_used"] == 1.0
    assert known["located_covariance"][0] < 1.0 < known["located_covariance"][2]  # type: ignore[index]


def test_an_agent_of_ones_own_may_put_a_position_of_its_own_in_place_of_the_navigators() -> None:
    """The agent within keeps the formation by the nav that it is given."""
    agent, other = (FormationAgent(replace(small().agent_config(2))) for _ in range(2))
    plain = agent.decide(nav(0, 0.0, 0.0), [])[1]["e_used"]
    moved = other.decide(structs.replace(nav(0, 0.0, 0.0), eta=(3.0, 0.0, 5.0, 0.0, 0.0)), [])[1]["e_used"]
    assert moved != plain
