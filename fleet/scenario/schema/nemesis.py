"""A nemesis: faults that the seed draws, on a grid of times or as a swarm."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field

from fleet.scenario.schema.faults import FaultAction, read_fault
from fleet.scenario.schema.section import Section
from fleet.scenario.schema.value_types import Period, Time, VehicleNumbers, mistake
from netem.parsing import nearest

# The kinds that need nothing but a target, which a nemesis draws.
DrawnKind = Literal["partition", "down", "mute", "deaf", "kill", "pause", "freeze", "off", "stuck"]
# The kinds of a swarm whose strength is drawn as well; loss, delay and rate are those of links.
StrongKind = Literal[
    "loss", "delay", "rate", "slow", "clock", "dvl", "compass", "fix", "bias", "noise", "dropout", "efficiency", "gust"
]
WORDS: tuple[str, ...] = (*get_args(DrawnKind), *get_args(StrongKind))
Aim = Literal["any", "leader", "hub", "bridge", "speaker"]


class NemesisPick(FaultAction):
    """A fault as it may come, or the name of one whose target, and perhaps strength, is drawn each time."""

    drawn: DrawnKind | StrongKind | None = None


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
    on, and when, for how long and how strongly each fault holds. Liveness is a swarm up to `heal`; then a core of
    vehicles has no fault any more, and all others stay broken to the end.
    """

    every: Period | None = None  # without mode
    for_: Annotated[Period | None, Field(alias="for")] = None  # without mode
    pick: Picks | None = None  # with a mode: all kinds that fit the scenario
    start: Time | None = None  # of the first; `every`, and 0 s with a mode
    until: Period | None = None  # when the last has ended; the end of the run, three quarters of it in a swarm
    mode: Literal["swarm", "liveness"] | None = None
    most_silent: Annotated[int, Field(ge=1)] | None = None  # vehicles killed, suspended or mute at once; any number
    mean: Period | None = None  # time from one beginning to the next; the seed draws it
    aims: Annotated[list[Aim], Field(min_length=1)] | None = None  # all
    leader: Annotated[int, Field(ge=1)] | None = None  # vehicle that the aim `leader` means
    core: VehicleNumbers | None = None  # liveness: a drawn majority that links connect
    heal: Time | None = None  # liveness: half of the run


def read_nemesis(value: Any) -> Any:
    """A nemesis may be given by its mode alone."""
    return {"mode": value} if isinstance(value, str) else value
