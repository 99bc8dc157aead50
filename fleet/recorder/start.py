"""Where a run begins that goes on from another: what was run before, and up to when.

A run is a function of its scenario and seed. So a moment of a run is its scenario and a tick, and whoever wants to be
there runs to it (`fleet.execution.moments`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import msgspec

from fleet.scenario.scenario import Scenario


class Leg(NamedTuple):
    """A run, or the part of a run behind another leg, up to a tick."""

    scenario: Scenario
    until: int  # tick
    salt: int = 0  # changes the draws of world and network; 0: the draws of every run with this seed


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run begins that goes on from another."""

    legs: tuple[Leg, ...]  # each goes on where the one before ends
    source: str = ""  # the log, and its digest
    notes: tuple[str, ...] = ()
    recorded: Callable[[], Any] | None = None  # makes a `MessageSink` that compares the last leg with its log

    @property
    def tick(self) -> int:
        return self.legs[-1].until

    @property
    def before(self) -> Start | None:
        """Where the last leg begins; None: at t = 0."""
        return Start(self.legs[:-1]) if len(self.legs) > 1 else None

    def to_json(self) -> bytes:
        """The legs as a log keeps them: `[[scenario as YAML, tick], ...]`."""
        return msgspec.json.encode([[leg.scenario.to_yaml(), leg.until] for leg in self.legs])


def set_up_otherwise(now: Scenario, before: Scenario, i: int) -> bool:
    """Whether agent i differs in more than the seed between two scenarios, so that it cannot keep what it remembers."""
    config = now.agent_config(i)
    return replace(before.agent_config(i), seed=config.seed) != config
