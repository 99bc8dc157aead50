"""Faults that the seed draws, of a swarm and of a nemesis: whom they are aimed at, all in a list before the run."""

from __future__ import annotations

from itertools import pairwise
from math import log
from statistics import mean

import pytest
from small_scenario import read_back, small

from fleet.execution.whole_run import run_loaded
from fleet.quantities import vehicle_numbers
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.schema.nemesis import WORDS, NemesisPick
from fleet.scenario.sections import liveness, nemesis_targets, swarm
from fleet.scenario.sections.graph import neighbours, reachable
from fleet.scenario.sections.nemesis import keep_within_limit
from fleet.scenario.sections.swarm import DrawnFault
from netem.fault_kinds import WorldFaultKind

S = 10**9
LONG = ("duration=100 s", "graph={shape: ring}", "vehicles=6", "nemesis=swarm")


def drawn(s: Scenario) -> list[DrawnFault]:
    return swarm.draw(s.undrawn.nemesis, s.targets)


def test_the_seed_draws_kinds_number_beginning_length_and_strength() -> None:
    """Laws of the draws, over 150 seeds; each tolerance is about four standard deviations."""
    runs = [drawn(small(*LONG, f"seed={seed}")) for seed in range(150)]
    all_faults = [fault for run in runs for fault in run]
    kinds = [len({fault.pick.drawn for fault in run}) for run in runs if len(run) > 15]
    assert 2 < mean(kinds) < 7 and len({fault.pick.drawn for fault in all_faults}) == 10  # of ten, each with 1/2
    assert min(map(len, runs)) <= 1 and max(map(len, runs)) > 20
    holding = {name for name, kind in KINDS.items() if kind.holds_command}
    inner = [fault for fault in all_faults if fault.at < 20 * S and fault.pick.drawn not in holding]
    shares = [log(fault.lasts / 50e6) / log(50 * S / 50e6) for fault in inner]  # log-uniform from a round to half a run
    assert mean(shares) == pytest.approx(0.5, abs=0.06) and min(shares) >= 0 and max(shares) > 0.97
    assert mean(fault.strength for fault in all_faults) == pytest.approx(0.5, abs=0.04)
    assert {fault.aim for fault in all_faults} == {"any", "leader", "hub", "bridge", "speaker"}
    assert any(b.at < a.at + a.lasts for run in runs for a, b in pairwise(run))  # they overlap
    assert all(fault.at + fault.lasts <= 75 * S and fault.lasts % 10**7 == 0 for fault in all_faults)
    steady = [drawn(small(*LONG, "nemesis={mode: swarm, mean: 1 s}", f"seed={seed}")) for seed in range(30)]
    gaps = [(b.at - a.at) / S for run in steady for a, b in pairwise(run)]
    assert mean(gaps) == pytest.approx(1.0, abs=0.09)
    assert mean(gap > 1.0 for gap in gaps) == pytest.approx(0.37, abs=0.05)  # exp(-1): a Poisson process


def test_what_is_drawn_is_a_list_before_the_run_and_makes_the_same_run() -> None:
    """Every kind is on in one of these; a scenario of the list alone is the same, to the digest."""
    words = f"nemesis={{mode: swarm, mean: 60 ms, until: 900 ms, pick: [{', '.join(WORDS)}]}}"
    more = ("agent.clock={drift: 20 ppm}", "navigation={usbl: {at: 0 0 0 m}}")
    seen = set()
    for seed in range(1, 13):
        s = small(words, *more, f"seed={seed}")
        seen |= {fault.kind.name for fault in s.spec.faults}
        again = read_back(s)
        assert again.undrawn.nemesis is None
        result = run_loaded(s)
        assert result.status in ("pass", "check_failed"), result.reason
        if seed < 3:
            assert run_loaded(again).digest == result.digest
    assert seen == {*WORDS, "link"} - {"loss", "delay", "rate"}


def aimed(s: Scenario, *faults: tuple[str, str, float, float]) -> list[str]:
    """The targets of faults, each of (kind, aim, at, for) [s]."""
    those = [
        DrawnFault(n, NemesisPick.model_validate({"drawn": kind}), int(at * S), int(lasts * S), aim)
        for n, (kind, aim, at, lasts) in enumerate(faults, start=1)
    ]
    written = swarm.to_sections(those, s.targets)
    return [str(getattr(fault, fault.kind.name)) for fault in written]


def test_aims_go_by_the_graph_and_by_what_was_before() -> None:
    star = small(*LONG, "graph={shape: star, hub: 4}")
    assert aimed(star, ("kill", "hub", 1, 1)) == ["4"]
    assert aimed(star, ("down", "leader", 1, 1))[0] in ("1->*", "*->1", "*<->1")
    led = small(*LONG, "graph={shape: ring, reference: [3]}", "knows_reference=false")
    assert aimed(led, ("kill", "leader", 1, 1), ("partition", "leader", 3, 1)) == ["3", "isolate:3"]
    named = small(*LONG, "nemesis={mode: swarm, leader: 5}")
    assert aimed(named, ("mute", "leader", 1, 1)) == ["5"]
    line = small(*LONG, "graph={shape: path}", "vehicles=3")
    assert aimed(line, ("partition", "bridge", 1, 1))[0] in ("1 / 2,3", "1,2 / 3")
    ring = small(*LONG)
    assert nemesis_targets.bridges(frozenset(ring.targets.pairs)) == ()
    # A ring has no bridge; while one pair is cut every other one is.
    (text,) = {t for t in aimed(ring, ("down", "any", 1, 9), ("partition", "bridge", 2, 1)) if "/" in t}
    assert all(vehicle_numbers(part) for part in text.split("/"))
    back = aimed(ring, ("kill", "any", 1, 1), ("mute", "any", 1.5, 3), ("deaf", "speaker", 3, 1))
    assert back[2] == back[0]  # who was killed speaks again; who was muted is mute still


