"""What `--json` prints: one struct per command, a page made of the structs, and real documents that fit them."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import TypeVar

import msgspec
import pytest
from click.testing import Result as Invoked
from failing_laws import failing
from failing_laws import module as module
from repository import ROOT
from small_scenario import SMALL
from tool import commands, invoke

from fleet.addons.studies.catalogue import shipped_studies
from fleet.addons.studies.explanation.what_if import OtherCommands
from fleet.cli import listing
from fleet.cli.documents.failure import FailedCommand
from fleet.cli.documents.logs import Checked, Compared
from fleet.cli.documents.output import print_document
from fleet.cli.documents.page import DOCUMENTS, page, schema
from fleet.execution.supervisor import Supervisor
from fleet.logs.info import Info
from fleet.mcap.reader import digest
from fleet.repeat.verify import Verification
from fleet.result.result import Result
from fleet.scenario.catalogue import shipped_scenarios

S = TypeVar("S", bound=msgspec.Struct)
QUICK = ["paper", "--in-process", "--duration", "300 ms"]
NO_CHECKS = ["--set", "checks={}"]
RUNAWAY = ["--set", "faults=[{at: 100 ms, wrench: {force: 1e200 1e200 0 N}}]", "--set", "on_death=abort"]


def printed(struct: type[S], result: Invoked) -> S:
    """The one document on stdout; it has no field that the struct does not have."""
    found = msgspec.json.decode(result.stdout, type=struct, dec_hook=lambda kind, text: kind(text))
    assert json.loads(msgspec.json.encode(found, enc_hook=str)) == json.loads(result.stdout)
    return found


def failure(*arguments: str | Path) -> FailedCommand:
    result = invoke(*arguments)
    found = printed(FailedCommand, result)
    assert found.exit == result.exit_code
    return found


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of a run that passed."""
    out = tmp_path_factory.mktemp("runs")
    assert invoke("run", *QUICK, *NO_CHECKS, "--out", out, "-q").exit_code == 0
    return (out / "latest").resolve()


# --- the structs and their page ----------------------------------------------


def test_every_command_with_json_has_its_struct() -> None:
    asked = {name for name, command in commands().items() if any(p.name == "as_json" for p in command.params)}
    assert asked == set(DOCUMENTS) - {"check LOG"}


def test_the_page_is_current() -> None:
    """docs/reference/json.md is what `fleet about --schemas` prints now."""
    shown = (ROOT / "docs" / "reference" / "json.md").read_text("utf-8")
    assert shown == page() == invoke("about", "--schemas").stdout


def test_every_record_is_explained_and_has_its_section() -> None:
    text, documents = page(), {document.__name__ for document in [*DOCUMENTS.values(), FailedCommand]}
    assert all(f"\n## fleet {command}\n" in text for command in DOCUMENTS)
    for name, record in (row for command in DOCUMENTS for row in schema(command)["$defs"].items()):
        assert record["description"].endswith("."), name
        assert not record["description"].startswith(f"{name}("), f"{name} has no docstring of its own"
        for field, described in record["properties"].items():
            assert described.get("description", ".").endswith("."), f"{name}.{field}"
            assert f"`{field}`" in text
        assert name in documents or f"\n### {name}\n" in text


def test_no_two_records_of_the_page_have_one_name() -> None:
    headings = [line for line in page().splitlines() if line.startswith("#")]
    assert len(headings) == len(set(headings))


def test_the_schema_of_one_command() -> None:
    result = invoke("about", "--schemas", "verify")
    assert json.loads(result.stdout) == json.loads(json.dumps(schema("verify")))
    assert [option["$ref"] for option in schema("verify")["anyOf"]] == ["#/$defs/Verification", "#/$defs/FailedCommand"]
    assert json.loads(invoke("about", "--schemas", "check", "LOG").stdout)["anyOf"] == schema("check LOG")["anyOf"]
    refused = invoke("about", "--schemas", "export")
    assert (refused.exit_code, "export has no --json; there are " in refused.stderr) == (2, True)


def test_numbers_that_are_not_finite_and_names_that_are_no_text_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    class Document(msgspec.Struct):
        number: float
        name: str

    for name in ("a", "a\udcff"):
        print_document(Document(float("inf"), name))
        assert json.loads(capsys.readouterr().out) == {"number": None, "name": name}


# --- fleet list, fleet check ----------------------------------------------------


def test_list() -> None:
    result = invoke("list", "--json")
    found = printed(listing.document(), result)
    assert [row.name for row in found.scenarios] == shipped_scenarios()
    assert [row.name for row in found.studies] == shipped_studies()


