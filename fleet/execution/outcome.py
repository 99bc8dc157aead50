"""The end of a run: its log closed, its packets accounted for, its checks judged, its result filled in."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from msgspec import convert

from fleet.analysis.verdicts import judge, judge_expected
from fleet.cores import cores, machine
from fleet.execution.notes import nothing_came
from fleet.execution.runner import Runner
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogError, LogFile, NoLog
from fleet.result.result import FaultEvent, LinkAge, Result, Status, TumbleSpell, Wall
from fleet.result.verdict import Verdict
from fleet.scenario.scenario import Scenario


def settle(journal: Journal, log: LogFile | NoLog, runner: Runner, result: Result) -> None:
    """Close the log, and enter into the ledger what was still on the way."""
    try:
        log.close()
    except LogError as error:
        log.abandon()
        if result.status is Status.PASS:
            result.status, result.reason = Status.BROKEN, str(error)
    result.digest = log.digest
    for link, (sent, duplicated) in runner.closing.entered.items():
        journal.ledger.enter(link, sent=sent, duplicated=duplicated)
    journal.finish()


def judge_run(scenario: Scenario, journal: Journal, result: Result, *, lost: int, more: Sequence[Verdict] = ()) -> None:
    """Judge a run at its end.

    Args:
        scenario: what was run.
        journal: what was recorded.
        result: takes the verdicts and the status.
        lost: number of messages that the middleware lost.
        more: verdicts that are no checks of the scenario.
    """
    if result.status is not Status.PASS:
        return
    result.checks = [*judge(scenario, journal, middleware_lost=lost), *more]
    expected = judge_expected(scenario, result.checks)
    if expected is not None:
        result.checks.append(expected)
    deciding = result.checks if expected is None else [expected]
    if not all(verdict.passed for verdict in deciding):
        result.status = Status.CHECK_FAILED
    if lost:
        result.status = Status.BROKEN
        result.reason = f"the middleware lost {lost} messages: the run is invalid"


def account_for(
    result: Result, scenario: Scenario, journal: Journal, file: LogFile | NoLog, runner: Runner, wall: Wall
) -> None:
    """Enter every number of a run into its result. How many times real time it went is computed here."""

    def seconds(tick: int) -> float:
        return tick * scenario.tick_ns / 1e9

    def rows(*, faults: bool) -> list[FaultEvent]:
        events = [event for event in journal.happened if event.is_fault is faults]
        return [FaultEvent(seconds(event.tick), event.fault, event.action, event.what) for event in events]

    result.exit = result.status.exit
    result.from_s = seconds(journal.begin)
    result.sim_s = seconds(max(0, journal.written))
    result.vehicles = journal.metrics.summary()
    result.formation = journal.metrics.formation
    result.tumbles = [
        TumbleSpell(spell.vehicle, seconds(spell.begin), None if spell.end is None else seconds(spell.end))
        for spell in journal.tumbles
    ]
    result.ledger = {scenario.link_name(link): one.ordered for link, one in journal.ledger.accounts.items()}
    result.ages = convert(journal.ages.summary(scenario.tick_ns, scenario.link_name), dict[str, LinkAge])
    result.middleware_lost = runner.middleware_lost
    result.faults, result.events = rows(faults=True), rows(faults=False)
    result.messages, result.log_bytes, result.digest = file.messages, file.size, file.digest
    result.python = sys.version.split()[0]
    wall.cores, wall.machine = cores(), machine()
    wall.x_real_time = (result.sim_s - result.from_s) / max(1e-9, wall.run_s)
    wall.cpu_s = runner.closing.cpu_s
    result.wall = wall
    result.rejected = runner.closing.rejected
    result.deaths = {str(i): how for i, how in runner.deaths.items()}
    silent = _silent(scenario, journal)
    result.notes = [*runner.notes, *([nothing_came(silent)] if silent else [])]


def _silent(scenario: Scenario, journal: Journal) -> list[str]:
    """The nodes in simulated time that sent nothing. The relay tells those of the wall clock."""
    speak = {src for (src, _), account in journal.ledger.accounts.items() if account.sent}
    return [name for i, name in enumerate(scenario.spec.names or (), start=1) if i not in speak]
