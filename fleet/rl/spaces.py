"""Observations and actions of a policy, as spaces of Gymnasium and as arrays in them. -1 stands for an unknown one."""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

import numpy as np
from gymnasium import spaces

from fleet.errors import FleetError
from fleet.rl.policy_agent import Action, Choices, Seat
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import BeliefKind

STATE = 6  # numbers of a state message: position and velocity
Values = dict[str, Any]


def name_of(i: int) -> str:
    """The name of a vehicle's agent."""
    return f"uuv_{i}"


def observed(scenario: Scenario, i: int, choices: Choices) -> spaces.Dict:
    """The space of what agent i sees."""
    config = scenario.agent_config(i)
    each: dict[str, spaces.Space[Any]] = {"message": _box(choices.numbers or STATE), "age": _box(1, -1.0)}
    if scenario.acoustic is not None:
        each["range"] = _box(1, -1.0)
    found: dict[str, spaces.Space[Any]] = {"time": _box(1, 0.0), "eta": _box(5), "nu": _box(5)}
    if scenario.plant_signals(i) is not None:
        found["roll"] = _box(2)
    if scenario.belief(i) is BeliefKind.FILTER:
        found["covariance"] = _box(10)
    if config.reference is not None:
        found["desired"] = _box(STATE)
    neighbours = {name_of(one.id): spaces.Dict(dict(each)) for one in sorted(config.neighbours, key=lambda n: n.id)}
    if neighbours:
        found["neighbours"] = spaces.Dict(neighbours)
    return spaces.Dict(found)


def decided(scenario: Scenario, i: int, choices: Choices) -> spaces.Dict:
    """The space of what agent i decides."""
    config = scenario.agent_config(i)
    if choices.move == "velocity":
        low, high = config.guidance.rho_lo, config.guidance.rho_hi
    else:
        high = config.tau_max
        low = (-high[0], -high[1], -high[2])
    move = spaces.Box(np.array(low), np.array(high), dtype=np.float64)
    return spaces.Dict({choices.move: move, "send": spaces.Discrete(2), "message": _box(choices.numbers or STATE)})


def observation(space: spaces.Dict, seat: Seat) -> Values:
    """The observation of an agent at the tick of its present or last decision."""
    nav, config = seat.nav, seat.config
    if nav is None:  # its agent has not begun
        return _filled(space)
    t = nav.tick * config.tick_ns / 1e9 if nav.clock_ns is None else nav.clock_ns / 1e9
    values: Values = {"time": _array(t), "eta": _array(*nav.eta), "nu": _array(*nav.nu)}
    if "roll" in space.spaces:
        values["roll"] = _array(*nav.roll)
    if "covariance" in space.spaces:
        known = nav.belief and isfinite(nav.belief[0])
        values["covariance"] = _array(*nav.belief) if known else np.full(10, -1.0)
    if "desired" in space.spaces:
        desired = config.desired(t)
        values["desired"] = _array(*desired.position, *desired.velocity)
    if "neighbours" in space.spaces:
        values["neighbours"] = {}
        for one in sorted(config.neighbours, key=lambda n: n.id):
            each = space["neighbours"][name_of(one.id)]
            values["neighbours"][name_of(one.id)] = _neighbour(each, seat, one.id)
    return values


def _neighbour(space: spaces.Dict, seat: Seat, j: int) -> Values:
    heard = seat.heard.get(j)
    if heard is None:
        return {**_filled(space), "age": _array(-1.0)}
    values = {"message": _array(*heard.numbers), "age": _array(heard.age_s)}
    if "range" in space.spaces:
        values["range"] = _array(-1.0 if heard.range_m is None else heard.range_m)
    return values


def action_of(who: str, space: spaces.Dict, values: Any, choices: Choices) -> Action:
    """The action of a policy.

    Raises:
        FleetError: it is not of the space.
    """
    if not isinstance(values, dict) or set(values) != set(space):
        got = f"keys {', '.join(map(str, values))}" if isinstance(values, dict) else repr(values)[:80]
        raise FleetError(f"the action of {who}: expected a dict with {', '.join(space)}, got {got}")
    numbers = {}
    for key in (choices.move, "message"):
        size = space[key].shape[0]
        try:
            array = np.asarray(values[key], dtype=np.float64)
        except (TypeError, ValueError):
            array = np.array(np.nan)
        if array.shape != (size,) or not np.isfinite(array).all():
            raise FleetError(f"the action of {who}: {key}: expected {size} finite numbers, got {values[key]!r:.80}")
        numbers[key] = tuple(array.tolist())
    if values["send"] not in (0, 1):
        raise FleetError(f"the action of {who}: send: expected 0 or 1, got {values['send']!r:.80}")
    return Action(numbers[choices.move], bool(values["send"]), numbers["message"])


def values_of(action: Action, choices: Choices) -> Values:
    """The inverse."""
    return {choices.move: _array(*action.move), "send": int(action.sends), "message": _array(*action.message)}


def _box(size: int, low: float = -inf) -> spaces.Box:
    return spaces.Box(low, inf, (size,), np.float64)


def _array(*values: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array(values, np.float64)


def _filled(space: spaces.Dict) -> Values:
    """-1 everywhere, and 0 in messages: nothing is known."""
    return {
        key: _filled(one) if isinstance(one, spaces.Dict) else np.full(one.shape, 0.0 if key == "message" else -1.0)
        for key, one in space.items()
    }