def test_check() -> None:
    found = printed(Checked, invoke("check", "partition-heal", "--json"))
    assert (found.valid, found.name, found.vehicles, found.duration_s) == (True, "partition-heal", 4, 150.0)
    assert [(fault.id, fault.from_s, fault.to_s) for fault in found.faults] == [("split", 10.0, 30.0)]
    assert found.theory.parts == [[1, 2, 3, 4]]
    assert (found.warnings, found.not_checked) == ([], [])


def test_check_of_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pwd.getpwall", list)  # nobody else uses this machine
    found = printed(Checked, invoke("check", ROOT / "docs" / "examples" / "election_stack" / "stack.yaml", "--json"))
    assert (found.valid, found.vehicles, found.links, found.warnings) == (True, 5, 10, [])


def test_check_says_the_limits_that_it_prints_in_words() -> None:
    found = printed(Checked, invoke("check", "paper", "--json"))
    words = invoke("check", "paper").stdout
    assert f"stable below {found.theory.gain_limit_per_s:.4g} 1/s. Above, " in words
    assert f"K is optimised, {found.theory.gain_per_s:.4g} 1/s at most" in words
    assert f"stable up to {found.theory.settled_delay_limit_s:.4g} s. Above, " in words
    assert found.theory.delay_limit_s == 0.0
    assert "while K is at its largest, 2 1/s: unstable, even without delay" in words


def test_check_of_a_fleet_for_which_theory_has_no_limits() -> None:
    cut = invoke("check", "paper", "--set", "graph={edges: {1->2: 1}, reference: 1}", "--set", "checks={}", "--json")
    found = printed(Checked, cut).theory
    assert (found.unreached, found.not_computed) == ([3, 4], "not every vehicle is reached")
    assert (found.gain_limit_per_s, found.delay_limit_s) == (None, None)
    ideal = printed(Checked, invoke("check", "ideal", "--json"))
    assert (ideal.ideal, ideal.theory.delay_limit_s) == (True, None)
    assert "warning: no chain of links leads" in cut.stderr


def test_check_with_a_law_that_may_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stranger.py").write_text(failing(10**6, "pass"))
    file = tmp_path / "s.yaml"
    file.write_text(SMALL + "controller: stranger:Law\n")
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    found = printed(Checked, invoke("check", file, "--json"))
    assert [problem.key for problem in found.not_checked] == ["controller.law"]


