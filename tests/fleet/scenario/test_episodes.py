"""Episodes of a nemesis: where they lie, whom they concern, and how likely a pattern is."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise, permutations, product
from math import sqrt

import pytest
from samples import samples

from fleet.addons.studies.bare_run import bare_verdicts
from fleet.errors import ScenarioError
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections import episodes
from netem import draws

MOORED = """
title: episodes
moored: true
vehicles: 5
duration: 60 s
graph: {shape: ring}
agent: {law: "fleet.protocols.election:Election", parameters: {vehicles: 5, lease_s: 2, quorum: fleet}}
network: {period: 100 ms, links: {"*": delay 100ms 30ms}}
nemesis: {mode: episodes, watch: [control.leads above 0, control.candidate]}
checks: {fleet.protocols.checks:AtMostOneLeader: {per: fleet}}
"""
S = 10**9


def moored(*changes: str) -> Scenario:
    return parse_scenario(MOORED, "m.yaml", changes)


def plan(s: Scenario) -> episodes.EpisodePlan:
    assert s.undrawn.nemesis is not None
    return episodes.plan(s.undrawn.nemesis, s.targets)


AVERAGE = ("agent=fleet.protocols.average:ExactAverage", "nemesis.watch=null")


@pytest.mark.parametrize(
    ("changes", "unit_s", "begins_s"),
    [
        ((), 2.0, (2.0, 16.5, 31.0, 45.5)),
        (("nemesis.unit=3 s",), 3.0, (3.0, 22.0, 41.0)),
        (("nemesis.unit=3 s", "nemesis.start=0 s", "nemesis.until=40 s"), 3.0, (0.0, 20.0)),
        (AVERAGE, 1.0, (1.0, 15.7, 30.4, 45.1)),
        ((*AVERAGE, "neighbours.drop_after=4 s"), 4.0, (4.0, 32.0)),
    ],
)
def test_when_they_are(changes: tuple[str, ...], unit_s: float, begins_s: tuple[float, ...]) -> None:
    """The unit is what the scenario or its agent states, else ten rounds."""
    found = plan(parse_scenario(MOORED[: MOORED.index("checks")], "m.yaml", changes))
    assert found.unit == unit_s * S and found.begins == tuple(round(t * S) for t in begins_s)


@pytest.mark.parametrize("vehicles", [1, 2, 3, 5])
def test_kills_leave_somebody_alive_or_end(vehicles: int) -> None:
    """A search drew kills that ended the whole fleet for good, and then nothing was judged."""
    fleet = f"agent.parameters={{vehicles: {vehicles}, lease_s: 2, quorum: fleet}}"
    s = moored(f"vehicles={vehicles}", fleet, "nemesis={mode: episodes, pick: [kill]}", "graph={shape: complete}")
    forever = 0
    for seed in range(1, 200):
        faults, _ = episodes.draw(s.undrawn.nemesis, s.targets._replace(spec=s.spec.model_copy(update={"seed": seed})))
        for_good = [fault for fault in faults if fault.for_ is None]
        gone = {i for fault in for_good for i in fault.kind.vehicles(fault.values)}
        assert len(gone) < vehicles, f"seed {seed}"
        forever += len(for_good)
    assert (forever > 0) is (vehicles > 1)


@pytest.mark.parametrize("seed", range(1, 30))
def test_faults_lie_in_the_first_half_of_an_episode_but_for_those_that_stay(seed: int) -> None:
    s = moored(f"seed={seed}")
    unit, _, begins = plan(s)
    assert len(begins) <= len(s.spec.faults) + len(s.spec.triggers) <= 3 * len(begins)
    for fault in s.spec.faults:
        begin = max(at for at in begins if at <= fault.at)
        assert fault.at < begin + 3 * unit
        if fault.for_ is None:
            assert begin == begins[-1] and fault.kind.name in ("partition", "kill")
        else:
            assert s.targets.round_ns <= fault.for_ <= begin + 3 * unit - fault.at
    for trigger in s.spec.triggers:
        assert trigger.when.before is not None and trigger.wait is not None and trigger.for_ is not None
        begin = max(at for at in begins if at <= trigger.when.after)
        assert trigger.when.after < trigger.when.before
        assert trigger.when.before + trigger.wait + trigger.for_ <= begin + 4 * unit
    assert parse_scenario(s.to_yaml(), "m.yaml").spec == s.spec


def test_every_kind_and_every_size_of_target_is_drawn() -> None:
    drawn = [fault for seed in range(60) for fault in moored(f"seed={seed}").spec.faults]
    assert {fault.kind.name for fault in drawn} == set(episodes.KINDS)
    assert {len((fault.kill or "").split(",")) for fault in drawn if fault.kill} == {1, 2, 3, 4}
    assert {fault.hold.order for fault in drawn if fault.hold} == {"sent", "reversed"}


def test_a_vehicle_changes_sides_and_restarts_at_that_moment() -> None:
    """Three faults that belong together, as one needs who looks for a lease that is forgotten at a restart: a round
    later the vehicle has told its new side what it knew.
    """
    found = 0
    for seed in range(200):
        faults = moored(f"seed={seed}", "nemesis.watch=null").spec.faults
        for first, then, last in zip(faults, faults[1:], faults[2:], strict=False):
            if first.partition and then.partition and first.for_ and first.at + first.for_ == then.at and last.kill:
                before, after = ({*str(fault.partition).partition(" ")[0].split(",")} for fault in (first, then))
                found += before ^ after == {str(last.kill)} and last.at == then.at and (last.for_ or 9 * S) <= S
    assert found >= 5


def test_one_link_into_a_vehicle_is_held_before_the_vehicle_goes_mute() -> None:
    """A lease that is counted from the answer needs it: with all links held the vehicle would not lead."""
    found = 0
    for seed in range(400):
        faults = moored(f"seed={seed}", "nemesis.watch=null", "nemesis.pick=[hold, mute]").spec.faults
        for first, then in pairwise(faults):
            src, _, dst = str(first.hold.links if first.hold else "").partition("->")
            found += src.isdigit() and dst == str(then.mute)
    assert found >= 5


@pytest.mark.parametrize("vehicles", [5, 100, 101, 250])
def test_no_two_draws_of_an_order_are_the_same(vehicles: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The order of the vehicles in one fault says nothing about that in another one, however many they are."""
    asked = Counter[tuple[int, ...]]()

    def uniform(seed: int, purpose: str, number: int, what: int) -> float:
        asked[number, what] += what % 16 == episodes._WHO
        return draws.uniform(seed, purpose, number, what)

    s = moored("graph={shape: path}", f"vehicles={vehicles}", "nemesis.watch=null", "agent.parameters.vehicles=5")
    monkeypatch.setattr(episodes, "uniform", uniform)
    assert s.undrawn.nemesis is not None
    for seed in range(10):
        asked.clear()
        episodes.count_episodes(s.undrawn.nemesis, s.targets, [seed])
        assert max(asked.values()) == 1


