"""`fleet.parallel_env`: what is asked for is checked here, before PettingZoo is imported."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fleet.addons.learning.policy_agent import Choices
from fleet.errors import FleetError
from fleet.execution.external_agents import refuse
from fleet.execution.stepped_run import Changes, load_for
from fleet.logs.table import require
from fleet.quantities import QuantityError, show_time, time_ns
from fleet.scenario.scenario import Scenario

if TYPE_CHECKING:
    from fleet.addons.learning.environment import FleetEnv, Reward

MOST_NUMBERS = 1000  # of a message


def parallel_env(
    scenario: str | Path | Scenario,
    *,
    set: Changes = (),
    seed: int | None = None,
    trust: bool = False,
    vehicles: Iterable[int] | None = None,
    move: Literal["velocity", "force"] = "velocity",
    message: Literal["state"] | int = "state",
    every: str | None = None,
    reward: str | Reward | None = None,
    resident: bool = False,
) -> FleetEnv:
    """A scenario as an environment of PettingZoo: policies decide for vehicles. Needs the extra `rl`.

    The run is in this process. Messages pass through the network of the scenario.
    The guide is `docs/guide/policies.md`.

    Args:
        scenario: a shipped name, a file, or a loaded scenario.
        set: changes of the scenario, as for `fleet.run`.
        seed: seed of the first episode. None: the seed of the scenario.
        trust: as for `fleet.run`.
        vehicles: policies decide for these vehicles. None: for all. The others keep the laws of the scenario.
        move: a policy decides a `velocity` over ground [m/s, NED], or a `force`: surge force [N], pitch and yaw
            moment [N m].
        message: a policy sends its "state", six numbers (position [m], velocity [m/s], NED) in the payload of the
            scenario. A number: it sends that many numbers of its own.
        every: time from one decision to the next. None: the round period of the network.
        reward: the name of a check. The rewards of an episode add up to its margin. Or a function of the `State`, which
            returns one number, or one for each agent. None: the first check that has a margin.
        resident: with `move="force"`, the scenario's own law runs along. `infos` have its action, the log its signals.

    Returns:
        The environment, before its first `reset`.

    Raises:
        FleetError: PettingZoo is not installed, or what is asked for does not fit the scenario.
        ScenarioError: with every mistake that was found.
    """
    require("parallel_env", ("pettingzoo", "gymnasium"), "rl")
    found = load_for(parallel_env, scenario, set, (), (), seed, trust)
    refuse(found, "an environment")
    numbers = _numbers(found, message)
    if move not in ("velocity", "force"):
        raise FleetError(f"move: expected velocity or force, got {move!r}")
    chosen = _vehicles(found, vehicles)
    _insist_on_laws(found, chosen, move, resident=resident)
    from fleet.addons.learning.environment import FleetEnv

    return FleetEnv(found, chosen, Choices(move, numbers, resident), _every(found, every), _reward(found, reward))


def _numbers(scenario: Scenario, message: str | int) -> int:
    """Numbers of a message; 0: a state."""
    if message == "state":
        if scenario.spec.network.payload == "located":
            raise FleetError(
                "message: with network.payload located a state holds a covariance, too: set network.payload to full or "
                "compact, or give a number of numbers"
            )
        return 0
    if not isinstance(message, int) or isinstance(message, bool) or not 1 <= message <= MOST_NUMBERS:
        raise FleetError(f'message: expected "state", or how many numbers (1 to {MOST_NUMBERS}), got {message!r}')
    return message


def _vehicles(scenario: Scenario, vehicles: Iterable[int] | None) -> tuple[int, ...]:
    every = range(1, scenario.vehicles + 1)
    chosen = tuple(every) if vehicles is None else tuple(sorted(dict.fromkeys(vehicles)))
    if wrong := [i for i in chosen if i not in every]:
        raise FleetError(f"vehicles: {wrong[0]!r} is none of {scenario.name}, which has 1 to {scenario.vehicles}")
    if not chosen:
        raise FleetError("vehicles: expected one at least")
    return chosen


def _insist_on_laws(scenario: Scenario, vehicles: tuple[int, ...], move: str, *, resident: bool) -> None:
    """Raise FleetError if the scenario's own laws cannot do what they are needed for."""
    if resident and move != "force":
        raise FleetError('resident: the own law of the scenario answers in forces: give move="force", too')
    if resident and scenario.ideal:
        raise FleetError("resident: on an ideal network a law decides after it heard what is sent at the same tick")
    for i in vehicles if resident or move == "velocity" else ():
        config = scenario.agent_config(i)
        if config.agent is not None:
            raise FleetError(f'vehicle {i} has a whole agent, {config.agent.name}: give move="force", and no resident')
        if move == "velocity" and config.controller is not None:
            raise FleetError(
                f"vehicle {i} has the controller {config.controller.name}, which follows no velocity: give "
                'move="force", or set guidance and tracking'
            )


def _every(scenario: Scenario, every: str | None) -> int:
    if every is None:
        return scenario.round_ticks
    try:
        ns = time_ns(every)
    except QuantityError as error:
        raise FleetError(f"every: {error}") from None
    if ns < scenario.tick_ns or ns % scenario.tick_ns:
        raise FleetError(f"every: expected a whole number of ticks of {show_time(scenario.tick_ns)}, got {every}")
    return ns // scenario.tick_ns


def _reward(scenario: Scenario, reward: str | Reward | None) -> str | Reward:
    if callable(reward):
        return reward
    checks = scenario.spec.checks
    known = [name for name in ("formation_error", "consensus_error") if getattr(checks, name) is not None]
    known += [] if checks.min_separation is None else ["min_separation"]
    known += [] if checks.max_age is None else ["max_age"]
    known += [name for _, _, name, *_ in checks.own()]
    if reward in known:
        return str(reward)
    has = ", ".join(known) or "none"
    if reward is not None:
        raise FleetError(f"reward: {reward!r} is no check of {scenario.name} with a margin in time; it has {has}")
    if not known:
        raise FleetError(
            f"reward: {scenario.name} has no check with a margin: add one, or give a function of the state"
        )
    return known[0]
