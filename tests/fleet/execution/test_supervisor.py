"""The supervisor with canned histories: no process is started, no message is sent."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest.mock import ANY, MagicMock

import pytest

from fleet.errors import RunBroken
from fleet.execution import supervisor as module
from fleet.execution.hosting import Hosting
from fleet.execution.options import Options
from fleet.execution.supervisor import CONTROLLER_FAILED, Supervisor
from fleet.execution.wiring import USUAL
from fleet.processes.children import FORKSERVER_LOST, Exit
from fleet.recorder.journal import Journal
from fleet.scenario.loading import load_scenario
from netem.wire.credentials import agent_role
from netem.wire.messages import Death, Restart


class Child:
    """A process that was started once."""

    def __init__(self, role: str) -> None:
        self.role, self.pid, self.log_path = role, 7, Path("log") / f"{role}.log"

    def tail(self) -> list[str]:
        return ["ValueError: no"]


class Children:
    def __init__(self, hosting: Hosting, vehicles: int) -> None:
        self.by_role = {role: Child(role) for role in map(hosting.role, range(1, vehicles + 1))}


class External:
    """External agents of which some hold a token."""

    def __init__(self, *vehicles: int) -> None:
        self.vehicles = vehicles
        self.tokens: set[int] = set(vehicles)
        self.expected: list[tuple[int, int, int]] = []

    def present(self, i: int) -> bool:
        return i in self.tokens

    def token(self, i: int, alive: bool) -> None:
        (self.tokens.add if alive else self.tokens.discard)(i)

    def expect(self, i: int, incarnation: int, begin: int) -> None:
        self.expected.append((i, incarnation, begin))

    def on_joined(self, i: int) -> None: ...


class Processes:
    """Session and launch of a supervisor: they write down what it asks for, and answer what the test says."""

    def __init__(self) -> None:
        self.answers: dict[str, dict[str, Any]] = {"absences": {"tick": 40}}
        self.asked: list[tuple[str, str, dict[str, Any]]] = []
        self.announced: list[Death | Restart] = []
        self.started: list[tuple[int, int, int]] = []

    def ask(self, role: str, op: str, **fields: Any) -> dict[str, Any]:
        self.asked.append((role, op, fields))
        return self.answers.get(op, {})

    def put(self, message: Death | Restart) -> None:
        self.announced.append(message)

    def computing(self, role: str) -> int:
        return 2 if role == "host-1" else 0

    def agent(self, i: int, incarnation: int, begin: int) -> tuple[int, int, int]:
        return i, incarnation, begin

    def start(self, role: str, target: tuple[int, int, int]) -> None:
        assert role == agent_role(target[0])
        self.started.append(target)


class Rig:
    """A supervisor and all that it acts on."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        *overrides: str,
        external: Sequence[int] = (),
        hosts: tuple[tuple[int, ...], ...] = (),
    ) -> None:
        scenario = load_scenario("paper", ["duration=4 s", "checks={}", *overrides])
        journal = Journal(scenario, None)  # type: ignore[arg-type]  # nothing is written
        journal.framed = 40
        shared, self.fleet, self.external = Hosting(hosts), Processes(), External(*external)
        supervisor = Supervisor(scenario, journal, MagicMock(), Options(), USUAL, shared, "canned", print)
        self.supervisor: Any = supervisor
        self.notes, self.killed = supervisor.notes, []
        vars(supervisor).update(
            begun=True,
            granted=50,
            external=self.external,
            _children=Children(shared, 4),
            _session=self.fleet,
            _launch=self.fleet,
        )
        monkeypatch.setattr(module, "POLL_S", -1.0)
        monkeypatch.setattr(module.os, "kill", lambda pid, number: self.killed.append(pid))


def test_an_agent_that_dies_under_continue_leaves_its_vehicle_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, "on_death=continue")
    assert rig.supervisor.on_process_ended(Exit("agent-2", 1, 7))
    assert rig.fleet.announced == [Death(2, None, 0, None)]
    assert rig.supervisor.deaths == {2: ["exited with status 1"]}
    assert rig.supervisor.vehicles_without_agent() == [2]
    assert rig.notes.lines == [
        "t = 0.40 s (tick 40) agent 2 (pid 7) exited with status 1: its vehicle drifts without thrust; "
        "last line of log/agent-2.log: ValueError: no"
    ]
    rig.supervisor.poll()
    assert (rig.fleet.started, rig.supervisor.next_restart()) == ([], 400)


