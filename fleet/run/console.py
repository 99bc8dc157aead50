"""The console of a distributed run: start the processes, wait until all are ready, grant the clock, record.

Everything that happens comes in as an event of one queue: frames, reports and notes from zenoh's threads, exits
from the watcher's. The main thread takes them one by one.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

import msgpack

import agents.main
import agents.process
import netem.main
import netem.process
import world.main
import world.process
from fleet.errors import RunBroken, StoppedError, printable
from fleet.hosts.rendezvous import Rendezvous
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
from fleet.processes.open_files import allow_open_files
from fleet.processes.ports import free_port
from fleet.processes.private_folder import PrivateFolder
from fleet.recorder.journal import Journal
from fleet.run.clock import Clock, LiveClock
from fleet.run.directory import RunDirectory
from fleet.run.external_agents import ExternalAgents
from fleet.run.operator import Operator
from fleet.run.supervisor import Supervisor
from fleet.scenario.scenario import Scenario, frame_every
from netem.errors import BusError, MalformedMessage, OutOfPlace
from netem.faults import NetFault, fault_values
from netem.wire.access import CONSOLE, LEASE_MS, NETEM, OPERATOR, Credentials, Listener, agent_role, generate
from netem.wire.bus import Bus, Respond
from netem.wire.codec import encode
from netem.wire.control import read_map, request
from netem.wire.keys import Keys, vehicle_of
from netem.wire.messages import PROTOCOL_VERSION, RUN_OVER, Frames, Grant, Hello, LinkReport, Note, WorldFaults
from netem.wire.queues import Quota
from netem.wire.settings import PENDING
from netem.wire.shell import expect
from world.faults import WorldFault

WORLD = world.process.WORLD
JOIN_S = 10.0
JOIN_TRY_MS = 500
READY_S = 20.0
READY_PER_VEHICLE_S = 0.2
POLL_S = 0.02
QUIET_S = 2.0  # without an event for so long, ask who is waiting for whom
JOIN_TIMEOUT_S = 300.0  # for agents that somebody else starts
SETTLE_S = 0.2  # after a death, how long to collect what else happened

CLOSE_S = 15.0  # for the last word of world and netem, which may have much to catch up with on a busy machine

MOST_NOTES = 1000

FRAME, LINKS, NOTE, EXIT, OPERATION = "frame", "links", "note", "exit", "operation"
TOKEN, LOST = "token", "lost"
_EXPECTED = {FRAME: (Frames, Hello), LINKS: (LinkReport, Hello)}


class Console:
    """One distributed run."""

    def __init__(
        self,
        scenario: Scenario,
        directory: RunDirectory,
        journal: Journal,
        *,
        run: str | None = None,
        port: int | None = None,
        audit: bool = False,
        start_order: Callable[[list[str]], list[str]] | None = None,
        rendezvous: Rendezvous | None = None,
        join_timeout_s: float = JOIN_TIMEOUT_S,
        say: Callable[[str], None] = lambda _: None,
        pace: float | None = None,
    ) -> None:
        """`pace`: ticks begin by the wall clock, so many times as fast as real; None: in lockstep."""
        self._pace = pace
        self._scenario, self._directory, self._journal = scenario, directory, journal
        self._vehicles = tuple(range(1, scenario.vehicles + 1))
        self._keys = Keys(run or secrets.token_hex(4))
        self._port = port
        self._private: PrivateFolder | None = None
        self._audit = audit
        self._start_order = start_order
        self._rendezvous = rendezvous or Rendezvous()
        self._events: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._children = Children(lambda ended: self._events.put((EXIT, ended)))
        self._bus: Bus | None = None
        self._grant: Callable[[bytes], None] = _unconnected
        self._hello: set[str] = set()
        self.notes: list[str] = []
        self._queued_notes = Quota(MOST_NOTES)  # by role
        self._rejected_notes: Counter[str] = Counter()  # by role: malformed, or too many
        self._received = {FRAME: 0, LINKS: 0}
        self.middleware_lost = 0  # messages that zenoh lost; any makes the run invalid
        self._agent_arguments: dict[int, tuple[Any, ...]] = {}
        self._granted = 0
        self._external = ExternalAgents(scenario, directory, say)
        self._join_timeout_s = join_timeout_s
        self._supervisor = Supervisor(
            scenario, journal, self._children, self._external, self.notes, lambda: self._granted, self._start_agent
        )
        self.operator: Operator | None = None
        self.waiting = ""  # who is being waited for, when nothing moves
        self.started_s = 0.0  # wall time until everyone was ready
        self.timing: dict[str, Any] = {}  # of a run on a wall clock that was ended early

    @property
    def children(self) -> dict[str, Child]:
        """The running processes by role."""
        return self._children.by_role

    @property
    def deaths(self) -> dict[int, list[str]]:
        """By vehicle, how agents ended that nobody told to."""
        return self._supervisor.deaths

    def serve(self, clock: Clock, progress: Callable[[], None]) -> dict[str, Any]:
        """Run to the end; returns what the processes reported when they closed.

        Raises:
            RunBroken: the run could not be completed.
        """
        began = time.monotonic()
        try:
            bus = self._start()
            self._get_ready(bus, progress)
            self.started_s = time.monotonic() - began
            try:
                self._record(bus, clock, progress)
            except (StoppedError, KeyboardInterrupt):
                self.timing = self._measured(bus)
                raise
            return self._close(bus)
        finally:
            try:
                self._dismiss()
            finally:
                self._children.stop()
                if self._bus is not None:
                    self._bus.close()
                self._directory.connection.unlink(missing_ok=True)
                self._external.close()
                if self._private is not None:
                    self._private.close()

    def _start(self) -> Bus:
        scenario, keys = self._scenario, self._keys
        rendezvous = self._rendezvous
        credentials = rendezvous.credentials or generate(self._vehicles)
        listener = rendezvous.listener
        if self._port is not None and not rendezvous.router:
            loopback = f"tcp/127.0.0.1:{free_port(self._port)}"
            listener = (
                Listener((loopback,), LEASE_MS)
                if listener is None
                else replace(listener, endpoints=(loopback, *listener.endpoints))
            )
        allow_open_files(scenario.vehicles, strangers=PENDING if listener else 0)
        private = self._private = PrivateFolder()
        endpoint = rendezvous.router or private.endpoint
        if rendezvous.router:
            self._listen(self._visit(endpoint, credentials[CONSOLE]))
        clients = {role: c for role, c in credentials.items() if role != WORLD}
        sea = scenario.world_config, frame_every(scenario), self._pace
        network = scenario.netem_config, self._pace is not None
        targets: dict[str, tuple[Callable[..., None], tuple[Any, ...]]] = {
            WORLD: (world.main.run, (endpoint, keys.run, clients, private.path, *sea, listener, self._audit)),
            NETEM: (netem.main.run, (endpoint, keys.run, credentials[NETEM], *network)),
        }
        if rendezvous.router:
            targets[WORLD] = world.main.join, (endpoint, keys.run, credentials[WORLD], *sea)
        for i in self._vehicles:
            role = agent_role(i)
            if i in self._external.vehicles:
                continue
            self._agent_arguments[i] = (endpoint, keys.run, i, credentials[role])
            targets[role] = (agents.main.run, self._agent_arguments[i])
        order = list(targets)
        if self._start_order is not None:
            order = self._start_order(order)
        for role in order:
            self._start_process(role, *_flat(targets[role]))
            if role == order[0]:
                self._children.watch()
            if role == WORLD and not rendezvous.router:
                # Now, because an agent that finds nobody to ask for its configuration keeps asking.
                bus = self._bus = self._join(endpoint, credentials[CONSOLE])
                self._listen(bus)
        self._directory.write_connection(
            {
                "endpoint": endpoint,
                "run": keys.run,
                "scenario": scenario.name,
                "pid": os.getpid(),
                **credentials[OPERATOR].to_values(),
            }
        )
        assert self._bus is not None  # the world is among the roles
        joining = {role: rendezvous.joining(role, known) for role, known in credentials.items()}
        self._external.open(rendezvous.reached or (listener.endpoints[0] if listener else endpoint), keys.run, joining)
        return self._bus

    def _start_process(self, role: str, *target: Any) -> None:
        title = f"fleet {role.replace('-', ' ')} [{self._scenario.name}]"
        try:
            self._children.start(role, title, self._directory.process_log(role), *target)
        except TimeoutError as error:
            raise RunBroken(f"{role} could not be started: {error}") from error
        except (EOFError, OSError) as error:
            why = forkserver_death(SETTLE_S) or str(error) or type(error).__name__
            raise RunBroken(f"{role} could not be started: {why}") from error

    def _listen(self, bus: Bus) -> None:
        scenario, keys = self._scenario, self._keys
        self._grant = bus.publisher(keys.grant)
        put = self._events.put
        bus.subscribe(keys.frame, lambda _, data: put((FRAME, data)))
        bus.subscribe(keys.links, lambda _, data: put((LINKS, data)))

        def note(key: str, data: bytes) -> None:
            role = key.rsplit("/", 1)[-1]
            if self._queued_notes.admit(role):
                put((NOTE, (role, data)))
            else:
                self._rejected_notes[role] += 1

        bus.subscribe(keys.note("*"), note)
        clock = {} if self._pace is None else {"clock": "real"}
        slices = {keys.cfg(i): {"agent": scenario.agent_config(i).to_values()} | clock for i in self._vehicles}
        strangers = {keys.cfg(i): i for i in self._external.vehicles}

        def configure(key: str, _: bytes, respond: Respond) -> None:
            more = self._external.answer(strangers[key]) if key in strangers else {}
            respond(msgpack.packb(more if "error" in more else slices[key] | more))

        bus.answer(keys.cfg("*"), configure)
        for key, i in {keys.alive(agent_role(i)): i for i in self._external.vehicles}.items():
            bus.watch_tokens(key, partial(self._token, i))
        bus.answer(f"{keys.op}/*", lambda _, data, respond: put((OPERATION, (data, respond))))

    def _token(self, i: int, _: str, alive: bool) -> None:
        self._events.put((TOKEN, (i, alive)))

    def _join(self, endpoint: str, credentials: Credentials) -> Bus:
        deadline = time.monotonic() + JOIN_S
        while True:
            try:
                return Bus.connect(endpoint, credentials, timeout_ms=JOIN_TRY_MS)
            except BusError as error:
                self._take(POLL_S)  # the world may have died: that is the better explanation
                if time.monotonic() > deadline:
                    raise RunBroken(str(error)) from None

    def _visit(self, endpoint: str, credentials: Credentials) -> Bus:
        """Join a router that is there already; nobody else may use this run's keys there."""
        try:
            bus = self._bus = Bus.connect(endpoint, credentials)
        except BusError as error:
            raise RunBroken(str(error)) from None
        if tokens := bus.tokens(self._keys.alive("*")):
            who = ", ".join(token.rsplit("/", 1)[-1] for token in tokens)
            raise RunBroken(
                f"run {self._keys.run} is going on at {endpoint} already ({who}): end it, or make credentials for "
                "another with fleet acl"
            )
        bus.on_lost(lambda: self._events.put((LOST, endpoint)))
        return bus

    def _get_ready(self, bus: Bus, progress: Callable[[], None]) -> None:
        """A hello and its echo on every key; liveliness alone would not show that messages pass."""
        probe = encode(Hello(CONSOLE, 0, 0, PROTOCOL_VERSION, False))
        began = time.monotonic()
        deadline = began + READY_S + READY_PER_VEHICLE_S * len(self._vehicles)
        missing = "the world"
        while True:
            self._grant(probe)
            answer = self._control(bus, WORLD, "ready")
            network = self._control(bus, NETEM, "ready")
            ready = {i for i, _ in answer.get("ready", ())}
            for i in self._external.awaited:
                if i in ready and self._external.here(i):
                    self._external.joined(i)
            ready -= {*self._external.awaited}
            absent = [i for i in self._vehicles if i not in ready]
            unheard = {FRAME, LINKS} - self._hello
            if not absent and not unheard and network.get("round") and answer.get("grant"):
                return
            if absent:
                missing = "agents " + ", ".join(map(str, absent)) if len(absent) < 9 else f"{len(absent)} agents"
            else:
                missing = "netem" if not network.get("round") else ", ".join(sorted(unheard)) or "the clock's key"
            if absent == self._external.awaited and network.get("round") and answer.get("grant"):
                # Everyone of ours is ready, so whoever starts the others has all the time.
                deadline = self._wait_to_join(began, progress)
            elif time.monotonic() > deadline:
                raise RunBroken(f"not ready after {READY_S:.0f} s: waiting for {missing}", self._tails())
            retry = time.monotonic() + POLL_S
            while (left := retry - time.monotonic()) > 0:
                self._take(left)

    def _wait_to_join(self, since: float, progress: Callable[[], None]) -> float:
        """Say whom the run waits for; until when our own processes may now take to be ready.

        Raises:
            RunBroken: nobody joined in time.
        """
        now = time.monotonic()
        if now - since > self._join_timeout_s:
            raise RunBroken(
                f"{self._external.waiting().removeprefix('waiting for ').removesuffix(' to join')} did not join within "
                f"{self._join_timeout_s:g} s; --join-timeout gives more time"
            )
        self.waiting = f"{self._external.waiting()}, {now - since:.0f} s"
        progress()
        return now + READY_S

    def _record(self, bus: Bus, clock: Clock, progress: Callable[[], None]) -> None:
        journal = self._journal
        moved = asked = time.monotonic()
        live = LiveClock(clock, moved)
        self.operator = self._operator(bus, live)
        self.waiting = ""
        self._supervisor.connect(self._grant, partial(self._control, bus))
        while journal.framed < clock.ticks:
            self._supervisor.tend()
            now = time.monotonic()
            until = min(live.until(journal.written, now), hold := self._supervisor.next_restart())
            if until > self._granted:
                self._granted = until
                self._grant(encode(Grant(until)))
                moved = now
            before = journal.framed
            self._take(0.01 if live.speed is not None or live.paused or hold <= self._granted else 0.1)
            if self.operator.stopping:
                raise StoppedError
            if journal.framed != before or live.paused:
                moved, self.waiting = now, "paused" if live.paused else ""
            elif self._external.awaited:
                self._wait_to_join(moved, progress)
                continue
            elif now - max(moved, asked) > QUIET_S:
                asked = now
                self.waiting = f"{self._who_waits(bus)}, {now - moved:.0f} s"
            if now - moved > self._scenario.stall_timeout_s:
                raise RunBroken(
                    f"nothing moved for {self._scenario.stall_timeout_s:g} s at "
                    f"{self._seconds(journal.framed)}: {self._who_waits(bus)}",
                    [*self.notes[-5:]],
                )
            progress()

    def _operator(self, bus: Bus, clock: LiveClock) -> Operator:
        def tell_netem(faults: tuple[NetFault, ...]) -> bool:
            return "tick" in self._control(bus, NETEM, "faults", faults=[fault_values(fault) for fault in faults])

        def tell_world(faults: tuple[WorldFault, ...]) -> None:
            # On the key of the grants, so that it is there before any tick that is granted later.
            self._grant(encode(WorldFaults(msgpack.packb([fault.to_values() for fault in faults]))))

        return Operator(
            self._scenario,
            self._journal,
            clock,
            tell_netem,
            self._supervisor.end_agents,
            self._supervisor.restart_agent,
            lambda: self._granted,
            self._supervisor.without_agent,
            lambda: self.waiting,
            tell_world=tell_world,
        )

    def _close(self, bus: Bus) -> dict[str, Any]:
        journal = self._journal
        if self._pace is None:
            # Nobody waits for the last round: the world may be at the end before netem has what belongs to it.
            m = self._scenario.round_ticks
            last = (self._scenario.ticks - 1) // m * m
            self._take_until(lambda: journal.reported >= last, "netem did not report its last round")
        answer = self._control(bus, NETEM, "close", timeout_s=CLOSE_S, tick=self._scenario.ticks)
        self._take_until(lambda: journal.complete, "netem did not close its books")
        sea = self._control(bus, WORLD, "close", timeout_s=CLOSE_S)
        counts = {"world": sea.get("counts", {}), "netem": answer.get("counts", {}), "console": self._received}
        self.middleware_lost = lost_messages(counts, barrier=self._pace is None)
        notes = {f"note/{role}": count for role, count in sorted(self._rejected_notes.items())}
        rejected = {**sea.get("rejected", {}), **answer.get("rejected", {}), **notes}
        return {
            "entered": {(src, dst): (sent, copies) for src, dst, sent, copies in answer.get("entered", ())},
            "rejected": rejected,
            "timing": {**sea.get("timing", {}), "netem": answer.get("timing", {})},
        }

    def _measured(self, bus: Bus) -> dict[str, Any]:
        """How everyone kept up so far; nothing in lockstep, or if somebody does not answer."""
        if self._pace is None:
            return {}
        sea, network = self._control(bus, WORLD, "close"), self._control(bus, NETEM, "timing")
        return {**sea["timing"], "netem": network["timing"]} if sea and network else {}

    def _take_until(self, done: Callable[[], bool], otherwise: str) -> None:
        deadline = time.monotonic() + CLOSE_S
        while not done():
            self._take(0.1)
            if time.monotonic() > deadline:
                raise RunBroken(otherwise)

    def _take(self, timeout_s: float) -> None:
        """Handle the next event, and all that are there already."""
        try:
            kind, data = self._events.get(timeout=max(0.0, timeout_s))
            while True:
                self._handle(kind, data)
                kind, data = self._events.get_nowait()
        except Empty:
            return

    def _handle(self, kind: str, data: Any) -> None:
        if kind == OPERATION:
            request_data, respond = data
            try:
                if self.operator is None:
                    answer = {"error": f"not ready yet{f': {self.waiting}' if self.waiting else ''}"}
                else:
                    answer = self.operator.handle(read_map(request_data))
            except MalformedMessage as error:
                answer = {"error": str(error)}
            respond(msgpack.packb(answer))
            return
        if kind == LOST:
            at = self._seconds(self._journal.framed)
            raise RunBroken(f"the link to the router at {data} has ended at {at}: closed, or silent for the lease")
        if kind == TOKEN:
            i, alive = data
            was_here = self._external.here(i)
            self._external.token(i, alive)
            if alive:
                self._supervisor.came(i)
            if was_here and not alive and not self.started_s:
                self._external.expect(i, 0, 0)  # it left before the run began: another one may come
            elif was_here and not alive and not self._supervisor.left(i):
                raise RunBroken(f"agent {i} (external) left at {self._seconds(self._journal.framed)}")
            return
        if kind == EXIT:
            if self._supervisor.bury(data):
                return
            self._explain([data])
        if kind == NOTE:
            self._hear_note(*data)
            return
        try:
            message = expect(data, *_EXPECTED[kind])
            match message:
                case Frames():
                    self._received[FRAME] += 1
                    for frame in message.frames:
                        self._journal.frame(frame)
                case LinkReport():
                    self._received[LINKS] += 1
                    self._journal.links(message)
                case Hello():
                    self._hello.add(kind)
        except OutOfPlace as error:
            self.middleware_lost += 1
            raise RunBroken(f"the middleware lost a message on {kind}: {error}") from error
        except MalformedMessage as error:
            raise RunBroken(f"a damaged message on {kind}: {error}") from error

    def _start_agent(self, i: int, incarnation: int, begin: int) -> None:
        if i in self._external.vehicles:
            self._external.expect(i, incarnation, begin)
            return
        role = agent_role(i)
        self._start_process(role, agents.main.run, *self._agent_arguments[i], incarnation, begin)

    def _hear_note(self, role: str, data: bytes) -> None:
        """A note, from whom the router let onto the key of `role`: nobody speaks for another."""
        self._queued_notes.release(role)
        try:
            note = expect(data, Note)
            assert isinstance(note, Note)
            own = {0, vehicle_of(role.replace("agent-", "/"))} if role.startswith("agent-") else {note.subject}
            if note.role != role or note.subject not in own:
                raise MalformedMessage("note", f"{role} speaks as {note.role!r:.40} about {note.subject}")
        except MalformedMessage as error:
            self._rejected_notes[role] += 1
            if self._rejected_notes[role] == 1:
                self.notes.append(
                    f"{self._seconds(self._journal.framed)} rejected from {role}: {printable(str(error))}"
                )
            return
        self._note(note)

    def _note(self, note: Note) -> None:
        if len(self.notes) >= MOST_NOTES:
            self._rejected_notes[note.role] += 1
            return
        who = f"{'vehicle' if note.role == WORLD else 'agent'} {note.subject}" if note.subject else note.role
        self.notes.append(f"{self._seconds(note.tick)} {who}: {printable(note.text)}")

    def _who_waits(self, bus: Bus) -> str:
        """Who has not answered, in words."""
        if starting := self._supervisor.starting:
            return "waiting for agents to start again: " + ", ".join(map(str, sorted(starting)))
        waiting = self._control(bus, WORLD, "waiting")
        network = self._control(bus, NETEM, "waiting")
        late = sorted({i for i, _ in waiting.get("waiting", ())})
        if missing := network.get("missing"):
            # The rest wait for an inbox, which waits for these.
            late = [i for i in missing if i in late] or late
        if not waiting:
            return "waiting for the world" + _suspended(self._children.by_role[WORLD])
        if not network:
            return "waiting for netem" + _suspended(self._children.by_role[NETEM])
        if not late:
            return "waiting for the log" if self._journal.written < self._journal.framed else "waiting"
        stopped = [
            f"agent {i}"
            + (" (external)" if i in self._external.vehicles else _suspended(self._children.by_role[agent_role(i)]))
            for i in late[:8]
        ]
        more = f" and {len(late) - 8} more" if len(late) > 8 else ""
        return "waiting for " + ", ".join(stopped) + more

    def _dismiss(self) -> None:
        """The run is over, whatever the reason: those whom nobody ends are told."""
        with contextlib.suppress(MalformedMessage):
            sea = self._children.by_role.get(WORLD)
            if self._external.vehicles and self._bus is not None and sea is not None and sea.process.is_alive():
                self._supervisor.connect(self._grant, partial(self._control, self._bus))
                self._supervisor.dismiss(RUN_OVER)

    def _control(self, bus: Bus, role: str, op: str, *, timeout_s: float = 1.0, **fields: Any) -> dict[str, Any]:
        answer = bus.ask(self._keys.ctl(role), request(op, **fields), timeout_s=timeout_s)
        return {} if answer is None else read_map(answer)

    def _explain(self, exits: list[Exit]) -> None:
        """Say who died and how. What else happened meanwhile is collected first, frames included."""
        deadline = time.monotonic() + SETTLE_S
        while (left := deadline - time.monotonic()) > 0:
            try:
                kind, data = self._events.get(timeout=left)
            except Empty:
                break
            if kind == EXIT:
                exits.append(data)
            elif kind == OPERATION:
                continue
            else:
                self._handle(kind, data)
        at = self._seconds(self._journal.framed)
        if any(e.code == FORKSERVER_LOST for e in exits) and (death := forkserver_death()) is not None:
            raise RunBroken(f"{death} at {at}; every process of the run ended with it")
        # The world hosts the router: when it goes, others may lose their session and follow.
        exits.sort(key=lambda e: (e.role != WORLD, e.code >= 0, e.role))
        first, others = exits[0], exits[1:]
        child = self._children.by_role[first.role]
        reason = f"{first.role.replace('-', ' ')} (pid {child.pid}) {describe_exit(first.code)} at {at}"
        lines = [
            f"last lines of {child.log_path}:",
            *(f"  {line}" for line in child.tail() or ["(nothing printed)"]),
        ]
        relevant = [n for n in self.notes if f"agent {first.role.removeprefix('agent-')}:" in n]
        lines = [*relevant, *lines]
        if others:
            lines.append("also ended: " + ", ".join(f"{e.role} ({describe_exit(e.code)})" for e in others))
        raise RunBroken(reason, lines)

    def _tails(self) -> list[str]:
        return [f"{c.role}: {line}" for c in self._children.by_role.values() for line in c.tail()[-1:]][:10]

    def _seconds(self, tick: int) -> str:
        return f"t = {max(0, tick) * self._scenario.tick_ns / 1e9:.2f} s (tick {max(0, tick)})"


