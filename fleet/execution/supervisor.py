"""The processes of a distributed run: who is started, who ended, who is to end, and who takes over.

World and netem receive every life by tick, so that all three agree on who has an agent when (`netem.lives`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from socket import socket
from typing import Any

import agents.main
import agents.process
import netem.main
import world.main
from agents.host_progress import running
from fleet.errors import RunBroken
from fleet.execution.directory import RunDirectory
from fleet.execution.external_agents import ExternalAgents
from fleet.execution.hosting import Hosting
from fleet.execution.notes import Notes, folded, tick_text, without_agent
from fleet.execution.options import Options
from fleet.execution.rendezvous import Rendezvous
from fleet.execution.session import EventKind, EventQueue, Session, connect_to_router, connect_to_world
from fleet.processes.children import (
    FORKSERVER_LOST,
    Child,
    Children,
    Exit,
    describe_exit,
    ended,
    forkserver_death,
    forkserver_suspended,
    suspended,
)
from fleet.processes.limits import allow_open_files, processors
from fleet.processes.ports import free_port
from fleet.processes.run_folder import RunFolder
from fleet.recorder.journal import Journal
from fleet.scenario.faults.kind import Kill
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.sections.timeline import MOST_RESTARTS
from netem.clock import Clock
from netem.errors import MalformedMessage
from netem.faults import NetFault, fault_values
from netem.lives import Absence, Lives
from netem.wire.bus import Bus
from netem.wire.credentials import CONSOLE, LEASE_MS, NETEM, OPERATOR, WORLD, Listener, agent_role, generate, host_role
from netem.wire.keys import Keys
from netem.wire.messages import RUN_OVER, Death, Restart, WorldFault, WorldFaults
from netem.wire.session import PENDING
from netem.wire.vehicle_bus import Ends

# --- launch
# The processes of a run: the world, netem and the agents, each with its credentials and its part of the scenario.


FORKSERVER_S = 0.2  # how long to wait for the end of a fork server that does not answer
# Processes of agents that the world asks at a time; more of them find colder caches, fewer leave processors idle.
ASKED_PER_CPU = 3

Target = tuple[Callable[..., None], tuple[Any, ...]]  # a function that a process runs, and its arguments


class Launch:
    """Starts the processes of one run, each with what it needs."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        hosting: Hosting,
        keys: Keys,
        directory: RunDirectory,
        children: Children,
    ) -> None:
        """Choose endpoints, make credentials and the folder of the run's socket; nothing is started. Raises RunBroken
        if the port is taken, or this machine allows too few open files, or has no place for the folder.
        """
        self._scenario, self._options, self._hosting, self._keys = scenario, options, hosting, keys
        self._directory, self._children = directory, children
        self._rendezvous = options.rendezvous or Rendezvous()
        everyone = tuple(range(1, scenario.vehicles + 1))
        self.credentials = self._rendezvous.credentials or generate(everyone, hosts=hosting.members)  # by role
        self.joins_router = self._rendezvous.router is not None  # one that is there already; else the world hosts one
        self._listener = self._other_endpoints()
        others = self._listener or self._rendezvous.certified
        allow_open_files(scenario.vehicles, others=PENDING if others else 0)
        self._private = RunFolder()
        # On a wall clock a suspended agent would leave its navs unread, and the world would wait for room. To a host
        # zenoh carries the messages of many agents at once, and sockets besides it cost more than they save.
        self._ends = Ends() if options.clock is Clock.LOCKSTEP and not hosting.members else None
        self.endpoint = self._rendezvous.router or self._private.endpoint  # for the run's own processes

    def admit(self, external: ExternalAgents) -> None:
        """Tell commands and external agents, in files, how to reach this run. Raises FleetError if a file cannot be
        written.
        """
        self._directory.write_connection(
            {
                "endpoint": self.endpoint,
                "run": self._keys.run,
                "scenario": self._scenario.name,
                "pid": os.getpid(),
                **self.credentials[OPERATOR].to_values(),
            }
        )
        meeting = self._rendezvous
        endpoint = meeting.reached or (self._listener.endpoints[0] if self._listener else self.endpoint)
        credentials = {role: meeting.external_credentials(role, known) for role, known in self.credentials.items()}
        external.open(endpoint, self._keys, credentials, meeting.folders)

    def targets(self) -> dict[str, Target]:
        """The function of each process, by role. The processes start in this order."""
        here = self.endpoint, self._keys.run
        network = self._scenario.netem_config, self._options.clock, self._hosting.members
        targets: dict[str, Target] = {WORLD: self._world()}
        targets[NETEM] = netem.main.run, (*here, self.credentials[NETEM], *network)
        for h, role in enumerate(map(host_role, range(1, len(self._hosting.members) + 1)), start=1):
            targets[role] = agents.main.run_host, (*here, h, self.credentials[role], self._private.path / role)
        elsewhere = {*self._scenario.external, *chain(*self._hosting.members)}
        for i in range(1, self._scenario.vehicles + 1):
            if i not in elsewhere:
                targets[agent_role(i)] = self.agent(i)
        order = self._options.start_order
        return targets if order is None else {role: targets[role] for role in order(list(targets))}

    def agent(self, i: int, incarnation: int = 0, begin: int = 0) -> Target:
        """The function that an agent's process runs, in the life `incarnation` that begins at tick `begin`."""
        credentials = self.credentials[self._hosting.role(i)]
        return agents.main.run, (self.endpoint, self._keys.run, i, credentials, self._end(i), incarnation, begin)

    def _end(self, i: int) -> socket | None:
        """The end of a vehicle's bus for an agent that is about to start; None: the bus is on zenoh."""
        if self._ends is None:
            return None
        try:
            return self._ends.new(i)
        except OSError:  # no descriptor is left; or the world has ended, which its exit explains
            return None

    def computing(self, role: str) -> int:
        """The vehicle whose agent a host computes, or computed when it ended. 0: no vehicle, or not a host."""
        return running(self._private.path / role)

    def start(self, role: str, target: Target) -> None:
        """Start a process, named in `ps` after its role and the scenario. Raises RunBroken: it could not be started."""
        function, arguments = target
        title = f"fleet {role.replace('-', ' ')} [{self._scenario.name}]"
        try:
            self._children.start(role, title, self._directory.process_log(role), function, *arguments)
        except TimeoutError as error:
            raise RunBroken(f"{role} could not be started: {error}") from error
        except (EOFError, OSError) as error:
            why = forkserver_death(FORKSERVER_S) or str(error) or type(error).__name__
            raise RunBroken(f"{role} could not be started: {why}") from error
        finally:
            for one in arguments:
                if isinstance(one, socket):
                    one.close()  # the process has it

    def close(self) -> None:
        """Remove the folder of the run's socket: from now on nobody joins."""
        self._private.close()
        if self._ends is not None:
            self._ends.close()

    def _world(self) -> Target:
        scenario = self._scenario
        # An agent elsewhere may take long to answer, and keep the turn of one that would not.
        most_asked = scenario.vehicles if scenario.external else ASKED_PER_CPU * processors()
        sea = world.main.Sea(
            scenario.world_config, frame_every(scenario), self._options.clock, self._options.speed or 1.0, most_asked
        )
        ends = None if self._ends is None else self._ends.of_world
        if self.joins_router:
            return world.main.join, (self.endpoint, self._keys.run, self.credentials[WORLD], sea, ends)
        clients = {role: known for role, known in self.credentials.items() if role != WORLD}
        listening = self._listener, self._rendezvous.certified, self._hosting.members
        return world.main.run, (self.endpoint, self._keys.run, clients, self._private.path, sea, *listening, ends)

    def _other_endpoints(self) -> Listener | None:
        listener = self._rendezvous.listener
        if self._options.port is None or self.joins_router:
            return listener
        loopback = f"tcp/127.0.0.1:{free_port(self._options.port)}"
        if listener is None:
            return Listener((loopback,), LEASE_MS)
        return replace(listener, endpoints=(loopback, *listener.endpoints))


