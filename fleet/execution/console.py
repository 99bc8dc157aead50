"""The console of a distributed run: start the processes, wait until all are ready, grant the clock, record.

Everything that happens is an event of one queue (`fleet.execution.session`), which the main thread takes one by one.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgpack

from fleet.errors import RunBroken, StoppedError
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.directory import RunDirectory
from fleet.execution.external_agents import ExternalAgents
from fleet.execution.hosting import hosting
from fleet.execution.notes import Notes, tick_text
from fleet.execution.operator import Operator
from fleet.execution.options import Options
from fleet.execution.runner import Closing
from fleet.execution.session import EXPECTED, EventKind, EventQueue, Session, connect_to_router, connect_to_world
from fleet.execution.supervisor import Launch, Supervisor, explain, last_lines, who_waits
from fleet.processes.children import Children, Exit
from fleet.processes.interrupts import deferring_interrupts
from fleet.recorder.journal import Journal
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Kill
from netem.errors import MalformedMessage, OutOfPlace
from netem.faults import NetFault, fault_values
from netem.lives import Absence
from netem.vehicle_clock import Clock
from netem.wire.access import CONSOLE, NETEM, WORLD, agent_role
from netem.wire.bus import Bus, Respond
from netem.wire.codec import expect
from netem.wire.keys import Keys
from netem.wire.messages import (
    PROTOCOL_VERSION,
    RUN_OVER,
    Death,
    Frames,
    Grant,
    Hello,
    LinkReport,
    Message,
    Restart,
    WorldFault,
    WorldFaults,
)
from netem.wire.shell import read_map

# --- accounts
# The account of a completed run: every message that one process sent, another received.


def closing(world: dict[str, Any], network: dict[str, Any], rejected: dict[str, int]) -> Closing:
    """The final reports of a completed run's processes.

    Args:
        world, network: what they answered to `close`.
        rejected: notes that were not kept, by key.
    """
    return Closing(
        entered={(src, dst): (sent, copies) for src, dst, sent, copies in network.get("entered", ())},
        rejected={**world.get("rejected", {}), **network.get("rejected", {}), **rejected},
        timing={**world.get("timing", {}), "netem": network.get("timing", {})},
    )


def lost_messages(counts: dict[str, Any], clock: Clock = Clock.LOCKSTEP) -> int:
    """How many messages left one process of a completed run and never arrived at the other.

    Every nav is answered by one command; agents' own counts are not needed.

    Args:
        counts: by process (`world`, `netem`, `console`), how many messages of each kind it sent and received.
        clock: on a wall clock an agent may skip navs, and commands are not counted.

    Raises:
        RunBroken: a process did not report what it sent and received.
    """
    try:
        world_sent, world_received = counts["world"]["sent"], counts["world"]["received"]
        netem_sent, netem_received = counts["netem"]["sent"], counts["netem"]["received"]
        console = counts["console"]
        pairs = [
            *([(world_sent["nav"], world_received["cmd"])] if clock is Clock.LOCKSTEP else []),
            (world_sent["round"], netem_received["round"]),
            (world_sent["frame"], console["frame"]),
            (netem_sent["links"], console["links"]),
        ]
    except KeyError as error:
        raise RunBroken(f"a process closed without its count of {error}") from None
    return sum(abs(sent - received) for sent, received in pairs)


# --- readiness
# Whether everyone is ready for the first tick.


@dataclass(frozen=True, slots=True)
class Readiness:
    """The processes that are ready, at one moment."""

    missing: str  # who is not, in words; empty: everyone is ready
    only_external: bool = False  # nobody is missing but agents that somebody else starts


def readiness(
    world: Mapping[str, Any],
    network: Mapping[str, Any],
    vehicles: Sequence[int],
    awaited: Sequence[int],
    silent: Collection[str],
) -> Readiness:
    """Find out from the answers of world and netem to `ready` which processes are ready.

    A liveliness token only shows that a process lives. These answers show that messages arrive.

    Args:
        world: the world's answer. `ready` has (vehicle, incarnation) of each agent that greeted the world. `grant`
            says that the world hears grants. Empty: no answer.
        network: netem's answer. `round` says that netem hears the world. Empty: no answer.
        vehicles: all vehicles of the fleet, ascending.
        awaited: vehicles with an external agent that has not joined, ascending.
        silent: keys on which the console has heard no greeting.
    """
    ready = {i for i, _ in world.get("ready", ())}.difference(awaited)
    absent = [i for i in vehicles if i not in ready]
    cores = bool(network.get("round") and world.get("grant"))
    if absent:
        missing = "agents " + ", ".join(map(str, absent)) if len(absent) < 9 else f"{len(absent)} agents"
    elif not network.get("round"):
        missing = "netem"
    else:
        missing = ", ".join(sorted(silent)) or ("" if cores else "the clock's key")
    return Readiness(missing, only_external=bool(awaited) and absent == list(awaited) and cores)


READY_S = 20.0
READY_PER_VEHICLE_S = 0.2
POLL_S = 0.02
QUIET_S = 2.0  # without an event for so long, ask who waits for whom
SETTLE_S = 0.2  # after a death, how long to collect what else happened
CLOSE_S = 15.0  # for the last answers of world and netem, which may have much to catch up with on a busy machine


class Console:
    """One distributed run: a `Runner`, and the `Fleet` that its operator and its supervisor act on."""

    def __init__(
        self,
        scenario: Scenario,
        directory: RunDirectory,
        journal: Journal,
        options: Options,
        run: str,
        print_line: Callable[[str], None],
    ) -> None:
        """Prepare a run; nothing is started.

        Args:
            run: its id; its keys begin with fleet/<run>/.
            print_line: shows the operator a line that stays.
        """
        self._scenario, self._directory, self._journal, self._options = scenario, directory, journal, options
        self._vehicles = range(1, scenario.vehicles + 1)
        self._keys = Keys(run)
        self._events = EventQueue()
        self._children = Children(partial(self._events.put, EventKind.EXIT))
        self._external = ExternalAgents(scenario, directory, print_line)
        self._notes = Notes(scenario.tick_ns)
        self._hosting = hosting(scenario, options)
        self._supervisor = Supervisor(
            self, scenario, journal, self._children, self._external, self._notes, self._hosting
        )
        self._operator: Operator | None = None  # until everyone is ready
        self._launch: Launch | None = None
        self._session: Session | None = None
        self._silent = {EventKind.FRAME, EventKind.LINKS}  # keys on which no greeting was heard
        self._received = {EventKind.FRAME: 0, EventKind.LINKS: 0}
        self.granted = 0
        self.waiting = ""
        self.started_s = 0.0
        self.middleware_lost = 0
        self.closing = Closing()

    @property
    def deaths(self) -> dict[int, list[str]]:
        return self._supervisor.deaths

    @property
    def notes(self) -> list[str]:
        return self._notes.lines

    def serve(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Run to the end.

        Raises:
            RunBroken: the run could not be completed.
            StoppedError: the operator stopped it.
            FleetError: the join file of an external agent cannot be written.
        """
        began = time.monotonic()
        try:
            self._start(progress)
            self._get_ready(progress)
            self.started_s = time.monotonic() - began
            try:
                self._record(policy, progress)
            except (StoppedError, KeyboardInterrupt):
                self.closing = Closing(timing=self._timing_so_far())
                raise
            self.closing = self._close()
        finally:
            with deferring_interrupts():  # or processes would stay, and an open session would keep us from ending
                self._clean_up()

    # The stages of a run.

    def _start(self, progress: Callable[[], None]) -> None:
        """Start the processes, connect to the router, and let the operator and external agents in."""
        launch = Launch(self._scenario, self._options, self._hosting, self._keys, self._directory, self._children)
        self._launch = launch
        own = launch.credentials[CONSOLE]
        if launch.joins_router:
            self._open(connect_to_router(launch.endpoint, own, self._keys, self._events))
        targets = launch.targets()
        for number, (role, target) in enumerate(targets.items()):
            self.waiting = f"starting processes, {number} of {len(targets)}"
            progress()
            launch.start(role, target)
            if number == 0:
                self._children.watch()
            if role == WORLD and not launch.joins_router:
                # Now, because an agent whose question for its configuration finds no answer keeps asking.
                # The world may have died meanwhile: that is the better explanation.
                self._open(connect_to_world(launch.endpoint, own, partial(self._take, POLL_S)))
        self._directory.write_connection(launch.connection)
        self._external.open(launch.external_endpoint, self._keys, launch.external_credentials, launch.join_folders)

    def _open(self, bus: Bus) -> None:
        self._session = session = Session(bus, self._keys)
        session.listen(self._events, self._notes)
        session.configure(self._scenario, self._options.clock, self._hosting, self._external, self._events)

    def _get_ready(self, progress: Callable[[], None]) -> None:
        """Wait until a greeting has passed on every key."""
        greeting = Hello(CONSOLE, 0, 0, PROTOCOL_VERSION, False)
        began = time.monotonic()
        deadline = began + READY_S + READY_PER_VEHICLE_S * len(self._vehicles)
        while True:
            self._put(greeting)
            world, network = self.ask(WORLD, "ready"), self.ask(NETEM, "ready")
            self._external.note_ready(i for i, _ in world.get("ready", ()))
            state = readiness(world, network, self._vehicles, self._external.awaited, self._silent)
            if not state.missing:
                return
            if state.only_external:
                # Our own processes are ready, so whoever starts the others has all the time.
                self._wait_to_join(began, progress)
                deadline = time.monotonic() + READY_S
            elif time.monotonic() > deadline:
                tails = last_lines(self._children.by_role)
                raise RunBroken(f"not ready after {time.monotonic() - began:.0f} s: waiting for {state.missing}", tails)
            self.waiting = f"waiting for all to be ready, not yet {state.missing}"
            progress()
            for event in self._events.take_for(POLL_S):
                self._handle(*event)

    def _record(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Grant ticks as far as the clock, the log and the supervisor allow, until all frames are there."""
        journal = self._journal
        moved = asked = time.monotonic()
        live = LiveClock(policy, moved)
        self._operator = operator = Operator(self._scenario, journal, live, self)
        self.waiting = ""
        while journal.framed < policy.ticks:
            self._supervisor.poll()
            now = time.monotonic()
            until = min(live.until(journal.written, now), hold := self._supervisor.next_restart())
            if until > self.granted:
                self.granted = until
                self._put(Grant(until))
                moved = now
            before = journal.framed
            self._take(0.01 if live.speed_limit is not None or live.paused or hold <= self.granted else 0.1)
            if operator.stopping:
                raise StoppedError
            if journal.framed != before or live.paused:
                moved, self.waiting = now, "paused" if live.paused else ""
            elif self._external.awaited:
                self._wait_to_join(moved, progress)
                continue
            elif now - max(moved, asked) > QUIET_S:
                asked = now
                self.waiting = f"{self._who_waits()}, {now - moved:.0f} s"
            if now - moved > self._scenario.stall_timeout_s:
                stalled = f"nothing moved for {self._scenario.stall_timeout_s:g} s at {self._now()}"
                raise RunBroken(f"{stalled}: {self._who_waits()}", self.notes[-5:])
            progress()

    def _close(self) -> Closing:
        """Wait for the last reports, and settle the accounts."""
        journal = self._journal
        if self._options.clock is Clock.LOCKSTEP:
            # The last round has no barrier: the world may be at the end before netem has what belongs to it.
            m = self._scenario.round_ticks
            last = (self._scenario.ticks - 1) // m * m
            self._take_until(lambda: journal.reported >= last, "netem did not report its last round")
        network = self.ask(NETEM, "close", timeout_s=CLOSE_S, tick=self._scenario.ticks)
        self._take_until(lambda: journal.complete, "netem did not report its last packets")
        world = self.ask(WORLD, "close", timeout_s=CLOSE_S)
        counts = {"world": world.get("counts", {}), "netem": network.get("counts", {}), "console": self._received}
        self.middleware_lost = lost_messages(counts, clock=self._options.clock)
        return closing(world, network, self._notes.rejected)

    def _timing_so_far(self) -> dict[str, Any]:
        """How late everyone was in a realtime run; empty in lockstep, or without an answer."""
        if self._options.clock is Clock.LOCKSTEP:
            return {}
        world, network = self.ask(WORLD, "close"), self.ask(NETEM, "timing")
        return {**world["timing"], "netem": network["timing"]} if world and network else {}

    def _clean_up(self) -> None:
        try:
            with contextlib.suppress(MalformedMessage):
                world = self._children.by_role.get(WORLD)
                there = self._session is not None and world is not None and world.process.is_alive()
                if there and self._external.vehicles:
                    self._supervisor.dismiss_external(RUN_OVER)
        finally:
            self._children.stop()
            if self._session is not None:
                self._session.close()
            self._directory.connection.unlink(missing_ok=True)
            self._external.close()
            if self._launch is not None:
                self._launch.close()

    # What is asked of the running fleet, and done to it: `Fleet`.

    @property
    def begun(self) -> bool:
        return self.started_s > 0

    def ask(self, role: str, op: str, *, timeout_s: float = 1.0, **fields: Any) -> dict[str, Any]:
        assert self._session is not None  # open since the world was started
        return self._session.ask(role, op, timeout_s=timeout_s, **fields)

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        return "tick" in self.ask(NETEM, "faults", faults=[fault_values(fault) for fault in faults])

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        # On the key of the grants, so it arrives before any tick that is granted later.
        self._put(WorldFaults(tuple(faults)))

    def set_absences(self, absences: Sequence[Absence]) -> None:
        if "tick" not in self.ask(NETEM, "absences", absences=[list(absence) for absence in absences]):
            raise RunBroken("netem did not answer")

    def announce(self, message: Death | Restart) -> None:
        self._put(message)

    def computing(self, role: str) -> int:
        return self._launch.computing(role) if self._launch is not None else 0

    def start_agent(self, i: int, incarnation: int, begin: int) -> None:
        if i in self._external.vehicles:
            self._external.expect(i, incarnation, begin)
            return
        assert self._launch is not None
        self._launch.start(agent_role(i), self._launch.agent(i, incarnation, begin))

    def _put(self, message: Message) -> None:
        assert self._session is not None
        self._session.put(message)

    def without_agent(self) -> list[int]:
        return self._supervisor.without_agent()

    def end_agents(self, kill: Kill) -> None:
        self._supervisor.end_agents(kill)

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        self._supervisor.restart_agent(i, begin, tick)

    # Events.

    def _take(self, timeout_s: float) -> None:
        """Handle the next event and all further events that are there already; wait at most this long for the first."""
        for event in self._events.take(timeout_s):
            self._handle(*event)

    def _take_until(self, done: Callable[[], bool], otherwise: str) -> None:
        deadline = time.monotonic() + CLOSE_S
        while not done():
            self._take(0.1)
            if time.monotonic() > deadline:
                raise RunBroken(otherwise)

    def _handle(self, kind: EventKind, data: Any) -> None:
        match kind:
            case EventKind.FRAME | EventKind.LINKS:
                self._record_message(kind, data)
            case EventKind.NOTE:
                role, note = data
                ended = self._notes.receive(role, note, self._journal.framed)
                if ended is not None and ended.vehicle in self._hosting.agents(role):
                    self._events.put(EventKind.EXIT, Exit(agent_role(ended.vehicle), ended.status, 0))
            case EventKind.EXIT:
                if not self._supervisor.ended(data):
                    self._explain(data)
            case EventKind.OPERATION:
                self._answer_operator(*data)
            case EventKind.TOKEN:
                i, alive = data
                (self._supervisor.registered if alive else self._supervisor.unregistered)(i)
            case EventKind.ROUTER_LOST:
                at = self._now()
                raise RunBroken(f"the link to the router at {data} has ended at {at}: closed, or silent for the lease")

    def _record_message(self, kind: EventKind, data: bytes) -> None:
        try:
            match expect(data, *EXPECTED[kind]):
                case Frames() as message:
                    self._received[kind] += 1
                    for frame in message.frames:
                        self._journal.frame(frame)
                case LinkReport() as message:
                    self._received[kind] += 1
                    self._journal.links(message)
                case Hello():
                    self._silent.discard(kind)
        except OutOfPlace as error:
            self.middleware_lost += 1
            raise RunBroken(f"the middleware lost a message on {kind}: {error}") from error
        except MalformedMessage as error:
            raise RunBroken(f"a damaged message on {kind}: {error}") from error

    def _answer_operator(self, data: bytes, respond: Respond) -> None:
        try:
            if self._operator is None:
                answer = {"error": f"not ready yet{f': {self.waiting}' if self.waiting else ''}"}
            else:
                answer = self._operator.handle(read_map(data))
        except MalformedMessage as error:
            answer = {"error": str(error)}
        respond(msgpack.packb(answer))

    # Who waits, and who died.

    def _wait_to_join(self, since: float, progress: Callable[[], None]) -> None:
        """Show the agents that the run waits for, since a wall time. Raises RunBroken: they did not join in time."""
        self.waiting = self._external.waiting(time.monotonic() - since, self._options.join_timeout_s)
        progress()

    def _who_waits(self) -> str:
        if starting := self._supervisor.starting:
            return "waiting for agents to start again: " + ", ".join(map(str, sorted(starting)))
        world, network = self.ask(WORLD, "waiting"), self.ask(NETEM, "waiting")
        behind = self._journal.written < self._journal.framed
        processes, external = self._hosting.children(self._children.by_role), self._external.vehicles
        return who_waits(world, network, processes, external, log_is_behind=behind, computing=self.computing)

    def _explain(self, first: Any) -> None:
        """Raise RunBroken for a process that ended; what else happened meanwhile is taken first, frames included."""
        exits = [first]
        for kind, data in self._events.take_for(SETTLE_S):
            if kind is EventKind.EXIT:
                exits.append(data)
            elif kind is not EventKind.OPERATION:
                self._handle(kind, data)
        processes = self._hosting.children(self._children.by_role)
        raise explain(exits, processes, self.notes, self._now(), self.computing)

    def _now(self) -> str:
        return tick_text(self._journal.framed, self._scenario.tick_ns)
