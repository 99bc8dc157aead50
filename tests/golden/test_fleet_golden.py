"""Whole runs against the reference trajectories: shipped scenarios, in-process and distributed, read from their logs.

`test_golden` proves the cores in a bare loop; this proves that scenario files, lockstep, netem, codec and log
change nothing on the way.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from repository import GOLDEN

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Status
from fleet.scenario.loading import load_scenario

EVERY = "log.every=10 ticks"  # the trajectories hold every tenth sample
TOLERANCE = {"eta": 1e-6, "nu": 1e-6, "e": 1e-6, "rho": 1e-6, "cmd": 1e-6, "K": 1e-5, "x": 1e-5, "tau": 1e-4}

CASES: dict[str, tuple[str, list[str]]] = {
    "NBOC_undisturbed": ("ideal", []),
    "NBOC_disturbed": ("ideal", ["sea.disturbance=paper"]),
    "NBOC_H_undisturbed": ("ideal", ["profile=hardened"]),
    "NBOC_C_undisturbed": ("ideal", ["profile=consistent"]),
    "net_1tick_hold": ("paper", ["network.period=10 ms", "neighbours.extrapolate=hold"]),
    "net_10Hz_dr": ("paper", []),
    "net_10Hz_dr_disturbed": ("paper-disturbed", []),
    "NBOC_H_comms_10Hz_0p5s_hold": (
        "paper",
        ["profile=hardened", "neighbours.extrapolate=hold", "network.links={'*': 'delay 500ms'}", "checks={}"],
    ),
}


def signals(log: Path) -> dict[str, np.ndarray[Any, Any]]:
    """Every compared signal of a log as an array (sample, vehicle, component)."""
    rows: dict[str, dict[int, list[list[float]]]] = defaultdict(lambda: defaultdict(list))
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, m in reader.iter_decoded_messages():
            match channel.topic.split("/"):
                case ["uuv", i, "state"]:
                    rows["eta"][int(i)].append([m.x, m.y, m.z, m.theta, m.psi])
                    rows["nu"][int(i)].append([m.u, m.v, m.w, m.q, m.r])
                case ["uuv", i, "error"]:
                    rows["e"][int(i)].append(list(m.e))
                case ["uuv", i, "guidance"]:
                    rows["K"][int(i)].append(list(m.K))
                    rows["rho"][int(i)].append(list(m.rho))
                    rows["cmd"][int(i)].append([m.u_cmd, m.theta_cmd, m.psi_cmd])
                case ["uuv", i, "control"]:
                    rows["x"][int(i)].append(list(m.x))
                case ["uuv", i, "command"]:
                    rows["tau"][int(i)].append(list(m.applied))
    return {name: np.stack([np.array(of[i]) for i in sorted(of)], axis=1) for name, of in rows.items()}


def compare(log: Path, name: str) -> None:
    golden = np.load(GOLDEN / f"{name}.npz")
    found = signals(log)
    assert set(found) == set(TOLERANCE)
    for signal, tolerance in TOLERANCE.items():
        want = golden[signal][: len(found[signal])]
        assert want.shape == found[signal].shape, signal
        worst = float(np.abs(found[signal] - want).max())
        assert worst <= tolerance, f"{name}: {signal} differs by {worst:.3g}, allowed {tolerance:g}"


# The quick one has a network, and is whole; tests/golden/test_golden.py compares all trajectories in a bare loop.
QUICK = "net_10Hz_dr"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == QUICK else [pytest.mark.slow]) for name in CASES]
)
def test_in_process_run_follows_the_reference_trajectory(name: str, tmp_path: Path) -> None:
    scenario, overrides = CASES[name]
    overrides = [*overrides, "duration=20 s", "checks={}"]
    result = execute(load_scenario(scenario, [EVERY, *overrides]), Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, result.checks
    compare(result.directory / "run.mcap", name)


@pytest.mark.slow
def test_distributed_run_follows_the_reference_trajectory(tmp_path: Path) -> None:
    """One is enough: `test_same_bytes` shows that distributed and in-process logs are the same bytes."""
    result = execute(load_scenario("paper-disturbed", [EVERY]), Options(tmp_path, quiet=True))
    assert result.status is Status.PASS, (result.reason, result.lines, result.checks)
    compare(result.directory / "run.mcap", "net_10Hz_dr_disturbed")
