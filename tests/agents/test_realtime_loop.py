"""An agent on a wall clock answers the newest, and says when messages came."""

from __future__ import annotations

import pytest
from realtime import nav

from agents.loop import RealtimeLoop
from agents.sample import Decision
from netem.errors import OutOfPlace
from netem.wire.messages import Arrival, Command, Delivery, Inbox, Nav, Receipt, Transmission


class Core:
    """An agent core that says what it was given."""

    def __init__(self) -> None:
        self.given: list[tuple[int, list[int]]] = []

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        return (b"x",)

    def decide(self, nav: Nav, deliveries: list[Delivery]) -> Decision:
        self.given.append((nav.tick, [d.seq for d in deliveries]))
        return Decision((0.0, 0.0, 0.0), ())


def test_an_agent_answers_the_newest_nav_and_what_it_is_to_send_at() -> None:
    loop = RealtimeLoop(Core(), 10)  # type: ignore[arg-type]
    assert [n.tick for n in loop.to_answer([nav(1), nav(2)])] == [2]
    assert [n.tick for n in loop.to_answer([nav(9), nav(10), nav(11)])] == [10, 11]
    assert [n.tick for n in loop.to_answer([nav(10), nav(20)])] == [20]
    assert [n.tick for n in loop.to_answer([nav(10), nav(20), nav(21), nav(22)])] == [20, 22]


def test_an_agent_uses_what_is_due_and_says_when_it_came() -> None:
    core = Core()
    loop = RealtimeLoop(core, 10)  # type: ignore[arg-type]
    assert [type(answer) for answer in loop.nav(nav(0))] == [Transmission, Command]
    loop.arrive(Inbox(0, 2, False, (Delivery(2, 0, 2, 7, 0, b"a"),)), 5)
    loop.arrive(Inbox(0, 4, False, (Delivery(4, 0, 2, 8, 0, b"b"),)), 6)
    assert [type(answer) for answer in loop.nav(nav(1))] == [Command]
    assert loop.nav(nav(3))[1:] == [Receipt(0, 3, (Arrival(2, 7, 0, 5),))]
    assert loop.nav(nav(5))[1:] == [Receipt(0, 5, (Arrival(2, 8, 0, 6),))]
    assert core.given == [(0, []), (1, []), (3, [7]), (5, [8])]
    with pytest.raises(OutOfPlace) as caught:
        loop.nav(nav(5))
    assert (caught.value.expected, caught.value.got) == (6, 5)
