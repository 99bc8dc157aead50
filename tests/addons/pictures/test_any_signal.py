"""Pictures of any signal: what is on the axes, which names are known, and what checks add."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.shell_completion import ShellComplete
from in_process_runs import Alone
from matplotlib.figure import Figure

from fleet.addons.pictures.any_signal import signals_of_checks
from fleet.addons.pictures.caption import caption_of
from fleet.addons.pictures.gallery import WHAT, draw
from fleet.addons.pictures.report import page, telling
from fleet.addons.pictures.runs import LoggedRun, View, load
from fleet.cli.main import cli
from fleet.logs.topic_names import signal_names

pytestmark = pytest.mark.usefixtures("coarse")

CHECKS = (
    "checks={signal: ["
    "{name: shallow, topic: state.z, below: 7 m, after: 1 s}, {name: one, topic: control.leads, at_most_one: true}, "
    "{name: nobody, topic: control.leader, equals: 0}, {name: near, topic: error.e_norm, below: 100 m}], "
    '"fleet.protocols.checks:AtMostOneLeader": {per: side, grace: 4 s}}'
)


@pytest.fixture(scope="module")
def directory(made: Alone) -> Path:
    """Five vehicles elect a leader; that it is nobody fails."""
    return made("election", "duration=6 s", "faults=[]", CHECKS).directory


@pytest.fixture(scope="module")
def run(directory: Path) -> LoggedRun:
    return load([directory])[0]


def figure(run: LoggedRun, name: str, view: View | None = None) -> Figure:
    ((_, _, found),) = draw([name], [run], view or View())
    assert isinstance(found, Figure), found
    return found


def test_whole_numbers_are_steps_that_do_not_hide_each_other(run: LoggedRun) -> None:
    drawn = figure(run, "control.leader")
    (ax,) = drawn.axes
    lines = [line for line in ax.get_lines() if "-vehicle-" in str(line.get_gid())]
    assert len(lines) == 5 and {line.get_drawstyle() for line in lines} == {"steps-post"}
    last = [float(np.asarray(line.get_ydata())[-1]) for line in lines]
    assert len(set(last)) == 5 and {round(value) for value in last} == {1}
    assert "number of the leader" in caption_of(drawn)
    crosses = [
        line for line in ax.get_lines() if str(line.get_gid()).startswith("failed-") and line.get_marker() == "x"
    ]
    (moment,) = [verdict.moment for verdict in run.verdicts if verdict.check == "nobody"]
    assert crosses and {float(np.asarray(cross.get_xdata())[0]) for cross in crosses} == {moment.at_s}
    assert "fails at" in caption_of(drawn)


def test_other_numbers_are_lines_with_what_a_check_asks(run: LoggedRun) -> None:
    (ax,) = figure(run, "state.z").axes
    assert {line.get_drawstyle() for line in ax.get_lines()} == {"default"}
    assert ax.get_ylabel() == "state.z [m]"
    (asked,) = [line for line in ax.get_lines() if line.get_gid() == "check"]
    assert list(map(float, asked.get_ydata())) == [7.0, 7.0] and float(np.asarray(asked.get_xdata())[0]) == 1.0
    assert [text.get_text() for text in ax.texts if text.get_gid() == "check-name"] == ["check: below 7 m after 1 s"]


def test_a_vector_has_an_axis_for_each_component(run: LoggedRun) -> None:
    labels = [ax.get_ylabel() for ax in figure(run, "command.tau").axes]
    assert labels == ["command.tau_0 [N]", "command.tau_1 [N m]", "command.tau_2 [N m]"]
    (ax,) = figure(run, "command.tau_1", View(vehicles=(2,))).axes
    (line,) = [line for line in ax.get_lines() if line.get_gid() == f"{run.slug}-vehicle-2"]
    assert ax.get_ylabel() == "command.tau_1 [N m]" and len(np.asarray(line.get_ydata())) > 1
    (ax,) = figure(run, "|error.e|").axes
    (norm,) = [line for line in ax.get_lines() if line.get_gid() == f"{run.slug}-vehicle-1"]
    assert np.asarray(norm.get_ydata())[-1] == pytest.approx(run.log["uuv/1/error"]["e_norm"][-1])


def test_the_name_of_one_vehicle_is_drawn_alone(run: LoggedRun) -> None:
    (ax,) = figure(run, "|uuv/2/error.e|").axes
    assert ax.get_ylabel() == "|error.e| [m]"
    assert [line.get_gid() for line in ax.get_lines() if "vehicle" in str(line.get_gid())] == [f"{run.slug}-vehicle-2"]


def test_signals_of_checks_are_drawn_without_asking(run: LoggedRun) -> None:
    """Also those that a check in Python looked at. `error.e_norm` has a picture of its own, which comes first."""
    assert list(map(str, signals_of_checks([run]))) == [
        "state.z",
        "control.leads",
        "control.leader",
        "control.leads_until",
    ]
    names = [name for name, _, _ in draw(["checks"], [run], View())]
    assert names == ["error", "state.z", "control.leads", "control.leader", "control.leads_until"]
    assert telling(run)[0] == "state.z"


def test_the_report_begins_with_the_verdict_a_picture_and_the_reason(
    run: LoggedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fleet.addons.pictures.report.WHAT", {"checks": WHAT["checks"]})
    text = page([run], View())
    places = [
        text.index(part) for part in ('class="fail">2 of 7 checks failed', "<figure", ">shallow<", ">near<", ">Faults<")
    ]
    assert places == sorted(places)
    assert "alt=" in text and text.count("<figure") == 5
    assert "Packets by kind of payload" in text and "<td>election</td>" in text


def test_signals_are_completed(directory: Path) -> None:
    assert {"control.leads", "command.tau", "state.z"} <= set(signal_names(directory))

    def completed(typed: str) -> list[str]:
        shell = ShellComplete(cli, {}, "fleet", "_FLEET_COMPLETE")
        return [item.value for item in shell.get_completions(["plot", str(directory), "--what"], typed)]

    assert completed("control.lead") == ["control.leader", "control.leads", "control.leads_until"]
    assert completed("inputs,tra") == ["inputs,track", "inputs,track-3d"]
