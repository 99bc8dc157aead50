"""The server of the page: a port that is open before its address is printed, behind a token."""

from __future__ import annotations

import asyncio
import logging
import os
import secrets
import socket
import webbrowser
from collections.abc import Awaitable, Callable, Collection, MutableMapping
from contextlib import suppress
from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from ipaddress import ip_address
from types import FrameType
from typing import Any
from urllib.parse import parse_qs, urlsplit

from fleet.addons.page.live_feed import LiveFeed
from fleet.addons.page.log_feed import LogFeed
from fleet.errors import FleetError
from fleet.processes.limits import allow_most_open_files
from fleet.terminal.width import say
from netem.private_folder import PrivateFolder, runtime_place

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
    """Lets users that know the token reach an application.

    Others on the machine reach the port as well, and a page of anybody's in the same browser can send requests to it.
    So the guard exchanges the token once for a cookie that no script and no other site can use. Every request and
    websocket needs the cookie. The guard refuses names of hosts that are not ours (DNS rebinding), and websockets that
    another page opens. Plain ASGI: Starlette's own middleware does not see websockets.
    """

    def __init__(self, app: App, token: str, port: int, hosts: Collection[str]) -> None:
        """Guard an application. `token`: of the address. `port`: of the server; cookies of one host know no ports, so
        our cookie has it in its name. `hosts`: names of this host for its users; empty: any, but then a page of another
        host still gets nothing."""
        self._app, self._token = app, token
        self._cookie = f"fleet-view-{port}"
        self._session = secrets.token_urlsafe(24)
        self._names = {f"{host}:{port}".lower() for host in hosts}
        if port == _HTTP:  # which browsers leave out
            self._names |= {host.lower() for host in hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
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


LOOPBACK = "127.0.0.1"
MOST_HEADER_BYTES = 16_384  # of a request, so that whoever has no token holds no more of our memory
SILENT_S = 3.0  # for a whole request; a browser sends its own at once


@dataclass(frozen=True, slots=True)
class PageListener:
    """Where the page is reached: a port that listens already, and the token without which it lets nobody in."""

    host: str
    port: int
    listening: socket.socket
    token: str

    @property
    def address(self) -> str:
        host = self.host
        name = socket.gethostname() if _is_any(host) else f"[{host}]" if ":" in host else host
        return f"http://{name}:{self.port}/?token={self.token}"

    @property
    def names(self) -> set[str]:
        """The names of this host for its users; empty: any."""
        if _is_any(self.host):
            return set()
        name = f"[{self.host}]" if ":" in self.host else self.host
        return {name, "localhost"} if is_loopback(self.host) else {name}


def open_listener(host: str = LOOPBACK, port: int | None = None) -> PageListener:
    """Listen, with a new token. `port`: None or 0: a free one. Raises FleetError: NiceGUI is not installed; the address
    is not one of this machine, or the port is taken."""
    if find_spec("nicegui") is None:
        raise FleetError("the page needs NiceGUI, which is not installed: pip install 'uuv-fleet[view]'")
    try:
        family = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0][0]
        found = socket.create_server((host, port or 0), family=family)
    except (OSError, UnicodeError) as error:  # of a name that no host can have
        where = f"port {port} of {host}" if port else host
        what = f"{where} cannot be listened on ({getattr(error, 'strerror', None) or error})"
        raise FleetError(f"{what}; --port chooses another, and without it a free one is taken", status=3) from None
    return PageListener(host, found.getsockname()[1], found, secrets.token_urlsafe(24))


def serve(feed: LiveFeed | LogFeed, listener: PageListener, *, may_act: bool) -> None:
    """Serve the page until a signal ends the program. `may_act`: whether the page may disturb the run."""
    import uvicorn
    from fastapi import FastAPI
    from nicegui import ui

    from fleet.addons.page.page import Page

    page = Page(feed, may_act=may_act)
    app = FastAPI(openapi_url=None)
    ui.run_with(
        app,
        root=page.build,
        title=f"{feed.name} - fleet view",
        favicon="🌊",
        dark=True,
        reconnect_timeout=10.0,
        message_history_length=20,
        binding_refresh_interval=None,
        cache_control_directives="no-cache",
        tailwind=False,
        show_welcome_message=False,
    )
    page.begin()
    allow_most_open_files()  # whoever reaches the port can open connections and stay silent
    config = uvicorn.Config(
        Guard(app, listener.token, listener.port, listener.names),
        http=_impatient(),
        h11_max_incomplete_event_size=MOST_HEADER_BYTES,
        proxy_headers=False,
        log_config=None,  # what it logs goes the way of all errors
        log_level="error",
        access_log=False,
        timeout_graceful_shutdown=1,
    )

    class Server(uvicorn.Server):
        """Ends within a second, and then does not wait for a second Ctrl-C, at which uvicorn prints a traceback."""

        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            super().handle_exit(sig, frame)
            self.force_exit = False

    with _Errors():
        Server(config).run(sockets=[listener.listening])


class _Errors(logging.Handler):
    """What the server logs: the first error is said in a line, and all are counted. A browser can cause any number."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self._count = 0

    def __enter__(self) -> None:
        for name in ("engineio.server", "socketio.server"):  # which print it themselves, too
            logging.getLogger(name).handlers.clear()
        logging.getLogger().addHandler(self)

    def __exit__(self, *_: object) -> None:
        logging.getLogger().removeHandler(self)
        if self._count > 1:
            say(f"the page had {self._count} errors in all", err=True)

    def emit(self, record: logging.LogRecord) -> None:
        self._count += 1
        if self._count == 1:
            error = record.exc_info[1] if record.exc_info else None
            what = record.getMessage().splitlines()[0] if error is None else f"{type(error).__name__}: {error}"
            say(f"an error of the page, perhaps of a malformed message: {what:.200}; others are only counted", err=True)


def _impatient() -> type[asyncio.Protocol]:
    """A connection that is closed if no whole request came in time; h11, since httptools has no limit of headers."""
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Impatient(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self.loop.call_later(SILENT_S, self._close_if_silent)

        def _close_if_silent(self) -> None:
            if not getattr(self, "cycle", None) and self in self.connections:  # which a websocket leaves
                self.transport.abort()

    return Impatient


class Browser:
    """A browser that is led to the address by a file of this user, because arguments of processes are seen by all."""

    def __init__(self, url: str) -> None:
        self._folder = PrivateFolder("view", runtime_place())
        self.file = self._folder.path / "open.html"
        descriptor = os.open(self.file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w") as file:
            file.write(
                f'<meta http-equiv="refresh" content="0; url={escape(url)}"><a href="{escape(url)}">fleet view</a>'
            )

    def open(self) -> bool:
        """Open it, unless there is no browser or no screen."""
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            return False
        with suppress(webbrowser.Error, OSError):
            return webbrowser.open(self.file.as_uri())
        return False

    def close(self) -> None:
        self._folder.close()


def is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _is_any(host: str) -> bool:
    try:
        return ip_address(host).is_unspecified
    except ValueError:
        return False
