"""Agents that compute nonsense, and agents that say it: refused, counted, explained, and nothing else changes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent
from threading import Event, Thread
from typing import Any

import pytest
from ended_runs import CHECKS, LONG
from failing_laws import NAN_IN_THE_CORE
from first_difference import assert_same_bytes
from in_process_runs import Alone, log_of, recorded
from live import LiveRun
from spawned import fleet as fleet_process

import agents.make_agent
import fleet.execution.in_process
import fleet.execution.launch
from agents.controllers import TRACKING
from fleet.execution.clock import GrantPolicy
from fleet.execution.directory import RunDirectory
from fleet.mcap.reader import LogReader
from fleet.result.result import Result, Status
from netem.wire.bus import Bus
from netem.wire.codec import encode
from netem.wire.credentials import Credentials
from netem.wire.keys import Keys
from netem.wire.messages import Command, Frames, Hello, LinkReport, Nav, Note, Transmission

# --- controllers that fail -------------------------------------------------


def sabotage(folder: Path, code: str) -> dict[str, str]:
    """The environment of a run in whose processes `code` is executed before anything else.

    Every interpreter that starts with the folder in PYTHONPATH loads `sitecustomize`, the fork server included.
    """
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(dedent(code), "utf-8")
    return {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}


NAN_COMMAND = """
    from math import nan
    import agents.make_agent
    make_agent = agents.make_agent.make_agent

    class Careless:
        def __init__(self, config):
            self._id, self._core = config.id, make_agent(config)

        def __getattr__(self, name):
            method = getattr(self._core, name)
            return self._failing(method) if name in ("step", "decide") else method

        def _failing(self, method):
            def failing(nav, deliveries):
                answer = method(nav, deliveries)
                return answer._replace(tau=(nan, 0.0, 0.0)) if (self._id, nav.tick) == (3, 57) else answer

            return failing

    agents.make_agent.make_agent = Careless
"""


@pytest.mark.slow
def test_controller_that_computes_nan(tmp_path: Path) -> None:
    """The agent stops at the sample in which its numbers stop making sense, and what it printed is shown."""
    with LiveRun(tmp_path / "runs", "paper", *LONG, environment=sabotage(tmp_path / "s", NAN_IN_THE_CORE)) as run:
        assert run.status(60.0) == 3
        run.until_nobody_is_left()  # the traceback of the law is shown
        assert "agent 3 (pid " in run.said
        assert "exited with status 70 at t = 0.5" in run.said
        assert "controller failed: agent 3, tick 57: control.demand is (nan, nan, nan)" in run.said
        assert "last lines of " in run.said
        assert "agents.errors.ControllerError: agent 3, tick 57" in run.said
        assert LogReader(run.log).missing == ""


def test_controller_that_computes_nan_in_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Likewise in the plain loop: a broken run with vehicle and tick, not a traceback."""
    monkeypatch.setitem(TRACKING, "neurodynamic", TRACKING["neurodynamic"])  # restored after the sabotage
    exec(dedent(NAN_IN_THE_CORE), {})
    result = recorded(tmp_path, "paper")
    assert result.status is Status.BROKEN
    assert result.reason == "agent 3, tick 57: control.demand is (nan, nan, nan)"


@pytest.mark.slow
def test_nan_command_is_refused_by_the_world(tmp_path: Path) -> None:
    """An agent that does not check itself: the command is malformed, so the vehicle is waited for in vain, and the
    end of the run says both."""
    arguments = [*LONG, "--set", "stall_timeout=1 s"]
    with LiveRun(tmp_path / "runs", "paper", *arguments, environment=sabotage(tmp_path / "s", NAN_COMMAND)) as run:
        run.ends(3)
        assert "waiting for agent 3" in run.said
        assert "rejected on " in run.said
        assert "malformed cmd message: tau[0]: expected a finite number, got nan" in run.said
        assert "tau[0]: expected a finite number, got nan" in (run.directory / "log" / "world.log").read_text()


