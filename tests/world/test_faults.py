"""What faulty sensors, actuators and sea do to one vehicle, and that they leave everything else alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loops import world_config
from small_scenario import small

from fleet.scenario.loading import parse_scenario
from netem.wire.codec import decode, encode
from netem.wire.messages import WorldFault, WorldFaults
from world.disturbance import GaussMarkov, gust
from world.sea import World

KINDS = {
    "noise": (0.1, 0.01, 0.02, 0.03),
    "bias": (1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.01, 0.02),
    "freeze": (),
    "efficiency": (0.5, 0.6, 0.7),
    "saturate": (2.0, 1e300, 1.0),
    "off": (),
    "stuck": (),
    "current": (0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 60.0),
    "dropout": (0.6,),
    "gust": (0.2, 0.1, 0.0, 0.2),
    "wrench": (1.0, 0.0, 0.5, 0.1, 0.2),
}


def world(*faults: WorldFault) -> World:
    return World(replace(world_config(), faults=faults))


def fault(kind: str, begin: int = 5, end: int | None = 10, vehicles: tuple[int, ...] = (2,)) -> WorldFault:
    return WorldFault("f", begin, end, kind, vehicles, KINDS[kind])  # type: ignore[arg-type]


def drive(sea: World, ticks: int, first: int = 0) -> list[list[Any]]:
    """(measured, applied, state) of every vehicle at every tick, under a changing command."""
    rows = []
    for k in range(first, first + ticks):
        row = []
        for i in sea.ids:
            measured = sea.sense(i)[:2]
            applied = sea.actuate(i, (3.0 + 0.5 * k, 0.2 * k, -1.5))
            sea.advance(i, applied)
            row.append((measured, applied, sea.state(i)))
        rows.append(row)
    return rows


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_touches_its_vehicle_while_it_lasts(kind: str) -> None:
    healthy, ill = drive(world(), 20), drive(world(fault(kind)), 20)
    assert [row[0] for row in ill] == [row[0] for row in healthy]  # vehicle 1
    assert ill[:5] == healthy[:5]
    assert ill[7][1] != healthy[7][1]
    after = [row[1][1] for row in ill[10:]], [row[1][1] for row in healthy[10:]]
    assert after[0] == after[1]  # the actuators are well again


def test_bias_and_freeze() -> None:
    rows = drive(world(fault("bias")), 12)
    (eta, nu), _, _ = rows[6][1]
    before = rows[5][1][2]  # the truth at tick 6
    assert (*eta, *nu) == pytest.approx([a + b for a, b in zip((*before[0], *before[1]), KINDS["bias"], strict=True)])
    rows = drive(world(fault("freeze")), 12)
    assert len({rows[k][1][0] for k in range(5, 10)}) == 1
    assert rows[5][1][0] == rows[4][1][2]  # what was true when it began


def test_actuators() -> None:
    def applied(kind: str) -> list[Any]:
        return [row[1][1] for row in drive(world(fault(kind)), 12)]

    well = [row[1][1] for row in drive(world(), 12)]
    assert applied("efficiency")[7] == pytest.approx(
        tuple(f * x for f, x in zip(KINDS["efficiency"], well[7], strict=True))
    )
    assert applied("saturate")[7] == (2.0, well[7][1], -1.0)
    assert applied("off")[5:10] == [(0.0, 0.0, 0.0)] * 5
    assert applied("stuck")[5:10] == [well[5]] * 5
    assert applied("stuck")[10] == well[10]


def test_the_sea() -> None:
    """A current is the scenario's own current, a wrench on everybody the scenario's own disturbance, for a while."""
    always = WorldFault("f", 0, None, "current", (), (0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 60.0))
    steady = World(replace(world_config(), current=(0.2, 0.1, 0.0)))
    assert drive(world(always), 15) == drive(steady, 15)
    pushed, calm = drive(world(fault("wrench", 0, None)), 30), drive(world(), 30)
    assert pushed[-1][1][2][1][0] > calm[-1][1][2][1][0]  # pushed forward


def test_a_drifting_current_is_first_order_gauss_markov() -> None:
    """Stationary from the start: its deviation is sigma, and it forgets as exp(-t / T); axes have nothing in common."""
    runs = [GaussMarkov((0.2, 0.0, 0.1), 2.0, 0.1, seed, "current") for seed in range(400)]
    values = np.array([[drift.at(k) for k in range(60)] for drift in runs])
    for when in (0, 59):
        assert np.std(values[:, when, 0]) == pytest.approx(0.2, rel=0.1)
        assert np.std(values[:, when, 2]) == pytest.approx(0.1, rel=0.1)
    assert not values[:, :, 1].any()
    for lag in (5, 20, 40):
        pairs = values[:, : 60 - lag, 0], values[:, lag:, 0]
        found = np.mean(pairs[0] * pairs[1]) / 0.04
        assert found == pytest.approx(np.exp(-lag * 0.1 / 2.0), abs=0.08)
    assert abs(np.mean(values[:, :, 0] * values[:, :, 2])) < 0.1 * 0.2 * 0.1
    late = GaussMarkov((0.2, 0.0, 0.1), 2.0, 0.1, 0, "current").at(59)
    assert late == runs[0].at(59)  # whoever asks, and in whatever order


def test_a_gust_rises_and_falls_once() -> None:
    assert gust((2.0, 0.0, -1.0), 10.0, 0.0) == (0.0, 0.0, 0.0)
    assert gust((2.0, 0.0, -1.0), 10.0, 5.0) == pytest.approx((2.0, 0.0, -1.0))
    assert gust((2.0, 0.0, -1.0), 10.0, 2.5) == pytest.approx((1.0, 0.0, -0.5))
    assert gust((2.0, 0.0, -1.0), 10.0, 10.0) == (0.0, 0.0, 0.0)


def test_the_seas_own_drift_is_that_of_a_fault_but_for_its_draws() -> None:
    drifting = replace(world_config(), drift=((0.1, 0.1, 0.0), 5.0))
    assert drive(World(drifting), 15) != drive(world(), 15)
    assert drive(World(drifting), 15) == drive(World(drifting), 15)
    # Both vehicles see the same water.
    one, other = World(drifting), World(drifting)
    drive(one, 5)
    for i in reversed(other.ids):
        for k in range(5):
            other.advance(i, other.actuate(i, (3.0 + 0.5 * k, 0.2 * k, -1.5)))
    assert [one.state(i) for i in one.ids] == [other.state(i) for i in one.ids]


def test_a_dropout_repeats_what_was_measured_before() -> None:
    rows = drive(world(fault("dropout")), 12)
    measured = [row[1][0] for row in rows]
    truth = [measured[0], *(row[1][2] for row in rows[:-1])]
    repeated = [measured[k] == measured[k - 1] for k in range(6, 10)]
    assert any(repeated)
    assert all(measured[k] in (truth[k], measured[k - 1]) for k in range(1, 12))


@pytest.mark.parametrize(
    ("entry", "kind", "values"),
    [
        ("noise: {vehicles: 1-2, position_noise: 10 cm}", "noise", (0.1, 0.0, 0.0, 0.0)),
        ("bias: {position: 1 0 0 m, yaw_rate: 1 rad/s}", "bias", (1.0, *(0.0,) * 8, 1.0, 0.0, 0.0)),
        ("freeze: 1", "freeze", ()),
        ("efficiency: {surge: 50 %}", "efficiency", (0.5, 1.0, 1.0)),
        ("saturate: {yaw_moment: 2 N m}", "saturate", (1e300, 1e300, 2.0)),
        ("off: '1, 3'", "off", ()),
        ("stuck: 1-3", "stuck", ()),
        ("current: 0.1 0 0 m/s", "current", (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 60.0)),
        (
            "current: {mean: 0.1 0 0 m/s, sigma: 0 5 0 cm/s, time_constant: 20 s}",
            "current",
            (0.1, 0.0, 0.0, 0.0, 0.05, 0.0, 20.0),
        ),
        ("gust: {velocity: 0 1 0 m/s, over: 1 s}", "gust", (0.0, 1.0, 0.0, 1.0)),
        ("dropout: {vehicles: 2, probability: 30 %}", "dropout", (0.3,)),
        ("wrench: {force: 1 0 0 N, pitch_moment: -1 N m}", "wrench", (1.0, 0.0, 0.0, -1.0, 0.0)),
    ],
)
def test_what_a_scenario_says(entry: str, kind: str, values: tuple[float, ...]) -> None:
    s = small(f"faults=[{{at: 100 ms, for: 200 ms, {entry}}}]", "network=ideal")
    (found,) = s.world_config.faults
    assert (found.kind, found.begin, found.end, found.values) == (kind, 10, 30, values)
    assert parse_scenario(s.to_yaml(), "again.yaml") == s
    assert decode(encode(WorldFaults((found,)))) == WorldFaults((found,))
