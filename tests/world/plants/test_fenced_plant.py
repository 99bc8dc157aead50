"""A plant in the world: its motion, its roll, its failures, and what is remembered of it."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin
from typing import Any

import pytest
from loops import world_config

from netem.wire.messages import WorldFault
from world.config import NavNoise, PlantSetup, WorldConfig
from world.errors import PlantError, PluginError
from world.plants import fenced_plant
from world.sea import World

TAU = (3.0, 0.4, -0.6)
LONG_S = 1.0  # a budget: garbage of all tests before, collected on a busy machine, has taken 0.5 s


def config(
    name: str = "Rolling", i: int = 2, phi0: float = 0.0, budget_s: float = 0.0, **parameters: Any
) -> WorldConfig:
    """Four vehicles, of which one is a plant."""
    found = world_config()
    setups = list(found.vehicles)
    setups[i - 1] = replace(setups[i - 1], plant=PlantSetup(f"own_plants:{name}", parameters, budget_s, phi0, 0.1))
    return replace(found, vehicles=tuple(setups))


def drive(sea: World, ticks: int, i: int = 2) -> None:
    for _ in range(ticks):
        sea.advance(i, sea.actuate(i, TAU))


def everything(sea: World, i: int = 2) -> tuple[Any, ...]:
    return sea.tick(i), *sea.state(i), sea.of_plant(i), sea.sense(i)


def test_a_plant_moves_beside_vehicles_that_are_none() -> None:
    sea, other = World(config(phi0=0.3)), World(world_config())
    assert sea.of_plant(2) == (0.3, 0.1, 0.0, sea.state(2)[1][3], sea.state(2)[1][4])
    assert sea.state(2) == other.state(2)
    assert sea.of_plant(1) == ()
    for i in (1, 2):
        drive(sea, 50, i)
        drive(other, 50, i)
    assert everything(sea, 1) == everything(other, 1)
    phi, p, thrust, *fins = sea.of_plant(2)
    assert phi != 0.3 and p != 0.1
    assert thrust == pytest.approx(TAU[0])
    assert tuple(fins) == sea.state(2)[1][3:]
    assert sea.state(2)[0][0] == pytest.approx(other.state(2)[0][0], abs=0.05)  # the model is nearly the same


def test_a_command_is_clipped_to_the_smaller_limits() -> None:
    assert World(config("Weak")).actuate(2, (50.0, -50.0, 0.2)) == (2.0, -0.5, 0.2)
    assert World(config("Rolling")).actuate(2, (50.0, -50.0, 0.2)) == (20.0, -20.0, 0.2)
    assert World(config("Weak")).actuate(1, (50.0, -50.0, 0.2)) == (20.0, -20.0, 0.2)


def test_the_pitch_of_a_rolled_hull_changes_by_both_rates() -> None:
    sea = World(config(phi0=0.7))
    drive(sea, 20)
    before = sea.pitch(2)
    (_, _, _, theta, _), (_, _, _, q, r) = sea.state(2)
    phi = sea.of_plant(2)[0]
    assert before == (theta, q * cos(phi) - r * sin(phi))
    drive(sea, 1)
    assert (sea.pitch(2)[0] - before[0]) / 0.01 == pytest.approx(before[1], rel=0.05)


def test_the_sensor_knows_roll() -> None:
    true = World(config(phi0=0.2))
    assert true.sense(2) == (*true.state(2), (0.2, 0.1))
    assert true.sense(1)[2] == ()
    noisy = World(replace(config(phi0=0.2), noise=NavNoise(angle_rad=0.01)))
    eta, nu, roll = noisy.sense(2)
    assert (eta[:3], nu, roll[1]) == (true.state(2)[0][:3], true.state(2)[1], 0.1)
    assert 0.0 < abs(roll[0] - 0.2) < 0.1
    faults = (
        WorldFault("b", 5, 10, "bias", (), (*(0.0,) * 10, 0.05, -0.02)),
        WorldFault("f", 20, 30, "freeze", (2,), ()),
    )
    sea, well = World(replace(config(), faults=faults)), World(config())
    measured = []
    for _ in range(32):
        measured.append((sea.sense(2), well.sense(2)))
        drive(sea, 1)
        drive(well, 1)
    ill, right = measured[7]
    assert ill[:2] == right[:2]
    assert ill[2] == pytest.approx((right[2][0] + 0.05, right[2][1] - 0.02))
    assert [ill for ill, _ in measured[20:30]] == [measured[20][1]] * 10
    assert measured[30][0] == measured[30][1]


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("raise", "raised ZeroDivisionError: no water"),
        ("nan", "returned the state (nan, "),
        ("short", "returned a state of 12 numbers: expected 13 numbers, as the state before has"),
        ("text", "returned the state 'forward': expected 13 numbers"),
        ("pose", "expected pose (x, y, z, phi, theta, psi), six finite numbers"),
        ("report", "lacks fins"),
        ("loop", "took longer than its budget of 1000 ms"),
    ],
)
def test_a_failure_names_vehicle_tick_and_line_and_leaves_the_vehicle_where_it_was(how: str, said: str) -> None:
    sea = World(config("Failing", budget_s=LONG_S if how == "loop" else 0.0, how=how, at=3))
    drive(sea, 3)
    before = everything(sea)
    with pytest.raises(PlantError) as caught:
        drive(sea, 1)
    error = caught.value
    assert (error.vehicle, error.tick) == (2, 3)
    assert str(error).startswith("vehicle 2, tick 3: Failing ")
    assert said in str(error)
    assert "own_plants.py:" in error.where
    assert everything(sea) == before


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Elsewhere", "vehicle 2, tick 0: Elsewhere has the pose (0, -10, 0, 0, 0, 0) at its start: expected (-1, "),
        ("RaisingLimits", "vehicle 2, tick 0: RaisingLimits raised LookupError: no data sheet ("),
        ("NoLimits", "vehicle 2, tick 0: NoLimits has the limits (20.0, -1.0, 20.0): expected three finite numbers"),
    ],
)
def test_what_cannot_begin(name: str, said: str) -> None:
    with pytest.raises(PlantError) as caught:
        World(config(name))
    assert str(caught.value).startswith(said)


def test_what_cannot_be_used() -> None:
    with pytest.raises(PluginError, match="it has no method pose"):
        World(config("Lacking"))
    with pytest.raises(PluginError, match="unexpected keyword argument 'mass'"):
        World(config("Rolling", mass=3.0))


def test_a_plant_that_cannot_be_ended_does_not_take_the_result_with_it() -> None:
    sea = World(config("Clinging"))
    drive(sea, 1)
    sea.close()
    assert sea.tick(2) == 1


def test_another_vehicle_begins_with_the_motion_that_was() -> None:
    rolling, plain = World(config(phi0=0.3)), World(world_config())
    drive(rolling, 30)
    drive(plain, 30)
    was, of_plant, plainly = rolling.state(2), rolling.of_plant(2)[:2], plain.state(2)
    heavy, heavier, light = World(config("Weak")), World(config("Weak")), World(world_config())
    heavy.take_over(rolling)
    assert (heavy.tick(2), heavy.state(2), heavy.of_plant(2)[:2]) == (30, was, of_plant)
    heavier.take_over(plain)
    assert (heavier.state(2), heavier.of_plant(2)[:2]) == (plainly, (0.0, 0.0))
    light.take_over(heavy)
    assert light.state(2) == was


def test_a_state_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fenced_plant, "MAX_NUMBERS", 10)
    with pytest.raises(PlantError, match="expected 1 to 10 numbers"):
        World(config())
