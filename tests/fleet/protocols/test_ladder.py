"""The ladder for learners: each step's check fails with what the page gives, and passes with the solution."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from marks import slow
from repository import ROOT

from fleet.execution.whole_run import run
from fleet.result.result import Result

PAGE = (ROOT / "docs/guide/protocols/index.md").read_text("utf-8")
BLOCKS = re.findall(r"```(?:python|yaml)\n(.*?)```", PAGE, re.S)


LISTENS = {  # task 1 of step 3
    "        self._newest = {}": "        self._begin = None\n        self._newest = {}",
    "        leader = min(": "        self._begin = nav.tick if self._begin is None else self._begin\n"
    "        leader = 0 if nav.tick - self._begin < 300 else min(",
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the files that the page gives, and what becomes of two of them in the first tasks."""
    folder = tmp_path_factory.mktemp("ladder")
    given = {named[1]: block for block in BLOCKS if (named := re.match(r"# (\w+\.\w+)\n", block))}
    (solution,) = [block for block in BLOCKS if block.startswith("        for delivery")]
    given["greeting.py"] = given["hello.py"].replace("        ...  # step 1\n", solution)
    given["greeting.yaml"] = given["hello.yaml"].replace("hello:", "greeting:")
    given["listening.py"] = given["my_election.py"]
    for old, new in LISTENS.items():
        assert old in given["listening.py"]
        given["listening.py"] = given["listening.py"].replace(old, new)
    for name, text in given.items():
        (folder / name).write_text(text, "utf-8")
    return folder


@pytest.fixture(autouse=True)
def ladder(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)


def failed(result: Result) -> dict[str, str]:
    assert result.reason == "", result.reason
    return {verdict.check: verdict.found for verdict in result.checks if not verdict.passed}


def test_hello() -> None:
    assert set(failed(run("hello.yaml"))) == {"control.heard"}
    assert failed(run("greeting.yaml")) == {}


@pytest.mark.parametrize("changes", [{}, *slow({"network.links": "{}", "faults": []})])
def test_the_average_of_the_page_is_wrong(changes: dict[str, object]) -> None:
    """Also without loss, as the page says; the scenario's own agent passes: tests/golden/test_gallery.py."""
    result = run(
        "average", set={"agent": "my_average:MyAverage", "duration": "8 s", "log.every": "10 ticks", **changes}
    )
    assert set(failed(result)) == {"TrueMean"}


@pytest.mark.parametrize(
    ("agent", "changes", "at_s"),
    [
        ("my_election", {"duration": "2 s"}, 0.0),
        ("listening", {"duration": "8 s", "faults": [{"at": "4 s", "partition": "1,2 / 3,4,5"}]}, 7.0),
    ],
    ids=["at the start", "under partition"],
)
def test_the_election_of_the_page_has_two_leaders(agent: str, changes: dict[str, object], at_s: float) -> None:
    """The scenario's own agent never has: tests/golden/test_gallery.py."""
    found = failed(run("election", set={"agent": f"{agent}:MyElection", "log.every": "5 ticks", **changes}))
    assert float(re.findall(r"at ([\d.]+) s", found["AtMostOneLeader"])[0]) == pytest.approx(at_s, abs=0.2)
