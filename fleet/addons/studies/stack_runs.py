"""Runs of a study whose programs are not ours: each is a `fleet netem` of its own, on the wall clock.

A run has a process, ports and a folder of its own. How many go on at a time follows from the CPU time of the first one:
together they take three quarters of what it and idle processors had, so that what else the machine does has room. A run
in which the host was late says nothing about the network. It is made again, and is no result if it is late three times.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from shlex import quote
from typing import IO

import psutil
from msgspec import structs

from fleet.addons.studies.modules import folder_of_checks
from fleet.addons.studies.one_run import Task, failed_row, late, measured_row, scenario_of, whole_row
from fleet.addons.studies.row import FAILED, LATE, Row, run_name
from fleet.addons.studies.signal_measures import Samples
from fleet.errors import FleetError, printable
from fleet.execution.directory import SCENARIO
from fleet.logs.open_log import open_log
from fleet.processes.child_start import PARENT_PID_VARIABLE
from fleet.processes.limits import processors
from fleet.result.file import RESULT, read_result
from fleet.result.result import Result, Status
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.nodes import Node
from netem.private_folder import PrivateFolder

TRIES = 3  # of a run that is late
MOST_KEPT = 20  # directories of runs that failed, of one study
MOST_LATE, ENOUGH = 0.2, 5  # share of late runs above which fewer go on at a time, and of how many runs
SHARE = 0.75  # of the processors
MOST_AT_ONCE = 32
GRACE_S = 60.0  # that a run may take beside its own time: programs start, get ready, and stop
POLL_S = 0.05


class StackRuns:
    """Makes such runs on this machine."""

    def __init__(self, at_once: int | None = None, tell: Callable[[str], None] = lambda _: None) -> None:
        """Prepare it.

        Args:
            at_once: how many runs go on at a time; None: as many as the first one shows to be possible.
            tell: gets a sentence that the user should read.
        """
        self._given, self._at_once, self._tell = at_once, at_once or 1, tell
        self._since = [0, 0]  # runs, and those that were late, since their number at a time changed
        self._broken = False  # whether a run without a result was told
        self._one = False  # whether two runs would need the same port
        self._told = False  # that the runs are on the wall clock

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """Make every run; see `Engine.make`. No process, port or folder of one is left, whatever ends this."""
        under_way: list[_Run] = []
        again: deque[tuple[Task, int]] = deque()
        more = True
        try:
            while True:
                while len(under_way) < (1 if self._one else self._at_once) and (again or more):
                    if again:
                        task, tries = again.popleft()
                    elif (new := next(tasks, None)) is not None:
                        task, tries = new, 1
                        self._look_at(task)
                    else:
                        more = False
                        continue
                    under_way.append(_Run(task, tries))
                if not under_way:
                    return
                time.sleep(POLL_S)
                for run in [run for run in under_way if run.over]:
                    under_way.remove(run)
                    row = whole_row(run.task, run.row())
                    self._count(run, row)
                    if row.status == LATE and run.tries < TRIES:
                        again.append((run.task, run.tries + 1))
                    else:
                        take([row])
                wait()
        finally:
            for run in under_way:
                run.end()

    def _look_at(self, task: Task) -> None:
        """Tell that each run takes its time, and notice that the file names ports, which one run at a time can have."""
        if self._one:
            return
        with suppress(FleetError):  # the run says it
            scenario = scenario_of(task)
            nodes = (scenario.spec.nodes or {}).items()
            named = [name for name, node in nodes if _names_a_port(node)]
            named += [f"vehicle {i}" for i, its in enumerate(scenario.controls, 1) if its.gateway is not None]
            self._one = bool(named)
            if task.modules.programs and not self._told:
                self._told = True
                takes = f"each run takes {scenario.duration_ns / 1e9:g} s of wall time"
                self._tell(f"{takes}; with `clock: simulated` in the file runs are faster, and repeat")
            if named and self._given != 1:
                self._tell(f"{', '.join(named)}: the file names their ports, so there is one run at a time")

    def _count(self, run: _Run, row: Row) -> None:
        """Choose how many runs go on at a time."""
        if row.status == FAILED and not self._broken:
            self._broken = True
            self._tell(f"seed {row.seed} has no result: {row.reason}")
        self._since[0] += 1
        self._since[1] += row.status == LATE
        if self._given is None and run.cpu_share is not None:
            room = min(processors(), run.cpu_share + run.idle_share)
            self._given = self._at_once = max(1, min(MOST_AT_ONCE, int(SHARE * room / run.cpu_share)))
        runs, lates = self._since
        if runs >= ENOUGH and lates > MOST_LATE * runs:
            half = max(1, self._at_once // 2)
            rest = f"{half} at a time from now on" if half < self._at_once else "one goes on at a time already"
            self._tell(f"{lates} of {runs} runs were late, because this machine is too busy: {rest}")
            self._at_once, self._since = half, [0, 0]


def _names_a_port(node: Node) -> bool:
    modem = node.modem is not None and node.modem.where != 0
    return bool(node.udp or node.listen or node.connect or modem)


def _idle_s() -> float:
    """How long the processors have been idle since the machine started, all together."""
    times = psutil.cpu_times()
    return float(times.idle + times.iowait)


class _Run:
    """One run that goes on."""

    def __init__(self, task: Task, tries: int) -> None:
        self.task, self.tries = task, tries
        self.cpu_share: float | None = None  # processors that it took, by its result
        self.idle_share = 0.0  # processors that nobody used while it went on
        self._folder = PrivateFolder("stack")
        file = self._folder.path / f"{task.name}.yaml"
        file.write_text(task.text, "utf-8")
        self._said: IO[bytes] = (self._folder.path / "said").open("w+b")
        self._process = subprocess.Popen(
            _command(task.modules.verb, file, task.seed, self._folder.path / "runs"),
            stdin=subprocess.DEVNULL,
            stdout=self._said,
            stderr=self._said,
            cwd=task.modules.folder,
            env=os.environ | {PARENT_PID_VARIABLE: str(os.getpid())},
            start_new_session=True,
        )
        self._begun, self._idle_s = time.monotonic(), _idle_s()
        self._most_s = task.timeout_s

    @property
    def over(self) -> bool:
        if self._process.poll() is not None:
            return True
        if time.monotonic() - self._begun > self._most_s:
            self._process.terminate()  # it stops its programs
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE_S)
            self._process.kill()
            self._process.wait()
            return True
        return False

    def end(self) -> None:
        """End it at once: its keeper ends the programs."""
        self._process.kill()
        self._process.wait()
        self._said.close()
        self._folder.close()

    def row(self) -> Row:
        """What came of it. Its folder is gone then, but for the directory of a run that failed."""
        task = self.task
        try:
            scenario = scenario_of(task)
            directory = next(iter((self._folder.path / "runs").glob(f"{scenario.name}-*")), None)
            if directory is None or not (directory / RESULT).exists():
                return failed_row(task, FleetError(self._last_words()))
            result = read_result(directory)
            wall = result.wall
            if wall.cpu_s:
                self.cpu_share = wall.cpu_s / (wall.startup_s + wall.run_s)
                self.idle_share = (_idle_s() - self._idle_s) / max(1e-9, time.monotonic() - self._begun)
            if result.status is Status.BROKEN:  # as with a program that cannot be started: the network is not to blame
                return failed_row(task, FleetError(": ".join(filter(None, (result.reason, self._tail())))))
            if why := lateness(result):
                return structs.replace(failed_row(task, FleetError(f"late: {why}")), status=LATE)
            if time.monotonic() - self._begun > self._most_s and result.status is not Status.PASS:
                return failed_row(task, late(task))
            row = measured_row(result, self._samples(scenario, directory))
            row.digest = None  # on the wall clock each log is another one
            if not result.passed:
                row.reason = "; ".join(filter(None, (row.reason, self._kept(directory))))
            return row
        except (FleetError, OSError) as error:
            return failed_row(task, error)
        finally:
            self._said.close()
            self._folder.close()

    def _samples(self, scenario: Scenario, directory: Path) -> Samples:
        samples = Samples(scenario, self.task.signals)
        if self.task.signals:
            samples.read(open_log(directory, ["uuv/*/control"]))
        return samples

    def _kept(self, directory: Path) -> str:
        """Keep the directory of a run that failed; returns where it is."""
        if not self.task.keep:
            return ""
        keep = Path(self.task.keep)
        with suppress(OSError):
            keep.mkdir(parents=True, exist_ok=True)
            if sum(1 for _ in keep.iterdir()) < MOST_KEPT:
                shutil.rmtree(place := keep / run_name(self.task.point, self.task.seed), ignore_errors=True)
                return str(shutil.move(directory, place))
        return ""

    def _lines(self) -> list[str]:
        self._said.seek(0)
        return self._said.read().decode("utf-8", "replace").splitlines()

    def _tail(self) -> str:
        """The last lines of the program that ended, which are told indented."""
        return " | ".join([line.strip() for line in self._lines() if line.startswith("  ")][-2:])[:500]

    def _last_words(self) -> str:
        lines = self._lines()
        code = self._process.returncode
        return f"fleet {self.task.modules.verb} ended with status {code}: {' | '.join(lines[-3:])[:500]}"


def describe_failure(directory: Path) -> list[str]:
    """A run that failed, in words: its faults, what failed first, how its programs ended, and how to make it again."""
    try:
        result = read_result(directory)
    except (FleetError, OSError):
        return [f"  {directory}"]
    lines = [
        f"  fault from {one.at_s:g} s: {one.what} (id {one.fault})" for one in result.faults if one.action == "begins"
    ]
    failed = [verdict for verdict in result.checks if verdict.failed]
    lines += [f"  {verdict.check}: {verdict.words}" for verdict in failed[:3]]
    lines += [f"  {result.reason}"] if result.reason else []
    for ended in result.deaths.values():
        lines += [f"  {ended[0]}", *(f"    {line}" for line in ended[-3:] if line != ended[0])]
    return [*map(printable, lines), f"  {again(directory)}"]


def again(directory: Path) -> str:
    """The command that makes a run again."""
    return f"fleet netem {quote(str(directory / SCENARIO))} --trust"


def run_stack(scenario: Scenario, out: Path) -> Result:
    """Make one run of a stack, with its directory in a folder, and wait for it. A late one is made again.

    Args:
        scenario: what is run.
        out: the folder for its directory.

    Returns:
        The result.

    Raises:
        FleetError: there is no result, or it was late each time.
    """
    why = ""
    for _ in range(TRIES):
        result = _make(scenario, out)
        if not (why := lateness(result)):
            return result
    raise FleetError(f"{scenario.name} was late {TRIES} times, so it says nothing: {why}")


def lateness(result: Result) -> str:
    """How late the host of a run was, in words; empty: it was in time."""
    found = next((verdict for verdict in result.checks if verdict.check == "punctual" and verdict.failed), None)
    return "" if found is None else found.found


def _make(scenario: Scenario, out: Path) -> Result:
    with PrivateFolder("stack") as own:
        file = own / f"{scenario.name}.yaml"
        file.write_text(scenario.to_yaml(), "utf-8")
        folder = folder_of_checks([scenario], scenario.reading.folder)
        words = _command("netem" if scenario.nodes else "run", file, scenario.seed, out.resolve())
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", cwd=folder, check=False)
    directory = Path(done.stdout.strip() or "none")
    if not (directory / RESULT).exists():
        raise FleetError(f"{scenario.name} has no result: {done.stderr.strip()[-500:]}")
    result = read_result(directory)
    result.directory = directory
    return result


def _command(verb: str, file: Path, seed: int, out: Path) -> list[str]:
    words = [sys.executable, "-m", "fleet", verb, file, "--seed", seed, "--out", out, "--trust", "--quiet"]
    return [*map(str, words)]
