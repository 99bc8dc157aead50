"""Checks that are fed by hand: depths of three vehicles over 4 s, faults, and fates of packets."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from small_scenario import small

from fleet.checks.own_checks import OwnChecks
from fleet.checks.values import LoggedValues, Values
from fleet.result.verdict import Verdict
from fleet.scenario.sections.timeline import Event
from fleet.scenario.text.fault_words import entry_of_words
from netem.wire.messages import Fate

Depth = Callable[[int, float], float | None]  # of a vehicle at a time [s]; None: not reported
FAULTS = "faults=[{id: cut, at: 1 s, for: 1 s, down: 1->2}, {id: jam, at: 2500 ms, for: 500 ms, down: 2->3}]"


def fed(
    checks: str,
    depth: Depth,
    *,
    faults: str = "",
    fates: Iterable[Fate] = (),
    until_s: float = 4.0,
    at_once: bool = True,
    signal: str = "nav.z",
    names: str = "",
) -> list[Verdict]:
    """The verdicts of checks on `nav.z`, or on `error.e_norm`.

    Args:
        faults: a `--set` of the scenario. They happen as planned.
        fates: in the order of their final ticks.
        at_once: whether the checks judge only at the end.
        names: a `--set` of the scenario, which makes the three vehicles nodes.
    """
    scenario = small("duration=4 s", f"checks={{{checks}}}", *filter(None, [faults, names]))
    own = OwnChecks.from_scenario(scenario)
    events, waiting = list(scenario.faults.events), list(fates)
    verdicts: list[Verdict] = []
    for tick in range(round(until_s * 100) + 1):
        while events and events[0].tick <= tick:
            own.event(events.pop(0))
        found: dict[tuple[int, str], Values] = {}
        for i in (1, 2, 3):
            if (z := depth(i, tick / 100)) is not None:
                if signal == "nav.z":
                    found[i, "nav"] = (0.0, 0.0, z, *([0.0] * 7))
                else:
                    found[i, "error"] = (0.0, 0.0, 0.0, z, *([0.0] * 4))
        own.take(LoggedValues(tick, found))
        while waiting and waiting[0].final_tick <= tick:
            own.settle(waiting.pop(0))
        if not at_once:
            verdicts = own.verdicts(over=False)
    verdicts = own.verdicts(over=until_s == 4.0)
    assert own.verdicts(over=until_s == 4.0) == verdicts  # asking changes nothing
    return verdicts


def fate(src: int, dst: int, sent: int, cause: str = "delivered", *, final: int | None = None) -> Fate:
    """A packet's fate; ticks."""
    at = sent + 1 if final is None else final
    return Fate(at, src, dst, sent // 5, 0, sent, at, 0, cause, False, b"")


def begins(fault: str, tick: int, what: str = "down 1->2") -> Event:
    """The beginning of a fault."""
    return Event(tick, fault, "begins", what, entry_of_words(what))
