"""Options of `fleet replay` and `fleet record`, and files that are no logs."""

from __future__ import annotations

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
