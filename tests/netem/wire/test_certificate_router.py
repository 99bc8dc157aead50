"""The router for agents that have a certificate and no password: what each may do there, and what comes of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zenoh
from free_ports import free_port
from host_certificates import made as made
from waiting import wait_for

import netem.wire.certificate_router as certificate_router
from fleet.addons.hosts import certificates
from fleet.processes.run_folder import RunFolder
from netem.errors import BusError
from netem.limits import WIRE_MESSAGE
from netem.wire.bus import Bus
from netem.wire.certificate_router import CertificateRouter
from netem.wire.credentials import CONSOLE, NETEM, Credentials, Listener, agent_role, generate
from netem.wire.keys import Keys
from netem.wire.session import UNIVERSAL, client_settings, client_tls, open_session

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'uuv-fleet[hosts]'")

KEYS = Keys("5ea")
LIMIT_S = 60.0


class Run:
    """The routers of a run with two vehicles, its console and netem; agent 1 may come with its certificate alone."""

    def __init__(self, private: Path, certs: Path) -> None:
        self._folder = RunFolder()
        self._certs = certs
        known, server = generate((1, 2)), certificates.read_server(certs)
        self.world = Bus.host(self._folder.endpoint, KEYS, (1, 2), known, private)
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        pair = server.pair
        listener = Listener(
            (self.endpoint,), 20_000, server.ca, pair.certificate, pair.key, certified=frozenset([agent_role(1)])
        )
        self._second = CertificateRouter(self.world, KEYS, (1, 2), listener)
        self.heard: list[tuple[str, str, bytes]] = []  # by whom, on which key
        self.tokens: set[str] = set()
        self._open = [self.world]
        for role, bus, expressions in (
            ("world", self.world, [KEYS.cmd("*")]),
            (NETEM, self.join(known[NETEM]), [KEYS.tx("*")]),
            (CONSOLE, self.join(known[CONSOLE]), [KEYS.frame, KEYS.links, KEYS.note("*")]),
            ("agent-2", self.join(known["agent-2"]), [KEYS.nav(2), KEYS.rx(2)]),
        ):
            for expression in expressions:
                bus.subscribe(expression, lambda key, data, who=role: self.heard.append((who, key, data)))
            if role == CONSOLE:
                bus.answer(KEYS.cfg("*"), lambda key, _, respond: respond(b"slice of " + key.encode()))
                bus.answer(f"{KEYS.op}/**", lambda *_: self.heard.append((CONSOLE, "op", b"")))
                bus.watch_tokens(KEYS.alive("*"), self._token)
        self.world.answer(KEYS.ctl("world"), lambda _, __, respond: respond(b"done"))

    def join(self, credentials: Credentials) -> Bus:
        bus = Bus.connect(self._folder.endpoint, credentials)
        self._open.append(bus)
        return bus

    def certified(self, who: str | None, certs: Path | None = None) -> Bus:
        """A session with the certificate of `who`, or with none; no password, not low-latency.

        Raises:
            zenoh.ZError: it is not let in.
        """
        shown = certificates.read_client(certs or self._certs, who) if who else certificates.KeyPair("", "")
        tls = client_tls(Credentials("", "", certificates.read_ca(self._certs), shown.certificate, shown.key))
        settings = client_settings([self.endpoint], None, 700) | tls | UNIVERSAL
        bus = Bus(open_session("client", settings), self.endpoint)
        self._open.append(bus)
        return bus

    def until_heard(self, bus: Bus, key: str, data: bytes, by: str) -> None:
        def heard() -> bool:
            bus._session.put(key, data)
            return (by, key, data) in self.heard

        wait_for(heard, LIMIT_S, f"{data!r} on {key}")

    def close(self) -> None:
        for bus in reversed(self._open):
            bus.close()
        self._second.close()
        self._folder.close()

    def _token(self, key: str, alive: bool) -> None:
        (self.tokens.add if alive else self.tokens.discard)(key)


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Iterator[Run]:
    opened = Run(tmp_path, made)
    try:
        yield opened
    finally:
        opened.close()


def asked(bus: Bus, key: str) -> bytes | None:
    return bus.ask(key, timeout_s=0.3)


def test_an_agent_with_a_certificate_is_what_one_with_a_password_is(run: Run) -> None:
    agent, told = run.certified("agent-1"), []
    agent.subscribe(KEYS.nav(1), lambda key, data: told.append((key, data)))
    agent.subscribe(KEYS.rx(1), lambda key, data: told.append((key, data)))
    assert wait_for(lambda: asked(agent, KEYS.cfg(1)), LIMIT_S) == b"slice of " + KEYS.cfg(1).encode()
    run.until_heard(agent, KEYS.cmd(1), b"c", by="world")
    run.until_heard(agent, KEYS.tx(1), b"t", by=NETEM)
    run.until_heard(agent, KEYS.note("agent-1"), b"n", by=CONSOLE)
    for key in (KEYS.nav(1), KEYS.rx(1)):
        wait_for(lambda key=key: run.world._session.put(key, b"!") or (key, b"!") in told, LIMIT_S)
    withdraw = agent.token(KEYS.alive("agent-1"))
    wait_for(lambda: KEYS.alive("agent-1") in run.tokens, LIMIT_S)
    withdraw()
    wait_for(lambda: KEYS.alive("agent-1") not in run.tokens, LIMIT_S)
    agent.token(KEYS.alive("agent-1"))
    wait_for(lambda: KEYS.alive("agent-1") in run.tokens, LIMIT_S)
    agent.close()
    wait_for(lambda: KEYS.alive("agent-1") not in run.tokens, LIMIT_S)


def test_tx_and_cmd_stay_in_order_and_what_is_too_long_stays_out(run: Run) -> None:
    agent = run.certified("agent-1")
    order: list[bytes] = []
    run.world.subscribe(KEYS.every(1), lambda key, data: order.append(data) if not key.endswith("nav/1") else None)
    run.until_heard(agent, KEYS.cmd(1), b"ready", by="world")
    wait = zenoh.CongestionControl.BLOCK  # as a run puts: zenoh's default drops a message when the link is congested
    agent._session.put(KEYS.cmd(1), bytes(WIRE_MESSAGE.bytes + 1), congestion_control=wait)
    for k in range(200):
        agent._session.put((KEYS.tx if k % 2 else KEYS.cmd)(1), b"%d" % k, congestion_control=wait)
    wait_for(lambda: order and order[-1] == b"199", LIMIT_S)
    assert [data for data in order if data != b"ready"] == [b"%d" % k for k in range(200)]


FORGED = [
    KEYS.cmd(2), KEYS.tx(2), KEYS.note("agent-2"), KEYS.nav(2), KEYS.rx(2), KEYS.grant, KEYS.round, KEYS.frame,
    KEYS.links, KEYS.note("world"), KEYS.note(NETEM), KEYS.cmd("*"), KEYS.tx("*"), KEYS.every(1), f"{KEYS.prefix}/**",
]  # fmt: skip


def test_it_speaks_for_nobody_else_and_overhears_nothing(run: Run) -> None:
    agent, overheard = run.certified("agent-1"), set()
    for expression in ("**", KEYS.rx("*"), KEYS.nav(2), KEYS.frame, KEYS.cmd("*")):
        agent.subscribe(expression, lambda key, _: overheard.add(key), of_others=True)
    for key in FORGED:
        agent._session.put(key, b"forged")
    for role in ("agent-2", "world", CONSOLE):
        agent.token(KEYS.alive(role))
    for key in (KEYS.cfg(2), KEYS.ctl("world"), f"{KEYS.op}/stop"):
        assert asked(agent, key) is None
    # What it sends is handled in order, so that a sign of life comes behind everything.
    run.until_heard(agent, KEYS.cmd(1), b"behind", by="world")
    for key in (KEYS.nav(2), KEYS.rx(2)):
        run.until_heard(run.world, key, b"secret", by="agent-2")
    run.until_heard(agent, KEYS.cmd(1), b"and again", by="world")
    assert not [one for one in run.heard if one[2] == b"forged"]
    assert run.tokens == set()
    assert overheard == set()


def test_without_the_list_it_could(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The list is what holds it back on its own router; what is not an agent's is not passed on in any case."""

    def anything(*_: Any) -> dict[str, Any]:
        return {"enabled": False}

    monkeypatch.setattr(certificate_router, "certificate_control", anything)
    run = Run(tmp_path, made)
    try:
        stranger = run.certified("fleet")
        run.until_heard(stranger, KEYS.cmd(1), b"forged", by="world")
        stranger._session.put(KEYS.grant, b"granted")
        stranger._session.put(KEYS.cmd(2), b"of another")
        run.until_heard(stranger, KEYS.cmd(1), b"behind", by="world")
        assert {key for _, key, _ in run.heard} == {KEYS.cmd(1)}
    finally:
        run.close()


