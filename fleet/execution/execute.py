"""One run from scenario to verdict: directory, log, the fleet or the in-process loop, result."""

from __future__ import annotations

import secrets
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass

from msgspec import convert
from rich.console import Console as Terminal

from agents.errors import AgentError
from fleet.analysis import punctuality
from fleet.analysis.first_sample import try_plants
from fleet.checks.own_checks import OwnChecks
from fleet.errors import FleetError, RunBroken, StoppedError
from fleet.execution.clock import WINDOW_NS, GrantPolicy
from fleet.execution.directory import RunDirectory
from fleet.execution.external_agents import has_gateways, refuse
from fleet.execution.hosting import Hosting, hosting
from fleet.execution.in_process import InProcess
from fleet.execution.moments import Prefix, reach
from fleet.execution.options import Options
from fleet.execution.outcome import account_for, judge_run, settle
from fleet.execution.progress import ProgressLine
from fleet.execution.registry import RegistryError, register
from fleet.execution.runner import Runner
from fleet.execution.triggered import resolve_triggers
from fleet.execution.wiring import USUAL, Wiring
from fleet.processes.interrupts import DeferInterrupts, HungUp
from fleet.processes.limits import NO_THREAD, no_thread
from fleet.processes.ports import free_port
from fleet.quantities import show_time
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile, NoLog
from fleet.recorder.start import Start
from fleet.recorder.writer import LogWriter
from fleet.replay.publisher import LivePublisher
from fleet.result.file import write_result
from fleet.result.result import Published, Result, Status, Wall
from fleet.result.timing import Punctual
from fleet.scenario.programs import admit_programs
from fleet.scenario.scenario import Scenario
from fleet.terminal.progress import showing
from fleet.terminal.status_line import StatusLine
from netem.clock import Clock
from world.errors import WorldError
from world.plugins.output import lines_go_into


@dataclass(slots=True)
class _Run:
    scenario: Scenario
    options: Options
    wiring: Wiring
    directory: RunDirectory
    publisher: LivePublisher | None
    log: LogFile | NoLog
    journal: Journal
    runner: Runner
    line: StatusLine
    result: Result
    in_process: bool
    hosting: Hosting
    wall_s: float = 0.0  # from the first process on


def execute(scenario: Scenario, options: Options, terminal: Terminal | None = None, wiring: Wiring = USUAL) -> Result:
    """Run a scenario to its verdict. Only a caller's mistake raises; a run that breaks is a result.

    Args:
        scenario: what to run. Triggers that it still has are resolved first.
        options: how the user wants to run it.
        terminal: shows progress. None stands for stderr.
        wiring: how the run is connected.

    Raises:
        ScenarioError: a plant cannot be started, or a module may not run.
        RunBroken: the port is taken.
        LogError: the log cannot be created.
        CheckError: a check in Python cannot be made.
        FleetError: making the run directory or publishing the journal fails. A gateway would start without permission.
            A run in one process has an external agent. The run that this one continues differs from its log.
    """
    scenario = resolve_triggers(scenario, wiring.start)
    if has_gateways(scenario):
        admit_programs(scenario.spec, scenario.reading.policy)
    try_plants(scenario)
    moment = None if wiring.start is None else _run_prefix(wiring.start, quiet=options.quiet)
    interrupts = DeferInterrupts()
    with interrupts.handling(), ExitStack() as while_it_lives:
        if moment is not None:
            while_it_lives.callback(moment.run.release)
        run = _prepare(scenario, options, wiring, moment, terminal or Terminal(stderr=True), interrupts, while_it_lives)
        _serve(run)
        with interrupts:  # what there is gets written, whatever comes meanwhile
            settle(run.journal, run.log, run.runner, run.result)
            _judge(run)
            _report(run)
    return run.result


def _run_prefix(start: Start, *, quiet: bool) -> Prefix:
    at = show_time(start.tick * start.legs[-1].scenario.tick_ns)
    with showing(f"running to t = {at} again", quiet=quiet) as on_progress:
        return reach(start, on_progress)