def test_what_some_seeds_draw_is_counted_by_kind() -> None:
    s = moored("nemesis.watch=null")
    assert s.undrawn.nemesis is not None
    kinds, faults = episodes.count_episodes(s.undrawn.nemesis, s.targets, range(1, 61))
    assert kinds.total() == 60 * len(plan(s).begins) and set(kinds) == {"isolations", "splits", "mixed"}
    drawn = [moored(f"seed={seed}", "nemesis.watch=null").spec.faults for seed in range(1, 61)]
    assert faults == Counter(fault.kind.name for some in drawn for fault in some)


def test_only_kinds_that_are_picked_are_drawn() -> None:
    drawn = [f for seed in range(20) for f in moored(f"seed={seed}", "nemesis.pick=[kill, duplicate]").spec.faults]
    assert {fault.kind.name for fault in drawn} == {"kill", "duplicate"}


def test_how_likely_a_pattern_is() -> None:
    """Of two isolations of given vehicles in given units, against many runs of four episodes each."""
    vehicles, runs = 3, samples(1_000)
    wanted = [{(1, 0), (2, 1)}, {(3, 2), (3, 0)}, {(1, 1), (2, 1)}]
    hits, count = [0] * len(wanted), 0
    for seed in range(runs):
        s = moored(f"seed={seed}", f"vehicles={vehicles}", "agent.parameters.vehicles=3", "nemesis.pick=[partition]",
                   "nemesis.watch=null")  # fmt: skip
        unit, _, begins = plan(s)
        count += len(begins)
        for begin in begins:
            mine = [f for f in s.spec.faults if begin <= f.at < begin + 3 * unit]
            found = [(f.partition or "", (f.at - begin) // unit) for f in mine]
            single = [(int(text[0]), w) for text, w in found if text[1:3] == " /"]
            for k, pattern in enumerate(wanted):
                hits[k] += len(single) == len(mine) == 2 and set(single) == pattern
    one = episodes.chance(2, vehicles, 1)
    # Other episodes cut off single vehicles, too, so what is counted is not less.
    for hit in hits:
        assert hit / count > one - 3 * sqrt(one / count)
    assert episodes.chance(2, vehicles, 2) == pytest.approx(1 - (1 - one) ** 2)


def test_the_chances_of_all_patterns_add_up_to_those_of_the_episodes() -> None:
    """Each of a number of isolations, whatever their order; two of one vehicle in one unit are no pattern."""
    for n in (1, 2, 3):
        places = list(product(range(5), range(3)))
        patterns = {frozenset(some) for some in permutations(places, n)}
        repeated = 1 - len(patterns) * {1: 1, 2: 2, 3: 6}[n] / len(places) ** n
        share = sum(episodes.chance(n, 5, 1) for _ in patterns)
        assert share == pytest.approx(episodes.SHARES[n] / 3 * (1 - repeated))


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_bare_run_takes_all_of_them(seed: int) -> None:
    assert bare_verdicts(moored(f"seed={seed}"))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("nemesis.unit=30 s", "nemesis"),
        ("nemesis.pick=[loss]", "nemesis.pick.1"),
        ("nemesis.mean=1 s", "nemesis.mean"),
        ("nemesis.every=1 s", "nemesis.every"),
        ("nemesis={mode: swarm, unit: 3 s}", "nemesis.unit"),
    ],
)
def test_a_mistake_is_at_its_key(change: str, key: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        moored(change)
    assert key in [problem.key for problem in caught.value.problems]