def test_check_of_a_wrong_scenario_lists_every_problem(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(SMALL.replace("vehicles: 3", "vehicles: three") + "tic: 10 ms\nstall_timeout: 3\n")
    found = failure("check", file, "--json", "--set", "seed=x")
    assert found.exit == 2
    shown = [(problem.file, problem.line, problem.key) for problem in found.problems]
    assert shown == [
        (str(file), 2, "vehicles"),
        (str(file), 9, "tic"),
        (str(file), 10, "stall_timeout"),
        ("--set seed=x", 1, "seed"),
    ]
    assert found.problems[1].hint == 'did you mean "tick"?'
    assert found.error.endswith("4 problems")


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(SMALL.replace("velocity: 0.5 0 0 m/s", "speed: 1 m/s"))
    assert "reference.velocity" in [problem.key for problem in failure("check", file, "--json").problems]


# --- fleet run ------------------------------------------------------------------


def test_run(tmp_path: Path) -> None:
    result = invoke("run", *QUICK, *NO_CHECKS, "--net", "1->2 loss 50%", "--out", tmp_path, "--json")
    found = printed(Result, result)
    directory = (tmp_path / "latest").resolve()
    assert (found.run, found.directory) == (directory.name, directory)
    assert (found.status, found.exit, found.sim_s) == ("pass", 0, 0.3)
    assert found.digest == digest(directory / "run.mcap")
    assert found.ledger["1->2"].sent == 3
    # One truth: all but where it is stands in result.json, under the same names.
    values = json.loads(result.stdout)
    assert values == {"run": found.run, "directory": str(found.directory)} | json.loads(
        (directory / "result.json").read_text()
    )


def test_run_that_fails_a_check(tmp_path: Path) -> None:
    result = invoke("run", *QUICK, "--out", tmp_path, "--json")
    found = printed(Result, result)
    assert (result.exit_code, found.exit, found.status) == (1, 1, "check_failed")
    assert [one.check for one in found.checks if not one.passed] == ["formation_error"]
    assert "not judged  formation_error" in result.stderr


def test_run_that_breaks(tmp_path: Path) -> None:
    result = invoke("run", *QUICK, *NO_CHECKS, *RUNAWAY, "--out", tmp_path, "--json")
    found = printed(Result, result)
    assert (result.exit_code, found.exit, found.status) == (3, 3, "broken")
    assert "vehicle 1, tick " in found.reason
    assert f"fleet: {found.reason}" in result.stderr


def test_run_that_cannot_begin(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert failure("run", "papre", "--json").problems[0].message.startswith("there is no such shipped scenario")
    assert failure("run", "--json").error.startswith("no scenario given: name one")
    assert failure("run", "paper", "--seed", "x", "--json").exit == 2  # the mistake stands before --json
    assert failure("run", "paper", "--show-config", "--json").error.startswith("--show-config prints YAML")
    assert "cannot make a run directory" in failure("run", *QUICK, "--out", tmp_path / "file", "--json").error
    nothing = invoke("run", "paper", "--jsn")
    assert (nothing.exit_code, nothing.stdout) == (2, "")


@pytest.mark.slow
def test_run_on_a_wall_clock_and_published(tmp_path: Path) -> None:
    result = invoke("run", "paper", "--duration", "1 s", "--clock", "real", "--max-missed", "100%", *NO_CHECKS,
                    "--publish", "--out", tmp_path, "--json", "-q")  # fmt: skip
    found = printed(Result, result)
    assert "warning: --clock real is deprecated" in result.stderr and "fleet netem" in result.stderr
    assert found.published is not None
    assert (found.timing.clock, list(found.timing.vehicles)) == ("real", ["1", "2", "3", "4"])


def test_run_in_which_an_agent_dies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    poll, killed = Supervisor.poll, list[int]()

    def killing(self: Supervisor) -> None:
        if self._journal.framed > 0 and not killed:  # in the run, and long before its end
            # Not `is_alive`: it would race with the thread that watches, and one of the two reads no exit status.
            killed.append(self._children.by_role["agent-3"].pid)
            os.kill(killed[0], signal.SIGKILL)
        poll(self)

    monkeypatch.setattr(Supervisor, "poll", killing)
    result = invoke("run", "paper", "--duration", "10 s", *NO_CHECKS, "--out", tmp_path, "--json", "-q")
    found = printed(Result, result)
    assert (result.exit_code, found.exit) == (1, 1), (found.reason, result.stderr)
    assert found.deaths == {"3": ["was killed by SIGKILL"]}


# --- fleet verify, diff, info --------------------------------------------------------


def test_verify(recorded: Path) -> None:
    result = invoke("verify", recorded, "--json")
    found = printed(Verification, result)
    assert (result.exit_code, found.reproduced, found.difference) == (0, True, None)
    assert (found.path, found.until_s) == (recorded / "run.mcap", 0.3)


def test_verify_of_a_log_that_is_not_reproduced(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.recorder.tick_messages.quaternion", lambda *_: (0.6, 0.0, 0.0, 0.8))
    result = invoke("verify", recorded, "--json")
    found = printed(Verification, result)
    assert (result.exit_code, found.reproduced) == (1, False)
    assert found.difference.a == found.difference.b
    assert (found.difference.number, found.difference.fields[0].field) == (0, "pose.orientation.x")


def test_diff(recorded: Path, tmp_path: Path) -> None:
    same = printed(Compared, invoke("diff", recorded, recorded, "--json"))
    assert (same.same, same.within, same.first, same.signals) == (True, True, None, [])
    invoke("run", *QUICK, *NO_CHECKS, "--net", "1->2 corrupt 100%", "--duration", "200 ms", "--out", tmp_path)
    result = invoke("diff", recorded, tmp_path / "latest", "--json")
    found = printed(Compared, result)
    assert (result.exit_code, found.same, found.within) == (1, False, False)
    assert found.first.a == found.first.b
    assert {f"{found.first.a.topic}.{row.field}" for row in found.first.fields} <= {s.signal for s in found.signals}
    assert found.others["link/1-2.corrupted"] == 2
    assert found.only_a["uuv/1/nav"] == 10
    assert "attachment scenario.yaml" in found.besides


def test_whatif(recorded: Path) -> None:
    same = printed(OtherCommands, invoke("whatif", recorded, "--agent", "3", "--json"))
    assert (same.identical, same.first_s, same.samples) == (True, None, 30)
    other = printed(OtherCommands, invoke("whatif", recorded, "--agent", "3", "--controller", "bsmc", "--json"))
    assert max(component.max or 0.0 for component in other.components.values()) > 0.0


def test_info(recorded: Path) -> None:
    found = printed(Info, invoke("info", recorded, "--json"))
    assert found.messages == sum(count for _, count in found.topics.values())
    assert found.run["scenario"] == "paper"


def test_a_log_that_is_none_is_a_failure(tmp_path: Path) -> None:
    for command in (["verify"], ["info"], ["diff", tmp_path]):
        assert "cannot read" in failure(*command, tmp_path / "nothing.mcap", "--json").error
