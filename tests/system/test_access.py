"""Who may say and hear what: the router enforces it, whatever a process tries.

The runs of these tests are a router and one session per role, all in this process. Every attack is made twice: on
a router with our access-control list, where nothing may come of it, and on one without, where it must succeed. The
second shows that the first would have noticed.
"""

from __future__ import annotations

import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import zenoh
from ended_runs import LONG
from free_ports import free_port
from in_process_runs import recorded
from live import LiveRun
from waiting import wait_for

import fleet.execution.launch
import netem.wire.bus
import netem.wire.credentials
from fleet.execution.directory import RunDirectory
from fleet.mcap.reader import LogReader
from fleet.processes.run_folder import RunFolder
from fleet.result.result import Status
from netem.errors import BusError
from netem.wire.bus import Bus, Respond
from netem.wire.credentials import CONSOLE, LEASE_MS, NETEM, OPERATOR, Credentials, Listener, agent_role, generate
from netem.wire.keys import Keys

RUN = "5ec7e7"
KEYS = Keys(RUN)
VEHICLES = (1, 2)
HOST, HOSTS = "host-1", ((3,),)  # where agent 3 is in its first life; later ones use its login
WORLD = "world"
LIMIT_S = 60.0

# Everything that anybody can put, and who may. The world is the router itself.
PUTS: dict[str, set[str]] = {
    **{KEYS.tx(i): {agent_role(i)} for i in VEHICLES},
    **{KEYS.cmd(i): {agent_role(i)} for i in VEHICLES},
    **{KEYS.note(agent_role(i)): {agent_role(i)} for i in VEHICLES},
    **{KEYS.nav(i): set() for i in VEHICLES},
    **{KEYS.rx(i): {NETEM} for i in VEHICLES},
    **{key: {HOST} for key in (KEYS.tx(HOST), KEYS.cmd(HOST), KEYS.note(HOST))},
    **{key: {HOST} for key in (KEYS.tx(3), KEYS.cmd(3), KEYS.note("agent-3"))},
    KEYS.nav(3): set(),
    KEYS.rx(3): {NETEM},
    KEYS.host(1): {NETEM},
    KEYS.note(NETEM): {NETEM},
    KEYS.note(WORLD): set(),
    KEYS.links: {NETEM},
    KEYS.round: set(),
    KEYS.frame: set(),
    KEYS.grant: {CONSOLE},
}
# A put may name many keys at once.
WILD_PUTS = [KEYS.tx("*"), KEYS.cmd("*"), KEYS.rx("*"), KEYS.nav("*"), KEYS.note("*"), KEYS.host("*"),
             f"{KEYS.prefix}/**", "**"]  # fmt: skip

HEARD_BY = {
    WORLD: [KEYS.cmd("*")],
    NETEM: [KEYS.tx("*")],
    CONSOLE: [KEYS.frame, KEYS.links, KEYS.note("*")],
    **{agent_role(i): [KEYS.nav(i), KEYS.rx(i)] for i in VEHICLES},
    HOST: [KEYS.host(1), KEYS.nav(3), KEYS.rx(3)],
}
ROLES = [CONSOLE, NETEM, OPERATOR, "agent-1", "agent-2", HOST]
ATTACKERS = ["agent-1", HOST, NETEM, CONSOLE, OPERATOR]


ENFORCED = pytest.mark.parametrize("guard", ["as in every run", "incoming only", "outgoing only"], indirect=True)


def listeners(key: str) -> set[str]:
    """Who subscribes to what a put on `key` reaches."""
    family = {KEYS.prefix + "/" + key.split("/")[2] + "/*", key}
    return {role for role, expressions in HEARD_BY.items() if family & set(expressions)}


