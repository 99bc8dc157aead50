"""What `import fleet` offers, and what its objects say of themselves in a shell and in a notebook."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_up_study import CONTROLLER, DELAY, LOSS, Row, made_up, usual

import fleet
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.study import Study
from fleet.errors import FleetError
from fleet.notebook import MOST_ROWS, html_table
from fleet.result.file import read_result
from fleet.result.result import Result, Status
from fleet.result.verdict import Verdict


def test_dir_lists_what_is_offered() -> None:
    assert [name for name in dir(fleet) if not name.startswith("_")] == sorted(fleet.__all__)


def test_a_key_of_the_scenario_that_is_given_as_an_argument() -> None:
    with pytest.raises(TypeError, match=r"has no argument 'duration'; .* set=\{'duration': '5 s'\}"):
        fleet.run("paper", duration="5 s")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"has no argument 'in_process'; it has scenario, "):
        fleet.run("paper", in_process=True)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"run\(\) has no argument 'sede'; did you mean \"seed\"\?"):
        fleet.run("paper", sede=3)  # type: ignore[arg-type]
    with pytest.raises(
        TypeError, match=r"Run\(\) has no argument 'out'; it has scenario, set, net, fault, seed, trust"
    ):
        fleet.Run("paper", out="runs")  # type: ignore[arg-type]


def test_a_run_in_a_notebook_can_be_drawn(tmp_path: Path) -> None:
    changes = {"duration": "2 s", "checks": {}}
    result = fleet.run("paper", set=changes, out=tmp_path)
    assert result.directory is not None
    log = fleet.open_log(tmp_path / "latest")
    assert log.path.parent.samefile(result.directory)
    assert log.digest == result.digest == fleet.run("paper", set=changes).digest
    assert read_result(result.directory).digest == result.digest
    drawn = fleet.plot(log, ["formation", "state.z"], out=tmp_path / "plots", format="svg")
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == ["formation.svg", "state.z.svg"]
    assert drawn._repr_html_().count('<img alt="formation" src="data:image/png;base64,iVBOR') == 1
    figure = fleet.plot(log.path.parent, "state.z")["state.z"]
    figure.set_size_inches(3.5, 2.0)
    figure.savefig(tmp_path / "z.pdf")
    assert not (log.path.parent / "plots").exists()
    for what in ("formatoin!", "timing", "state.zz"):
        with pytest.raises(FleetError):
            fleet.plot(log, what)


def verdict(name: str, *, passed: bool) -> Verdict:
    return Verdict(name, passed, "below <1 m>", "2 m", 2.0, 1.0, "m")


def test_a_result_in_a_line_and_as_a_table() -> None:
    result = Result(scenario="ring", seed=7, status=Status.CHECK_FAILED)
    result.checks = [verdict("deaths", passed=True), verdict("formation_error", passed=False)]
    assert repr(result) == "<Result of ring with seed 7: check_failed; 1 of 2 checks passed, failed: formation_error>"
    table = result._repr_html_()
    assert table.index("formation_error") < table.index("deaths")  # what failed comes first
    assert "below &lt;1 m&gt;" in table
    broken = Result(scenario="ring", seed=7, status=Status.BROKEN, reason="agent 2 ended")
    assert repr(broken) == "<Result of ring with seed 7: broken; agent 2 ended>"
    assert "agent 2 ended" in broken._repr_html_()


def test_a_study_in_a_line_and_as_a_table(tmp_path: Path) -> None:
    study = Study(made_up(tmp_path / "s", CONTROLLER, DELAY, row=usual))
    assert repr(study) == f"<Study {tmp_path / 's'}: small over controller, network.links.*.delay>"
    table = study._repr_html_()
    assert table.count("<tr>") == 5  # headings, and two controllers at two delays
    assert "<th>median of formation_final_m</th>" in table


def test_runs_without_a_partner_are_not_compared(tmp_path: Path) -> None:
    def apart(values: Row, seed: int) -> Row | None:
        return usual(values, seed) if (values["network.links.*.loss"] == 0.0) == (seed == 1) else None

    study = Study(made_up(tmp_path / "s", LOSS, row=apart))
    with pytest.raises(
        StudyError, match=r"e_rms_m has no pair: no run at .*=0.0 has a partner at .*=60.0 .* same seed"
    ):
        study.compare("network.links.*.loss", 0.0, 60.0, "e_rms_m")
    assert study.compare("network.links.*.loss", 30.0, 60.0, "e_rms_m").difference.runs == 2


def test_a_long_table_counts_what_it_leaves_out() -> None:
    assert html_table("t", ["n"], ([n] for n in range(MOST_ROWS + 3))).count("<td>") == MOST_ROWS
    assert "and 3 more" in html_table("t", ["n"], ([n] for n in range(MOST_ROWS + 3)))


def test_names_of_version_1_0_still_work_and_say_what_they_are_now() -> None:
    """They had gone without a warning, though the page on what is stable promises one."""
    for old in ("stepping", "SteppedRun"):
        with pytest.warns(DeprecationWarning, match=rf"fleet.{old} is deprecated, use fleet.Run"):
            assert getattr(fleet, old) is fleet.Run
    with fleet.Run("paper", set={"duration": "100 ms", "checks": {}}, seed=1) as run:
        result = run.to_end()
    with pytest.warns(DeprecationWarning, match=r"use Result.checks"):
        assert result.verdicts is result.checks
