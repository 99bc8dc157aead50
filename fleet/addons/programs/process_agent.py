"""A program as an agent: real processes in simulated time, whose packets are payloads of the rounds."""

from __future__ import annotations

import json
import os
import re
import struct
import sys
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from random import Random
from typing import Any, ClassVar, NamedTuple

from agents.api import AgentConfig, Delivery, FormationAgent, Nav, Said, Signal, Telemetry, Vec3
from agents.packets import BEGIN, EVERYBODY, V4, Datagram, DatagramAssembly, Segment, node_address, read
from fleet.addons.programs.address_book import AddressBook
from fleet.addons.programs.attachment import attachment
from fleet.addons.programs.helpers import helper_command
from fleet.addons.programs.home import copy_of_disk
from fleet.addons.programs.known_ports import (
    COMMAND_PORT,
    MODEM_AGENT_PORT,
    MODEM_PORT,
    NAVIGATION_PORT,
    READY_PORT,
    WATER_PORT,
    ZENOH_PORT,
)
from fleet.addons.programs.line_signal import LineSignal
from fleet.addons.programs.message_signal import MessageSignal, NoNumber
from fleet.addons.programs.modem_beside import ModemBeside, is_for_modem, modem_beside, to_modem
from fleet.addons.programs.processes import EPOCH_NS, Process, Processes, ProgramEnded
from fleet.addons.programs.shared_sockets import KINDS as SOCKET_KINDS
from fleet.addons.programs.shared_sockets import SharedSockets
from fleet.addons.programs.steering import SteeredVehicle, navigation
from fleet.addons.programs.streams import Streams
from fleet.addons.programs.udp_ways import UdpWays
from fleet.addons.programs.zenoh_messages import puts
from world.plugins.kept_files import kept_folder
from world.plugins.output import line_writer

NS = 10**9
MOST_IN_ROUND = 40_000  # bytes; the transport carries 48 kB in a message
PROCESSORS = 4  # that a program sees; with one, executors of ROS 2 have one thread and handle no cancel in time
MOST_QUEUED = 1 << 20  # bytes that wait for a round; what comes then is lost, as in a full network card
_ADDRESSES = struct.Struct("<16sH16sH")
_STILL: Vec3 = (0.0, 0.0, 0.0)  # N, N m, N m
_LOOPBACK = V4 + b"\x7f\0\0\x01"


class OtherProgram(NamedTuple):
    """A program that runs beside the agent's, on the same host."""

    name: str
    command: tuple[str, ...]  # may have the places that arguments have
    environment: Mapping[str, Any]
    ends: str  # whether it may end by itself, see `several_programs`


class ReadyLine(NamedTuple):
    """What a program prints when it is ready, as every life of it has to."""

    name: str  # of the program
    pattern: re.Pattern[str]
    within_ns: int


@dataclass(slots=True)
class _Stretch:
    """Ticks in a row in which the same has come to a program: nothing, or one tick with something."""

    begin_ns: int
    packets: list[Delivery]
    nav: Nav | None  # None: its vehicle is moored
    ticks: int = 1


