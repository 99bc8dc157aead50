"""A run with its default settings under attack by those who hold a login, and by those who hold none.

`test_access` tries every key with every role on a router of its own. Here the whole fleet runs: what is tried is
refused, refused logins are told in log/world.log and in the result, and the log is the same bytes as without.
"""

from __future__ import annotations

import json
import os
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from attack import SCENARIO, Attack
from free_ports import free_port
from in_process_runs import Alone, log_of, recorded
from waiting import wait_for

import fleet.execution.launch
from fleet.execution.directory import RunDirectory
from fleet.mcap.reader import LogReader
from fleet.result.result import Result, Status
from netem.wire.bus import Bus
from netem.wire.codec import encode
from netem.wire.credentials import OBSERVER, OPERATOR, Credentials, generate
from netem.wire.keys import Keys
from netem.wire.mailbox import Mailbox
from netem.wire.messages import Hello, Note
from netem.wire.open_bus import OpenBus
from netem.wire.queues import MOST_WAITING

SHORT = ["duration=400 ms", "checks={}"]


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Attack, Result]:
    """One run, attacked, of a user whose files anybody may read unless they are made otherwise."""
    attack = Attack()
    write = RunDirectory.write_connection

    def write_and_attack(directory: RunDirectory, values: dict[str, Any]) -> None:
        write(directory, values)
        attack(directory.path, values)

    before = os.umask(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fleet.execution.launch, "generate", attack.generate)
        patch.setattr(RunDirectory, "write_connection", write_and_attack)
        try:
            result = recorded(tmp_path_factory.mktemp("attacked"), "paper", *SCENARIO, in_process=False)
        finally:
            os.umask(before)
            attack.close()
    return attack, result


def test_the_run_goes_on_as_if_nothing_had_happened(attacked: tuple[Attack, Result], alone: Alone) -> None:
    """The log of the attacked run has the bytes of one in a single process, which nobody can reach."""
    attack, result = attacked
    assert (result.status, result.reason, result.lines) == (Status.PASS, "", [])
    assert attack.stolen == []
    undisturbed = alone("paper", *SCENARIO)
    assert result.digest == undisturbed.digest
    assert log_of(result).read_bytes() == log_of(undisturbed).read_bytes()


def test_every_refused_login_is_told(attacked: tuple[Attack, Result]) -> None:
    """In log/world.log and among the notes once, in result.json with how often; and nothing that was allowed."""
    _, result = attacked
    values = json.loads((result.directory / "result.json").read_text())
    told = values["rejected"]
    assert {"refused a login with a wrong password", "refused a login of an unknown user"} == {
        what for what in told if what.startswith("refused")
    }
    # What the router lets through is judged by who takes it.
    assert {"cmd/3: OutOfPlace", "cmd/3: MalformedMessage", "tx/3: MalformedMessage"} <= told.keys()
    assert told["note/agent-3"] == 2
    world_log = (result.directory / "log" / "world.log").read_text()
    assert all(what in world_log for what in values["rejected"] if what.startswith("refused"))
    assert len(world_log.splitlines()) == len([what for what in told if not what.startswith(("tx", "note"))])
    notes = "\n".join(values["notes"])
    assert "rejected from agent-3: malformed note message: agent-3 speaks as 'agent-2' about 2" in notes
    assert "agent 3: \ufffd[2Jnothing\ufffdhappened" in notes
    assert "I am agent 2" not in notes


def test_no_secret_is_anywhere(attacked: tuple[Attack, Result]) -> None:
    """Not in arguments or environment, no file of the run but the connection file, which was ours alone and is gone;
    and no process has a socket of any network: nothing is scouted for, nobody else can come."""
    attack, result = attacked
    assert len(attack.secrets) == 7
    assert attack.exposed == []
    assert attack.modes["connection.json"] == 0o600
    assert not (result.directory / "connection.json").exists()
    for path in result.directory.rglob("*"):
        if path.is_file():
            assert not [secret for secret in attack.secrets if secret in path.read_bytes()], path
    reader = LogReader(result.directory / "run.mcap")
    everything = b"".join(r.data for r in reader) + repr((reader.metadata, reader.attachments)).encode()
    assert not [secret for secret in attack.secrets if secret in everything]


