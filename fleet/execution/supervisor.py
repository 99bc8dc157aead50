"""The processes of a distributed run: who is started, who ended, who is to end, and who takes over.

World and netem receive every life by tick, so that all three agree on who has an agent when (`netem.lives`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Sequence
from functools import partial

import agents.main
import agents.process
from fleet.errors import RunBroken
from fleet.execution.diagnosis import explain, who_waits
from fleet.execution.directory import RunDirectory
from fleet.execution.external_agents import ExternalAgents
from fleet.execution.hosting import Hosting
from fleet.execution.launch import Launch
from fleet.execution.notes import Notes, tick_text
from fleet.execution.options import Options
from fleet.execution.session import EventKind, EventQueue, Session, connect_to_router, connect_to_world
from fleet.execution.wiring import Wiring
from fleet.processes.children import (
    FORKSERVER_LOST,
    Children,
    Exit,
    describe_exit,
    has_ended,
)
from fleet.recorder.journal import Journal
from fleet.scenario.faults.kind import Kill
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import MOST_RESTARTS
from netem.errors import MalformedMessage
from netem.faults import NetFault, fault_values
from netem.lives import Absence, Lives
from netem.wire.bus import Bus
from netem.wire.credentials import CONSOLE, NETEM, WORLD, agent_role
from netem.wire.keys import Keys
from netem.wire.messages import RUN_OVER, Death, Restart, WorldFault, WorldFaults

CONTROLLER_FAILED = agents.process.CONTROLLER_FAILED
POLL_S = 0.02


class Supervisor:
    """Starts, ends and restarts the processes of one run: what its operator acts on, as a `Fleet`.

    Everything happens on the console's main thread. An agent's lives count from 0. It is *ended* when the scenario or
    the operator wants its vehicle without an agent; when it ends by itself, that is a *death*, and the scenario's
    `on_death` says what follows.
    """

    def __init__(
        self,
        scenario: Scenario,
        journal: Journal,
        directory: RunDirectory,
        options: Options,
        wiring: Wiring,
        hosting: Hosting,
        run: str,
        print_line: Callable[[str], None],
    ) -> None:
        """Prepare it; nothing is started. The arguments are those of the console."""
        self._scenario, self._journal, self._directory = scenario, journal, directory
        self._options, self._wiring, self._hosting, self._keys = options, wiring, hosting, Keys(run)
        self.events = EventQueue()
        self.external = ExternalAgents(scenario, directory, print_line)
        self.notes = Notes(scenario.tick_ns)
        self._children = Children(partial(self.events.put, EventKind.EXIT))
        self._launch: Launch | None = None
        self._session: Session | None = None
        self.granted = 0  # ticks below it may have begun
        self.waiting = ""  # the processes that the run waits for, in words; empty: the run moves
        self.begun = False  # everyone was ready and the clock runs; before that no agent may end
        self._vehicles = tuple(range(1, scenario.vehicles + 1))
        self._lives = Lives(scenario.faults.absences)
        self._incarnation = dict.fromkeys(self._vehicles, 0)  # number of the life that was started last
        self.starting: dict[int, int] = {}  # vehicle -> tick of the agent that was started again and is not ready
        self._polled_s = 0.0
        self._ending: set[int] = set()  # vehicles whose agent, the one that was started last, was asked to end
        self._gone: set[int] = set()  # vehicles whose agent has ended
        self._restarts: dict[int, int] = {}  # vehicle -> how often because of on_death
        self.deaths: dict[int, list[str]] = {}  # vehicle -> how its agents died

    @property
    def session(self) -> Session:
        """On the bus, since the world was started."""
        assert self._session is not None
        return self._session

    def start(self, progress: Callable[[], None], meanwhile: Callable[[], None]) -> None:
        """Start the processes, connect to the router, and let the operator and external agents in. `meanwhile` is
        called between attempts to connect, and may raise a better explanation, such as the world's end. Raises
        RunBroken if a process could not be started, or there is no router; FleetError if the join file of an external
        agent cannot be written.
        """
        self._launch = launch = Launch(
            self._scenario,
            self._options,
            self._wiring,
            self._hosting,
            self._keys,
            self._directory,
            self._children,
        )
        own = launch.credentials[CONSOLE]
        if launch.joins_router:
            self._open(connect_to_router(launch.endpoint, own, self._keys, self.events))
        targets = launch.targets()
        for number, (role, target) in enumerate(targets.items()):
            self.waiting = f"starting processes, {number} of {len(targets)}"
            progress()
            launch.start(role, target)
            if number == 0:
                self._children.watch()
            if role == WORLD and not launch.joins_router:
                # Now, because an agent whose question for its configuration finds no answer keeps asking.
                self._open(connect_to_world(launch.endpoint, own, meanwhile))
        launch.admit(self.external)

    def _open(self, bus: Bus) -> None:
        self._session = session = Session(bus, self._keys)
        session.listen(self.events, self.notes)
        session.configure(self._scenario, self._options.clock, self._hosting, self.external, self.events)

    def close(self) -> None:
        try:
            with contextlib.suppress(MalformedMessage):
                world = self._children.by_role.get(WORLD)
                joined = [[i, self._incarnation[i], 0] for i in self.external.vehicles if self.external.present(i)]
                if joined and self._session is not None and world is not None and not has_ended(world.pid):
                    self._session.ask(WORLD, "dismiss", agents=joined, reason=RUN_OVER)
        finally:
            self._children.stop()
            if self._session is not None:
                self._session.close()
            self._directory.connection.unlink(missing_ok=True)
            self.external.close()
            if self._launch is not None:
                self._launch.close()

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        return "tick" in self.session.ask(NETEM, "faults", faults=[fault_values(fault) for fault in faults])

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        # On the key of the grants, so it arrives before any tick that is granted later.
        self.session.put(WorldFaults(tuple(faults)))

    def vehicles_without_agent(self) -> list[int]:
        return [i for i in self._vehicles if self._lives.lacks_agent(i, max(0, self._journal.framed))]

    def end_agents(self, kill: Kill) -> None:
        for absence in kill.absences:
            self._lives.add(absence)
            self.session.put(Death(absence.vehicle, kill.begin, 0, kill.end))
        self._set_absences()

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        self._lives.restart(i, begin, tick)
        self.session.put(Restart(i, begin, tick))
        self._set_absences()

    def next_restart(self) -> int:
        """The first begin of an agent that is not ready yet, as a tick. The clock stops before it."""
        # Simulated time waits for the process, so the result does not depend on the 0.3 s that Python takes to start.
        planned = [gap[1] for i in self._vehicles if (gap := self._gap(i)) is not None and gap[1] is not None]
        return min([*planned, *self.starting.values()], default=self._scenario.ticks)

    def on_process_ended(self, exit_: Exit) -> bool:
        """Record that a process ended. False: the run cannot go on without it. If an agent died, the world decides the
        tick of its death.
        """
        own = [*self._hosting.agents(exit_.role)]
        if not own:
            return False
        if exit_.role != agent_role(own[0]):  # a host ended; agents that were started again are elsewhere
            own = [i for i in own if not self._incarnation[i] and i not in self._gone]
        died = [i for i in own if i not in self._ending]
        if died and not self._survivable(exit_):
            return False
        child = self._hosting.children(self._children.by_role)[exit_.role]
        how, where = describe_exit(exit_.code), f"pid {child.pid}"
        if child.role != agent_role(own[0] if own else 0):
            where = f"{child.role}, {where}"
        if computing := self._computing(exit_.role):
            how += f" while agent {computing} computed"
        last = f"; last line of {child.log_path}: {line}" if (line := "".join(child.tail()[-1:])) else ""
        for i in died:
            self._died(i, f"agent {i} ({where}) {how}", how, last)
        self._gone.update(own)
        return True

    def on_token(self, i: int) -> None:
        """Record that an external agent's liveliness token appeared.

        A session whose link was cut links again by itself, with its token, but what it missed is lost. So an agent
        whose life is over is dismissed; otherwise it would keep others from joining.
        """
        self.external.token(i, True)
        over = self._incarnation[i] - (i not in self._gone)
        if self.begun and over >= 0:
            self._dismiss(i, over, 0, "its link had ended, and its life with it")

    def on_token_gone(self, i: int) -> None:
        """Record that an external agent's liveliness token disappeared. Raises RunBroken if the agent died, and the run
        does not go on without it.
        """
        was_there = self.external.present(i)
        self.external.token(i, False)
        if not was_there:
            return
        if not self.begun:
            self.external.expect(i, 0, 0)  # another one may join in its place
        elif i not in self.starting and i not in self._gone:
            if self._scenario.spec.on_death == "abort":
                raise RunBroken(f"agent {i} (external) left at {self.now()}")
            self._died(i, f"agent {i} (external) left", "left: its session ended", "")
            self._gone.add(i)

    def note(self, role: str, data: bytes) -> None:
        """Take a note of a process; that an agent on a host has ended is an event like the end of a process."""
        ended = self.notes.receive(role, data, self._journal.framed)
        if ended is not None and ended.vehicle in self._hosting.agents(role):
            self.events.put(EventKind.EXIT, Exit(agent_role(ended.vehicle), ended.status, 0))

    def poll(self) -> None:
        """End the agents whose time has come, and start their successors; cheap when nothing is due."""
        if not self._lives.absences or time.monotonic() < self._polled_s + POLL_S:
            return
        self._polled_s = time.monotonic()
        if self.starting:
            self._note_ready()
        granted = self.granted
        due = {i: gap for i in self._vehicles if (gap := self._gap(i)) is not None and gap[0] <= granted}
        alive = [i for i in due if i not in self._ending | self._gone]
        # The world asks for no command from the gap's first tick on: once it has reached it, nothing is lost.
        reached = dict(self.session.ask(WORLD, "ticks").get("ticks", ())) if alive else {}
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
                self._start_agent(i, self._incarnation[i], end)

    def _start_agent(self, i: int, incarnation: int, begin: int) -> None:
        if i in self.external.vehicles:
            self.external.expect(i, incarnation, begin)
            return
        assert self._launch is not None
        self._launch.start(agent_role(i), self._launch.agent(i, incarnation, begin))

    def _note_ready(self) -> None:
        ready = {(i, life) for i, life in self.session.ask(WORLD, "ready").get("ready", ())}
        for i in [i for i in self.starting if (i, self._incarnation[i]) in ready]:
            if i not in self.external.vehicles or self.external.present(i):
                del self.starting[i]
                self.external.on_joined(i)

    def _died(self, i: int, who: str, how: str, last: str) -> None:
        life, granted = self._incarnation[i], self.granted
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
        self.session.put(Death(i, begin, life, until))
        if until is not None:
            self._set_absences()
        self.deaths.setdefault(i, []).append(how)
        then = f", another one takes over at {tick_text(until, self._scenario.tick_ns)}" if until is not None else ""
        fate = "is not integrated any more" if i in self._journal.diverged else f"drifts without thrust{then}"
        self.notes.add(self._journal.framed, who, f"its vehicle {fate}{last}")

    def _end(self, i: int, tick: int) -> None:
        """End the agent of a vehicle. One elsewhere or on a host is dismissed, and ignored from then on."""
        if i in self.external.vehicles or self._hosting.role(i, self._incarnation[i]) != agent_role(i):
            self._dismiss(i, self._incarnation[i], tick, "it was killed by a fault of the scenario or the operator")
            self._gone.add(i)
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._children.by_role[agent_role(i)].pid, signal.SIGKILL)

    def _dismiss(self, i: int, incarnation: int, tick: int, reason: str) -> None:
        self.session.ask(WORLD, "dismiss", agents=[[i, incarnation, tick]], reason=reason)

    def _survivable(self, exit_: Exit) -> bool:
        return (
            self.begun
            and self._scenario.spec.on_death != "abort"
            and exit_.code != FORKSERVER_LOST
            and (exit_.code != CONTROLLER_FAILED or self._scenario.spec.on_controller_error == "die")
        )

    def _gap(self, i: int) -> tuple[int, int | None] | None:
        gaps = self._lives.gaps(i)
        life = self._incarnation[i]
        return gaps[life] if life < len(gaps) else None

    def _set_absences(self) -> None:
        if "tick" not in self.session.ask(NETEM, "absences", absences=[list(one) for one in self._lives.absences]):
            raise RunBroken("netem did not answer")

    def _computing(self, role: str) -> int:
        return 0 if self._launch is None else self._launch.computing(role)

    def now(self) -> str:
        return tick_text(self._journal.framed, self._scenario.tick_ns)

    def last_lines(self) -> list[str]:
        """The last line of each process, of the first ten that printed one."""
        return [f"{child.role}: {line}" for child in self._children.by_role.values() for line in child.tail()[-1:]][:10]

    def who_waits(self) -> str:
        if self.starting:
            return "waiting for agents to start again: " + ", ".join(map(str, sorted(self.starting)))
        world, network = self.session.ask(WORLD, "waiting"), self.session.ask(NETEM, "waiting")
        behind = self._journal.written < self._journal.framed
        processes, external = self._hosting.children(self._children.by_role), self.external.vehicles
        return who_waits(world, network, processes, external, log_is_behind=behind, computing=self._computing)

    def explain(self, exits: Sequence[Exit]) -> RunBroken:
        processes = self._hosting.children(self._children.by_role)
        return explain(exits, processes, self.notes.lines, self.now(), self._computing)
