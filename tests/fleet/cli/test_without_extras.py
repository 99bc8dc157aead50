"""Commands that need no extra, where the libraries of the extra `study` are not installed."""

from __future__ import annotations

from pathlib import Path

import pytest
from one_child import in_one_child

from fleet.addons.studies.engine_interface import NEEDED

# piqp brings scipy.
WITHOUT = f"import sys; sys.modules.update(dict.fromkeys({tuple(name for name in NEEDED if name != 'scipy')}))"
ONE = ["--workers", "1"]
FAILS = """
title: Two vehicles, one of which dies
vehicles: 2
duration: 1 s
reference: {start: 0 0 5 m, velocity: 0.5 0 0 m/s}
formation: {shape: line, spacing: 8 m}
graph: {shape: path}
initial: {scatter: 0.5 m, around: reference}
network: {period: 100 ms, links: {'*': delay 100ms loss 20%}}
checks: {formation_error: {below: 1 mm, after: 500 ms}}
faults: [{at: 300 ms, kill: 2}]
"""


@pytest.mark.once
@pytest.mark.timeout(300)  # on a busy machine: four of the commands start a worker
def test_search_regress_rare_shrink_and_why_need_no_table_of_runs(tmp_path: Path) -> None:
    (tmp_path / "fails.yaml").write_text(FAILS)
    rare = ["--check", "max_age", "--set", "duration=1 s", "--set", "checks={max_age: {below: 1 s}}"]
    commands = {
        "search": (1, ["search", "fails.yaml", "--nemesis", "--budget", "1", "--keep", "kept", *ONE]),
        "again": (0, ["regress", "kept", *ONE]),
        "rare": (0, ["rare", "lossy", "--repeats", "1", "--effort", "4", *ONE, *rare]),
        "less": (0, ["shrink", "fails.yaml", "--budget", "2", *ONE]),
        "run": (1, ["run", "fails.yaml", "--in-process"]),
        "why": (0, ["why", "--budget", "1", *ONE]),
        "a study needs it": (2, ["sweep", "fails.yaml"]),
    }
    found = in_one_child([(tmp_path, arguments) for _, arguments in commands.values()], before=WITHOUT)
    assert dict(zip(commands, (done.status for done in found), strict=True)) == {
        name: status for name, (status, _) in commands.items()
    }, found