def _prepare(
    scenario: Scenario,
    options: Options,
    wiring: Wiring,
    moment: Prefix | None,
    terminal: Terminal,
    interrupts: DeferInterrupts,
    while_it_lives: ExitStack,
) -> _Run:
    """Make the run directory, the log and the journal; start the publisher, if there is one, and nothing else."""
    if scenario.nodes and wiring.relay is None:
        refuse(scenario, "a run of vehicles")
    in_process = options.in_process or scenario.ideal or wiring.start is not None
    if in_process:
        refuse(scenario, "a run in one process")
    elif options.port is not None:
        free_port(options.port)  # before anything is made
    shared = Hosting() if in_process else hosting(scenario, options.clock, wiring.rendezvous)

    # Before anything is made, too: one in Python may be wrong.
    checks = OwnChecks.from_scenario(scenario, 0 if wiring.start is None else wiring.start.tick)
    line = StatusLine(terminal, quiet=options.quiet)
    directory = while_it_lives.enter_context(closing(RunDirectory(options.out, scenario.name, scenario.seed)))
    if in_process:
        while_it_lives.enter_context(lines_go_into(directory.path / "log"))
    text = scenario.to_yaml()
    directory.write_scenario(text)
    try:
        while_it_lives.callback(register(directory).unlink, missing_ok=True)
    except RegistryError as error:
        if not in_process:  # a run in one process answers no command
            line.print(f"the run is not registered: {error}; commands find it with --run {directory.path}")
    number = (wiring.rendezvous and wiring.rendezvous.run) or secrets.token_hex(4)
    publisher = (
        LivePublisher(number, directory.observe, text, wait=options.wait_for_subscribers) if options.publish else None
    )
    log = NoLog() if scenario.spec.log.none else LogFile(directory.log)
    links = None if moment is None else moment.links
    writer = LogWriter(log, scenario, wiring.start, publisher, options.clock, links)
    if publisher is not None:
        _publish(publisher, directory, line, wiring)
    journal = Journal(scenario, writer, interrupts, checks)
    runner: Runner
    if wiring.relay is not None:
        runner = wiring.relay(scenario, directory, journal, log, number, line.print)
    elif in_process:
        runner = InProcess(scenario, journal, None if moment is None else moment.run)
    else:
        from fleet.execution.console import Console  # here, because it imports zenoh and multiprocessing

        runner = Console(scenario, directory, journal, options, wiring, shared, number, line.print)
    result = Result(
        run=directory.path.name,
        directory=directory.path,
        scenario=scenario.name,
        seed=scenario.seed,
        status=Status.PASS,
    )
    return _Run(scenario, options, wiring, directory, publisher, log, journal, runner, line, result, in_process, shared)


def _publish(publisher: LivePublisher, directory: RunDirectory, line: StatusLine, wiring: Wiring) -> None:
    """Open the publisher, and tell the user and whoever wants to know."""
    publisher.open()
    where = f"fleet/{publisher.run}/log/** at {publisher.endpoint}"
    line.print(f"publishing {where}; how to join: {directory.observe}")
    if wiring.on_published is not None:
        wiring.on_published(directory.path)


def _serve(run: _Run) -> None:
    result, began = run.result, time.monotonic()
    try:
        if run.publisher is not None and run.publisher.wait:
            run.line.print("waiting for a subscriber")
            run.publisher.wait_for_subscriber()
        began = time.monotonic()
        with run.line:
            progress = ProgressLine(run.scenario, run.journal, run.line, lambda: run.runner.waiting)
            run.runner.serve(_policy(run.scenario, run.options, run.wiring.start), progress)
    except RunBroken as error:
        result.status, result.reason, result.lines = Status.BROKEN, error.reason, error.lines
        if found := next((line.strip() for line in error.lines if NO_THREAD in line), ""):
            result.lines = [*error.lines, no_thread(found).reason]
    except StoppedError:
        result.status, result.reason = Status.INTERRUPTED, "the operator asked for it"
    except (AgentError, WorldError, FleetError) as error:
        result.status, result.reason = Status.BROKEN, str(error)
    except HungUp:
        result.status, result.reason = Status.HUNG_UP, "the terminal was closed"
    except KeyboardInterrupt:
        result.status, result.reason = Status.INTERRUPTED, "interrupted"
    except RuntimeError as error:
        if NO_THREAD not in str(error):
            raise
        result.status, result.reason = Status.BROKEN, no_thread(error).reason
    finally:
        run.wall_s = time.monotonic() - began
        if run.publisher is not None:
            run.publisher.close()


def _judge(run: _Run) -> None:
    more, result = [*run.runner.closing.verdicts], run.result
    timing = run.runner.closing.timing
    if run.scenario.nodes:
        if "late" in timing:
            result.punctual = convert(timing, Punctual)
            more.append(punctuality.punctual(result.punctual, run.scenario.spec.checks.punctual))
    elif run.options.clock is Clock.REAL:
        result.timing = punctuality.timing_of(timing, run.options.speed or 1.0)
    if result.timing is not None:
        more.append(punctuality.verdict(result.timing, run.options.max_missed))
    judge_run(run.scenario, run.journal, result, lost=run.runner.middleware_lost, more=more)


def _report(run: _Run) -> None:
    runner, result = run.runner, run.result
    wall = Wall(in_process=run.in_process, startup_s=runner.started_s, run_s=run.wall_s - runner.started_s)
    if not run.in_process:
        wall.processes, wall.per_process = run.hosting.processes_used(run.scenario)
    account_for(result, run.scenario, run.journal, run.log, runner, wall)
    if run.publisher is not None:
        result.published = Published(run.publisher.published, run.publisher.dropped)
    try:
        write_result(result, run.directory.path)
    except OSError as error:
        result.lines.append(f"result.json could not be written: {error.strerror}")
        run.directory.remove_result()


def _policy(scenario: Scenario, options: Options, start: Start | None = None) -> GrantPolicy:
    if options.clock is Clock.REAL:
        return GrantPolicy.of(scenario, options.speed or 1.0, lead_ns=WINDOW_NS)
    begin = 0 if start is None else start.tick
    # A real computer cannot go faster. The wall clock only holds the run back: its log is the same.
    speed = options.speed or (1.0 if has_gateways(scenario) else None)
    return GrantPolicy.of(scenario, speed, begin=begin)
