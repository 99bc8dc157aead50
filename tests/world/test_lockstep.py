"""The three state machines of the lockstep, and the clock and journal beside them, on canned histories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from agents.loop import AgentLoop
from agents.sample import Decision
from fleet.execution.clock import GrantPolicy
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter
from fleet.scenario.loading import load_scenario
from netem.errors import OutOfPlace
from netem.wire.messages import Command, Delivery, Frame, Inbox, LinkReport, Nav, Round, Transmission
from world.lockstep import Lockstep, NavTo

SCENARIO = load_scenario("paper", ["duration=300 ms", "checks={}"])
SIZE = SCENARIO.layout(1).size


def command(tick: int, incarnation: int = 0) -> Command:
    return Command(incarnation, tick, (1.0, 0.1, -0.1), (0.0,) * SIZE)


def run(order: list[int], frame_every: int = 1) -> tuple[list[Frame], list[Round]]:
    """Answer navs in whatever order `order` picks among the waiting vehicles; all frames and rounds."""
    lockstep = Lockstep(SCENARIO.world_config, frame_every=frame_every)
    out: list[Any] = list(lockstep.grant(SCENARIO.ticks))
    waiting = [nav for nav in out if isinstance(nav, NavTo)]
    frames, rounds, step = [], [], 0
    while waiting:
        nav = waiting.pop(order[step % len(order)] % len(waiting))
        step += 1
        for item in lockstep.command(nav.id, command(nav.nav.tick)):
            {NavTo: waiting, Frame: frames, Round: rounds}[type(item)].append(item)  # type: ignore[attr-defined]
    assert lockstep.finished
    return frames, rounds


@given(st.lists(st.integers(0, 3), min_size=1, max_size=30))
def test_the_order_of_commands_changes_nothing(order: list[int]) -> None:
    """However far each vehicle runs ahead, frames and rounds are the same, complete and in order."""
    frames, rounds = run(order)
    assert (frames, rounds) == run([0])
    assert [f.tick for f in frames] == list(range(SCENARIO.ticks + 1))
    assert [r.tick for r in rounds] == [0, 10, 20]
    assert all([row.id for row in f.vehicles] == [1, 2, 3, 4] for f in frames)


def test_thinned_frames_end_with_the_state_at_the_end() -> None:
    assert [f.tick for f in run([0], frame_every=7)[0]] == [0, 7, 14, 21, 28, 30]


def test_nothing_starts_beyond_the_grant() -> None:
    lockstep = Lockstep(SCENARIO.world_config)
    assert lockstep.grant(0) == []
    assert len(lockstep.grant(1)) == 4
    assert not [o for o in lockstep.command(1, command(0)) if isinstance(o, NavTo)]
    assert [o.nav.tick for o in lockstep.grant(2) if isinstance(o, NavTo)] == [1]


def test_commands_out_of_place_are_refused() -> None:
    lockstep = Lockstep(SCENARIO.world_config)
    lockstep.grant(5)
    with pytest.raises(OutOfPlace, match="tick: expected 0, got 3"):
        lockstep.command(1, command(3))
    with pytest.raises(OutOfPlace, match="incarnation"):
        lockstep.command(1, command(0, incarnation=1))
    with pytest.raises(OutOfPlace, match="telemetry values"):
        lockstep.command(1, replace(command(0), telemetry=(1.0,)))
    lockstep.command(1, command(0))
    assert lockstep.waiting_for[0] == (2, 0)
    with pytest.raises(OutOfPlace, match="tick: expected 1, got 0"):
        lockstep.command(1, command(0))


class Core:
    """Notes what it was given."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, list[int]]] = []

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        return (b"here",)

    def decide(self, nav: Nav, deliveries: list[Delivery]) -> Decision:
        self.seen.append((nav.tick, [d.due_tick for d in deliveries]))
        return Decision((1.0, 2.0, 3.0), ())


def nav(tick: int, incarnation: int = 0) -> Nav:
    return Nav(incarnation, tick, (0.0,) * 5, (0.0,) * 5)


def inbox(until: int, *due: int) -> Inbox:
    return Inbox(0, until, False, tuple(Delivery(d, 0, 2, n, 0, b"") for n, d in enumerate(due)))


