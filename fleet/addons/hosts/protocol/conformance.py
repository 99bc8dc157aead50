"""`fleet protocol check`: world, netem and console in one, against an agent of another make.

It writes a join file, waits for the agent, and plays a canned exchange. That has the handshake, ticks and round ticks,
an inbox that comes late and in parts, messages that are malformed or meant for an earlier life, a gap, and the end.
Every message of the agent is judged. The vehicle does not move; what the agent commands is not judged, only when and in
what form.
"""

from __future__ import annotations

import contextlib
import shlex
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any

import msgpack

from agents import payload
from agents.join_file import JoinFile
from fleet.addons.hosts.protocol.emulated_fleet import EmulatedFleet
from fleet.errors import FleetError
from fleet.execution.rendezvous import Rendezvous
from fleet.processes.ports import free_port
from fleet.scenario.scenario import Scenario
from netem.errors import BusError, MalformedMessage, OutOfPlace
from netem.private_folder import PrivateFolder
from netem.wire.codec import encode
from netem.wire.credentials import agent_role, generate
from netem.wire.keys import Keys
from netem.wire.messages import (
    PROTOCOL_VERSION,
    RUN_OVER,
    Command,
    Delivery,
    End,
    Hello,
    Inbox,
    Message,
    Nav,
    Transmission,
)


def damaged_deliveries(src: int, sent: int, eta: tuple[float, ...]) -> tuple[Delivery, ...]:
    """A neighbour's payloads of a tick, and the same payloads after a damaging network. `eta`: the pose of who receives
    it [m, rad]; the neighbour is 5 m to its north.
    """
    good = payload.encode(payload.StateMessage(src, sent, (eta[0] + 5.0, eta[1], eta[2]), (0.5, 0.0, 0.0)))
    flipped = bytes([good[0], good[1] ^ 0x40, *good[2:]])
    payloads = [good, flipped, good[:15], b"", bytes(range(63)), b"\xff" * 200]
    return tuple(Delivery(sent + 1, sent, src, seq, 0, data) for seq, data in enumerate(payloads))


def junk_of(life: int) -> tuple[bytes, ...]:
    """Bytes that are no message: no MessagePack, no array, no kind, too short, of wrong types, of an unknown kind."""
    return (
        b"",
        b"\xc1",
        b"\xff" * 40,
        msgpack.packb({"nav": 1}),
        msgpack.packb([]),
        msgpack.packb(["nav", life]),
        msgpack.packb(["nav", life, "now", [0.0] * 5, [0.0] * 5]),
        msgpack.packb(["rx", life, None, False, []]),
        msgpack.packb(["weather", life, 1, [], []]),
    )


ASKS = "asks cfg for its slice"
HELLO = "says hello on cmd and tx: role agent, its number, the incarnation of cfg, the protocol version"
READY = "says hello with echo set on cmd, once both were echoed"
TOKEN = "declares its liveliness token"
COMMANDS = "answers each nav with one cmd: its incarnation and tick, three finite numbers, all telemetry or none"
TRANSMITS = "puts one tx at each round tick, before the cmd, and none at other ticks"
LATE = "waits with its answer until the inbox is known up to the tick"
PARTS = "takes an inbox in parts for known only when the last is there"
DAMAGED = "survives payloads that the network has damaged"
MALFORMED = "drops malformed messages and goes on"
EARLIER = "ignores nav, rx and end of an earlier life"
GAP = "goes on after ticks in which it was not asked"
ROLLS = "answers a nav with roll, its sixth field"
SHOWS = "answers a nav with what its clock shows, its seventh field"
BELIEVES = "answers a nav with belief, its eighth field"
UNASKED = "puts nothing that it was not asked for"
FORM = "puts well-formed messages of its own kinds only"
ENDS = "closes its session when it is told the end"
CHECKS = (
    *(ASKS, HELLO, READY, TOKEN, COMMANDS, TRANSMITS, LATE, PARTS, DAMAGED),
    *(MALFORMED, EARLIER, GAP, ROLLS, SHOWS, BELIEVES, UNASKED, FORM, ENDS),
)


@dataclass(frozen=True, slots=True)
class ProtocolCheck:
    """One verdict; None if the exchange did not get that far."""

    what: str
    passed: bool | None
    expected: str = ""
    got: str = ""

    def __str__(self) -> str:
        if self.passed:
            return f"pass  {self.what}"
        if self.passed is None:
            return f"----  {self.what}: not reached"
        return f"FAIL  {self.what}: expected {self.expected}; got {self.got}"


