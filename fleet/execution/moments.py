"""A moment of a run, reached by running to it in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from agents.errors import AgentError
from fleet.errors import FleetError, RunBroken
from fleet.execution.in_process import InProcess, start_in_process
from fleet.quantities import show_time
from fleet.recorder.journal import JournalSink
from fleet.recorder.metrics import VehicleError
from fleet.recorder.scene.messages import LinkHistories
from fleet.recorder.start import Leg, Start
from fleet.recorder.writer import LogWriter
from fleet.scenario.sections.timeline import Event
from netem.wire.messages import Command, Fate, Frame
from world.errors import WorldError


class Prefix(NamedTuple):
    """A run before a tick, from which one other run goes on; it is used up then."""

    run: InProcess
    links: LinkHistories


class _Unrecorded:
    """A sink of the journal that only follows what a log would draw of the links."""

    def __init__(self, links: LinkHistories) -> None:
        self.links = links

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None: ...
    def event(self, event: Event) -> None: ...

    def packet(self, fate: Fate) -> None:
        self.links.settle(fate)


def reach(start: Start, on_progress: Callable[[float], None] = lambda share: None) -> Prefix:
    """Run to where another run begins.

    Args:
        start: the moment.
        on_progress: called with the share of the way that is done.

    Raises:
        FleetError: the way there broke, or it is not that of the log.
    """
    moment: Prefix | None = None
    for leg in start.legs:
        moment = _run_leg(leg, moment, start if leg is start.legs[-1] else None, lambda k: on_progress(k / start.tick))
    assert moment is not None
    return moment


def _run_leg(leg: Leg, before: Prefix | None, start: Start | None, on_progress: Callable[[int], None]) -> Prefix:
    """Go on from a moment to the end of a leg. `start`: whose last leg it is."""
    scenario = leg.scenario
    links = LinkHistories(scenario.graph.links) if before is None else before.links
    log: JournalSink = _Unrecorded(links)
    if start is not None and start.recorded is not None:
        log = writer = LogWriter(start.recorded(), scenario, start.before, links=links)
        links = writer.links
    run = start_in_process(scenario, log, None if before is None else before.run, salt=leg.salt, judged=False)
    try:
        run.begin()
        while run.granted < leg.until:
            run.advance(min(run.granted + scenario.round_ticks, leg.until))
            on_progress(run.granted)
        run.write_up()
    except (AgentError, WorldError, RunBroken) as error:
        run.release()
        at = show_time(leg.until * scenario.tick_ns)
        raise FleetError(f"{scenario.name}, run again to t = {at}, breaks on the way: {error}") from None
    except BaseException:
        run.release()
        raise
    return Prefix(run, links)