class Hall:
    """A router with every role's session, subscribed and answering as the processes of a run are."""

    def __init__(self, private: Path) -> None:
        self.credentials = generate((*VEHICLES, 3), hosts=HOSTS)
        self._folder, self.private = RunFolder(), private
        self.endpoint = self._folder.endpoint
        self.port = f"tcp/127.0.0.1:{free_port()}"  # for those who cannot use the socket
        self.heard: list[tuple[str, str, bytes]] = []  # listener, key, data
        self.tokens: list[str] = []
        self._marks = 0
        listener = Listener((self.port,), LEASE_MS)
        world = Bus.host(self.endpoint, KEYS, (*VEHICLES, 3), self.credentials, private, listener, HOSTS)
        self.sessions = {WORLD: world}
        for role in ROLES:
            self.sessions[role] = self.join(role)
        for role, expressions in HEARD_BY.items():
            for expression in expressions:
                self.sessions[role].subscribe(expression, self._hears(role))
        self.sessions[CONSOLE].answer(KEYS.cfg("*"), _answer("the slice"))
        self.sessions[CONSOLE].answer(f"{KEYS.op}/**", _answer("the operation"))
        self.sessions[NETEM].answer(KEYS.ctl(NETEM), _answer("netem"))
        world.answer(KEYS.ctl(WORLD), _answer("the world"))
        world.watch_tokens(KEYS.alive("*"), lambda key, alive: self.tokens.append(key) if alive else None)
        for key, speakers in PUTS.items():
            for role in speakers or {WORLD}:
                self.until_heard(role, key, f"hello from {role} on {key}".encode(), listeners(key))

    def join(self, role: str) -> Bus:
        """Agent 1 comes by the port, everybody else by the socket: the list is the same."""
        return Bus.connect(self.port if role == "agent-1" else self.endpoint, self.credentials[role])

    def put(self, role: str, key: str, data: bytes) -> None:
        # As a run puts: by default zenoh drops a message when the link is congested.
        self.sessions[role]._session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)

    def who_heard(self, data: bytes) -> set[tuple[str, str]]:
        return {(role, key) for role, key, heard in list(self.heard) if heard == data}

    def settle(self, role: str) -> None:
        """Return once the router has handled all that `role` has sent, and everyone has received what came of it.

        A session's messages reach the router in order, and so does what the router sends to each session: a sign of
        life from `role` is behind what it sent before, and a mark from the router is behind what it passed on. zenoh
        calls each subscription on a thread of its own, so every subscription gets a mark.
        """
        self._marks += 1
        mark = b"mark %d" % self._marks
        session = self.sessions[role]
        match role:
            case "console":
                wait_for(lambda: session.ask(KEYS.ctl(WORLD), timeout_s=0.5), LIMIT_S, "the world's answer")
            case "operator":
                wait_for(lambda: session.ask(f"{KEYS.op}/status", timeout_s=0.5), LIMIT_S, "the console's answer")
            case "netem":
                self.until_heard(role, KEYS.links, mark + b" of netem", {CONSOLE})
            case _:
                number = role.removeprefix("agent-")
                wait_for(lambda: session.ask(KEYS.cfg(number), timeout_s=0.5), LIMIT_S, "the slice")
        waiting = {(role, expression.replace("*", "1")) for role, each in HEARD_BY.items() for expression in each}

        def marked() -> bool:
            for key in {key for _, key in waiting}:
                self.put(WORLD, key, mark)
            waiting.difference_update(self.who_heard(mark))
            return not waiting

        wait_for(marked, LIMIT_S, f"{mark!r} on every subscription")

    def until_heard(self, role: str, key: str, data: bytes, by: set[str]) -> None:
        """Put again and again until everybody has heard it: a subscription takes a moment to become known, and a
        publisher that knows of none says nothing."""

        def heard() -> bool:
            self.put(role, key, data)
            return by <= {listener for listener, _ in self.who_heard(data)}

        wait_for(heard, LIMIT_S, f"{data!r} on {key}")

    def _hears(self, role: str) -> Any:
        return lambda key, data: self.heard.append((role, key, data))

    def close(self) -> None:
        for session in reversed(self.sessions.values()):
            session.close()
        self._folder.close()


def _answer(text: str) -> Any:
    def answer(key: str, _: bytes, respond: Respond) -> None:
        respond(f"{text} for {key}".encode())

    return answer


@contextmanager
def hall(private: Path) -> Iterator[Hall]:
    opened = Hall(private)
    try:
        yield opened
    finally:
        opened.close()


def without(flow: str) -> Any:
    """The list with everything allowed in one direction: what the other direction alone holds back.

    The router holds back twice. A publisher that is not told of a subscriber stays silent of its own accord, which
    a hostile program need not do; so what comes in must be refused by itself, and so must what goes out.
    """
    messages = ["put", "delete", "query", "reply", "declare_subscriber", "declare_queryable", "liveliness_token"]
    rule = {"permission": "allow", "flows": [flow], "messages": messages, "key_exprs": ["**"]}

    def access_control(keys: Keys, vehicles: tuple[int, ...], **how: Any) -> dict[str, Any]:
        block = netem.wire.credentials.access_control(keys, vehicles, **how)
        block["rules"].append({"id": "open", **rule})
        for policy in block["policies"]:
            policy["rules"].append("open")
        return block

    return access_control


GUARDS: dict[str, Any] = {
    "as in every run": netem.wire.credentials.access_control,
    "incoming only": without("egress"),
    "outgoing only": without("ingress"),
    "none": lambda keys, vehicles, **how: {"enabled": False},
}


