"""Connections that have not sent a request."""

from __future__ import annotations

import asyncio
from typing import Any

from fleet.view.half_open import HalfOpen


class Transport:
    """A connection as far as it is looked at."""

    def __init__(self, number: int) -> None:
        self.client = ("127.0.0.1", number)
        self.closed = False

    def get_extra_info(self, name: str) -> tuple[str, int]:
        assert name == "peername"
        return self.client

    def abort(self) -> None:
        self.closed = True


async def _nothing(*_: Any) -> None:
    """An application that answers nothing."""


def opened(half_open: HalfOpen, count: int) -> list[Any]:
    transports: list[Any] = [Transport(number) for number in range(count)]
    for transport in transports:
        half_open.opened(transport)
    return transports


def test_of_too_many_the_oldest_is_closed_and_who_has_asked_is_not() -> None:
    async def flood() -> list[bool]:
        half_open = HalfOpen(_nothing, most=3)
        asked, *silent = opened(half_open, 3)
        await half_open({"type": "http", "client": list(asked.client)}, _nothing, _nothing)
        more: list[Any] = [Transport(number) for number in range(10, 14)]
        for transport in more:
            half_open.opened(transport)
        return [one.closed for one in (asked, *silent, *more)]

    assert asyncio.run(flood()) == [False, True, True, True, False, False, False]


def test_a_silent_one_is_closed_after_a_while() -> None:
    async def wait() -> list[bool]:
        half_open = HalfOpen(_nothing, for_s=0.0)
        silent, asked = opened(half_open, 2)
        half_open.forget(asked.client)
        while not silent.closed:
            await asyncio.sleep(0)
        return [silent.closed, asked.closed]

    assert asyncio.run(wait()) == [True, False]


def test_there_are_fewer_than_the_files_that_may_be_open() -> None:
    assert 1 <= HalfOpen(_nothing)._most <= 100
