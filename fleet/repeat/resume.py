"""`fleet run --from LOG@TIME`: a whole fleet goes on from a recorded moment, closed loop, changed or not.

Without changes the rest is that of the log to the last bit. With changes every agent keeps its memory as long as it
runs the same laws and hears the same neighbours; otherwise it begins anew, as after a restart, and a note says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from agents.controllers import laws
from fleet.errors import FleetError
from fleet.logs.reader import LogReader, Tell, digest, log_path
from fleet.logs.schemas import ANEW, FROM, START
from fleet.quantities import QuantityError, show_time, time_ns
from fleet.recorder.snapshot import Snapshot, Start, find
from fleet.repeat.recorded_run import recorded as read
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.fault_words import read_fault
from fleet.scenario.text.overrides import FAULT, Override
from fleet.scenario.trust import Policy


def parse_from(text: str) -> tuple[Path, int | None]:
    """`LOG@20s`, or `LOG` for its last snapshot. Raises FleetError if the time is none."""
    path, at, time = text.rpartition("@")
    if not at:
        return Path(text), None
    try:
        return Path(path), time_ns(time.strip())
    except QuantityError as error:
        raise FleetError(f"--from {text}: {error}; write a log and a time, as in runs/latest@20s") from None


def continuation(
    path: Path,
    at_ns: int | None,
    overrides: Sequence[str | Override] = (),
    name: str | None = None,
    tell: Tell = lambda _: None,
) -> tuple[Scenario, Start]:
    """The scenario that goes on, and where. `name`: of another scenario than the log's own. `tell`: called with the
    share of the log that was read, three times from its beginning. Raises FleetError if there is no log of ours, or the
    scenario is wrong; the log has no such moment, or the changes are too great to go on from it.
    """
    source = read(path, tell)
    recorded = source.script()
    scenario = source.script(overrides, Policy()) if name is None else load_scenario(name, overrides)
    if recorded.external:
        vehicles = ", ".join(map(str, recorded.external))
        raise FleetError(
            f"vehicle {vehicles} is external in {source.path}: what its agent remembers is its own affair and not in "
            "the log, so nothing can go on from there"
        )
    if at_ns is not None and at_ns > recorded.duration_ns:
        raise FleetError(
            f"{source.path} ends at {show_time(recorded.duration_ns)}, got {show_time(at_ns)}; without @TIME the run "
            "goes on from the last snapshot"
        )
    snapshot = find(path, at_ns, tell)
    at = show_time(snapshot.tick * recorded.tick_ns)
    for what, ours, theirs in (
        ("the number of vehicles", scenario.vehicles, recorded.vehicles),
        ("the tick", scenario.tick_ns, recorded.tick_ns),
        ("the round period", scenario.round_ticks, recorded.round_ticks),
        ("the links of the graph", scenario.graph.links, recorded.graph.links),
        ("the kind of network", scenario.acoustic is None, recorded.acoustic is None),
    ):
        if ours != theirs:
            raise FleetError(f"{what} cannot change in a run that goes on from t = {at}: leave it, or run anew with it")
    for override in map(Override.of, overrides):
        if override.option == FAULT and time_ns(read_fault(override.text)["at"]) < snapshot.tick * recorded.tick_ns:
            raise FleetError(f"{override.name}: it begins before t = {at}, from which the run goes on")
    if scenario.ticks <= snapshot.tick:
        raise FleetError(f"the run would be over before t = {at}, from which it goes on")
    notes = [f"goes on from t = {at} of {log_path(path)}"]
    if at_ns is not None and at_ns != snapshot.tick * recorded.tick_ns:
        notes[0] += f", its last snapshot before {show_time(at_ns)}"
    pairs = enumerate(zip(scenario.controls, recorded.controls, strict=True), start=1)
    anew = [i for i, (now, before) in pairs if laws(now) != laws(before)]
    if anew:
        notes.append(f"other laws: agents {', '.join(map(str, anew))} begin without memory")
    return scenario, Start(
        snapshot, f"{log_path(path)}, digest {digest(log_path(path), tell)}", tuple(anew), tuple(notes)
    )


def start_of(reader: LogReader) -> Start | None:
    """Where the run of a log that was read began, if it went on from another. Raises FleetError if the log does not
    hold it whole.
    """
    data = reader.attachments.get(START)
    if data is None:
        return None
    run = reader.metadata.get("run", {})
    anew = tuple(int(i) for i in run.get(ANEW, "").split() if i.isdecimal())
    return Start(Snapshot.from_bytes(data), run.get(FROM, ""), anew)