Halls = Callable[[str], Hall]


@pytest.fixture(scope="module")
def halls(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Halls]:
    """The hall with a guard. All tests of a guard share it: what one of them leaves there reaches nobody."""
    known: dict[str, Hall] = {}
    with ExitStack() as opened, pytest.MonkeyPatch.context() as patch:

        def of(guard: str) -> Hall:
            if guard not in known:
                patch.setattr(netem.wire.bus, "access_control", GUARDS[guard])
                known[guard] = opened.enter_context(hall(tmp_path_factory.mktemp("hall")))
                patch.setattr(netem.wire.bus, "access_control", GUARDS["as in every run"])
            return known[guard]

        yield of


@pytest.fixture
def guard(request: pytest.FixtureRequest) -> str:
    """The name of a guard, for tests that are parametrised with it."""
    return str(getattr(request, "param", "as in every run"))


@pytest.fixture
def guarded(guard: str, halls: Halls) -> Hall:
    return halls(guard)


@pytest.fixture
def unguarded(halls: Halls) -> Hall:
    """A router without the list."""
    return halls("none")


# --- putting ---------------------------------------------------------------


def test_everyone_can_say_what_is_theirs(guarded: Hall) -> None:
    """Every allowed put of every role arrives: the list forbids nothing that a run needs."""
    for key, speakers in PUTS.items():
        for role in speakers:
            data = f"{role} on {key}".encode()
            guarded.put(role, key, data)
            guarded.settle(role)
            assert {listener for listener, _ in guarded.who_heard(data)} == listeners(key), data


@pytest.mark.parametrize("guard", ["as in every run", "incoming only"], indirect=True)
def test_nobody_can_say_what_is_not_theirs(guarded: Hall) -> None:
    """Agent 1 can put no command and no transmission of agent 2, no nav, no inbox, no frame, no grant ... ; and a put
    on a wildcard, which would name its own key among others, is refused as a whole."""
    for role in ATTACKERS:
        forged, deleted = f"forged by {role}".encode(), guarded.who_heard(b"")
        allowed = {KEYS.rx("*"), KEYS.host("*")} if role == NETEM else set()  # every inbox, at once or one by one
        for key in [*(key for key, speakers in PUTS.items() if role not in speakers), *WILD_PUTS]:
            if key not in allowed:
                guarded.put(role, key, forged)
        for key in (KEYS.cmd(1), KEYS.cmd(2), KEYS.nav(2), KEYS.frame):
            guarded.sessions[role]._session.delete(key)
        guarded.settle(role)
        # What a session says to itself never leaves it.
        heard = guarded.who_heard(forged) | (guarded.who_heard(b"") - deleted)
        assert {listener for listener, _ in heard} <= {role}, role


def test_without_the_list_every_forgery_is_heard(unguarded: Hall) -> None:
    for key, speakers in PUTS.items():
        if "agent-1" not in speakers:
            unguarded.until_heard("agent-1", key, f"forged {key}".encode(), listeners(key))
    unguarded.until_heard("agent-1", KEYS.cmd("*"), b"wild", {WORLD})


# --- listening -------------------------------------------------------------

WIRETAPS = [
    KEYS.rx(2), KEYS.nav(2), KEYS.rx("*"), KEYS.nav("*"), KEYS.tx(2), KEYS.tx("*"), KEYS.cmd(2), KEYS.cmd("*"),
    KEYS.frame, KEYS.links, KEYS.round, KEYS.note("*"), KEYS.grant, KEYS.host("*"), f"{KEYS.prefix}/**", "**",
]  # fmt: skip


def wiretap(hall: Hall, role: str) -> set[str]:
    """What `role` overhears: a set that grows while the others talk."""
    overheard: set[str] = set()
    for expression in WIRETAPS:
        hall.sessions[role].subscribe(expression, lambda key, _: overheard.add(key))
    hall.settle(role)
    return overheard


def everybody_says_everything(hall: Hall) -> None:
    for key, speakers in PUTS.items():
        hall.until_heard(next(iter(speakers), WORLD), key, b"secret on " + key.encode(), listeners(key))
    for role in ROLES:
        hall.settle(role)


