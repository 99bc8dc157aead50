"""The theory of each border of a study, to be drawn next to the result of the simulations.

`fleet check` leaves loss out. Here it enters the rule of dead reckoning as age: of a link that loses the share p, what
is heard last is p / (1 - p) rounds older on average.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

from fleet.analysis.link_shares import effective_loss
from fleet.analysis.stability import analyse, dead_reckoning, oldest_s, shunting_decay
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from fleet.study.borders import Borders
from fleet.study.one_run import A_STUDY


@dataclass(frozen=True, slots=True)
class Theory:
    """Theory at the low end of a border's range, and along it.

    Attributes:
        shunting: K lambda_max(L+B) and a [1/s]. The first must be smaller. None: the rule does not apply.
        stable: at the low end of the range, whether the linear loop is stable for the final value of K. None: not
            known.
        reckoning: index of the first value with K tau rho(A) >= 1, for the mean age under loss. If no value is that
            large, the number of values. None: the rule does not apply.
    """

    shunting: tuple[float, float] | None
    stable: bool | None
    reckoning: int | None


def theory(borders: Borders) -> list[Theory]:
    """Of each border what theory says.

    Raises:
        ScenarioError: a law of a scenario may not be loaded here, or a scenario is damaged.
    """
    return [_theory(borders, number, Policy(A_STUDY)) for number in range(borders.count)]


def _theory(borders: Borders, number: int, policy: Policy) -> Theory:
    places, store = len(borders.places), borders.store

    def scenario(place: int) -> Scenario:
        text = borders.points[number * places + place]["scenario"]
        return parse_scenario(text, store.record.scenario, folder=store.folder, policy=policy)

    first = scenario(0)
    found = analyse(first)
    decay, loop = shunting_decay(first), found.at_settled
    stable = None if loop is None or found.settled is None else not loop.unstable(max(found.settled))
    reckoning = None
    if _reckoning(first) is not None:
        reckoning = bisect_left(range(places), 1.0, key=lambda place: _reckoning(scenario(place)) or 0.0)
    shunting = None if decay is None or found.gain_max is None else (found.gain_max * found.lambda_max, decay)
    return Theory(shunting, stable, reckoning)


def _reckoning(scenario: Scenario) -> float | None:
    lost = max((condition.loss for condition in scenario.conditions.values()), default=0.0)
    lost = max([lost, *map(effective_loss, scenario.changing.values())])
    if lost >= 1.0:
        return float("inf")
    round_s = scenario.round_ticks * scenario.tick_ns / 1e9
    return dead_reckoning(scenario, analyse(scenario, linear=False), oldest_s(scenario) + round_s * lost / (1.0 - lost))
