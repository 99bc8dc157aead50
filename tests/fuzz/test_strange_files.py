"""Files from strangers that are no files, are damaged, or ask for too much: told quickly and in words."""

from __future__ import annotations

import copy
import json
import random
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest
from in_process_runs import Alone
from live_directory import live_directory
from marks import slow
from repository import ROOT
from tool import invoke

from fleet.analysis.stability import oldest_s
from fleet.errors import ScenarioError
from fleet.result.file import ResultError, read_result
from fleet.scenario.loading import parse_scenario
from fleet.scenario.validation import _everywhere
from netem.lives import Absence, Lives

PAPER = (ROOT / "fleet" / "scenario" / "shipped" / "paper.yaml").read_text("utf-8")


@pytest.mark.slow
def test_a_scenario_from_a_command() -> None:
    """What is open already is read: stdin, and what a shell makes of <(command)."""
    for script in (
        '"$@" /dev/stdin < fleet/scenario/shipped/paper.yaml',
        '"$@" <(cat fleet/scenario/shipped/paper.yaml)',
    ):
        done = subprocess.run(
            ["bash", "-c", script, "bash", sys.executable, "-m", "fleet", "check"],
            cwd=ROOT, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("paper: valid.")


# --- too many faults, too many mistakes -----------------------------------------


def problems(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, "x.yaml")
    return str(caught.value)


def test_a_nemesis_of_millions_of_faults_is_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    nemesis = "tick: 1 ms\nnemesis: {every: 1 ms, for: 10 ms, pick: [kill, {link: {'*': loss 40%}}]}\n"
    text = PAPER.replace("duration: 60 s ", "duration: 3600 s ").replace("tick: 10 ms ", "#") + nemesis
    monkeypatch.setattr("fleet.scenario.sections.nemesis._grid", None)
    said = problems(text)
    assert "nemesis.every: 3599990 faults, one every 1 ms, expected at most 5000 in a scenario" in said
    with_check = text.replace(
        "  ledger: balanced\n", "  ledger: balanced\n  recovery_time: {within: 1 s, below: 1 m}\n"
    )
    assert "3599990 faults" in problems(with_check)


def test_what_a_nemesis_adds_counts_with_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a limit of 50 faults in place of 5000."""
    monkeypatch.setattr("fleet.scenario.rules.faults.MOST_FAULTS", 50)
    own = "faults: [{at: 1 s, for: 1 s, kill: 1}]\n"
    most = "nemesis: {every: 10 ms, for: 10 ms, until: 500 ms, pick: [kill]}\n"  # 49 + 1
    assert len(parse_scenario(PAPER + most, "x.yaml").spec.faults) == 49
    assert len(parse_scenario(PAPER + most + own, "x.yaml").spec.faults) == 50
    assert "expected at most 50 " in problems(PAPER + most + own.replace("]", ", {at: 2 s, for: 1 s, kill: 1}]"))


def test_a_list_of_too_many_faults() -> None:
    faults = "faults:\n" + "- {at: 1 s, for: 1 s, kill: 1}\n" * 2500
    text = PAPER.replace("vehicles: 4\n", "vehicles: 100\n")
    assert "faults: 2500 faults, expected at most 1000" in problems(text + faults)


def test_many_mistakes_are_counted_and_the_first_shown() -> None:
    """All keys that there are, among which the one that was meant is looked for, are listed once: it takes 7 ms."""
    before = _everywhere.cache_info().misses
    said = problems(PAPER + "faults: [" + ",".join(["{a: 1}"] * 1000) + "]\n")
    assert _everywhere.cache_info().misses <= before + 1
    assert said.count("x.yaml:") == 200
    assert said.endswith(" problems; the first 200 are shown")


def test_absences_add_up_in_one_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """One after another they took a time that grew with the square of their number, and give the same."""
    random_ = random.Random(1)
    absences = [Absence(random_.randint(1, 3), b := random_.randrange(900), b + 9) for _ in range(200)]
    one_by_one = Lives()
    for absence in absences:
        one_by_one.add(absence)
    at_once = Lives(absences)
    assert all(at_once.gaps(i) == one_by_one.gaps(i) != [] for i in (1, 2, 3))
    counted: list[int] = []
    monkeypatch.setattr(Lives, "_add_up", lambda self, i: counted.append(i))
    Lives(Absence(1, 20 * k, 20 * k + 9) for k in range(20))
    assert counted == [1]


def test_links_without_a_condition_cost_nothing_to_look_at() -> None:
    """How old news can become took a list of one object per link: 130 MB for 1000 vehicles that all hear each other."""
    text = (
        PAPER.replace("shape: path\n", "shape: complete\n").replace("  ahead: 1.0 ", "#").replace("  behind: 0.8 ", "#")
    )
    scenario = parse_scenario(text, "x.yaml", ["vehicles=100"])
    assert len(scenario.graph.links) == 9900
    tracemalloc.start()
    try:
        assert oldest_s(scenario) == pytest.approx(0.1)
        assert tracemalloc.get_traced_memory()[1] < 500_000
    finally:
        tracemalloc.stop()


# --- a damaged result -----------------------------------------------------------

NASTY: tuple[Any, ...] = (
    None, True, "", "x", "<script>", -1, 0, 10**30, 10**400, 1e308, float("nan"), float("inf"), -float("inf"), 0.5,
    [], {}, [[]], [None], {"": None}, {"*": {}}, "\ud800", "\0", "9" * 5000,
)  # fmt: skip


@pytest.fixture(scope="module")
def directory(made: Alone) -> Path:
    """A run with losses, a fault and a check."""
    words = ["duration=1 s", "network.links={'*': 'loss 30%'}", "faults=[{at: 300 ms, for: 200 ms, partition: halves}]"]
    words += ["checks={ledger: balanced, formation_error: {below: 1 mm}}"]
    return made("paper", *words).directory


def mutated(seed: int, whole: str) -> str:
    """One variant: a value replaced, removed, moved or renamed, or bytes changed."""
    draw = random.Random(seed)
    if seed % 8 == 0:
        return whole[: draw.randrange(len(whole))]
    if seed % 8 == 1:
        at = draw.randrange(len(whole))
        return whole[:at] + draw.choice('{}[]",:0-e\\xnN') * draw.choice((1, 1, 3000)) + whole[at + 1 :]
    values = copy.deepcopy(json.loads(whole))
    places = list(_places(values))
    for _ in range(draw.choice((1, 1, 2, 5))):
        parent, key = draw.choice(places)
        try:
            match draw.randrange(5):
                case 0:
                    del parent[key]
                case 1:
                    other, other_key = draw.choice(places)
                    parent[key] = copy.deepcopy(other[other_key])
                case 2 if isinstance(parent, dict):
                    parent[f"{key}x"] = parent.pop(key)
                case _:
                    parent[key] = draw.choice(NASTY)
        except (KeyError, IndexError):
            continue
    return json.dumps(values)


def _places(values: Any) -> Iterator[tuple[Any, Any]]:
    for key in list(values) if isinstance(values, dict) else range(len(values)):
        yield values, key
        if isinstance(values[key], (dict, list)):
            yield from _places(values[key])


@pytest.mark.parametrize("seeds", [range(60), *slow(range(60, 250))])
def test_no_result_stops_a_report(
    seeds: range, directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of every variant: the page is made, with the verdicts or with what is wrong where; and tables from the log."""
    from fleet.addons.pictures.report import page
    from fleet.addons.pictures.runs import View, load

    monkeypatch.setattr("fleet.addons.pictures.report.WHAT", {})
    monkeypatch.setattr("fleet.addons.pictures.report.PER_RUN", set())
    copytree(directory, tmp_path / "run")
    (run,) = load([tmp_path / "run"])
    path = tmp_path / "run" / "result.json"
    whole = path.read_text()
    used = told = 0
    assert "result.json" not in page([run], View())
    for seed in seeds:
        path.write_text(mutated(seed, whole), "utf-8", "surrogatepass")
        text = page([run] if seed % 3 else [run, run], View())
        assert "<script>" not in text
        damaged = "result.json is damaged: " in text or "is of another log" in text
        counted = damaged or any(account.sent for account in read_result(path.parent).ledger.values())
        assert ("Packets per directed link" in text) == counted
        told += damaged
        used += not damaged
    print(f"{told} told, {used} used")
    assert told > 0.4 * len(seeds) and used > 0.1 * len(seeds)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"vehicles": {"1": {"e_rms_m": "x"}}}, r"Expected `float .*`, got `str` - at `\$.vehicles\[...\].e_rms_m`"),
        ({"checks": 5}, r"Expected `array`, got `int` - at `\$.checks`"),
        ({"digest": None}, r"Expected `str`, got `null` - at `\$.digest`"),
    ],
)  # fmt: skip
def test_a_damaged_result_is_told_where(change: dict[str, Any], why: str, directory: Path, tmp_path: Path) -> None:
    values = json.loads((directory / "result.json").read_text())
    (tmp_path / "result.json").write_text(json.dumps(values | change))
    with pytest.raises(ResultError, match=why):
        read_result(tmp_path)


