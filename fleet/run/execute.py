"""One run from scenario to verdict: directory, log, the fleet or the in-process loop, result."""

from __future__ import annotations

import secrets
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any

from rich.console import Console as Terminal

from agents.errors import AgentError
from fleet.analysis import punctuality
from fleet.analysis.punctuality import MOST_MISSED
from fleet.analysis.verdicts import Verdict, judge, judge_expected
from fleet.errors import RunBroken, StoppedError
from fleet.hosts.rendezvous import Rendezvous
from fleet.processes.interrupts import DeferInterrupts, HungUp
from fleet.processes.ports import free_port
from fleet.recorder.journal import Journal, Spell
from fleet.recorder.snapshot import Start
from fleet.recorder.writer import LogError, LogWriter
from fleet.replay.publisher import LivePublisher, PublishError
from fleet.run.clock import WINDOW_NS, Clock
from fleet.run.console import JOIN_TIMEOUT_S, Console
from fleet.run.directory import RunDirectory
from fleet.run.external_agents import ExternalError, refuse
from fleet.run.in_process import InProcess
from fleet.run.progress import ProgressLine
from fleet.scenario.scenario import Scenario, frame_every
from netem.condition import Link
from world.errors import WorldError


class Status(IntEnum):
    """Exit statuses of `fleet run`."""

    PASS = 0
    CHECK_FAILED = 1
    USAGE = 2
    BROKEN = 3
    HUNG_UP = 129
    INTERRUPTED = 130


@dataclass(slots=True)
class Result:
    """What a run came to."""

    status: Status
    directory: Path
    digest: str
    reason: str = ""
    lines: list[str] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Options:
    """How to run, as opposed to what: nothing here may change a byte of the log."""

    out: Path = Path("runs")
    in_process: bool = False
    speed: float | None = None
    quiet: bool = False
    publish: bool = False
    wait: bool = False  # with `publish`: begin when somebody listens
    port: int | None = None
    start: Start | None = None  # where it goes on from another run; in-process only
    pace: float | None = None  # on a wall clock, so many times as fast as real; None: in lockstep
    most_missed: float = MOST_MISSED  # share of its ticks that an agent may miss on a wall clock
    start_order: Callable[[list[str]], list[str]] | None = None
    audit: bool = False  # tell also which messages the router refuses
    join_timeout_s: float = JOIN_TIMEOUT_S  # how long to wait for an agent that somebody else starts
    rendezvous: Rendezvous | None = None  # how processes on several hosts meet; None: all on this one


def execute(scenario: Scenario, options: Options, terminal: Terminal | None = None) -> Result:
    """Run a scenario to its verdict. Only a caller's mistake raises; a run that breaks is a result.

    Raises:
        RunDirectoryError: the run directory cannot be made or written.
        LogError: the log cannot be created.
        PublishError: the journal was to be published and cannot be.
        RunBroken: the port is taken.
        ExternalError: somebody else is to start an agent, and the run is to be one process.
    """
    whole = DeferInterrupts()
    with whole.guarding():
        return _execute(scenario, options, terminal or Terminal(stderr=True), whole)