# --- post mortem
# Explains why a run cannot go on: a process ended, with its last lines, or the run waits for a process.


MOST_NAMED = 8  # processes in a line
_REAPED_S = 2.0  # the sockets of a fork server that is killed close a moment before it can be reaped


def explain(
    exits: Sequence[Exit],
    children: Mapping[str, Child],
    notes: Sequence[str],
    at: str,
    computing: Callable[[str], int] = lambda _: 0,
) -> RunBroken:
    """The error for processes that ended at about the same time: which one ended first, how, and its last lines.

    Args:
        children: the processes by role. If an agent shares a process, its role has that process.
        notes: of the run. The error repeats those about the agent that ended, and names other agents with the same.
        at: the time in the run, in words.
        computing: returns the agent that a host was computing when it ended. 0: none, or the process is no host.
    """
    if any(e.code == FORKSERVER_LOST for e in exits) and (death := forkserver_death(_REAPED_S)) is not None:
        return RunBroken(f"{death} at {at}; every process of the run ended with it")
    # The world hosts the router: when it ends, others may lose their session and end as well.
    first, *others = sorted(exits, key=lambda e: (e.role != WORLD, e.code >= 0, e.role))
    child = children[first.role]
    culprit = computing(first.role)
    reason = f"{first.role.replace('-', ' ')} ({_where(first.role, child)}) {describe_exit(first.code)} at {at}"
    reason += f" while agent {culprit} computed" if culprit else ""
    about = [note for note in notes if f"agent {culprit or first.role.removeprefix('agent-')}:" in note]
    alike = {without_agent(note) for note in about}
    lines = folded([*about, *(note for note in notes if note not in about and without_agent(note) in alike)])
    tail = child.tail()
    # A traceback ends in what the note says.
    if about and any(line.lstrip().startswith(("Traceback ", 'File "')) for line in tail):
        lines.append(f"the traceback is in {child.log_path}")
    else:
        lines.append(f"last lines of {child.log_path}:")
        lines += [f"  {line}" for line in tail or ["(nothing printed)"]]
    if others:
        named = ", ".join(f"{e.role} ({describe_exit(e.code)})" for e in others[:MOST_NAMED])
        lines.append("also ended: " + named + _more(len(others)))
    return RunBroken(reason, lines)


