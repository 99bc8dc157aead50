"""The supervisor of agents' lives in a distributed run: who ended, who is to end, and who takes over.

World and netem receive every life by tick, so that all three agree on who has an agent when (`netem.lives`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import time

import agents.process
from fleet.errors import RunBroken
from fleet.execution.external_agents import ExternalAgents
from fleet.execution.fleet import Fleet
from fleet.execution.hosting import Hosting
from fleet.execution.notes import Notes, tick_text
from fleet.processes.children import FORKSERVER_LOST, Children, Exit, describe_exit
from fleet.recorder.journal import Journal
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import MOST_RESTARTS, Kill
from netem.lives import Absence, Lives
from netem.wire.access import WORLD, agent_role
from netem.wire.messages import Death, Restart

CONTROLLER_FAILED = agents.process.CONTROLLER_FAILED
POLL_S = 0.02


class Supervisor:
    """Ends and restarts the agents of one run. Everything happens on the console's main thread.

    An agent's lives count from 0. It is *ended* when the scenario or the operator wants its vehicle without an agent;
    when it ends by itself, that is a *death*, and the scenario's `on_death` says what follows.
    """

    def __init__(
        self,
        fleet: Fleet,
        scenario: Scenario,
        journal: Journal,
        children: Children,
        external: ExternalAgents,
        notes: Notes,
        hosting: Hosting,
    ) -> None:
        self._hosting = hosting
        self._fleet, self._scenario, self._journal = fleet, scenario, journal
        self._children, self._external, self._notes = children, external, notes
        self._vehicles = tuple(range(1, scenario.vehicles + 1))
        self._lives = Lives(scenario.faults.absences)
        self._incarnation = dict.fromkeys(self._vehicles, 0)  # of the agent that was started last
        self.starting: dict[int, int] = {}  # vehicle -> tick of the agent that was started again and is not ready
        self._polled_s = 0.0
        self._ending: set[int] = set()  # vehicles whose agent, the one that was started last, was asked to end
        self._gone: set[int] = set()  # and whose has ended
        self._restarts: dict[int, int] = {}  # vehicle -> how often because of on_death
        self.deaths: dict[int, list[str]] = {}  # vehicle -> how its agents died

    def without_agent(self) -> list[int]:
        """The vehicles that have no agent now."""
        return [i for i in self._vehicles if self._lives.without_agent(i, max(0, self._journal.framed))]

    def end_agents(self, kill: Kill) -> None:
        """End agents because the operator asks for it."""
        for absence in kill.absences:
            self._lives.add(absence)
            self._fleet.announce(Death(absence.vehicle, kill.begin, 0, kill.end))
        self._fleet.set_absences(self._lives.absences)

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        """Start vehicle i's agent again at a tick because the operator asks for it.

        Args:
            i: number of the vehicle.
            begin: it has been missing since this tick. None: the tick does not matter.
            tick: it begins at this tick.
        """
        self._lives.restart(i, begin, tick)
        self._fleet.announce(Restart(i, begin, tick))
        self._fleet.set_absences(self._lives.absences)

    def next_restart(self) -> int:
        """The first begin of an agent that is not ready yet, as a tick. The clock stops before it."""
        planned = [gap[1] for i in self._vehicles if (gap := self._gap(i)) is not None and gap[1] is not None]
        return min([*planned, *self.starting.values()], default=self._scenario.ticks)

    def ended(self, exit_: Exit) -> bool:
        """Record that a process ended. False: the run cannot go on without it.

        If an agent died, the world decides the tick of its death.
        """
        own = [*self._hosting.agents(exit_.role)]
        if not own:
            return False
        if exit_.role != agent_role(own[0]):  # of a host; those that were started again are elsewhere
            own = [i for i in own if not self._incarnation[i] and i not in self._gone]
        died = [i for i in own if i not in self._ending]
        if died and not self._survivable(exit_):
            return False
        child = self._hosting.children(self._children.by_role)[exit_.role]
        how, where = describe_exit(exit_.code), f"pid {child.pid}"
        if child.role != agent_role(own[0] if own else 0):
            where = f"{child.role}, {where}"
        if computing := self._fleet.computing(exit_.role):
            how += f" while agent {computing} computed"
        last = f"; last line of {child.log_path}: {line}" if (line := "".join(child.tail()[-1:])) else ""
        for i in died:
            self._died(i, f"agent {i} ({where}) {how}", how, last)
        self._gone.update(own)
        return True

    def registered(self, i: int) -> None:
        """Record that an external agent's liveliness token appeared.

        A session whose link was cut links again by itself, with its token, but what it missed is lost. So an agent
        whose life is over is dismissed; otherwise it would keep others from joining.
        """
        self._external.token(i, True)
        over = self._incarnation[i] - (i not in self._gone)
        if self._fleet.begun and over >= 0:
            self._dismiss(i, over, 0, "its link had ended, and its life with it")

    def unregistered(self, i: int) -> None:
        """Record that an external agent's liveliness token disappeared.

        Raises:
            RunBroken: the agent died, and the run does not go on without it.
        """
        was_there = self._external.present(i)
        self._external.token(i, False)
        if not was_there:
            return
        if not self._fleet.begun:
            self._external.expect(i, 0, 0)  # another one may join in its place
        elif i not in self.starting and i not in self._gone:
            if self._scenario.spec.on_death == "abort":
                raise RunBroken(f"agent {i} (external) left at {self._now()}")
            self._died(i, f"agent {i} (external) left", "left: its session ended", "")
            self._gone.add(i)

    def dismiss_external(self, reason: str) -> None:
        """Notify the external agents that have joined that no nav will follow."""
        joined = [[i, self._incarnation[i], 0] for i in self._external.vehicles if self._external.present(i)]
        if joined:
            self._fleet.ask(WORLD, "dismiss", agents=joined, reason=reason)

    def poll(self) -> None:
        """End the agents whose time has come, and start their successors; cheap when nothing is due."""
        if not self._lives.absences or time.monotonic() < self._polled_s + POLL_S:
            return
        self._polled_s = time.monotonic()
        if self.starting:
            self._note_ready()
        granted = self._fleet.granted
        due = {i: gap for i in self._vehicles if (gap := self._gap(i)) is not None and gap[0] <= granted}
        alive = [i for i in due if i not in self._ending | self._gone]
        # The world asks for no command from the gap's first tick on: once it has reached it, nothing is lost.
        reached = dict(self._fleet.ask(WORLD, "ticks").get("ticks", ())) if alive else {}
        for i, (begin, end) in due.items():
            if i in alive and i not in self.starting and reached.get(i, -1) >= begin:
                self._ending.add(i)
                self._end(i, begin)
            elif i in self._gone and end is not None and end <= granted:
                # Not before: until the clock waits at that tick, an operator may still move it.
                self._ending.discard(i)
                self._gone.discard(i)
                self._incarnation[i] += 1
                self.starting[i] = end
                self._fleet.start_agent(i, self._incarnation[i], end)

    def _note_ready(self) -> None:
        ready = {(i, life) for i, life in self._fleet.ask(WORLD, "ready").get("ready", ())}
        for i in [i for i in self.starting if (i, self._incarnation[i]) in ready]:
            if i not in self._external.vehicles or self._external.present(i):
                del self.starting[i]
                self._external.joined(i)

    def _died(self, i: int, who: str, how: str, last: str) -> None:
        """Account for an agent that ended by itself.

        Args:
            who: the agent and what happened, for a note.
            how: what happened, for the result.
            last: its last words, for the note.
        """
        life, granted = self._incarnation[i], self._fleet.granted
        gap = self._gap(i)
        begin = self.starting.pop(i, None)
        until = None
        if gap is None or gap[0] > granted:
            restart = self._scenario.spec.on_death == "restart" and i not in self._journal.diverged
            if restart and self._restarts.get(i, 0) < MOST_RESTARTS:
                self._restarts[i] = self._restarts.get(i, 0) + 1
                until = self._scenario.next_round(granted)
            # The world will report when it was; here it matters only when another one takes over.
            since = max(self._journal.framed, 0 if life == 0 else self._lives.gaps(i)[life - 1][1] or 0)
            self._lives.add(Absence(i, since, gap[1] if until is None and gap else until))
        # An agent that was never ready got no nav: its life ends where it would have begun.
        self._fleet.announce(Death(i, begin, life, until))
        if until is not None:
            self._fleet.set_absences(self._lives.absences)
        self.deaths.setdefault(i, []).append(how)
        then = f", another one takes over at {tick_text(until, self._scenario.tick_ns)}" if until is not None else ""
        fate = "is not integrated any more" if i in self._journal.diverged else f"drifts without thrust{then}"
        self._notes.add(self._journal.framed, who, f"its vehicle {fate}{last}")

    def _end(self, i: int, tick: int) -> None:
        """End the agent of a vehicle. One elsewhere or on a host is dismissed, and ignored from then on."""
        if i in self._external.vehicles or self._hosting.role(i, self._incarnation[i]) != agent_role(i):
            self._dismiss(i, self._incarnation[i], tick, "it was killed by a fault of the scenario or the operator")
            self._gone.add(i)
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._children.by_role[agent_role(i)].pid, signal.SIGKILL)

    def _dismiss(self, i: int, incarnation: int, tick: int, reason: str) -> None:
        self._fleet.ask(WORLD, "dismiss", agents=[[i, incarnation, tick]], reason=reason)

    def _survivable(self, exit_: Exit) -> bool:
        """Whether the run goes on without this agent."""
        return (
            self._fleet.begun
            and self._scenario.spec.on_death != "abort"
            and exit_.code != FORKSERVER_LOST
            and (exit_.code != CONTROLLER_FAILED or self._scenario.spec.on_controller_error == "die")
        )

    def _gap(self, i: int) -> tuple[int, int | None] | None:
        """The gap (begin, end) after the life of agent i that was started last, if there is one."""
        gaps = self._lives.gaps(i)
        life = self._incarnation[i]
        return gaps[life] if life < len(gaps) else None

    def _now(self) -> str:
        return tick_text(self._journal.framed, self._scenario.tick_ns)