class ProcessAgent:
    """One life of a program. When the agent is dropped, the program is killed."""

    plugin_file: ClassVar[Path]
    command: ClassVar[tuple[str, ...]]
    together: ClassVar[tuple[OtherProgram, ...]]
    ends: ClassVar[str]  # whether it may end by itself while others run
    awaits: ClassVar[tuple[ReadyLine, ...]]
    variables: ClassVar[Mapping[str, str]]  # of its environment, unless the scenario gives others
    beside: ClassVar[tuple[str, ...]]  # a program of ours that gets the agent's number; (): none
    reads: ClassVar[tuple[LineSignal, ...]]
    watches: ClassVar[tuple[MessageSignal, ...]]
    signals: ClassVar[tuple[Signal, ...]]

    def __init__(
        self,
        config: AgentConfig,
        arguments: Sequence[Any] = (),
        signals: Any = None,
        addresses: Mapping[str, int] | None = None,
        env: Mapping[str, Any] | None = None,
        files: Sequence[str] = (),
        epoch: str = "",
        processors: int = PROCESSORS,
        udp: Mapping[str, Any] | None = None,
        modem: Mapping[str, Any] | None = None,
        **_: Any,
    ) -> None:
        """Prepare the program; it is started with the agent's first tick.

        Args:
            config: the agent's slice.
            arguments: of the command line; `{id}`, `{seed}` and `{zenoh}` stand for the agent's number, the run's seed,
                and where a zenoh program connects.
            signals: read by `process_class`.
            addresses: agents by `HOST:PORT` or `HOST`.
            env: variables of the environment.
            files: files and folders that are copied into the program's home, beside the program.
            epoch: the time at the beginning of the run, such as `2026-06-01T12:00:00`, in UTC; "": 2026-01-01.
            processors: how many the program sees.
            udp: ports of the own host that stand for those of other agents, see `UdpWays`.
            modem: an acoustic modem that the program opens, as a file of nodes has it; None: there is none.
        """
        self._config, self._tick_ns = config, config.tick_ns
        words = {"id": config.id, "seed": config.seed, "zenoh": _ENDPOINT}
        given = ("{zenoh}" if word == "tcp/unused" else str(word) for word in arguments)  # scenarios of 1.0 say so
        self._words = [_fill_places(word, words) for word in (*self.command, *given)]
        self._environment = dict(self.variables) | {
            key: _fill_places(str(value), words) for key, value in (env or {}).items()
        }
        self._words = self._all_words(words)
        folder = self.plugin_file.parent
        self._files = [path if path.is_absolute() else folder / path for path in map(Path, files)]
        self._book = AddressBook(config, addresses or {})
        self._formation = FormationAgent(config)
        self._epoch_ns = epoch_ns(epoch) if epoch else EPOCH_NS
        self._processors, self._udp = processors, dict(udp or {})
        self._modem = modem_beside(config.id, modem) if modem else None
        self._place: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._life: _Life | None = None
        self._owner = os.getpid()
        self._history: list[_Stretch] = []
        counts = {each.name: each.counts for each in self.reads} | {each.name: each.counts for each in self.watches}
        self.values: dict[str, float | None] = {name: 0.0 if counted else None for name, counted in counts.items()}
        self._awaited = [*self.awaits]  # programs that are not ready yet
        self._begin_ns = 0
        self._unread: set[str] = set()  # signals of which a message had no number
        self._said: list[Said] = []
        self._unheard: set[int] = set()  # neighbours whose laws send what no program can hear
        self._write_line = line_writer(f"agent-{config.id}.log")
        self._disk = kept_folder(f"agent-{config.id}")
        self._disk_before = None if self._disk is None else copy_of_disk(self._disk)

    def _all_words(self, places: Mapping[str, Any]) -> list[str]:
        """The command line of all that runs on the host."""
        if not self.together:
            return self._words
        programs: list[Any] = [[self.plugin_file.name, self._words, {}, self.ends]]
        for each in self.together:
            variables = {key: _fill_places(str(value), places) for key, value in each.environment.items()}
            programs.append([each.name, [_fill_places(word, places) for word in each.command], variables, each.ends])
        files = [word for _, words, _, _ in programs for word in words if word.startswith("/")]
        return helper_command("fleet.addons.programs.several_programs", json.dumps(programs), *files)

    def __del__(self) -> None:
        life = getattr(self, "_life", None)
        if life is not None and not sys.is_finalizing():
            life.processes.close()

    def transmit(self, nav: Nav) -> Sequence[bytes]:
        """What the agent that steers sends, and of what the program has sent as much as fits into a round."""
        steering = [] if self._config.moored else list(self._formation.transmit(nav))
        return [*steering, *(self._life.leaving(MOST_IN_ROUND - sum(map(len, steering))) if self._life else ())]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Hand over what has come, and let the program run until it waits."""
        now_ns, deliveries = nav.tick * self._tick_ns, list(deliveries)
        if self._config.moored:
            tau = _STILL
        else:
            tau, _ = self._formation.decide(nav, [each for each in deliveries if not is_for_modem(each)])
        steers, self._place = None if self._config.moored else nav, nav.eta[:3]
        packets = [each for each in deliveries if each.payload.startswith(BEGIN) or is_for_modem(each)]
        self._note_laws(now_ns, deliveries)
        if os.getpid() != self._owner:
            self._repeat()
        self._remember(now_ns, packets, steers)
        life = self._step(now_ns, packets, steers, tell=True)
        return life.vehicle.demand(nav) or tau, self.values

    def _note_laws(self, now_ns: int, deliveries: Iterable[Delivery]) -> None:
        """Say once of each neighbour that a law of it sends what no program can hear."""
        for each in deliveries:
            is_message = each.payload[:1] == BEGIN[:1]
            if is_message and not each.payload.startswith(BEGIN) and each.src not in self._unheard:
                self._unheard.add(each.src)
                text = f"no program hears what the law of vehicle {each.src} sends: UdpPort of agents.api makes packets"
                self._say(now_ns, "err", text)

    def _repeat(self) -> None:
        """Start the program again, with all that came: this process is a copy by fork, and it belongs to the first."""
        self._owner, self._life, self._disk = os.getpid(), None, None
        for one in self._history:
            for k in range(one.ticks):
                life = self._step(one.begin_ns + k * self._tick_ns, one.packets, one.nav, tell=False)
                life.leaving(sys.maxsize)

    def _remember(self, now_ns: int, packets: list[Delivery], nav: Nav | None) -> None:
        """Keep what has come, for a repetition; ticks in a row without anything are one entry."""
        last = self._history[-1] if self._history else None
        goes_on = last is not None and last.begin_ns + last.ticks * self._tick_ns == now_ns
        if last is None or packets or nav is not None or last.packets or last.nav is not None or not goes_on:
            self._history.append(_Stretch(now_ns, packets, nav))
        else:
            last.ticks += 1

    def _step(self, now_ns: int, packets: list[Delivery], nav: Nav | None, tell: bool) -> _Life:
        if self._life is None:
            self._begin_ns = now_ns
            self._life = _Life(
                self._config, self._words, self._environment, self._files, self._book, now_ns, self._epoch_ns,
                self._disk,
                self._disk_before,
                self.beside,
                self._processors,
                UdpWays(self._udp),
                self._modem,
                watched=bool(self.watches),
            )  # fmt: skip
        life = self._life
        life.place = self._place if nav is None else nav.eta[:3]
        for at_ns, stream, text in life.step(now_ns, packets, nav):
            for each in self.reads if stream in ("out", "err") else ():  # loggers, as those of ROS, write to err
                if (value := each.read(text, self.values[each.name])) is not None:
                    self.values[each.name] = value
            self._awaited = [each for each in self._awaited if not each.pattern.search(text)]
            if tell and not (stream == "end" and self._awaited):  # what was never ready has not ended well
                self._say(at_ns, stream, text)
        if self._awaited and (late := self._late(now_ns, life)):
            self._awaited = []
            life.stop()
            if tell:
                self._say(now_ns, "failed", late)
        if life.messages:
            self._watch(now_ns, life.messages, tell=tell)
            life.messages.clear()
        return life

    def _late(self, now_ns: int, life: _Life) -> str:
        """Which program was not ready in time, or has ended before, in words; empty: none."""
        for each in self._awaited:
            if life.over or now_ns - self._begin_ns > each.within_ns:
                when = "before it ended" if life.over else f"within {each.within_ns / NS:g} s"
                return f"{each.name} was not ready {when}: it printed no line with {each.pattern.pattern!r}"
        return ""

    def _say(self, at_ns: int, stream: str, text: str) -> None:
        """Put a line into the log of the run, and into the agent's own."""
        self._said.append(Said(at_ns, stream, text if len(text) <= 1000 else text[:999] + "…"))
        self._write_line(f"{at_ns / NS:.3f} {text}" if stream == "out" else f"{at_ns / NS:.3f} {stream}: {text}")

    def _watch(self, now_ns: int, messages: Sequence[tuple[str, bytes]], tell: bool) -> None:
        """Read the numbers in what has left."""
        for (key, payload), each in product(messages, self.watches):
            try:
                value = each.read(key, payload, self.values[each.name])
            except NoNumber as error:
                if each.name not in self._unread and tell:  # the next one is wrong at another place
                    self._unread.add(each.name)
                    self._say(now_ns, "err", f"signal {each.name}: {key:.80}: {error}")
                continue
            if value is not None:
                self.values[each.name] = value

    def take_said(self) -> Sequence[Said]:
        """The lines that the program has printed since the last call, and how it ended."""
        said, self._said = self._said, []
        return said