ANSWER_S = 5.0  # until an answer counts as missing
SILENCE_S = 0.3  # how long nothing must come where nothing may, at least
_SLOWER = 5.0  # and so many times as long as the slowest answer took: on a busy machine a wrong answer is late, too
LIFE, BEGIN_ROUNDS = 1, 3  # the life that is asked for, and the round in which it begins: not what one might assume


class _BrokenOffError(Exception):
    """The agent cannot be asked any further."""


class Examination:
    """One exchange with one agent."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: int,
        file: Path,
        *,
        port: int | None = None,
        meeting: Rendezvous | None = None,
    ) -> None:
        """Prepare the exchange; `run` carries it out. The agent is given the slice of a vehicle of the scenario, and a
        join file. `port`: of the router on the loopback interface; None: any free one. `meeting`: where the agent may
        join with a certificate alone; its folder goes beside `file`. Raises FleetError if there is no such vehicle, the
        network is ideal, or the file or the folder exists.
        """
        if not 1 <= vehicle <= scenario.vehicles:
            raise FleetError(
                f"there is no vehicle {vehicle} in {scenario.name}: the vehicles are 1 to {scenario.vehicles}"
            )
        if scenario.ideal:
            raise FleetError("an agent cannot join an ideal network: choose a scenario with links")
        self._meeting = meeting or Rendezvous()
        for path in (file, *([file.with_suffix("")] if vehicle in self._meeting.folders else [])):
            if path.exists():
                raise FleetError(f"{path} is there already: choose another place with --join-file FILE")
        self._m = scenario.round_ticks
        self._config = scenario.agent_config(vehicle)
        self._telemetry = scenario.layout(vehicle).size
        self._state = scenario.initial[vehicle - 1]
        self._more: tuple[Any, ...] = ()  # the further fields of a nav: roll, clock_ns, belief
        self._neighbours = [neighbour.id for neighbour in self._config.neighbours]
        self._i, self._file, self._port = vehicle, file, port
        self._keys = Keys(token_hex(4))
        self._reached: set[str] = set()
        self._failed: dict[str, tuple[str, str]] = {}
        self._known = 0  # the tick up to which the agent has its inbox
        self.notes: list[str] = []  # texts of the agent's Note messages
        self.slowest_s = 0.0  # longest wait for an answer

    def run(self, timeout_s: float, show: Callable[[str], None]) -> list[ProtocolCheck]:
        """Wait `timeout_s` for the agent to be started, examine it, and return a verdict for each of `CHECKS`. `show`
        is called with a line that names the join file. Raises FleetError if no agent came, or the endpoint or the file
        cannot be made.
        """
        i, begin = self._i, BEGIN_ROUNDS * self._m
        user = generate((i,))[agent_role(i)]
        endpoint = f"tcp/127.0.0.1:{free_port(self._port)}"
        joining = JoinFile(
            endpoint, self._keys.run, i, user.user, user.password, PROTOCOL_VERSION, "check", LIFE, begin
        )
        answer = {"agent": self._config.to_values(), "incarnation": LIFE, "begin": begin, "version": PROTOCOL_VERSION}
        with PrivateFolder() as private:
            try:
                self._fleet = EmulatedFleet(endpoint, self._keys, i, user, private, answer, self._meeting.certified)
            except BusError as error:
                raise FleetError(str(error)) from None
        folder = self._file.with_suffix("")
        try:
            joining.write(self._file)
            file, alone = shlex.quote(str(self._file)), ""
            if i in self._meeting.folders:
                self._meeting.folders[i].write(folder, self._keys, LIFE, begin)
                alone = f"; with its certificate alone: {shlex.quote(str(folder))}"
            show(f"waiting for agent {i}: start it with {file}; ours would be: fleet agent --join {file}{alone}")
            with contextlib.suppress(_BrokenOffError):
                self._examine(timeout_s, begin)
            self.notes = self._fleet.notes
            return self._verdicts()
        except OSError as error:
            raise FleetError(f"cannot write {error.filename or self._file}: {error.strerror}") from None
        finally:
            self._file.unlink(missing_ok=True)
            if i in self._meeting.folders:
                shutil.rmtree(folder, ignore_errors=True)
            self._fleet.close()

    def _take(self, deadline: float) -> tuple[str, Message | None] | None:
        """As `EmulatedFleet.take`, up to a deadline, because an agent may put messages without end that are no answer;
        a malformed message is judged, and ends the exchange.
        """
        while True:
            try:
                return self._fleet.take(deadline - time.monotonic())
            except MalformedMessage as error:
                self._fail(FORM, "hello and cmd on cmd, hello and tx on tx", error)
                raise _BrokenOffError from None
            except OutOfPlace as error:
                self._fail(HELLO, str(error.expected), error.got)

    def _fail(self, check: str, expected: str, got: object) -> None:
        self._failed.setdefault(check, (expected, str(got)))

    def _verdicts(self) -> list[ProtocolCheck]:
        return [
            ProtocolCheck(check, False, *self._failed[check])
            if check in self._failed
            else ProtocolCheck(check, True if check in self._reached else None)
            for check in CHECKS
        ]

    def _examine(self, timeout_s: float, begin: int) -> None:
        m = self._m
        self._handshake(timeout_s)
        self._known = begin
        self._ask(begin)
        self._reached |= {COMMANDS, TRANSMITS, UNASKED, FORM}
        eta, _ = self._state
        self._send_nav(begin + 1)
        self._silence(LATE, begin + 1, f"no answer to nav {begin + 1} before an rx that covers it")
        self._send_inbox(
            damaged_deliveries(self._neighbours[0] if self._neighbours else self._i + 1, begin, eta), more=True
        )
        self._silence(PARTS, begin + 1, "no answer while more of the inbox is to come")
        self._send_inbox()
        self._answer(begin + 1, DAMAGED)
        tick = begin + 2 * m + 1
        for k in range(begin + 2, tick):
            self._ask(k)
        for junk in junk_of(LIFE):
            self._fleet.nav(junk)
            self._fleet.rx(junk)
        self._ask(tick, MALFORMED)
        self._fleet.nav(encode(Nav(LIFE - 1, tick + 1, *self._state)))
        self._fleet.rx(encode(Inbox(LIFE - 1, self._known + m, False, ())))
        self._fleet.nav(encode(End(LIFE - 1, tick + 1, "this life is over long ago")))
        self._silence(EARLIER, tick + 1, f"no answer to what is meant for incarnation {LIFE - 1}")
        self._ask(tick + 1, EARLIER)
        tick += 2 * m + 2
        self._ask(tick, GAP)
        belief = (0.25, 0.0, 0.0, 0.01, 0.25, 0.0, 0.0, 0.01, 0.0, 0.001)
        for check, field in ((ROLLS, (0.05, 0.01)), (SHOWS, 20_000_001), (BELIEVES, belief)):
            self._more = *self._more, field
            tick += 1
            self._ask(tick, check)
        for k in range(tick + 1, tick + 3 * m - 2):
            self._ask(k)
        self._end(tick + 3 * m - 2)

    def _handshake(self, timeout_s: float) -> None:
        asked = ready = False
        probed: set[str] = set()
        steps, deadline = 0, time.monotonic() + timeout_s
        while not (asked and ready and len(probed) == 2 and self._fleet.here):
            if (done := asked + ready + len(probed) + self._fleet.here) > steps:
                steps, deadline = done, time.monotonic() + 2 * ANSWER_S
            taken = self._take(deadline)
            if taken is None and not steps:
                raise FleetError(f"no agent came within {timeout_s:g} s: no query of cfg, no hello, no token")
            if taken is None:
                break
            key, message = taken
            if isinstance(message, Hello):
                got = (message.role, message.id, message.incarnation, message.version)
                if got != (expected := ("agent", self._i, LIFE, PROTOCOL_VERSION)):
                    self._fail(HELLO, f"role, id, incarnation, version {expected} on {key}", got)
                if not message.echo:
                    probed.add(key)
                else:
                    ready = True
                    if key != "cmd" or len(probed) < 2:
                        self._fail(
                            READY, "hello with echo set on cmd after one without it on cmd and tx", f"it on {key}"
                        )
            elif message is not None:
                self._fail(UNASKED, "nothing but hello before the first nav", _show(message))
            asked = asked or key == "cfg"
        for check, done, expected_, got_ in (
            (ASKS, asked, f"a query on {self._keys.cfg(self._i)}", "none"),
            (HELLO, len(probed) == 2, "hello on cmd and on tx", f"it on {' and '.join(sorted(probed)) or 'neither'}"),
            (READY, ready, "hello with echo set on cmd", "none"),
            (TOKEN, self._fleet.here, f"the token {self._keys.alive(agent_role(self._i))}", "none"),
        ):
            self._reached.add(check)
            if not done:
                self._fail(check, expected_, f"{got_} within {2 * ANSWER_S:g} s")
        if not (asked and ready and len(probed) == 2 and self._fleet.here):
            raise _BrokenOffError

    def _ask(self, tick: int, blame: str = COMMANDS) -> None:
        while self._known < tick:
            self._send_inbox()
        self._send_nav(tick)
        self._answer(tick, blame)

    def _answer(self, tick: int, blame: str) -> None:
        """Judge what answers the nav of a tick; `blame` is the check that fails when nothing does."""
        began = time.monotonic()
        transmitted = False
        while True:
            taken = self._take(began + ANSWER_S)
            if taken is None or (taken[0] == "token" and not self._fleet.here):
                why = f"none within {ANSWER_S:g} s" if taken is None else "its token is gone"
                self._fail(blame, f"cmd of tick {tick}", why)
                raise _BrokenOffError
            match taken[1]:
                case Transmission() as transmission:
                    if tick % self._m:
                        self._fail(TRANSMITS, f"no tx at tick {tick}: rounds are {self._m} ticks", _show(transmission))
                    elif transmitted or (transmission.incarnation, transmission.tick) != (LIFE, tick):
                        self._fail(TRANSMITS, f"one tx of incarnation {LIFE}, tick {tick}", _show(transmission))
                    transmitted = True
                case Command() as command:
                    if command.incarnation == LIFE and command.tick < tick:
                        self._fail(UNASKED, f"one cmd per nav; tick {tick} is due", _show(command))
                        continue
                    if (command.incarnation, command.tick) != (LIFE, tick):
                        self._fail(COMMANDS, f"cmd of incarnation {LIFE}, tick {tick}", _show(command))
                        raise _BrokenOffError
                    if len(command.telemetry) not in (0, self._telemetry):
                        size = f"0 or {self._telemetry} values of telemetry"
                        self._fail(COMMANDS, size, len(command.telemetry))
                    if tick % self._m == 0 and not transmitted:
                        self._fail(TRANSMITS, f"tx of round tick {tick} before its cmd", "the cmd")
                    self.slowest_s = max(self.slowest_s, time.monotonic() - began)
                    self._reached.add(blame)
                    return

    def _silence(self, check: str, tick: int, expected: str) -> None:
        self._reached.add(check)
        deadline = time.monotonic() + max(SILENCE_S, min(_SLOWER * self.slowest_s, ANSWER_S))
        while (taken := self._take(deadline)) is not None:
            message = taken[1]
            if isinstance(message, Command) and message.incarnation == LIFE and message.tick < tick:
                self._fail(UNASKED, "one cmd per nav", f"another {_show(message)}")
            elif message is not None and not isinstance(message, Hello):
                self._fail(check, expected, _show(message))
                raise _BrokenOffError
            if taken[0] == "token" and not self._fleet.here:
                self._fail(check, "that it stays", "its token is gone")
                raise _BrokenOffError

    def _end(self, tick: int) -> None:
        self._reached.add(ENDS)
        self._fleet.nav(encode(End(LIFE, tick, RUN_OVER)))
        deadline = time.monotonic() + ANSWER_S
        while self._fleet.here:
            taken = self._take(deadline)
            if taken is None:
                self._fail(ENDS, "that its token goes", f"it is there {ANSWER_S:g} s later")
                return
            if taken[1] is not None and not isinstance(taken[1], Hello):
                self._fail(UNASKED, "nothing after the end", _show(taken[1]))

    def _send_nav(self, tick: int) -> None:
        self._fleet.nav(encode(Nav(LIFE, tick, *self._state, *self._more)))

    def _send_inbox(self, deliveries: tuple[Delivery, ...] = (), *, more: bool = False) -> None:
        self._fleet.rx(encode(Inbox(LIFE, self._known + self._m, more, deliveries)))
        if not more:
            self._known += self._m


def _show(message: Message) -> str:
    match message:
        case Command() | Transmission():
            kind = "cmd" if isinstance(message, Command) else "tx"
            return f"{kind} of incarnation {message.incarnation}, tick {message.tick}"
    return type(message).__name__.lower()
