"""Fleets with every mode of an agent decide as they did: all that agents report, against stored numbers.

`WRITE_AGENTS=1 pytest tests/agents/test_agents_golden.py` writes the numbers anew, after a change that is meant.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from ranged import DYING, UNSURE
from repository import ROOT

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.logs.open_log import open_log
from fleet.scenario.loading import load_scenario

GOLDEN = ROOT / "tests" / "expected" / "agents.json"
CASES = {
    "locate-consistent": ["duration=6 s", *DYING],
    "locate-compass": ["duration=5 s", "faults.1.at=2 s", *UNSURE],
    "mirror-image-turn": ["duration=6 s"],
    "leader-lost-standby": ["duration=6 s", "faults.1.at=1 s"],
    "crossing": ["duration=3 s", "keep_apart.distance=25 m"],
    "helix": ["duration=3 s"],
    "rough-sea": [
        "duration=3 s",
        "per_vehicle={2: {controller: bsmc}, 3: {controller: boc}}",
        "network.payload=compact",
    ],
}


@pytest.mark.parametrize("name", CASES)
def test_it_decides_as_it_did(name: str, tmp_path: Path) -> None:
    scenario = load_scenario(name, ["checks={tumbled: waived}", *CASES[name]])
    log = open_log(execute(scenario, Options(tmp_path, in_process=True, quiet=True)).directory)
    ours = {}
    for topic in (topic for topic in log if topic.startswith("uuv/") and len(log[topic])):
        for field in log[topic].fields:
            values = np.asarray(log[topic][field])
            if values.dtype.kind in "fiu":
                flat = np.nan_to_num(values.astype(float)).reshape(len(values), -1)
                ours[f"{topic}.{field}"] = [
                    *flat.mean(axis=0).tolist(),
                    *flat[len(flat) // 2].tolist(),
                    *flat[-1].tolist(),
                ]
    golden = json.loads(GOLDEN.read_text("utf-8")) if GOLDEN.exists() else {}
    if os.environ.get("WRITE_AGENTS"):
        golden[name] = {key: [float(f"{value:.9g}") for value in values] for key, values in ours.items()}
        GOLDEN.write_text(json.dumps(golden, separators=(",", ":")).replace('],"', '],\n"') + "\n", "utf-8")
    assert ours.keys() == golden[name].keys()
    for key, values in ours.items():
        assert values == pytest.approx(golden[name][key], rel=1e-6, abs=1e-7), key
