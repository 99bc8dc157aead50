"""What a shell is offered while a command for a live run is typed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from live_directory import live_directory
from tool import invoke

from fleet.cli.main import cli
from fleet.scenario.loading import load_scenario
from netem.errors import BusError


def offered(monkeypatch: pytest.MonkeyPatch, *words: str, shell: str = "zsh") -> list[str]:
    """The words that complete the last one."""
    monkeypatch.setenv("COMP_WORDS", " ".join(["fleet", *(w if w else "''" for w in words)]))
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    monkeypatch.setenv("_FLEET_COMPLETE", f"{shell}_complete")
    lines = CliRunner().invoke(cli, prog_name="fleet", complete_var="_FLEET_COMPLETE").output.splitlines()
    return [line.removeprefix("plain,") for line in lines] if shell == "bash" else lines[1::3]


@pytest.fixture
def live(tmp_path: Path) -> Iterator[str]:
    """The name of a live run of ours; nobody answers there."""
    with live_directory(tmp_path, text=load_scenario("paper", ["vehicles=3"]).to_yaml()) as directory:
        yield directory.name


def test_words_that_need_no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    assert offered(monkeypatch, "run", "partition-") == ["partition-heal"]
    assert offered(monkeypatch, "sweep", "rou") == ["rough-sea"]
    assert offered(monkeypatch, "sweep", "loss") == ["loss-delay", "lossy"]
    assert offered(monkeypatch, "inject", "ef") == ["efficiency"]
    assert offered(monkeypatch, "inject", "slow", "b") == ["by="]
    assert offered(monkeypatch, "inject", "mute", "1") == []  # there is no run to ask for its vehicles


def test_targets_are_those_of_the_run(live: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def connect(*_: object, **__: object) -> None:
        raise BusError("nobody is there")  # at once, where a session would try for 2 s

    monkeypatch.setattr("netem.wire.bus.Bus.connect", connect)
    assert offered(monkeypatch, "status", "--run", "p") == [live]
    assert offered(monkeypatch, "inject", "kill", "") == ["1", "2", "3"]
    assert offered(monkeypatch, "inject", "down", "2") == ["2->1", "2->3", "2<->3"]
    assert offered(monkeypatch, "inject", "link", "1->2", "del") == ["delay"]
    assert offered(monkeypatch, "inject", "partition", "iso") == ["isolate:1", "isolate:2", "isolate:3"]
    assert offered(monkeypatch, "heal", "") == []  # it does not answer


def test_bash_gets_what_it_can_parse(live: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its completion takes one backslash away; after an opening quote it needs none."""
    assert offered(monkeypatch, "inject", "down", "3", shell="bash") == [r"3-\\>2"]
    assert offered(monkeypatch, "inject", "down", "'3", shell="bash") == ["3->2"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_has_its_part(shell: str) -> None:
    result = invoke("completion", shell)
    assert (result.exit_code, f"_FLEET_COMPLETE={shell}_complete" in result.output) == (0, True)
