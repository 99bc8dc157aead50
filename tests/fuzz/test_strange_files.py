"""Files from strangers that are no files, are damaged, or ask for too much: told quickly and in words."""

from __future__ import annotations

import copy
import json
import os
import random
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from time import process_time
from typing import Any

import pytest
from live_directory import live_directory
from marks import slow
from repository import ROOT
from spawned import python
from tool import invoke

from agents.join_file import JoinError, JoinFile
from fleet.analysis.stability import oldest_s
from fleet.errors import FleetError, ScenarioError
from fleet.execution.connection import live_runs
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.hosts.certificates import _read as read_pem
from fleet.hosts.rendezvous import read_credentials
from fleet.pictures.report import page
from fleet.pictures.runs import Run, View, load
from fleet.result.file import ResultError, read_result
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.sections.link_conditions import read_trace
from fleet.scenario.sections.modem_files import load_modem
from fleet.scenario.sections.per_vehicle import load_vehicle
from netem.lives import Absence, Lives
from netem.private_file import read_file

PAPER = (ROOT / "fleet" / "scenario" / "shipped" / "paper.yaml").read_text("utf-8")


# --- what is no file ----------------------------------------------------------


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """A pipe into which nobody writes: whoever opens it to read waits for ever."""
    os.mkfifo(tmp_path / "pipe.toml", 0o600)
    return tmp_path / "pipe.toml"


@pytest.mark.slow
def test_a_pipe_is_no_input(pipe: Path) -> None:
    """Each reader says so at once; in a process of its own, because a wrong one hangs."""
    code = (
        "import sys; sys.path[:0] = ['tests/fuzz', 'tests/support'];"
        "import test_strange_files as t; from pathlib import Path; t.read_all(Path(sys.argv[1]))"
    )
    done = python("-c", code, pipe, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert len(said) == 7
    assert all("it is a pipe, not a file" in line for line in said), said


def read_all(pipe: Path) -> None:
    """Hand one path to everybody who reads a file of a user."""
    readers: tuple[tuple[Callable[[], object], type[Exception]], ...] = (
        (lambda: load_scenario(pipe), ScenarioError),
        (lambda: load_vehicle(str(pipe)), Exception),
        (lambda: load_modem(str(pipe)), Exception),
        (lambda: read_trace(pipe), Exception),
        (lambda: JoinFile.read(pipe), JoinError),
        (lambda: read_credentials(pipe, 4), FleetError),
        (lambda: read_pem(pipe), FleetError),
    )
    for reader, kind in readers:
        try:
            reader()
        except kind as error:
            print(str(error).replace("\n", " "))


@pytest.mark.parametrize(
    ("path", "why"),
    [("/dev/zero", "it is a device, not a file"), ("/dev/null", "it is a device, not a file"), (".", "is a directory")],
)
def test_devices_and_directories_are_no_scenarios(path: str, why: str) -> None:
    with pytest.raises(ScenarioError, match=why):
        load_scenario(path)


def test_a_file_that_is_too_large(tmp_path: Path) -> None:
    """A sparse one costs nothing to make, and would cost much to read."""
    for name in ("huge.yaml", "huge.toml"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(1 << 40)
    with pytest.raises(ScenarioError, match="it is larger than 4 MB"):
        load_scenario(tmp_path / "huge.yaml")
    with pytest.raises(Exception, match=r"it is larger than 0\.1 MB"):
        load_vehicle("huge.toml", tmp_path)
    with pytest.raises(OSError, match="larger than 1 MB"):
        read_file(tmp_path / "huge.yaml", 1_000_000)


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


def test_a_connection_file_that_is_a_pipe(tmp_path: Path) -> None:
    with live_directory(tmp_path) as run:
        (run / "connection.json").unlink()
        os.mkfifo(run / "connection.json")
        assert live_runs() == []


# --- too many faults, too many mistakes -----------------------------------------


def problems(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, "x.yaml")
    return str(caught.value)


def test_a_nemesis_of_millions_of_faults_is_refused_before_they_are_made() -> None:
    nemesis = "tick: 1 ms\nnemesis: {every: 1 ms, for: 10 ms, pick: [kill, {link: {'*': loss 40%}}]}\n"
    text = PAPER.replace("duration: 60 s ", "duration: 3600 s ").replace("tick: 10 ms ", "#") + nemesis
    began = process_time()
    said = problems(text)
    assert process_time() - began < 5.0
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


def test_thousands_of_mistakes_are_counted_and_the_first_shown() -> None:
    """Looking for the key that was meant took 7 ms for each of them."""
    began = process_time()
    said = problems(PAPER + "faults: [" + ",".join(["{a: 1}"] * 3000) + "]\n")
    assert process_time() - began < 10.0
    assert said.count("x.yaml:") == 200
    assert said.endswith(" problems; the first 200 are shown")


def test_absences_add_up_in_one_go() -> None:
    """One after another they took a time that grew with the square of their number, and give the same."""
    random_ = random.Random(1)
    absences = [Absence(random_.randint(1, 3), b := random_.randrange(900), b + 9) for _ in range(200)]
    one_by_one = Lives()
    for absence in absences:
        one_by_one.add(absence)
    at_once = Lives(absences)
    assert all(at_once.gaps(i) == one_by_one.gaps(i) != [] for i in (1, 2, 3))
    began = process_time()
    Lives(Absence(1, 20 * k, 20 * k + 9) for k in range(20_000))
    assert process_time() - began < 5.0  # it took 43 s


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
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with losses, a fault and a check."""
    words = ["duration=1 s", "network.links={'*': 'loss 30%'}", "faults=[{at: 300 ms, for: 200 ms, partition: halves}]"]
    words += ["checks={ledger: balanced, formation_error: {below: 1 mm}}"]
    options = Options(tmp_path_factory.mktemp("runs"), in_process=True, quiet=True)
    return load([execute(load_scenario("paper", words), options).directory])[0]


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


@pytest.mark.parametrize("seeds", [range(100), *slow(range(100, 250))])
def test_no_result_stops_a_report(seeds: range, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of every variant: the page is made, with the verdicts or with what is wrong where; and tables from the log."""
    monkeypatch.setattr("fleet.pictures.report.WHAT", {})
    monkeypatch.setattr("fleet.pictures.report.PER_RUN", set())
    path = run.log.path.parent / "result.json"
    whole = path.read_text()
    used = told = 0
    try:
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
    finally:
        path.write_text(whole)
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
def test_a_damaged_result_is_told_where(change: dict[str, Any], why: str, run: Run, tmp_path: Path) -> None:
    values = json.loads((run.log.path.parent / "result.json").read_text())
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


@pytest.mark.parametrize("text", ["", "[]", "null", "{", '{"endpoint": 5}', '{"run": "a/b"}', "[" * 100_000, "PIPE"])
def test_no_observe_file_crashes_a_recorder(text: str, tmp_path: Path) -> None:

    with live_directory(tmp_path) as run:
        if text == "PIPE":
            os.mkfifo(run / "observe.json")
        else:
            (run / "observe.json").write_text(text)
        done = invoke("record", "--run", run, "-o", tmp_path / "x.mcap")
    assert done.exit_code == 2
    assert "is no live run that is published: there is no usable observe.json" in " ".join(done.output.split())
