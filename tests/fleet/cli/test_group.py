"""What ends a command in one line although no command has words for it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from fleet.cli.main import cli

LONG = "x" * 300  # longer than any file system takes


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", LONG], ["script", LONG], ["recover", LONG], ["certs", LONG], ["new", "controller", LONG],
    ],
    ids=lambda arguments: arguments[0],
)  # fmt: skip
def test_a_name_that_no_file_can_have(arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(cli, arguments)
    assert isinstance(result.exception, SystemExit), result.exception
    (line,) = result.stderr.splitlines()
    assert (result.exit_code, line.startswith("fleet: "), line.endswith(": File name too long")) == (2, True, True)


def test_a_disk_that_fails_is_not_the_users_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(5, os.strerror(5))

    monkeypatch.setattr("fleet.scenario.catalogue.list_scenarios", fail)
    result = CliRunner().invoke(cli, ["list"])
    assert (result.exit_code, result.stderr) == (3, "fleet: Input/output error\n")


def test_an_argument_with_bytes_that_are_no_text() -> None:
    result = CliRunner().invoke(cli, ["check", "paper", "--set", "name=\udcff"])
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 2 and "Traceback" not in result.output


@pytest.mark.parametrize("group", [(), ("new",), ("bench",), ("protocol",)])
def test_no_sentence_in_a_list_of_commands_is_cut(group: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, [*group, "--help"], env={"COLUMNS": "80"})
    listed = result.stdout.split("\nCommands:\n")[1].splitlines()
    assert [line for line in listed if line.endswith("...") or len(line) > 80] == []
