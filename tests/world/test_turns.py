"""Turns: few agents are asked at a time, and none of them waits for one who is not."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from fleet.scenario.loading import load_scenario
from netem.wire.messages import Command, Nav, Round
from world.lockstep import Lockstep, NavTo
from world.turns import TickOrder

# Suspended vehicles pass ticks without being asked, so they are ahead of the others when they go on.
SCENARIO = load_scenario(
    "paper",
    [
        "duration=500 ms",
        "checks={}",
        "faults=[{at: 50 ms, for: 180 ms, pause: '1, 2'}, {at: 200 ms, for: 100 ms, pause: '2, 3'}, "
        "{at: 310 ms, kill: 4}]",
    ],
)
M = SCENARIO.round_ticks
SIZE = SCENARIO.layout(1).size


def nav(tick: int) -> Nav:
    return Nav(0, tick, (0.0,) * 5, (0.0,) * 5)


@given(st.integers(1, 5), st.lists(st.integers(0, 4), min_size=1, max_size=30), st.integers(1, 50), st.integers(1, 4))
def test_every_nav_leaves_when_its_agent_can_answer_it(most: int, order: list[int], window: int, shared: int) -> None:
    """Whoever is asked has a round behind it that is complete, so it can answer; and all ticks come to pass."""
    lockstep, turns = Lockstep(SCENARIO.world_config), TickOrder(M, most, lambda i, _: i // shared)
    complete, asked, step, granted = {-M}, [], 0, 0
    out: list[Any] = []
    while not lockstep.finished:
        for item in out:
            if isinstance(item, NavTo):
                turns.ask(item.id, item.nav)
            elif isinstance(item, Round):
                complete.add(item.tick)
                turns.on_round_passed(item.tick)
        while (turn := turns.take()) is not None:
            for i, question in turn:
                assert (question.tick - 1) // M * M in complete
                assert turns.holds(i)
            assert len({i // shared for i, _ in turn}) == 1
            asked += turn
        assert len({i // shared for i, _ in asked}) <= most
        if not asked:
            assert granted < SCENARIO.ticks  # otherwise everybody would wait for nobody
            granted += window
            out = lockstep.grant(granted)
            continue
        i, question = asked.pop(order[step % len(order)] % len(asked))
        step += 1
        out = lockstep.command(i, Command(question.incarnation, question.tick, (1.0, 0.1, -0.1), (0.0,) * SIZE))
        turns.release(i)


def test_who_goes_on_between_rounds_keeps_its_turn() -> None:
    turns = TickOrder(M, 1)
    turns.ask(1, nav(0))
    turns.ask(2, nav(0))
    assert turns.take() == [(1, nav(0))]
    assert turns.take() is None
    turns.release(1)
    turns.ask(1, nav(1))  # after a round tick, which 2 has not passed
    assert turns.take() == [(2, nav(0))]
    turns.release(2)
    turns.ask(2, nav(1))
    assert turns.take() is None
    turns.on_round_passed(0)
    assert turns.take() == [(1, nav(1))]
    turns.release(1)
    turns.ask(1, nav(2))
    assert turns.take() == [(1, nav(2))]


def test_agents_of_one_process_are_asked_together() -> None:
    """Those that are asked while the others of their process compute need not wait for a turn."""
    turns = TickOrder(M, 1, lambda i, _: (i - 1) // 3)
    for i in (1, 2, 4, 5):
        turns.ask(i, nav(0))
    assert turns.take() == [(1, nav(0)), (2, nav(0))]
    turns.ask(3, nav(0))
    assert turns.take() == [(3, nav(0))]
    for i in (1, 2):
        turns.release(i)
    assert turns.take() is None
    turns.forget(3)
    turns.forget(4)
    assert turns.take() == [(5, nav(0))]


def test_who_ended_is_not_asked_any_more() -> None:
    turns = TickOrder(M, 2)
    for i in (1, 2, 3):
        turns.ask(i, nav(0))
    turns.ask(4, nav(1))
    assert [turns.take(), turns.take()] == [[(1, nav(0))], [(2, nav(0))]]
    for i in (1, 3, 4):
        turns.forget(i)
    turns.on_round_passed(0)
    assert not turns.holds(1)
    assert turns.take() is None
