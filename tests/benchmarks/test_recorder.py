"""The recorder is measured by the calls of a run, told again; what they write is that run's log."""

from __future__ import annotations

from pathlib import Path

from small_scenario import small

from benchmarks.recorder import Calls, recorder_figures
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter


def test_what_is_measured_is_the_log_of_the_run(tmp_path: Path) -> None:
    scenario = small("duration=200 ms", "network.links={'*': 'delay 20ms loss 30%'}")
    assert all(value > 0 for value, _ in recorder_figures(scenario).values())
    log = LogFile(tmp_path / "again.mcap")
    Calls.of(scenario).repeat(LogWriter(log, scenario))
    log.close()
    result = execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    assert (tmp_path / "again.mcap").read_bytes() == (result.directory / "run.mcap").read_bytes()