def test_a_flood_changes_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Agent 3's login puts garbage on all its keys, as fast as it can, while a run goes on: that is slower, and
    its log the same."""
    attack, over = Attack(), threading.Event()
    threads: list[threading.Thread] = []
    write = RunDirectory.write_connection

    def write_and_flood(directory: RunDirectory, values: dict[str, Any]) -> None:
        write(directory, values)
        keys, bus = Keys(values["run"]), Bus.connect(values["endpoint"], attack.credentials["agent-3"])
        attack.wait_until_up(keys, values["endpoint"])
        garbage = [b"\xc1", b"", b"\x91" * 40_000, encode(Hello("agent", 3, 0, 0, True))]
        note = encode(Note("agent-3", 3, 0, "!"))

        def say(n: int) -> None:
            for key in (keys.cmd(3), keys.tx(3), keys.note("agent-3")):
                bus._session.put(key, garbage[n % len(garbage)])
            bus._session.put(keys.note("agent-3"), note)

        def flood() -> None:
            for n in range(1, 3000):
                if over.is_set():
                    break
                with suppress(Exception):  # the router goes first
                    say(n)
            bus.close()

        say(0)  # here, so that the run is not over before
        threads.append(threading.Thread(target=flood, daemon=True))
        threads[0].start()

    monkeypatch.setattr(fleet.execution.launch, "generate", attack.generate)
    monkeypatch.setattr(RunDirectory, "write_connection", write_and_flood)
    try:
        flooded = recorded(tmp_path / "a", "paper", *SHORT, in_process=False)
    finally:
        over.set()
        threads[0].join(60)
        attack.close()
    alone = recorded(tmp_path / "b", "paper", *SHORT)
    assert flooded.status is Status.PASS, "\n".join([flooded.reason, *flooded.lines])
    assert flooded.digest == alone.digest
    rejected = flooded.values["rejected"]
    assert {"cmd/3: MalformedMessage", "tx/3: MalformedMessage", "note/agent-3"} <= rejected.keys()
    assert min(rejected.values()) > 0
    assert len(flooded.values["notes"]) <= 1000


def test_a_flood_fills_no_queue() -> None:
    """What waits on one key is limited, so that nobody's puts fill the memory or displace another's; dropped is only
    where nobody may wait."""

    class Wire:
        def publisher(self, key: str) -> None: ...
        def subscribe(self, key: str, handler: Any) -> None:
            self.say = handler

    wire = Wire()
    shell = Mailbox(wire, "netem", "note/netem")  # type: ignore[arg-type]
    shell.subscribe("run/tx/*")
    for _ in range(MOST_WAITING + 5):
        wire.say("run/tx/3", b"x")
    wire.say("run/tx/2", b"y")
    assert shell.rejected == {"tx/3: flood": 5}
    assert [shell.take().key for _ in range(MOST_WAITING + 1)][-1] == "run/tx/2"
    wire.say("run/tx/3", b"z")
    assert shell.take().data == b"z"
    assert shell.queue.empty()


def test_the_observer_of_a_published_run_only_listens(tmp_path: Path) -> None:
    """It can put, delete, answer or ask nothing, and hears the journal and nothing else."""
    keys, private = Keys("0b5e"), tmp_path
    observer = generate(())[OPERATOR].password
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = OpenBus.host(endpoint, keys, Credentials(OBSERVER, observer), private)
    one, other = (OpenBus.connect(endpoint, Credentials(OBSERVER, observer)) for _ in range(2))
    heard: list[tuple[str, bytes]] = []
    try:
        overheard: list[tuple[str, bytes]] = []  # by another observer
        for bus, into in ((router, heard), (other, overheard)):
            bus.subscribe(
                "**", lambda sample, into=into: into.append((str(sample.key_expr), sample.payload.to_bytes()))
            )
            bus.subscribe(
                keys.log("**"), lambda sample, into=into: into.append((keys.log("x"), sample.payload.to_bytes()))
            )
        router.answer(keys.schema("*"), {keys.schema("X"): b"schema", keys.cfg(1): b"slice"})
        router.answer(keys.cfg("*"), {keys.cfg(1): b"slice"})
        other.answer(keys.schema("*"), {keys.schema("X"): b"a lie"})
        session = one._session
        for key in (keys.log("uuv/1/state"), keys.frame, keys.cmd(1), keys.grant, "**"):
            session.put(key, b"forged")
            session.delete(key)
        # What is answered may take its time on a busy machine; what is not is waited for in vain.
        asked = {
            key: [r.ok.payload.to_bytes() for r in session.get(key, timeout=limit) if r.ok is not None]
            for key, limit in ((keys.schema("X"), 20.0), (keys.cfg(1), 1.0), (f"{keys.op}/status", 1.0))
        }
        assert asked == {keys.schema("X"): [b"schema"], keys.cfg(1): [], f"{keys.op}/status": []}
        journal = router.publication(keys.log("x"), "zenoh/bytes", drop=True)
        secret = router.publication(keys.cfg(1), "zenoh/bytes", drop=True)

        def journal_heard() -> bool:
            secret.put(b"secret", None)
            journal.put(b"said", None)
            return (keys.log("x"), b"said") in overheard

        wait_for(journal_heard, 60.0, "the journal")
        # Nothing of what the first one put. The router itself may hear a put after those who are linked to it.
        wait_for(lambda: {what for _, what in heard} >= {b"said", b"secret"}, 60.0, "the router's own")
        assert {what for _, what in heard} == {b"said", b"secret"}
        assert {what for _, what in overheard} == {b"said"}
    finally:
        for bus in (one, other, router):
            bus.close()
