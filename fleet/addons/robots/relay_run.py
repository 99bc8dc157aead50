"""A run whose robots are other programs: a relay in a process of its own; here its log and its operator.

It is a `Runner`, and for the operator a `Fleet` whose faults are those of the network alone.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing import Pipe
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic_ns
from types import MappingProxyType
from typing import Any

import msgpack
import msgspec

from fleet.addons.robots.message_log import MessageLog, place_of
from fleet.addons.robots.programs import Programs
from fleet.analysis.robot_addresses import lines
from fleet.errors import FleetError, RunBroken, StoppedError
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.directory import RunDirectory
from fleet.execution.notes import nothing_came, some
from fleet.execution.operator import Operator
from fleet.execution.runner import Closing
from fleet.processes.children import Children, Exit, describe_exit
from fleet.processes.interrupts import holding_interrupts
from fleet.processes.run_folder import RunFolder
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile, NoLog
from fleet.scenario.faults.kind import Kill
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.schema.nodes import TopicPlace, udp_target, without_address
from netem import relay_process
from netem.endpoint import ModemEndpoint
from netem.errors import MalformedMessage
from netem.faults import NetFault, fault_values
from netem.relay_messages import Opened, Port, RelayReport, Setup, Watched
from netem.relay_process import MOST_NOTES
from netem.wire.bus import Bus
from netem.wire.codec import encode
from netem.wire.control import read_map
from netem.wire.credentials import CONSOLE, OPERATOR, generate
from netem.wire.keys import Keys
from netem.wire.messages import Command, Frame, Life, LinkReport, VehicleFrame, WorldFault
from netem.wire.robots import ANY_PORT, RobotEndpoint
from netem.wire.session import quiet_zenoh

RELAY = "relay"
OPEN_S = 20.0  # for sessions that wait for a router of others
CLOSE_S = 10.0
POLL_S = 0.05
PROMPT_S = 0.005
_FREE = f"tcp/127.0.0.1{ANY_PORT}"
STILL = (0.0, 0.0, 0.0)  # the force and moments of a robot whose motion nobody measures
GONE_S = 2.0  # until the end of a process is known whose pipe has closed
PING_S = 0.1
BEHIND_S = 1.0  # with its reports, and so with messages: the status line says so
LEAD_NS = 20_000_000  # a fault that is injected begins so much later, so that the relay knows it by then
LOST_AFTER_NS = 10_000_000_000


def setup_of(
    scenario: Scenario,
    folder: Path | None,
    found: Mapping[str, str] = MappingProxyType({}),
    watched: Sequence[Watched] = (),
) -> Setup:
    """The settings of the relay of a scenario with nodes.

    Args:
        scenario: the scenario.
        folder: where a node's file of zenoh is looked for.
        found: the addresses of nodes that say none.
        watched: what the console wants to know of robots.
    """
    spec, here = scenario.spec, folder or Path()
    nodes = list(enumerate((spec.nodes or {}).values(), start=1))
    names, ports = scenario.nodes, []
    for i, node in nodes:
        for port, text in node.udp.items():
            target = udp_target(text)
            assert target is not None  # the schema has read it
            dst, host, to = target
            ports.append(Port(i, int(port), names.index(dst) + 1, host, to, node.host))
    return Setup(
        config=scenario.netem_config,
        robots=tuple(
            RobotEndpoint(
                i,
                names[i - 1],
                node.listen or found.get(names[i - 1], ""),
                node.connect or "",
                str(here / node.zenoh) if node.zenoh else "",
                silent=node.modem is not None and spec.carry is None,
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
        watched=tuple(watched),
        modems=tuple(modems_of(scenario)),
        isolated=tuple(i for i, node in nodes if node.isolate),
        ticks=scenario.ticks,
    )


def modems_of(scenario: Scenario) -> Iterator[ModemEndpoint]:
    """The modems that programs open, of the nodes that have one."""
    for i, node in enumerate((scenario.spec.nodes or {}).values(), start=1):
        if (modem := node.modem) is None:
            continue
        from fleet.addons.modems.languages import modem_core

        yield modem_core(i, modem)


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
        self._begin_ns = 2**63  # when tick 0 begins; nobody knows it before the programs are ready
        self._ended = False
        self._relay_cpu_s = 0.0
        self._until = -1  # the relay has told everything up to this tick
        self._programs = Programs(scenario, directory.path, print_line)
        self._planned: Sequence[Any] = ()  # the faults that the programs know
        self._every = frame_every(scenario)
        self._found: dict[str, str] = {}  # by node that says none: the address where its programs meet us
        self._places = {i: (*plan.start, 0.0, 0.0) for i, plan in enumerate(scenario.plans, start=1)}
        self.started_s, self.middleware_lost = 0.0, 0
        self.closing = Closing()
        self.notes: list[str] = []
        self.deaths: dict[int, list[str]] = {}
        self.waiting = ""

    def serve(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Run to the end, or until the operator or Ctrl-C ends it, which is how most runs end. Raises RunBroken: the
        relay ended, or could not begin; StoppedError, KeyboardInterrupt: it was ended before t = 0, so there is nothing
        to judge.
        """
        began, folder, bus = time.monotonic(), RunFolder(), None
        try:
            self._start(progress)
            bus = self._admit(folder)
            operator = Operator(self._scenario, self._journal, LiveClock(policy, time.monotonic()), self)
            self._begin(operator, progress)
            self.started_s = time.monotonic() - began
            try:
                self._record(operator, progress)
            except (StoppedError, KeyboardInterrupt):
                if not self._begun:
                    raise
                self._tell(op="close")
            self._take_rest(progress)
        except (StoppedError, KeyboardInterrupt):
            if not self._begun:
                self._note(self._ended_early())
            raise
        finally:
            with holding_interrupts() as came:  # otherwise processes stay, and an open session keeps us from ending
                self._programs.close(came)
                if self.closing.timing:
                    self.closing.timing["programs"] = self._programs.waits()
                self.notes += self._programs.notes
                if self._programs.states:
                    self.closing.cpu_s = self._relay_cpu_s + self._programs.cpu_s + time.process_time()
                self._children.stop()
                if bus is not None:
                    bus.close()
                self._directory.connection.unlink(missing_ok=True)
                folder.close()

    def _start(self, progress: Callable[[], None]) -> None:
        free = without_address(self._scenario.spec.nodes or {})
        self._found = dict.fromkeys(free, _FREE)
        setup = setup_of(self._scenario, self._scenario.reading.folder, self._found, self._programs.watched)
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
        opened = msgspec.msgpack.decode(self._received(), type=Opened)
        if opened.problem:
            raise RunBroken(opened.problem)
        ports = {self._scenario.nodes[i - 1]: port for i, port in opened.ports.items()}
        self._modems = {self._scenario.nodes[i - 1]: where for i, where in opened.modems.items()}
        self._namespaces = {self._scenario.nodes[i - 1]: enter for i, enter in opened.namespaces.items()}
        self._found = {name: f"{_FREE.removesuffix(ANY_PORT)}:{ports[name]}" for name in self._found}
        self.waiting = ""
        # Not before: a program that comes too early is refused.
        for line in lines(self._scenario, self._found, self._modems):
            self._print(line)

    def _begin(self, operator: Operator, progress: Callable[[], None]) -> None:
        """Fix when tick 0 begins: at once, or when all programs are ready. Raises RunBroken: one is not ready."""

        def meanwhile() -> None:
            self._answer(operator)
            self._explain_exit()
            progress()

        programs = self._programs
        if not programs.states:
            self._begin_ns = programs.begins(LEAD_NS)
            self._tell(op="begin", at_ns=self._begin_ns)
            return
        self._tell(op="rehearse", at_ns=None)
        self.waiting = "starting the programs"
        programs.start(self._addresses, self._modems, self._namespaces, meanwhile)
        while True:
            programs.hear()
            if not (unready := programs.unready()):
                break
            self.waiting = f"waiting for {some(unready)} to be ready"
            if self._pipe.poll(POLL_S):
                self._take()
            meanwhile()
        self.waiting = ""
        self._begin_ns = programs.begins(LEAD_NS)
        self._tell(op="begin", at_ns=self._begin_ns)

    @property
    def _addresses(self) -> dict[str, str]:
        """Where programs meet us, by node."""
        nodes = (self._scenario.spec.nodes or {}).items()
        found = {name: node.listen or node.connect or self._found.get(name, "") for name, node in nodes}
        return {name: address for name, address in found.items() if address}

    def _admit(self, folder: RunFolder) -> Bus:
        """Let commands reach this run, as those of vehicles."""
        quiet_zenoh()
        credentials = generate(())
        bus = Bus.host(folder.endpoint, self._keys, (), credentials, folder.path)
        bus.answer(f"{self._keys.op}/*", lambda _, data, respond: self._requests.put((data, respond)))
        bus.token(self._keys.alive(CONSOLE))
        reached = {"endpoint": folder.endpoint, "run": self._keys.run, "scenario": self._scenario.name}
        own = {"pid": os.getpid(), "nodes": self._addresses, **credentials[OPERATOR].to_values()}
        self._directory.write_connection({**reached, **own})
        return bus

    def _record(self, operator: Operator, progress: Callable[[], None]) -> None:
        pinged = 0.0
        while self._taken(progress):
            self._answer(operator)
            if operator.faults is not self._planned:
                self._planned = operator.faults
                self._programs.plan(self._planned, self._scenario.tick_ns)
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
            self._end_programs(progress)
            return False
        self._programs.hear()
        self._frames()
        behind_s = (monotonic_ns() - self._begin_ns - self._journal.reported * self._scenario.tick_ns) / 1e9
        self.waiting = f"the relay is behind, by {behind_s:.1f} s" if behind_s > BEHIND_S else ""
        if not self._begun and self._programs.states:
            self.waiting = f"all programs are ready, and t = 0 comes in {-behind_s:.0f} s"
        self._explain_exit()
        progress()
        return True

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
        self._programs.see(report.watched)
        if report.until < 0:
            return False
        for message in report.messages:
            self._messages.write(message)
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
        self._until = until
        if end is None:
            self._frames()
            return False
        rest = tuple(fates) if fate is None else (fate, *fates)
        self._journal.links(LinkReport(until, True, False, rest))
        entered = {(src, dst): (sent, copies) for src, dst, sent, copies in end["entered"]}
        self.closing = Closing(entered=entered, timing={"late": end["late"], "came": end["came"]})
        self._relay_cpu_s = end["cpu_s"]
        return True

    def _end_programs(self, progress: Callable[[], None]) -> None:
        """The relay has told everything: wait until the programs have told what they did until then, and stop them."""
        if self._ended:
            return
        self._ended = True
        programs, end_ns = self._programs, self._begin_ns + self._until * self._scenario.tick_ns
        programs.ends_at(end_ns)
        deadline = time.monotonic() + CLOSE_S
        while programs.known_ns < end_ns and time.monotonic() < deadline:
            programs.hear()
            self._frames()
            progress()
            time.sleep(PROMPT_S)
        self._frames(whole=True)
        sent = any(count for count, _ in self.closing.entered.values())
        if (verdict := programs.verdict(sent=sent)) is not None:
            self.closing.verdicts.append(verdict)
        self.deaths = programs.deaths()
        self.notes += programs.silent()
        if self._begun:
            self.notes += self._mute()

    def _mute(self) -> list[str]:
        """Notes on nodes from which nothing came: their programs may reach each other without us."""
        sent = {src for (src, _), (count, _) in self.closing.entered.items() if count}
        started = {state.node for state in self._programs.states.values()}
        mute = [self._scenario.nodes[i - 1] for i in sorted(started - sent)]
        if not mute:
            return []
        if not sent:
            return ["no program sent anything through this network: do they reach each other without it, by addresses "
                    "of their own or by multicast?"]  # fmt: skip
        return [nothing_came(mute)]

    def _frames(self, *, whole: bool = False) -> None:
        """Write the frames up to where relay and programs have told everything. `whole`: up to the end of the run."""
        tick_ns, framed = self._scenario.tick_ns, self._journal.framed
        until = self._until
        if not whole:
            until = min(until, (self._programs.known_ns - self._begin_ns) // tick_ns)
        tick = 0 if framed < 0 else framed + self._every
        while tick <= until:
            self._frame(tick)
            tick += self._every
        if whole and self._journal.framed < until:
            self._frame(until)

    def _frame(self, tick: int) -> None:
        programs, tick_ns = self._programs, self._scenario.tick_ns
        programs.advance(self._begin_ns + tick * tick_ns)
        rows = []
        for i, place in self._places.items():
            told = programs.values(i) if self._scenario.spec.signals else None
            command = b"" if told is None else encode(Command(0, tick, STILL, told))
            rows.append(VehicleFrame(i, place, (0.0,) * 5, (), STILL if command else (), command, (), (), (), ()))
        lives = tuple(
            Life(min(tick, max(0, -(-(at_ns - self._begin_ns) // tick_ns))), node, begins, False)
            for at_ns, node, begins in programs.changes
        )
        programs.changes.clear()
        self._journal.frame(Frame(tick, False, lives, (), tuple(rows)))

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

    @property
    def _begun(self) -> bool:
        return monotonic_ns() >= self._begin_ns

    def _ended_early(self) -> str:
        """In words, what the end of a run before its t = 0 has ended."""
        names = some([name for name, state in self._programs.states.items() if state.runs])
        state = f" ({self.waiting})" if self.waiting else ""
        return f"the run ended before t = 0{state}" + (f", and its programs with it: {names}" if names else "")

    def _note(self, text: str) -> None:
        self.notes.append(text)
        self._print(text)

    def _answer(self, operator: Operator) -> None:
        """Answer the requests that have come. Raises StoppedError: one of them was to stop."""
        try:
            while not operator.stopping:
                data, respond = self._requests.get_nowait()
                try:
                    answer = operator.handle(read_map(data))
                except MalformedMessage as error:
                    answer = {"error": str(error)}
                respond(msgpack.packb(answer))
        except Empty:
            return
        raise StoppedError

    @property
    def granted(self) -> int:
        """The tick at which a fault begins that is injected now: the first one, if the run has not begun yet."""
        return max(0, (monotonic_ns() + LEAD_NS - self._begin_ns) // self._scenario.tick_ns)

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        self._tell(op="faults", faults=[fault_values(fault) for fault in faults])
        return True

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        """The programs get their pauses with the plan of all faults; the operator refuses the rest."""

    def vehicles_without_agent(self) -> list[int]:
        return self._programs.gone

    def end_agents(self, kill: Kill) -> None:
        """The programs get it with the plan of all faults."""

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        if begin is None:
            self._programs.again(i)

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
