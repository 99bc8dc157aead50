"""The world process: the sea, connected by zenoh, whose router runs here (one hop on the hot path)."""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Callable
from socket import socket
from threading import Lock
from time import monotonic
from typing import Any, NoReturn

import msgpack

from netem.errors import MalformedMessage, OutOfPlace
from netem.lives import Absence
from netem.wire.bundles import AgentGroups
from netem.wire.bus import Bus, Respond
from netem.wire.codec import encode, expect
from netem.wire.control import read_map
from netem.wire.credentials import WORLD as WORLD
from netem.wire.credentials import Members, agent_role, host_role
from netem.wire.keys import Keys, vehicle_of
from netem.wire.mailbox import Mailbox, Probes
from netem.wire.messages import (
    PROTOCOL_VERSION,
    Bundle,
    Command,
    Death,
    End,
    Frame,
    Frames,
    Grant,
    Hello,
    Message,
    Nav,
    Restart,
    Round,
    SaidBy,
    VehicleFrame,
    WorldFault,
    WorldFaults,
)
from netem.wire.parts import PART_BYTES, split
from netem.wire.queues import PutQueue
from netem.wire.refusals import Refusals
from netem.wire.vehicle_bus import Inbound
from world.errors import IntegrationError
from world.lockstep import Lockstep, NavTo, Out
from world.realtime import RealtimeRun
from world.turns import TickOrder, Turn

log = logging.getLogger(__name__)

FRAMES_PER_MESSAGE = 10  # frames that travel together while the world has more to do
FRAMES_WAIT_S = 0.02
FIX_BYTES = 70  # length of a fix in a frame, at most
ROUND_BYTES = 36  # length of a vehicle in a round, at most: two numbers and a position
_ECHO = encode(Hello(WORLD, 0, 0, PROTOCOL_VERSION, True))
_PROBE = encode(Hello(WORLD, 0, 0, PROTOCOL_VERSION, False))


