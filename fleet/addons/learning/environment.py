"""A fleet as a `ParallelEnv`: one episode is one run, which goes on by a decision period when all have decided.

In arrays of observations and actions -1 stands for an unknown one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf, isfinite
from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from agents.loop import AgentLoop
from fleet.addons.learning.policy_agent import Action, Choices, HeldLife, PolicyAgent, Seat
from fleet.errors import FleetError
from fleet.execution.stepped_run import Run, State
from fleet.result.result import Result, Status
from fleet.scenario.loading import with_overrides
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import BeliefKind

STATE = 6  # numbers of a state message: position and velocity
Values = dict[str, Any]


def name_of(i: int) -> str:
    return f"uuv_{i}"


def observation_space(scenario: Scenario, i: int, choices: Choices) -> spaces.Dict:
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


def action_space(scenario: Scenario, i: int, choices: Choices) -> spaces.Dict:
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
        return _fill_space(space)
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
        return {**_fill_space(space), "age": _array(-1.0)}
    values = {"message": _array(*heard.numbers), "age": _array(heard.age_s)}
    if "range" in space.spaces:
        values["range"] = _array(-1.0 if heard.range_m is None else heard.range_m)
    return values


def action_of(who: str, space: spaces.Dict, values: Any, choices: Choices) -> Action:
    """The action of a policy. Raises FleetError: it is not of the space."""
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
    return {choices.move: _array(*action.move), "send": int(action.sends), "message": _array(*action.message)}


def _box(size: int, low: float = -inf) -> spaces.Box:
    return spaces.Box(low, inf, (size,), np.float64)


def _array(*values: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array(values, np.float64)


def _fill_space(space: spaces.Dict) -> Values:
    return {
        key: _fill_space(one) if isinstance(one, spaces.Dict) else np.full(one.shape, 0.0 if key == "message" else -1.0)
        for key, one in space.items()
    }


Reward = Callable[[State], Mapping[str, float] | float]


class FleetEnv(ParallelEnv[str, Values, Values]):  # type: ignore[misc]
    """See `fleet.parallel_env`."""

    metadata = {"name": "uuv_fleet_v0", "render_modes": [], "is_parallelizable": True}  # noqa: RUF012  as PettingZoo
    render_mode = None

    def __init__(
        self, scenario: Scenario, vehicles: tuple[int, ...], choices: Choices, every: int, reward: str | Reward
    ) -> None:
        """`vehicles`: policies decide for these. `every`: ticks from one decision to the next."""
        self.scenario = scenario
        self.possible_agents = [name_of(i) for i in vehicles]
        self.agents: list[str] = []
        self._vehicles = dict(zip(self.possible_agents, vehicles, strict=True))
        self._choices, self._every, self._reward = choices, every, reward
        self._observed = {who: observation_space(scenario, i, choices) for who, i in self._vehicles.items()}
        self._decided = {who: action_space(scenario, i, choices) for who, i in self._vehicles.items()}
        self._seeds: np.random.Generator | None = None  # of episodes that are asked for without a seed
        self._seats: dict[str, Seat] = {}
        self._margin = 0.0
        self.run: Run | None = None  # of this episode: to look at, and to inject faults

    def observation_space(self, agent: str) -> spaces.Dict:
        return self._observed[agent]

    def action_space(self, agent: str) -> spaces.Dict:
        return self._decided[agent]

    @property
    def result(self) -> Result:
        """The verdicts and all numbers of an episode that is over. Raises FleetError: it is not."""
        if self.run is None:
            raise FleetError("there is no episode yet: call reset()")
        return self.run.result

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Values], dict[str, dict[str, Any]]]:
        """Begin an episode. `seed`: of the run. By default that of the scenario in the first episode, and then drawn
        from the seed before. `options`: none is known. Raises ScenarioError: with this seed the scenario is none;
        FleetError: with this seed agents would hear other neighbours."""
        self.close()
        if seed is not None or self._seeds is None:
            episode = self.scenario.seed if seed is None else int(seed)
            self._seeds = np.random.default_rng(episode)
        else:
            episode = int(self._seeds.integers(2**31))
        scenario = (
            self.scenario if episode == self.scenario.seed else with_overrides(self.scenario, [f"seed={episode}"])
        )
        if scenario.graph.links != self.scenario.graph.links:
            raise FleetError(
                f"seed {episode} draws another graph than seed {self.scenario.seed}, so agents would hear other "
                "neighbours: give the scenario a graph that is not drawn"
            )
        self._seats = {who: self._seat(scenario, i) for who, i in self._vehicles.items()}
        lives = {i: self._maker(scenario, who) for who, i in self._vehicles.items()}
        self.run, self.agents, self._margin = Run.prepared(scenario, agents=lives), [*self.possible_agents], 0.0
        self.run.go(1)
        self._look()
        self._rewards()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Values], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Go on by a decision period. Raises FleetError: there is no episode, an agent has no action, or an action is
        not of its space."""
        run = self.run
        if run is None or not self.agents:
            raise FleetError("the episode is over: call reset()" if run is not None else "call reset() first")
        if set(actions) != set(self.agents):
            raise FleetError(f"step: expected an action for each of {', '.join(self.agents)}, got {', '.join(actions)}")
        for who in self.agents:
            self._seats[who].action = action_of(who, self._decided[who], actions[who], self._choices)
        for seat in self._seats.values():
            seat.until = run.tick - 1 + self._every
        for who, seat in self._seats.items():
            if seat.life is not None and not run.over:
                run.answer(self._vehicles[who], seat.life.go_on())
        if not run.over:
            run.go(self._every)
        self._look()
        over = run.over
        broken = over and run.result.status is Status.BROKEN
        rewards = self._rewards()
        found = (
            self._observations(),
            rewards,
            dict.fromkeys(self.agents, broken),
            dict.fromkeys(self.agents, over and not broken),
            self._infos(),
        )
        if over:
            self.agents = []
        return found

    def render(self) -> None:
        """Nothing: `run.state` has the fleet as it is."""

    def close(self) -> None:
        if self.run is not None:
            self.run.close()

    def _seat(self, scenario: Scenario, i: int) -> Seat:
        return Seat(scenario.agent_config(i), self._choices)

    def _maker(self, scenario: Scenario, who: str) -> Callable[[int, int], HeldLife]:
        def make(incarnation: int, begin: int) -> HeldLife:
            seat = self._seats[who]
            core = PolicyAgent(seat)
            loop = AgentLoop(
                core,
                scenario.round_ticks,
                incarnation=incarnation,
                begin=begin,
                ideal=scenario.ideal,
            )
            return HeldLife(seat, loop, core)

        return make

    def _look(self) -> None:
        for seat in self._seats.values():
            if seat.life is not None and (holds := seat.life.holds) is not None:
                seat.life.core.look(*holds)

    def _observations(self) -> dict[str, Values]:
        return {who: observation(self._observed[who], self._seats[who]) for who in self.agents}

    def _infos(self) -> dict[str, dict[str, Any]]:
        """Per agent: the seed, whether its decision counts, and what the scenario's own law would do."""
        run = self.run
        assert run is not None
        infos: dict[str, dict[str, Any]] = {}
        for who in self.agents:
            life = self._seats[who].life
            holds = None if life is None else life.holds
            infos[who] = {"seed": run.scenario.seed, "asked": holds is not None}
            if self._choices.resident and life is not None and holds is not None:
                infos[who]["resident"] = values_of(life.core.foresee(*holds), self._choices)
        return infos

    def _rewards(self) -> dict[str, float]:
        assert self.run is not None
        if isinstance(self._reward, str):
            margin = self.run.margin(self._reward)
            now = self._margin if margin is None else margin.value
            gained, self._margin = now - self._margin, now
            return dict.fromkeys(self.agents, gained)
        given = self._reward(self.run.state)
        if not isinstance(given, Mapping):
            return dict.fromkeys(self.agents, float(given))
        if missing := set(self.agents) - set(given):
            raise FleetError(f"the reward has no number for {', '.join(sorted(missing))}")
        return {who: float(given[who]) for who in self.agents}
