"""Faults in words: they mean what the same fault means in a scenario, and their mistakes have a place."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest
from any_condition import conditions
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from fleet.quantities import show_time
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.loading import load_scenario
from fleet.scenario.schema.faults import ACTIONS, FaultEntry, FaultSection
from fleet.scenario.sections.fault_entry import entry_of, words_of
from fleet.scenario.text.fault_words import FaultWordsError, example, read_fault
from netem.grammar import print_condition

ENTRY: TypeAdapter[FaultSection] = TypeAdapter(FaultEntry)


def words(fault: FaultSection) -> str:
    """A fault in the words of the log."""
    return words_of(entry_of(fault))


def told(fault: FaultSection) -> str:
    """A fault in the words of the log, with its times and its name."""
    lasts = "" if fault.for_ is None else f"for {show_time(fault.for_)} "
    name = "" if fault.id is None else f" id {fault.id}"
    return f"at {show_time(fault.at)} {lasts}{words(fault)}{name}"


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("at 20s for 10s partition halves", {"at": "20s", "for": "10s", "partition": "halves"}),
        ("partition 1, 2 / 3, 4 at 20 s for 1 min", {"at": "20 s", "for": "1 min", "partition": "1, 2 / 3, 4"}),
        ("at 5s partition isolate:3 id alone", {"at": "5s", "id": "alone", "partition": "isolate:3"}),
        ("link 1<->2 delay 500ms loss 20%", {"link": {"1<->2": "delay 500ms loss 20%"}}),
        ("link '1 -> 2' 'down'", {"link": {"1 -> 2": "down"}}),
        ("link * down, 1->2: loss 3%", {"link": {"*": "down", "1->2": "loss 3%"}}),
        ("slow vehicles=2 by='5 ticks' for 2s", {"for": "2s", "slow": {"vehicles": "2", "by": "5 ticks"}}),
        ("gust velocity=0 0.5 0 m/s over=10 s", {"gust": {"velocity": "0 0.5 0 m/s", "over": "10 s"}}),
        ("noise {vehicles: 2-3,5, position_noise: 0.1 m}", {"noise": {"vehicles": "2-3,5", "position_noise": "0.1 m"}}),
        ("current 0.2 0 0 m/s", {"current": "0.2 0 0 m/s"}),
        ("current mean=0.2 0 0 m/s", {"current": {"mean": "0.2 0 0 m/s"}}),
        ("kill 2-3", {"kill": "2-3"}),
        ("hold 1->2 for 3 s", {"for": "3 s", "hold": "1->2"}),
        ("hold links=1->2 order=reversed", {"hold": {"links": "1->2", "order": "reversed"}}),
        ("at 20 kill 3", {"at": "20", "kill": "3"}),  # the schema says that the time has no unit
    ],
)
def test_words_are_the_fault_that_a_scenario_has(text: str, meant: dict[str, Any]) -> None:
    assert read_fault(text) == meant


@pytest.mark.parametrize(
    ("kind", "once"), [("dvl", "lost"), ("compass", "lost"), ("fix", "lost"), ("dropout", "probability")]
)
def test_a_share_that_is_lost_is_read_by_both_names_and_logged_by_the_old_one(kind: str, once: str) -> None:
    new, old = (ENTRY.validate_python({"at": "1 s", kind: {key: "30 %"}}) for key in ("loss", once))
    assert new == old
    assert words(new) == f"{kind} {{{once}: 30 %}}"
    assert new.model_dump(exclude_defaults=True, by_alias=True)[kind] == {"loss": "30 %"}


@pytest.mark.parametrize("kind", ACTIONS)
def test_the_example_of_every_kind_is_a_fault(kind: str) -> None:
    assert words(ENTRY.validate_python({"at": "1 s", **read_fault(example(kind))})).split()[0] == kind


def test_every_fault_of_the_shipped_scenarios_is_told_in_words_and_read_again() -> None:
    """Those of the timelines, and those that the nemesis draws."""
    faults = [fault for name in shipped_scenarios() for fault in load_scenario(name).spec.faults]
    assert len(faults) > 10
    assert [ENTRY.validate_python(read_fault(told(fault))) for fault in faults] == faults


SHARE = st.floats(0, 1).map(str)
TIMES = st.integers(0, 10**12).map(show_time)
PERIODS = st.integers(1, 10**12).map(show_time)
VEHICLES = st.lists(st.integers(1, 99), min_size=1, max_size=3).map(lambda numbers: ", ".join(map(str, numbers)))
SELECTORS = st.sampled_from(["*", "1->2", "1<->2", "1->*", "*->2", "2 -> 13"])


def vector(unit: str, least: float = -1e3) -> st.SearchStrategy[str]:
    number = st.floats(least, 1e3)
    return st.builds(lambda x, y, z: f"{x!r} {y!r} {z!r} {unit}", number, number, number)


def amount(unit: str, least: float = 0.0) -> st.SearchStrategy[str]:
    return st.floats(least, 1e3).map(lambda number: f"{number!r} {unit}")


def some(**values: st.SearchStrategy[str]) -> st.SearchStrategy[dict[str, str]]:
    """A section with at least one value."""
    return st.fixed_dictionaries({}, optional=values).filter(bool)


TARGETS: dict[str, st.SearchStrategy[Any]] = {
    "link": st.dictionaries(SELECTORS, conditions().map(print_condition), min_size=1, max_size=3),
    "down": SELECTORS,
    "hold": SELECTORS | st.fixed_dictionaries({"links": SELECTORS, "order": st.just("reversed")}),
    "duplicate": st.fixed_dictionaries({"links": SELECTORS, "after": PERIODS}),
    "up": SELECTORS,
    "partition": st.sampled_from(["1,2 / 3,4", "1, 2 /3", "halves", "one", "ring", "isolate:3", "isolate: 3"]),
    "slow": st.fixed_dictionaries({"by": st.integers(1, 99).map("{} ticks".format)}, optional={"vehicles": VEHICLES}),
    "clock": some(vehicles=VEHICLES, step=st.integers(-99, 99).map("{} ms".format), drift=amount("ppm", -99.0)),
    "noise": some(vehicles=VEHICLES, position_noise=amount("m"), angle_noise=amount("deg"), rate_noise=amount("deg/s")),
    "bias": some(vehicles=VEHICLES, position=vector("m"), velocity=vector("m/s"), yaw=amount("deg", -99.0)),
    "dropout": st.fixed_dictionaries({"probability": SHARE}, optional={"vehicles": VEHICLES}),
    "dvl": some(vehicles=VEHICLES, lost=SHARE, bias=vector("m/s"), jump=amount("cm/s"), chance=SHARE),
    "compass": some(vehicles=VEHICLES, lost=SHARE, bias=amount("deg", -99.0), jump=amount("deg")),
    "fix": some(vehicles=VEHICLES, lost=SHARE, jump=amount("m"), chance=SHARE),
    "efficiency": some(vehicles=VEHICLES, surge=SHARE, pitch=SHARE),
    "saturate": some(vehicles=VEHICLES, surge_force=amount("N"), yaw_moment=amount("N m")),
    "current": vector("m/s") | st.fixed_dictionaries({"mean": vector("m/s"), "sigma": vector("cm/s", 0.0)}),
    "gust": st.fixed_dictionaries({"velocity": vector("m/s"), "over": PERIODS}),
    "wrench": some(vehicles=VEHICLES, force=vector("N"), pitch_moment=amount("N m", -99.0)),
}
FAULTS = st.sampled_from(ACTIONS).flatmap(
    lambda kind: st.fixed_dictionaries(
        {"at": TIMES, kind: TARGETS.get(kind, VEHICLES)},
        optional={"for": PERIODS, "id": st.sampled_from(["f1", "split", "7"])},
    )
)


@given(FAULTS)
def test_any_fault_is_told_in_words_and_read_again(entry: dict[str, Any]) -> None:
    fault = ENTRY.validate_python(entry)
    assume(not fault.kind.does_nothing(fault.values))  # no scenario may have such a fault
    assert ENTRY.validate_python(read_fault(told(fault))) == fault


@given(st.text(alphabet="at for id link kill slow by= : , { } ' \" 1->2 * 5s 30% \x00é"))
def test_any_text_is_read_or_refused_in_words(text: str) -> None:
    with suppress(FaultWordsError):
        assert read_fault(text).keys() & set(ACTIONS)