class WorldProcess:
    """Passes what comes in to a run and publishes what comes out."""

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        run: Lockstep | RealtimeRun,
        refusals: Refusals | None = None,
        most_asked: int | None = None,
        members: Members = (),
        ends: socket | None = None,
    ) -> None:
        """`refusals`: what the router refuses, if it lives here. `most_asked`: processes that are asked at a time;
        None: all. `members`: the vehicles of each host. `ends`: where the console hands over the ends of vehicles'
        buses (`netem.wire.vehicle_bus`); None: they are on zenoh.
        """
        self._keys = keys
        self._in: PutQueue | Inbound
        self._ends: Inbound | None = None
        self._grant_key = keys.grant
        self._run = run
        self._state = run.state
        self._ids = run.state.ids
        most = len(self._ids) if most_asked is None else most_asked
        self._hosts = hosts = AgentGroups(bus, keys, members, keys.cmd)
        self._turns = TickOrder(run.config.round_ticks, most, lambda i, nav: -hosts.of(i, nav.incarnation) or i)
        self._mailbox = Mailbox(bus, WORLD, keys.note(WORLD))
        self._nav: dict[int, Callable[[bytes], None]] = {i: bus.publisher(keys.nav(i)) for i in self._ids}
        self._round = bus.publisher(keys.round)
        self._frame = bus.publisher(keys.frame)
        self._frames: list[Frame] = []  # not yet published
        self._frames_bytes = 0
        self._frames_lock = Lock()  # the console's question who is waited for comes on another thread
        self._flushed_s = 0.0
        self._sent = dict.fromkeys(("nav", "round", "frame"), 0)
        self._received = {"cmd": 0}
        self._probes = Probes()
        self._ready: set[tuple[int, int]] = set()  # agent and incarnation
        self._grant_heard = False
        self._listen(bus, ends)
        bus.answer(keys.ctl(WORLD), self._control)
        self._token_roles = {keys.alive(agent_role(i)): [i] for i in self._ids}
        self._token_roles |= {keys.alive(host_role(h)): [*group] for h, group in enumerate(members, start=1)}
        bus.watch_tokens(keys.alive("*"), self._token)
        bus.token(keys.alive(WORLD))
        self._refusals = refusals or Refusals()
        self._refusals.report_to(lambda text: self._mailbox.note(0, min(map(self._state.tick_of, self._ids)), text))

    def _listen(self, bus: Bus, ends: socket | None) -> None:
        # Commands and grants: an agent owes one at a time.
        capacity = max(64, 3 * len(self._ids))
        self._in = channel = bus.channel(self._keys.cmd("*"), capacity=capacity)
        if ends is not None:
            self._in = self._ends = Inbound(channel, capacity, ends, self._keys.cmd)

    def serve_or_give_up(self) -> NoReturn:
        """Serve; when a vehicle's motion cannot go on, publish what there is, say why in one line, and end."""
        try:
            self.serve()
        except IntegrationError as error:
            with self._frames_lock:
                self._flush_frames()
            if error.__cause__ is not None:
                traceback.print_exception(error.__cause__)
            sys.stderr.write(f"{error}\n")
        sys.exit(1)

    def serve(self) -> None:
        """Handle one message after the other, until the process is ended. Raises IntegrationError if a vehicle cannot
        be moved, and the run is not to go on without it.
        """
        take, poll = self._in.get, self._in.poll
        while True:
            item = poll()
            if item is None:
                # While agents compute, more frames are to come: a message for each would wake the console every tick.
                if self._turns.idle or monotonic() > self._flushed_s + FRAMES_WAIT_S:
                    with self._frames_lock:
                        self._flush_frames()
                item = take()
            self._handle(*item)

    def _handle(self, key: str, data: bytes) -> None:
        try:
            if key == self._grant_key:
                self._from_console(expect(data, Grant, Death, Restart, WorldFaults, Hello))
            elif host := self._hosts.number(key):
                self._from_host(host, expect(data, Bundle, Hello))
            else:
                self._publish(self._from_agent(vehicle_of(key), data))
        except (MalformedMessage, OutOfPlace) as error:
            self._reject(key, error)

    def _reject(self, key: str, error: MalformedMessage | OutOfPlace) -> None:
        i = vehicle_of(key)
        self._mailbox.reject(key, self._state.tick_of(i) if i in self._ids else 0, error)

    def _from_console(self, message: Message) -> None:
        """Carry out the console's requests in their order. None of them changes a tick that was granted before."""
        run, state = self._run, self._state
        match message:
            case Grant():
                self._publish(run.grant(message.until))
            case WorldFaults():
                state.world.faults = _check_faults(message.faults)
            case Death(vehicle=i) if i in self._ids:
                if message.tick is not None:
                    state.lives.add(Absence(i, message.tick, message.until))
                    return
                out = run.end(i, message.incarnation, message.until)
                if i not in dict(run.waiting_for):
                    # A nav whose agent has ended was not lost on the way.
                    self._sent["nav"] -= self._turns.holds(i)
                    self._turns.forget(i)
                self._publish(out)
            case Restart(vehicle=i) if i in self._ids:
                state.lives.restart(i, message.begin, message.tick)
            case Hello():
                self._grant_heard = True

    def _from_host(self, h: int, message: Message) -> None:
        if isinstance(message, Hello):
            _check_version(message)
            self._probes.spend(-h)
            self._hosts.greet(h, _ECHO)
            return
        assert isinstance(message, Bundle)
        out: list[Out] = []
        try:
            for part in message.parts:
                try:
                    self._hosts.check(h, part.vehicle)
                    out += self._from_agent(part.vehicle, part.message)
                except (MalformedMessage, OutOfPlace) as error:
                    self._reject(self._keys.cmd(part.vehicle), error)
        finally:
            self._publish(out)  # also when one vehicle cannot be moved: the others were

    def _from_agent(self, i: int, data: bytes) -> list[Out]:
        message = expect(data, Command, Hello)
        if i not in self._nav:
            raise MalformedMessage("cmd", f"no vehicle {i} in this run")
        if isinstance(message, Command):
            if len(data) > PART_BYTES:
                raise MalformedMessage("cmd", f"{len(data)} bytes; at most {PART_BYTES} fit into a frame")
            out = self._take_command(i, message, data)
            self._received["cmd"] += 1
            return out
        if isinstance(message, Hello):
            _check_version(message)
            if message.echo:
                self._ready.add((i, message.incarnation))
            else:
                self._probes.spend(i)
                self._nav_to(i, _ECHO)
        return []

    def _take_command(self, i: int, command: Command, data: bytes) -> list[Out]:
        if not self._turns.holds(i):
            raise OutOfPlace("tick", "no command (no nav is unanswered)", command.tick)
        out = self._run.command(i, command, data)
        self._turns.release(i)
        return out

    def _publish(self, out: list[Out]) -> None:
        for i, tick, text in self._state.notes:
            self._mailbox.note(i, tick, text)
        self._state.notes.clear()
        round_over = False
        for item in out:
            if isinstance(item, NavTo):
                self._ask(item.id, item.nav)
            elif isinstance(item, Round):
                round_over = True
                self._send_round(item)
                self._turns.on_round_passed(item.tick)
        while (turn := self._turns.take()) is not None:
            self._send_navs(turn)
        with self._frames_lock:
            for item in out:
                if isinstance(item, Frame):
                    self._add_frame(item)
            if round_over:
                self._flush_frames()  # the console can write them as soon as netem has reported

    def _send_round(self, item: Round) -> None:
        alive = [*zip(item.alive, item.positions, strict=True)]
        for part, more in split(alive, lambda _: ROUND_BYTES, PART_BYTES):
            self._sent["round"] += 1
            there, positions = zip(*part, strict=True) if part else ((), ())
            self._round(encode(Round(item.tick, there, positions, () if more else item.paused, more)))

    def _ask(self, i: int, nav: Nav) -> None:
        self._turns.ask(i, nav)

    def _asked(self, i: int) -> bool:
        """Whether agent i has been asked, and not only waits for its turn."""
        return self._turns.holds(i)

    def _send_navs(self, turn: Turn) -> None:
        self._sent["nav"] += len(turn)
        i, nav = turn[0]
        if host := self._hosts.of(i, nav.incarnation):
            self._hosts.put(host, [(i, encode(nav)) for i, nav in turn])
        else:
            self._nav_to(i, encode(nav))

    def _nav_to(self, i: int, data: bytes) -> None:
        if self._ends is None or not self._ends.put(i, data):
            self._nav[i](data)

    def _tell(self, i: int, incarnation: int, data: bytes) -> None:
        if host := self._hosts.of(i, incarnation):
            self._hosts.put(host, [(i, data)])
        else:
            self._nav_to(i, data)

    def _add_frame(self, frame: Frame) -> None:
        for said, _ in split(frame.said, _said_bytes, PART_BYTES) if frame.said else ():
            self._add_part(Frame(frame.tick, True, (), (), (), tuple(said)), sum(map(_said_bytes, said)))
        lives, tumbles = frame.lives, frame.tumbles
        for rows, more in split(frame.vehicles, _row_bytes, PART_BYTES):
            part = Frame(frame.tick, more, lives, tumbles, tuple(rows))
            self._add_part(part, sum(map(_row_bytes, rows)))
            lives, tumbles = (), ()

    def _add_part(self, part: Frame, size: int) -> None:
        if len(self._frames) >= FRAMES_PER_MESSAGE or self._frames_bytes + size > PART_BYTES:
            self._flush_frames()
        self._frames.append(part)
        self._frames_bytes += size

    def _flush_frames(self) -> None:
        if self._frames:
            self._flushed_s = monotonic()
            self._sent["frame"] += 1
            self._frame(encode(Frames(tuple(self._frames))))
            self._frames.clear()
            self._frames_bytes = 0

    def _token(self, key: str, alive: bool) -> None:
        state = self._state
        for i in () if alive or self._run.finished else self._token_roles.get(key, ()):
            # The end of the token of an agent that was to end may come only when the next agent has begun.
            if not state.lacks_agent(i) and not state.incarnation(i):
                self._mailbox.note(i, state.tick_of(i), "its session ended")

    def _control(self, key: str, data: bytes, respond: Respond) -> None:
        """Answer the console, on a zenoh thread, while the main thread may wait: of the run this only reads."""
        try:
            request = read_map(data)
        except MalformedMessage as error:
            respond(msgpack.packb({"error": str(error)}))
            return
        match request.get("op"):
            case "ready":
                self._round(_PROBE)
                self._frame(_ECHO)
                respond(msgpack.packb({"ready": sorted(map(list, self._ready.copy())), "grant": self._grant_heard}))
            case "waiting":
                with self._frames_lock:
                    self._flush_frames()  # who asks sees no progress, and nothing may hold it back
                waiting = [list(pair) for pair in self._run.waiting_for if self._asked(pair[0])]
                respond(msgpack.packb({"waiting": waiting}))
            case "ticks":
                respond(msgpack.packb({"ticks": [[i, self._state.tick_of(i)] for i in self._ids]}))
            case "dismiss":
                for i, incarnation, tick in request["agents"]:
                    self._tell(i, incarnation, encode(End(incarnation, tick, request["reason"])))
                respond(msgpack.packb({}))
            case "close":
                counts = {"sent": self._sent, "received": self._received}
                respond(msgpack.packb({"rejected": self._rejected(), "counts": counts, "timing": self._timing()}))
            case other:
                respond(msgpack.packb({"error": f"no operation {other!r:.40}"}))

    def _rejected(self) -> dict[str, int]:
        # Copies, which are made in one piece: other threads count meanwhile.
        return {**self._mailbox.rejected.copy(), **self._refusals.counts.copy()}

    def _timing(self) -> dict[str, Any]:
        """How the world and the agents kept up with the wall clock; empty in lockstep."""
        return {}


def _check_version(hello: Hello) -> None:
    if hello.version != PROTOCOL_VERSION:
        raise MalformedMessage("hello", f"protocol version {hello.version}, ours is {PROTOCOL_VERSION}")


def _check_faults(faults: tuple[WorldFault, ...]) -> tuple[WorldFault, ...]:
    for fault in faults:
        if len(fault.values) != (expected := fault.kind.numbers):
            got = len(fault.values)
            raise MalformedMessage("faults", f"{fault.id!r:.40}: {fault.kind} has {expected} values, not {got}")
    return faults


def _row_bytes(row: VehicleFrame) -> int:
    # Nine bytes per double of state, measurement and tau, a little for the rest.
    return 240 + len(row.command) + 9 * (len(row.plant) + 2 + len(row.belief)) + FIX_BYTES * len(row.fixes)


def _said_bytes(line: SaidBy) -> int:
    return 32 + 4 * len(line.said.text)  # UTF-8 takes up to four bytes for a character
