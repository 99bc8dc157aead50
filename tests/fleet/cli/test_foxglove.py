"""`fleet view --foxglove` as a user meets it."""

from __future__ import annotations

import re
import signal
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from foxglove_client import viewer
from traffic import Command
from traffic import log as log

from fleet.cli.foxglove import _who
from fleet.cli.main import cli


def invoke(*arguments: Any) -> tuple[int, str]:
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    assert not isinstance(result.exception, Exception) or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, " ".join(result.output.split())


def test_a_log_is_served_until_ctrl_c(log: Path) -> None:
    """Where, and who can watch, is said; viewers see the connection end."""
    with Command("view", "--foxglove", log, "--rate", "5") as server:
        server.until("how it is played")
        found = re.search(r"ws://127\.0\.0\.1:\d+", server.printed)
        assert found is not None and "whoever is on this host" in server.printed
        with viewer(found[0]) as watcher:
            watcher.subscribe("uuv/1/state")
            watcher.until(lambda: watcher.messages)
            server.send(signal.SIGINT)
            watcher.until_closed()
        assert server.status() == 130 and "Traceback" not in server.printed, server.printed


def test_without_the_sdk_a_line_says_what_to_install(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.cli.foxglove.find_spec", lambda name: None)
    code, said = invoke("view", "--foxglove", log)
    assert code == 2 and "pip install 'uuv-fleet[foxglove]'" in said


@pytest.mark.parametrize(
    ("host", "words"),
    [
        ("127.0.0.1", "whoever is on this host"),
        ("localhost", "whoever is on this host"),
        ("::1", "whoever is on this host"),
        ("0.0.0.0", "warning: whoever reaches 0.0.0.0"),
        ("sea.example", "warning: whoever reaches sea.example"),
    ],
)
def test_who_can_watch_is_said(host: str, words: str) -> None:
    assert _who(host).startswith(words)
