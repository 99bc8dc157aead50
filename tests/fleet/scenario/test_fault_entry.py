"""A fault as data: what events carry, so that nobody has to read its words."""

from __future__ import annotations

import json

import pytest

from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.loading import load_scenario
from fleet.scenario.schema.faults import FaultAction
from fleet.scenario.sections.fault_entry import (
    entry_kind,
    entry_of,
    entry_vehicles,
    fault_of,
    is_fault,
    vehicle_entry,
    words_of,
)
from fleet.scenario.text.fault_words import MOST_WORDS, entry_of_words, example

NAMES = ("auv1", "m-2", "kill", "a.b", "x")  # nodes may have such names


@pytest.mark.parametrize("kind", KINDS)
def test_words_and_entry_of_every_kind_say_the_same_with_numbers_and_with_names(kind: str) -> None:
    entry = entry_of_words(example(kind))
    assert entry_kind(entry) == kind and is_fault(entry)
    for names in ((), NAMES) if KINDS[kind].acts_on == "network" else ((),):  # nodes have no other faults
        assert entry_of_words(words_of(entry, names), names) == entry
    fault = fault_of(entry)
    assert fault is not None and entry_of(fault) == entry
    assert entry_vehicles(entry) == fault.kind.vehicles(fault.values)


def test_every_planned_fault_of_the_shipped_scenarios_has_the_entry_of_its_words() -> None:
    """So a log, which has the words alone, tells the same as the run did."""
    events = [(event, one.nodes) for one in map(load_scenario, shipped_scenarios()) for event in one.faults.events]
    assert len(events) > 20
    for event, names in events:
        assert event.entry == entry_of_words(event.what, tuple(names))
        assert isinstance(fault_of(event.entry), FaultAction)


def test_what_befell_a_vehicle_is_no_fault() -> None:
    for kind in ("tumbled", "diverged"):
        entry = vehicle_entry(kind, 3)
        assert not is_fault(entry) and entry == entry_of_words(f"{kind} 3")
        assert (entry_kind(entry), entry_vehicles(entry)) == (kind, (3,))


@pytest.mark.parametrize(
    "words",
    [
        "",
        " ",
        "kill",
        "kill everybody",
        "nothing 3",
        "kill 1-999999999",
        "partition",
        "tumbled ever",
        "{}",
        "kill 3 " * 20000,
    ],
)
def test_words_of_a_stranger_are_no_fault(words: str) -> None:
    entry = entry_of_words(words)
    assert entry_vehicles(entry) == () and fault_of(entry or json.dumps({"x": 1})) is None


def test_long_words_are_read_up_to_a_limit() -> None:
    link = "link " + ", ".join(f"{i}->{i + 1}: loss 10%" for i in range(1, 400))
    assert entry_kind(entry_of_words(link)) == "link" and len(link) < MOST_WORDS
