"""Limits for connections that have not sent a request: their number, and the time of each.

Without these, nobody could connect any more.

Every program that reaches the port can open connections and stay silent, and a process can open only a limited number
of files. So the oldest silent connection is closed when there are too many, and each after a while. A browser sends its
request at once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol

from fleet.view.guard import App, Receive, Scope, Send
from fleet.view.half_open_limit import FOR_S, most_half_open


class HalfOpen:
    """An application, and the connections to it that have not asked for anything."""

    def __init__(self, app: App, most: int | None = None, for_s: float = FOR_S) -> None:
        self._app, self._for_s = app, for_s
        self._most = most_half_open() if most is None else most
        self._silent: dict[Any, tuple[asyncio.Transport, asyncio.TimerHandle]] = {}  # by the address of the other end

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on: its connection is silent no more."""
        if client := scope.get("client"):
            self.forget(tuple(client))
        await self._app(scope, receive, send)

    def opened(self, transport: asyncio.Transport) -> None:
        """There is a new connection."""
        if self._most <= len(self._silent):
            oldest, _ = self._silent[next(iter(self._silent))]
            oldest.abort()
            self.forget(_client(oldest))
        timer = asyncio.get_running_loop().call_later(self._for_s, transport.abort)
        self._silent[_client(transport)] = transport, timer

    def forget(self, client: Any) -> None:
        """It has sent a request, or is closed."""
        if found := self._silent.pop(client, None):
            found[1].cancel()

    def protocol(self) -> Callable[..., asyncio.Protocol]:
        """The class that uvicorn uses on each connection."""
        half_open = self

        class Protocol(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
            def connection_made(self, transport: asyncio.Transport) -> None:
                super().connection_made(transport)
                self._client = _client(transport)
                half_open.opened(transport)

            def connection_lost(self, exc: Exception | None) -> None:
                half_open.forget(self._client)
                super().connection_lost(exc)

        return Protocol


def _client(transport: asyncio.Transport) -> Any:
    """Host and port of the other end, as a request has them."""
    return tuple((transport.get_extra_info("peername") or (id(transport), 0))[:2])