def _unconnected(_: bytes) -> None:
    raise AssertionError("the console has not joined the run yet")


def lost_messages(counts: dict[str, Any], *, barrier: bool = True) -> int:
    """How many messages left one process of a completed run and never arrived at the other.

    Every nav is answered by one command; agents' own counts are not needed. Without a barrier an agent may skip navs.

    Raises:
        RunBroken: a process did not say what it sent and received.
    """
    try:
        world_sent, world_received = counts["world"]["sent"], counts["world"]["received"]
        netem_sent, netem_received = counts["netem"]["sent"], counts["netem"]["received"]
        console = counts["console"]
        pairs = [
            *([(world_sent["nav"], world_received["cmd"])] if barrier else []),
            (world_sent["round"], netem_received["round"]),
            (world_sent["frame"], console[FRAME]),
            (netem_sent["links"], console[LINKS]),
        ]
    except KeyError as error:
        raise RunBroken(f"a process closed without its count of {error}") from None
    return sum(abs(sent - received) for sent, received in pairs)


def _flat(target: tuple[Callable[..., None], tuple[Any, ...]]) -> tuple[Any, ...]:
    return (target[0], *target[1])


def _suspended(child: Child) -> str:
    """' (suspended)' when the process is stopped, so that a forgotten SIGSTOP is seen at once."""
    if ended(child.pid):  # and nobody has told
        return f" (pid {child.pid} has ended; {forkserver_suspended() or 'it has not been reaped yet'})"
    return f" (pid {child.pid} is suspended)" if suspended(child.pid) else ""