def test_another_certificate_opens_nothing_and_none_is_refused(run: Run, tmp_path: Path) -> None:
    overheard: set[str] = set()
    for who in ("agent-2", "fleet"):
        stranger = run.certified(who)
        stranger.subscribe(KEYS.nav(1), lambda key, _: overheard.add(key))
        for key in (KEYS.cmd(1), KEYS.tx(1), KEYS.cmd(2)):
            stranger._session.put(key, b"forged")
        stranger.token(KEYS.alive("agent-1"))
        assert asked(stranger, KEYS.cfg(1)) is None  # it is behind everything, as above
        run.world._session.put(KEYS.nav(1), b"secret")
        assert asked(stranger, KEYS.cfg(2)) is None
    assert (run.heard, run.tokens, overheard) == ([], set(), set())
    certificates.make(tmp_path / "other", agents=1)
    for who, certs in ((None, None), ("agent-1", tmp_path / "other")):
        with pytest.raises(zenoh.ZError):
            run.certified(who, certs)


def test_without_a_certificate_nobody_connects_where_no_vehicle_is_external_either(run: Run, made: Path) -> None:
    server, run.endpoint = certificates.read_server(made), f"tls/127.0.0.1:{free_port()}"
    listener = Listener((run.endpoint,), 20_000, server.ca, server.pair.certificate, server.pair.key)
    with closing(CertificateRouter(run.world, KEYS, (1, 2), listener)):  # open, it would keep Python from ending
        run.certified("agent-1")  # which opens nothing
        with pytest.raises(zenoh.ZError):
            run.certified(None)


def test_a_port_that_is_taken_is_said(run: Run, made: Path) -> None:
    server = certificates.read_server(made)
    taken = Listener((run.endpoint,), 20_000, server.ca, server.pair.certificate, server.pair.key)
    with pytest.raises(BusError, match=f"cannot listen on {run.endpoint}"):
        CertificateRouter(run.world, KEYS, (1, 2), taken)
