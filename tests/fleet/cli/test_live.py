"""The commands for live runs, with answers that were written here: what they print, where, and with which status."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from live_directory import live_directory
from refusals import check_refusals, type_command
from tool import invoke

from fleet.cli.documents.logs import Runs
from fleet.execution.answers import ClockSet, Healed, Injected, Stopping
from fleet.execution.connection import RemoteError

FAULT = {"id": "live-1", "what": "mute 3", "from_s": 12.4, "to_s": 22.4, "until_healed": False}
TUMBLED = {"what": "tumbled 3", "times": 10, "first_s": 12.45, "id": "tumbled-3-10", "last_s": 40.0, "lasts": True}
ANSWERS: dict[str, dict[str, Any]] = {
    "status": {"at_s": 1.5, "end_s": 60.0, "clock": "paused"},
    "inject": FAULT,
    "faults": {"faults": [FAULT | {"state": "active", "active": True}], "events": [TUMBLED]},
    "heal": {"healed": ["live-1"], "at_s": 13.0},
    "clock": {"clock": "paused", "at_s": 2.0},
    "stop": {"at_s": 3.0},
}

STATUS: dict[str, Any] = {
    "scenario": "paper", "waiting": "", "formation": {"worst_m": 1.0, "vehicle": 1, "median_m": 1.0, "vehicles": 1},
    "delivered": 1, "lost": 0, "faults": [], "events": [], "vehicles_total": 0, "vehicles": [], "links_total": 0,
    "links": [],
}  # fmt: skip


class Answers(dict[str, Any]):
    """What each operation is answered with; an exception is raised. Which run was asked for what is kept."""

    def __init__(self) -> None:
        super().__init__(ANSWERS)
        self.asked: list[tuple[str, str, dict[str, Any]]] = []  # but for its list of faults

    def __call__(self, run: Any, op: str, **fields: Any) -> dict[str, Any]:
        if op != "faults":
            self.asked.append((run.name, op, fields))
        if isinstance(self[op], Exception):
            raise self[op]
        return dict(self[op])


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Answers:
    monkeypatch.chdir(tmp_path)  # below which the runs are
    monkeypatch.setattr("fleet.execution.connection.ask", found := Answers())
    return found


@pytest.fixture
def asked(answers: Answers) -> list[tuple[str, str, dict[str, Any]]]:
    return answers.asked


CASES: list[tuple[list[str], type[msgspec.Struct], str]] = [
    (["inject", "mute", "3"], Injected, "live-1: mute 3, from t = 12.40 s until 22.40 s"),
    (["heal"], Healed, "healed live-1 at t = 13.00 s"),
    (["clock", "pause"], ClockSet, "paused, t = 2.00 s; fleet clock resume goes on"),
    (["stop"], Stopping, "stopping at t = 3.00 s"),
]


@pytest.mark.parametrize(("arguments", "kind", "said"), CASES)
def test_every_answer_begins_with_the_name_of_the_run(
    arguments: list[str], kind: type[msgspec.Struct], said: str, answers: dict[str, Any], tmp_path: Path
) -> None:
    """As text, and as one JSON document of the declared kind."""
    with live_directory(tmp_path) as run:
        result = invoke(*arguments)
        assert (result.exit_code, result.stdout, result.stderr) == (0, f"{run.name}: {said}\n", "")
        document = invoke(*arguments, "--json")
        values = json.loads(document.stdout)
        assert (document.exit_code, document.stderr, values["run"]) == (0, "", run.name)
        assert json.loads(msgspec.json.encode(msgspec.json.decode(document.stdout, type=kind))) == values


def test_a_fault_without_an_end_lasts_until_it_is_healed(answers: dict[str, Any], tmp_path: Path) -> None:
    answers["inject"] = FAULT | {"to_s": 60.0, "until_healed": True}
    with live_directory(tmp_path):
        said = invoke("inject", "mute", "3").stdout
        assert said.endswith("from t = 12.40 s until healed, at the latest the end at 60 s\n")


def test_several_live_runs_need_a_name(answers: dict[str, Any], tmp_path: Path) -> None:
    with live_directory(tmp_path, "paper") as paper, live_directory(tmp_path, "rough-sea") as rough:
        for command in ("status", "heal", "stop"):
            result = invoke(command)
            assert (result.exit_code, result.stdout) == (2, "")
            assert f"2 live runs; say which:\n  --run {paper.name}\n  --run {rough.name}\n" in result.stderr
        assert invoke("stop", "--run", "rough").stdout.startswith(f"{rough.name}: stopping")
        listed = invoke("ls").stdout.splitlines()
        assert listed[0] == f"{paper.name}: t = 1.5 of 60 s, paused"
        assert listed[1].startswith(f"  {paper}, pid ")
        found = msgspec.json.decode(invoke("ls", "--json").stdout, type=Runs)
        assert [(row.run, row.at_s, row.error) for row in found.live] == [(paper.name, 1.5, ""), (rough.name, 1.5, "")]


def test_a_run_is_named_by_position_or_by_an_option(answers: dict[str, Any], tmp_path: Path) -> None:
    answers["status"] = answers["status"] | STATUS
    with live_directory(tmp_path, "paper") as paper, live_directory(tmp_path, "rough-sea") as rough:
        for command in ("status", "stop"):
            for name, meant in (("paper", paper), ("rough", rough), (str(rough), rough), (paper.name, paper)):
                by_position, by_option = invoke(command, name), invoke(command, "--run", name)
                assert by_position.stdout == by_option.stdout
                assert by_position.stdout.startswith(f"{meant.name}: "), by_position.output
            assert invoke(command, "paper", "--run", "paper").exit_code == 0
            both = invoke(command, "paper", "--run", "rough")
            assert both.exit_code == 2 and "which run? paper, or --run rough: give one of them" in both.stderr


@pytest.mark.parametrize(
    ("by_position", "by_option"),
    [
        (("heal", "rough", "live-1"), ("heal", "live-1", "--run", "rough")),
        (("clock", "rough", "pause"), ("clock", "pause", "--run", "rough")),
        (("clock", "rough", "2x"), ("clock", "speed", "2", "--run", "rough")),
        (("clock", "rough", "max"), ("clock", "speed", "max", "--run", "rough")),
        (("clock", "rough", "step", "3"), ("clock", "step", "3", "--run", "rough")),
        (("inject", "rough", "mute", "3"), ("inject", "mute", "3", "--run", "rough")),
        (("inject", "rough", "for 5s mute", "3"), ("inject", "for 5s mute", "3", "--run", "rough")),
    ],
)
def test_the_run_may_stand_in_front(
    by_position: tuple[str, ...], by_option: tuple[str, ...], asked: list[Any], tmp_path: Path
) -> None:
    with live_directory(tmp_path, "paper"), live_directory(tmp_path, "rough-sea"):
        assert (invoke(*by_position).exit_code, invoke(*by_option).exit_code) == (0, 0)
        first, second = asked
        assert first == second and first[0].startswith("rough-sea")
        both = invoke(*by_position, "--run", "paper")
        assert both.exit_code == 2 and "which run? rough, or --run paper: give one of them" in both.stderr


def test_a_kind_of_fault_in_front_is_a_run_only_before_another_kind(asked: list[Any], tmp_path: Path) -> None:
    with live_directory(tmp_path, "partition") as run:
        assert invoke("inject", "partition", "halves").exit_code == 0
        assert invoke("inject", "partition", "kill", "3").exit_code == 0
        assert asked == [
            (run.name, "inject", {"fault": {"partition": "halves"}}),
            (run.name, "inject", {"fault": {"kill": "3"}}),
        ]


def test_a_first_word_that_is_nothing_has_both_readings(asked: list[Any], tmp_path: Path) -> None:
    with live_directory(tmp_path) as run:
        hide = {run.name: "RUN", str(tmp_path): "HERE"}
        check_refusals("cli/first words", lambda line: type_command(*line.split()), hide=hide)
    assert asked == []


def test_a_fault_that_has_the_name_of_its_run_is_not_guessed(
    answers: dict[str, Any], asked: list[Any], tmp_path: Path
) -> None:
    with live_directory(tmp_path, "live") as run:
        assert invoke("heal", "live").exit_code == 0
        assert invoke("heal", "live", "--run", "live").exit_code == 0
        assert asked == [(run.name, "heal", {"id": None}), (run.name, "heal", {"id": "live"})]
        answers["faults"] = {"faults": [{"id": "live"}]}
        result = invoke("heal", "live")
        assert result.exit_code == 2
        assert f"say fleet heal {run.name} (all its faults) or fleet heal {run.name} live (that one)" in result.stderr


def test_a_run_that_does_not_answer(answers: dict[str, Any], tmp_path: Path) -> None:
    """It is listed, with what is wrong; a command for it ends with 3."""
    answers["status"] = answers["heal"] = RemoteError("paper-1 did not answer within 5 s; is it over?")
    with live_directory(tmp_path):
        assert invoke("ls").stdout.startswith("paper-1 did not answer within 5 s; is it over?\n  ")
        row = json.loads(invoke("ls", "--json").stdout)["live"][0]
        assert (row["at_s"], row["error"]) == (None, "paper-1 did not answer within 5 s; is it over?")
        assert invoke("heal").exit_code == 3


@pytest.mark.parametrize(
    ("values", "status"), [({"error": "no", "status": 2}, 2), ({"error": "no", "status": 3}, 3), ({"error": "no"}, 3)]
)
def test_the_kind_of_a_refusal_is_its_status(
    values: dict[str, Any], status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import msgpack

    class FakeBus:
        ask: Callable[..., bytes] = staticmethod(lambda *_, **__: msgpack.packb(values))

        def close(self) -> None: ...

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("netem.wire.bus.Bus.connect", lambda *_, **__: FakeBus())
    with live_directory(tmp_path) as run:
        result = invoke("heal", "nosuch")
        assert (result.exit_code, result.stderr) == (
            status,
            f"fleet: {run.name}: refused: no; and no live run is called 'nosuch'\n",
        )


@pytest.mark.parametrize("command", [["inject", "mute", "3"], ["heal"], ["clock", "pause"], ["status"], ["stop"]])
def test_a_run_of_another_version_is_named_in_a_line(
    command: list[str], answers: dict[str, Any], tmp_path: Path
) -> None:
    answers[command[0]] = {"at": 1.0}
    with live_directory(tmp_path) as run:
        result = invoke(*command)
    assert (result.exit_code, result.stdout) == (3, "")
    assert result.stderr.startswith(f"fleet: {run.name} answers as another version of uuv-fleet does: ")
