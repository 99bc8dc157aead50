"""A second router, for agents that have a certificate and nothing else: no password, no low-latency transport.

Zenoh asks for a password on every listener of a session or on none, and so a router that takes certificates alone is a
session of its own. Its access-control list knows each agent by the common name of its certificate. This router
exchanges the messages of each agent with the run's router, key by key, and forwards nothing more.

Such agents use zenoh-pico, which has no passwords. A nav and its command take 168 and 221 us here, and 105 and 60 us on
the run's router. Commands and payloads of an agent are one subscription: with one each, zenoh's threads put a command
before the payloads of its tick.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import zenoh

from netem.errors import BusError
from netem.wire.bus import Bus, Respond
from netem.wire.credentials import Listener, agent_role, certificate_control
from netem.wire.keys import Keys
from netem.wire.linger import never_linger
from netem.wire.session import UNIVERSAL, listening, open_session, reason, router_settings, server_tls


class CertificateRouter:
    """Listens with mutual TLS, and passes messages between the agents of `listener.certified` and the run's router."""

    def __init__(self, run: Bus, keys: Keys, vehicles: tuple[int, ...], listener: Listener) -> None:
        """Open the router beside that of a run.

        Args:
            run: the session of the run.
            keys: of the run.
            vehicles: all of them; agent i may join here if its role is in `listener.certified`.
            listener: endpoints and certificates.

        Raises:
            BusError: an endpoint is in use, or this process may not listen on it.
        """
        agents = tuple(i for i in vehicles if agent_role(i) in listener.certified)
        settings = {
            **router_settings(len(agents), listener.lease_ms),
            **UNIVERSAL,
            **listening([*listener.endpoints]),
            **server_tls(listener, mutual=True),  # the certificate is needed even if no vehicle is external
            "access_control": certificate_control(keys, agents),
        }
        try:
            self._bus = Bus(open_session("router", settings), listener.endpoints[0])
        except zenoh.ZError as error:
            raise BusError(f"cannot listen on {' and '.join(listener.endpoints)}: {reason(error)}") from None
        self._bus.watch_begins(lambda _: never_linger())
        self._run, self._keys = run, keys
        self._withdraw: dict[str, Callable[[], None]] = {}  # functions that withdraw a token, by its key
        for i in agents:
            self._connect(i)
        run.keep(self)

    def close(self) -> None:
        """Close the router; waits as `Bus.close` does."""
        self._bus.close()

    def _connect(self, i: int) -> None:
        """Pass on what agent i says and hears. Each subscriber has its own thread, so one that waits for room delays
        only its own messages. Messages keep their order only within one subscriber, so tx and cmd share one.
        """
        keys, role = self._keys, agent_role(i)
        _pass_on(self._bus, self._run, keys.every(i), (keys.tx(i), keys.cmd(i)), of_others=True)
        _pass_on(self._bus, self._run, keys.note(role), (keys.note(role),), of_others=True)
        for key in (keys.nav(i), keys.rx(i)):
            _pass_on(self._run, self._bus, key, (key,), of_others=False)
        self._bus.answer(keys.cfg(i), self._ask)
        self._bus.watch_tokens(keys.alive(role), self._hold)

    def _ask(self, key: str, request: bytes, respond: Respond) -> None:
        answer = self._run.ask(key, request)
        if answer is not None:  # otherwise the query ends without a reply, as on the run's own router
            respond(answer)

    def _hold(self, key: str, alive: bool) -> None:
        """An agent's token here is one there."""
        if alive and key not in self._withdraw:
            self._withdraw[key] = self._run.token(key)
        elif not alive and key in self._withdraw:
            self._withdraw.pop(key)()


def _pass_on(source: Bus, target: Bus, expression: str, keys: tuple[str, ...], *, of_others: bool) -> None:
    """Put in `target` what is put on `keys` in `source`; `expression` includes them, and perhaps others."""
    puts = {key: target.publisher(key) for key in keys}

    def receive(key: str, data: bytes) -> None:
        if key in puts:
            with suppress(BusError):  # too long for the run's router, or the session has closed
                puts[key](data)

    source.subscribe(expression, receive, of_others=of_others)
