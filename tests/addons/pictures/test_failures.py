"""The moments at which checks failed, in pictures and in the report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from small_scenario import small

from fleet.addons.pictures import gallery
from fleet.addons.pictures.axes import MOST_MARKS
from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.exchange import spacetime
from fleet.addons.pictures.runs import View, load
from fleet.execution.execute import execute
from fleet.execution.options import Options

CHECKS = [
    f"{{name: c{k}, topic: state.x, never: true, above: 0 m, after: {100 * k} ms, vehicles: 2}}" for k in range(1, 8)
]


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    # Vehicle 2 begins at 0 m or behind it, and moves north.
    scenario = small(
        f"checks={{signal: [{', '.join(CHECKS)}], formation_error: {{below: 1 mm}}}}", "initial.surge=1 m/s"
    )
    result = execute(scenario, Options(tmp_path_factory.mktemp("runs"), in_process=True, quiet=True))
    return result.directory


def marks(figure: Figure) -> list[float]:
    return [float(line.get_xdata()[0]) for line in figure.axes[0].get_lines() if line.get_gid() == "failed-check"]


def test_each_moment_is_a_line_with_a_number(directory: Path) -> None:
    (run,) = load([directory])
    figure = gallery.consensus([run], View())
    at = sorted({at_s for _, at_s in run.failures})
    assert len(at) >= 2 and marks(figure) == at[:MOST_MARKS]
    names = [text.get_text() for text in figure.axes[0].texts if text.get_gid() == "failed-check-name"]
    assert names == [f"✗{k + 1}" for k in range(len(marks(figure)))]
    words = caption_of(figure)
    assert f"✗1  fails at {at[0]:g} s: formation_error\n" in words
    assert len(at) <= MOST_MARKS or f"and at {len(at) - MOST_MARKS} more times" in words
    assert marks(gallery.consensus([run], View(window=(at[0] + 0.001, 1.0)))) == at[1 : MOST_MARKS + 1]


def test_messages_are_those_before_the_first_failure(tmp_path: Path) -> None:
    """They were those around the first fault or loss, and the mark of the failure lay beside the picture."""
    fails = "checks={signal: {topic: state.x, never: true, above: -100 m, after: 3 s, vehicles: 2}}"
    scenario = small("duration=4 s", fails, "faults=[{at: 500 ms, for: 100 ms, mute: 1}]")
    (run,) = load([execute(scenario, Options(tmp_path, in_process=True, quiet=True)).directory])
    ((_, at_s),) = run.failures
    figure = spacetime([run], View())
    first, last = figure.axes[0].get_xlim()
    assert marks(figure) == [at_s] and first < at_s <= last < first + 3.0


def test_the_result_of_another_log_marks_nothing(directory: Path, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes((directory / "run.mcap").read_bytes())
    assert load([tmp_path])[0].failures == []
    values = json.loads((directory / "result.json").read_text())
    (tmp_path / "result.json").write_text(json.dumps(values | {"digest": "0" * 64}))
    assert load([tmp_path])[0].failures == []
    (tmp_path / "result.json").write_text(json.dumps(values))
    assert load([tmp_path])[0].failures != []
    values["checks"][1]["moment"] = {"at_s": -1}
    (tmp_path / "result.json").write_text(json.dumps(values))
    assert load([tmp_path])[0].failures == []
