"""A verdict: one check with what was asked and found, and the moment at which it failed."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import Any

from fleet.quantities import vehicle_names
from netem.causes import Cause


@dataclass(frozen=True, slots=True)
class LastMessage:
    """The message that made the difference to a vehicle, as far as that can be told; times in s."""

    src: int
    dst: int
    sent_s: float
    at_s: float  # when its fate became final
    fate: str
    heard_s: float | None  # when the newest that arrived on this link had been sent; None: nothing has

    @property
    def words(self) -> str:
        """In words."""
        link, when = f"{self.src}->{self.dst}", f"sent at {self.sent_s:g} s"
        if self.fate == Cause.DELIVERED:
            return f"the last message that vehicle {self.dst} received: {link}, {when}, due at {self.at_s:g} s"
        heard = "nothing before" if self.heard_s is None else f"the last before from {self.heard_s:g} s"
        return f"the last message that vehicle {self.dst} missed: {link}, {when}, {self.fate}; it had {heard}"


@dataclass(frozen=True, slots=True)
class Moment:
    """When a check failed, and what was so then."""

    tick: int
    at_s: float
    vehicles: list[int] = field(default_factory=list)  # whose signals failed it
    values: dict[str, float | None] = field(default_factory=dict)  # of what failed it, by name; None: not finite
    faults: list[str] = field(default_factory=list)  # ids of those that were active
    message: LastMessage | None = None

    @property
    def words(self) -> str:
        """What was so, in words; empty: nothing to tell."""
        faults = ", ".join(self.faults[:4]) + (f" and {len(self.faults) - 4} more" if len(self.faults) > 4 else "")
        active = f"fault{'s' if len(self.faults) > 1 else ''} {faults} active" if self.faults else "no fault active"
        return "; ".join([active, *([] if self.message is None else [self.message.words])])


@dataclass(frozen=True, slots=True)
class Verdict:
    """One check: what was asked and what was found, in words and as numbers."""

    check: str
    passed: bool
    asked: str
    found: str
    value: float | None = None  # what is compared with the limit; None where there was nothing to judge
    limit: float | None = None
    unit: str = ""
    moment: Moment | None = None  # at which it failed, where that is known
    signals: tuple[str, ...] = ()  # that it looked at, by name; of a check that is the user's own

    def to_values(self) -> dict[str, Any]:
        """Plain values; JSON knows no infinity, so that is None as well."""
        values = asdict(self)
        return (
            values
            | {"signals": list(self.signals)}
            | {"value": self.value if self.value is not None and isfinite(self.value) else None}
        )


def who(vehicles: list[int]) -> str:
    """` (vehicle 3)`, or nothing if no vehicle is named."""
    return f" ({vehicle_names(vehicles)})" if vehicles else ""
