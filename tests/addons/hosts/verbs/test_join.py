"""Waiting for a join file and its run: what is told meanwhile, and how it ends. The run itself is in tests/system."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rich.console import Console as Terminal

from agents.join_file import JoinError, JoinFile, NotYetError
from fleet.addons.hosts.verbs import protocol
from fleet.terminal.status_line import StatusLine

FILE = JoinFile("unixsock-stream//tmp/x", "abc", 3, "agent-3", "secret")


@pytest.fixture
def patiently(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[object, list[str]]]:
    """Waits while a step happens each time that it would sleep; returns what came of it and what was told."""

    def wait(path: Path, attempt: Callable[[], object], steps: Iterator[object]) -> tuple[object, list[str]]:
        now = 0.0

        def sleep(seconds: float) -> None:
            nonlocal now
            now += seconds
            next(steps, None)

        monkeypatch.setattr(protocol.time, "sleep", sleep)
        monkeypatch.setattr(protocol.time, "monotonic", lambda: now)
        said = io.StringIO()
        line = StatusLine(Terminal(file=said, width=80), quiet=False)
        try:
            result: object = protocol.patiently(attempt, 10.0, path, line)
        except JoinError as error:
            result = error
        return result, [text for text in said.getvalue().splitlines() if text.startswith("waiting, ")]

    return wait


def test_a_file_that_comes_in_parts_and_with_wrong_modes(
    patiently: Callable[..., tuple[object, list[str]]], tmp_path: Path
) -> None:
    path = tmp_path / "join-3.json"

    def copied() -> Iterator[None]:
        yield
        path.write_text('{"endpoint": "unix')
        path.chmod(0o600)
        yield
        FILE.write(path)
        path.chmod(0o644)
        yield
        yield
        path.chmod(0o600)
        yield

    found, told = patiently(path, lambda: JoinFile.read(path), copied())
    assert found == FILE
    assert [text.removeprefix("waiting, at most 10 s: ").replace(str(path), "FILE")[:47] for text in told] == [
        "there is no FILE: a run writes it for each vehi",
        "FILE is no join file: not JSON (Input data was ",
        "FILE holds a secret and can be read by others (",
    ]


def test_the_time_ends(patiently: Callable[..., tuple[object, list[str]]], tmp_path: Path) -> None:
    path = tmp_path / "join-3.json"
    found, told = patiently(path, lambda: JoinFile.read(path), iter(()))
    assert isinstance(found, NotYetError)
    assert str(found).startswith(f"waited 10 s: there is no {path}")
    assert len(told) == 1


def test_a_run_that_is_over_is_waited_for_and_another_version_is_not(
    patiently: Callable[..., tuple[object, list[str]]], tmp_path: Path
) -> None:
    from agents.join import serve

    path = tmp_path / "join-3.json"
    JoinFile(f"unixsock-stream/{tmp_path}/gone", "abc", 3, "agent-3", "secret").write(path)
    found, told = patiently(path, lambda: serve(JoinFile.read(path), lambda _: None), iter(()))
    assert isinstance(found, NotYetError) and "run abc is over" in str(found)
    assert len(told) == 1 and "there is no router at" in told[0]

    path.write_text('{"version": "other"}')
    found, told = patiently(path, lambda: JoinFile.read(path), iter(()))
    assert isinstance(found, JoinError) and not isinstance(found, NotYetError)
    assert told == []