class _Life:
    """A program from its start to its end."""

    def __init__(
        self,
        config: AgentConfig,
        command: Sequence[str],
        environment: Mapping[str, str],
        files: Sequence[Path],
        book: AddressBook,
        now_ns: int,
        epoch: int,
        disk: Path | None,
        disk_before: Path | None,
        beside: Sequence[str],
        processors: int,
        ways: UdpWays,
        modem: ModemBeside | None,
        *,
        watched: bool,
    ) -> None:
        self._id, self._book, self._ways = config.id, book, ways
        self._beside, self._environment = beside, environment
        self.messages: list[tuple[str, bytes]] | None = [] if watched else None  # what left, by key; None: not wanted
        self._node: int | None = None  # the family of the program beside it
        self._modem, self._modem_family = modem, -1
        self.place: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._out: deque[bytes] = deque()
        # Fragments of a former life may still wait for the rest at others: a life that begins later has other numbers.
        self._queued, self._number = 0, Random(f"{config.seed}/{now_ns}").getrandbits(16) if now_ns else 0
        self._fragments = DatagramAssembly()
        self.over = self._begun = False
        self._last_ns = 0
        self._config = config
        self._helper: int | None = None  # the family of the zenoh endpoint; None: nobody has asked for it
        self._wanted = any(_ENDPOINT in word for word in command)  # an endpoint; who names it is given it at once
        self._ready = False  # whether it listens
        self.vehicle = SteeredVehicle(config)
        self.streams = Streams(
            config.id, lambda segment: self._put(segment.packed()), self._to_processes, self._unanswered
        )
        self.shared = SharedSockets(
            lambda number, kind, data: self.processes.send(kind, data, to=number),
            self.streams.close,
            self.streams.change_owner,
        )
        self.processes = Processes(
            command, environment, files, agent=config.id, agents=book.largest, tick_ns=config.tick_ns, now_ns=now_ns,
            seed=Random(f"{config.seed}/{config.id}/{now_ns}").getrandbits(63), told=self._told, epoch_ns=epoch,
            other_addresses=book.has_others, disk=disk, disk_before=disk_before, processors=processors,
            attached=attachment(config.id),
        )  # fmt: skip

    def step(self, now_ns: int, packets: Sequence[Delivery], nav: Nav | None = None) -> list[tuple[int, str, str]]:
        """Let time pass: what has come, and what the program prints until it waits (time [ns], stream, line).

        Args:
            now_ns: the time [ns].
            packets: payloads that have come.
            nav: where the vehicle is, which a program may steer by; None: it is moored.
        """
        if self.over and not self._has_modem:  # what it had written to its streams is still sent
            self.streams.tick(now_ns)
            for delivery in packets:
                self._hear(delivery)
            return []
        processes, streams = self.processes, self.streams
        # A fault has paused it, as SIGSTOP does: its timers are late, and all at once.
        stood = self._begun and now_ns - self._last_ns > self._config.tick_ns
        self._last_ns = now_ns
        if self._begun and not packets and not streams.busy and nav is None and processes.soonest_ns > now_ns:
            return []  # as in most ticks
        said: list[tuple[int, str, str]] = []
        try:
            if stood:
                processes.jump(now_ns)
            if not self._begun:
                self._begun = True
                if self._modem:  # first, so that its port is open when the program begins
                    self._modem_family = processes.next_family  # its first datagram comes before the next line
                    processes.begin_helper(self._modem.command, shares_files=self._modem.has_terminal)
                processes.begin()
                if self._beside:
                    self._node = processes.begin_helper([*self._beside, str(self._id)], self._environment)
            processes.advance(now_ns, before_last=lambda: said.extend(self._lines()))
            streams.processes = processes.count
            streams.tick(now_ns)
            for delivery in packets:
                self._hear(delivery)
            if nav is not None:
                self._tell_own(NAVIGATION_PORT, navigation(nav, now_ns))
            processes.advance(now_ns)
            self._serve_zenoh(now_ns)
            if self._node is not None and processes.running and not processes.family_runs(self._node):
                raise ProgramEnded("the node of its vehicle has ended, see its lines")
            if self._modem and not self._has_modem:
                raise ProgramEnded("its modem has ended, see its lines")
        except ProgramEnded as error:
            said += self._lines()
            return [*said, *self._end(str(error))]
        said += self._lines()
        if self.over:  # its modem works on
            return said
        if not processes.running:
            return [*said, *self._end(processes.problem)]
        if processes.is_dead and not streams.busy:
            processes.show_threads()
            said += self._lines()
            return [*said, *self._end("deadlock: no thread can ever run, and nothing is on its way to one")]
        return said

    @property
    def _has_modem(self) -> bool:
        return self.processes.family_runs(self._modem_family)

    def _unanswered(self, port: int) -> bool:
        """Nobody listens on a port of the own agent: on zenoh's there will be an endpoint."""
        if port != ZENOH_PORT or self._ready:
            return False
        self._wanted = True
        return True

    def _serve_zenoh(self, now_ns: int) -> None:
        """Start the endpoint if a program wants to connect to it, and let the program connect when it listens."""
        if self._wanted and self._helper is None:
            heard = [str(each.id) for each in self._config.neighbours]
            self._helper = self.processes.begin_helper(
                helper_command("fleet.addons.programs.zenoh_endpoint", self._id, *heard)
            )
            self.processes.advance(now_ns)
        if self._helper is not None and not self.processes.family_runs(self._helper):
            raise ProgramEnded("its zenoh endpoint has ended")
        if self._wanted and self._ready:
            self._wanted = False
            self.streams.processes = self.processes.count
            self.streams.call_again()
            self.processes.advance(now_ns)

    def _tell_own(self, port: int, data: bytes) -> None:
        """Send a datagram to the own programs on the loopback."""
        self.processes.send(68, _ADDRESSES.pack(_LOOPBACK, port, _LOOPBACK, port) + data)

    def stop(self) -> None:
        """End it, whatever it does."""
        self.over = True
        self.processes.close()

    def _end(self, problem: str) -> list[tuple[int, str, str]]:
        self.over = True
        now_ns = self.processes.now_ns
        if problem or not self._has_modem:
            self.processes.close()
        return [(now_ns, "failed", problem)] if problem else [(now_ns, "end", "exit status 0")]

    def _lines(self) -> list[tuple[int, str, str]]:
        return [(self.processes.now_ns, stream, line) for stream, line in self.processes.lines()]

    def leaving(self, most: int) -> list[bytes]:
        """The packets that go with this round, at most so many bytes together; the others wait."""
        taken: list[bytes] = []
        while self._out and len(self._out[0]) <= most:
            taken.append(self._out.popleft())
            most -= len(taken[-1])
            self._queued -= len(taken[-1])
        return taken

    def _put(self, payload: bytes) -> None:
        if self._queued + len(payload) > MOST_QUEUED:
            return  # as in a full network card
        self._out.append(payload)
        self._queued += len(payload)

    def _to_processes(self, kind: int, data: bytes, to: int) -> None:
        if to and self.shared.is_held(int.from_bytes(data[:8], "little")):
            to = 0  # after a fork several processes have it
        self.processes.send(kind, data, to=to)

    def _told(self, process: Process, kind: int, data: bytes) -> None:
        if kind == 83:  # S: a datagram
            self._send(process, data)
        elif kind in SOCKET_KINDS:
            self.shared.on_message(process.pid, kind, data)
        elif kind != 76:  # L: one was lost, because its socket was full
            if kind == 0:
                self.shared.on_process_ended(process)
            self.streams.processes = self.processes.count
            self.streams.on_message(process.pid, kind, data, self._book.agent, self.shared.is_held)

    def _send(self, process: Process, data: bytes) -> None:
        _, from_port, to_ip, to_port = _ADDRESSES.unpack_from(data)
        if to_ip == _LOOPBACK and (way := self._ways.way(to_port)) is not None:
            other, port = way
            self.processes.answer(process, b"U\x01")
            self._ways.sends(other, from_port)
            if self.messages is not None:
                self.messages.append((f"udp/{to_port}", data[_ADDRESSES.size :]))
            self._leave(Datagram(other, from_port, port, node_address(other, False), data[_ADDRESSES.size :]))
            return
        agent = self._book.agent(to_ip, to_port)
        here = is_own(to_ip, self._id)
        if here and to_port == MODEM_AGENT_PORT and process.family == self._modem_family:
            self.processes.answer(process, b"U\x01")
            self._put(data[_ADDRESSES.size :])
            return
        if here and (to_port == READY_PORT or (to_port == COMMAND_PORT and not self._config.moored)):
            self.processes.answer(process, b"U\x01")
            if to_port == READY_PORT:
                self._ready = True
            else:
                self.vehicle.command(data[_ADDRESSES.size :])
            return
        if here:
            elsewhere = agent not in (None, self._id)
            self.processes.answer(process, b"U" + bytes((elsewhere or self.processes.count > 1,)))
        if agent in (self._id, EVERYBODY):
            self._datagram(to_port, data, but=process.pid)
        if agent is not None and agent != self._id:
            if self.messages is not None and to_port == WATER_PORT and process.family == self._helper:
                self.messages += puts(data[_ADDRESSES.size :])
            to = to_ip if agent == EVERYBODY else node_address(agent, to_ip[:12] != V4)
            self._leave(Datagram(agent, from_port, to_port, to, data[_ADDRESSES.size :]))

    def _leave(self, datagram: Datagram) -> None:
        self._number = (self._number + 1) & 0xFFFF
        for each in datagram.fragments(self._number):
            self._put(each.packed())

    def _hear(self, delivery: Delivery) -> None:
        if is_for_modem(delivery):
            head = _ADDRESSES.pack(_LOOPBACK, MODEM_AGENT_PORT, _LOOPBACK, MODEM_PORT)
            self.processes.send(68, head + to_modem(delivery, self.place), family=self._modem_family)
            return
        packet = read(delivery.payload)
        if packet is None or packet.agent not in (EVERYBODY, self._id):
            return
        if isinstance(packet, Segment):
            self.streams.hear(delivery.src, packet)
            return
        if (whole := self._fragments.whole(delivery.src, packet)) is None:
            return
        packet = whole
        if self._ways and (found := self._ways.arrives(delivery.src, packet.to_port)) is not None and found[1]:
            to_port, back = found
            self._datagram(to_port, _ADDRESSES.pack(_LOOPBACK, back, _LOOPBACK, to_port) + packet.data)
            return
        v6 = packet.to_ip[:12] != V4
        head = _ADDRESSES.pack(node_address(delivery.src, v6), packet.from_port, packet.to_ip, packet.to_port)
        self._datagram(packet.to_port, head + packet.data)

    def _datagram(self, port: int, data: bytes, but: int = 0) -> None:
        """Hand a datagram to the processes that may listen on a port."""
        if port == WATER_PORT and self._helper is not None:
            self.processes.send(68, data, but=but, family=self._helper)
        else:
            self.processes.send(68, data, but=but, outside=self._helper)


def is_own(ip: bytes, agent: int) -> bool:
    """Whether the library of a program takes an address for its own, and asks whether somebody hears there."""
    if ip[:12] == V4:
        return ip[12] == 127 or ip == node_address(agent, False)
    linked = ip[:2] == b"\xfe\x80" and ip[14:] == agent.to_bytes(2, "big")
    return ip == bytes(15) + b"\x01" or ip == node_address(agent, True) or linked


def epoch_ns(text: str) -> int:
    """A moment [ns since 1970] by its date and time in UTC. Raises ValueError: it is none."""
    at = datetime.fromisoformat(text)
    return round(at.replace(tzinfo=at.tzinfo or UTC).timestamp()) * NS


_PLACE = re.compile(r"\{(id|seed|zenoh)\}")
_ENDPOINT = f"tcp/127.0.0.1:{ZENOH_PORT}"


def _fill_places(word: str, values: Mapping[str, Any]) -> str:
    """A word with its places filled in. Other braces stay: a program may be given JSON."""
    return _PLACE.sub(lambda found: str(values[found[1]]), word)
