"""What is done on the page is a command, which does the same when it is typed."""

from __future__ import annotations

import shlex

import pytest
from refusals import check_refusals
from small_scenario import small
from tool import invoke

from fleet.addons.page import page as words
from fleet.scenario.faults.kind import FaultKind, LinkFaultKind, VehicleFaultKind
from fleet.scenario.text.fault_words import read_fault


@pytest.mark.parametrize(("kind", "target"), [(LinkFaultKind, "1->2"), (VehicleFaultKind, "2"), (FaultKind, "")])
def test_every_suggestion_is_a_fault(kind: type[FaultKind], target: str) -> None:
    scenario = small("duration=60 s")
    offered = words.suggestions(kind, target)
    assert offered
    for name, text in offered.items():
        assert words.entry(text, "5s", scenario, 100)["for"] == "5s", name


def test_the_command_to_copy_says_the_same() -> None:
    command = words.inject("link 1->2 delay 500ms loss 20%", "10s", "paper-1")
    assert command == "fleet inject link '1->2' delay 500ms loss 20% --for 10s --run paper-1"
    typed = shlex.split(command)[2:]
    assert read_fault(" ".join(typed[: typed.index("--for")])) == read_fault("link 1->2 delay 500ms loss 20%")


@pytest.mark.parametrize(
    "command",
    [
        words.inject("kill 3", "", "paper-1"),
        words.inject("partition 1,2 / 3,4", "5s", "paper-1"),
        words.inject("current -0.2 0 0 m/s", "5s", "paper-1"),
        words.heal(None, "paper-1"),
        words.heal("live-1", "paper-1"),
        words.clock("pause", None, "paper-1"),
        words.clock("step", 10, "paper-1"),
        words.clock("speed", None, "paper-1"),
        words.clock("speed", 0.5, "paper-1"),
    ],
)
def test_each_is_a_command_of_the_command_line(command: str) -> None:
    """It is understood as far as to look for the run, which there is none of."""
    result = invoke(*shlex.split(command)[1:])
    assert "no live run" in result.stderr, result.stderr


def test_a_line_through_the_fleet_is_a_partition() -> None:
    assert words.partition([[1, 2], [3]]) == "partition 1,2 / 3"
    assert words.entry(words.partition([[1, 2], [3]]), "", small("duration=60 s"), 100)


def test_what_is_no_fault_of_this_run_is_refused_as_it_is_typed() -> None:
    check_refusals("view/faults that are typed", lambda *typed: words.entry(*typed, small("duration=60 s"), 100))
