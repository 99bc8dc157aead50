"""Faults: what a scenario's timeline means, what it does to packets and vehicles, and that deaths do not end a run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any, get_args

import pytest
from fault_histories import drive, told, world
from hypothesis import given
from hypothesis import strategies as st
from live import LiveRun
from refusals import check_refusals
from small_scenario import SMALL, read_back, small

from fleet.analysis.stability import analyse
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Result, Status
from fleet.scenario.faults.partitions import partition
from fleet.scenario.loading import load_scenario
from fleet.scenario.schema.faults import ACTIONS
from netem.condition import Condition
from netem.config import NetemConfig
from netem.fault_kinds import NetFaultKind, WorldFaultKind
from netem.faults import NO_FAULTS, NetFault, active_faults
from netem.lives import Absence
from netem.network import Netem
from world.lockstep import Lockstep, NavTo
from world.lockstep import Out as WorldOut

TICK_NS = 10_000_000
LINKS = ((1, 2), (2, 1), (2, 3), (3, 2))


# --- partitions ------------------------------------------------------------


def components(n: int, cut: set[tuple[int, int]]) -> list[set[int]]:
    """Groups that still talk to each other, on a complete graph."""
    groups: list[set[int]] = [{i} for i in range(1, n + 1)]
    for a in range(1, n + 1):
        for b in range(1, n + 1):
            if a != b and (a, b) not in cut:
                one, other = (next(g for g in groups if x in g) for x in (a, b))
                if one is not other:
                    groups.remove(other)
                    one |= other
    return groups


@given(
    st.integers(2, 15),
    st.integers(0, 1000),
    st.sampled_from(["halves", "one", "majority", "isolate:1", "ring", "bridge"]),
)
def test_partitions_are_what_their_names_say(n: int, seed: int, name: str) -> None:
    cut = partition(name, n, seed, 1)
    assert {(b, a) for a, b in cut} == cut  # both ways
    sizes = sorted(len(group) for group in components(n, cut))
    match name:
        case "halves":
            assert sizes == sorted([n // 2, n - n // 2])
        case "one" | "isolate:1":
            assert sizes == [1, n - 1]
        case "majority":
            assert sizes[-1] > n / 2
            assert sum(sizes) == n
        case "bridge":
            assert len(sizes) == 1 or n == 2
        case "ring":
            sees = [frozenset(b for b in range(1, n + 1) if b == a or (a, b) not in cut) for a in range(1, n + 1)]
            assert all(len(view) > n / 2 for view in sees)
            assert n < 4 or len(set(sees)) == n


def test_bridge_leaves_one_that_both_halves_see() -> None:
    cut = partition("bridge", 7, 3, 1)
    middle = [i for i in range(1, 8) if all(i not in link for link in cut)]
    assert len(middle) == 1
    without = cut | {link for i in range(1, 8) for link in ((middle[0], i), (i, middle[0]))}
    assert sorted(len(group) for group in components(7, without)) == [1, 3, 3]


def test_bad_partitions() -> None:
    cases = ["halve", "one:3", "isolate:\u00b2", "1,2 / 2,3", "1 / 9", "isolate:9", "a / b", ""]
    check_refusals("scenario/partitions", lambda text: partition(text, 4, 1, 1), cases)


def test_those_in_no_group_are_alone() -> None:
    assert components(4, partition("1,2 / 3", 4, 1, 1)) == [{1, 2}, {3}, {4}]


# --- the network under faults ----------------------------------------------


def test_faults_lie_over_the_links_own_condition() -> None:
    """The later begun one wins while both last; each ends by itself, in any order."""
    lossy, slow = Condition(loss=1.0), Condition(delay_ns=50_000_000)
    faults = (
        NetFault("a", 10, 40, "link", ((1, 2),), (), lossy),
        NetFault("b", 20, 30, "link", ((1, 2),), (), slow),
        NetFault("c", 20, None, "mute", vehicles=(3,)),
    )
    assert [active_faults(faults, k).conditions.get((1, 2)) for k in (0, 10, 20, 30, 40)] == [
        None,
        lossy,
        slow,
        lossy,
        None,
    ]
    assert [active_faults(faults, k).mute for k in (19, 20, 999)] == [frozenset(), frozenset({3}), frozenset({3})]
    assert active_faults(faults, 5) == NO_FAULTS


def netem(*faults: NetFault) -> Netem:
    return Netem(NetemConfig(1, TICK_NS, 10, (1, 2, 3), LINKS, {}, faults))


def play(network: Netem, rounds: int, alive: tuple[int, ...] = (1, 2, 3)) -> list[Any]:
    fates: list[Any] = []
    for k in range(0, 10 * rounds, 10):
        fates += network.exchange(k, dict.fromkeys(alive, (b"x",))).fates
    return fates + list(network.close(10 * rounds))


def causes(fates: list[Any], link: tuple[int, int]) -> list[str]:
    return [f.cause for f in sorted(fates, key=lambda f: f.sent_tick) if (f.src, f.dst) == link]


def test_each_fault_has_its_cause_and_ends() -> None:
    fates = play(netem(NetFault("p", 10, 30, "partition", ((1, 2), (2, 1)))), 5)
    assert causes(fates, (1, 2)) == ["delivered", "partition", "partition", "delivered", "delivered"]
    assert causes(fates, (2, 3)) == ["delivered"] * 5
    fates = play(netem(NetFault("m", 10, 20, "mute", vehicles=(2,))), 3)
    assert causes(fates, (2, 1)) == causes(fates, (2, 3)) == ["delivered", "mute", "delivered"]
    assert causes(fates, (1, 2)) == ["delivered"] * 3
    fates = play(netem(NetFault("d", 10, 20, "deaf", vehicles=(2,))), 3)
    assert causes(fates, (1, 2)) == causes(fates, (3, 2)) == ["delivered", "deaf", "delivered"]
    fates = play(netem(NetFault("x", 0, None, "down", ((3, 2),))), 2)
    assert causes(fates, (3, 2)) == ["down", "down"]


def test_what_is_on_its_way_arrives_though_the_link_is_cut() -> None:
    """Conditions act on entry. A packet of 250 ms sent at 0 passes a partition that begins at 100 ms."""
    slow = {(1, 2): Condition(delay_ns=250_000_000)}
    network = Netem(
        NetemConfig(1, TICK_NS, 10, (1, 2), ((1, 2),), slow, (NetFault("p", 10, 50, "partition", ((1, 2),)),))
    )
    fates = [f for k in range(0, 50, 10) for f in network.exchange(k, {1: (b"x",), 2: ()}).fates]
    assert [(f.sent_tick, f.final_tick, f.cause) for f in fates if f.cause == "delivered"] == [(0, 25, "delivered")]


def test_the_dead_hear_nothing_and_say_nothing() -> None:
    fates = play(netem(), 3, alive=(1, 3))
    assert causes(fates, (1, 2)) == ["dead receiver"] * 3
    assert causes(fates, (2, 1)) == []


kinds = st.sampled_from(["link", "down", "partition", "mute", "deaf"])


@given(
    st.lists(
        st.tuples(
            kinds, st.integers(0, 60), st.integers(1, 40), st.sets(st.sampled_from(LINKS)), st.sets(st.integers(1, 3))
        ),
        max_size=6,
    ),
    st.integers(0, 6),
)
def test_ledger_balances_under_any_faults_and_state_goes_on(found: list[Any], cut: int) -> None:
    """Every packet has one final fate whatever happens; and a network restored in the middle goes on the same."""
    condition = Condition(delay_ns=80_000_000, jitter_ns=60_000_000, loss=0.2, duplicate=0.3)
    faults = tuple(
        NetFault(f"f{n}", begin, begin + span, kind, tuple(sorted(links)), tuple(sorted(who)), condition)
        for n, (kind, begin, span, links, who) in enumerate(sorted(found, key=lambda f: f[1]))
    )
    whole = netem(*faults)
    fates = play(whole, 7)
    told = Counter((f.src, f.dst) for f in fates)
    assert {link: sent + copies for link, (sent, copies) in whole.entered.items()} == {
        link: told[link] for link in LINKS
    }
    first, second = netem(*faults), netem(*faults)
    parts = [f for k in range(0, 10 * cut, 10) for f in first.exchange(k, dict.fromkeys((1, 2, 3), (b"x",))).fates]
    second.take_over(first)
    parts += [f for k in range(10 * cut, 70, 10) for f in second.exchange(k, dict.fromkeys((1, 2, 3), (b"x",))).fates]
    assert parts + list(second.close(70)) == fates


# --- scenarios -------------------------------------------------------------

TIMELINE = (
    "faults=[{at: 100 ms, for: 200 ms, link 1->2: loss 30%}, {at: 200 ms, partition: halves, id: split}, "
    "{at: 300 ms, down: 2<->3, for: 100 ms}, {at: 400 ms, mute: '1-2', for: 100 ms}, "
    "{at: 500 ms, for: 130 ms, kill: 3}]"
)


def test_a_timeline_compiles_and_prints_back() -> None:
    s = small(TIMELINE)
    read_back(s)
    kinds = [(f.id, f.kind, f.begin, f.end) for f in s.netem_config.faults]
    assert kinds == [
        ("f1", "link", 10, 30),
        ("split", "partition", 20, None),
        ("f3", "down", 30, 40),
        ("f4", "mute", 40, 50),
    ]
    assert s.world_config.absences == s.netem_config.absences == (Absence(3, 50, 65),)  # with a round, every 5 ticks
    assert s.netem_config.faults[0].links == ((1, 2),)


def test_every_kind_of_fault_has_a_core() -> None:
    """The schema lists the kinds; what no core knows would be accepted and do nothing."""
    assert set(ACTIONS) == {*get_args(NetFaultKind), "kill", *WorldFaultKind}


SQUALL = '''
from typing import Any

from fleet.scenario import value_types as v
from fleet.scenario.faults import of_motion
from fleet.scenario.faults.kind import Part, SomeVehicles, Strength, Surroundings, VehicleFaultKind
from fleet.scenario.faults.kind import network_fault, world_fault
from netem.fault_kinds import WorldFaultKind
from netem.wire.messages import TimedFault


class SquallKeys(SomeVehicles):
    force: v.Force = 0.0


class SquallFault(VehicleFaultKind):
    """A push to the north, under which nothing is heard."""

    value = SquallKeys
    example = "squall vehicles=2 force=3 N"
    acts_on = "agent"
    drawn = "strength"
    every_number_strengthens = True
    offers = (("squall", "squall vehicles={0} force=3 N"),)

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        who = self.vehicles(values)
        push = world_fault(times, WorldFaultKind.WRENCH, who, (values.force, 0.0, 0.0, 0.0, 0.0))
        return [push, network_fault(times, "deaf", vehicles=who)]

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        return {"force": f"{strength.between(1, 10):g} N"}


of_motion.OF_MOTION = (*of_motion.OF_MOTION, SquallFault())  # the one line
'''
ASKED = """
import click
import squall
import fleet
from fleet.errors import ScenarioError
from fleet.cli.completion import injection
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.loading import load_scenario
from fleet.scenario.text.fault_words import read_fault
from fleet.addons.studies.targets import targets
print(read_fault(squall.SquallFault.example))
context = click.Context(click.Command("inject"))
context.params = {"what": ("squall",)}
print([item.value for item in injection(context, None, "")])
print(KINDS["squall"].offers)
print(targets("squall", {"vehicles": "1,2", "force": "3 N"}, 4, 1, "f1").items)
nemesis = "nemesis={mode: swarm, pick: [squall], mean: 1 s}"
drawn = [load_scenario("small.yaml", [nemesis, "duration=10 s", f"seed={seed}"]).spec.faults for seed in range(4)]
print({fault.kind.name for some in drawn for fault in some})
for force in (3, 0):
    fault = f"{{at: 500 ms, squall: {{vehicles: 2, force: {force} N}}}}"
    try:
        plain, pushed = (fleet.run("small.yaml", set=[f"faults=[{one}]", "duration=2 s"]) for one in ("", fault))
    except ScenarioError as error:
        print(str(error).splitlines()[0].partition("]: ")[2])
    else:
        print(pushed.values["ledger"]["1->2"]["lost"], plain.digest != pushed.digest)
