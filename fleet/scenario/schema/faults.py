"""Faults at given times."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, create_model

from fleet.scenario import value_types as v
from fleet.scenario.faults.kind import FaultKind
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.faults.of_motion import CurrentSection, CurrentValue
from fleet.scenario.schema.checks import OnlyTrue, Quantity
from fleet.scenario.value_types import Section, mistake
from netem.parsing import nearest


class SeaSection(Section):
    """The forces of the sea on every vehicle."""

    disturbance: Literal["none", "paper"] = "none"
    current: CurrentValue = CurrentSection.model_construct()


FaultId = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")]


class FaultTimes(Section):
    """When a fault begins, and for how long it lasts. It always ends, at the latest with the run."""

    id: FaultId | None = None  # f1, f2, ...
    at: v.Time
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # to the end


ACTIONS = tuple(KINDS)
_FIELDS: dict[str, Any] = {name: (kind.value | None, None) for name, kind in KINDS.items()}
_Effect: Any = create_model("_Effect", __base__=Section, **_FIELDS)


class FaultAction(_Effect):
    """The effect of a fault: the entry gives exactly one of these keys, each the name of a kind."""

    @property
    def kind(self) -> FaultKind:
        """The kind of a valid fault."""
        return next(kind for name, kind in KINDS.items() if getattr(self, name) is not None)

    @property
    def values(self) -> Any:
        """What a valid fault has behind the name of its kind."""
        return getattr(self, self.kind.name)


class FaultSection(FaultAction, FaultTimes):
    """One fault."""


def read_fault(value: Any) -> Any:
    """`link 1->2: loss 30%` is short for `link: {1->2: loss 30%}`."""
    if not isinstance(value, dict):
        return value
    long: dict[str, Any] = {}
    for key, inner in value.items():
        if isinstance(key, str) and key.startswith("link ") and "link" not in value:
            long.setdefault("link", {})[key.removeprefix("link ").strip(" \"'")] = inner
        else:
            long[key] = inner
    return long


FaultEntry = Annotated[FaultSection, BeforeValidator(read_fault)]


# --- triggers: faults that begin when an agent reports something


class WhenSection(Section):
    """A moment in what agents report: one condition begins to hold, or a value changes.

    A condition that holds in the first sample begins there.
    """

    topic: str  # topic group, dot, field: control.leads
    vehicles: v.VehicleNumbers | None = None  # whose reports count; all
    above: Quantity | None = None
    below: Quantity | None = None
    equals: Quantity | None = None
    changes: OnlyTrue = None
    after: v.Time = 0  # earlier samples do not count
    before: v.Period | None = None  # nor those from then on; to the end


class TriggerSection(Section):
    """A fault that begins some time after such a moment; at most once in a run."""

    id: FaultId | None = None  # t1, t2, ...
    when: WhenSection
    nth: Annotated[int, Field(ge=1)] = 1  # which of these moments, in the order of time and vehicles
    wait: v.Period | None = None  # from the moment on; a round, which is also the least
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # to the end
    fault: dict[str, Any]  # as in `faults`; itself, others and neighbours stand for numbers


# --- nemesis: faults that the seed draws, on a grid of times or as a swarm


# What a condition of links may become; each is a kind of its own for a nemesis.
CONDITIONS = ("loss", "delay", "rate")
OF_TARGET = tuple(name for name, kind in KINDS.items() if kind.drawn == "target")  # and nothing else is drawn
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
    start: v.Time | None = None  # of the first; `every`, and 0 s with a mode
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