@pytest.mark.parametrize("guard", ["as in every run", "outgoing only"], indirect=True)
def test_agent_and_operator_overhear_nothing(guarded: Hall) -> None:
    """Not a neighbour's inbox or nav, not the fleet's frames: only what an agent said itself and what is meant for it.
    The operator's credentials are for asking the console; they read no traffic."""
    own = {KEYS.cmd(1), KEYS.tx(1), KEYS.note("agent-1"), KEYS.nav(1), KEYS.rx(1)}
    by_agent, by_operator = wiretap(guarded, "agent-1"), wiretap(guarded, OPERATOR)
    everybody_says_everything(guarded)
    assert by_agent <= own
    assert by_operator == set()


def test_without_the_list_an_agent_overhears_everything(unguarded: Hall) -> None:
    overheard = wiretap(unguarded, "agent-1")

    def everything() -> bool:
        everybody_says_everything(unguarded)
        return overheard >= set(PUTS)

    wait_for(everything, LIMIT_S, "all keys")


# --- asking and answering --------------------------------------------------

QUESTIONS = [*map(KEYS.cfg, (2, HOST, "*")), *map(KEYS.ctl, (WORLD, NETEM)), f"{KEYS.op}/status", f"{KEYS.prefix}/**"]


def answers(hall: Hall, role: str, key: str) -> list[str]:
    replies = hall.sessions[role]._session.get(key, timeout=1.0)
    return sorted(reply.ok.payload.to_string() for reply in replies if reply.ok is not None)


def allowed(hall: Hall, role: str, key: str) -> list[str]:
    """The answers where there must be one, which may come late on a busy machine."""
    return wait_for(lambda: answers(hall, role, key), LIMIT_S, f"an answer on {key}")


@ENFORCED
def test_agent_learns_its_own_slice_only(guarded: Hall) -> None:
    """An agent cannot know the fleet: the configuration of others, the control of processes and the operator's
    questions stay closed to it, by name and by wildcard."""
    assert allowed(guarded, "agent-1", KEYS.cfg(1)) == [f"the slice for {KEYS.cfg(1)}"]
    assert {key: answers(guarded, "agent-1", key) for key in QUESTIONS} == {key: [] for key in QUESTIONS}


def test_without_the_list_an_agent_learns_everything(unguarded: Hall) -> None:
    for key in QUESTIONS:
        allowed(unguarded, "agent-1", key)


@ENFORCED
def test_nobody_answers_for_another(guarded: Hall) -> None:
    """An agent that offers itself as the console or the world is never asked."""
    with closing(guarded.join("agent-1")) as liar:  # one of its own: it would be answered by its own lies
        for expression in (KEYS.cfg(2), KEYS.cfg("*"), KEYS.ctl("*"), f"{KEYS.op}/**", f"{KEYS.prefix}/**"):
            liar.answer(expression, _answer("a lie"))
        behind = b"behind the lies"

        def known() -> bool:
            liar._session.put(KEYS.cmd(1), behind)
            return (WORLD, KEYS.cmd(1)) in guarded.who_heard(behind)

        wait_for(known, LIMIT_S, "a sign of life")
        assert allowed(guarded, "agent-2", KEYS.cfg(2)) == [f"the slice for {KEYS.cfg(2)}"]
        assert allowed(guarded, CONSOLE, KEYS.ctl(WORLD)) == [f"the world for {KEYS.ctl(WORLD)}"]
        assert allowed(guarded, CONSOLE, KEYS.ctl(NETEM)) == [f"netem for {KEYS.ctl(NETEM)}"]
        assert allowed(guarded, OPERATOR, f"{KEYS.op}/status") == [f"the operation for {KEYS.op}/status"]


@pytest.mark.parametrize("guard", ["as in every run", "incoming only", "none"], indirect=True)
def test_nobody_lives_for_another(guard: str, guarded: Hall) -> None:
    """A liveliness token is held under the own name or not at all."""
    agent = guarded.sessions["agent-1"]
    for name in ("agent-2", WORLD, NETEM):
        agent.token(KEYS.alive(name))
    agent.token(KEYS.alive("agent-1"))
    wait_for(lambda: KEYS.alive("agent-1") in guarded.tokens, LIMIT_S, "the agent's own token")
    expected = {"agent-1"} if guard != "none" else {"agent-1", "agent-2", WORLD, NETEM}
    assert set(guarded.tokens) == {KEYS.alive(name) for name in expected}


# --- credentials -----------------------------------------------------------


