"""One real computer among simulated vehicles: the agent whose messages are those of programs outside of the run.

A run in lockstep at `--speed 1` goes on at the pace of the wall clock. The gateway answers each tick at once. What real
programs have sent since the round before leaves with the next one, and what the network delivers is given to them. So a
slow program costs nobody a tick. The log has what they sent, and `fleet verify` takes it from there.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic_ns
from typing import TYPE_CHECKING, NamedTuple

from agents.config import AgentConfig
from agents.packets import EVERYBODY
from agents.plugged_agent import MAX_PAYLOAD_BYTES
from agents.sample import Decision
from agents.udp_port import MOST_DATA, UdpPort
from fleet.addons.programs.known_ports import WATER_PORT
from fleet.errors import FleetError
from fleet.processes.child_start import die_with_parent, program_environment
from netem.clock import Clock
from netem.modem_frame import MARK
from netem.wire.messages import Delivery, Nav

if TYPE_CHECKING:
    from fleet.addons.modems.agent_modem import AgentModem
    from fleet.addons.modems.modem import ModemCore
    from fleet.addons.programs.zenoh_endpoint import ZenohEndpoint
    from fleet.scenario.schema.nodes import ModemPortSection

MOST_WAITING = (
    1 << 20
)  # bytes of real programs that wait for a round; what comes then is lost, as in a full network card
STOP_S = 5.0  # until a program that was asked to end is killed
_MODEM = 0  # in place of a port
_TOKENS_NS = 500_000_000  # how often tokens of zenoh are told


class Counts(NamedTuple):
    """Messages of the real programs.

    Attributes:
        out: datagrams that they sent, and that went into the network.
        into: datagrams that were given to them.
        lost: those that found no room on the way out.
        late: those that waited longer than a round on the way out. The run was behind, or much had to leave.
    """

    out: int
    into: int
    lost: int
    late: int


class UdpRule(NamedTuple):
    """What the network delivers for a port of the agent goes to a program, and its answers to everybody who hears.

    Attributes:
        port: of the agent in the simulated network, and of our socket.
        host: where the real program is.
        to: its port there.
    """

    port: int
    host: str
    to: int

    @classmethod
    def of(cls, text: str) -> UdpRule:
        """Read `9000=192.168.0.7:9100`. Raises FleetError: it is none."""
        port, _, where = text.partition("=")
        host, _, to = where.rpartition(":")
        if not (port.isdecimal() and to.isdecimal() and host and 0 < int(port) < 65_536 and 0 < int(to) < 65_536):
            raise FleetError(f"expected PORT=HOST:PORT such as 9000=192.168.0.7:9100, got {text!r:.80}")
        return cls(int(port), host, int(to))


def modem_section(text: str) -> ModemPortSection:
    """A modem by what a user typed, such as `unet=1101`. Raises FleetError: it is none."""
    from pydantic import ValidationError

    from fleet.scenario.schema.nodes import LANGUAGES, ModemPortSection

    language, _, where = text.partition("=")
    if language not in LANGUAGES or not where:
        raise FleetError(f"--modem: expected {', '.join(LANGUAGES)} with a port, such as unet=1101; got {text!r:.80}")
    try:
        return ModemPortSection.model_validate({language: int(where) if where.isdecimal() else where})
    except ValidationError as error:
        raise FleetError(f"--modem {language}: {error.errors()[0]['msg']}") from None


class _Sent(NamedTuple):
    """What a real program has said."""

    port: int  # of the agent, from and to which it goes; `_MODEM`: it is a payload of the modem, as it is
    data: bytes
    agent: int  # EVERYBODY: all that hear
    came_ns: int  # CLOCK_MONOTONIC


class Gateway:
    """The core of an external agent; see `agents.loop.AgentCore`."""

    def __init__(
        self,
        udp: Sequence[UdpRule],
        zenoh: str,
        carry: Sequence[str],
        tell: Callable[[str], None],
        modem: ModemPortSection | None = None,
        run: Sequence[str] = (),
    ) -> None:
        """Prepare it.

        Args:
            udp: ports by which real programs take part.
            zenoh: the address of a router for real programs, as zenoh writes it; empty: none.
            carry: key expressions of what leaves through it.
            tell: called with a line for the user.
            modem: an acoustic modem that real programs open; None: there is none.
            run: the command line of a program that lasts as long as the gateway; (): it is started by others.
        """
        self._rules, self._zenoh, self._carry, self._tell = tuple(udp), zenoh, tuple(carry), tell
        self._modem_section, self._run = modem, [*run]
        self._program: subprocess.Popen[bytes] | None = None
        self._core: ModemCore | None = None
        self._modem: AgentModem | None = None
        self._sent: SimpleQueue[_Sent] = SimpleQueue()
        self._waiting: deque[tuple[bytes, int]] = deque()  # payloads; when the first of a message came, else 0
        self._size, self._out, self._into, self._lost, self._late = 0, 0, 0, 0, 0
        self._notes: list[tuple[int, str]] = []
        self._sockets: dict[int, socket.socket] = {}
        self._endpoint: ZenohEndpoint | None = None
        self._told_ns = 0
        self._begun: tuple[int, int] | None = None  # the first tick, and when it came
        self._passed = (0, 1)  # since then, in the run and on the wall clock [ns]

    @property
    def pace(self) -> float:
        """How much faster than the wall clock the run went."""
        return self._passed[0] / max(1, self._passed[1])

    @property
    def counts(self) -> Counts:
        """What has passed so far."""
        return Counts(self._out, self._into, self._lost, self._late)

    def begin(self, config: AgentConfig, clock: Clock) -> Gateway:
        """Open sockets and router. Raises FleetError: a port is in use, or there is no such host."""
        self._tick_ns, self._round_ns = config.tick_ns, config.round_ticks * config.tick_ns
        self._config = config
        self._ports: Mapping[int, UdpPort] = {
            port: UdpPort(config, port) for port in (*(rule.port for rule in self._rules), WATER_PORT)
        }
        self._targets: dict[int, tuple[str, int]] = {}
        for rule in self._rules:
            made = self._sockets[rule.port] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                address = socket.gethostbyname(rule.host)
                here = "127.0.0.1" if address.startswith("127.") else "0.0.0.0"
                made.bind((here, rule.port))
            except OSError as error:
                self.close()
                raise FleetError(f"--udp {rule.port}={rule.host}:{rule.to}: {error.strerror}") from None
            self._targets[rule.port] = address, rule.to
            Thread(target=self._receive, args=(rule.port, made), daemon=True).start()
            self._tell(f"UDP to {here}:{rule.port} goes to everybody who hears agent {config.id}; "
                       f"what comes for its port {rule.port} goes to {rule.host}:{rule.to}")  # fmt: skip
            if here != "127.0.0.1":
                self._tell(f"warning: other machines reach port {rule.port}, which asks for no password")
        if self._zenoh:
            self._endpoint = self._opened(config)
            self._tell(f"real programs of zenoh connect to {self._zenoh}")
        if self._modem_section is not None:
            self._open_modem(self._modem_section)
        if self._run:
            self._start()
        return self

    def _start(self) -> None:
        # As its own group, so that what it starts ends with it; and with us, if somebody kills us.
        dies = partial(die_with_parent, os.getpid())
        try:
            self._program = subprocess.Popen(
                self._run, stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=dies,
                env=program_environment(os.environ),
            )  # fmt: skip
        except OSError as error:
            self.close()
            raise FleetError(f"--run {self._run[0]}: {error.strerror}") from None

    def _open_modem(self, section: ModemPortSection) -> None:
        from fleet.addons.modems.languages import modem_core
        from netem.errors import BusError

        core = modem_core(self._config.id, section)
        try:
            where = core.listen()
        except BusError as error:
            self.close()
            raise FleetError(f"--modem {section.language}: {error}") from None
        self._core = core
        self._tell(f"real programs open the modem ({section.language}) at {where}")

    def _switched_on(self, core: ModemCore, nav: Nav) -> AgentModem:
        from fleet.addons.modems.agent_modem import AgentModem

        begin_ns = monotonic_ns() - nav.tick * self._tick_ns  # at --speed 1
        known = {f"auv{i}": i for i in (self._config.id, *(each.id for each in self._config.neighbours))}
        name = f"auv{self._config.id}"
        return AgentModem(
            core, name, known, begin_ns, lambda data: self._sent.put(_Sent(_MODEM, data, 0, monotonic_ns()))
        )

    def _opened(self, config: AgentConfig) -> ZenohEndpoint:
        from fleet.addons.programs.zenoh_endpoint import ZenohEndpoint
        from netem.errors import BusError

        def send(data: bytes, to: int | None) -> None:
            self._sent.put(_Sent(WATER_PORT, data, to or EVERYBODY, monotonic_ns()))

        heard = [each.id for each in config.neighbours]
        try:
            return ZenohEndpoint(config.id, heard, send, listen=self._zenoh, carry=self._carry)
        except BusError as error:
            raise FleetError(f"--zenoh {self._zenoh}: {error}") from None

    def _receive(self, port: int, listening: socket.socket) -> None:
        with suppress(OSError):  # closed at the end
            while True:
                data, _ = listening.recvfrom(1 << 16)
                if len(data) <= MOST_DATA:
                    self._sent.put(_Sent(port, data, EVERYBODY, monotonic_ns()))

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """What real programs have sent since the round before, as much as fits into a round; the rest waits."""
        with suppress(Empty):
            while True:
                said = self._sent.get_nowait()
                payloads = [said.data] if said.port == _MODEM else self._ports[said.port].send(said.data, said.agent)
                size = sum(map(len, payloads))
                if self._size + size > MOST_WAITING:
                    self._lost += 1
                    continue
                self._size += size
                self._out += 1
                self._waiting += [(each, said.came_ns if number == 0 else 0) for number, each in enumerate(payloads)]
        taken: list[bytes] = []
        room, now_ns = MAX_PAYLOAD_BYTES, monotonic_ns()
        while self._waiting and len(self._waiting[0][0]) <= room:
            payload, came_ns = self._waiting.popleft()
            taken.append(payload)
            room -= len(payload)
            self._size -= len(payload)
            if came_ns and now_ns - came_ns > self._round_ns + self._tick_ns:
                self._count_late(nav.tick, now_ns - came_ns)
        return tuple(taken)

    def _count_late(self, tick: int, waited_ns: int) -> None:
        self._late += 1
        if self._late == 1:
            text = f"a message of its real program waited {waited_ns / 1e6:.0f} ms, longer than a round"
            self._notes.append((tick, f"{text}; fleet agent counts all of them"))

    def decide(self, nav: Nav, deliveries: list[Delivery]) -> Decision:
        """Give real programs what has come. The vehicle itself stays, or is moored."""
        if self._core is not None:
            if self._modem is None:
                self._modem = self._switched_on(self._core, nav)
            for each in deliveries:
                if each.payload.startswith(MARK):
                    self._modem.hear(each.src, each.seq, each.copy, each.payload, nav.eta[:3])
        for port, ours in self._ports.items():
            for datagram in ours.receive(deliveries):
                self._into += 1
                if port == WATER_PORT:
                    if self._endpoint is not None:
                        self._endpoint.hear(datagram.src, datagram.data)
                else:
                    with suppress(OSError):  # the program is not there yet, or its host is gone: UDP tells nobody
                        self._sockets[port].sendto(datagram.data, self._targets[port])
        now_ns = monotonic_ns()
        if self._begun is None:
            self._begun = nav.tick, now_ns
        self._passed = (nav.tick - self._begun[0]) * self._tick_ns, now_ns - self._begun[1]
        if self._endpoint is not None and now_ns - self._told_ns >= _TOKENS_NS:
            self._told_ns = now_ns
            self._endpoint.tick(now_ns)
        return Decision((0.0, 0.0, 0.0), ())

    def take_notes(self) -> list[tuple[int, str]]:
        """That the first message was late, once."""
        notes, self._notes = self._notes, []
        return notes

    def close(self) -> None:
        """Close sockets and router."""
        for each in self._sockets.values():
            each.close()
        if self._endpoint is not None:
            self._endpoint.close()
        if self._core is not None:
            self._core.close()
        if self._program is not None:
            for number in (signal.SIGTERM, signal.SIGKILL):
                with suppress(ProcessLookupError):
                    os.killpg(self._program.pid, number)
                with suppress(subprocess.TimeoutExpired):
                    self._program.wait(STOP_S)
