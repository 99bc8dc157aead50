"""How a run is connected: commands and companions decide this, and no option does so by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.execution.rendezvous import Rendezvous
    from fleet.execution.runner import MakeRelay
    from fleet.recorder.start import Start


@dataclass(frozen=True, slots=True)
class Wiring:
    """From where a run goes on, how its processes meet, and who is told."""

    start: Start | None = None  # where it goes on from another run; in-process only
    start_order: Callable[[list[str]], list[str]] | None = None  # orders the roles; None: the usual order
    rendezvous: Rendezvous | None = None  # how processes on several hosts meet; None: all are on this one
    relay: MakeRelay | None = None  # makes the run of a scenario with nodes
    on_published: Callable[[Path], None] | None = None  # is told the run's directory when its journal can be read


USUAL = Wiring()  # a run from t = 0 of processes on this host, which tells nobody