def test_bridges_are_the_pairs_without_which_more_parts_are() -> None:
    """The law itself, by trying, on 60 random graphs."""
    for seed in range(60):
        s = small("vehicles=8", "graph={shape: random, probability: 0.15}", f"seed={seed}", "nemesis=swarm")
        pairs = frozenset(s.targets.pairs)

        def parts(some: frozenset[tuple[int, int]]) -> int:
            return len({min(reachable([i], neighbours(some))) for i in range(1, 9)})

        assert nemesis_targets.bridges(pairs) == tuple(sorted(p for p in pairs if parts(pairs - {p}) > parts(pairs)))


CHECKS = (
    "checks={signal: [{name: at-last, topic: state.z, below: 9 m, eventually_within: 1 s, fault: every}, "
    "{name: never, topic: state.z, above: 99 m, never: true}], formation_error: {below: 9 m, after: 60 s}}"
)


def test_liveness_heals_a_core_and_leaves_the_others_broken() -> None:
    for seed in range(20):
        s = small(*LONG, "nemesis=liveness", CHECKS, f"seed={seed}")
        core = set(liveness.core(s.undrawn.nemesis, s.targets))
        inside = [pair for pair in s.targets.pairs if set(pair) <= core]
        assert len(core) == 4 and reachable([min(core)], neighbours(inside)) == core
        lasting = [fault for fault in s.spec.faults if fault.for_ is None]
        hit = {int(str(getattr(fault, fault.kind.name)).removeprefix("isolate:")) for fault in lasting}
        assert hit == {1, 2, 3, 4, 5, 6} - core
        assert all(fault.at + fault.for_ <= 50 * S for fault in s.spec.faults if fault.for_ is not None)
        last, never = s.spec.checks.signal or []
        assert (set(vehicle_numbers(last.vehicles or "")), last.after, last.fault) == (core, 50 * S, None)
        assert (never.vehicles, never.after) == (None, 0)
        error = s.spec.checks.formation_error
        assert error is not None and (set(vehicle_numbers(error.vehicles or "")), error.after) == (core, 60 * S)
        read_back(s)
    led = small(*LONG, "graph={shape: path, reference: [1]}", "knows_reference=false", "nemesis=liveness")
    assert led.undrawn.nemesis is not None and 1 in liveness.core(led.undrawn.nemesis, led.targets)


def test_vehicles_that_lack_an_instrument_are_not_hit_there() -> None:
    some = "per_vehicle={2: {agent: {clock: {drift: 20 ppm}}}}"
    s = small(*LONG, some, "nemesis={mode: swarm, mean: 1 s, pick: [clock]}")
    assert {i for fault in s.spec.faults for i in fault.kind.vehicles(fault.values)} == {2}
    plain = small(*LONG)
    assert not {"clock", "compass"} & {pick.drawn for pick in swarm.picks_of(plain.undrawn.nemesis, plain.targets)}
    ideal = load_scenario("ideal", ["nemesis={mode: swarm, mean: 1 s}"])
    assert {fault.kind.name for fault in ideal.spec.faults} <= set(WorldFaultKind)


SWARM = ("duration=60 s", "vehicles=5", "graph={shape: ring}")
ONE = "nemesis={mode: swarm, pick: [kill, mute, down], mean: 2 s, most_silent: 1}"


def fault(at: str, **more: str) -> FaultSection:
    return FaultSection.model_validate({"at": at, **more})


def silent_at_once(scenario: Scenario) -> int:
    """The most vehicles that are silent at a time."""
    spells = [
        (one.at, one.at + (one.for_ or scenario.duration_ns), one.kind.vehicles(one.values))
        for one in scenario.spec.faults
        if one.kind.name in ("kill", "mute", "pause")
    ]
    return max((len({i for a, b, who in spells if a <= at < b for i in who}) for at, _, _ in spells), default=0)


def test_what_goes_beyond_is_left_out() -> None:
    faults = [fault("1 s", kill="1", **{"for": "4 s"}), fault("2 s", mute="1", **{"for": "1 s"}),
              fault("3 s", kill="2", **{"for": "9 s"}), fault("4 s", down="1->2"), fault("5 s", pause="3")]  # fmt: skip

    def kept(most: int | None, *own: FaultSection) -> list[bool]:
        left = keep_within_limit(most, faults, own)
        return [one in left for one in faults]

    assert kept(None) == [True] * 5
    assert kept(1) == [True, True, False, True, True]  # of the same vehicle; after the first
    assert kept(2) == [True, True, True, True, True]
    assert kept(1, fault("0 s", kill="5")) == [False, False, False, True, False]


def test_a_seed_keeps_to_it() -> None:
    free = [small(*SWARM, ONE, "nemesis.most_silent=5", f"seed={n}") for n in range(1, 10)]
    kept = [small(*SWARM, ONE, f"seed={n}") for n in range(1, 10)]
    assert max(map(silent_at_once, free)) > 1 and max(map(silent_at_once, kept)) == 1
