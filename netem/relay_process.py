"""The process between robots that are not ours: their sessions and sockets, a relay, and a pipe to the console.

Other threads put what comes into one queue, with its time. The main thread takes it and hands over what is due. In each
round it tells the console the fate of each packet. The console is another process, so a slow disk delays no packet.
"""

from __future__ import annotations

import gc
import os
import socket
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic_ns, process_time, sleep
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct

from netem.discovery import Discovery
from netem.endpoint import ModemChannel, ModemEndpoint, ModemRequest
from netem.errors import BusError
from netem.faults import read_faults
from netem.histogram import Histogram
from netem.isolated import IpPacket, IsolatedRobots
from netem.limits import LINK_UNDER_WAY, LONGEST_DATAGRAM, RELAY_WAITING
from netem.relay import DueMessage, MessageFate, Relay
from netem.relay_messages import LoggedMessage, Opened, Port, RelayReport, Setup, WatchedMessage
from netem.robot_message import DATAGRAM, MODEM, PACKET, PUT, QUERY, REPLY, RobotMessage
from netem.wire import robots
from netem.wire.queries import OpenQueries, Ticket
from netem.wire.robot_queues import Inlet
from netem.wire.robots import Robot, Token, Unfit
from netem.wire.session import quiet_zenoh

MOST_KEPT_BYTES = 1_000_000  # the bytes of a longer message are not logged
MOST_NOTES = 1000
SILENT_NS = 10_000_000_000  # after such a silence another program may be the sender of datagrams
SLOW_NS = 100_000_000  # a robot that keeps a message waiting for longer is named
_BEHIND = 64  # reports that the console may be behind before the relay waits for it
_SWITCH_S = 0.0005  # what comes waits so long for the interpreter's lock at most, and not 5 ms as by default
_UDP = "udp/"  # what the keys of datagrams begin with
_BATCH = 500  # what comes is taken so often before the relay looks for what is due


class _Moved(NamedTuple):
    robot: int
    place: tuple[float, ...]


class _Datagram(Struct):
    port: Port
    at_ns: int
    payload: bytes
    sender: Any  # address of the sending program


def run(pipe: Connection, setup: Setup) -> None:
    """Serve until the console says so, or is gone. It first gets an `Opened`."""
    quiet_zenoh()
    os.environ.pop("ZENOH_RUNTIME", None)
    sys.setswitchinterval(_SWITCH_S)
    queue: SimpleQueue[Any] = SimpleQueue()
    try:
        process = RelayProcess(pipe, setup, queue)
    except BusError as error:
        pipe.send_bytes(msgspec.msgpack.encode(Opened(problem=str(error))))
        return
    pipe.send_bytes(msgspec.msgpack.encode(Opened(process.ports, process.opened, process.isolated_files)))
    try:
        begin_ns = msgspec.msgpack.decode(pipe.recv_bytes())["at_ns"]
        gc.freeze()
        process.serve(begin_ns)
    except EOFError:
        pass  # the console is gone
    except BusError as error:
        process.fail(error)
    finally:
        process.close_modems()  # a terminal would stay as a link to nothing