def test_wrong_credentials_are_refused(guarded: Hall) -> None:
    """A wrong password, another role's, an unknown user, none at all: refused in clear words without the password."""
    good = guarded.credentials
    wrong = [
        Credentials("agent-1", "wrong-password"),
        Credentials("agent-1", good["agent-2"].password),
        Credentials("agent-9", good["agent-1"].password),
        Credentials(WORLD, ""),
        Credentials("", ""),
    ]

    def try_to_join(endpoint: str, credentials: Credentials) -> None:
        with pytest.raises(BusError) as caught:
            Bus.connect(endpoint, credentials, timeout_ms=300)
        assert f"cannot join the run at {endpoint} as {credentials.user}:" in str(caught.value)
        assert not credentials.password or credentials.password not in str(caught.value)

    attempts = list(product((guarded.endpoint, guarded.port), wrong))
    with ThreadPoolExecutor(len(attempts)) as pool:  # each waits until its time is over
        assert list(pool.map(lambda attempt: try_to_join(*attempt), attempts)) == [None] * 10


def test_users_file_is_gone_once_the_router_is_up(guarded: Hall) -> None:
    """Nothing of the credentials is left on the disk, and who knows them may still join."""
    assert list(guarded.private.iterdir()) == []
    guarded.join("agent-2").close()


def test_passwords_are_long_fresh_and_unseen() -> None:
    first, second = generate((*VEHICLES, 3), hosts=HOSTS), generate((*VEHICLES, 3), hosts=HOSTS)
    passwords = [c.password for c in (*first.values(), *second.values())]
    assert len(set(passwords)) == len(passwords) == 2 * len(ROLES)
    assert min(map(len, passwords)) >= 32  # of 64 symbols: 192 bits
    assert not [c for c in first.values() if c.password in f"{c} {c!r} {[c]}"]


def test_no_secret_is_left_lying_about(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No password in any process's arguments or environment while the run lives, and afterwards none in its
    directory (the connection file held the operator's), in the log or in the temporary folder that the router read."""
    folders: list[Path] = []
    make_folder = tempfile.mkdtemp

    def make_and_remember(*args: Any, **kwargs: Any) -> str:
        folders.append(Path(make_folder(*args, **kwargs)))
        return str(folders[-1])

    leaked: dict[str, Credentials] = {}
    exposed: list[str] = []
    write = RunDirectory.write_connection

    def remember(vehicles: tuple[int, ...], **how: Any) -> dict[str, Credentials]:
        leaked.update(generate(vehicles, **how))
        return leaked

    def look_round(directory: RunDirectory, values: dict[str, Any]) -> None:
        write(directory, values)
        secrets = [c.password.encode() for c in leaked.values()]
        for path in [*Path("/proc").glob("[0-9]*/cmdline"), *Path("/proc").glob("[0-9]*/environ")]:
            try:
                text = path.read_bytes()
            except OSError:
                continue  # it ended meanwhile
            exposed.extend(f"{path}: {text!r}" for secret in secrets if secret in text)

    monkeypatch.setattr(tempfile, "mkdtemp", make_and_remember)
    monkeypatch.setattr(fleet.execution.launch, "generate", remember)
    monkeypatch.setattr(RunDirectory, "write_connection", look_round)
    out = tmp_path / "runs"
    result = recorded(out, "paper", "duration=1 s", "checks={}", in_process=False)
    assert result.status is Status.PASS
    assert len(leaked) == 7
    assert exposed == []
    secrets = [c.password.encode() for c in leaked.values()]
    for path in out.rglob("*"):
        if path.is_file():
            assert not any(secret in path.read_bytes() for secret in secrets), path
    reader = LogReader(result.directory / "run.mcap")
    everything = b"".join(r.data for r in reader) + repr((reader.metadata, reader.attachments)).encode()
    assert not any(secret in everything for secret in secrets)
    # That of multiprocessing is this process's until its end; an earlier test may have made it.
    ours = [each for each in folders if each.name.startswith("uuv-fleet") and "-processes-" not in each.name]
    assert len(ours) == 1
    assert not ours[0].exists()


def test_connection_file(tmp_path: Path) -> None:
    """While the run lives, for its owner alone, and enough to join as the operator; afterwards gone."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        run.until_running(0.5)
        path = run.directory / "connection.json"
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert path.stat().st_uid == os.getuid()
        values = json.loads(path.read_text())
        assert set(values) == {"endpoint", "run", "scenario", "pid", "user", "password"}
        assert (values["user"], values["scenario"], values["pid"]) == (OPERATOR, "paper", run.pid)
        assert values["endpoint"].startswith("unixsock-stream//")
        Bus.connect(values["endpoint"], Credentials(values["user"], values["password"])).close()
        socket_path = Path(values["endpoint"].removeprefix("unixsock-stream/"))
        assert stat.S_IMODE(socket_path.parent.stat().st_mode) == 0o700
        run.role("agent 1").kill()
        assert run.status() == 3
        assert not path.exists()
        assert not socket_path.parent.exists()
