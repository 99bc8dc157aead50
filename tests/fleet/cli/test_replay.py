"""Options of `fleet replay` and `fleet record`, and files that are no logs."""

from __future__ import annotations

from pathlib import Path

import pytest
from tool import invoke
from traffic import PAGE, endpoint
from traffic import log as log

from fleet.cli.group import command_of


def test_nobody_there(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "netem.wire.open_bus.OpenBus.connect.__func__.__kwdefaults__", {"timeout_ms": 200}, raising=False
    )
    for arguments in (["replay", log], ["record", "-k", "x", "-o", tmp_path / "x.mcap"]):
        refused = invoke(*arguments, "--connect", endpoint())
        assert refused.exit_code == 3 and "nobody answers" in refused.output and ".rs:" not in refused.output
    assert list(tmp_path.iterdir()) == []


def test_page_names_every_option() -> None:
    for name in ("replay", "record"):
        for option in command_of(name).params:
            long = [text for text in option.opts if text.startswith("--")]
            assert not long or long[0] in PAGE or long[0] == "--quiet" or long[0] == "--out", long
