"""The recorder is measured by the calls of a run, told again; what they write is that run's log."""

from __future__ import annotations

from pathlib import Path

from small_scenario import small

from fleet.bench.recorder import recorder_figures
from fleet.execution.execute import execute
from fleet.execution.options import Options


def test_what_is_measured_is_the_log_of_the_run(tmp_path: Path) -> None:
    scenario = small("duration=200 ms", "network.links={'*': 'delay 20ms loss 30%'}")
    figures = recorder_figures(scenario, tmp_path / "again.mcap")
    assert set(figures) == {"written", "written_mcap", "times_mcap"}
    assert all(value > 0 for value in figures.values())
    result = execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    assert (tmp_path / "again.mcap").read_bytes() == (result.directory / "run.mcap").read_bytes()