"""


def test_a_new_kind_is_one_file_and_one_line(tmp_path: Path) -> None:
    """The schema, `inject`, completion, page, nemesis, `shrink` and a run know it; and a value that does nothing."""
    (tmp_path / "squall.py").write_text(SQUALL, "utf-8")
    (tmp_path / "small.yaml").write_text(SMALL, "utf-8")
    (tmp_path / "asked.py").write_text(ASKED, "utf-8")
    done = subprocess.run([sys.executable, "asked.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [
        "{'squall': {'vehicles': '2', 'force': '3 N'}}",
        "['vehicles=', 'force=']",
        "(('squall', 'squall vehicles={0} force=3 N'),)",
        "[1, 2]",
        "{'squall'}",
        "{'deaf': 30} True",
        "faults.1.squall: changes nothing: give it a value",
    ], done.stderr


def test_a_fault_behind_the_end_is_warned_of() -> None:
    """A run may be cut short with --duration; that is no mistake in its faults."""
    s = small("faults=[{at: 2 s, mute: 1}, {at: 3 s, kill: 2}, {at: 0 s, deaf: 1}]")
    assert [fault.id for fault in s.netem_config.faults] == ["f3"]
    assert s.world_config.absences == ()
    assert "fault f1, f2: the run is over before it begins" in analyse(s).warnings


# --- deaths ----------------------------------------------------------------


def test_a_scripted_kill_and_an_end_at_the_same_tick_are_the_same() -> None:
    """The first tick without a command is the tick of death, whoever caused it."""
    scripted = drive(Lockstep(world(absences=(Absence(2, 17),))), 50, {1, 2, 3, 4})
    lockstep = Lockstep(world())
    natural = drive(lockstep, 17, {1, 2, 3, 4})
    lockstep.grant(18)
    natural += [out for out in lockstep.end(2, 0) if not isinstance(out, NavTo)]
    # Those whose nav went out with the grant answer now.
    from netem.wire.messages import Command

    for i, tick in lockstep.waiting_for:
        natural += lockstep.command(i, Command(0, tick, (1.0, 0.0, 0.0), ()))
    natural += drive(lockstep, 50, {1, 3, 4})

    def kept(outs: list[WorldOut], kind: str) -> list[Any]:
        return [out for out in outs if type(out).__name__ == kind]

    assert kept(natural, "Frame") == kept(scripted, "Frame")
    assert kept(natural, "Round") == kept(scripted, "Round")
    assert [r.alive for r in kept(scripted, "Round")] == [(1, 2, 3, 4)] * 2 + [(1, 3, 4)] * 3
    assert not [n for n in kept(scripted, "NavTo") if n.id == 2 and n.nav.tick >= 17]


@pytest.mark.parametrize("absences", [(), (Absence(1, 0, 30),)])
def test_a_vehicle_whose_motion_leaves_the_finite_numbers_ends(absences: tuple[Absence, ...]) -> None:
    """It stays where it was, and its end is told as an error, also when it has no agent that could end with it."""
    from dataclasses import replace

    config = world(keep_going=True, absences=absences)
    runaway = replace(config.vehicles[0], nu0=(1e200, 1e200, 1e200, 1e150, 1e150))
    lockstep = Lockstep(replace(config, vehicles=(runaway, *config.vehicles[1:])))
    frames = [out for out in drive(lockstep, 50, {1, 2, 3, 4}) if type(out).__name__ == "Frame"]
    assert len(frames) == 51
    assert {frame.vehicles[0].eta for frame in frames} == {runaway.eta0}
    ((vehicle, tick, text),) = lockstep.state.notes
    assert (vehicle, tick) == (1, 0)
    assert text.startswith("error: the motion left the finite numbers")
    assert [(life.tick, life.vehicle) for f in frames for life in f.lives if life.diverged] == [(1, 1)]


def test_deaths_of_others_are_refused() -> None:
    lockstep = Lockstep(world())
    lockstep.grant(5)
    assert lockstep.end(2, 1) == []  # another incarnation's
    assert not lockstep.state.lacks_agent(2)


def run(folder: Path, *overrides: str, in_process: bool = True) -> Result:
    checks = "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived}"
    scenario = load_scenario("paper", [checks, *overrides])
    return execute(scenario, Options(folder, in_process=in_process, quiet=True))


def test_a_run_full_of_faults_is_the_same_everywhere(tmp_path: Path) -> None:
    """Network faults and a scripted kill: the ledger balances, and distributed gives the bytes of in-process."""
    faults = (
        "faults=[{at: 300 ms, for: 400 ms, "
        "link 1<->2: delay 50ms 20ms loss gemodel 10% 30% duplicate 20% corrupt 10%}, "
        "{at: 500 ms, for: 500 ms, partition: halves}, {at: 800 ms, kill: 3}, {at: 1 s, deaf: 1, for: 300 ms}]"
    )
    results = [run(tmp_path, "duration=2 s", faults, in_process=flag) for flag in (True, False)]
    assert [r.status for r in results] == [Status.PASS] * 2, [(r.reason, r.lines, r.checks) for r in results]
    alone, fleet = ((r.directory / "run.mcap").read_bytes() for r in results)
    assert alone == fleet
    assert told(results[0].directory) == [
        (0.3, "f1", "begins"), (0.5, "f2", "begins"), (0.7, "f1", "ends"), (0.8, "f3", "begins"),
        (1.0, "f2", "ends"), (1.0, "f4", "begins"), (1.3, "f4", "ends"),
        (1.32, "tumbled-3", "begins"),  # without an agent it tumbles
        (2.0, "f3", "ends"), (2.0, "tumbled-3", "ends"),
    ]  # fmt: skip
    assert results[1].values["deaths"] == {}  # nobody died who was not meant to


@pytest.mark.slow
def test_a_check_of_some_vehicles(tmp_path: Path) -> None:
    """The dead one is far away, which does not count against the others."""
    everyone = ["checks.formation_error={below: 0.1 m, after: 45 s}", "log.every=50 ticks"]
    result = execute(load_scenario("kill", everyone), Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.CHECK_FAILED
    assert "(vehicle 4" in next(v.found for v in result.checks if v.check == "formation_error")


@pytest.mark.slow
def test_a_killed_agent_does_not_end_the_run(tmp_path: Path) -> None:
    """kill -9 from outside: explained, recorded, the vehicle drifts, the others go on, nothing is lost on the way."""
    arguments = [
        "--duration",
        "6 s",
        "--speed",
        "4",
        "--set",
        "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived, deaths: {at_most: 1}}",
    ]
    with LiveRun(tmp_path / "runs", "paper", *arguments) as live:
        live.until_running()
        os.kill(live.role("agent 3").pid, signal.SIGKILL)
        assert live.status(60.0) == 0
        live.until_nobody_is_left()
        assert "agent 3 (pid " in live.said
        assert "was killed by SIGKILL: its vehicle drifts without thrust" in live.said
        events = [event[1:] for event in told(live.directory)]
        # Where it tumbles depends on when it was killed, and that is wall time; it may do so after the end.
        others = [event for event in events if not event[0].startswith("tumbled-")]
        assert others == [("death-3", "begins"), ("death-3", "ends")]
        assert (
            next(
                v
                for v in json.loads((live.directory / "result.json").read_text("utf-8"))["checks"]
                if v["check"] == "deaths"
            )["value"]
            == 1
        )


@pytest.mark.parametrize("name", ["one", "majority", "ring", "bridge"])
def test_two_partitions_of_a_kind_are_drawn_apart(name: str) -> None:
    assert len({frozenset(partition(name, 7, 1, f"f{n}")) for n in range(8)}) > 3
