"""A run between robots that are not ours: a relay in a process of its own; here its log and its operator.

It is a `Runner`, and for the operator a `Fleet` whose faults are those of the network alone.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import Pipe
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic_ns
from types import MappingProxyType
from typing import Any

import msgpack
import msgspec

from fleet.addons.robots.message_log import MessageLog, place_of
from fleet.analysis.robot_addresses import lines
from fleet.errors import FleetError, RunBroken
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.directory import RunDirectory
from fleet.execution.operator import Operator
from fleet.execution.runner import Closing
from fleet.processes.children import Children, Exit, describe_exit
from fleet.processes.ports import free_port
from fleet.processes.run_folder import RunFolder
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile, NoLog
from fleet.scenario.faults.kind import Kill
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.nodes import TopicPlace, udp_target, without_address
from netem import relay_process
from netem.errors import MalformedMessage
from netem.faults import NetFault, fault_values
from netem.relay_process import MOST_NOTES, Port, RelayReport, Setup
from netem.wire.bus import Bus
from netem.wire.control import read_map
from netem.wire.credentials import CONSOLE, OPERATOR, generate
from netem.wire.keys import Keys
from netem.wire.messages import Frame, LinkReport, VehicleFrame, WorldFault
from netem.wire.robots import RobotEndpoint
from netem.wire.session import quiet_zenoh

RELAY = "relay"
OPEN_S = 20.0  # for sessions that wait for a router of others
CLOSE_S = 10.0
POLL_S = 0.05
GONE_S = 2.0  # until the end of a process is known whose pipe has closed
PING_S = 0.1
BEHIND_S = 1.0  # with its reports, and so with messages: the status line says so
LEAD_NS = 20_000_000  # a fault that is injected begins so much later, so that the relay knows it by then
LOST_AFTER_NS = 10_000_000_000


def setup_of(scenario: Scenario, folder: Path | None, found: Mapping[str, str] = MappingProxyType({})) -> Setup:
    """The settings of the relay of a scenario with nodes. `folder`: where a node's file of zenoh is looked for.
    `found`: the addresses of nodes that say none.
    """
    spec, here = scenario.spec, folder or Path()
    nodes = list(enumerate((spec.nodes or {}).values(), start=1))
    names, ports = scenario.nodes, []
    for i, node in nodes:
        for port, text in node.udp.items():
            target = udp_target(text)
            assert target is not None  # the schema has read it
            dst, host, to = target
            ports.append(Port(i, int(port), names.index(dst) + 1, host, to))
    return Setup(
        config=scenario.netem_config,
        robots=tuple(
            RobotEndpoint(
                i,
                names[i - 1],
                node.listen or found.get(names[i - 1], ""),
                node.connect or "",
                str(here / node.zenoh) if node.zenoh else "",
            )
            for i, node in nodes
        ),
        carry=tuple(spec.carry or ("**",)),
        ports=tuple(ports),
        places={i: scenario.plans[i - 1].start for i, _ in nodes},
        place_topics={i: node.place.topic.strip("/") for i, node in nodes if isinstance(node.place, TopicPlace)},
        header=spec.header or 0,
        fragments=bool(spec.fragments),
        payloads=bool(spec.log.payloads),
        linked=spec.discovery == "linked",
        lost_after_ns=spec.lost_after or LOST_AFTER_NS,
        ticks=scenario.ticks,
    )


class RelayRun:
    """One run: its relay, its journal, its operator."""

    def __init__(
        self,
        scenario: Scenario,
        directory: RunDirectory,
        journal: Journal,
        log: LogFile | NoLog,
        run: str,
        print_line: Callable[[str], None],
    ) -> None:
        """Prepare it; nothing is started. `print_line`: shows the operator a line that stays."""
        self._scenario, self._directory, self._journal, self._print = scenario, directory, journal, print_line
        self._messages = MessageLog(log, scenario.tick_ns, scenario.nodes)
        self._keys = Keys(run)
        self._exits: SimpleQueue[Exit] = SimpleQueue()
        self._children = Children(self._exits.put)
        self._requests: SimpleQueue[tuple[bytes, Callable[[bytes], None]]] = SimpleQueue()
        self._pipe, self._theirs = Pipe()
        self._begin_ns = 0
        self._found: dict[str, str] = {}  # by node that says none: the address where its programs meet us
        self._places = {i: (*plan.start, 0.0, 0.0) for i, plan in enumerate(scenario.plans, start=1)}
        self.started_s, self.middleware_lost = 0.0, 0
        self.closing = Closing()
        self.notes: list[str] = []
        self.deaths: dict[int, list[str]] = {}
        self.waiting = ""

    # --- a runner

    def serve(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Run to the end, or until the operator or Ctrl-C ends it, which is how most runs end. Raises RunBroken: the
        relay ended, or could not begin.
        """
        began, folder, bus = time.monotonic(), RunFolder(), None
        try:
            self._start(progress)
            bus = self._admit(folder)
            self.started_s = time.monotonic() - began
            self._begin_ns = monotonic_ns() + LEAD_NS
            self._tell(op="begin", at_ns=self._begin_ns)
            operator = Operator(self._scenario, self._journal, LiveClock(policy, time.monotonic()), self)
            try:
                self._record(operator, progress)
            except KeyboardInterrupt:
                self._tell(op="close")
            self._take_rest(progress)
        finally:
            self._children.stop()
            if bus is not None:  # an open session would keep this process from ending
                bus.close()
            self._directory.connection.unlink(missing_ok=True)
            folder.close()

    def _start(self, progress: Callable[[], None]) -> None:
        free = without_address(self._scenario.spec.nodes or {})
        self._found = {name: f"tcp/127.0.0.1:{free_port(None)}" for name in free}
        setup = setup_of(self._scenario, self._scenario.reading.folder, self._found)
        title = f"fleet {RELAY} [{self._scenario.name}]"
        log = self._directory.process_log(RELAY)
        self.waiting = "opening the sessions of the nodes"
        progress()
        self._children.start(RELAY, title, log, relay_process.run, self._theirs, setup)
        self._theirs.close()
        self._children.watch()
        deadline = time.monotonic() + OPEN_S
        while not self._pipe.poll(POLL_S):
            progress()
            if time.monotonic() > deadline:
                raise RunBroken(f"the relay did not begin within {OPEN_S:g} s")
            self._explain_exit()
        if problem := self._received().decode():
            raise RunBroken(problem)
        self.waiting = ""
        for line in lines(self._scenario, self._found):  # not before: a program that comes too early is refused
            self._print(line)

    def _admit(self, folder: RunFolder) -> Bus:
        """Let commands reach this run, as those of vehicles."""
        quiet_zenoh()
        credentials = generate(())
        bus = Bus.host(folder.endpoint, self._keys, (), credentials, folder.path)
        bus.answer(f"{self._keys.op}/*", lambda _, data, respond: self._requests.put((data, respond)))
        bus.token(self._keys.alive(CONSOLE))
        nodes = (self._scenario.spec.nodes or {}).items()
        addresses = {name: node.listen or node.connect or self._found.get(name, "") for name, node in nodes}
        reached = {"endpoint": folder.endpoint, "run": self._keys.run, "scenario": self._scenario.name}
        told = {name: address for name, address in addresses.items() if address}
        own = {"pid": os.getpid(), "nodes": told, **credentials[OPERATOR].to_values()}
        self._directory.write_connection({**reached, **own})
        return bus

    def _record(self, operator: Operator, progress: Callable[[], None]) -> None:
        pinged = 0.0
        while self._taken(progress):
            self._answer(operator)
            if operator.stopping:
                self._tell(op="close")
                return
            if (now := time.monotonic()) - pinged > PING_S:
                pinged = now
                self._tell(op="ping", at_ns=monotonic_ns())

    def _take_rest(self, progress: Callable[[], None]) -> None:
        deadline = time.monotonic() + CLOSE_S
        while self._taken(progress):
            if time.monotonic() > deadline:
                raise RunBroken("the relay did not report its last packets")

    def _taken(self, progress: Callable[[], None]) -> bool:
        """Record a report if there is one. Returns whether more will come."""
        if self._journal.complete or (self._pipe.poll(POLL_S) and self._take()):
            return False
        behind_s = (monotonic_ns() - self._begin_ns - self._journal.reported * self._scenario.tick_ns) / 1e9
        self.waiting = f"the relay is behind, by {behind_s:.1f} s" if behind_s > BEHIND_S else ""
        self._explain_exit()
        progress()
        return True

    # --- what the relay says

    def _received(self) -> bytes:
        try:
            return self._pipe.recv_bytes()
        except (EOFError, OSError):
            self._explain_exit(GONE_S)
            raise RunBroken("the relay closed its pipe") from None

    def _take(self) -> bool:
        """Record a report. Returns whether it was the last one."""
        report = msgspec.msgpack.decode(self._received(), type=RelayReport)
        for note in report.notes:
            self._note(note)
        if report.closing is not None and "error" in report.closing:
            raise RunBroken(report.closing["error"])
        self._place(report)
        for said in report.said:
            self._messages.write(said)
        end, until, m = report.closing, report.until, self._scenario.round_ticks
        if end is not None:
            self._journal.end_at(min(until, self._scenario.ticks))
        fates = iter(report.fates)
        fate = next(fates, None)
        begin = self._journal.reported + m if self._journal.reported >= 0 else 0
        for tick in range(begin, until + 1 if end is None else until, m):  # the closing report is that of the last tick
            some = []
            while fate is not None and fate.final_tick <= tick:
                some.append(fate)
                fate = next(fates, None)
            self._journal.links(LinkReport(tick, False, False, tuple(some)))
            self._frame(tick)
        if end is None:
            return False
        rest = tuple(fates) if fate is None else (fate, *fates)
        self._journal.links(LinkReport(until, True, False, rest))
        self._frame(until)
        entered = {(src, dst): (sent, copies) for src, dst, sent, copies in end["entered"]}
        self.closing = Closing(entered=entered, timing={"late": end["late"], "came": end["came"]})
        return True

    def _frame(self, tick: int) -> None:
        if tick == self._journal.framed:
            return
        rows = tuple(
            VehicleFrame(i, place, (0.0,) * 5, (), (), b"", (), (), (), ()) for i, place in self._places.items()
        )
        self._journal.frame(Frame(tick, False, (), (), rows))

    def _place(self, report: RelayReport) -> None:
        moved = {}
        for i, key, payload in report.placed:
            try:
                place = place_of(key, payload)
            except FleetError as error:
                text = f"{self._scenario.vehicle_name(i)}: {error}"
                if text not in self.notes and len(self.notes) < MOST_NOTES:
                    self._note(text)
                continue
            self._places[i] = (*place[:3], 0.0, place[3])
            moved[i] = place[:3]
        if moved:
            self._tell(op="places", places=moved)

    def _note(self, text: str) -> None:
        self.notes.append(text)
        self._print(text)

    # --- commands

    def _answer(self, operator: Operator) -> None:
        try:
            while True:
                data, respond = self._requests.get_nowait()
                try:
                    answer = operator.handle(read_map(data))
                except MalformedMessage as error:
                    answer = {"error": str(error)}
                respond(msgpack.packb(answer))
        except Empty:
            return

    @property
    def granted(self) -> int:
        """The tick at which a fault begins that is injected now."""
        return (monotonic_ns() + LEAD_NS - self._begin_ns) // self._scenario.tick_ns

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        self._tell(op="faults", faults=[fault_values(fault) for fault in faults])
        return True

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        """There are none: the operator refuses them."""

    def without_agent(self) -> list[int]:
        return []

    def end_agents(self, kill: Kill) -> None:
        """Nobody's: the operator refuses it."""

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        """Nobody's."""

    # --- the process

    def _tell(self, **request: Any) -> None:
        try:
            self._pipe.send_bytes(msgspec.msgpack.encode(request))
        except OSError:
            self._explain_exit()

    def _explain_exit(self, patience_s: float = 0.0) -> None:
        """Raise RunBroken if the relay has ended. `patience_s`: its pipe is empty, so we wait so long for its end."""
        try:
            ended = self._exits.get(timeout=patience_s) if patience_s else self._exits.get_nowait()
        except Empty:
            return
        if not patience_s and self._pipe.poll():
            self._exits.put(ended)
            return
        child = self._children.by_role[RELAY]
        lines = [f"last lines of {child.log_path}:", *(f"  {line}" for line in child.tail() or ["(nothing printed)"])]
        raise RunBroken(f"the relay (pid {ended.pid}) {describe_exit(ended.code)}", lines)
