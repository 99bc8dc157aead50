"""Runs on a wall clock: what is late, what follows from it, and that a run in which nothing is late is lockstep's.

The state machines are told what time it is, so nothing here depends on how fast the machine is; the real runs at the
end assert what holds on any machine.
"""

from __future__ import annotations

import json
import random
import re
import signal
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hand import Hand
from hypothesis import given
from hypothesis import strategies as st
from live import LiveRun
from nowhere import Nowhere, serve

from agents.agent import make_agent
from agents.realtime_loop import RealtimeLoop
from fleet.analysis import punctuality as timing
from fleet.cli.main import cli
from fleet.pictures.runs import Look, NothingToDraw, load
from fleet.pictures.timing import punctuality
from fleet.recorder.journal import Journal
from fleet.recorder.writer import LogWriter
from fleet.repeat.recorded_run import ScriptError
from fleet.repeat.verify import verify
from fleet.repeat.what_if import whatif
from fleet.run.clock import Clock
from fleet.run.connection import RemoteError
from fleet.run.execute import Status, execute
from fleet.run.in_process import InProcess
from fleet.run.options import Options
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario, frame_every
from netem.errors import OutOfPlace
from netem.histogram import Histogram
from netem.realtime_process import RealtimeNetemProcess
from netem.realtime_rounds import RealtimeRounds
from netem.wire.codec import decode, encode
from netem.wire.control import request
from netem.wire.keys import Keys
from netem.wire.messages import Arrival, Command, Delivery, Inbox, LinkReport, Nav, Pace, Receipt, Round, Transmission
from netem.wire.shell import Item
from world.lockstep import NavTo
from world.realtime import RealtimeRun
from world.tick_schedule import TickSchedule

KEYS = Keys("5ea")
PERIOD_NS = 10_000_000
SHORT = load_scenario("paper", ["duration=300 ms", "checks={}"])
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
        self.log = LogWriter(path, scenario)
        self.journal = Journal(scenario, self.log)
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
        assert self.journal.ledger.unbalanced() == {}
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
    log = LogWriter(path, scenario)
    fleet = InProcess(scenario, Journal(scenario, log))
    fleet.serve(Clock.of(scenario), lambda: None)
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


@given(
    st.lists(st.tuples(st.integers(0, 3 * PERIOD_NS), st.booleans()), min_size=1, max_size=60),
)
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


@given(st.lists(st.integers(-5, 10**10), min_size=1, max_size=200), st.sampled_from([50, 95, 99]))
def test_percentiles_are_those_of_numpy_to_the_width_of_a_bucket(values: list[int], percent: int) -> None:
    spread = Histogram()
    for value in values:
        spread.add(value)
    exact = max(0.0, float(np.percentile(values, percent, method="inverted_cdf")))
    found = spread.percentile_ns(percent)
    assert exact <= max(found, 1000)
    assert found <= max(1000, exact * 1.13)
    shown = spread.to_values()
    assert sum(n for _, n in shown["histogram_ms"]) + shown["negative"] == shown["count"] == len(values)


class Core:
    """An agent core that says what it was given."""

    def __init__(self) -> None:
        self.given: list[tuple[int, list[int]]] = []

    def step(self, nav: Nav, deliveries: list[Delivery]) -> Any:
        self.given.append((nav.tick, [d.seq for d in deliveries]))
        return type("Step", (), {"tau": (0.0,) * 3, "telemetry": (), "payloads": (b"x",)})()


def nav(tick: int, incarnation: int = 0) -> Nav:
    return Nav(incarnation, tick, (0.0,) * 5, (0.0,) * 5)


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
    with pytest.raises(OutOfPlace):
        loop.nav(nav(5))


def network() -> RealtimeRounds:
    rounds = RealtimeRounds(load_scenario("paper", ["checks={}", "network.links={'*': 'delay 25ms'}"]).netem_config)
    rounds.round(Round(0, (1, 2, 3, 4), ((0.0,) * 3,) * 4, ()))
    return rounds


def advance(rounds: RealtimeRounds, until: int) -> dict[int, list[tuple[int, Delivery]]]:
    """Exchange up to a tick; what each vehicle got, and when it was handed out."""
    got: dict[int, list[tuple[int, Delivery]]] = {}
    while rounds.tick < until:
        tick = rounds.tick
        if tick % 10 == 0:
            rounds.round(Round(tick, (1, 2, 3, 4), ((0.0,) * 3,) * 4, ()))
        inboxes, report = rounds.exchange(0)
        assert (report is not None) == (tick % 10 == 0)
        for i, inbox in inboxes:
            got.setdefault(i, []).extend((tick, d) for d in inbox.deliveries)
    return got


