"""`fleet view`, on a page or with `--foxglove`, and `fleet run --view`, as far as they go without a page."""

from __future__ import annotations

import re
import signal
import socket
from pathlib import Path

import pytest
from foxglove_client import viewer
from live_directory import live_directory
from tool import invoke
from traffic import Command
from traffic import log as log

from fleet.addons.page import server
from fleet.addons.page.verbs.foxglove import _who
from fleet.execution.directory import OBSERVE
from fleet.replay.observed import Observed, write_observed
from netem.errors import BusError
from netem.wire.open_bus import OpenBus


def refused(*arguments: object) -> tuple[int, str]:
    result = invoke("view", *arguments, "--no-open")
    return result.exit_code, " ".join(result.output.split())


def test_without_nicegui_no_run_is_started_and_nothing_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "find_spec", lambda name: None)
    result = invoke("run", "paper", "--view", "--out", tmp_path)
    assert result.exit_code == 2
    assert "pip install 'uuv-fleet[view]'" in " ".join(result.stderr.split())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("shown", [[], ["--foxglove"]])
def test_options_that_are_for_the_other_kind_are_refused(
    shown: list[str], log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the page as in Foxglove."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with live_directory(tmp_path / "runs", "paper") as directory:
        write_observed(directory / OBSERVE, Observed("tcp/127.0.0.1:1", "observer", "secret", "0123abcd"))
        for option in (["--rate", "2"], ["--loop"]):
            code, said = refused("paper", *option, *shown)
            assert code == 2 and "--rate and --loop are for logs" in said
        given = tmp_path / "given.json"
        given.write_bytes((directory / OBSERVE).read_bytes())
        given.chmod(0o600)
        code, said = refused(given, "--control", *shown)
        assert code == 2 and "only what an observer needs is at hand" in said


def test_no_port_and_no_connection_are_status_3(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the help says."""

    def nobody(*_: object) -> OpenBus:
        raise BusError("nobody answers")

    with socket.create_server(("127.0.0.1", 0)) as taken:
        code, said = refused(log, "--port", port := taken.getsockname()[1])
    assert code == 3 and re.search(f"port {port} of 127.0.0.1 .* in use.*--port", said)
    given = tmp_path / "given.json"
    write_observed(given, Observed("tcp/127.0.0.1:1", "observer", "secret", "0123abcd"))
    monkeypatch.setattr(OpenBus, "connect", nobody)
    code, said = refused(given)
    assert code == 3 and "cannot be read: nobody answers" in said


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
    monkeypatch.setattr("fleet.addons.page.verbs.foxglove.find_spec", lambda name: None)
    refused = invoke("view", "--foxglove", log)
    assert refused.exit_code == 2 and "pip install 'uuv-fleet[foxglove]'" in " ".join(refused.stderr.split())


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
