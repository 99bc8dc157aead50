"""A program as an agent: its turns are ticks, and what it sends are payloads of the rounds."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any, ClassVar

from agents.api import (
    AgentConfig,
    Delivery,
    FormationAgent,
    Nav,
    PayloadError,
    Signal,
    Telemetry,
    Vec3,
    pack,
    unpack,
)
from fleet.addons.programs import standard
from fleet.addons.programs.datagrams import EVERYBODY, AddressBook, Datagrams, select_module, socket_module
from fleet.addons.programs.event_loop import asyncio_module, loop_aside
from fleet.addons.programs.executables import obstacle
from fleet.addons.programs.import_space import ImportSpace
from fleet.addons.programs.library import NoLibraryError, compiled
from fleet.addons.programs.line_signal import NOTHING_YET, LineSignal
from fleet.addons.programs.process_agent import ProcessAgent, epoch_ns, own_python
from fleet.addons.programs.ros_packages import interface
from fleet.addons.programs.threads import thread_module, threading_module
from fleet.addons.programs.turns import NS, Turns
from fleet.addons.programs.velocity import velocity_demand
from fleet.addons.programs.zenoh_session import TOKEN, Zenoh, zenoh_module
from fleet.errors import FleetError
from fleet.quantities import time_ns
from world.errors import PluginError
from world.plugins.fence import OverBudgetError, alarm
from world.plugins.output import line_writer

ZENOH, DATAGRAM, ROS = "zenoh", "udp", "ros"  # kinds of payloads
BUDGET_S = 10.0  # of computing in one turn, unless the scenario has a budget of its own
TOKENS_NS = 500_000_000  # how often tokens are told again
_PARAMETERS = ("arguments", "signals", "addresses", "order", "cost", "shared")  # of a program on stand-ins
_OF_PROCESSES = ("process", "interpreter", "arguments", "signals", "addresses", "env", "files", "epoch")


class ProgramFailed(FleetError):
    """A program raised something, or ended with a status."""


def program_class(path: Path, parameters: Mapping[str, Any]) -> type[ProgramAgent] | type[ProcessAgent]:
    """The agent that a program makes with some parameters. Nothing of it runs yet.

    Args:
        path: the program: a file of Python, or anything that can be executed.
        parameters: those of the guide. With `process: yes`, and of what is no file of Python, it is a real process in
            simulated time; else Python on stand-ins.

    Raises:
        PluginError: there is no such parameter, or one has no meaning.
    """
    real = path.suffix != ".py" or bool(parameters.keys() & {"process", "interpreter"})
    known = _OF_PROCESSES if real else _PARAMETERS
    if unknown := sorted(parameters.keys() - {*known}):
        raise _wrong(path, f"there is no key {unknown[0]!r}", f"known: {', '.join(known)}")
    lines = tuple(_line_signal(path, name, about) for name, about in dict(parameters.get("signals") or {}).items())
    if real:
        return _process_class(path, parameters, lines)
    if parameters.get("order", "ready") not in ("ready", "seeded"):
        raise _wrong(path, f"order: expected ready or seeded, got {parameters['order']!r}")

    class Program(ProgramAgent):
        plugin_file = path
        reads = lines
        signals = tuple(Signal(each.name, "1", "as the program printed it last; -1 before") for each in lines)

    return Program


def _process_class(path: Path, parameters: Mapping[str, Any], lines: tuple[LineSignal, ...]) -> type[ProcessAgent]:
    interpreter = parameters.get("interpreter") or (own_python() if path.suffix == ".py" else "")
    found = shutil.which(interpreter) if interpreter else None
    if interpreter and found is None:
        raise _wrong(path, f"interpreter: there is no command {interpreter!r}", "give its path, or install it")
    if problem := obstacle(found or path):
        raise _wrong(path, problem)
    if not interpreter and not os.access(path, os.X_OK):
        raise _wrong(
            path, "it cannot be executed", "chmod +x, or say by which interpreter, such as `interpreter: node`"
        )
    try:
        epoch_ns(str(parameters.get("epoch") or "2026-01-01"))
    except ValueError as error:
        raise _wrong(path, f"epoch: {error}", "write a date and a time, such as 2026-06-01T12:00:00") from None
    try:
        compiled()
    except NoLibraryError as error:
        raise _wrong(path, str(error)) from None

    class Program(ProcessAgent):
        plugin_file = path
        command = (found, str(path)) if found else (str(path),)
        reads = lines
        signals = tuple(Signal(each.name, "1", "as the program printed it last; -1 before") for each in lines)

    return Program


def _wrong(path: Path, problem: str, hint: str = "") -> PluginError:
    return PluginError("agent", f"program:{path.name}", problem, hint)


def _line_signal(path: Path, name: str, about: Any) -> LineSignal:
    text = about.get("line") if isinstance(about, Mapping) else about
    try:
        pattern = re.compile(str(text))
    except re.error as error:
        raise _wrong(path, f"signals.{name}.line is no regular expression: {error}") from None
    if "value" not in pattern.groupindex:
        raise _wrong(path, f"signals.{name}.line names no group", "write (?P<value>...) round the number")
    return LineSignal(name, pattern)


class ProgramAgent:
    """One life of a program. When the agent is dropped, the program has ended: nothing of it has an effect any more."""

    plugin_file: ClassVar[Path]
    reads: ClassVar[tuple[LineSignal, ...]]
    signals: ClassVar[tuple[Signal, ...]]

    def __init__(
        self,
        config: AgentConfig,
        arguments: Sequence[Any] = (),
        signals: Any = None,
        addresses: Mapping[str, int] | None = None,
        order: str = "ready",
        cost: str | float = 0.0,
        shared: Sequence[str] = (),
    ) -> None:
        """Prepare the program; its first turn is the agent's first tick.

        Args:
            config: the agent's slice.
            arguments: of the command line; `{id}` and `{seed}` stand for the agent's number and the run's seed.
            signals: read by `program_class`.
            addresses: agents by `HOST:PORT` or `HOST`.
            order: of callbacks of asyncio that are ready at the same time: `ready` or `seeded`.
            cost: time that a turn takes, such as `2 ms`.
            shared: packages that all programs of this process share.
        """
        self._tick_ns = config.tick_ns
        self._cost_ns, self._busy_until_ns = time_ns(cost) if isinstance(cost, str) else round(cost * NS), 0
        self._life = ProgramLife(self.plugin_file, self.reads, config, arguments, addresses or {}, order, shared)
        self._formation, self._moored = FormationAgent(config), config.moored  # it steers until the program commands
        self._limited = not config.budget_s

    def __del__(self) -> None:
        life = getattr(self, "_life", None)
        if life is None or life.turns.over or sys.is_finalizing():
            return
        with loop_aside():  # it may be the turn of another program
            life.turns.end()

    def transmit(self, nav: Nav) -> Sequence[bytes]:
        """What the program has sent since the last round, and what the agent that steers sends."""
        return [*self._formation.transmit(nav), *self._life.sent()]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Hand over what has come, and let the program run until it waits."""
        now_ns, deliveries = nav.tick * self._tick_ns, list(deliveries)
        tau, _ = self._formation.decide(nav, deliveries)
        self._life.take(now_ns, deliveries)
        if not self._moored:
            self._life.navigate(nav)
        if now_ns >= self._busy_until_ns:
            with loop_aside():
                self._advance(now_ns)
            self._busy_until_ns = now_ns + self._cost_ns
        return self._life.demand(nav) or tau, self._life.values

    def _advance(self, now_ns: int) -> None:
        if not self._limited or threading.current_thread() is not threading.main_thread():
            self._life.turns.advance(now_ns)
            return
        try:
            with alarm(BUDGET_S, 0.0, lambda: True):
                self._life.turns.advance(now_ns)
        except OverBudgetError as error:
            problem = (
                f"it computed for {BUDGET_S:g} s and did not wait: a program waits with time.sleep, a queue or await"
            )
            raise ProgramFailed(problem).with_traceback(error.__traceback__) from None