def test_a_network_that_is_late_exchanges_nothing_after_the_end() -> None:
    """The end may be among what a tick that is overdue still takes in."""
    config, bus, items = SHORT.netem_config, Nowhere(), Nowhere()
    network = RealtimeNetemProcess(bus, KEYS, config, RealtimeRounds(config))  # type: ignore[arg-type]
    network._shell.queue = items  # type: ignore[assignment]
    for said in (Pace(0, 0, 1000), Round(0, (1, 2, 3, 4), ((0.0,) * 3,) * 4, ())):
        items.queue.append(Item(KEYS.round, encode(said), None))
    items.queue.append(Item(KEYS.ctl("netem"), request("close", tick=10), lambda _: None))
    serve(network)
    reports = [report for key, data in bus.put if key == KEYS.links and isinstance(report := decode(data), LinkReport)]
    assert [(report.until, report.closing) for report in reports] == [(10, True)]


@pytest.mark.parametrize("late", [0, 4])
def test_what_is_sent_late_enters_late_and_takes_as_long(late: int) -> None:
    """Handed out a tick before it is due, and due by the link's delay after it came."""
    rounds = network()
    advance(rounds, late)
    rounds.transmission(1, Transmission(0, 0, (b"state",)))
    got = advance(rounds, 9)
    assert [(tick, d.sent_tick, d.due_tick) for tick, d in got[2]] == [(late + 2, late, late + 3)]
    assert rounds.late == {1: int(late > 0), 2: 0, 3: 0, 4: 0}


def test_the_network_measures_what_receipts_say() -> None:
    rounds = network()
    rounds.transmission(1, Transmission(0, 0, (b"state",)))
    advance(rounds, 9)
    rounds.receipt(2, Receipt(0, 4, (Arrival(1, 0, 0, 2_000_000),)), lambda tick: tick * PERIOD_NS)
    found = rounds.timing()
    assert found["overdue"] == 1  # due at 3, used at 4
    assert found["links"]["1->2"]["injected"]["max_ms"] == 30.0  # 25 ms, rounded up to ticks
    assert found["links"]["1->2"]["measured"]["max_ms"] == 40.0
    assert (found["hop"]["max_ms"], found["margin"]["max_ms"]) == (2.0, 28.0)
    with pytest.raises(OutOfPlace, match="1->2 number 0"):
        rounds.receipt(2, Receipt(0, 5, (Arrival(1, 0, 0, 0),)), lambda tick: 0)


@pytest.mark.parametrize("tick", [5, 1000, 0])
def test_the_network_refuses_what_is_no_next_transmission(tick: int) -> None:
    rounds = network()
    rounds.transmission(1, Transmission(0, 0, ()))
    with pytest.raises(OutOfPlace, match="round tick"):
        rounds.transmission(1, Transmission(0, tick, ()))


def test_the_network_waits_for_the_world_but_not_for_agents() -> None:
    rounds = network()
    advance(rounds, 10)
    assert not rounds.known  # where everyone is at tick 10 has not been said


def test_grants_on_a_wall_clock_go_ahead_of_it() -> None:
    clock = Clock(10_000, PERIOD_NS, 10, 1, speed_limit=1.0, lead_ns=500_000_000)
    assert clock.until(-1, 0.0) == 51
    assert clock.until(40, 0.4) == 91


FINE: dict[str, Any] = {
    "world": {"period_ms": 10.0, "slipped_s": 0.0, "held_s": 0.0, "run_s": 10.0},
    "vehicles": {
        "1": {"asked": 1000, "missed": 0, "longest": 0, "silent": 0},
        "2": {"asked": 1000, "missed": 0, "longest": 0, "silent": 0},
    },
    "netem": {"late": {"1": 0}, "missed": {"1": 0}, "overdue": 0, "hop": {"count": 100}},
}


def worse(path: str, value: Any) -> dict[str, Any]:
    changed = json.loads(json.dumps(FINE))
    *most, last = path.split(".")
    place = changed
    for step in most:
        place = place[step]
    place[last] = value
    return changed


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (
            "vehicles.2",
            {"asked": 1000, "missed": 8, "longest": 3, "silent": 0},
            r"agent 2 missed 8 of 1000 ticks \(0.80%\), 3 in",
        ),
        ("vehicles.1.silent", 120, r"agent 1 was silent for 1.2 s in all, suspended or stuck$"),
        ("netem.late", {"1": 3}, "3 transmissions"),
        ("netem.missed", {"1": 1}, "1 transmissions"),
        ("netem.overdue", 7, "7 of 100 deliveries"),
        ("world.slipped_s", 0.05, "moved the clock by 0.05 s"),
        ("world.held_s", 2.0, "stood still for 2 s"),
    ],
)
def test_whatever_is_late_degrades_a_run_and_is_named(path: str, value: Any, said: str) -> None:
    assert timing.label(FINE) == ("on time", [])
    name, reasons = timing.label(worse(path, value))
    assert (name, len(reasons)) == ("degraded", 1)
    assert re.search(said, reasons[0])


def test_the_verdict_tolerates_what_was_asked_for() -> None:
    some = worse("vehicles.2", {"asked": 1000, "missed": 8, "longest": 3, "silent": 0})
    assert timing.verdict(some, 0.01).passed
    assert not timing.verdict(some, 0.005).passed
    assert timing.verdict(some, 0.01).found.startswith("degraded: agent 2 missed")
    assert not timing.verdict(worse("world.slipped_s", 1.0), 0.01).passed


