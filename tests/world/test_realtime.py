"""Runs on a wall clock in virtual time: what is late, and that a run in which nothing is late is lockstep's."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from realtime import PERIOD_NS, SHORT

from agents.loop import RealtimeLoop
from agents.make_agent import make_agent
from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario, frame_every
from netem.errors import OutOfPlace
from netem.realtime_rounds import RealtimeRounds
from netem.wire.messages import Command, Nav, Receipt, Round, Transmission
from world.lockstep import NavTo
from world.realtime import RealtimeRun, TickSchedule

SIZE = SHORT.layout(1).size


class Virtual:
    """A whole free-running fleet in virtual time; `absent(i, tick)` says that agent i does not get a nav answered.

    `suspended`: it answers as soon as it is back, with what has queued up.
    """

    def __init__(
        self, scenario: Scenario, path: Path, absent: Callable[[int, int], bool], *, suspended: bool = False
    ) -> None:
        self.scenario, self.absent, self.suspended = scenario, absent, suspended
        self.unanswered: list[Nav] = []
        self.log = LogFile(path)
        self.journal = Journal(scenario, LogWriter(self.log, scenario))
        self.world = RealtimeRun(scenario.world_config, frame_every=frame_every(scenario))
        self.network = RealtimeRounds(scenario.netem_config)
        self.agents = {i: self._born(i, 0) for i in self.world.state.ids}

    def _born(self, i: int, incarnation: int) -> RealtimeLoop:
        core = make_agent(self.scenario.agent_config(i))
        return RealtimeLoop(core, self.scenario.round_ticks, incarnation=incarnation)

    def run(self) -> str:
        """To the end; returns the digest."""
        self.world.grant(self.scenario.ticks)
        for tick in range(self.scenario.ticks):
            for out in self.world.begin():
                if isinstance(out, Round):
                    self.network.round(out)
                elif isinstance(out, NavTo) and self.absent(out.id, tick):
                    self.unanswered.append(out.nav)
                elif isinstance(out, NavTo):
                    self._answer(out.id, out.nav)
            if self.suspended and self.absent(3, tick - 1) and not self.absent(3, tick):
                for nav in self.agents[3].to_answer(self.unanswered):
                    self._answer(3, nav)
            inboxes, report = self.network.exchange(tick * PERIOD_NS)
            for i, inbox in inboxes:
                if inbox.incarnation == self.agents[i].incarnation:
                    self.agents[i].arrive(inbox, tick * PERIOD_NS + 1000)
            if report is not None:
                self.journal.links(report)
            for frame in self.world.finish():
                self.journal.frame(frame)
        self.journal.links(self.network.close(self.scenario.ticks))
        self.log.close()
        for link, (sent, copies) in self.network.netem.entered.items():
            self.journal.ledger.enter(link, sent=sent, duplicated=copies)
        assert self.journal.complete
        assert self.journal.ledger.unbalanced_links() == {}
        return self.log.digest

    def _answer(self, i: int, nav: Nav) -> None:
        if nav.incarnation > self.agents[i].incarnation:
            self.agents[i] = self._born(i, nav.incarnation)
        for answer in self.agents[i].nav(nav):
            if isinstance(answer, Transmission):
                self.network.transmission(i, answer)
            elif isinstance(answer, Command):
                self.world.command(i, answer)
            elif isinstance(answer, Receipt):
                self.network.receipt(i, answer, lambda tick: tick * PERIOD_NS)


def lockstep(scenario: Scenario, path: Path) -> str:
    log = LogFile(path)
    fleet = InProcess(scenario, Journal(scenario, LogWriter(log, scenario)))
    fleet.serve(
        GrantPolicy(scenario.ticks, scenario.tick_ns, scenario.round_ticks, frame_every(scenario)), lambda: None
    )
    log.close()
    return log.digest


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("paper", []),
        ("rough-sea", []),
        ("lossy", []),
        ("kill-restart", ["faults=[{id: crash, at: 1 s, for: 700 ms, kill: 3}]"]),
        ("paper", ["faults=[{at: 500 ms, for: 300 ms, slow: {vehicles: 2, by: 3 ticks}}]"]),
        ("paper", ["faults=[{at: 500 ms, for: 300 ms, pause: 2}]"]),
    ],
)
def test_when_nothing_is_late_the_bytes_are_those_of_lockstep(name: str, more: list[str], tmp_path: Path) -> None:
    scenario = load_scenario(name, ["duration=2500 ms", "checks={}", *more])
    virtual = Virtual(scenario, tmp_path / "free.mcap", lambda i, tick: False)
    assert virtual.run() == lockstep(scenario, tmp_path / "lockstep.mcap")
    found = virtual.network.timing()
    assert (found["overdue"], sum(found["late"].values()), sum(found["missed"].values())) == (0, 0, 0)
    assert all(kept.missed == kept.late == kept.stale == 0 for kept in virtual.world.punctuality.values())


def test_an_agent_that_skips_ticks_is_counted_and_the_others_are_not(tmp_path: Path) -> None:
    scenario = load_scenario("paper", ["duration=2500 ms", "checks={}"])
    # Ticks 100 to 104, of which 100 is a round tick.
    virtual = Virtual(scenario, tmp_path / "free.mcap", lambda i, tick: i == 3 and 100 <= tick < 105)
    assert virtual.run() != lockstep(scenario, tmp_path / "lockstep.mcap")
    assert {i: (kept.missed, kept.longest) for i, kept in virtual.world.punctuality.items()} == {
        1: (0, 0), 2: (0, 0), 3: (5, 5), 4: (0, 0),
    }  # fmt: skip
    assert virtual.network.timing()["missed"] == {"1": 0, "2": 0, "3": 1, "4": 0}


def test_a_silent_agent_is_left_in_peace_until_it_answers(tmp_path: Path) -> None:
    """From 50 ticks without an answer on it gets navs ever more seldom and no messages; then all is as before."""
    scenario = load_scenario("paper", ["duration=8 s", "checks={}", "profile=hardened"])
    virtual = Virtual(scenario, tmp_path / "free.mcap", lambda i, tick: i == 3 and 200 <= tick < 700, suspended=True)
    virtual.run()
    # Its last answer was that of tick 199; from then on it is asked once more after 50, 100, 200 and 400 ticks.
    assert [nav.tick for nav in virtual.unanswered] == [*range(200, 250), 299, 399, 599]
    kept = virtual.world.punctuality
    assert [text for _, _, text in virtual.world.state.notes] == [
        "its agent has not answered for 50 ticks: it hears nothing until it does",
        "its agent answers again, after 501 ticks",
    ]
    assert (kept[3].missed, kept[3].late, kept[3].longest, kept[3].silent) == (501, 2, 501, 452)
    assert all(kept[i].missed == kept[i].silent == 0 for i in (1, 2, 4))
    found = virtual.network.timing()
    # It was to send at 200 to 240; that of 240 came when it was back, before the network knew that it was.
    assert (found["missed"]["3"], found["late"]["3"], found["unread"]) == (4, 1, 0)
    lost = virtual.journal.ledger.accounts[2, 3].lost
    assert lost["dead receiver"] == 46  # of tick 250 to 700
    assert virtual.journal.ledger.accounts[3, 2].sent == 20 + 9


def command(tick: int, force: float = 1.0, incarnation: int = 0) -> Command:
    return Command(incarnation, tick, (force, 0.0, 0.0), (0.0,) * SIZE)


def free() -> RealtimeRun:
    world = RealtimeRun(SHORT.world_config)
    world.grant(SHORT.ticks)
    return world


def forces(frames: list[Any]) -> list[float]:
    """The surge force that acted on vehicle 1."""
    return [frame.vehicles[0].tau[0] for frame in frames]


def test_the_newest_command_acts_until_a_newer_one_is_there() -> None:
    world, frames = free(), []
    said: list[list[Command]] = [
        [command(0, 1.0)], [], [command(1, 2.0)], [command(2, 3.0), command(3, 4.0)], [], [command(5, 5.0)],
    ]  # fmt: skip
    for commands in said:
        world.begin()
        for one in commands:
            world.command(1, one)
        frames += world.finish()
    assert forces(frames) == [1.0, 1.0, 2.0, 4.0, 4.0, 5.0]
    kept = world.punctuality[1]
    # Ticks 1, 2 and 4 went by without their answers; that of tick 1 acted at 2, that of 2 came with a newer one.
    assert (kept.asked, kept.missed, kept.late, kept.stale, kept.longest) == (6, 3, 2, 0, 2)


@given(st.lists(st.integers(0, 4), min_size=1, max_size=12), st.randoms(use_true_random=False))
def test_every_answer_is_in_time_or_late_or_stale(delays: list[int], order: random.Random) -> None:
    """What was missed = late + stale + never came, in whatever order answers come (4: never)."""
    world, there, answered = free(), [], 0
    for tick, delay in enumerate(delays):
        world.begin()
        there += [(tick + delay, command(tick))] if delay < 4 else []
        now = [one for at, one in there if at == tick]
        order.shuffle(now)
        for one in now:
            world.command(1, one)
        answered += len(now)
        world.finish()
    kept = world.punctuality[1]
    assert kept.missed == kept.late + kept.stale + len(delays) - answered


def test_an_answer_behind_a_newer_one_is_dropped_and_counted() -> None:
    world = free()
    world.begin()
    world.finish()
    world.begin()
    world.command(1, command(1, 2.0))
    world.command(1, command(0, 9.0))
    assert forces(world.finish()) == [2.0]
    assert (world.punctuality[1].missed, world.punctuality[1].stale) == (1, 1)
    assert world.take_answered() == [(1, 1), (1, 0)]
    assert world.take_answered() == []


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ([command(1)], "answer to the nav of tick 0"),
        ([command(0), command(0)], "answer to the nav of tick 0"),
        ([command(0, incarnation=1)], "incarnation"),
        ([Command(0, 0, (1.0, 0.0, 0.0), (0.0,) * (SIZE + 1))], "telemetry"),
    ],
)
def test_the_world_refuses_what_it_did_not_ask_for(said: list[Command], expected: str) -> None:
    world = free()
    world.begin()
    *before, last = said
    for one in before:
        world.command(1, one)
    with pytest.raises(OutOfPlace, match=expected):
        world.command(1, last)


def test_an_agent_that_ends_drifts_from_the_tick_it_did_not_answer() -> None:
    world = free()
    world.begin()
    world.command(1, command(0))
    world.end(1, 0)
    frames = world.finish()
    world.begin()
    frames += world.finish()
    assert forces(frames) == [1.0, 0.0]
    assert [life.tick for frame in frames for life in frame.lives] == [1]


@given(st.lists(st.tuples(st.integers(0, 3 * PERIOD_NS), st.booleans()), min_size=1, max_size=60))
def test_ticks_never_begin_early_and_every_moved_moment_is_accounted_for(late: list[tuple[int, bool]]) -> None:
    """Wall time passed = ticks times the period + what the clock was moved by + what the last tick was late."""
    schedule = TickSchedule(PERIOD_NS)
    schedule.start(0, 1000)
    behind = 0
    for k, (ns, held) in enumerate(late):
        now = schedule.at_ns(k) + ns
        behind = schedule.begin(k, now, held=held)
        assert behind >= 0
        assert schedule.at_ns(k) <= now
        assert now - schedule.at_ns(k) <= PERIOD_NS
    assert schedule.at_ns(len(late)) == 1000 + len(late) * PERIOD_NS + schedule.held_ns + schedule.slipped_ns


def test_grants_on_a_wall_clock_go_ahead_of_it() -> None:
    clock = GrantPolicy(10_000, PERIOD_NS, 10, 1, speed_limit=1.0, lead_ns=500_000_000)
    assert clock.until(-1, 0.0) == 51
    assert clock.until(40, 0.4) == 91
