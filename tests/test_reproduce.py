"""The report on the paper: its numbers against an independent implementation's, its verdicts on canned runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from agents.controllers import CONTROLLERS
from fleet.cli import cli
from fleet.recording import record
from fleet.reproduce.cases import CASES, D, Outcome, U, measure, run_case, settle
from fleet.reproduce.claims import Check, Claim, judge
from fleet.reproduce.figures import FIGURES
from fleet.reproduce.report import write
from fleet.scenario import load_scenario


def test_every_case_is_a_scenario_of_its_own() -> None:
    scenarios = [case.scenario() for case in CASES.values()]
    assert all(a != b for n, a in enumerate(scenarios) for b in scenarios[:n])
    assert {case.controller.lower() for case in CASES.values() if case.group == "paper"} == set(CONTROLLERS)
    assert {case.sea for case in CASES.values() if case.group == "paper"} == {U, D}


# By an independent implementation of the same reading: settling times [s] of UUV 1-4, RMS z and peak demand of UUV 1,
# surge effort 0-2 s and largest u_cmd of UUV 1, first step of rho.
PUBLISHED = {
    "NBOC-undisturbed": (
        [8.17, 7.08, 7.22, 8.16],
        [16.74, 16.79, 16.86, 16.92],
        (132.73, 32.63, 49.52),
        16.77,
        2.121,
        1.926,
    ),
    "BC-undisturbed": ([4.71, 4.37, 4.38, 4.46], [9.13, 9.31, 9.27, 9.24], (174.35, 34.16, 9.0), 18.2, 4.47, 4.38),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_numbers_of_a_case(name: str) -> None:
    told: list[float] = []
    outcome = run_case(name, told.append)
    assert outcome.broken == ""
    assert told == sorted(told)
    ten, five, peak, effort, u_cmd, step = PUBLISHED[name]
    assert [row["settle_10pct_s"] for row in outcome.metrics] == pytest.approx(ten, abs=0.006)
    assert [row["settle_5cm_s"] for row in outcome.metrics] == pytest.approx(five, abs=0.06)
    first = outcome.metrics[0]
    assert first["demand_peak"] == pytest.approx(peak, rel=0.06)
    assert first["effort_first"][0] == pytest.approx(effort, abs=0.06)
    assert first["u_cmd_max_mps"] == pytest.approx(u_cmd, abs=0.006)
    assert first["rho_first_step_mps"] == pytest.approx(step, abs=0.006)
    assert max(row["e_rms_m"] for row in outcome.metrics) < 1e-5


def test_a_run_that_breaks_is_kept_until_then() -> None:
    outcome = run_case("NBC-unlimited-undisturbed", lambda _: None)
    assert "is vertical" in outcome.broken
    assert outcome.t[-1] < 2.0
    assert all(row["settle_5cm_s"] is None for row in outcome.metrics)


def test_recording_has_what_each_vehicle_reports() -> None:
    """Vehicles with different laws: NaN where a signal is somebody else's; the last sample has no command."""
    r = record(load_scenario("paper", ["duration=100 ms", "per_vehicle.2.controller=bc"]))
    assert r["eta"].shape == (11, 4, 5)
    assert np.isfinite(r["eta"]).all()
    assert np.isnan(r["x"][:, 1]).all()
    assert np.isfinite(r["x"][:-1, 0]).all()
    assert np.isnan(r["cmd_rate"][:, 0]).all()
    assert np.isnan(r["tau"][-1]).all()
    assert r.t == pytest.approx(np.arange(11) / 100)
    r.signals["z"] = np.abs(r["u_err"])
    assert len(measure(r)) == 4


@pytest.mark.parametrize(
    ("values", "expected"),
    [([3, 2, 1, 0.5, 0.5], 3.0), ([3, 0.5, 2, 0.5, 0.5], 3.0), ([0.5] * 5, 0.0), ([3, 0.5, 0.5, 0.5, 1.0], None)],
)
def test_settle(values: list[float], expected: float | None) -> None:
    """The first time after which a value stays below the limit (1) to the end."""
    assert settle(np.arange(5.0), np.array(values), 1.0) == expected
    assert settle(np.arange(5.0), np.full(5, np.nan), 1.0) is None


def canned(**values: float) -> Outcome:
    """A run of which only the numbers matter."""
    row = {
        "settle_10pct_s": 5.0, "settle_5cm_s": 10.0, "e_rms_m": 0.02, "e_max_late_m": 1e-5, "z_rms_mps": 0.02,
        "z_max_mps": 1.0, "demand_start": [20.0, 5.0, 3.0], "demand_peak": [100.0, 20.0, 9.0],
        "effort_first": [15.0, 10.0, 10.0], "effort": [60.0, 30.0, 15.0], "u_cmd_max_mps": 2.0,
        "rho_first_step_mps": 1.9, "rho_step_max_mps": 0.2, "theta_max_deg": 40.0, "u_min_mps": 0.1,
        "K_late_mean": [0.3, 0.3, 0.8], "K_late_span": [0.0, 0.0, 0.0],
    }  # fmt: skip
    signals = {"rho": np.full((3, 4, 3), 0.5)}
    return Outcome("canned", [dict(row, **values) for _ in range(4)], np.arange(3.0), signals)


def outcomes(**of: Outcome) -> dict[str, Outcome]:
    """The same run for every case, but for those given; names with _ for -."""
    special = {name.replace("_", "-").replace("k-max", "k_max"): outcome for name, outcome in of.items()}
    return {name: replace(special.get(name, canned()), name=name) for name in CASES}