SLEEPER = """
    from time import sleep

    class Sleeper:
        signals = ()

        def __init__(self, config):
            pass

        def step(self, sample):
            if sample.tick % 10 == 5:
                sleep(0.08)
            return (0.0, 0.0, 0.0), {}
"""


def test_a_real_run_is_on_time_and_lockstep_or_says_why_not(tmp_path: Path) -> None:
    scenario = load_scenario("paper", ["duration=2 s", "checks={ledger: balanced, middleware_loss: {at_most: 0}}"])
    found = execute(scenario, Options(tmp_path, quiet=True, realtime_speed=0.5, most_missed=1.0))
    same = execute(scenario, Options(tmp_path, quiet=True, in_process=True))
    assert (found.status, found.reason) == (Status.PASS, "")
    measured = found.values["timing"]
    assert measured["label"] in ("on time", "degraded")
    assert found.digest == same.digest or measured["label"] == "degraded"
    assert (measured["label"] == "on time") == (measured["reasons"] == [])
    assert all(row["asked"] == 200 for row in measured["vehicles"].values())
    assert measured["netem"]["hop"]["count"] + measured["netem"]["unread"] == 120
    assert measured["netem"]["links"]["1->2"]["injected"]["p50_ms"] == 10.0
    (run,) = load([found.directory])
    figure = punctuality([run], Look())
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["UUV 1", "UUV 2", "UUV 3", "UUV 4"]
    shares = figure.axes[0].lines[0].get_ydata()
    assert shares[0] == 1.0
    assert all(a >= b > 0 for a, b in pairwise(shares))
    (run,) = load([same.directory])
    with pytest.raises(NothingToDraw, match="lockstep"):
        punctuality([run], Look())
    for refused in (verify, lambda log: whatif(log, 3)):
        with pytest.raises(ScriptError, match="--clock real"):
            refused(found.directory)


def test_an_agent_too_slow_for_its_ticks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sleeper.py").write_text(dedent(SLEEPER))
    monkeypatch.syspath_prepend(str(tmp_path))
    scenario = load_scenario(
        "paper", ["duration=2 s", "checks={}", "per_vehicle={2: {controller: 'sleeper:Sleeper'}}", "graph.shape=path"]
    )
    found = execute(scenario, Options(tmp_path, quiet=True, realtime_speed=1.0))
    assert found.status is Status.CHECK_FAILED
    rows = found.values["timing"]["vehicles"]
    # Twenty times it sleeps, and each time seven more ticks go by; fewer where the machine stops the world, too.
    assert rows["2"]["missed"] >= 20 * 3
    assert rows["2"]["response"]["max_ms"] >= 80.0
    assert "agent 2 missed" in found.verdicts[-1].found


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--in-process"], "not with --in-process"),
        (["--speed", "max"], "has no max"),
        (["--clock", "lockstep", "--max-missed", "2%"], "is for --clock real"),
        (["--set", "network=ideal"], "not with network: ideal"),
        (["--max-missed", "2"], "expected a share"),
    ],
)
def test_what_makes_no_sense_on_a_wall_clock_is_refused(arguments: list[str], said: str) -> None:
    result = CliRunner().invoke(cli, ["run", "paper", "--clock", "real", *arguments])
    assert (result.exit_code, said in result.output) == (2, True)


def test_a_suspended_agent_does_not_hold_the_others(tmp_path: Path) -> None:
    """It is named, nobody waits for it, and it is among them again when it goes on."""
    arguments = ["--clock", "real", "--speed", "2", "--duration", "8 s", "--max-missed", "1"]
    with LiveRun(tmp_path, "paper", *arguments, "--set", "profile=hardened", "--set", "checks={}") as run:
        run.until_running(3.0)  # sooner its vehicle would not survive an old command for long
        hand, agent = Hand(tmp_path), run.role("agent 2")
        with pytest.raises(RemoteError, match="keeps the pace"):
            hand.clock("speed", 4.0)
        agent.suspend()
        hand.until(hand.now() + 2.0)
        agent.resume()
        assert run.status() == 0, run.printed
        assert "agent 2 was silent for" in run.said
    notes = [note for note in json.loads((run.directory / "result.json").read_text())["notes"] if "vehicle 2" in note]
    assert ["has not answered for 100 ticks" in note for note in notes[:1]] == [True], notes
    assert ["its agent answers again" in note for note in notes[1:]] == [True], notes


def test_a_run_that_is_ended_early_says_how_everyone_kept_up(tmp_path: Path) -> None:
    with LiveRun(tmp_path, "paper", "--clock", "real", "--duration", "60 s", "--set", "checks={}") as run:
        run.until_running().send(signal.SIGINT, group=True)
        assert run.status() == 130
        assert "clock: real, 1 x, a tick every 10 ms" in run.said
    result = json.loads((run.directory / "result.json").read_text())
    assert all(100 <= row["asked"] < 6000 for row in result["timing"]["vehicles"].values())
