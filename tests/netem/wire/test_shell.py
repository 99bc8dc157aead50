"""The queue of a process: what it has room for."""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread

from netem.wire.shell import ROOM, ROOM_PER_SENDER, Shell


class Wire:
    """A bus whose messages the test says."""

    def publisher(self, key: str) -> None: ...

    def subscribe(self, key: str, handler: Callable[[str, bytes], None]) -> None:
        self.say = handler


def test_what_all_senders_may_have_under_way_finds_room() -> None:
    """Otherwise the router waits for this process, and this process, when it puts, for the router."""
    senders = 10 * ROOM
    wire = Wire()
    shell = Shell(wire, "netem", "note/netem", senders=senders)  # type: ignore[arg-type]
    shell.subscribe("run/tx/*")
    most = ROOM_PER_SENDER * senders

    def say(count: int) -> Thread:
        thread = Thread(target=lambda: [wire.say("run/tx/1", b"") for _ in range(count)], daemon=True)
        thread.start()
        return thread

    filling = say(most)
    filling.join(30.0)
    assert not filling.is_alive()
    one_more = say(1)
    assert shell.queue.qsize() == most
    shell.take()
    one_more.join(30.0)
    assert not one_more.is_alive()