def test_an_agent_that_dies_under_restart_gets_another_life_three_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock stops before the tick at which the next life begins, until that one is ready."""
    rig = Rig(monkeypatch, "on_death=restart")
    for life in range(4):
        rig.supervisor.granted = 50 + 100 * life
        assert rig.supervisor.on_process_ended(Exit("agent-2", -9, 7))
        if life == 3:
            break
        begin = rig.fleet.announced[-1].until  # type: ignore[union-attr]
        assert rig.fleet.announced[-1] == Death(2, None, life, begin)
        assert begin is not None and begin >= rig.supervisor.granted and begin % 10 == 0
        assert rig.supervisor.next_restart() == begin
        assert rig.fleet.asked[-1][1:] == ("absences", {"absences": ANY})
        assert rig.fleet.asked[-1][2]["absences"][-1][2] == begin
        rig.supervisor.granted = begin
        rig.supervisor.poll()
        assert rig.fleet.started[-1] == (2, life + 1, begin)
        rig.fleet.answers["ready"] = {"ready": [[2, life + 1]]}
        rig.supervisor.poll()
        assert rig.supervisor.starting == {}
    assert rig.fleet.announced[-1] == Death(2, None, 3, None)
    assert len(rig.fleet.started) == 3
    assert rig.supervisor.next_restart() == 400


@pytest.mark.parametrize(
    ("role", "code", "overrides"),
    [
        ("world", 1, ()),
        ("netem", -9, ()),
        ("agent-1", 1, ("on_death=abort",)),
        ("agent-1", FORKSERVER_LOST, ()),
        ("agent-1", CONTROLLER_FAILED, ()),
    ],
)
def test_ends_that_end_the_run(
    role: str, code: int, overrides: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(monkeypatch, *overrides)
    assert not rig.supervisor.on_process_ended(Exit(role, code, 7))
    assert rig.fleet.announced == []


def test_no_agent_may_die_before_the_run_has_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, "on_death=continue")
    rig.supervisor.begun = False
    assert not rig.supervisor.on_process_ended(Exit("agent-1", 1, 7))


def test_a_scripted_kill_waits_until_the_world_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process is ended once the world asks it for nothing more, and the next one begins at its tick."""
    rig = Rig(monkeypatch, "faults=[{at: 1 s, for: 1 s, kill: 3}]")
    rig.supervisor.granted, rig.fleet.answers["ticks"] = 100, {"ticks": [[3, 99]]}
    rig.supervisor.poll()
    assert rig.killed == []
    rig.fleet.answers["ticks"] = {"ticks": [[3, 100]]}
    rig.supervisor.poll()
    assert rig.killed == [7]
    assert rig.supervisor.on_process_ended(Exit("agent-3", -9, 7))
    assert (rig.supervisor.deaths, rig.fleet.announced) == ({}, [])  # it was asked for
    rig.supervisor.poll()
    assert rig.fleet.started == []
    rig.supervisor.granted = 200
    rig.supervisor.poll()
    assert rig.fleet.started == [(3, 1, 200)]


def test_a_host_that_dies_takes_its_living_agents_along(monkeypatch: pytest.MonkeyPatch) -> None:
    """Vehicle 1's agent ended before, so it had a process of its own; each life after the first has."""
    rig = Rig(monkeypatch, "on_death=restart", hosts=((1, 2, 3), (4,)))
    assert rig.supervisor.on_process_ended(Exit("agent-1", CONTROLLER_FAILED - 1, 0))
    rig.supervisor.granted = 100
    rig.supervisor.poll()
    assert rig.supervisor.on_process_ended(Exit("host-1", -11, 7))
    rig.supervisor.granted = 200
    rig.supervisor.poll()
    assert rig.supervisor.deaths == {
        1: ["exited with status 69"],
        2: ["was killed by SIGSEGV while agent 2 computed"],
        3: ["was killed by SIGSEGV while agent 2 computed"],
    }
    assert rig.fleet.started == [(1, 1, 60), (2, 1, 110), (3, 1, 110)]
    assert "agent 3 (host-1, pid 7) was killed by SIGSEGV while agent 2 computed: its vehicle" in rig.notes.lines[-1]


def test_a_kill_of_an_agent_on_a_host_ends_its_life_only(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, "faults=[{at: 1 s, for: 1 s, kill: 3}]", hosts=((1, 2, 3, 4),))
    rig.supervisor.granted, rig.fleet.answers["ticks"] = 100, {"ticks": [[3, 100]]}
    rig.supervisor.poll()
    reason = "it was killed by a fault of the scenario or the operator"
    assert (rig.killed, rig.fleet.asked[-1][1:]) == ([], ("dismiss", {"agents": [[3, 0, 100]], "reason": reason}))
    rig.supervisor.granted = 200
    rig.supervisor.poll()
    assert (rig.fleet.started, rig.supervisor.deaths) == ([(3, 1, 200)], {})


def test_an_external_agent_that_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, "on_death=continue", external=[3])
    rig.supervisor.on_token_gone(3)
    assert rig.supervisor.deaths == {3: ["left: its session ended"]}
    rig.supervisor.on_token(3)  # its link comes back by itself
    assert rig.fleet.asked[-1][1:] == (
        "dismiss", {"agents": [[3, 0, 0]], "reason": "its link had ended, and its life with it"},
    )  # fmt: skip
    rig = Rig(monkeypatch, "on_death=abort", external=[3])
    with pytest.raises(RunBroken, match=r"agent 3 \(external\) left at t = 0.40 s \(tick 40\)"):
        rig.supervisor.on_token_gone(3)


def test_before_the_run_another_external_agent_may_come(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, "on_death=abort", external=[3])
    rig.supervisor.begun = False
    rig.supervisor.on_token_gone(3)
    assert (rig.external.expected, rig.supervisor.deaths) == ([(3, 0, 0)], {})
    rig.supervisor.on_token_gone(3)  # a token that was not there cannot go
    assert rig.external.expected == [(3, 0, 0)]