def claims_of(**of: Outcome) -> dict[str, Claim]:
    return {claim.text: claim for claim in judge(outcomes(**of))}


def find(claims: dict[str, Claim], words: str) -> Claim:
    (found,) = [claim for text, claim in claims.items() if words in text]
    return found


def test_equal_runs_reproduce_no_difference() -> None:
    """Nobody is faster, smaller or more frugal than its equal; what is no comparison holds."""
    claims = claims_of()
    assert len(claims) == 11
    assert find(claims, "converge faster, clearly for UUVs 2-4 (undisturbed)").verdict == "not reproduced"
    assert find(claims, "smaller consensus errors").verdict == "not reproduced"
    assert find(claims, "smaller velocity tracking errors").verdict == "not reproduced"
    assert find(claims, "performs best").verdict == "reproduced"
    assert find(claims, "gains adjust").verdict == "reproduced"
    assert find(claims, "perfectly achieved").verdict == "reproduced"


def test_a_verdict_follows_its_numbers() -> None:
    slow = canned(settle_10pct_s=9.0, settle_5cm_s=20.0)
    claims = claims_of(NBC_undisturbed=slow, BC_undisturbed=slow)
    faster = find(claims, "converge faster, clearly for UUVs 2-4 (undisturbed)")
    assert faster.verdict == "reproduced"
    assert faster.readings == "printed cost: yes; corrected cost: yes"
    claims = claims_of(NBC_undisturbed=slow)
    assert (
        find(claims, "converge faster, clearly for UUVs 2-4 (undisturbed)").readings
        == "printed cost: 2 of 4; corrected cost: 2 of 4"
    )
    worse = canned(e_rms_m=0.0201)
    assert (
        find(claims_of(NBC_disturbed=worse, BC_disturbed=worse), "consensus errors").verdict == "not reproduced"
    )  # within 2 %
    worse = canned(e_rms_m=0.03)
    assert find(claims_of(NBC_disturbed=worse, BC_disturbed=worse), "consensus errors").verdict == "reproduced"


def test_never_settling_is_not_fast() -> None:
    never = canned(settle_10pct_s=None, settle_5cm_s=None)  # type: ignore[arg-type]
    claims = claims_of(NBOC_undisturbed=never, BC_undisturbed=never)
    checks = find(claims, "converge faster, clearly for UUVs 2-4 (undisturbed)").checks
    assert [check.holds for check in checks[:4]] == [False, False, True, True]
    assert "never" in checks[0].numbers


def test_claims_without_their_runs_are_left_out() -> None:
    assert judge({name: o for name, o in outcomes().items() if name.startswith("NBOC-u")}) != []
    assert judge({}) == []


def test_verdict_words() -> None:
    yes, no = Check("a", "", True, ""), Check("b", "", False, "")
    assert Claim("", "", (yes, yes)).verdict == "reproduced"
    assert Claim("", "", (yes, no)).verdict == "partly"
    assert Claim("", "", (no,)).verdict == "not reproduced"
    assert Claim("", "", (yes, no)).readings == "a: yes; b: no"


def test_report_holds_every_run_and_claim(tmp_path: Path) -> None:
    runs = outcomes(
        BC_unlimited_undisturbed=replace(canned(z_rms_mps=float("nan")), broken="vehicle 1 stands | vertical")
    )
    claims = judge(runs)
    path = write(tmp_path, runs, claims, "over a network", list(FIGURES))
    text = path.read_text("utf-8")
    assert all(name in text for name in CASES)
    assert all(claim.text in text for claim in claims)
    assert all(f"({name}.png)" in text for name in FIGURES)
    assert "ended early: vehicle 1 stands \\| vertical" in text
    values = json.loads((tmp_path / "metrics.json").read_text("utf-8"), parse_constant=lambda word: pytest.fail(word))
    assert values["cases"].keys() == CASES.keys()
    assert [claim["verdict"] for claim in values["claims"]] == [claim.verdict for claim in claims]


def test_command_with_a_few_cases(tmp_path: Path) -> None:
    """Two runs that end early, in two processes: a report with pictures of what there is, and no claim."""
    arguments = [
        "reproduce",
        "--out",
        str(tmp_path / "r"),
        "--case",
        "bc-unlimited",
        "--case",
        "nbc-unlimited",
        "--jobs",
        "2",
    ]
    result = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "no claim can be judged on these runs alone" in result.output
    text = (tmp_path / "r" / "report.md").read_text("utf-8")
    assert "ended early: vehicle 1" in text
    assert not list((tmp_path / "r").glob("*.png"))


def test_command_refuses_what_is_not_there(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["reproduce", "--case", "nbco"])
    assert result.exit_code == 2
    assert "no run begins with 'nbco'" in result.output
    (tmp_path / "file").write_text("")
    result = CliRunner().invoke(cli, ["reproduce", "--out", str(tmp_path / "file" / "x"), "--case", "bc-unlimited"])
    assert result.exit_code == 3
    assert "cannot make" in result.output


def test_pictures_repeat_to_the_byte(tmp_path: Path) -> None:
    from fleet.plotting import line, panels, save

    for name in ("a", "b"):
        figure, axes = panels(1, 1)
        line(axes[0], 0, [0, 1, 2], [1, 3, 2], "x")
        save(figure, tmp_path / name, ("png", "svg", "pdf"))
    for form in ("png", "svg", "pdf"):
        assert (tmp_path / f"a.{form}").read_bytes() == (tmp_path / f"b.{form}").read_bytes()