def test_nan_command_in_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plain loop has nobody to wait for: it ends at once, naming the vehicle."""
    monkeypatch.setattr(agents.make_agent, "make_agent", agents.make_agent.make_agent)  # restored after the sabotage
    exec(dedent(NAN_COMMAND), {})
    monkeypatch.setattr(fleet.execution.in_process, "make_agent", agents.make_agent.make_agent)
    result = recorded(tmp_path, "paper")
    assert result.status is Status.BROKEN
    assert "nan" in result.reason
    assert "3" in result.reason


# --- agents that talk nonsense ---------------------------------------------


class Intruder:
    """Agent 3's credentials in other hands: a second session beside the real agent's, from its start to its end.

    The run itself is `execute` on the main thread, where processes must be started; this thread joins as soon as
    the connection file is written, and puts `nonsense` again and again until told to stop. The clock stands until it
    has done so some times after the beginning of the run.
    """

    def __init__(self, patch: pytest.MonkeyPatch, nonsense: Callable[[Keys], list[tuple[str, bytes]]]) -> None:
        self._nonsense = nonsense
        self._credentials: dict[str, Credentials] = {}
        self._over = Event()
        self._thread: Thread | None = None
        self.rounds = 0
        generate, write = fleet.execution.launch.generate, RunDirectory.write_connection

        def generate_and_leak(vehicles: tuple[int, ...], **more: Any) -> dict[str, Credentials]:
            self._credentials = generate(vehicles, **more)
            return self._credentials

        def write_and_join(directory: RunDirectory, values: dict[str, Any]) -> None:
            write(directory, values)
            self._thread = Thread(target=self._talk, args=(values["endpoint"], values["run"]))
            self._thread.start()

        grant = GrantPolicy.until

        def grant_later(policy: GrantPolicy, written: int, wall_s: float) -> int:
            granted = grant(policy, written, wall_s)
            if written >= policy.ticks // 4:
                self._seen = self._seen or self.rounds
                granted = granted if self.rounds >= self._seen + ROUNDS else min(granted, policy.ticks // 2)
            return granted

        self._seen = 0
        patch.setattr(fleet.execution.launch, "generate", generate_and_leak)
        patch.setattr(RunDirectory, "write_connection", write_and_join)
        patch.setattr(GrantPolicy, "until", grant_later)

    def _talk(self, endpoint: str, run: str) -> None:
        bus = Bus.connect(endpoint, self._credentials["agent-3"])
        messages = self._nonsense(Keys(run))
        puts = {key: bus.publisher(key) for key, _ in messages}
        while not self._over.wait(0.01):
            for key, data in messages:
                puts[key](data)
            self.rounds += 1
        bus.close()

    def run(self, folder: Path) -> Result:
        try:
            return recorded(folder, "paper", CHECKS, DURATION, in_process=False)
        finally:
            self._over.set()
            if self._thread is not None:
                self._thread.join()


ROUNDS = 12
DURATION = "duration=2 s"


def nonsense(keys: Keys) -> list[tuple[str, bytes]]:
    """What a broken or hostile agent may put on the keys that are its own."""
    far = 10**9
    good = (1.0, 0.0, 0.0)
    zeros = (0.0,) * 27
    nan = float("nan")
    nav = encode(Nav(0, 3, (0.0,) * 5, (0.0,) * 5))
    anywhere = [b"", b"\xc1", bytes(range(256)), b"\x93\xa3cmd", b"\xc0" * 40_000, nav, b"\x91\xa4nope"]
    commands = [
        encode(Command(0, far, good, zeros)),
        encode(Command(7, 0, good, zeros)),
        encode(Command(0, far, (nan, 0.0, 0.0), zeros)),
        encode(Command(0, far, (float("inf"), 0.0, 0.0), zeros)),
        encode(Command(0, far, (1.0, 0.0), zeros)),
        encode(Command(0, 2**63, good, zeros)),
        encode(Hello("agent", 3, 0, 99, False)),
        encode(Transmission(0, 0, ())),
    ]
    transmissions = [
        encode(Transmission(0, far, (b"late",))),
        encode(Transmission(0, far + 1, ())),
        encode(Transmission(7, 0, ())),
        encode(Transmission(0, 2**63, (b"x" * 1000,) * 10)),
        encode(Command(0, 0, good, zeros)),
    ]
    return [
        *((keys.cmd(3), data) for data in anywhere + commands),
        *((keys.tx(3), data) for data in anywhere + transmissions),
    ]


def notes(keys: Keys) -> list[tuple[str, bytes]]:
    """A hostile agent puts these on its key for notes. It reaches the console on no other key.

    Some are garbage, and some are lies. Others may come from world and netem only, and would end in the log.
    """
    nav = encode(Nav(0, 3, (0.0,) * 5, (0.0,) * 5))
    frames = [
        encode(Frames(())),
        *(encode(LinkReport(at, over, False, ())) for at, over in ((0, False), (200, True))),
    ]
    lies = [encode(Note("world", 99, 2**63, "[red]\x1b[2Jall is lost[/red]")), encode(Note("x" * 4096, 0, 0, ""))]
    return [(keys.note("agent-3"), data) for data in [b"", b"\xc1", nav, *frames, *lies]]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """That of a run beside all this."""
    with pytest.MonkeyPatch.context() as patch:
        intruder = Intruder(patch, lambda keys: [*nonsense(keys), *notes(keys)])
        found = intruder.run(tmp_path_factory.mktemp("runs"))
    assert intruder.rounds >= ROUNDS
    return found


def test_a_run_beside_a_hostile_agent_is_the_run_in_peace(result: Result, alone: Alone) -> None:
    """Malformed, misplaced, mistimed and non-finite messages, forged frames and lies from an agent's own session, all
    the run long: nobody dies of them, and the log is byte for byte that of a run in peace."""
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert_same_bytes(log_of(alone("paper", CHECKS, DURATION)), log_of(result))


def test_garbage_beside_a_real_agent_is_counted(result: Result) -> None:
    rejected = json.loads((result.directory / "result.json").read_text())["rejected"]
    kinds = "cmd/3: MalformedMessage", "cmd/3: OutOfPlace", "tx/3: MalformedMessage", "tx/3: OutOfPlace"
    for kind in kinds:
        assert rejected[kind] > 10
    assert sum("rejected on" in note for note in result.values["notes"]) == 4  # of each kind only the first is told


def test_notes_that_cannot_be_read_or_lie_are_only_notes(result: Result) -> None:
    assert json.loads((result.directory / "result.json").read_text())["rejected"]["note/agent-3"] > 10
    told = result.values["notes"]
    assert sum("rejected from agent-3" in note for note in told) == 1
    assert not [note for note in told if "\x1b" in note]


LONG_PAYLOADS = """
    from msgspec.structs import replace
    from netem.wire import codec
    from netem.wire.messages import Transmission
    encode = codec.encode

    def longer(message):
        if isinstance(message, Transmission):
            message = replace(message, payloads=tuple(p + b"x" * 30_000 for p in message.payloads))
        return encode(message)

    codec.encode = longer
"""


@pytest.mark.slow
def test_long_payloads_travel_in_parts(tmp_path: Path) -> None:
    """Two neighbours' payloads of 30 kB do not fit into one message; the agents refuse them, and nobody dies."""
    words = ["run", "paper", "-q", "--duration", "500 ms", "--set", "checks={}", "--out", tmp_path / "runs"]
    done = fleet_process(*words, environment=sabotage(tmp_path / "site", LONG_PAYLOADS))
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "runs" / "latest" / "result.json").read_text("utf-8"))
    assert result["vehicles"]["2"]["payloads_rejected"] == 10  # two neighbours, five rounds
