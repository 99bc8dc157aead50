"""Studies of a stack whose programs hear each other or not: real runs of `fleet netem`, a second each."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import loaded_once  # noqa: F401
import pytest
from live import Command, gone
from psutil import Process
from refusals import CommandRefused, type_command
from tool import invoke
from waiting import wait_for

import fleet
from fleet.addons.studies.failures import FailureFolder
from fleet.addons.studies.study import open_study
from fleet.errors import FleetError
from netem.private_folder import PrivateFolder

pytest_plugins = ["pytester"]
LIMIT_S = 60.0

# The one of m1 puts fifty numbers per second; the others print how many they have heard within 200 ms.
MEMBER = """\
import json, sys, time
import zenoh
config = zenoh.Config()
for key, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session:
    heard = []
    if sys.argv[2] != "m1":
        session.declare_subscriber("n", lambda sample: heard.append(time.monotonic()))
    while True:
        if sys.argv[2] == "m1":
            session.put("n", "1")
        print(f"heard={sum(at > time.monotonic() - 0.2 for at in heard)}", flush=True)
        time.sleep(0.02)
"""
STACK = {
    "title": "Who hears whom", "nodes": {"m1": {}, "m2": {}}, "duration": "1 s",
    "programs": {"m*": {"run": "python member.py {listen} {node}", "ready": {"line": "heard"}}},
    "signals": {"heard": {"of": "m2", "line": r"heard=(?P<value>\\d+)"}},
    "graph": {"edges": ["m1->m2"]},
    "network": {"links": {"*": "loss 0%"}},
    "checks": {
        "programs": "running", "punctual": {"late": "1 min"},
        "signal": {"name": "hears", "topic": "heard", "above": 1, "after": "900 ms"},
    },
}  # fmt: skip


def write(folder: Path, **sections: Any) -> None:
    (folder / "member.py").write_text(MEMBER)
    (folder / "stack.yaml").write_text(json.dumps(STACK | sections).replace("\\\\\\\\", "\\\\"), "utf-8")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the stack, in which commands are typed."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path)
    return tmp_path


def called(*words: object, status: int = 0) -> str:
    done = invoke(*words)
    assert done.exit_code == status, done.output
    return " ".join(done.output.split())


def test_a_sweep_has_its_rows_and_says_how_a_run_failed(here: Path) -> None:
    """With the words of its verdicts, and the command that makes it again; nothing of its runs is left."""
    said = called(
        "sweep",
        "stack.yaml",
        "--vary",
        "network.links.*.loss=0 %, 100 %",
        "--seeds",
        "1",
        "-o",
        "studies",
        "--workers",
        "2",
    )
    (directory,) = [path for path in (here / "studies").iterdir() if path.is_dir() and not path.is_symlink()]
    frame = open_study(directory).to_pandas()
    assert list(frame["passed"]) == [True, False]
    assert list(frame["check.programs"]) == [True, True]
    (kept,) = (directory / "logs").iterdir()
    # What was said in the last moment is under way at the end of the run, and not lost: the share may be below 1.
    links = json.loads((kept / "result.json").read_text("utf-8"))["ledger"].values()
    assert frame["loss_share"][0] == 0.0
    assert all(link["sent"] == sum(link["lost"].values()) + link.get("in_flight", 0) for link in links)
    assert links and not any(link.get("delivered") for link in links)
    lost, sent = sum(sum(link["lost"].values()) for link in links), sum(link["sent"] for link in links)
    assert frame["loss_share"][1] == lost / sent
    assert frame["digest"].isna().all()  # on the wall clock each log is another one
    assert "seed 1 failed at *.loss=100" in said and "hears: " in said
    assert f"fleet netem {kept / 'scenario.yaml'} --trust" in said


TEST = """
def test_it(fleet_runs):
    results = fleet_runs("stack.yaml", seeds=2, set=["network.links.*.loss={loss}"])
    assert [result.seed for result in results] == [1, 2]
