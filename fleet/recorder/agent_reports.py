"""Whole agents, which run a protocol of somebody's: what each of them reported at the end.

Not in metrics.py, which is compiled: mypyc 2.4 does not take a comprehension with a lambda in a NamedTuple.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

from fleet.result.result import SignalValue
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signal_checks import checked_signals


class _Reported(NamedTuple):
    name: str
    unit: str
    place: int  # in the telemetry


class AgentProtocol(NamedTuple):
    """The whole agent of one vehicle, and what it reports; without a name it has the laws of a controller instead."""

    law: str
    signals: tuple[_Reported, ...]  # those that a check of the scenario names come first

    @classmethod
    def of(cls, scenario: Scenario, vehicle: int) -> AgentProtocol:
        agent = scenario.agent_config(vehicle).agent
        if agent is None:
            return cls("", ())
        judged = {signal.name for signal in checked_signals(scenario.spec.checks)}
        known = [
            (f"{group}.{signal.name}", _Reported(signal.name, signal.unit, place.start))
            for group, signal, place in scenario.layout(vehicle).signals()
            if signal.width == 1
        ]
        return cls(agent.name, tuple(signal for _, signal in sorted(known, key=lambda one: one[0] not in judged)))

    def values(self, telemetry: tuple[float, ...]) -> dict[str, SignalValue]:
        """The last report of the vehicle, by name; empty: it reports no more."""
        return {
            name: SignalValue(telemetry[place] if isfinite(telemetry[place]) else None, unit)
            for name, unit, place in (self.signals if telemetry else ())
        }
