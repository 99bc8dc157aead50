"""`fleet view` and `fleet run --view`, as far as they go without a page."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from click.testing import CliRunner
from live_directory import live_directory
from traffic import log as log

from fleet.cli.main import cli
from fleet.execution.directory import OBSERVE
from fleet.replay.observed import Observed, write_observed
from fleet.view import server
from netem.errors import BusError
from netem.wire.open_bus import OpenBus


def refused(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["view", *map(str, arguments), "--no-open"])
    return result.exit_code, " ".join(result.output.split())


def test_without_nicegui_no_run_is_started_and_nothing_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "find_spec", lambda name: None)
    result = CliRunner().invoke(cli, ["run", "paper", "--view", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "pip install 'uuv-fleet[view]'" in " ".join(result.stderr.split())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("viewer", [[], ["--foxglove"]])
def test_options_that_are_for_the_other_kind_are_refused(
    viewer: list[str], log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the page as in Foxglove."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with live_directory(tmp_path / "runs", "paper") as directory:
        write_observed(directory / OBSERVE, Observed("tcp/127.0.0.1:1", "observer", "secret", "0123abcd"))
        for option in (["--rate", "2"], ["--loop"]):
            code, said = refused("paper", *option, *viewer)
            assert code == 2 and "--rate and --loop are for logs" in said
        given = tmp_path / "given.json"
        given.write_bytes((directory / OBSERVE).read_bytes())
        given.chmod(0o600)
        code, said = refused(given, "--control", *viewer)
        assert code == 2 and "only what an observer needs is at hand" in said


def test_no_port_and_no_connection_are_status_3(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the help says."""

    def nobody(*_: object) -> OpenBus:
        raise BusError("nobody answers")

    with socket.create_server(("127.0.0.1", 0)) as taken:
        code, said = refused(log, "--port", taken.getsockname()[1])
    assert code == 3 and "in use" in said
    given = tmp_path / "given.json"
    write_observed(given, Observed("tcp/127.0.0.1:1", "observer", "secret", "0123abcd"))
    monkeypatch.setattr(OpenBus, "connect", nobody)
    code, said = refused(given)
    assert code == 3 and "cannot be read: nobody answers" in said
