"""An operator who is faster than a shell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from live import READY_S, LiveRun
from tool import tool
from waiting import wait_for

from fleet.execution.connection import ask, find


def began(live: LiveRun) -> Hand:
    """The hand of an operator of a run that has begun."""
    wait_for(lambda: live.over or tool(live.out, "status").exit_code == 0, READY_S, "the run to begin")
    assert not live.over, live.printed
    return Hand(live.out)


def held(live: LiveRun) -> Hand:
    """The same hand, which holds the clock from then on, so that nothing need be quick."""
    hand = began(live)
    hand.clock("pause")
    return hand


class Hand:
    """Does to the newest run under a directory what `fleet inject`, `heal`, `clock` and `status` do."""

    def __init__(self, out: Path) -> None:
        self.run = find(str(out / "latest"))

    def inject(self, **fault: Any) -> dict[str, Any]:
        return ask(self.run, "inject", fault=fault)

    def heal(self, name: str | None = None) -> list[str]:
        return list(ask(self.run, "heal", id=name)["healed"])

    def clock(self, do: str, value: float | None = None) -> None:
        ask(self.run, "clock", do=do, value=value)

    def now(self) -> float:
        return float(ask(self.run, "status")["at_s"])

    def until(self, sim_s: float) -> None:
        wait_for(lambda: self.now() >= sim_s, 60.0, f"{sim_s:g} s")

    def step(self, ticks: int) -> None:
        """Let a clock that is held go on for so many ticks; it does so meanwhile."""
        self.clock("step", ticks)

    def pause_at_round(self) -> None:
        """Hold the clock with the grant at a round tick."""
        self.clock("pause")
        while True:
            granted = round(float(ask(self.run, "clock", do="pause", value=None)["at_s"]) / 0.01)
            wait_for(lambda: round(self.now() / 0.01) == granted - 1, 60.0, "the clock to hold")  # noqa: B023
            if granted % 10 == 0:
                return
            self.step(10 - granted % 10)
