"""Access to the page: a user needs the token of its address, and a browser that asks this host for it.

Others on the machine reach the port as well, and a page of anybody's in the same browser can send requests to it. So
the guard exchanges the token once for a cookie that no script and no other site can use. Every request and websocket
needs the cookie. The guard refuses names of hosts that are not ours (DNS rebinding), and websockets that another page
opens. Plain ASGI: Starlette's own middleware does not see websockets.
"""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable, Collection, MutableMapping
from typing import Any
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

TOKEN = "token"
_HTTP = 80
_LEAD_ON = b'<!doctype html><meta http-equiv="refresh" content="0; url=/"><a href="/">fleet view</a>'
_NO_TOKEN = (
    "This page needs the token that stands in its address.\n"
    "Open the whole address that fleet view printed: http://.../?token=...\n"
)
_WRONG_HOST = "This address is not the one that fleet view printed.\n"
_POLICY = (
    b"default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    b"img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws: wss:; frame-ancestors 'none'"
)


class Guard:
    """Lets users that know the token reach an application."""

    def __init__(self, app: App, token: str, port: int, hosts: Collection[str]) -> None:
        """Guard an application.

        Args:
            token: of the address.
            port: of the server; cookies of one host know no ports, so our cookie has it in its name.
            hosts: names of this host for its users; empty: any, but then a page of another host still gets nothing.
        """
        self._app, self._token = app, token
        self._cookie = f"fleet-view-{port}"
        self._session = secrets.token_urlsafe(24)
        self._names = {f"{host}:{port}".lower() for host in hosts}
        if port == _HTTP:  # which browsers leave out
            self._names |= {host.lower() for host in hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {key: value.decode("latin-1") for key, value in scope["headers"]}
        if not self._is_ours(headers, scope["type"]):
            await _refuse(scope, send, _WRONG_HOST)
        elif self._is_known(headers.get(b"cookie", "")):
            await self._app(scope, receive, _with_policy(send))
        elif scope["type"] == "http" and self._offers_token(scope):
            await self._welcome(send)
        else:
            await _refuse(scope, send, _NO_TOKEN)

    def _is_ours(self, headers: MutableMapping[bytes, str], kind: str) -> bool:
        """Whether it was sent to a name of ours, and a websocket by a page of ours."""
        host = headers.get(b"host", "").lower()
        if self._names and host not in self._names:
            return False
        origin = headers.get(b"origin")
        return (kind == "http" and origin is None) or (origin is not None and _host_of(origin) == host)

    def _is_known(self, cookies: str) -> bool:
        """Other servers of this host set cookies, too, for all ports and of any form: ours is looked for, no more."""
        ours = f"{self._cookie}={self._session}".encode()
        return any(secrets.compare_digest(cookie.strip().encode(), ours) for cookie in cookies.split(";"))

    def _offers_token(self, scope: Scope) -> bool:
        offered = parse_qs(scope.get("query_string", b"").decode("latin-1")).get(TOKEN, [])
        return len(offered) == 1 and secrets.compare_digest(offered[0].encode(), self._token.encode())

    async def _welcome(self, send: Send) -> None:
        """Give the cookie, and lead to the address without the token, which stays out of history and links.

        With a page, not with a redirection: what a local file leads to, as `Browser` does, counts as begun by another
        site up to the last redirection, and a browser sends no strict cookie there.
        """
        cookie = f"{self._cookie}={self._session}; Path=/; HttpOnly; SameSite=Strict"
        headers = [
            (b"content-type", b"text/html; charset=utf-8"),
            (b"set-cookie", cookie.encode()),
            (b"referrer-policy", b"no-referrer"),
            (b"cache-control", b"no-store"),
        ]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": _LEAD_ON})


def _host_of(origin: str) -> str:
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:  # no address
        return ""


def _with_policy(send: Send) -> Send:
    """Nothing is fetched from anywhere else, and nobody frames the page."""

    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            more = [(b"content-security-policy", _POLICY), (b"referrer-policy", b"no-referrer")]
            message["headers"] = [*message.get("headers", ()), *more]
        await send(message)

    return sending


async def _refuse(scope: Scope, send: Send, text: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"cache-control", b"no-store"),
        (b"connection", b"close"),  # who is refused keeps no file of ours open
    ]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": text.encode()})
