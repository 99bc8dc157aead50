"""The programs of a stack, as the console sees them: their command lines, who is ready or gone, what they have told."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from heapq import heappop, heappush
from math import isfinite, nan
from pathlib import Path
from shlex import quote
from signal import SIGKILL
from time import monotonic_ns
from typing import Any, NamedTuple

from fleet.addons.programs.message_signal import NoNumber
from fleet.addons.robots import keeper
from fleet.addons.robots.message_values import reader
from fleet.analysis.command_lines import search_path
from fleet.analysis.verdicts import NOTHING_AT_ALL
from fleet.errors import RunBroken
from fleet.execution.notes import some
from fleet.processes.child_start import program_environment
from fleet.processes.children import describe_exit
from fleet.result.verdict import Verdict
from fleet.scenario.faults.kind import Kill, Part
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.programs import DONE, ProgramSection, expected_ending, fill_placeholders, programs_of
from fleet.scenario.sections.node_signals import signals_of_node
from netem.fault_kinds import WorldFaultKind
from netem.histogram import Histogram
from netem.namespaces import address
from netem.relay_messages import Watched, WatchedMessage
from netem.relay_process import MOST_NOTES
from netem.wire.messages import WorldFault

BEFORE_NS = 500_000_000  # from the start of the keeper until every program has begun, where {begin_s} is told before
COMPOSE_S = 0.05  # between two looks at the operator while docker works
FEW_LINES = 3  # of a program that ends while the run goes on: others may, too
PATIENCE_NS = 1_000_000_000  # until the user is told who is waited for at the end
STOP_S = 3.0  # for the keeper, beside the time that programs have to stop
_EARLY = "{begin_s}"
_LOGS = ("keeper", "relay")  # of the run, beside those of programs
_NEVER = "(?!)"  # a line has no match of it: something else says that the program is ready


@dataclass(slots=True)
class ProgramState:
    """One program, and how it is doing."""

    name: str  # `m1`, or `m1/mission`
    node: int
    section: ProgramSection
    pid: int | None = None
    ready: bool = False
    since_ns: int = 0  # when it was started last
    ended: str = ""  # how it ended by itself
    code: int = 0
    tail: list[str] = field(default_factory=list)

    @property
    def runs(self) -> bool:
        return self.pid is not None


class ProgramChange(NamedTuple):
    """A program has ended by itself, or has begun again after that."""

    at_ns: int
    node: int
    begins: bool = False


class Programs:
    """All programs of a run. Nothing is started before `start`."""

    def __init__(self, scenario: Scenario, directory: Path, print_line: Callable[[str], None]) -> None:
        """Prepare them.

        Args:
            scenario: it has programs, or signals that nodes tell in messages.
            directory: of the run.
            print_line: shows the operator a line that stays.
        """
        self._scenario, self._directory, self._print = scenario, directory.resolve(), print_line
        spec, nodes = scenario.spec, list(scenario.nodes)
        self.states = {
            name: ProgramState(name, nodes.index(node) + 1, section)
            for name, node, section in programs_of(spec.programs or {}, nodes)
        }
        self._signals = {i: signals_of_node(spec, i) for i in range(1, len(nodes) + 1)}
        self._values: dict[int, list[float]] = {}
        self._counts: dict[int, list[int]] = {}
        for i in self._signals:
            self._forget(i)
        self.watched: list[Watched] = []  # what the relay has to look for
        self._meanings: list[tuple[str, int, int, Any]] = []  # of each: what it is about, node, signal, its reader
        self._watch()
        self._keeper: subprocess.Popen[bytes] | None = None
        self._composed = False
        self._rest = b""
        self._events: list[tuple[int, int, dict[str, Any]]] = []  # by time
        self._count = 0
        self.known_ns = 0 if self.states else 2**63  # everything up to this time has been told
        self.begin_ns: int | None = None
        self.notes: list[str] = []
        self._unread: set[int] = set()  # what is watched and has had a message without a number
        self._spoken: set[str] = set()  # the signals of which some node has told a number
        self.cpu_s = 0.0
        self._waits: dict[str, Histogram] = {}  # for a processor, by node
        self.changes: list[ProgramChange] = []  # since the last frame
        self._over_ns = 2**63
        self._sessions: set[int] = set()  # of all programs that were started: each is the leader of one
        self._stubborn: list[str] = []  # programs that had to be killed when they were to stop

    @property
    def any(self) -> bool:
        """Whether there is anything to start or to look for."""
        return bool(self.states or self.watched)

    def _watch(self) -> None:
        for i, told in self._signals.items():
            for place, section in enumerate(told.values()):
                if section.message is not None:
                    key = self._filled(section.message, i)
                    if section.ros is not None:
                        key = f"*/{key.strip('/')}/**"  # of rmw_zenoh: domain, topic, type, hash
                    self.watched.append(Watched(i, key))
                    self._meanings.append(("signal", i, place, None if section.count else reader(section)))
        for state in self.states.values():
            ready = state.section.ready
            if (text := ready.token or ready.key) is not None:
                self.watched.append(Watched(state.node, self._filled(text, state.node), ready.token is not None))
                self._meanings.append(("ready", state.node, 0, state.name))

    def _filled(self, text: str, node: int) -> str:
        return fill_placeholders(text, {"node": self._scenario.nodes[node - 1], "number": node})

    def start(
        self,
        addresses: Mapping[str, str],
        modems: Mapping[str, str],
        namespaces: Mapping[str, tuple[str, ...]],
        meanwhile: Callable[[], None],
    ) -> None:
        """Start the programs. Raises RunBroken: the keeper cannot start, or docker refuses.

        Args:
            addresses: where they meet us, by node.
            modems: where they open a modem, by node.
            namespaces: the files of the namespaces that they enter, by node.
            meanwhile: called again and again while docker brings containers up, which may take minutes.
        """
        if not self.states:
            return
        after = max((state.section.ready.after or 0 for state in self.states.values()), default=0)
        planned_ns = monotonic_ns() + BEFORE_NS + after + (self._scenario.spec.begin or 0)
        uses = any(_EARLY in text for s in self.states.values() for text in (*s.section.run, *s.section.env.values()))
        self._planned_ns = planned_ns if uses else None
        values = [
            self._values_of(state, addresses, modems, planned_ns)
            | {"enter": namespaces.get(self._scenario.nodes[state.node - 1], ())}
            for state in self.states.values()
        ]
        try:
            self._keeper = subprocess.Popen(
                [sys.executable, "-I", keeper.__file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=(self._directory / "log" / "keeper.log").open("wb"), start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise RunBroken(f"the programs cannot be started: {error.strerror}") from None
        assert self._keeper.stdout is not None
        os.set_blocking(self._keeper.stdout.fileno(), False)
        if self._scenario.spec.compose is not None:
            self._tell(down=self._compose_command("down"))  # before: if somebody kills us, it does that
            self._composed = True  # also one that fails may have begun something
            self._compose("up", "-d", "--wait", meanwhile=meanwhile)
        self._tell(programs=values)

    def _values_of(
        self, state: ProgramState, addresses: Mapping[str, str], modems: Mapping[str, str], begin_ns: int
    ) -> dict[str, Any]:
        section, ready = state.section, state.section.ready
        node = self._scenario.nodes[state.node - 1]
        listen = addresses.get(node, "").replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
        file = self._directory / f"zenoh-{node}.json5"
        if listen:
            connect = {"mode": "client", "connect": {"endpoints": [listen]}}
            file.write_text(json.dumps(connect | {"scouting": {"multicast": {"enabled": False}}}))
        known = {
            "listen": listen, "zenoh": file, "modem": modems.get(node, ""), "node": node, "number": state.node,
            "address": address(state.node),
            "seed": self._scenario.seed,
            "begin_s": f"{begin_ns / 1e9:.3f}", "duration_s": f"{self._scenario.duration_ns / 1e9:g}",
            "dir": self._directory, "domain": os.environ.get("ROS_DOMAIN_ID", "0"),
        }  # fmt: skip
        env = program_environment(os.environ) | {f"FLEET_{key.upper()}": str(value) for key, value in known.items()}
        env["PATH"] = search_path()
        env |= {"PYTHONUNBUFFERED": "1", "ROS_DOMAIN_ID": str(known["domain"])}
        if listen:
            env |= {
                "RMW_IMPLEMENTATION": "rmw_zenoh_cpp",
                "ZENOH_CONFIG_OVERRIDE": f'connect/endpoints=["{listen}"]',
            }
        env |= {key: fill_placeholders(text, known) for key, text in section.env.items()}
        told = self._signals[state.node].values()
        lines = [(n, each.line, bool(each.count)) for n, each in enumerate(told) if each.line is not None]
        return {
            "name": state.name, "node": node, "argv": [fill_placeholders(word, known) for word in section.run],
            "env": env, "folder": section.folder or ".", "nice": section.nice, "signals": lines,
            "log": str(self._log_of(state)),
            "line": _NEVER if ready.token or ready.key else ready.line, "port": ready.port, "after_ns": ready.after,
            "stop": section.stop.signal, "stop_within_ns": section.stop.within,
        }  # fmt: skip

    def unready(self) -> list[str]:
        """The programs that are not ready yet. Raises RunBroken: one has ended, or takes too long."""
        waiting = []
        for state in self.states.values():
            if state.ended and not self._is_fine(state):
                raise RunBroken(f"{state.name} {state.ended} before the run began", self._tail_of(state))
            if state.ready or state.ended:
                continue
            waiting.append(state.name)
            if state.runs and monotonic_ns() - state.since_ns > state.section.ready.within:
                within_s = state.section.ready.within / 1e9
                raise RunBroken(f"{state.name} was not ready within {within_s:g} s", self._tail_of(state))
        return waiting

    def begins(self, lead_ns: int) -> int:
        """Fix when tick 0 begins, now that all are ready: the time [ns]. Raises RunBroken: it was told another one."""
        wanted_ns = monotonic_ns() + lead_ns + (self._scenario.spec.begin or 0)
        if self.states and self._planned_ns is not None:
            if monotonic_ns() + lead_ns > self._planned_ns:
                late_s = (monotonic_ns() + lead_ns - self._planned_ns) / 1e9
                raise RunBroken(f"programs were ready {late_s:.2f} s after {_EARLY}: give begin a longer time")
            wanted_ns = self._planned_ns
        self.begin_ns = wanted_ns
        self._tell(begin=wanted_ns)
        return wanted_ns

    def hear(self) -> None:
        """Take what the keeper says. Raises RunBroken: it is gone."""
        if self._keeper is None or self._keeper.stdout is None:
            return
        while True:
            try:
                data = os.read(self._keeper.stdout.fileno(), 1 << 20)
            except BlockingIOError:
                break
            if not data:
                if self._over_ns == 2**63:
                    raise RunBroken(
                        "the keeper of the programs is gone", _last_lines(self._directory / "log/keeper.log")
                    )
                break
            *lines, self._rest = (self._rest + data).split(b"\n")
            for line in lines:
                self._take(json.loads(line))
        if self.begin_ns is None:
            self.advance(monotonic_ns())

    def _take(self, said: dict[str, Any]) -> None:
        if "until" in said:
            self.known_ns = said["until"]
        elif "cpu_s" in said:
            self.cpu_s = said["cpu_s"]
        elif "slow" in said:
            state, what = self.states[said["slow"]], said["what"]
            told = list(self._signals[state.node])
            name = what if isinstance(what, str) else f"signal {told[what]}"
            self._note(
                f"{state.name}: the pattern of {name} takes longer than {keeper.MOST_MATCH_S:g} s for a line, "
                "and is not tried any more: write it without repetitions inside repetitions"
            )
        elif "waits" in said:
            for node, ns in said["waits"].items():
                self._waits.setdefault(node, Histogram()).add(ns)
        else:
            self._put(said["at"], said)

    def _put(self, at_ns: int, said: dict[str, Any]) -> None:
        self._count += 1
        heappush(self._events, (at_ns, self._count, said))

    def see(self, messages: Iterable[WatchedMessage]) -> None:
        """Take messages and tokens that the relay was to look for."""
        for message in messages:
            what, node, place, how = self._meanings[message.which]
            if what == "ready":
                self._put(message.at_ns, {"ready": how, "at": message.at_ns})
                continue
            try:
                value = None if how is None else how(message.key, message.payload)
            except NoNumber as error:
                if message.which not in self._unread:  # the next one is wrong at another place
                    self._unread.add(message.which)
                    name = list(self._signals[node])[place]
                    self._note(f"{self._scenario.nodes[node - 1]}: signal {name}: {message.key:.80}: {error}")
                continue
            self._put(message.at_ns, {"told": node, "signal": place, "value": value})

    def _note(self, text: str) -> None:
        if len(self.notes) < MOST_NOTES:
            self.notes.append(text)
            self._print(text)

    def advance(self, to_ns: int) -> None:
        """Let happen what happened up to a time [ns]."""
        while self._events and self._events[0][0] <= to_ns:
            at_ns, _, said = heappop(self._events)
            match said:
                case {"told": who, "signal": place, "value": value}:
                    node = who if isinstance(who, int) else self._scenario.nodes.index(who) + 1
                    self._counts[node][place] += 1
                    number = float(self._counts[node][place]) if value is None else value
                    self._values[node][place] = number if isfinite(number) else nan
                    self._spoken.add(list(self._signals[node])[place])
                case {"started": name, "pid": pid}:
                    self._starts(self.states[name], pid, at_ns)
                case {"ready": name}:
                    self.states[name].ready = self.states[name].runs
                case {"killed": name}:
                    self.states[name].pid, self.states[name].ready = None, False
                case {"ended": name, "code": code, "tail": tail}:
                    self._ends(self.states[name], code, tail, at_ns)

    def _starts(self, state: ProgramState, pid: int, at_ns: int) -> None:
        if state.ended:
            self.changes.append(ProgramChange(at_ns, state.node, begins=True))
        state.pid, state.since_ns, state.ready, state.ended = pid, at_ns, False, ""
        self._sessions.add(pid)
        self._forget(state.node)

    def _forget(self, node: int) -> None:
        """A node has told nothing yet: of that, the number of its lines and messages is known."""
        told = self._signals[node].values()
        self._values[node] = [0.0 if section.count else nan for section in told]
        self._counts[node] = [0] * len(told)

    def _ends(self, state: ProgramState, code: int, tail: list[str], at_ns: int) -> None:
        state.pid, state.ready, state.code, state.tail = None, False, code, tail
        how = describe_exit(code)
        if at_ns >= self._over_ns:  # the run is over, and stops it
            if code == -SIGKILL and state.section.stop.signal != "KILL":
                self._stubborn.append(state.name)
            return
        if self.begin_ns is None:
            state.ended = how
            return
        at_s = (at_ns - self.begin_ns) / 1e9
        state.ended = f"{how} at {at_s:.2f} s"
        if self._is_fine(state):
            return
        self.changes.append(ProgramChange(at_ns, state.node))
        self._print("\n".join([f"{state.name} {how} at t = {at_s:.2f} s", *self._tail_of(state, FEW_LINES)]))

    def _wanted(self, state: ProgramState) -> str:
        return expected_ending(self._scenario.spec.checks.programs, state.name, self._scenario.nodes[state.node - 1])

    def _is_fine(self, state: ProgramState) -> bool:
        return self._wanted(state) == DONE and state.code == 0

    def _log_of(self, state: ProgramState) -> Path:
        """The file of what it prints. No node has a plus in its name, so each program has a file of its own."""
        name = f"{state.name}+" if state.name in _LOGS else state.name.replace("/", "+")
        return self._directory / "log" / f"{name}.log"

    def _tail_of(self, state: ProgramState, most: int = keeper.TAIL) -> list[str]:
        lines = state.tail[-most:] or ["(nothing printed)"]
        return [f"last lines of {self._log_of(state)}:", *(f"  {line}" for line in lines)]

    def waits(self) -> dict[str, Any]:
        """How long threads of programs waited for a processor, by node."""
        return {node: waits.to_values() for node, waits in self._waits.items()}

    def values(self, node: int) -> tuple[float, ...] | None:
        """What a node has told last, in the order of its signals; None: it has no program that runs and is ready."""
        own = [state for state in self.states.values() if state.node == node]
        if own and not all(state.ready or (self._is_fine(state) and state.ended) for state in own):
            return None
        return tuple(self._values[node])

    @property
    def gone(self) -> list[int]:
        """The nodes of which a program does not run, in ascending order; one that has done its work runs."""
        ones = self.states.values()
        return sorted({state.node for state in ones if not (state.runs or (state.ended and self._is_fine(state)))})

    def plan(self, faults: Sequence[Part], tick_ns: int) -> None:
        """Carry out the faults that are about programs, in place of those of before."""
        if self._keeper is None:
            return
        assert self.begin_ns is not None
        dead: dict[str, list[list[int | None]]] = {}
        paused: dict[str, list[list[int | None]]] = {}
        for part in faults:
            pauses = isinstance(part, WorldFault) and part.kind == WorldFaultKind.PAUSE
            if isinstance(part, Kill) or pauses:
                begin = self.begin_ns + part.begin * tick_ns
                end = None if part.end is None else self.begin_ns + part.end * tick_ns
                spans = paused if pauses else dead
                for i in part.vehicles or range(1, len(self._scenario.nodes) + 1):
                    spans.setdefault(self._scenario.nodes[i - 1], []).append([begin, end])
        self._tell(dead=dead, paused=paused)

    def again(self, node: int) -> None:
        """Start the programs of a node again that have ended by themselves."""
        self._tell(again=self._scenario.nodes[node - 1])

    def ends_at(self, at_ns: int) -> None:
        """The run is over at a time [ns]: what ends later is no failure."""
        self._over_ns = at_ns

    def close(self, hurry: Callable[[], object] = lambda: None) -> None:
        """Stop the programs, and kill those that do not stop in time. Nothing of them is left.

        Args:
            hurry: whether the user does not want to wait for them any more.
        """
        if self._keeper is not None:
            self._stop(self._keeper, hurry)
        self._keeper = None
        if self._composed:
            self._composed = False
            self._compose("down")

    def _stop(self, kept: subprocess.Popen[bytes], hurry: Callable[[], object]) -> None:
        self._over_ns = min(self._over_ns, monotonic_ns())
        self._tell(stop=True)
        within_s = max((state.section.stop.within / 1e9 for state in self.states.values()), default=0.0)
        assert kept.stdin is not None
        began, told = monotonic_ns(), False
        deadline = began + round((within_s + STOP_S) * 1e9)
        with suppress(RunBroken):  # the keeper may be gone already
            while kept.poll() is None and monotonic_ns() < deadline and not hurry():
                self.hear()
                if not told and monotonic_ns() > began + PATIENCE_NS:
                    told = True
                    self._print(f"programs have {within_s:g} s to stop; Ctrl-C kills them at once")
                with suppress(subprocess.TimeoutExpired):
                    kept.wait(0.02)
            self.hear()
        self.advance(2**63)
        if self._stubborn:
            self._note(f"{some(self._stubborn)} did not stop in time and had to be killed: see stop")
        with suppress(OSError):
            kept.stdin.close()  # it kills what is left
        with suppress(subprocess.TimeoutExpired):
            kept.wait(STOP_S)
        kept.kill()
        if kept.wait():  # it has not: each program is a session, and what it had started is of that
            for session in self._sessions:
                for pid in keeper.descendants([session], session=session):
                    with suppress(OSError):
                        os.kill(pid, SIGKILL)
        if kept.stdout is not None:
            kept.stdout.close()

    def silent(self) -> list[str]:
        """A note for each signal of which no node has told a number. A number of lines or messages needs none."""
        found = []
        for name, section in (self._scenario.spec.signals or {}).items():
            nodes = [self._scenario.nodes[i - 1] for i, told in self._signals.items() if name in told]
            if section.count or name in self._spoken or not nodes:
                continue
            what = "line" if section.message is None else f"message on {section.message}"
            found.append(f"signal {name}: no {what} of {some(nodes)} had a number")
        return found

    def verdict(self, *, sent: bool) -> Verdict | None:
        """Whether all programs ran, or did their work; None: there are none. `sent`: whether anything came from one."""
        if not self.states:
            return None
        bad = []
        for state in self.states.values():
            last = f': "{state.tail[-1]:.120}"' if state.tail else ""
            if self._wanted(state) == DONE and not state.ended:
                bad.append(f"{state.name} did not end")
            elif state.ended and not self._is_fine(state):
                bad.append(f"{state.name} {state.ended}{last}")
        wants = self._scenario.spec.checks.programs or {"*": "running"}
        asked = ", ".join(what if pattern == "*" else f"{pattern} {what}" for pattern, what in wants.items())
        found = "; ".join(bad[:4]) + (f" and {len(bad) - 4} more" if len(bad) > 4 else "")
        printed = any(path.exists() and path.stat().st_size for path in map(self._log_of, self.states.values()))
        runs = any(self._wanted(state) != DONE for state in self.states.values())
        if runs and not (bad or sent or printed):
            return Verdict("programs", False, asked, f"all {len(self.states)}{NOTHING_AT_ALL}")
        verdict = Verdict("programs", not bad, asked, found or f"all {len(self.states)}", len(bad), 0, "programs")
        return verdict.with_margin(-len(bad), "programs")

    def deaths(self) -> dict[int, list[str]]:
        """By node, how its programs ended that were to run, with their last lines."""
        found: dict[int, list[str]] = {}
        for state in self.states.values():
            if state.ended and not self._is_fine(state):
                found.setdefault(state.node, []).extend([f"{state.name} {state.ended}", *state.tail])
        return found

    def _tell(self, **values: Any) -> None:
        if self._keeper is None or self._keeper.stdin is None:
            return
        with suppress(OSError):  # it is gone, and `hear` says so
            self._keeper.stdin.write(json.dumps(values).encode() + b"\n")
            self._keeper.stdin.flush()

    def _compose_command(self, *words: str) -> list[str]:
        name = f"fleet-{self._directory.name}".lower()
        return ["docker", "compose", "-p", name, "-f", str(self._scenario.spec.compose), *words]

    def _compose(self, *words: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Bring what a compose file names up or down. Raises RunBroken: docker is not here, or refuses."""
        command = self._compose_command(*words)
        try:
            docker = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace"
            )
        except FileNotFoundError:
            raise RunBroken("compose needs docker, which is not here: install it, or leave compose out") from None
        with docker:
            said: str | None = None
            try:
                while said is None:
                    meanwhile()
                    with suppress(subprocess.TimeoutExpired):
                        _, said = docker.communicate(timeout=COMPOSE_S)
            except BaseException:
                docker.terminate()  # who ends the run waits for no download
                raise
        if docker.returncode and words[0] == "up":
            raise RunBroken(f"{' '.join(map(quote, command))} failed", said.splitlines()[-12:])


def _last_lines(file: Path) -> list[str]:
    with suppress(OSError):
        return [f"  {line}" for line in file.read_text("utf-8", "replace").splitlines()[-12:]]
    return []
