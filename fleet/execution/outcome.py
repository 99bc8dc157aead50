"""What a run came to: its log closed, its packets accounted for, its checks judged, and all its numbers."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any

from fleet.analysis.verdicts import judge, judge_expected
from fleet.checks.verdict import Verdict
from fleet.execution.runner import Runner
from fleet.notebook import html_table
from fleet.recorder.journal import Journal, Spell
from fleet.recorder.log_file import LogError, LogFile
from fleet.recorder.no_log import NoLog
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Event
from netem.condition import Link


class Status(IntEnum):
    """Exit statuses of `fleet run`."""

    PASS = 0
    CHECK_FAILED = 1
    USAGE = 2
    BROKEN = 3
    HUNG_UP = 129
    INTERRUPTED = 130


@dataclass(slots=True, repr=False)
class Result:
    """What a run came to.

    Attributes:
        status: how it ended.
        directory: where its log is; None: it wrote none.
        digest: SHA-256 over the messages of its log, in hexadecimal; the same also if no log was written.
        reason: why it broke; empty: it did not.
        lines: what is known besides about why it broke.
        verdicts: of the checks, if it came to its end.
        values: all its numbers, as `result.json` has them.
    """

    status: Status
    directory: Path | None = None
    digest: str = ""
    reason: str = ""
    lines: list[str] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether it came to its end and every check passed."""
        return self.status is Status.PASS

    def __repr__(self) -> str:
        failed = [verdict.check for verdict in self.verdicts if not verdict.passed]
        said = f"{len(self.verdicts) - len(failed)} of {len(self.verdicts)} checks passed"
        said = self.reason or said + (f", failed: {', '.join(failed)}" if failed else "")
        return f"<Result of {self._run}: {self.status.name.lower()}; {said}>"

    def _repr_html_(self) -> str:
        rows = [(one.check, "pass" if one.passed else "FAIL", one.asked, one.found) for one in self.verdicts]
        title = f"{self._run}: {self.status.name.lower()}" + (f", {self.reason}" if self.reason else "")
        return html_table(title, ("check", "", "asked", "found"), sorted(rows, key=lambda row: row[1] == "pass"))

    @property
    def _run(self) -> str:
        return f"{self.values.get('scenario', 'a run')} with seed {self.values.get('seed', '?')}"


def settle(journal: Journal, log: LogFile | NoLog, runner: Runner, result: Result) -> None:
    """Close the log, and enter into the ledger what was still on the way."""
    _close_log(log, result)
    result.digest = log.digest
    for link, (sent, duplicated) in runner.closing.entered.items():
        journal.ledger.enter(link, sent=sent, duplicated=duplicated)
    journal.finish()


def judge_run(scenario: Scenario, journal: Journal, result: Result, *, lost: int, more: Sequence[Verdict] = ()) -> None:
    """Judge a run that came to its end.

    Args:
        lost: messages that the middleware lost.
        more: verdicts that are no checks of the scenario.
    """
    if result.status is not Status.PASS:
        return
    result.verdicts = [*judge(scenario, journal, middleware_lost=lost), *more]
    expected = judge_expected(scenario, result.verdicts)
    if expected is not None:
        result.verdicts.append(expected)
    deciding = result.verdicts if expected is None else [expected]
    if not all(verdict.passed for verdict in deciding):
        result.status = Status.CHECK_FAILED
    if lost:
        result.status = Status.BROKEN
        result.reason = f"the middleware lost {lost} messages: the run is invalid"


def _close_log(file: LogFile | NoLog, result: Result) -> None:
    try:
        file.close()
    except LogError as error:
        file.abandon()
        if result.status is Status.PASS:
            result.status, result.reason = Status.BROKEN, str(error)


def outcome_values(
    scenario: Scenario, journal: Journal, file: LogFile | NoLog, result: Result, *, lost: int
) -> dict[str, Any]:
    """Every number of a run as plain values, as result.json has them."""
    return {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "status": result.status.name.lower(),
        "exit": int(result.status),
        "reason": result.reason,
        "lines": result.lines,
        "from_s": journal.begin * scenario.tick_ns / 1e9,
        "sim_s": max(0, journal.written) * scenario.tick_ns / 1e9,
        "checks": [verdict.to_values() for verdict in result.verdicts],
        "vehicles": journal.metrics.summary(),
        "formation": journal.metrics.formation._asdict(),
        "tumbles": [_spell(spell, scenario.tick_ns / 1e9) for spell in journal.tumbles],
        "ledger": {_name(link): account.to_values() for link, account in journal.ledger.accounts.items()},
        "ages": journal.ages.summary(scenario.tick_ns),
        "middleware_lost": lost,
        "faults": [_event(event, scenario.tick_ns / 1e9) for event in journal.happened if event.is_fault],
        "events": [_event(event, scenario.tick_ns / 1e9) for event in journal.happened if not event.is_fault],
        "messages": file.messages,
        "log_bytes": file.size,
        "digest": file.digest,
        "python": sys.version.split()[0],
    }


def _event(event: Event, tick_s: float) -> dict[str, Any]:
    return {"at_s": event.tick * tick_s, "fault": event.fault, "action": event.action, "what": event.what}


def _spell(spell: Spell, tick_s: float) -> dict[str, Any]:
    until = None if spell.end is None else spell.end * tick_s
    return {"vehicle": spell.vehicle, "from_s": spell.begin * tick_s, "to_s": until}


def _name(link: Link) -> str:
    return f"{link[0]}->{link[1]}"