def test_an_agent_waits_until_its_inbox_is_known_and_gets_each_delivery_at_its_tick() -> None:
    core = Core()
    loop = AgentLoop(core, 2)
    assert [type(m) for m in loop.nav(nav(0))] == [Transmission, Command]
    assert loop.nav(nav(1)) == []
    assert loop.waits_for_inbox
    assert [type(m) for m in loop.inbox(inbox(2, 1, 2))] == [Command]
    loop.inbox(inbox(4, 4))
    assert [type(m) for m in loop.nav(nav(2))] == [Transmission, Command]
    loop.nav(nav(3))
    loop.nav(nav(4))
    assert core.seen == [(0, []), (1, [1]), (2, [2]), (3, []), (4, [4])]


def test_an_inbox_in_parts_counts_once_it_is_whole() -> None:
    core = Core()
    loop = AgentLoop(core, 2)
    loop.nav(nav(0))
    loop.nav(nav(1))
    assert loop.inbox(replace(inbox(2, 1), more=True)) == []
    assert [type(m) for m in loop.inbox(inbox(2, 1))] == [Command]
    assert core.seen[-1] == (1, [1, 1])


def test_an_agent_on_an_ideal_network_transmits_before_it_decides() -> None:
    loop = AgentLoop(Core(), 1, ideal=True)
    assert [type(m) for m in loop.nav(nav(0))] == [Transmission]
    assert [type(m) for m in loop.inbox(inbox(0, 0))] == [Command]


def test_an_agent_refuses_what_is_out_of_place() -> None:
    loop = AgentLoop(Core(), 2)
    with pytest.raises(OutOfPlace, match="incarnation"):
        loop.nav(nav(0, incarnation=1))
    loop.nav(nav(0))
    with pytest.raises(OutOfPlace, match="nav tick: expected 1, got 0"):
        loop.nav(nav(0))
    with pytest.raises(OutOfPlace, match="inbox until tick: expected 2, got 4"):
        loop.inbox(inbox(4))


@given(
    st.integers(1, 300), st.integers(1, 300), st.integers(1, 50), st.sampled_from([1_000_000, 10_000_000, 700_000_000])
)
def test_the_clock_never_deadlocks(ticks: int, round_ticks: int, every: int, tick_ns: int) -> None:
    """With any round and frame length, writing what a grant allows leads to a greater grant, up to the end."""
    clock = GrantPolicy(ticks, tick_ns, round_ticks, every)
    written, granted = -1, 0
    while granted < ticks:
        until = clock.until(written, 0.0)
        assert until > granted
        granted = until
        # Ticks below `until` are done: the log is complete to the last frame and the last round among them.
        done = granted - 1
        written = min(done - done % every, done - done % round_ticks)


def test_the_clock_paces_by_wall_time() -> None:
    clock = GrantPolicy(6000, 10_000_000, 10, 1, speed_limit=2.0)
    assert clock.until(5999, 0.0) == 1
    assert clock.until(5999, 1.0) == 201
    assert GrantPolicy(6000, 10_000_000, 10, 1).until(-1, 0.0) == 50
    later = GrantPolicy(
        6000, 10_000_000, 10, 1, speed_limit=2.0, begin=2000
    )  # what goes on from there paces from there
    assert (later.until(5999, 0.0), later.until(5999, 1.0)) == (2001, 2201)


def test_the_journal_notices_what_is_missing(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "run.mcap")
    journal = Journal(SCENARIO, LogWriter(log, SCENARIO))
    frames = run([0])[0]
    journal.frame(frames[0])
    assert journal.written == -1  # netem has not reported tick 0
    with pytest.raises(OutOfPlace, match="frame: expected 1, got 2"):
        journal.frame(frames[2])
    journal.links(LinkReport(0, False, False, ()))
    assert journal.written == 0
    with pytest.raises(OutOfPlace, match="link report: expected 10, got 20"):
        journal.links(LinkReport(20, False, False, ()))
    rows = frames[1].vehicles
    halves = [Frame(1, True, (), (), rows[:2]), Frame(1, False, (), (), rows[2:])]
    journal.frame(halves[0])
    assert journal.framed == 0
    journal.frame(halves[1])
    assert journal.framed == 1
    log.close()