"""


@pytest.mark.parametrize("loss", ["100 %", pytest.param("0 %", marks=pytest.mark.slow)])
def test_pytest_makes_runs_of_a_stack(loss: str, pytester: pytest.Pytester) -> None:
    """A failure has the line to paste, which makes that run again."""
    write(pytester.path)
    pytester.makepyfile(TEST.format(loss=loss))
    plugins = ("-p", "no:uuv-fleet", "-p", "fleet.addons.studies.pytest_plugin", "-p", "no:cacheprovider")
    result = pytester.runpytest_inprocess(*plugins)
    if loss == "0 %":
        result.assert_outcomes(passed=1)
        return
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*stack.yaml fails hears with seed 1, of 2 seeds", "*hears: *"])
    result.stdout.fnmatch_lines(["  fleet netem *stack-1-*/scenario.yaml --trust"])
    result.stdout.fnmatch_lines(["its log: *stack-1-*"])


@pytest.mark.parametrize(
    "words",
    [
        ["rare", "stack.yaml", "--check", "hears"],
        ["verify", "stack.yaml"],
        ["whatif", "stack.yaml"],
    ],
)
def test_what_cannot_run_a_stack_says_so_in_one_line(words: list[str], here: Path) -> None:
    with pytest.raises(CommandRefused) as caught:
        type_command(*words)
    assert caught.value.status == 2
    assert str(caught.value) and "Traceback" not in str(caught.value)
    assert sorted(path.name for path in here.iterdir()) == ["member.py", "stack.yaml"]


@pytest.mark.slow
def test_a_boundary_lies_between_a_loss_that_passes_and_one_that_fails(here: Path) -> None:
    said = called(
        "boundary", "stack.yaml", "--along", "network.links.*.loss=0 %..100 %", "--width", "0.4", "--seeds", "8",
        "-o", "studies",
    )  # fmt: skip
    assert "%" in said and "without result" not in said


FAULTS = {"faults": [
    {"at": "100 ms", "for": "100 ms", "partition": "m1 / m2"}, {"at": "0 s", "for": "1 s", "mute": "m1"},
    {"at": "300 ms", "for": "100 ms", "pause": "m2"},
]}  # fmt: skip


@pytest.mark.slow
def test_a_failure_is_found_made_small_kept_and_repeated(here: Path) -> None:
    """What is kept fails again from any folder; when it is mended, regress says so."""
    nemesis = {"every": "200 ms", "for": "750 ms", "pick": ["partition"]}
    write(here, nemesis=nemesis)
    said = called("search", "stack.yaml", "--budget", "2", "--keep", "failures", status=1)
    (failure,) = FailureFolder(here / "failures").failures()
    assert (failure.check, failure.least, failure.digest) == ("hears", True, "")
    assert "fleet netem failures/stack-hears.yaml" in said.replace(str(here) + "/", "")
    assert "as expected stack-hears.yaml: fails hears in 3 of 3 runs" in called(
        "regress", "failures", "--junit", "junit.xml"
    )
    (case,) = ElementTree.parse(here / "junit.xml").getroot().iter("testcase")
    assert case.find("failure") is None
    file = here / "failures" / "stack-hears.yaml"
    file.write_text(file.read_text().replace("above: 1", "above: -1"))
    assert "DIFFERS" in called("regress", "failures", status=1)
    assert "passes in 3 of 3 runs" in called("regress", "failures", "--accept")


@pytest.mark.slow
def test_shrink_leaves_what_two_of_three_runs_need(here: Path) -> None:
    write(here, **FAULTS)
    said = called("shrink", "stack.yaml")
    least = (here / "stack-least.yaml").read_text()
    assert "mute" in least and "partition" not in least and "pause" not in least, said


@pytest.mark.slow
def test_python_makes_a_sweep_of_a_stack(here: Path) -> None:
    study = fleet.sweep("stack.yaml", {"network.links.*.loss": ["0 %", "100 %"]}, seeds=1, out=here / "studies")
    assert list(study.to_pandas()["passed"]) == [True, False]
    again = study.rerun(1, 1, trust=True)
    assert not again.passed and (again.directory / "run.mcap").exists()  # type: ignore[operator]
    with pytest.raises(FleetError, match="--trust"):
        study.rerun(1, 1)


@pytest.fixture
def killed(here: Path) -> Iterator[Command]:
    """A sweep that has several runs under way."""
    write(here, duration="30 s")
    words = ["sweep", "stack.yaml", "--vary", "network.links.*.loss=0 %, 1 %", "--seeds", "3", "--workers", "2"]
    with Command(*words, own_group=True) as study:
        yield study


def test_nobody_is_left_when_a_study_is_killed(killed: Command) -> None:
    """Neither runs nor their programs; the next study takes away the folders."""
    family: dict[int, Process] = {}

    def programs() -> list[Process]:
        found = Process(killed.pid).children(recursive=True)
        family.update({one.pid: one for one in found})
        return [one for one in found if "member.py" in one.cmdline()]

    wait_for(lambda: killed.over or len(programs()) == 4, LIMIT_S, "the programs of two runs")
    assert not killed.over, killed.printed
    words = [word for one in family.values() if not gone(one) for word in one.cmdline()]
    folders = {Path(word).parent for word in words if word.endswith("/stack.yaml")}
    assert len(folders) == 2
    killed.send(signal.SIGKILL)
    killed.status()
    wait_for(lambda: all(map(gone, family.values())), LIMIT_S, "the end of all")
    PrivateFolder().close()  # as the next study makes one
    assert not [folder for folder in folders if folder.exists()]


def test_a_program_that_cannot_be_started_is_no_failure_of_the_network(here: Path) -> None:
    """It read as a border at the least loss. A typo costs no verdict, and is told once with the last words."""
    write(here, programs={"m*": {"run": "python mermber.py", "ready": {"line": "heard"}}})
    said = called("sweep", "stack.yaml", "--seeds", "2", "-o", "studies", "--workers", "1")
    (directory,) = [path for path in (here / "studies").iterdir() if path.is_dir() and not path.is_symlink()]
    assert open_study(directory).to_pandas()["passed"].isna().all()
    assert said.count("has no result") == 1 and "mermber.py" in said


@pytest.mark.parametrize(
    "words",
    [
        ["sweep", "stack.yaml", "--seeds", "1"],
        ["boundary", "stack.yaml", "--along", "network.links.*.loss=0 %..90 %"],
        ["search", "stack.yaml", "--episodes", "--set", "duration=30 s"],
        ["shrink", "stack.yaml", "--fault", "at 100ms kill m1"],
    ],
    ids=lambda words: words[0],
)
def test_a_cluster_is_refused_before_anybody_looks_for_it(
    words: list[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Programs run on this machine alone. A scheduler that is not there was looked for during ten seconds."""
    looked: list[Any] = []
    monkeypatch.setattr("fleet.addons.studies.engine.dask_engine", looked.append)
    with pytest.raises(CommandRefused) as caught:
        type_command(*words, "--scheduler", "tcp://127.0.0.1:1")
    assert "programs of a stack run on this machine alone: leave --scheduler out" in str(caught.value)
    assert not looked
