"""The care of agents' lives in a distributed run: who ended, who is to end, and who takes over.

The console hands in exits of processes and asks, between two grants, what is to be done. World and netem are told of
every life by tick, so that all three agree on who has an agent when (`netem.lives`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import agents.process
import world.process
from fleet.errors import RunBroken
from fleet.processes.children import FORKSERVER_LOST, Children, Exit, describe_exit
from fleet.recorder.journal import Journal
from fleet.run.external_agents import ExternalAgents
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import MOST_RESTARTS, Kill
from netem.lives import Absence, Lives
from netem.wire.access import NETEM, agent_role
from netem.wire.codec import encode
from netem.wire.messages import Death, Restart

WORLD = world.process.WORLD
CONTROLLER_FAILED = agents.process.CONTROLLER_FAILED
POLL_S = 0.02


Ask = Callable[..., dict[str, Any]]  # (role, operation, **fields) to the answer, an empty map when there is none


class Supervisor:
    """Tends the agents of one run. Everything happens on the console's main thread."""

    def __init__(
        self,
        scenario: Scenario,
        journal: Journal,
        children: Children,
        external: ExternalAgents,
        notes: list[str],
        granted: Callable[[], int],
        start: Callable[[int, int, int], None],
    ) -> None:
        """Args:
        notes: told how agents ended.
        granted: ticks below it may have been started.
        start: starts an agent again, given vehicle, incarnation and first tick.
        """
        self._scenario, self._journal, self._children, self._external = scenario, journal, children, external
        self._notes, self._granted, self._start = notes, granted, start
        self._vehicles = tuple(range(1, scenario.vehicles + 1))
        self._grant: Callable[[bytes], None] | None = None  # None before the first grant: no agent may end
        self._ask: Ask = _nobody
        self._lives = Lives(scenario.faults.absences)
        self._incarnation = dict.fromkeys(self._vehicles, 0)  # of the agent that was started last
        self.starting: dict[int, int] = {}  # vehicle -> tick of the agent that was started again and is not ready
        self._looked = 0.0
        self._told_to_end: set[int] = set()  # vehicles whose agent, the one that was started last, is to go
        self._gone: set[int] = set()  # and whose has gone
        self._restarted: dict[int, int] = {}  # vehicle -> how often because of on_death
        self.deaths: dict[int, list[str]] = {}  # how agents ended that nobody told to

    def connect(self, grant: Callable[[bytes], None], ask: Ask) -> None:
        """The run begins: `grant` puts on the key of the grants, `ask` asks world and netem."""
        self._grant, self._ask = grant, ask

    def without_agent(self) -> list[int]:
        """The vehicles that have no agent now."""
        return [i for i in self._vehicles if self._lives.without_agent(i, max(0, self._journal.framed))]

    def end_agents(self, kill: Kill) -> None:
        """An operator ends agents."""
        for absence in kill.absences:
            self._lives.add(absence)
            self._tell_world(Death(absence.vehicle, kill.begin, 0, kill.end or 0))
        self._tell_netem()

    def restart_agent(self, i: int, begin: int, tick: int) -> None:
        """An operator has an agent, that is missing since `begin`, begin again at a tick."""
        self._lives.restart(i, begin, tick)
        self._tell_world(Restart(i, begin, tick))
        self._tell_netem()

    def next_restart(self) -> int:
        """No tick from here on may start: somebody who begins there is not ready yet."""
        planned = [gap[1] for i in self._vehicles if (gap := self._gap(i)) is not None and gap[1] is not None]
        return min([*planned, *self.starting.values()], default=self._scenario.ticks)

    def bury(self, ended: Exit) -> bool:
        """Take that a process is gone; False if the run cannot go on without it.

        If it is an agent that nobody told to go, the world is told, which decides at which tick it ended.
        """
        if not ended.role.startswith("agent-"):
            return False
        i = int(ended.role.removeprefix("agent-"))
        if i not in self._told_to_end:
            if not self._survivable(ended):
                return False
            child = self._children.by_role[ended.role]
            how = describe_exit(ended.code)
            last = f"; last line of {child.log_path}: {line}" if (line := "".join(child.tail()[-1:])) else ""
            self._end(i, f"agent {i} (pid {child.pid}) {how}", how, last)
        self._gone.add(i)
        return True

    def left(self, i: int) -> bool:
        """Take that an external agent's token is gone; False if the run cannot go on without it."""
        if self._grant is None or i in self.starting or i in self._gone:
            return True  # another one may join in its place, or it had its time
        if self._scenario.spec.on_death == "abort":
            return False
        self._end(i, f"agent {i} (external) left", "left: its session ended", "")
        self._gone.add(i)
        return True

    def came(self, i: int) -> None:
        """Take that an external agent's token is there: one whose life is over is told so, or it would hold the place.

        A session whose link was cut links again by itself, with its token, and what it missed is lost.
        """
        over = self._incarnation[i] - (i not in self._gone)
        if self._grant is not None and over >= 0:
            self._ask(WORLD, "dismiss", agents=[[i, over, 0]], reason="its link had ended, and its life with it")

    def dismiss(self, reason: str) -> None:
        """Tell the external agents that are there that no nav will follow."""
        here = [[i, self._incarnation[i], 0] for i in self._external.vehicles if self._external.here(i)]
        if here:
            self._ask(WORLD, "dismiss", agents=here, reason=reason)

    def _end(self, i: int, who: str, how: str, last: str) -> None:
        """An agent has ended that nobody told to."""
        life = self._incarnation[i]
        gap = self._gap(i)
        begin = self.starting.pop(i, None)
        until = 0
        if gap is None or gap[0] > self._granted():
            again = self._scenario.spec.on_death == "restart" and i not in self._journal.diverged
            if again and self._restarted.get(i, 0) < MOST_RESTARTS:
                self._restarted[i] = self._restarted.get(i, 0) + 1
                until = self._scenario.next_round(self._granted())
            # The world will say when it was; here it matters only when another one takes over.
            since = max(self._journal.framed, 0 if life == 0 else self._lives.gaps(i)[life - 1][1] or 0)
            self._lives.add(Absence(i, since, until or (gap and gap[1])))
        # One that has not been ready never got a nav: its life ends where it would have begun.
        self._tell_world(Death(i, begin or 0, life, until))
        if until:
            self._tell_netem()
        self.deaths.setdefault(i, []).append(how)
        at = self._seconds(self._journal.framed)
        then = f", another one takes over at {self._seconds(until)}" if until else ""
        fate = "is not integrated any more" if i in self._journal.diverged else f"drifts without thrust{then}"
        self._notes.append(f"{at} {who}: its vehicle {fate}{last}")

    def tend(self) -> None:
        """End the agents whose time has come, and start those that follow them."""
        if not self._lives.absences or time.monotonic() < self._looked + POLL_S:
            return
        self._looked = time.monotonic()
        if self.starting:
            ready = {(i, life) for i, life in self._ask(WORLD, "ready").get("ready", ())}
            for i in [i for i in self.starting if (i, self._incarnation[i]) in ready]:
                if i not in self._external.vehicles or self._external.here(i):
                    del self.starting[i]
                    self._external.joined(i)
        granted = self._granted()
        due = {i: gap for i in self._vehicles if (gap := self._gap(i)) is not None and gap[0] <= granted}
        alive = [i for i in due if i not in self._told_to_end | self._gone]
        # The world asks nobody for a command from the gap's first tick on: once it is there, nothing is lost.
        reached = dict(self._ask(WORLD, "ticks").get("ticks", ())) if alive else {}
        for i, (begin, end) in due.items():
            if i in alive and i not in self.starting and reached.get(i, -1) >= begin:
                self._told_to_end.add(i)
                self._send_away(i, begin)
            elif i in self._gone and end is not None and end <= granted:
                # Not before: until the clock waits there, an operator may still move that tick, and it is told which.
                self._told_to_end.discard(i)
                self._gone.discard(i)
                self._incarnation[i] += 1
                self.starting[i] = end
                self._start(i, self._incarnation[i], end)

    def _send_away(self, i: int, tick: int) -> None:
        """End the agent of a vehicle; one that is not ours is told, and not listened to any more."""
        if i in self._external.vehicles:
            life = [[i, self._incarnation[i], tick]]
            self._ask(WORLD, "dismiss", agents=life, reason="it was killed by a fault of the scenario or the operator")
            self._gone.add(i)
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._children.by_role[agent_role(i)].pid, signal.SIGKILL)

    def _survivable(self, ended: Exit) -> bool:
        """Whether the run goes on without this process."""
        return (
            self._grant is not None
            and self._scenario.spec.on_death != "abort"
            and ended.code != FORKSERVER_LOST
            and (ended.code != CONTROLLER_FAILED or self._scenario.spec.on_controller_error == "die")
        )

    def _gap(self, i: int) -> tuple[int, int | None] | None:
        """How the life of agent i that was started last ends, if it does: (begin, end) of the gap after it."""
        gaps = self._lives.gaps(i)
        life = self._incarnation[i]
        return gaps[life] if life < len(gaps) else None

    def _tell_world(self, message: Death | Restart) -> None:
        assert self._grant is not None  # nobody ends before the run begins
        self._grant(encode(message))

    def _tell_netem(self) -> None:
        """Netem must know which life of an agent it talks to."""
        if "tick" not in self._ask(NETEM, "absences", absences=[list(a) for a in self._lives.absences]):
            raise RunBroken("netem did not answer")

    def _seconds(self, tick: int) -> str:
        return f"t = {max(0, tick) * self._scenario.tick_ns / 1e9:.2f} s (tick {max(0, tick)})"


def _nobody(role: str, op: str, **fields: Any) -> dict[str, Any]:
    raise AssertionError("the run has not begun yet")
