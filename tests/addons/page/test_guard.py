"""Who gets in: whoever knows the token, from a page of ours, on a name of ours."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from fleet.addons.page.server import Guard

PORT, TOKEN = 8123, "the-token"
OURS = f"127.0.0.1:{PORT}"


async def application(scope: Any, receive: Any, send: Any) -> None:
    """What is behind the guard."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": [(b"x-inside", b"yes")]})
    await send({"type": "http.response.body", "body": b"inside"})


@pytest.fixture
def guard() -> Guard:
    return Guard(application, TOKEN, PORT, {"127.0.0.1", "localhost"})


def ask(guard: Guard, query: str = "", kind: str = "http", **headers: str) -> tuple[Any, dict[str, str]]:
    """The status, or the kind of answer to a websocket, and the headers."""
    sent: list[Any] = []
    given = {"host": OURS} | headers
    scope = {
        "type": kind,
        "path": "/",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in given.items()],
    }

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> Any:
        raise AssertionError("nothing is read")

    asyncio.run(guard(scope, receive, send))
    first = sent[0]
    found = {name.decode(): value.decode() for name, value in first.get("headers", ())}
    return first.get("status", first["type"]), found


def cookie(guard: Guard) -> str:
    status, headers = ask(guard, f"token={TOKEN}")
    assert status == 200
    return headers["set-cookie"].partition(";")[0]


def test_the_token_is_exchanged_for_a_cookie_that_no_script_and_no_other_site_can_use(guard: Guard) -> None:
    status, headers = ask(guard, f"token={TOKEN}")
    # Not a redirection: a browser that a local file led here would not send the cookie behind it.
    assert status == 200 and "location" not in headers
    name, *rules = headers["set-cookie"].split("; ")
    assert name.startswith(f"fleet-view-{PORT}=") and TOKEN not in name
    assert {"HttpOnly", "SameSite=Strict"} <= set(rules)
    assert ask(guard, cookie=cookie(guard))[0] == 200


@pytest.mark.parametrize("query", ["", "token=", "token=wrong", f"token={TOKEN}&token=wrong", f"other={TOKEN}"])
def test_nobody_gets_in_without_the_token(guard: Guard, query: str) -> None:
    assert ask(guard, query)[0] == 403
    assert ask(guard, query, "websocket", origin=f"http://{OURS}")[0] == "websocket.close"


@pytest.mark.parametrize("other", ['prefs={"a":1}', "a,b=1", "x[y]=1", "foo", "é=1"])
def test_cookies_of_other_servers_of_the_host_do_not_harm(guard: Guard, other: str) -> None:
    assert ask(guard, cookie=f"{other}; {cookie(guard)}; more=1")[0] == 200


def test_an_origin_that_is_no_address_is_refused(guard: Guard) -> None:
    assert ask(guard, "", "websocket", cookie=cookie(guard), origin="http://[")[0] == "websocket.close"


@pytest.mark.parametrize("value", ["fleet-view-8123=wrong", "fleet-view-8124=x", "%%%", ""])
def test_other_cookies_do_not_help(guard: Guard, value: str) -> None:
    assert ask(guard, cookie=value)[0] == 403


def test_a_websocket_needs_the_cookie_and_a_page_of_ours(guard: Guard) -> None:
    known = cookie(guard)
    assert ask(guard, "", "websocket", cookie=known, origin=f"http://{OURS}")[0] == "websocket.accept"
    assert ask(guard, "", "websocket", cookie=known, origin="http://evil.example")[0] == "websocket.close"
    assert ask(guard, "", "websocket", cookie=known)[0] == "websocket.close"
    assert ask(guard, f"token={TOKEN}", "websocket", origin=f"http://{OURS}")[0] == "websocket.close"


@pytest.mark.parametrize("host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1:1", ""])
def test_a_name_that_is_not_ours_is_refused_as_by_dns_rebinding(guard: Guard, host: str) -> None:
    assert ask(guard, host=host, cookie=cookie(guard))[0] == 403


def test_another_page_gets_nothing_even_with_the_cookie(guard: Guard) -> None:
    known = cookie(guard)
    assert ask(guard, cookie=known, origin="http://evil.example")[0] == 403
    assert ask(guard, host=f"localhost:{PORT}", origin=f"http://localhost:{PORT}", cookie=known)[0] == 200


def test_where_any_name_will_do_a_page_of_another_host_still_gets_nothing() -> None:
    open_wide = Guard(application, TOKEN, PORT, ())
    host = f"ship.example:{PORT}"
    known = cookie(open_wide)
    assert ask(open_wide, host=host, cookie=known, origin=f"http://{host}")[0] == 200
    assert ask(open_wide, host=host, cookie=known, origin="http://evil.example")[0] == 403


def test_answers_forbid_what_is_fetched_from_elsewhere(guard: Guard) -> None:
    _, headers = ask(guard, cookie=cookie(guard))
    assert headers["x-inside"] == "yes"
    assert "default-src 'self'" in headers["content-security-policy"]
