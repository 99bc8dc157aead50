"""Faults that the seed draws, on a grid of times or as a swarm."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from fleet.scenario import value_types as v
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.schema.faults import FaultAction, read_fault
from fleet.scenario.value_types import Section, mistake
from netem.parsing import nearest

# What a condition of links may become; each is a kind of its own for a nemesis.
CONDITIONS = ("loss", "delay", "rate")
OF_TARGET = tuple(name for name, kind in KINDS.items() if kind.drawn == "target")  # the seed draws only their target
WORDS = (*OF_TARGET, *CONDITIONS, *(name for name, kind in KINDS.items() if kind.drawn == "strength"))
Aim = Literal["any", "leader", "hub", "bridge", "speaker"]


class NemesisPick(FaultAction):
    """A fault as it may come, or the name of one whose target, and perhaps strength, is drawn each time."""

    drawn: str | None = None


def _pick(value: Any) -> Any:
    if not isinstance(value, str):
        return read_fault(value)
    if value not in WORDS:
        hint = nearest(value, WORDS) or 'or a fault such as {link "*": loss 40%}'
        raise mistake(f"expected one of {', '.join(WORDS)}, got {value[:40]!r}", hint=hint)
    return {"drawn": value}


Picks = Annotated[list[Annotated[NemesisPick, BeforeValidator(_pick)]], Field(min_length=1)]


class NemesisSection(Section):
    """Random faults from the seed.

    Without `mode` one of `pick` begins in every period `every`, each for the time `for`. A swarm draws which kinds are
    on, and when, for how long and how strongly each fault holds. Episodes are a few faults in a unit of time of the
    protocol, with quiet times between them. Liveness is a swarm up to `heal`; then a core of
    vehicles has no fault any more, and all others stay broken to the end.
    """

    every: v.Period | None = None  # without mode
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # without mode
    pick: Picks | None = None  # with a mode: all kinds that fit the scenario
    start: v.Time | None = None  # the first fault begins; default: `every`, and 0 s with a mode
    until: v.Period | None = None  # when the last has ended; the end of the run, three quarters of it in a swarm
    mode: Literal["swarm", "episodes", "liveness"] | None = None
    most_silent: Annotated[int, Field(ge=1)] | None = None  # vehicles killed, suspended or mute at once; any number
    mean: v.Period | None = None  # time from one beginning to the next; the seed draws it
    aims: Annotated[list[Aim], Field(min_length=1)] | None = None  # all
    leader: Annotated[int, Field(ge=1)] | None = None  # vehicle that the aim `leader` means
    unit: v.Period | None = None  # episodes: lease_s or forget_after_s of the agent, drop_after, or ten rounds
    watch: Annotated[list[str], Field(min_length=1)] | None = None  # episodes: signals whose reports begin faults
    core: v.VehicleNumbers | None = None  # liveness: a drawn majority that links connect
    heal: v.Time | None = None  # liveness: half of the run