def who_waits(
    world: Mapping[str, Any],
    network: Mapping[str, Any],
    children: Mapping[str, Child],
    external: Collection[int],
    *,
    log_is_behind: bool,
    computing: Callable[[str], int] = lambda _: 0,
) -> str:
    """The agents or processes that have not answered, in words. `world` and `network` are their answers to `waiting`,
    empty without one; `external` are vehicles without a child process. `log_is_behind`: the journal has received more
    than the log holds. The rest is as for `explain`.
    """
    if not world:
        return "waiting for the world" + _condition(WORLD, children[WORLD])
    if not network:
        return "waiting for netem" + _condition(NETEM, children[NETEM])
    late = sorted({i for i, _ in world.get("waiting", ())})
    if missing := network.get("missing"):
        # The rest wait for an inbox, which waits for these.
        late = [i for i in missing if i in late] or late
    if not late:
        return "waiting for the log" if log_is_behind else "waiting"
    # Of a host's agents only the one that computes is late; the others wait for it.
    busy = {host: computing(host) for i in late if i not in external and (host := children[agent_role(i)].role)}
    late = [i for i in late if i in external or busy[children[agent_role(i)].role] in (0, i)] or late
    named = [
        f"agent {i}" + (" (external)" if i in external else _condition(agent_role(i), children[agent_role(i)]))
        for i in late[:MOST_NAMED]
    ]
    return "waiting for " + ", ".join(named) + _more(len(late))


def _more(total: int) -> str:
    return f" and {total - MOST_NAMED} more" if total > MOST_NAMED else ""


def _where(role: str, child: Child) -> str:
    return f"pid {child.pid}" if child.role == role else f"{child.role}, pid {child.pid}"


def _condition(role: str, child: Child) -> str:
    """Words on a process that cannot answer, so that a forgotten SIGSTOP is seen at once; mostly none, or the host."""
    where = _where(role, child)
    if ended(child.pid):  # and its exit has not been reported
        return f" ({where} has ended; {forkserver_suspended() or 'it has not been reaped yet'})"
    if suspended(child.pid):
        return f" ({where} is suspended)"
    return "" if child.role == role else f" ({where})"


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
        hosting: Hosting,
        run: str,
        print_line: Callable[[str], None],
    ) -> None:
        """Prepare it; nothing is started. The arguments are those of the console."""
        self._scenario, self._journal, self._directory = scenario, journal, directory
        self._options, self._hosting, self._keys = options, hosting, Keys(run)
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
        self._incarnation = dict.fromkeys(self._vehicles, 0)  # of the agent that was started last
        self.starting: dict[int, int] = {}  # vehicle -> tick of the agent that was started again and is not ready
        self._polled_s = 0.0
        self._ending: set[int] = set()  # vehicles whose agent, the one that was started last, was asked to end
        self._gone: set[int] = set()  # and whose has ended
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
            self._scenario, self._options, self._hosting, self._keys, self._directory, self._children
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
                if joined and self._session is not None and world is not None and not ended(world.pid):
                    self._session.ask(WORLD, "dismiss", agents=joined, reason=RUN_OVER)
        finally:
            self._children.stop()
            if self._session is not None:
                self._session.close()
            self._directory.connection.unlink(missing_ok=True)
            self.external.close()
            if self._launch is not None:
                self._launch.close()

    # What the operator asks for: `Fleet`.

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        return "tick" in self.session.ask(NETEM, "faults", faults=[fault_values(fault) for fault in faults])

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        # On the key of the grants, so it arrives before any tick that is granted later.
        self.session.put(WorldFaults(tuple(faults)))

    def without_agent(self) -> list[int]:
        return [i for i in self._vehicles if self._lives.without_agent(i, max(0, self._journal.framed))]

    def end_agents(self, kill: Kill) -> None:
        for absence in kill.absences:
            self._lives.add(absence)
            self.session.put(Death(absence.vehicle, kill.begin, 0, kill.end))
        self._set_absences()

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        self._lives.restart(i, begin, tick)
        self.session.put(Restart(i, begin, tick))
        self._set_absences()

    # Lives.

    def next_restart(self) -> int:
        """The first begin of an agent that is not ready yet, as a tick. The clock stops before it."""
        planned = [gap[1] for i in self._vehicles if (gap := self._gap(i)) is not None and gap[1] is not None]
        return min([*planned, *self.starting.values()], default=self._scenario.ticks)

    def ended(self, exit_: Exit) -> bool:
        """Record that a process ended. False: the run cannot go on without it. If an agent died, the world decides the
        tick of its death.
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
        if computing := self._computing(exit_.role):
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
        self.external.token(i, True)
        over = self._incarnation[i] - (i not in self._gone)
        if self.begun and over >= 0:
            self._dismiss(i, over, 0, "its link had ended, and its life with it")

    def unregistered(self, i: int) -> None:
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
                self.external.joined(i)

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

    # Words for a person.

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
