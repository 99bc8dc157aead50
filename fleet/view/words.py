"""The commands behind the buttons: every action on the page is one of the command line, shown to be copied."""

from __future__ import annotations

import shlex
from typing import Any

from fleet.errors import FleetError
from fleet.execution.operator import checked_fault
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.fault_words import read_fault

_BY_DEFAULT = {
    "link": {"cut": "down {0}", "delay": "link {0} delay 500ms", "lose": "link {0} loss 30%",
             "both": "link {0} delay 500ms 100ms loss 30%"},
    "vehicle": {"kill": "kill {0}", "pause": "pause {0}", "mute": "mute {0}", "deaf": "deaf {0}",
                "freeze sensors": "freeze {0}", "weaken": "efficiency vehicles={0} surge=50%"},
    "fleet": {"halves": "partition halves", "one": "partition one", "majority": "partition majority",
              "ring": "partition ring", "bridge": "partition bridge", "current": "current 0.2 0 0 m/s",
              "gust": "gust velocity=0 0.5 0 m/s over=10s"},
}  # fmt: skip


def suggestions(kind: str, target: str) -> dict[str, str]:
    """Faults of a link (`1->2`, `1<->2`), a vehicle or the fleet, as words, by what to call them."""
    return {name: words.format(target) for name, words in _BY_DEFAULT[kind].items()}


def entry(words: str, lasts: str, scenario: Scenario, tick: int) -> dict[str, Any]:
    """The fault that words describe, checked by the rules of scenarios as if it began at a tick.

    Args:
        lasts: how long, as `10s`; empty: until healed.

    Raises:
        FleetError: it is none, or not for this scenario; the text says what is wrong.
    """
    found = read_fault(words)
    if lasts.strip():
        if "for" in found:
            raise FleetError(f"the fault says for {found['for']} already")
        found["for"] = lasts.strip()
    checked_fault(found, tick, scenario)
    return found


def inject(words: str, lasts: str, run: str) -> str:
    """The command that injects a fault."""
    more = ["--for", lasts.strip()] if lasts.strip() else []
    options, fault = [*more, "--run", run], words.split()
    if any(word.startswith("-") for word in fault):  # a number below zero is no option
        return shlex.join(["fleet", "inject", *options, "--", *fault])
    return shlex.join(["fleet", "inject", *fault, *options])


def heal(name: str | None, run: str) -> str:
    """The command that heals a fault, or all."""
    return shlex.join(["fleet", "heal", *([name] if name else []), "--run", run])


def clock(do: str, value: float | None, run: str) -> str:
    """The command that holds, steps or paces a run."""
    number = "max" if do == "speed" and value is None else "" if value is None else f"{value:g}"
    return shlex.join(["fleet", "clock", do, *([number] if number else []), "--run", run])


def partition(groups: list[list[int]]) -> str:
    """The words that cut the fleet into groups."""
    return f"partition {' / '.join(','.join(map(str, group)) for group in groups)}"
