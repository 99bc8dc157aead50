"""`fleet export --scenario`: a log as a scenario that runs the same again, whatever was injected while it was made."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fleet.errors import FleetError
from fleet.logs.decoder import Decoder
from fleet.logs.fault_intervals import FaultMessage, fault_message
from fleet.logs.schemas import CLOCK, FAULT, FROM, NODES, node_names
from fleet.mcap.reader import LogReader, OnProgress, Record, log_path
from fleet.quantities import show_time
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import EVERY, Recovery, SignalCheck
from fleet.scenario.sections.fault_entry import is_fault, values_of
from fleet.scenario.sections.node_names import values_to_names
from fleet.scenario.text.fault_words import FaultWordsError, read_fault
from fleet.scenario.text.overrides import Override
from fleet.scenario.trust import READING, Policy, ran_from
from netem.clock import Clock
from netem.limits import LOG_FAULTS


@dataclass(frozen=True, slots=True)
class Recorded:
    """The run of a log: its scenario, the faults that happened, and when it ended."""

    path: Path
    reader: LogReader  # the reader has read the whole log
    text: str  # the scenario that stands in it
    events: list[tuple[int, FaultMessage]]  # (time [ns], message) of the topic `faults`
    last_ns: int  # time of the last message; -1 without any

    def insist_on_lockstep(self, what: str, instead: str) -> None:
        """Refuse a log of a run on a wall clock.

        Args:
            what: is not possible with it.
            instead: what is, with programs that are not ours.

        Raises:
            FleetError: the log is such a one.
        """
        about = self.reader.metadata.get("run", {})
        if NODES in about:
            raise FleetError(f"{self.path} holds what programs of others sent on a wall clock, so {what}; {instead}")
        if about.get(CLOCK) == Clock.REAL:
            raise FleetError(
                f"{self.path} was recorded with --clock real: when each agent answered was the machine's affair, so "
                f"{what}; in lockstep it can be repeated: fleet export {self.path} --scenario > again.yaml"
            )

    @property
    def goes_on(self) -> bool:
        """Whether its run went on from another."""
        return FROM in self.reader.metadata.get("run", {})

    def script(self, overrides: Sequence[str | Override] = (), policy: Policy = READING) -> Scenario:
        """The scenario, its faults taken from what happened, with overrides as for `fleet run --set`. `policy`: which
        modules of laws may be imported for it; by itself none. Raises ScenarioError if it is none for this version, or
        an override is wrong; FleetError if a fault that happened is none for this version.
        """
        policy = replace(policy, own=ran_from(self.text))
        if self.goes_on:
            # Gone on from another run, in one process: nothing was injected, and what was before is not in this log.
            return parse_scenario(self.text, str(self.path), overrides, policy=policy)
        return rerun(self.path, self.text, self.events, self.last_ns, overrides, policy)


def read_recorded_run(path: Path, on_progress: OnProgress = lambda _: None) -> Recorded:
    """Read a log. Raises LogReadError if there is no log to read; FleetError if it holds no scenario of ours."""
    path = log_path(path)
    reader = LogReader(path, on_progress)
    happened: list[Record] = []
    held = 0
    for record in reader.of(["faults"]):
        happened.append(record)
        held += len(record.data)
        if len(happened) > LOG_FAULTS.items or held > LOG_FAULTS.bytes:
            raise FleetError(
                f"{path} holds more than {LOG_FAULTS.items} events of faults, or {LOG_FAULTS.bytes} bytes of them: "
                "that is no run"
            )
    attached = _attached_scenario(path, reader)
    decode = Decoder(reader)
    names = node_names(reader.metadata.get("run", {}))
    events = [(record.log_ns, fault_message(decode.ours(record, FAULT), names)) for record in happened]
    ours = [(at_ns, event) for at_ns, event in events if event is not None]
    return Recorded(path, reader, attached, ours, reader.last_ns)


def script(path: Path, on_progress: OnProgress = lambda _: None) -> Scenario:
    """The scenario of a log, its faults taken from what happened. Raises LogReadError if there is no log to read;
    FleetError if it holds no scenario of ours.
    """
    return read_recorded_run(path, on_progress).script()


def _attached_scenario(path: Path, reader: LogReader) -> str:
    data = reader.attachments.get("scenario.yaml")
    if data is None:
        foreign = ": it was not written by fleet run, so there is nothing to judge or to repeat"
        because = f" ({reader.missing})" if reader.missing else f"{foreign}; fleet info and fleet plot show what it has"
        raise FleetError(f"{path} holds no scenario{because}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise FleetError(f"{path} holds a scenario that is no text") from None


def rerun(
    path: Path,
    text: str,
    happened: list[tuple[int, FaultMessage]],
    last_ns: int,
    overrides: Sequence[str | Override] = (),
    policy: Policy = READING,
) -> Scenario:
    """The scenario that gives what happened up to a time; `text` is what the log calls its scenario. Raises
    ScenarioError if that is none for this version, or an override is wrong; FleetError of a fault that is none for it.
    """
    planned = parse_scenario(text, str(path))
    end_ns = planned.ticks * planned.tick_ns
    try:
        faults = _entries(happened, end_ns, planned.nodes)
    except FaultWordsError as error:
        raise FleetError(f"{path} tells of a fault that is none: {error}") from None
    if last_ns < end_ns:
        faults = _with_plans(faults, planned)
    ended = {str(entry["id"]) for entry in faults if "for" in entry}
    more = [*_recoveries(planned, ended), *overrides]
    again = _drop_faults(text.splitlines()) + _faults_yaml(faults)
    return parse_scenario(again, str(path), more, policy=policy)


def _recoveries(planned: Scenario, ended: set[str]) -> list[str]:
    """The checks of recovery without those from a fault that the run did not see end, which a scenario must not ask."""
    section = planned.spec.checks
    changes = []
    for key in ("recovery_time", "signal"):
        checks: list[Recovery | SignalCheck] = getattr(section, key) or []
        kept = [
            check.model_dump(exclude_none=True, exclude_defaults=True)
            for check in checks
            if check.fault in {*ended, EVERY, None}
        ]
        if len(kept) < len(checks):
            changes.append(f"checks.{key}={json.dumps(kept)}")
    return changes


def _entries(events: list[tuple[int, FaultMessage]], end_ns: int, names: Sequence[str]) -> list[dict[str, Any]]:
    entries: dict[str, dict[str, Any]] = {}
    for at_ns, event in events:
        if not is_fault(event.entry) or event.what.startswith("lost "):
            continue  # a loss happens again by itself; only older logs have such events
        if event.action == "begins":
            values = values_to_names(values_of(event.entry), names) or read_fault(event.what)
            entries[event.fault] = {"id": event.fault, "at": show_time(at_ns), **values, "_at": at_ns}
        elif event.fault in entries and at_ns < end_ns:
            entries[event.fault]["for"] = show_time(at_ns - entries[event.fault]["_at"])
    return [{key: value for key, value in entry.items() if key != "_at"} for entry in entries.values()]


def _with_plans(faults: list[dict[str, Any]], scenario: Scenario) -> list[dict[str, Any]]:
    """The same for a run that was stopped: what has not begun, or not ended, stays as it was planned."""
    planned = {
        section.id or f"f{number}": section.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True)
        for number, section in enumerate(scenario.spec.faults, start=1)
    }
    found = [
        entry | {"for": planned[entry["id"]]["for"]}
        if "for" not in entry and "for" in planned.get(entry["id"], {})
        else entry
        for entry in faults
    ]
    begun = {entry["id"] for entry in faults}
    return found + [{**plan, "id": name} for name, plan in planned.items() if name not in begun]


def _faults_yaml(faults: list[dict[str, Any]]) -> str:
    # JSON is YAML, and quotes what needs quoting.
    return "".join(["\nfaults:\n", *(f"  - {json.dumps(entry)}\n" for entry in faults)]) if faults else "\n"


def _drop_faults(lines: list[str]) -> str:
    kept: list[str] = []
    inside = False
    for line in lines:
        if line and not line.startswith((" ", "#")):
            inside = line.startswith("faults:")
        if not inside:
            kept.append(line)
    return "\n".join(kept) + "\n"
