"""`fleet search` as people type it."""

from __future__ import annotations

import json
import re
from functools import partial
from math import inf
from pathlib import Path
from xml.etree import ElementTree

import pytest
from small_scenario import SMALL
from study_engine import made_here
from tool import invoke

from fleet.addons.studies.verbs.search import _seed_pieces
from fleet.execution.whole_run import run

RANDOM = """\
nemesis: {every: 400 ms, for: 300 ms, pick: [mute, deaf, {wrench: {vehicles: 1, force: 400 0 0 N}}]}
checks: {formation_error: {below: 4.6 m, after: 800 ms}, tumbled: waived}
"""
CALM = "checks.formation_error.below=99 m"
call = partial(invoke, "search")


@pytest.fixture(autouse=True)
def random_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_here(tmp_path, monkeypatch, SMALL + RANDOM)


def test_the_first_seed_that_fails_is_made_less() -> None:
    result = call("small.yaml", "--budget", "4")
    assert result.exit_code == 1, result.output
    assert "seed 2 fails formation_error, the first one from 1 on" in result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("No fault is needed. Then formation_error fails. See why: fleet run small-least.yaml;")
    assert lines[-1] == "small-least.yaml"
    assert not run("small-least.yaml").passed


def test_as_a_document() -> None:
    again = call("small.yaml", "--budget", "4", "--json")
    document = json.loads(again.stdout)
    assert (document["seed"], document["most_failures"]) == (2, None)
    assert document["least"]["file"] == "small-least.yaml"
    assert document["least"]["before"]["faults"] >= document["least"]["after"]["faults"]


def test_none_that_fails_is_said_with_a_bound() -> None:
    result = call("small.yaml", "--budget", "3", "--set", CALM)
    assert result.exit_code == 0, result.output
    said = "none of 3 runs fails a check: at most 63 % of such runs do, with 95 % confidence"
    assert " ".join(result.stdout.split()) == said
    document = json.loads(call("small.yaml", "--budget", "3", "--set", CALM, "--json").stdout)
    assert (document["seed"], document["runs"], document["least"]) == (None, 3, None)
    assert document["most_failures"] == pytest.approx(0.6316, abs=1e-4)


def test_with_a_folder_it_goes_on_and_regress_runs_what_is_kept() -> None:
    sometimes = "checks.signal={name: far, topic: state.z, above: 99 m, sometimes: true}"
    result = call("small.yaml", "--budget", "4", "--keep", "kept", "--junit", "j.xml")
    assert result.exit_code == 1, result.output
    assert "formation_error: first with seed 2; " in result.stdout
    assert "\nfleet run kept/small-formation_error.yaml --seed 2  # fails formation_error, sha256 " in result.stdout
    assert ElementTree.parse("j.xml").getroot().attrib["failures"] == "1"
    again = invoke("regress", "kept", "--junit", "r.xml", "--json")
    assert (again.exit_code, json.loads(again.stdout)["as_expected"]) == (0, True)
    (case,) = ElementTree.parse("r.xml").getroot().iter("testcase")
    assert case.attrib["name"] == "small-formation_error.yaml" and "fleet run" in (case.findtext("system-out") or "")
    path = Path("kept/small-formation_error.yaml")
    path.write_text(path.read_text("utf-8").replace("below: 4.6 m", "below: 99 m"), "utf-8")
    differs = invoke("regress", "kept")
    assert differs.exit_code == 1 and "DIFFERS small-formation_error.yaml: passes; expected: fails formation_error" in (
        " ".join(differs.stdout.split())
    )
    assert invoke("regress", "kept", "--accept").exit_code == 0
    assert invoke("regress", "kept").exit_code == 0
    little = call("small.yaml", "--budget", "2", "--set", CALM, "--set", sometimes)
    assert little.exit_code == 0
    assert "no failure found, but the runs did not get everywhere: far was reached in none of 2 runs" in " ".join(
        little.stdout.split()
    )


@pytest.mark.parametrize(
    ("checks", "verdict"),
    [("formation_error: {below: 99 m}", "passes"), ("consensus_error: {below: 1 mm}", "fails consensus_error")],
)
def test_what_is_accepted_is_shown_as_accepted_once(checks: str, verdict: str, tmp_path: Path) -> None:
    """The table and JUnit's file say what changed; neither says that a run which is as expected now differs."""
    call("small.yaml", "--budget", "4", "--keep", "kept")
    kept = tmp_path / "kept" / "small-formation_error.yaml"
    text, found = re.subn(r"^checks:\n(  .*\n)*", "", kept.read_text("utf-8"), flags=re.MULTILINE)
    assert found == 1
    kept.write_text(f"{text}checks: {{{checks}, tumbled: waived}}\n", "utf-8")
    accepted = invoke("regress", "kept", "--accept", "--junit", "junit.xml")
    assert accepted.exit_code == 0
    said = " ".join(accepted.stdout.split())
    assert said == f"accepted small-formation_error.yaml: {verdict} 1 of 1 are as expected"
    assert ElementTree.parse("junit.xml").getroot().attrib["failures"] == "0"
    index = (tmp_path / "kept" / "failures.json").read_text("utf-8")
    assert f"  # {verdict}, sha256 " in index
    again = invoke("regress", "kept", "--accept")
    assert (again.exit_code, again.stdout.split()[:2]) == (0, ["as", "expected"])
    assert (tmp_path / "kept" / "failures.json").read_text("utf-8") == index


@pytest.mark.parametrize(
    ("interrupted", "asked", "message"),
    [
        (
            "fleet.addons.studies.search.search",
            (),
            "no check had failed; fleet search small.yaml --keep DIR can be stopped and",
        ),
        ("fleet.addons.studies.search.search", ("--keep", "kept"), "the same command goes on with what kept has"),
        (
            "fleet.addons.studies.shrink.Shrinker.shrink",
            (),
            "before the failing run was made smaller, so small-least.yaml is",
        ),
    ],
)
def test_what_ctrl_c_leaves_is_said(
    interrupted: str, asked: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(interrupted, interrupt)
    assert message in call("small.yaml", "--budget", "4", *asked).stderr
    assert not list(Path().glob("*-least.yaml"))


@pytest.mark.parametrize(
    ("budget", "runs", "shown"),
    [
        ((200.0, inf), 0, ["0 of 200 seeds", "", ""]),
        ((200.0, inf), 50, ["50 of 200 seeds", "at most 0:00:30 left", "5 seeds/s"]),
        ((inf, 60.0), 50, ["50 seeds", "at most 0:00:50 left", "5 seeds/s"]),
        ((inf, 5.0), 50, ["50 seeds", "at most 0:00:00 left", "5 seeds/s"]),
    ],
)
def test_a_search_shows_how_far_it_is(
    budget: tuple[float, float], runs: int, shown: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It showed neither a total nor the time that is left."""
    now = iter([100.0, 110.0])
    monkeypatch.setattr("fleet.addons.studies.verbs.search.time.monotonic", lambda: next(now))
    line = _seed_pieces(budget)
    assert [piece.forms[0] for piece in line(None, "seeds", runs)] == shown  # type: ignore[arg-type]
