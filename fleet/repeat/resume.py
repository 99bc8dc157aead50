"""`fleet run --from LOG@TIME`: a whole fleet goes on from a recorded moment, closed loop, changed or not.

The recorded run is made once more up to that moment, and every message on the way is compared with the log. So what
follows continues that run. Without changes it is that of the log to the last bit. With changes every agent keeps its
memory as long as it is set up as before; otherwise it begins anew, as after a restart, and a note says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fleet.errors import FleetError
from fleet.mcap.reader import OnProgress, digest
from fleet.quantities import QuantityError, show_time, time_ns
from fleet.recorder.start import Leg, Start, set_up_otherwise
from fleet.repeat.recorded_run import Recorded
from fleet.repeat.recorded_run import read_recorded_run as read
from fleet.repeat.verify import Proof, as_it_was, start_of
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.log_rates import moment_grid
from fleet.scenario.text.fault_words import read_fault
from fleet.scenario.text.overrides import FAULT, Override
from fleet.scenario.trust import Policy


def parse_from(text: str) -> tuple[Path, int | None]:
    """`LOG@20s`, or `LOG` for its end. Raises FleetError if the time is none."""
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
    on_progress: OnProgress = lambda _: None,
) -> tuple[Scenario, Start]:
    """The scenario that goes on, and where.

    Args:
        path: of the log, or of its run directory.
        at_ns: the moment; None: the end of the log.
        overrides: changes, as for `fleet run --set`.
        name: of another scenario than the log's own.
        on_progress: called with the share of the log that was read, twice from its beginning.

    Raises:
        FleetError: there is no log of ours, or it has no such moment, or the changes are too great to go on from it.
        ScenarioError: the scenario is wrong, or that of the log does not run here.
    """
    source = read(path, on_progress)
    source.insist_on_lockstep(
        "nothing can go on from there", f"fleet netem {source.path.parent / 'scenario.yaml'} begins anew"
    )
    if external := source.script().external:
        vehicles = ", ".join(map(str, external))
        raise FleetError(
            f"vehicle {vehicles} is external in {source.path}: what its agent remembers is its own affair and not in "
            "the log, so nothing can go on from there"
        )
    before, recorded = start_of(source), as_it_was(source)
    scenario = source.script(overrides, Policy()) if name is None else load_scenario(name, overrides)
    tick = _tick(source, recorded, at_ns, 0 if before is None else before.tick)
    at = show_time(tick * recorded.tick_ns)
    _check(scenario, recorded, overrides, tick)
    notes = [f"goes on from t = {at} of {source.path}"]
    if at_ns is not None and at_ns != tick * recorded.tick_ns:
        notes[0] += f", the last round with a frame before {show_time(at_ns)}"
    legs = (*(() if before is None else before.legs), Leg(recorded, tick))
    if anew := [i for i in range(1, scenario.vehicles + 1) if set_up_otherwise(scenario, recorded, i)]:
        notes.append(f"set up otherwise: agents {', '.join(map(str, anew))} begin without memory")
    named = f"{source.path}, digest {digest(source.path, on_progress)}"
    return scenario, Start(legs, named, tuple(notes), lambda: Proof(source, recorded, before))


def _tick(source: Recorded, recorded: Scenario, at_ns: int | None, first: int) -> int:
    """The last tick up to a time at which a run can go on: a round with a frame."""
    last_ns = min(source.last_ns, recorded.duration_ns)
    if at_ns is not None and at_ns > last_ns:
        raise FleetError(
            f"{source.path} ends at {show_time(max(0, last_ns))}, got {show_time(at_ns)}: give a time in it"
        )
    grid = moment_grid(recorded.spec)
    tick = (last_ns if at_ns is None else at_ns) // recorded.tick_ns // grid * grid
    if tick <= first:
        begin, least = (show_time(k * recorded.tick_ns) for k in (first, first + grid))
        raise FleetError(f"{source.path} begins at {begin}: the first moment to go on from is {least}")
    return tick


def _check(scenario: Scenario, recorded: Scenario, overrides: Sequence[str | Override], tick: int) -> None:
    """Raises FleetError: a change is too great to go on from a tick."""
    at = show_time(tick * recorded.tick_ns)
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
        if override.option == FAULT and time_ns(read_fault(override.text)["at"]) < tick * recorded.tick_ns:
            raise FleetError(f"{override.name}: it begins before t = {at}, from which the run goes on")
    if scenario.ticks <= tick:
        raise FleetError(
            f"the run would be over before t = {at}, from which it goes on: give an earlier moment, as in LOG@20s, or "
            "a longer --duration"
        )
