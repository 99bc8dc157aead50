"""Options of `fleet replay` and `fleet record`, and files that are no logs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from traffic import PAGE, endpoint
from traffic import log as log

from fleet.cli.group import command_of
from fleet.cli.main import cli


def invoke(*arguments: Any) -> tuple[int, str]:
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    assert not isinstance(result.exception, Exception) or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


GARBAGE: dict[str, Callable[[Path], Any]] = {
    "cannot read": lambda path: None,
    "it is empty": lambda path: path.write_bytes(b""),
    "magic bytes": lambda path: path.write_text("no log at all"),
    "holds no message": lambda path: path.write_bytes(b"\x89MCAP0\r\n"),
    "holds no message: the file is cut": lambda path: path.write_bytes(
        b"\x89MCAP0\r\n\x06\xff\xff\xff\xff\xff\xff\xff\xff"
    ),
}


@pytest.mark.parametrize("words", GARBAGE)
def test_what_is_no_log_is_said_to_be_none(words: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    GARBAGE[words](path)
    code, said = invoke("replay", path)
    assert code == 2 and words in said and said.startswith("fleet: ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--topics", "uuv/1/stat"], "uuv/1/state"),
        (["--start", "3 s"], "the log ends at 2 s"),
        (["--end", "1"], "without a unit"),
        (["--start", "-1 s"], "0 or more"),
        (["--speed", "-1"], "expected 0 or"),
        (["--speed", "nan"], "expected 0 or"),
        (["--listen", "7447"], "tcp/127.0.0.1:7447"),
        (["--listen", "tcp/127.0.0.1:1", "--connect", "tcp/127.0.0.1:1"], "give either --connect or --listen"),
        (["--step"], "needs a terminal"),
    ],
)
def test_bad_options_of_replay(arguments: list[str], words: str, log: Path) -> None:
    code, said = invoke("replay", log, *arguments)
    assert code == 2 and words in said and "playing" not in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--key 'robot/**'"),
        (["--key", "a//b"], "no key expression"),
        (
            ["--run", "/nowhere"],
            "is no live run: there is no observe.json; the run must have been started with --publish",
        ),
        (["--key", "x", "-o", "/nowhere/x.mcap"], "No such file"),
        (["--key", "x", "-o", __file__], "exists already"),
    ],
)
def test_bad_options_of_record(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, said = invoke("record", *arguments)
    assert code == 2 and words in said
    assert list(tmp_path.iterdir()) == []


def test_nobody_there(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "netem.wire.open_bus.OpenBus.connect.__func__.__kwdefaults__", {"timeout_ms": 200}, raising=False
    )
    for arguments in (["replay", log], ["record", "-k", "x", "-o", tmp_path / "x.mcap"]):
        code, said = invoke(*arguments, "--connect", endpoint())
        assert code == 3 and "nobody answers" in said and ".rs:" not in said
    assert list(tmp_path.iterdir()) == []


def test_page_names_every_option() -> None:
    for name in ("replay", "record"):
        for option in command_of(name).params:
            long = [text for text in option.opts if text.startswith("--")]
            assert not long or long[0] in PAGE or long[0] == "--quiet" or long[0] == "--out", long
