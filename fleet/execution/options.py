"""How a scenario is run, as opposed to what it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.analysis.punctuality import MOST_MISSED
from netem.vehicle_clock import Clock

if TYPE_CHECKING:
    from fleet.execution.runner import MakeRelay
    from fleet.hosts.rendezvous import Rendezvous
    from fleet.recorder.start import Start

JOIN_TIMEOUT_S = 300.0  # for agents that somebody else starts


@dataclass(frozen=True, slots=True)
class Options:
    """How to run. In lockstep nothing here changes a byte of the log.

    In lockstep everyone waits for everyone, and `speed` only holds the run back. With the clock `real` ticks begin by
    the wall clock, `speed` times as fast, and wait for nobody, so agents can be late.
    """

    out: Path = Path("runs")  # where the run directory is made
    in_process: bool = False
    clock: Clock = Clock.LOCKSTEP
    speed: float | None = None  # times real time; None: in lockstep as fast as it goes, else 1
    quiet: bool = False
    publish: bool = False  # the journal on zenoh, while the run goes on
    wait: bool = False  # with `publish`: begin when there is a subscriber
    on_published: Callable[[Path], None] | None = None  # is told the run's directory when its journal can be read
    port: int | None = None  # of loopback, where the run's router listens as well
    start: Start | None = None  # where it goes on from another run; in-process only
    most_missed: float = MOST_MISSED  # share of its ticks that an agent may miss in real time
    start_order: Callable[[list[str]], list[str]] | None = None  # of roles; None: the usual order
    join_timeout_s: float = JOIN_TIMEOUT_S  # how long to wait for an agent that somebody else starts
    rendezvous: Rendezvous | None = None  # how processes on several hosts meet; None: all are on this one
    relay: MakeRelay | None = None  # makes the run of a scenario with nodes
