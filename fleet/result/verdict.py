"""A verdict: one check with its limit, its finding, and the time at which it failed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Annotated

from msgspec import Meta, Struct
from msgspec.structs import replace

from fleet.quantities import vehicle_name, vehicle_names
from netem.cause import Cause


class LastMessage(Struct, frozen=True):
    """The message that made the difference to a vehicle when a check failed, as far as that can be told."""

    src: int
    dst: int
    sent_s: float
    at_s: float
    fate: Annotated[str, Meta(description="delivered, corrupted, in flight, or the cause of its loss.")]
    heard_s: Annotated[
        float | None, Meta(description="When the newest that arrived on this link had been sent [s]; null: none has.")
    ]
    silent: Annotated[bool, Meta(description="Whether its sender was gone or paused when the check failed.")] = False

    def words(self, names: Sequence[str] = ()) -> str:
        """In words; `names`: of nodes, if there are some."""
        src, dst = (vehicle_names([i], names) for i in (self.src, self.dst))
        if self.silent:
            last = "nothing" if self.heard_s is None else f"what it sent at {self.heard_s:g} s"
            return f"{src} sends no more, and the last that {dst} has of it is {last}"
        link = f"{vehicle_name(self.src, names)}->{vehicle_name(self.dst, names)}"
        when = f"sent at {self.sent_s:g} s"
        if self.fate == Cause.DELIVERED:
            return f"the last message that {dst} received: {link}, {when}, due at {self.at_s:g} s"
        heard = "nothing before" if self.heard_s is None else f"the last before from {self.heard_s:g} s"
        return f"the last message that {dst} missed: {link}, {when}, {self.fate}; it had {heard}"


class Moment(Struct, frozen=True):
    """When a check failed, and what was so then."""

    tick: int
    at_s: Annotated[float, Meta(ge=0.0, le=1e15)]
    vehicles: Annotated[list[int], Meta(description="Those that failed it.")] = []
    values: Annotated[dict[str, float | None], Meta(description="What failed it, by signal.")] = {}
    faults: Annotated[list[str], Meta(description="Active ones, by id.")] = []
    message: LastMessage | None = None

    def words(self, names: Sequence[str] = ()) -> str:
        """The circumstances of the failure, in words; `names`: of nodes, if there are some."""
        faults = ", ".join(self.faults[:4]) + (f" and {len(self.faults) - 4} more" if len(self.faults) > 4 else "")
        active = f"fault{'s' if len(self.faults) > 1 else ''} {faults} active" if self.faults else "no fault active"
        return "; ".join([active, *([] if self.message is None else [self.message.words(names)])])


class Margin(Struct, frozen=True):
    """By how much a check holds: below 0 it fails, above 0 it passes, and 0 tells nothing."""

    value: Annotated[float, Meta(description="How far it is from failing; negative: from passing.")]
    unit: str = "1"
    at_s: Annotated[float | None, Meta(description="When it was least; null: at no one time.")] = None

    @property
    def words(self) -> str:
        return f"{self.value:.3g}" + ("" if self.unit == "1" else f" {self.unit}")


class Verdict(Struct, frozen=True):
    """One check: what was asked and what was found, in words and as numbers."""

    check: str
    passed: bool
    asked: str
    found: str
    value: Annotated[float | None, Meta(description="The number that is compared; null: nothing was found.")] = None
    limit: Annotated[float | None, Meta(description="null: it is only reported.")] = None
    unit: str = ""
    moment: Annotated[Moment | None, Meta(description="When it failed first; null: it did not, or at no one time.")] = (
        None
    )
    signals: Annotated[
        tuple[str, ...], Meta(description="Of one of your own checks, the signals that it looked at.")
    ] = ()
    margin: Margin | None = None

    reached: Annotated[
        bool | None, Meta(description="Of a check with `sometimes`: whether it was reached; null: of any other.")
    ] = None
    judged: Annotated[
        bool, Meta(description="False: the run ended too early to tell. Then it has not passed, and not failed.")
    ] = True

    @property
    def outcome(self) -> bool | None:
        """Whether it passed; None: it was not judged."""
        return bool(self.passed) if self.judged else None

    @property
    def failed(self) -> bool:
        return self.outcome is False

    @property
    def mark(self) -> str:
        """How it ended, as tables have it."""
        return "FAIL" if self.failed else "pass" if self.passed else "not judged"

    @property
    def words(self) -> str:
        """The finding and the margin. A margin of 0 is left out."""
        return self.found + (f"; margin {self.margin.words}" if self.margin is not None and self.margin.value else "")

    def with_margin(self, value: float | None, unit: str, at_s: float | None = None) -> Verdict:
        """The same with a margin, whose sign is never that of the other verdict."""
        if value is None or not isfinite(value) or not self.judged:
            return self
        value = max(value, 0.0) if self.passed else min(value, 0.0)
        return replace(self, margin=Margin(value, unit, at_s))

    def of_sometimes(self, reached: bool) -> Verdict:
        """The verdict of what some run of many must reach: no run fails for it."""
        found = f"reached: {self.found}" if reached else "not reached in this run"
        return Verdict(self.check, True, self.asked, found, signals=self.signals, reached=reached)


def sort_failed_first(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """Those that failed, those that were not judged, and those that passed."""
    return sorted(verdicts, key=lambda one: (not one.failed, one.judged))


def who(vehicles: Sequence[int], names: Sequence[str] = ()) -> str:
    """` (vehicle 3)`, with the names of nodes ` (auv3)`, or nothing if there is none."""
    return f" ({vehicle_names(vehicles, names)})" if vehicles else ""