class RelayProcess:
    """The sessions, sockets and relay of one run."""

    def __init__(self, pipe: Connection, setup: Setup, queue: SimpleQueue[Any]) -> None:
        """Open everything. Raises BusError: an address is in use, or nobody answers there."""
        self._pipe, self._setup, self._queue = pipe, setup, queue
        self._robots: dict[int, Robot] = {}
        self._sockets: dict[tuple[int, int], socket.socket] = {}
        self._senders: dict[int, tuple[Any, int]] = {}  # by robot: where its datagrams come from, and since when
        self._names = {endpoint.number: endpoint.name for endpoint in setup.robots}
        self._modems: dict[int, ModemEndpoint] = {}  # by robot
        self.opened: dict[int, str] = {}  # by robot: where programs open it
        self._outgoing: SimpleQueue[bytes | None] = SimpleQueue()
        self._notes: list[str] = []
        self._logged: list[LoggedMessage] = []
        self._watched: list[WatchedMessage] = []
        self._end: int | None = None  # the tick before which the run ends, as soon as that is known
        self._begin_ns: int | None = None  # when tick 0 begins; None: programs get ready, and it is not known yet
        self._rehearsal: Relay | None = None  # the relay of that time, as long as something of it is under way
        self._faults: Any = None  # those that the console gave last; None: those of the settings
        self._inlets = {endpoint.number: Inlet(queue.put) for endpoint in setup.robots}
        self._refused: Counter[int] = Counter()  # by robot: messages that found no room on their way here
        self._hearers: dict[int, set[int]] = {}  # by robot: those that get its queries and tokens
        self._queries = OpenQueries(self._hearers, self._end_query)
        self._kept_ns: dict[int, int] = {}  # by robot: how long it let a message wait at most
        self._untaken: Counter[int] = Counter()  # by robot: messages that it did not take
        self._told: set[str] = set()
        self._who: dict[str, int] = {}  # by zenoh id of a router: the robot that reaches it
        self._came = Histogram()  # how long what comes waits for this process
        self._isolated = IsolatedRobots(setup.isolated, self._names, setup.config.links)  # before there is any thread
        try:
            for endpoint in setup.robots:
                if endpoint.listen or endpoint.connect:
                    self._robots[endpoint.number] = Robot(endpoint, setup.carry, self._inlets[endpoint.number])
            for modem in setup.modems:
                self.opened[modem.number] = modem.listen()
                self._modems[modem.number] = modem
            for port in setup.ports:
                self._sockets[port.src, port.dst] = _bound(port)
            self._targets = {port: (_address(port.host), port.to) for port in setup.ports}
        except BusError:
            self._close()
            raise
        for src, dst in setup.config.links:
            if dst in self._robots:
                self._hearers.setdefault(src, set()).add(dst)
        self._twice()

    @property
    def isolated_files(self) -> dict[int, tuple[str, ...]]:
        """By robot in a network namespace of its own: the files that its programs enter."""
        return self._isolated.files

    @property
    def ports(self) -> dict[int, int]:
        """The ports that the system chose, by robot."""
        return {i: robot.port for i, robot in self._robots.items() if robot.port}

    def serve(self, begin_ns: int | None) -> None:
        """Hand over what is due, until the run is over or the console ends it.

        Args:
            begin_ns: when tick 0 begins; None: programs get ready first, and the console says it meanwhile. The network
                carries what they say to each other, without faults, and nothing of that is in the log.
        """
        self._begin_ns = begin_ns
        now = monotonic_ns()
        self._relay = self._made(now if begin_ns is None else begin_ns, rehearses=begin_ns is None)
        self._begin_modems(now if begin_ns is None else begin_ns)  # programs that get ready ask them
        self._discovery = Discovery(
            self._robots,
            self._hearers,
            lambda: self._relay,
            self._note,
            linked=self._setup.linked,
            lost_after_ns=self._setup.lost_after_ns,
        )
        self._sender = Thread(target=self._send, daemon=True)
        self._sender.start()
        Thread(target=self._listen, daemon=True).start()
        for port in self._setup.ports:
            Thread(target=self._receive, args=(port, self._sockets[port.src, port.dst]), daemon=True).start()
        self._isolated.listen(self._inlets)
        for i, robot in self._robots.items():
            robot.begin()
            if i in self._setup.place_topics:
                robot.follow(self._setup.place_topics[i])
        for which, watched in enumerate(self._setup.watched):
            if watched.robot in self._robots and not watched.key.startswith(_UDP):
                self._robots[watched.robot].watch(watched.key, partial(self._see, which), token=watched.token)
        if begin_ns is None:
            self._rehearse()
        if self._end is None:
            self._serve()
        self._last(min(self._end or 0, self._setup.ticks))

    def _made(self, begin_ns: int, *, rehearses: bool) -> Relay:
        config = replace(self._setup.config, faults=()) if rehearses else self._setup.config
        header, fragments = self._setup.header, self._setup.fragments
        relay = Relay(config, begin_ns, header=header, fragments=fragments, modems=self._modems)
        relay.places.update(self._setup.places)
        return relay

    def _rehearse(self) -> None:
        """Carry what programs say while they get ready."""
        while self._end is None and (self._begin_ns is None or monotonic_ns() < self._begin_ns):
            now = monotonic_ns()
            self._turn(min(now + self._round_ns, self._begin_ns or now + self._round_ns))
            self._discovery.update(monotonic_ns())
            self._relay.report(self._relay.tick(monotonic_ns()))  # forgotten
            self._report(-1, [])
        self._rehearsal = self._relay
        self._relay = self._made(self._begin_ns or 0, rehearses=False)
        self._relay.places.update(self._rehearsal.places)
        if self._faults is not None:
            self._relay.faults = self._faults

    def _begin_modems(self, begin_ns: int) -> None:
        acoustic = self._setup.config.acoustic
        if acoustic is None:
            return
        config, names = self._setup.config, self._names
        access_s = acoustic.longest_access_s(config.tick_ns, len(config.vehicles))
        addresses = {names[i]: modem.address for i, modem in self._modems.items()}
        for i, modem in self._modems.items():

            def place(i: int = i) -> tuple[float, ...]:
                return self._relay.places.get(i, (0.0, 0.0, 0.0))

            def move(to: tuple[float, ...], i: int = i) -> None:
                self._queue.put(_Moved(i, to))

            longest = acoustic.longest(config.tick_ns, i) - self._setup.header
            modem.begin(
                ModemChannel(acoustic.modem_of(i), longest, acoustic.buffer, access_s, acoustic.sound_speed, begin_ns,
                    config.seed, names[i], addresses, self._queue.put, place, move)
            )  # fmt: skip

    def _serve(self) -> None:
        assert self._begin_ns is not None
        config, begin_ns = self._setup.config, self._begin_ns
        reported = 0  # rounds
        while self._end is None:
            next_round = begin_ns + (reported + 1) * self._round_ns + config.tick_ns
            self._turn(next_round)
            now = monotonic_ns()
            if now >= next_round:
                reported = (now - begin_ns - config.tick_ns) // self._round_ns
                if reported * config.round_ticks >= self._setup.ticks:
                    self._end = self._setup.ticks
                    break
                self._discovery.update(now)
                until = reported * config.round_ticks
                self._report(until, self._relay.report(until))

    @property
    def _round_ns(self) -> int:
        return self._setup.config.round_ticks * self._setup.config.tick_ns

    def _turn(self, most_ns: int) -> None:
        """Wait until something comes or is due, at most to a time, and do what there is to do."""
        now, due = monotonic_ns(), self._relay.due_ns()
        until = most_ns if due is None else min(due, most_ns)
        if until > now:
            with suppress(Empty):
                self._take(self._queue.get(timeout=(until - now) / 1e9))
        for _ in range(min(_BATCH, self._queue.qsize())):
            self._take(self._queue.get_nowait())
        self._refuse()
        self._hand_over()
        self._settle()

    def _see(self, which: int, key: str, payload: bytes) -> None:
        """Keep something that is watched; zenoh calls it on a thread of its own."""
        if len(payload) <= MOST_KEPT_BYTES:
            self._queue.put(WatchedMessage(which, monotonic_ns(), key, payload))

    def _take(self, item: Any) -> None:
        match item:
            case Token():
                self._discovery.announce(item)
            case robots.Linked():
                self._linked(item)
            case _Datagram(port, at_ns, payload, sender):
                self._inlets[port.src].release(len(payload))
                known, heard_ns = self._senders.get(port.src, (sender, at_ns))
                if sender == known or at_ns - heard_ns > SILENT_NS:
                    self._senders[port.src] = sender, at_ns
                key = f"{_UDP}{port.port}"
                for which, watched in enumerate(self._setup.watched):
                    if watched.robot == port.src and watched.key == key:
                        self._watched.append(WatchedMessage(which, at_ns, key, payload))
                self._send_message(RobotMessage(port.src, DATAGRAM, key, payload, at_ns, port, port.dst))
            case IpPacket():
                self._inlets[item.robot].release(len(item.payload))
                if isinstance(message := self._isolated.message(item), str):
                    self._note(message)
                else:
                    self._send_message(message)
            case ModemRequest(robot):
                key = f"{MODEM}/{item.to}/{item.what}"
                self._send_message(RobotMessage(robot, MODEM, key, item.payload, monotonic_ns(), item))
            case _Moved(number, place):
                self._relay.places[number] = place
            case WatchedMessage():
                self._watched.append(item)
            case dict():
                self._asked(item)
            case None:
                raise EOFError
            case _:
                self._message(item)

    def _message(self, item: Any) -> None:
        message = robots.read(item)
        if message is None:
            self._queries.on_robot_ended(item.ticket, item.robot)
            return
        self._inlets[message.src].release(len(message.payload))
        if message.kind == QUERY:
            self._queries.begin(message.what, len(message.payload))
        elif message.kind == REPLY:
            self._queries.add_replies(message.what[0], message.src)
        self._send_message(message)

    def _send_message(self, message: RobotMessage) -> None:
        if self._setup.payloads and len(message.payload) <= MOST_KEPT_BYTES:
            encoding = str(message.what.encoding) if message.kind == PUT else ""
            tick = self._relay.tick(message.at_ns)
            self._logged.append(LoggedMessage(tick, message.src, message.key, message.kind, encoding, message.payload))
        self._relay.take(message)

    def _refuse(self) -> None:
        """Lose what found no room on its way here. A query of it has ended; who waits for a reply waits on."""
        for src, inlet in self._inlets.items():
            for name, count in inlet.unfit().items():
                what = name if isinstance(name, Unfit) else Unfit(PUT, "", 0)
                self._refused[src] += count
                if what.ticket is not None:
                    self._queries.add_replies(what.ticket, src, count)
                for _ in range(count):
                    message = RobotMessage(src, what.kind, what.key, b"", monotonic_ns(), to=what.to)
                    self._relay.refuse(message, what.size)

    def _end_query(self, ticket: Ticket) -> None:
        self._robots[ticket.asker].outlet.do(ticket.end)  # behind its answers

    def _asked(self, request: dict[str, Any]) -> None:
        match request["op"]:
            case "begin":
                self._begin_ns = request["at_ns"]
            case "faults":
                self._faults = read_faults(request["faults"])
                if self._begin_ns is not None and monotonic_ns() >= self._begin_ns:  # none acts before tick 0
                    self._relay.faults = self._faults
            case "places":
                self._relay.places.update({int(i): tuple(place) for i, place in request["places"].items()})
            case "close":
                self._end = self._relay.tick(monotonic_ns()) + 1

    def _hand_over(self) -> None:
        self._hand_over_of(self._relay)
        if self._rehearsal is not None:
            self._hand_over_of(self._rehearsal)
            if self._rehearsal.empty:
                self._rehearsal = None

    def _hand_over_of(self, relay: Relay) -> None:
        for due in relay.due_messages(monotonic_ns()):
            if due.message.kind in (DATAGRAM, PACKET):
                at_ns = monotonic_ns()
                relay.late.add(at_ns - due.due_ns)
                is_packet = due.message.kind == PACKET
                given = self._isolated.hand(due.dst, due.payload) if is_packet else self._sent(due)
                self._has_ended(due, at_ns, delivered=given)
            elif due.message.kind == MODEM and (modem := self._modems.get(due.dst)) is not None:
                self._heard(due, modem, relay)
            elif not self._offered(due):
                self._has_ended(due, monotonic_ns(), delivered=False)

    def _heard(self, due: DueMessage, modem: ModemEndpoint, relay: Relay) -> None:
        """Give a frame to a modem that programs open; it is there then, whether one listens or not."""
        relay.hand_to(modem, due)
        at_ns = monotonic_ns()
        relay.late.add(at_ns - due.due_ns)
        self._has_ended(due, at_ns, delivered=True)

    def _offered(self, due: DueMessage) -> bool:
        """Give a message to the outlet of its robot. False: the robot has none, or too much waits there."""
        message, payload, robot = due.message, due.payload, self._robots.get(due.dst)
        if robot is None:
            return False
        hand = partial(robot.hand, message, payload)
        if message.kind == QUERY:
            hand = partial(robot.ask, message.what, payload)
        elif message.kind == REPLY:
            hand = partial(robots.answer, message, payload)
        if not robot.outlet.offer(due, due.due_ns, len(payload), hand):
            return False
        if message.kind == REPLY:
            self._queries.on_reply(message.what[0], message.src)
        return True

    def _sent(self, due: DueMessage) -> bool:
        """Send a datagram. False: the system refuses it, or no port of its receiver is known."""
        port: Port = due.message.what
        back = self._sockets.get((due.dst, port.src)) or self._sockets[port.src, due.dst]
        address = self._targets[port] if port.to else self._senders.get(due.dst, (None, 0))[0]
        if address is None:
            return False
        try:
            back.sendto(due.payload, address)
        except OSError as error:
            where = f"{address[0]}:{address[1]}"
            self._note(f"datagrams for {self._names[due.dst]} cannot be sent to {where}: {error.strerror}")
            return False
        return True

    def _settle(self) -> None:
        """Take from the outlets what has become of messages. Their robots are judged here, the host by `late`."""
        for i, robot in self._robots.items():
            for due, at_ns, late_ns, kept_ns, delivered, problem in robot.outlet.outcomes():
                if problem:
                    self._note(problem)
                self._giver(due).late.add(late_ns)
                self._kept_ns[i] = max(kept_ns, self._kept_ns.get(i, 0))
                self._has_ended(due, at_ns, delivered=delivered)
            for problem in robot.outlet.problems():
                self._note(f"{robot.name}: {problem}")

    def _has_ended(self, due: DueMessage, at_ns: int, *, delivered: bool) -> None:
        self._untaken[due.dst] += not delivered
        self._giver(due).settle(due, at_ns, delivered=delivered)

    def _giver(self, due: DueMessage) -> Relay:
        """The relay that has given out a message: that of the time before t = 0 counts for no result."""
        before = self._rehearsal
        return before if before is not None and before.gave(due) else self._relay

    def _linked(self, link: robots.Linked) -> None:
        robot = self._robots[link.robot]
        if not link.begins and link.who in self._who:
            self._note(f"{robot.name}: the router is gone; it is looked for until it is back")
        self._twice()

    def _twice(self) -> None:
        """Note two robots that reach one router: what one puts would come back through the other for ever."""
        for number, robot in self._robots.items():
            for who in robot.routers:
                other = self._who.setdefault(who, number)
                if other != number:
                    first = self._robots[other].name
                    raise BusError(f"{first} and {robot.name} reach the same zenoh network ({who}): give each its own")

    def _note(self, text: str) -> None:
        """Tell the console something; the same thing once."""
        if text not in self._told and len(self._told) < MOST_NOTES:
            self._told.add(text)
            self._notes.append(text)

    def _report(self, until: int, fates: list[MessageFate]) -> None:
        placed = [(i, *robot.placed.pop()) for i, robot in self._robots.items() if robot.placed]
        logged = self._logged if until >= 0 else []
        report = RelayReport(until, fates, logged, placed, self._notes, self._watched)
        self._logged, self._notes, self._watched = [], [], []
        self._outgoing.put(msgspec.msgpack.encode(report))
        while self._outgoing.qsize() > _BEHIND:
            self._sender.join(0.01)

    def _last(self, end: int) -> None:
        self._settle()
        self._sum_up()
        fates = self._relay.close(end)
        closing = {
            "entered": [[*link, *counts] for link, counts in self._relay.entered.items()],
            "late": self._relay.late.to_values(),
            "came": self._came.to_values(),
            "cpu_s": process_time(),
        }
        # Programs notice that their ports are closed, and may end. Before the last tick that would count as a failure.
        tick_ns = self._setup.config.tick_ns
        sleep(min(max(0, (self._begin_ns or 0) + end * tick_ns - monotonic_ns()), tick_ns) / 1e9)
        self._end_with(RelayReport(end, fates, self._logged, [], self._notes, self._watched, closing))

    def _sum_up(self) -> None:
        """Notes about the whole run: who was slow, what stayed with its robot, what found no room."""
        names = self._names
        for i, name in names.items():
            if (kept_ns := self._kept_ns.get(i, 0)) > SLOW_NS or self._untaken[i]:
                waited = f"kept messages waiting for up to {kept_ns / 1e9:.3g} s" if kept_ns > SLOW_NS else ""
                lost = f"did not take {self._untaken[i]} messages (lost: receiver)" if self._untaken[i] else ""
                self._note(f"{name} {' and '.join(filter(None, (waited, lost)))}")
        for i, count in sorted(self._refused.items()):
            most = f"more than {RELAY_WAITING.items} messages or {RELAY_WAITING.bytes >> 20} MiB waited for the relay"
            self._note(f"{names[i]}: {most}; {count} were lost (queue)")
        for src, dst in sorted(self._relay.full):
            most = f"more than {LINK_UNDER_WAY.bytes >> 20} MiB were under way"
            self._note(f"{names[src]}->{names[dst]}: {most}; what did not fit was lost (queue)")
        for i, modem in self._modems.items():
            if remark := modem.remark:
                self._note(f"{names[i]}: {remark}")
        matched = set[int]()
        for robot in self._robots.values():
            matched |= robot.matched
            if count := robot.stayed.total():
                some = ", ".join(repr(key) for key, _ in robot.stayed.most_common(3))
                what = f"{count} messages, queries and replies whose keys no expression of carry includes ({some})"
                self._note(f"{robot.name}: {what} stayed with it")
        for number, key in enumerate(self._setup.carry):
            if self._robots and number not in matched and key != "**":
                self._note(f"carry: nothing came on {key}")

    def fail(self, error: BusError) -> None:
        """Tell the console why this cannot go on."""
        tick = self._relay.tick(monotonic_ns())
        self._end_with(RelayReport(tick, [], closing={"error": str(error)}))

    def _end_with(self, report: RelayReport) -> None:
        self._outgoing.put(msgspec.msgpack.encode(report))
        self._outgoing.put(None)
        self._sender.join()
        self._close()

    def _send(self) -> None:
        with suppress(OSError):  # the console is gone
            while (data := self._outgoing.get()) is not None:
                self._pipe.send_bytes(data)

    def _listen(self) -> None:
        try:
            while True:
                request = msgspec.msgpack.decode(self._pipe.recv_bytes())
                if request["op"] == "ping":  # as late as what comes from robots, which another thread takes, too
                    self._came.add(monotonic_ns() - request["at_ns"])
                else:
                    self._queue.put(request)
        except (EOFError, OSError):
            self._queue.put(None)

    def _receive(self, port: Port, listening: socket.socket) -> None:
        inlet = self._inlets[port.src]
        with suppress(OSError):  # closed at the end
            while True:
                payload, sender = listening.recvfrom(LONGEST_DATAGRAM.bytes)
                name = partial(Unfit, DATAGRAM, f"{_UDP}{port.port}", len(payload), port.dst)
                inlet.offer(_Datagram(port, monotonic_ns(), payload, sender), len(payload), name)

    def _close(self) -> None:
        self._isolated.close()
        for each in self._sockets.values():
            each.close()
        self.close_modems()
        for robot in self._robots.values():
            robot.close()

    def close_modems(self) -> None:
        """Close the ports and terminals of modems."""
        for modem in self._modems.values():
            modem.close()
        self._modems = {}


def _address(host: str) -> str:
    """The address of a host for datagrams. Raises BusError: there is no such host."""
    try:
        return str(socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0])
    except OSError as error:
        raise BusError(f"datagrams cannot go to {host}: {error.strerror}; give a host with an IPv4 address") from None


def _bound(port: Port) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind((_address(port.at), port.port))
    except OSError as error:
        made.close()
        where = f"{port.at}:{port.port}"
        raise BusError(f"cannot listen on {where} for datagrams: {error.strerror}") from None
    except BusError:
        made.close()
        raise
    return made
