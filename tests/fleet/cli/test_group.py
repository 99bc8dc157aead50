"""What ends a command in one line although no command has words for it."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from tool import invoke

from fleet.addon import installed_addons
from fleet.cli.group import command_of
from fleet.cli.main import cli
from fleet.cli.verbs import HINTS, OTHER_OPTIONS, every_verb, headings, hint_for


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
    names = [name for verbs in headings().values() for name in verbs]
    assert len(names) == len(set(names)) > 30
    assert {name: command_of(name).name for name in names} == {name: name for name in names}


def test_words_of_other_tools_name_verbs_of_ours() -> None:
    theirs = HINTS.keys() | {word for addon in installed_addons().addons.values() for word in addon.hints}
    assert len(theirs) > 35 and not theirs & every_verb().keys()
    for word in theirs:
        ours = hint_for(word)
        assert set(re.findall(r"fleet ([a-z0-9-]+)", ours)) <= every_verb().keys(), ours
        result = invoke(word, "x")
        assert (result.exit_code, result.stdout) == (2, "")
        assert f"; use {ours}\n" in result.stderr


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


def test_an_option_that_there_is_not_names_one_of_the_command_that_does_it() -> None:
    """`boundary --runs` was taken for a mistyped `--trust`."""
    others = [
        *OTHER_OPTIONS.items(),
        *(each for one in installed_addons().addons.values() for each in one.other_options.items()),
    ]
    assert {(verb, "--runs") for verb in ("sweep", "boundary", "search", "shrink")} <= {key for key, _ in others}
    for (verb, option), hint in others:
        mine = {known for parameter in command_of(verb).params for known in parameter.opts}
        assert option not in mine
        told = invoke(verb, option, "3").stderr
        assert hint in " ".join(told.split()) and "Did you mean" not in told
        named = hint.split()[0]
        assert named in mine or named == "fleet"
