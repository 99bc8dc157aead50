"""Runs of a stack whose file names ports cannot go on at the same time."""

from __future__ import annotations

from typing import Any

import pytest

from fleet.addons.studies import stack_runs
from fleet.addons.studies.modules import NO_MODULES
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import Row
from fleet.addons.studies.verbs.study_options import WorkerOptions
from fleet.result.result import Status

MODEMS = "a: {modem: {unet: 1101}, place: 0 0 9 m}, b: {modem: {unet: 1102}, place: 9 0 9 m}"
PROGRAM = "programs: {a: {run: 'true'}}"


@pytest.mark.parametrize(("nodes", "most"), [("a: {}, b: {}", 3), ('a: {udp: {"9": "b:10"}}, b: {}', 1), (MODEMS, 1)])
def test_ports_of_the_file_are_those_of_one_run_at_a_time(
    nodes: str, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    going_on: list[Task] = []
    seen: list[int] = []

    class Run:
        tries, cpu_share, idle_share, over = 1, None, 0.0, True

        def __init__(self, task: Task, tries: int) -> None:
            self.task = task
            going_on.append(task)

        def row(self) -> Row:
            seen.append(len(going_on))
            going_on.remove(self.task)
            return Row(seed=self.task.seed, status=Status.PASS)

        def end(self) -> None:
            pass

    monkeypatch.setattr(stack_runs, "_Run", Run)
    monkeypatch.setattr(stack_runs, "POLL_S", 0)
    water = "network: {acoustic: {modem: s2c}}" if "modem" in nodes else ""
    text = f"title: Two\n{water}\nnodes: {{{nodes}}}\n{PROGRAM}\nduration: 1 s\n"
    tasks = [Task(str(n), 0, n, "two", text, 9.0) for n in range(1, 7)]
    said: list[str] = []
    rows: list[Any] = []
    stack_runs.StackRuns(3, said.append).make(iter(tasks), rows.extend, lambda: None)
    assert len(rows) == len(tasks)
    assert max(seen) == most
    assert [line.partition(": ")[2] for line in said] == [
        "the file names their ports, so there is one run at a time"
    ] * (most == 1)


def test_the_command_line_tells_it_without_a_line_of_python(capsys: pytest.CaptureFixture[str]) -> None:
    with WorkerOptions().engine(NO_MODULES) as engine:
        engine.stacks._tell("one run at a time")  # type: ignore[union-attr]
    assert capsys.readouterr().err == "warning: one run at a time\n"
