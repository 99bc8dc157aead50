"""A run kept in memory as arrays, without a file."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Any

import numpy as np

from agents.errors import AgentError
from fleet.errors import RunBroken
from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.recorder.journal import Journal
from fleet.recorder.metrics import VehicleError
from fleet.recorder.snapshot import Snapshot
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Event
from netem.wire.messages import Command, Fate, Frame
from world.errors import WorldError

Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(slots=True)
class Recording:
    """One run: every signal as an array (sample, vehicle, component), from t = 0, as often as the scenario logs.

    The last sample has a state and errors only; where a vehicle does not report a signal, or no longer, it is NaN.
    """

    scenario: Scenario
    t: Array  # s, shape (samples,)
    signals: dict[str, Array] = field(default_factory=dict)
    broken: str = ""  # why the run ended early; empty: it did not

    def __getitem__(self, name: str) -> Array:
        return self.signals[name]


class _Capture:
    """A sink for the journal that keeps the signals of every frame in flat arrays."""

    def __init__(self, scenario: Scenario) -> None:
        self._ids = range(1, scenario.vehicles + 1)
        self._layouts = {i: scenario.layout(i) for i in self._ids}
        self.ticks = array("d")
        self.fixed = array("d")  # per vehicle: eta, nu, e, formation
        self.tau = array("d")  # per vehicle: as applied
        self.telemetry = {i: array("d") for i in self._ids}

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        self.ticks.append(frame.tick)
        for row in frame.vehicles:
            error = errors[row.id]
            self.fixed.extend(row.eta)
            self.fixed.extend(row.nu)
            self.fixed.extend(error.e)
            self.fixed.extend(error.formation)
            if row.tau:
                self.tau.extend(row.tau)
                command = commands.get(row.id)
                size = self._layouts[row.id].size
                telemetry = () if command is None else command.telemetry
                self.telemetry[row.id].extend(telemetry if len(telemetry) == size else (nan,) * size)

    def packet(self, fate: Fate) -> None:
        """Packets are not kept."""

    def event(self, event: Event) -> None:
        """Faults are not kept."""

    def snapshot(self, snapshot: Snapshot) -> None:
        """Snapshots are not kept."""

    def recording(self, scenario: Scenario, broken: str) -> Recording:
        """The recorded samples, as arrays."""
        n, samples = len(self._ids), len(self.ticks)
        fixed = np.frombuffer(self.fixed).reshape(samples, n, 16)
        made = Recording(scenario, np.frombuffer(self.ticks) * (scenario.tick_ns / 1e9), broken=broken)
        for name, place in (
            ("eta", slice(5)),
            ("nu", slice(5, 10)),
            ("e", slice(10, 13)),
            ("formation", slice(13, 16)),
        ):
            made.signals[name] = fixed[..., place]
        made.signals["tau"] = _padded(np.frombuffer(self.tau).reshape(-1, n, 3), samples)
        for i, layout in self._layouts.items():
            values = np.frombuffer(self.telemetry[i]).reshape(-1, layout.size)
            for _, signal, place in layout.signals():
                if signal.name not in made.signals:
                    made.signals[signal.name] = np.full((samples, n, signal.width), np.nan)
                if made.signals[signal.name].shape[2] == signal.width:
                    made.signals[signal.name][: len(values), i - 1] = values[:, place]
        return made


def record(scenario: Scenario, progress: Callable[[float], None] = lambda _: None) -> Recording:
    """Run a scenario in this process.

    Args:
        progress: called with the simulated time [s] now and then.

    Returns:
        The whole run, or what there was until it broke.
    """
    capture = _Capture(scenario)
    journal = Journal(scenario, capture)
    policy = GrantPolicy.of(scenario)
    broken = ""
    next_report = 0.0

    def report() -> None:
        nonlocal next_report
        now = time.monotonic()
        if now >= next_report:
            next_report = now + 0.1
            progress(max(0, journal.written) * scenario.tick_ns / 1e9)

    try:
        InProcess(scenario, journal).serve(policy, report)
    except (AgentError, WorldError, RunBroken) as error:
        broken = str(error)
    return capture.recording(scenario, broken)


def _padded(values: Array, samples: int) -> Array:
    """The array with NaN for the samples that are missing at the end."""
    missing = samples - len(values)
    return np.concatenate([values, np.full((missing, *values.shape[1:]), np.nan)]) if missing else values