class ProgramLife:
    """The inside of a program: its threads, its modules, and its ways to others."""

    def __init__(
        self,
        file: Path,
        reads: Sequence[LineSignal],
        config: AgentConfig,
        arguments: Sequence[Any],
        addresses: Mapping[str, int],
        order: str,
        shared: Sequence[str],
    ) -> None:
        """Prepare it; the arguments are those of `ProgramAgent`."""
        self._file, self._reads, self._config, self._order, self._shared = file, reads, config, order, shared
        self._arguments = [str(each).format(id=config.id, seed=config.seed) for each in arguments]
        self.values = {each.name: NOTHING_YET for each in reads}
        self.turns = Turns()
        self._out: list[bytes] = []
        self._datagrams = Datagrams(self.turns, AddressBook(config.id, addresses), self._send_datagram)
        hears = frozenset(each.id for each in config.neighbours)
        self._zenoh = Zenoh(self.turns, config.id, hears, partial(self._send, ZENOH))
        self._ros: Any = None  # made when the program imports rclpy, which needs the extra `ros2`
        self._tokens_ns = 0
        self._begun = False
        self._commanded: Callable[[Nav], Vec3] | None = None  # forces as the program commands; None: it has not yet
        self._zenoh.command = self._command
        self._output = standard.Output(self._hear_line)
        self._write_line = line_writer(f"agent-{config.id}.log")

    def take(self, now_ns: int, deliveries: Iterable[Delivery]) -> None:
        """What has come until a time; with the first one the program begins."""
        self.turns.now_ns = now_ns
        if not self._begun:
            self._begun = True
            self._begin(Random(f"{self._config.seed}/{self._config.id}/{now_ns}"))
        for delivery in deliveries:
            self._hear(delivery)

    def navigate(self, nav: Nav) -> None:
        """Tell the program where its vehicle is, if it listens: on `self/nav` of zenoh, on `/odom` of ROS."""
        if self._zenoh.hears_of_itself():
            (x, y, z, theta, psi), (u, v, w, q, r) = nav.eta, nav.nu
            values = {"t": self.turns.now_ns / NS, "position": [x, y, z], "theta": theta, "psi": psi,
                      "velocity": [u, v, w], "q": q, "r": r}  # fmt: skip
            self._zenoh.tell(json.dumps(values).encode())
        if self._ros is not None:
            self._ros.tell_odometry(self.turns.now_ns, nav)

    def demand(self, nav: Nav) -> Vec3 | None:
        """Surge force [N], pitch and yaw moment [N m] as the program commands; None: it has commanded nothing."""
        return None if self._commanded is None else self._commanded(nav)

    def _command(self, *forces: float) -> None:
        tau = _finite(forces)
        self._commanded = lambda _: tau

    def _command_velocity(self, *velocity: float) -> None:
        self._commanded = partial(velocity_demand, self._config.vehicle, _finite(velocity))

    def sent(self) -> list[bytes]:
        """What the program has sent, and its tokens again and again, since the water may lose them."""
        if self._zenoh.tokens and self.turns.now_ns >= self._tokens_ns:
            self._tokens_ns = self.turns.now_ns + TOKENS_NS
            for token in self._zenoh.tokens:
                self._send(ZENOH, [TOKEN, token.key])
        self._zenoh.expire()
        out, self._out = self._out, []
        return out

    def _begin(self, chance: Random) -> None:
        turns, output = self.turns, self._output
        shuffle = Random(chance.random()) if self._order == "seeded" else None
        space: ImportSpace
        stand_ins: dict[str, Any] = {
            "time": partial(standard.time_module, turns),
            "datetime": partial(standard.datetime_module, turns),
            "os": partial(standard.os_module, chance, self._config.id),
            "signal": standard.signal_module,
            "threading": partial(threading_module, turns, output.write),
            "_thread": lambda: thread_module(space.load("threading")),
            "socket": partial(socket_module, self._datagrams),
            "select": partial(select_module, self._datagrams),
            "asyncio": partial(asyncio_module, turns, self._datagrams, shuffle),
            "zenoh": partial(zenoh_module, self._zenoh),
            "zenoh.handlers": lambda: space.load("zenoh").handlers,
        }
        own = {"print": standard.print_to(output)}
        space = ImportSpace(self._file.parent, stand_ins, standard.REFUSED, own, self._shared)
        space.make_others = self._of_ros
        arguments = [str(self._file), *self._arguments]
        stand_ins["sys"] = partial(standard.sys_module, arguments, space.every_module, space.path, output)
        stand_ins["random"] = partial(_random, space, stand_ins, chance)
        turns.start(partial(self._run, space))

    def _run(self, space: ImportSpace) -> None:
        try:
            space.run(self._file)
        except SystemExit as end:
            if end.code not in (None, 0):
                raise ProgramFailed(f"it ended with {end.code!r:.200}") from None

    def _of_ros(self, name: str) -> ModuleType | None:
        if name.partition(".")[0] != "rclpy":
            return interface(name, self._file.parent)
        from fleet.addons.programs.ros_modules import rclpy_modules
        from fleet.addons.programs.ros_node import Ros

        if self._ros is None:
            self._ros = Ros(self.turns, self._config.id, partial(self._send, ROS), self._output.write)
            self._ros.command, self._ros.command_velocity = self._command, self._command_velocity
            self._rclpy_modules = rclpy_modules(self._ros)
        return self._rclpy_modules.get(name)

    def _hear_line(self, line: str) -> None:
        if self.turns.over:
            return
        for each in self._reads:
            if (value := each.read(line)) is not None:
                self.values[each.name] = value
        self._write_line(f"{self.turns.now_ns / NS:.3f} {line}")

    def _send_datagram(self, agent: int, port: int, to_port: int, data: bytes) -> None:
        self._send(DATAGRAM, [agent, port, to_port, data])

    def _send(self, kind: str, message: list[Any]) -> None:
        self._out.append(pack(kind, message))

    def _hear(self, delivery: Delivery) -> None:
        kind = delivery.payload[2 : 2 + delivery.payload[1]].decode("ascii", "replace") if delivery.payload else ""
        if kind not in (ZENOH, DATAGRAM, ROS):
            return
        try:
            message = unpack(kind, delivery.payload)
        except PayloadError:
            return  # it was damaged on the way, and UDP and TCP have checksums, too
        if kind == DATAGRAM:
            agent, port, to_port, data = message
            if agent in (EVERYBODY, self._config.id):
                self._datagrams.hear(delivery.src, port, to_port, data)
        elif kind == ZENOH:
            self._zenoh.hear(delivery.src, message)
        elif self._ros is not None:
            self._ros.hear(delivery.src, message)


def _finite(command: Sequence[float]) -> Vec3:
    if not all(map(isfinite, command)):
        raise ProgramFailed(f"it commands {command}: every number must be finite")
    surge, pitch, yaw = map(float, command)
    return surge, pitch, yaw


def _random(space: ImportSpace, stand_ins: dict[str, Any], chance: Random) -> ModuleType:
    make = stand_ins.pop("random")
    try:
        return standard.random_module(space.load("random"), chance)
    finally:
        stand_ins["random"] = make
