"""The console of a distributed run: start the processes, wait until all are ready, grant the clock, record.

Everything that happens is an event of one queue (`fleet.execution.session`), which the main thread takes one by one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgpack

from fleet.errors import RunBroken, StoppedError
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.directory import RunDirectory
from fleet.execution.hosting import Hosting
from fleet.execution.operator import Operator
from fleet.execution.options import Options
from fleet.execution.runner import Closing
from fleet.execution.session import EXPECTED, EventKind
from fleet.execution.supervisor import Supervisor
from fleet.execution.wiring import Wiring
from fleet.processes.children import Exit
from fleet.processes.interrupts import deferring_interrupts
from fleet.recorder.journal import Journal
from fleet.scenario.scenario import Scenario
from netem.clock import Clock
from netem.errors import MalformedMessage, OutOfPlace
from netem.wire.bus import Respond
from netem.wire.codec import expect
from netem.wire.control import read_map
from netem.wire.credentials import CONSOLE, NETEM, WORLD
from netem.wire.messages import PROTOCOL_VERSION, Frames, Grant, Hello, LinkReport

READY_S = 20.0
READY_PER_VEHICLE_S = 0.2
POLL_S = 0.02
QUIET_S = 2.0  # without an event for so long, ask who waits for whom
SETTLE_S = 0.2  # after a death, how long to collect what else happened
CLOSE_S = 15.0  # for the last answers of world and netem, which may have much to catch up with on a busy machine


class Console:
    """One distributed run, as a `Runner`: its clock and its log. Its processes are the supervisor's."""

    def __init__(
        self,
        scenario: Scenario,
        directory: RunDirectory,
        journal: Journal,
        options: Options,
        wiring: Wiring,
        hosting: Hosting,
        run: str,
        print_line: Callable[[str], None],
    ) -> None:
        """Prepare a run; nothing is started. `run`: its id; its keys begin with fleet/<run>/. `print_line`: shows the
        operator a line that stays.
        """
        self._scenario, self._journal, self._options = scenario, journal, options
        self._fleet = fleet = Supervisor(scenario, journal, directory, options, wiring, hosting, run, print_line)
        self.deaths, self.notes = fleet.deaths, fleet.notes.lines
        self._operator: Operator | None = None  # until everyone is ready
        self._silent = {EventKind.FRAME, EventKind.LINKS}  # keys on which no greeting was heard
        self._received = {EventKind.FRAME: 0, EventKind.LINKS: 0}
        self.started_s = 0.0
        self.middleware_lost = 0
        self.closing = Closing()

    @property
    def waiting(self) -> str:
        return self._fleet.waiting

    def serve(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Run to the end. Raises RunBroken if the run could not be completed; StoppedError if the operator stopped it;
        FleetError if the join file of an external agent cannot be written.
        """
        began = time.monotonic()
        try:
            self._fleet.start(progress, partial(self._take, POLL_S))
            self._get_ready(progress)
            self.started_s, self._fleet.begun = time.monotonic() - began, True
            try:
                self._record(policy, progress)
            except (StoppedError, KeyboardInterrupt):
                self.closing = Closing(timing=self._timing_so_far())
                raise
            self.closing = self._close()
        finally:
            with deferring_interrupts():  # otherwise processes stay, and an open session keeps us from ending
                self._fleet.close()

    def _get_ready(self, progress: Callable[[], None]) -> None:
        fleet, session = self._fleet, self._fleet.session
        vehicles = range(1, self._scenario.vehicles + 1)
        greeting = Hello(CONSOLE, 0, 0, PROTOCOL_VERSION, False)
        began = time.monotonic()
        deadline = began + READY_S + READY_PER_VEHICLE_S * len(vehicles)
        while True:
            session.put(greeting)
            world, network = session.ask(WORLD, "ready"), session.ask(NETEM, "ready")
            fleet.external.note_ready(i for i, _ in world.get("ready", ()))
            state = readiness(world, network, vehicles, fleet.external.awaited, self._silent)
            if not state.missing:
                return
            if state.only_external:
                # Our own processes are ready, so whoever starts the others has all the time.
                self._wait_to_join(began, progress)
                deadline = time.monotonic() + READY_S
            elif time.monotonic() > deadline:
                passed = f"not ready after {time.monotonic() - began:.0f} s"
                raise RunBroken(f"{passed}: waiting for {state.missing}", fleet.last_lines())
            fleet.waiting = f"waiting for all to be ready, not yet {state.missing}"
            progress()
            for event in fleet.events.take_for(POLL_S):
                self._handle(*event)

    def _record(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Grant ticks as far as the clock, the log and the supervisor allow, until all frames are there."""
        fleet, journal = self._fleet, self._journal
        moved = asked = time.monotonic()
        live = LiveClock(policy, moved)
        self._operator = operator = Operator(self._scenario, journal, live, fleet)
        fleet.waiting = ""
        while journal.framed < policy.ticks:
            fleet.poll()
            now = time.monotonic()
            until = min(live.until(journal.written, now), hold := fleet.next_restart())
            if until > fleet.granted:
                fleet.granted = until
                fleet.session.put(Grant(until))
                moved = now
            before = journal.framed
            self._take(0.01 if live.speed_limit is not None or live.paused or hold <= fleet.granted else 0.1)
            if operator.stopping:
                raise StoppedError
            if journal.framed != before or live.paused:
                moved, fleet.waiting = now, "paused" if live.paused else ""
            elif fleet.external.awaited:
                self._wait_to_join(moved, progress)
                continue
            elif now - max(moved, asked) > QUIET_S:
                asked = now
                fleet.waiting = f"{fleet.who_waits()}, {now - moved:.0f} s"
            if now - moved > self._scenario.stall_timeout_s:
                stalled = f"nothing moved for {self._scenario.stall_timeout_s:g} s at {fleet.now()}"
                raise RunBroken(f"{stalled}: {fleet.who_waits()}", self.notes[-5:])
            progress()

    def _close(self) -> Closing:
        journal, ask = self._journal, self._fleet.session.ask
        if self._options.clock is Clock.LOCKSTEP:
            # The last round has no barrier: the world may be at the end before netem has what belongs to it.
            m = self._scenario.round_ticks
            last = (self._scenario.ticks - 1) // m * m
            self._take_until(lambda: journal.reported >= last, "netem did not report its last round")
        network = ask(NETEM, "close", timeout_s=CLOSE_S, tick=self._scenario.ticks)
        self._take_until(lambda: journal.complete, "netem did not report its last packets")
        world = ask(WORLD, "close", timeout_s=CLOSE_S)
        counts = {"world": world.get("counts", {}), "netem": network.get("counts", {}), "console": self._received}
        self.middleware_lost = lost_messages(counts, clock=self._options.clock)
        return closing(world, network, self._fleet.notes.rejected)

    def _timing_so_far(self) -> dict[str, Any]:
        if self._options.clock is Clock.LOCKSTEP:
            return {}
        world, network = self._fleet.session.ask(WORLD, "close"), self._fleet.session.ask(NETEM, "timing")
        return {**world["timing"], "netem": network["timing"]} if world and network else {}

    def _wait_to_join(self, since: float, progress: Callable[[], None]) -> None:
        self._fleet.waiting = self._fleet.external.waiting(time.monotonic() - since, self._options.join_timeout_s)
        progress()

    def _take(self, timeout_s: float) -> None:
        for event in self._fleet.events.take(timeout_s):
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
                self._fleet.note(*data)
            case EventKind.EXIT:
                if not self._fleet.on_process_ended(data):
                    self._explain(data)
            case EventKind.OPERATION:
                self._answer_operator(*data)
            case EventKind.TOKEN:
                i, alive = data
                (self._fleet.on_token if alive else self._fleet.on_token_gone)(i)
            case EventKind.ROUTER_LOST:
                at = self._fleet.now()
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

    def _explain(self, first: Exit) -> None:
        """Raise RunBroken for a process that ended; what else happened meanwhile is taken first, frames included."""
        exits = [first]
        for kind, data in self._fleet.events.take_for(SETTLE_S):
            if kind is EventKind.EXIT:
                exits.append(data)
            elif kind is not EventKind.OPERATION:
                self._handle(kind, data)
        raise self._fleet.explain(exits)


@dataclass(frozen=True, slots=True)
class Readiness:
    """The processes that are ready, at one moment."""

    missing: str  # who is not, in words; empty: everyone is ready
    only_external: bool = False  # only agents are missing that somebody else starts


def readiness(
    world: Mapping[str, Any],
    network: Mapping[str, Any],
    vehicles: Sequence[int],
    awaited: Sequence[int],
    silent: Collection[str],
) -> Readiness:
    """Which processes are ready, by the answers of world and netem to `ready`. A liveliness token only shows that a
    process lives; these answers show that messages arrive.

    Args:
        world: `ready` has (vehicle, incarnation) of each agent that greeted the world; `grant`: it hears grants.
        network: `round` says that netem hears the world. As in `world`, empty: no answer.
        awaited: vehicles with an external agent that has not joined, ascending as `vehicles`.
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


def closing(world: dict[str, Any], network: dict[str, Any], rejected: dict[str, int]) -> Closing:
    """The final reports of a run's processes: their answers to `close`, and the notes that were not kept."""
    return Closing(
        entered={(src, dst): (sent, copies) for src, dst, sent, copies in network.get("entered", ())},
        rejected={**world.get("rejected", {}), **network.get("rejected", {}), **rejected},
        timing={**world.get("timing", {}), "netem": network.get("timing", {})},
    )


def lost_messages(counts: dict[str, Any], clock: Clock = Clock.LOCKSTEP) -> int:
    """How many messages left one process of a completed run and never arrived at the other, from the counts that each
    process gives by kind of message. Every nav is answered by one command; agents' own counts are not needed. On a wall
    clock an agent may skip navs, and commands are not counted. Raises RunBroken if a process did not report.
    """
    # A run that lost a message is invalid, whatever its checks say: what it shows was not computed from all messages.
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