def _execute(scenario: Scenario, options: Options, terminal: Terminal, whole: DeferInterrupts) -> Result:
    in_process = options.in_process or scenario.ideal or options.start is not None
    if in_process:
        refuse(scenario, "a run in one process")
    elif options.port is not None:
        free_port(options.port)  # before anything is made

    def say(text: str) -> None:
        if not options.quiet:
            terminal.print(text, highlight=False, markup=False, soft_wrap=True)

    directory = RunDirectory(options.out, scenario.name, scenario.seed)
    directory.write_scenario(scenario.to_yaml())
    run = (options.rendezvous and options.rendezvous.run) or secrets.token_hex(4)
    publisher = LivePublisher(run, directory.observe, wait=options.wait) if options.publish else None
    log = LogWriter(directory.log, scenario, options.start, publisher, lockstep=options.pace is None)
    if publisher is not None:
        publisher.open()
        say(f"publishing fleet/{run}/log/** at {publisher.endpoint}; how to join: {directory.observe}")
    journal = Journal(scenario, log, whole)
    clock = _clock(scenario, options)
    fleet: InProcess | Console
    if in_process:
        fleet = InProcess(scenario, journal, options.start)
    else:
        fleet = Console(
            scenario,
            directory,
            journal,
            run=run,
            port=options.port,
            audit=options.audit,
            start_order=options.start_order,
            pace=options.pace,
            rendezvous=options.rendezvous,
            join_timeout_s=options.join_timeout_s,
            say=say,
        )
    result = Result(Status.PASS, directory.path, "")
    closing: dict[str, Any] = {"entered": {}, "rejected": {}}
    began = time.monotonic()
    try:
        if publisher is not None and options.wait:
            say("waiting for a subscriber")
            publisher.heard()
            began = time.monotonic()
        with ProgressLine(
            scenario, journal, terminal, quiet=options.quiet, waiting=lambda: getattr(fleet, "waiting", "")
        ) as progress:
            closing = fleet.serve(clock, progress)
    except RunBroken as error:
        result.status, result.reason, result.lines = Status.BROKEN, error.reason, error.lines
    except (AgentError, WorldError, PublishError, ExternalError) as error:
        result.status, result.reason = Status.BROKEN, str(error)
    except LogError as error:
        result.status, result.reason = Status.BROKEN, str(error)
    except HungUp:
        result.status, result.reason = Status.HUNG_UP, "the terminal was closed"
    except KeyboardInterrupt:
        result.status, result.reason = Status.INTERRUPTED, "interrupted"
    except StoppedError:
        result.status, result.reason = Status.INTERRUPTED, "stopped by the operator"
    finally:
        wall_s = time.monotonic() - began
        if publisher is not None:
            publisher.close()
    with whole:  # what there is gets written, whatever comes meanwhile
        _close_log(log, result)
        for link, (sent, duplicated) in closing["entered"].items():
            journal.ledger.enter(link, sent=sent, duplicated=duplicated)
        journal.finish()
        if result.status is Status.PASS:
            result.verdicts = judge(scenario, journal, middleware_lost=fleet.middleware_lost)
            if options.pace is not None:
                result.verdicts.append(punctuality.verdict(closing["timing"], options.most_missed))
            expected = judge_expected(scenario, result.verdicts)
            if expected is not None:
                result.verdicts.append(expected)
            deciding = result.verdicts if expected is None else [expected]
            if not all(verdict.passed for verdict in deciding):
                result.status = Status.CHECK_FAILED
            if fleet.middleware_lost:
                result.status = Status.BROKEN
                result.reason = f"the middleware lost {fleet.middleware_lost} messages: the run is invalid"
        result.digest = log.digest
        started_s = getattr(fleet, "started_s", 0.0)
        result.values = _values(scenario, journal, log, result, fleet.middleware_lost)
        result.values["wall"] = {
            "in_process": in_process,
            "startup_s": started_s,
            "run_s": wall_s - started_s,
            "x_real_time": max(0, journal.written) * scenario.tick_ns / 1e9 / max(1e-9, wall_s - started_s),
        }
        if publisher is not None:
            result.values["published"] = {"messages": publisher.published, "dropped": publisher.dropped}
        if options.pace is not None and (measured := closing.get("timing") or getattr(fleet, "timing", {})):
            name, reasons = punctuality.label(measured)
            result.values["timing"] = {"clock": "real", "speed": options.pace, "label": name, "reasons": reasons}
            result.values["timing"] |= measured
        result.values["rejected"] = closing["rejected"]
        result.values["deaths"] = {str(i): how for i, how in fleet.deaths.items()}
        result.values["notes"] = list(getattr(fleet, "notes", ()))
        try:
            directory.write_result(result.values)
        except OSError as error:
            result.lines.append(f"result.json could not be written: {error.strerror}")
            directory.remove_result()
    return result


def _clock(scenario: Scenario, options: Options) -> Clock:
    speed, lead_ns = (options.speed, 0) if options.pace is None else (options.pace, WINDOW_NS)
    return Clock(scenario.ticks, scenario.tick_ns, scenario.round_ticks, frame_every(scenario), speed, lead_ns)


def _close_log(log: LogWriter, result: Result) -> None:
    try:
        log.close()
    except LogError as error:
        log.abandon()
        if result.status is Status.PASS:
            result.status, result.reason = Status.BROKEN, str(error)


def _values(scenario: Scenario, journal: Journal, log: LogWriter, result: Result, lost: int) -> dict[str, Any]:
    return {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "status": result.status.name.lower(),
        "exit": int(result.status),
        "reason": result.reason,
        "lines": result.lines,
        "sim_s": max(0, journal.written) * scenario.tick_ns / 1e9,
        "checks": [verdict.to_values() for verdict in result.verdicts],
        "vehicles": journal.metrics.summary(),
        "formation": journal.metrics.formation._asdict(),
        "tumbles": [_spell(spell, scenario.tick_ns / 1e9) for spell in journal.tumbles],
        "ledger": {_name(link): account.to_values() for link, account in journal.ledger.accounts.items()},
        "ages": journal.ages.summary(scenario.tick_ns),
        "middleware_lost": lost,
        "faults": [
            {
                "at_s": event.tick * scenario.tick_ns / 1e9,
                "fault": event.fault,
                "action": event.action,
                "what": event.what,
            }
            for event in journal.happened
        ],
        "messages": log.messages,
        "log_bytes": log.size,
        "digest": log.digest,
        "python": sys.version.split()[0],
    }


def _spell(spell: Spell, tick_s: float) -> dict[str, Any]:
    until = None if spell.end is None else spell.end * tick_s
    return {"vehicle": spell.vehicle, "from_s": spell.begin * tick_s, "to_s": until}


def _name(link: Link) -> str:
    return f"{link[0]}->{link[1]}"