def test_results_of_earlier_and_later_versions(tmp_path: Path) -> None:
    """One of before has neither a format nor all numbers, and words that JSON does not have."""
    row = """{"settle_10pct_s": 1, "settle_5cm_s": null, "e_rms_m": NaN, "e_final_m": -Infinity,
        "formation_final_m": 1e999, "effort_Ns": 1, "u_cmd_max_mps": null, "qp_failures": 0, "payloads_rejected": 0}"""
    text = '{"status": "broken", "sim_s": 2, "vehicles": {"1": ROW}}'.replace("ROW", row)
    (tmp_path / "result.json").write_text(text)
    found = read_result(tmp_path)
    assert (found.status, found.sim_s, found.digest, found.timing) == ("broken", 2.0, "", None)
    assert (found.vehicles["1"].e_rms_m, found.vehicles["1"].formation_final_m) == (None, None)
    assert (found.directory, found.run) == (tmp_path, tmp_path.name)
    (tmp_path / "result.json").write_text('{"status": "left", "format": 2}')
    with pytest.raises(ResultError, match="has format 2, of a later version of uuv-fleet; this one reads 1"):
        read_result(tmp_path)


@pytest.mark.parametrize("text", ["null", '{"endpoint": 5}', '{"run": "a/b"}'])
def test_no_observe_file_crashes_a_recorder(text: str, tmp_path: Path) -> None:
    with live_directory(tmp_path) as run:
        (run / "observe.json").write_text(text)
        done = invoke("record", "--run", run, "-o", tmp_path / "x.mcap")
    assert done.exit_code == 2
    assert "is no live run that is published: there is no usable observe.json" in " ".join(done.output.split())
