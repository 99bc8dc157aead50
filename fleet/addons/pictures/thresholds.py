"""The limits that a scenario's checks set for an error, drawn over the time at which they hold."""

from __future__ import annotations

from collections.abc import Sequence
from math import log10
from typing import NamedTuple

from matplotlib.axes import Axes

from fleet.addons.pictures.look import label_pt
from fleet.addons.pictures.runs import LoggedRun
from fleet.addons.pictures.shades import union
from fleet.addons.pictures.style import HALO, NORMAL
from fleet.scenario.schema.checks import EVERY, Below, Recovery

_FAR = 3.0  # times
_DECADES = 4.0
_LOW, _HIGH = 0.12, 0.88  # of an axis: beyond them words on a line are on that side of it where there is room


class Threshold(NamedTuple):
    """A signal is compared with a value, an error in m, in a time [s]."""

    value: float
    begin: float
    end: float
    words: str  # when, or of whom
    asked: str  # such as `below 0.5 m`


def thresholds(runs: Sequence[LoggedRun], error: str) -> list[Threshold]:
    """Those of the checks of all runs, each once. `error`: `formation` or `consensus`."""
    found: list[Threshold] = []
    for run in runs:
        if run.scenario is None:
            continue
        checks = run.scenario.spec.checks
        below: Below | None = getattr(checks, f"{error}_error")
        if below is not None:
            after = below.after / 1e9
            words = f"from {after:g} s{_of_vehicles(below.vehicles)}"
            found.append(Threshold(below.below, after, run.log.end, words, _below(below.below)))
        for check in checks.recovery_time or ():
            if check.error == error:
                found += _recoveries(check, run)
    return list(dict.fromkeys(one for one in found if one.begin < one.end))


def age_limits(runs: Sequence[LoggedRun]) -> list[Threshold]:
    """The ages [s] that the checks of all runs allow, each once."""
    found = []
    for run in runs:
        check = run.scenario.spec.checks.max_age if run.scenario is not None else None
        if check is not None:
            of = "" if check.links == "*" else f", links {check.links}"
            words = f"from {check.after / 1e9:g} s{of}"
            below = check.below / 1e9
            found.append(Threshold(below, check.after / 1e9, run.log.end, words, f"below {below:g} s"))
    return list(dict.fromkeys(one for one in found if one.begin < one.end))


def _recoveries(check: Recovery, run: LoggedRun) -> list[Threshold]:
    faults = run.log.faults
    allowed = check.below / 1e9
    found = []
    for fault in faults:
        if check.fault in (EVERY, fault.id) and fault.end < run.log.end:
            later = (other.begin for other in faults if other.id != fault.id and other.begin >= fault.end)
            words = f"{allowed:g} s after {fault.id}{_of_vehicles(check.vehicles)}"
            end = min(later, default=run.log.end)
            found.append(Threshold(check.within, fault.end + allowed, end, words, _below(check.within)))
    return found


def _below(value: float) -> str:
    return f"below {value:g} m"


def _of_vehicles(vehicles: str | None) -> str:
    return "" if vehicles is None else f", UUV {vehicles}"


def draw_thresholds(ax: Axes, asked: Sequence[Threshold]) -> list[str]:
    """A heavy dashed line where each holds, and its words at the line's end; those of one value together. A limit that
    is far from all values would leave them no room: words on it are returned instead.
    """
    first, last = ax.get_xlim()
    shown = [one for one in asked if one.begin < last and one.end > first]
    far = [value for value in dict.fromkeys(one.value for one in shown) if _is_far(ax, value)]
    outside = [f"outside: {_words([one for one in shown if one.value == value])}" for value in far]
    shown = [one for one in shown if one.value not in far]
    for k, value in enumerate(sorted({one.value for one in shown})):
        same = [one for one in shown if one.value == value]
        for begin, end in union([(max(one.begin, first), min(one.end, last)) for one in same]):
            ax.plot([begin, end], [value, value], color="black", linewidth=NORMAL,
                    linestyle=(0, (3, 1.5)), zorder=4, gid="check")  # fmt: skip
        low_down = k == 0 and len(shown) > len(same)
        va, off = ("top", -2) if (low_down or _share(ax, value) > _HIGH) and _share(ax, value) > _LOW else ("bottom", 2)
        ax.annotate(
            _words(same), (1.0, value), xycoords=("axes fraction", "data"), xytext=(-2, off),
            textcoords="offset points", ha="right", va=va, fontsize=label_pt(), zorder=5, gid="check-name",
            path_effects=HALO,
        )  # fmt: skip
    return outside


def _words(same: Sequence[Threshold]) -> str:
    words = list(dict.fromkeys(one.words for one in same))
    some = "; ".join(words[:2]) + (f"; and {len(words) - 2} more" if len(words) > 2 else "")
    return " ".join(filter(None, ("check:", same[0].asked, some)))


def _share(ax: Axes, value: float) -> float:
    """How high in the axis a value is, 0 to 1."""
    low, high, at = ax.yaxis.get_transform().transform([*ax.get_ylim(), value])
    return float((at - low) / (high - low))


def _is_far(ax: Axes, value: float) -> bool:
    """Whether a limit would squeeze the lines of an axis into a third of it, and is of another size than they are."""
    if not ax.lines and not ax.collections:
        return False
    low, high = ax.get_ylim()
    if ax.get_yscale() == "log":
        if value <= 0.0:
            return True
        low, high, value = log10(low), log10(high), log10(value)
        alike = low - _DECADES <= value <= high + _DECADES
    else:
        alike = abs(value) <= _FAR * max(abs(low), abs(high))
    return not alike and max(high, value) - min(low, value) > _FAR * (high - low)
