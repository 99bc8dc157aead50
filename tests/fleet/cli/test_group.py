"""What ends a command in one line although no command has words for it."""

from __future__ import annotations

import os
import re
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner
from tool import invoke

from fleet.cli.group import command_of
from fleet.cli.main import cli
from fleet.cli.verbs import ELSEWHERE, FORMER, GROUPS, VERBS


def test_a_disk_that_fails_is_not_the_users_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(5, os.strerror(5))

    monkeypatch.setattr("fleet.scenario.catalogue.list_scenarios", fail)
    result = invoke("list")
    assert (result.exit_code, result.stderr) == (3, "fleet: Input/output error\n")


def test_an_argument_with_bytes_that_are_no_text() -> None:
    result = invoke("check", "paper", "--set", "name=\udcff")
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 2 and "Traceback" not in result.output


@pytest.mark.parametrize("group", [(), ("new",), ("protocol",)])
def test_no_sentence_in_a_list_of_commands_is_cut(group: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, [*group, "--help"], env={"COLUMNS": "80"})
    listed = result.stdout.split("\nCommands:\n" if group else "\nStart:\n")[1].splitlines()
    assert [line for line in listed if line.endswith("...") or len(line) > 80] == []


def test_every_command_stands_in_one_group_and_where_the_table_says() -> None:
    names = [name for verbs in GROUPS.values() for name in verbs]
    assert len(names) == len(set(names))
    modules = {verb.module for verb in VERBS.values()}
    offered = {name: command.name for name in VERBS for command in [command_of(name)]}
    assert offered == {name: name for name in VERBS}
    held = [command.name for module in modules for command in import_module(module).COMMANDS]
    assert sorted(held) == sorted(VERBS)


def test_words_of_other_tools_name_verbs_of_ours() -> None:
    assert not ELSEWHERE.keys() & VERBS.keys()
    for ours in ELSEWHERE.values():
        assert set(re.findall(r"fleet (\S+)", ours)) <= VERBS.keys(), ours


def test_a_former_verb_names_the_new_line() -> None:
    assert not FORMER.keys() & VERBS.keys()
    for old, now in FORMER.items():
        result = invoke(old, "x")
        assert (result.exit_code, result.stdout) == (2, "")
        assert f"fleet {old} is now: {now}\n" in result.stderr
        assert now.split()[1] in VERBS


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["run", "paper", "duration=5s"], "a change of the scenario is --set 'duration=5s'"),
        (["sweep", "paper", "network.links.*.loss=10%"], "is --set 'network.links.*.loss=10%'"),
        (["run", "paper", "--dry-run"], "fleet check SCENARIO judges a scenario without a run"),
        (["run", "paper", "--seeds", "3"], "fleet sweep SCENARIO --seeds 20"),
        (["scenarios"], "use fleet list"),
        (["help", "rnu"], 'did you mean "run"?'),
        (["run", "election", "--set", "agent.parameters.usee_s=3"], 'did you mean "lease_s"? its parameters: '),
    ],
)
def test_what_other_tools_call_otherwise_is_named(words: list[str], hint: str) -> None:
    result = invoke(*words)
    assert result.exit_code == 2
    assert hint in result.stderr


def test_help_is_a_command_too() -> None:
    assert invoke("help").stdout == invoke("--help").stdout
    assert invoke("help", "run").stdout == invoke("run", "--help").stdout


def test_a_folder_that_was_removed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    result = invoke("info")
    assert result.exit_code != 0
    assert "the folder that you are in has been removed" in result.stderr
