"""The report on the paper: its numbers against an independent implementation's, its verdicts on canned runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tool import invoke

import fleet
from agents.controllers import CONTROLLERS
from fleet.addons.paper.cases import (
    CASES,
    NAMES,
    D,
    Outcome,
    Recording,
    U,
    late_s,
    recording_of,
    run_case,
    tumble_time,
    vehicle_measures,
)
from fleet.addons.paper.claims import CORRECTED, NO_K_MAX, PRINTED, Claim, ClaimCheck, judge
from fleet.addons.paper.figures import (
    DASHED,
    FIGURES,
    OF_CONTROLLERS,
    OF_VEHICLES,
    TAU_MAX,
    consensus_errors,
    inputs,
    topology,
)
from fleet.addons.paper.report import HEADINGS, chosen, table_1, write
from fleet.addons.paper.run import _network_check
from fleet.processes.interrupts import HungUp
from fleet.result.result import Result, Status


def test_every_case_is_a_scenario_of_its_own() -> None:
    scenarios = [case.scenario() for case in CASES.values()]
    assert all(a != b for n, a in enumerate(scenarios) for b in scenarios[:n])
    assert {case.controller.lower() for case in CASES.values() if case.group == "paper"} == set(CONTROLLERS)
    assert {case.sea for case in CASES.values() if case.group == "paper"} == {U, D}


# By an independent implementation of the same reading: settling times [s] of UUV 1-4, RMS z and peak demand of UUV 1,
# surge effort 0-2 s and largest u_cmd of UUV 1, first step of rho.
PUBLISHED = {
    "NBOC-undisturbed": (
        [8.17, 7.08, 7.22, 8.16], [16.74, 16.79, 16.86, 16.92], (132.73, 32.63, 49.52), 16.77, 2.121, 1.926,
    ),
    "BC-undisturbed": ([4.71, 4.37, 4.38, 4.46], [9.13, 9.31, 9.27, 9.24], (174.35, 34.16, 9.0), 18.2, 4.47, 4.38),
}  # fmt: skip


@pytest.mark.slow
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


def test_a_vehicle_that_tumbles_is_told_by_its_pitch() -> None:
    outcome = run_case("NBC-unlimited-undisturbed", lambda _: None)
    assert [row["tumbled_s"] for row in outcome.metrics][:2] == pytest.approx([0.84, 0.90], abs=0.011)
    assert outcome.failure.startswith("tumbled: UUV 1 at 0.8")
    assert all(row["settle_5cm_s"] is None for row in outcome.metrics)


def test_tumbled_is_beyond_80_degrees_either_way() -> None:
    t = np.arange(4.0)
    assert tumble_time(t, np.radians([0.0, 79.9, -79.9, 0.0])) is None
    assert tumble_time(t, np.radians([0.0, 10.0, 80.1, 0.0])) == 2.0
    assert tumble_time(t, np.radians([0.0, -80.1, 0.0, 95.0])) == 1.0


def test_a_failure_is_a_tumble_or_an_early_end() -> None:
    assert canned().failure == ""
    assert replace(canned(), broken="no more").failure == "ended early: no more"
    both = replace(canned(tumbled_s=1.5), broken="no more").failure
    assert both.startswith("tumbled: UUV 1 at 1.50 s, UUV 2") and both.endswith("; ended early: no more")


def recording(folder: Path, scenario: str, *changes: str) -> Recording:
    with fleet.Run(scenario, set=["checks={}", *changes], log=folder / "run.mcap") as run:
        run.to_end()
    return recording_of(fleet.open_log(folder / "run.mcap"))


def test_recording_has_what_each_vehicle_reports(tmp_path: Path) -> None:
    """Each sample of each vehicle; the last sample has no command."""
    r = recording(tmp_path, "paper", "duration=100 ms", "per_vehicle.2.controller=bc")
    assert r["eta"].shape == (11, 4, 5)
    assert np.isfinite(r["eta"]).all()
    assert np.isfinite(r["demand"][:-1]).all()
    assert np.isnan(r["applied"][-1]).all()
    assert r.t == pytest.approx(np.arange(11) / 100)
    assert len(vehicle_measures(r)) == 4


def test_late_is_whole_periods_of_the_disturbance(tmp_path: Path) -> None:
    """A mean over a part of a period would depend on where the run ends."""
    r = recording(tmp_path, "ideal", "duration=20 s", "sea.disturbance=paper", "controller=bc")
    assert late_s(r) == pytest.approx(2 * np.pi)
    r.signals["z"] = np.where(r.t < 5.0, 9.0, np.where(r.t < 12.0, 3.0, 1.0))[:, None, None] * np.ones((1, 4, 1))
    (row, *_) = vehicle_measures(r)
    assert (row["z_max_mps"], row["z_peak_mps"], row["z_rms_mps"]) == pytest.approx((9.0, 3.0, 1.0))
    (tmp_path / "short").mkdir()
    assert late_s(recording(tmp_path / "short", "ideal", "duration=100 ms")) == 10.0


Value = float | list[float] | None


def canned(**values: Value) -> Outcome:
    """A run of which only the numbers matter."""
    row: dict[str, Value] = {
        "settle_10pct_s": 5.0, "settle_5cm_s": 10.0, "e_rms_m": 0.02, "e_max_late_m": 1e-5, "z_rms_mps": 0.02,
        "z_peak_mps": 0.1, "z_max_mps": 1.0, "demand_start": [20.0, 5.0, 3.0], "demand_peak": [100.0, 20.0, 9.0],
        "effort_first": [15.0, 10.0, 10.0], "effort": [60.0, 30.0, 15.0], "u_cmd_max_mps": 2.0,
        "rho_first_step_mps": 1.9, "rho_step_max_mps": 0.2, "rho_min_mps": [0.1, -1.0, -1.25],
        "rho_max_mps": [1.5, 1.0, 1.25], "theta_max_deg": 40.0, "tumbled_s": None, "u_min_mps": 0.1,
        "K_span": [0.3, 0.3, 0.5], "K_late_mean": [0.3, 0.3, 0.8], "K_late_span": [0.0, 0.0, 0.0],
    }  # fmt: skip
    t = np.arange(0.0, 120.0, 0.05)
    signals = {key: np.full((len(t), 4, n), 0.5) for key, n in (("e", 3), ("z", 1), ("rho", 3), ("u_cmd", 1), ("K", 3))}
    fine = np.arange(0.0, 120.0, 0.01)
    first = {"t": fine, "demand": np.full((len(fine), 3), 100.0), "applied": np.full((len(fine), 3), 20.0)}
    return Outcome("canned", [dict(row, **values) for _ in range(4)], t, signals, first)


def outcomes(**of: Outcome) -> dict[str, Outcome]:
    """The same run for every case, but for those given; names with _ for -."""
    special = {name.replace("_", "-").replace("k-max", "k_max"): outcome for name, outcome in of.items()}
    assert special.keys() <= CASES.keys()
    return {name: replace(special.get(name, canned()), name=name) for name in CASES}


def scaled(outcome: Outcome, factor: float) -> Outcome:
    """The same with every number of every vehicle so many times larger."""

    def times(value: Value) -> Value:
        if value is None:
            return None
        return [x * factor for x in value] if isinstance(value, list) else value * factor

    return replace(outcome, metrics=[{key: times(value) for key, value in row.items()} for row in outcome.metrics])


def claims_of(**of: Outcome) -> dict[str, Claim]:
    return {claim.text: claim for claim in judge(outcomes(**of))}


def find(claims: dict[str, Claim], words: str) -> Claim:
    (found,) = [claim for text, claim in claims.items() if words in text]
    return found


def reading(claim: Claim, name: str) -> str:
    (found,) = [part.split(": ")[1] for part in claim.readings.split("; ") if part.startswith(f"{name}: ")]
    return found


FASTER = "converge faster, clearly for UUVs 2-4 (undisturbed)"
FASTER_DISTURBED = "converge faster, clearly for UUVs 2-4 (disturbed)"


def test_equal_runs_reproduce_no_difference() -> None:
    """Nobody is faster, smaller or more frugal than its equal; what is no comparison holds."""
    claims = claims_of()
    assert len(claims) == 11
    for words in (FASTER, FASTER_DISTURBED, "smaller consensus errors", "smaller velocity tracking", "effort"):
        assert find(claims, words).verdict == "not reproduced", words
    for words in ("performs best", "gains adjust", "gains converge", "perfectly achieved"):
        assert find(claims, words).verdict == "reproduced", words


def optimised(name: str) -> bool:
    return CASES[name].controller in ("NBOC", "BOC")


def test_every_claim_can_be_reproduced() -> None:
    """Where all that the paper calls smaller is a tenth, and a vehicle with another gain does no worse."""
    good = canned(rho_min_mps=[0.5, 0.0, 0.0], rho_max_mps=[1.0, 0.5, 0.5], rho_first_step_mps=3.0, e_max_late_m=9e-4)
    better = {
        "settle_10pct_s", "settle_5cm_s", "e_rms_m", "e_max_late_m", "z_rms_mps", "z_peak_mps", "demand_start",
        "demand_peak", "effort_first", "u_cmd_max_mps", "rho_first_step_mps", "rho_step_max_mps",
    }  # fmt: skip
    runs = {}
    for name, case in CASES.items():
        factor = {"NBOC": 0.1, "BOC": 0.13, "NBC": 0.8}.get(case.controller, 1.0)
        run = scaled(good, factor)
        rows = [
            {key: row[key] if key in better else plain[key] for key in row}
            for row, plain in zip(run.metrics, good.metrics, strict=True)
        ]
        runs[name] = replace(run, name=name, metrics=rows)
    for name in NAMES:  # z is a matter of neurodynamics
        z = 0.001 if name == "NBOC" else 0.002 if name == "NBC" else 0.02
        for row in runs[f"{name}-{D}"].metrics:
            row.update(z_rms_mps=z, z_peak_mps=z)
    for row in runs[f"NBOC-consistent-{D}"].metrics:
        row.update(z_rms_mps=0.001, z_peak_mps=0.001)
    for row in runs[f"NBC-b-10-{D}"].metrics:
        row["z_rms_mps"] = 0.002
    for claim in judge(runs):
        assert claim.verdict == "reproduced", [check for check in claim.checks if check.answer != "yes"]


def test_every_check_can_be_denied() -> None:
    """Where all that the paper calls smaller is ten times larger, and vehicles tumble, and gains never move or rest."""
    runs = outcomes()
    for name, case in CASES.items():
        run = scaled(canned(), 10.0 if optimised(name) else 1.0)
        bad: dict[str, Value] = {"tumbled_s": 1.0} if case.sea == U else {}
        bad |= {"K_span": [0.0] * 3, "K_late_span": [1.0] * 3, "rho_min_mps": [-9.0] * 3, "rho_max_mps": [9.0] * 3}
        bad["rho_step_max_mps"] = 2.0
        runs[name] = replace(run, name=name, metrics=[row | bad for row in run.metrics])
    for name in NAMES:
        z = 3.0 if name == "NBOC" else 2.0 if name == "NBC" else 1.0
        for row in runs[f"{name}-{D}"].metrics:
            row.update(z_rms_mps=z, z_peak_mps=z)
        if name == "BOC":  # nobody else is beaten by NBOC either
            for row in (*runs[f"BOC-{U}"].metrics, *runs[f"BOC-{D}"].metrics):
                row.update(settle_10pct_s=20.0, settle_5cm_s=50.0, e_rms_m=0.1, e_max_late_m=5e-5)
    for row in runs[f"NBOC-consistent-{D}"].metrics:
        row.update(z_rms_mps=3.0, z_peak_mps=3.0)
    for row in runs[f"NBC-b-10-{D}"].metrics:
        row["z_rms_mps"] = 9.0
    for claim in judge(runs):
        assert claim.verdict == "not reproduced", [check for check in claim.checks if check.answer != "no"]


def test_faster_means_than_each_of_the_others() -> None:
    slow = canned(settle_10pct_s=9.0, settle_5cm_s=20.0)
    faster = find(claims_of(NBC_undisturbed=slow, BC_undisturbed=slow, BSMC_undisturbed=slow), FASTER)
    assert faster.verdict == "reproduced"
    assert faster.readings == "printed cost: yes; corrected cost: yes"
    faster = find(claims_of(NBC_undisturbed=slow, BC_undisturbed=slow), FASTER)
    assert {check.answer_text for check in faster.checks} == {"partly (6 of 9)"}
    assert faster.readings == "printed cost: partly; corrected cost: partly"


def test_who_does_not_settle_either_is_not_slower() -> None:
    """As BOC and BC under the disturbance, which keep crossing 5 cm."""
    never = canned(settle_5cm_s=None)
    claim = find(claims_of(BOC_disturbed=never, BC_disturbed=never), FASTER_DISTURBED)
    asked = {c.asks: c for c in claim.checks if c.reading == PRINTED and "BOC within 5 cm" in c.asks}
    (nboc,), (boc,) = ([c for asks, c in asked.items() if ("NBOC" in asks) == both] for both in (True, False))
    assert (boc.answer, boc.numbers.count("not settled")) == ("no", 2)
    assert nboc.answer_text == "partly (3 of 9)"  # it settles, BC does not
    best = find(claims_of(NBOC_disturbed=never, BC_disturbed=never), "performs best")
    assert [c.answer for c in best.checks if c.asks.startswith("settling time to 5 cm, disturbed")] == ["no", "yes"]


def test_smaller_errors_means_than_each_of_the_others() -> None:
    """Less than NBC's and BC's is not enough; nor is a smaller mean square with a larger peak."""
    words = "smaller consensus errors"
    large = canned(e_rms_m=0.03, e_max_late_m=0.04)
    assert reading(find(claims_of(NBC_disturbed=large, BC_disturbed=large), words), CORRECTED) == "partly"
    three = {"NBC_disturbed": large, "BC_disturbed": large, "BSMC_disturbed": large}
    assert reading(find(claims_of(**three), words), CORRECTED) == "yes"
    near = canned(e_rms_m=0.0201, e_max_late_m=1.01e-5)  # within 2 %
    assert reading(find(claims_of(**dict.fromkeys(three, near)), words), CORRECTED) == "no"
    bursts = canned(e_max_late_m=0.1)
    found = find(claims_of(**three, NBOC_no_k_max_disturbed=bursts), words)
    assert (reading(found, NO_K_MAX), reading(found, CORRECTED)) == ("3 yes, 1 no", "yes")


def test_z_is_judged_on_every_vehicle_and_by_its_peaks() -> None:
    words = "smaller velocity tracking errors"
    large = canned(z_rms_mps=0.07, z_peak_mps=0.2)
    plain = {"BOC_disturbed": large, "BC_disturbed": large, "BSMC_disturbed": large}
    assert reading(find(claims_of(**plain), words), PRINTED) == "yes"
    peaks = canned(z_peak_mps=1.0)
    assert reading(find(claims_of(**plain, NBOC_disturbed=peaks), words), PRINTED) == "3 yes, 1 no"
    fourth = canned()
    fourth.metrics[3]["z_rms_mps"] = 0.1
    assert reading(find(claims_of(**plain, NBOC_disturbed=fourth), words), PRINTED) == "3 yes, 1 partly"


def test_a_gain_that_never_moves_does_not_adjust() -> None:
    still = canned(K_span=[0.0, 0.0, 0.0])
    assert find(claims_of(NBOC_undisturbed=still), "gains adjust").readings == "printed cost: 3 yes, 3 no"
    one_axis = canned(K_span=[0.05, 0.3, 0.3])
    assert find(claims_of(NBOC_undisturbed=one_axis), "gains adjust").verdict == "partly"


def test_a_tumbled_vehicle_reached_no_formation() -> None:
    tumbled_once = canned()
    tumbled_once.metrics[2]["tumbled_s"] = 1.25
    claim = find(claims_of(NBC_unlimited_undisturbed=tumbled_once), "perfectly achieved")
    (check,) = [c for c in claim.checks if c.answer != "yes"]
    assert check.answer == "no" and check.numbers.startswith("tumbled: UUV 3 at 1.25 s; largest")


def test_claims_without_their_runs_are_left_out() -> None:
    assert judge({name: o for name, o in outcomes().items() if name.startswith("NBOC-u")}) != []
    assert judge({}) == []


def test_verdict_words() -> None:
    answers = {"a": (True,), "b": (False, False), "c": (True, False)}
    yes, no, half = (ClaimCheck("b" if name == "c" else name, "", each, "") for name, each in answers.items())
    assert [check.answer_text for check in (yes, no, half)] == ["yes", "no", "partly (1 of 2)"]
    found = [Claim("", "", checks).verdict for checks in ((half,), (yes, yes), (yes, no), (no,))]
    assert found == ["partly", "reproduced", "partly", "not reproduced"]
    assert Claim("", "", (yes, half, no)).readings == "a: yes; b: 1 partly, 1 no"
    assert Claim("", "", (yes, no)).readings == "a: yes; b: no"


def test_report_holds_every_run_and_claim(tmp_path: Path) -> None:
    runs = outcomes(BC_unlimited_undisturbed=replace(canned(z_rms_mps=float("nan")), broken="vehicle 1 | is lost"))
    claims = judge(runs)
    path = write(tmp_path, runs, claims, "over a network", list(FIGURES))
    text = path.read_text("utf-8")
    assert all(name in text for name in CASES)
    assert all(claim.text in text for claim in claims)
    assert all(
        check.asks in text and check.numbers.replace("|", "\\|") in text for claim in claims for check in claim.checks
    )
    assert all(f"({name}.png)" in text for name in FIGURES)
    assert "ended early: vehicle 1 \\| is lost" in text
    values = json.loads((tmp_path / "metrics.json").read_text("utf-8"), parse_constant=lambda word: pytest.fail(word))
    assert values["cases"].keys() == CASES.keys()
    assert [claim["verdict"] for claim in values["claims"]] == [claim.verdict for claim in claims]


def test_table_1_is_the_papers() -> None:
    na, threes, sixes, tens = "N/A", "diag(0.3, 0.3, 0.3)", "diag(0.6, 0.6, 0.6)", "diag(10, 10, 10)"
    ones, tenths = "diag(1, 1, 1)", "0.1, 0.1, 0.1"
    assert HEADINGS == ("parameter", "NBOC", "BOC", "NBC", "BC", "BSMC")
    assert [row[1:] for row in table_1()] == [
        [threes, threes, sixes, sixes, sixes],
        [tens, tens, tens, tens, "diag(20, 15, 15)"],
        [tens, tens, na, na, na],
        [ones, ones, na, na, na],
        [ones, ones, na, na, na],
        [tenths, tenths, na, na, na],
        ["10", na, "10", na, na],
        ["30", na, "30", na, na],
        ["30", na, "30", na, na],
    ]
    assert all(len(row) == len(HEADINGS) for row in chosen())


def test_the_graph_is_drawn_with_its_weights() -> None:
    (ax,) = topology(outcomes(), U).axes
    texts = {text.get_text() for text in ax.texts}
    forth, back = ({f"a$_{{{link}}}$ = {w}" for link in links} for links, w in (((21, 32, 43), 1), ((12, 23, 34), 0.8)))
    assert forth | back | {f"b$_{i}$ = 1" for i in range(1, 5)} | {f"UUV {i}" for i in range(1, 5)} < texts


def test_inputs_are_drawn_as_demanded_with_the_limit() -> None:
    """Applied, all would lie on the limit at the start, and half an effort could not be seen."""
    for ax in inputs(outcomes(), U).axes:
        drawn = {line.get_label(): np.max(line.get_ydata()) for line in ax.lines}
        assert all(drawn[name] == 100.0 for name in NAMES)
        assert drawn["actuator limit"] in TAU_MAX


def test_lines_that_lie_on_each_other_can_be_told_apart() -> None:
    """A wider one is below and paler, and what is on top has gaps."""
    for below, above in (("NBOC", "BOC"), ("BC", "BSMC"), ("BC", "NBC"), ("NBC", "BSMC")):
        a, b = OF_CONTROLLERS[below], OF_CONTROLLERS[above]
        assert a["linewidth"] > b["linewidth"] and a["zorder"] < b["zorder"], (below, above)
    assert [look is DASHED for look in OF_VEHICLES] == [False, False, True, True]
    (ax, *_) = consensus_errors(outcomes(), U).axes
    assert [line.get_label() for line in ax.lines] == list(NAMES)


@pytest.mark.parametrize("name", FIGURES)
def test_every_picture_can_be_drawn(name: str) -> None:
    _, sea, make = FIGURES[name]
    figure = make(outcomes(), sea)
    assert figure.axes
    for ax in figure.axes:
        assert "topology" in name or ax.lines


def test_command_with_a_few_cases(tmp_path: Path) -> None:
    """Two runs that end early, in two processes: a report with pictures of what there is, and no claim."""
    cases = ("--case", "bc-unlimited", "--case", "nbc-unlimited")
    result = invoke("reproduce", "--out", tmp_path / "r", *cases, "--jobs", 2)
    assert result.exit_code == 0, result.output
    assert "no claim can be judged on these runs alone" in result.output
    text = (tmp_path / "r" / "report.md").read_text("utf-8")
    assert "tumbled: UUV 1 at 0.84 s" in text
    assert not list((tmp_path / "r").glob("*.png"))


@pytest.mark.parametrize(("status", "raised"), [(Status.INTERRUPTED, KeyboardInterrupt), (Status.HUNG_UP, HungUp)])
def test_a_signal_in_the_distributed_run_ends_it_all(
    status: Status, raised: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It came as a run with that status, after which all the other runs were made."""
    monkeypatch.setattr("fleet.execution.execute.execute", lambda *_: Result(status=status))
    with pytest.raises(KeyboardInterrupt) as caught:
        _network_check(lambda *_: None)
    assert caught.type is raised


def test_pictures_repeat_to_the_byte(tmp_path: Path) -> None:
    from fleet.addons.pictures.style import line, panels, save

    for name in ("a", "b"):
        figure, axes = panels(1, 1)
        line(axes[0], 0, [0, 1, 2], [1, 3, 2], "x")
        save(figure, tmp_path / name, ("png", "svg", "pdf"))
    for form in ("png", "svg", "pdf"):
        assert (tmp_path / f"a.{form}").read_bytes() == (tmp_path / f"b.{form}").read_bytes()
