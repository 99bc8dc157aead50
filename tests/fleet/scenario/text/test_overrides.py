"""`--net` and `--fault`: what they make of a scenario, and where their mistakes are. (`--set`: test_scenario.)"""

from __future__ import annotations

import pytest
from small_scenario import SMALL

from fleet.errors import ScenarioError
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario, timeline
from fleet.scenario.text.overrides import FAULT, NET, Override
from netem.grammar import parse_condition

HALVES, KILL = Override(FAULT, "at 200ms for 100 ms partition halves"), Override(FAULT, "at 500 ms kill 3")


def small(*overrides: str | Override) -> Scenario:
    return parse_scenario(SMALL, "small.yaml", overrides)


def refused(*overrides: str | Override) -> str:
    with pytest.raises(ScenarioError) as caught:
        small(*overrides)
    return str(caught.value)


def test_a_fault_in_words_is_the_same_as_in_the_file() -> None:
    words = small(HALVES, KILL)
    assert words == small("faults=[{at: 200 ms, for: 100 ms, partition: halves}, {at: 500 ms, kill: 3}]")
    assert parse_scenario(words.to_yaml(), "again.yaml") == words  # so it is recorded


def test_faults_come_behind_those_of_the_scenario() -> None:
    both = small("faults=[{at: 800 ms, mute: 1, id: quiet}]", HALVES)
    assert [row[0] for row in timeline(both)] == ["f2", "quiet"]
    drawn = small("nemesis={every: 300 ms, for: 100 ms, pick: [mute]}", KILL)
    assert len(drawn.spec.faults) > 1
    assert "kill 3" in [what for *_, what in timeline(drawn)]


def test_an_empty_list_of_faults_takes_one() -> None:
    assert small("faults=null", KILL) == small("faults=[]", KILL) == small(KILL)


def test_links_are_added_and_the_last_one_wins() -> None:
    found = small(Override(NET, "* delay 100ms loss 20%"), Override(NET, "1->2 down"))
    assert found == small("network.links={'*': delay 100ms loss 20%, 1->2: down}")
    assert small(Override(NET, "1->2 down, 2->3: loss 3%")).conditions == {
        (1, 2): parse_condition("down"),
        (2, 3): parse_condition("loss 3%"),
    }


def test_links_replace_the_same_selector_however_it_is_written() -> None:
    before = "network.links={'2 -> 1': loss 1%, '*': loss 2%, 1->2: loss 3%}"
    found = small(before, Override(NET, "2->1 down"))
    assert list(found.spec.network.links) == ["*", "1->2", "2->1"]
    assert found.conditions[2, 1] == parse_condition("down")
    everywhere = small(before, Override(NET, "* loss 9%"))
    assert set(everywhere.conditions.values()) == {parse_condition("loss 9%")}


def test_they_apply_after_a_network_that_is_set_and_after_scaling() -> None:
    found = load_scenario("paper", [Override(NET, "7->8 down"), "vehicles=8", "network={period: 200 ms}"])
    assert (found.spec.network.period, set(found.conditions)) == (200_000_000, {(7, 8)})


def test_links_of_an_acoustic_network() -> None:
    assert small("network=acoustic", Override(NET, "1->2 down")) == small("network={acoustic: {}, links: {1->2: down}}")


def test_every_mistake_is_reported_and_those_of_the_file_come_first() -> None:
    text = refused(Override(FAULT, "at 1s kill 9"), Override(NET, "9->8 down"), "seed=x", Override(FAULT, "kill"))
    lines = [line for line in text.splitlines() if not line.startswith(" ")]
    assert [line.split(":")[0] for line in lines] == [
        "--fault at 1s kill 9", "--net 9->8 down", "--set seed=x", "--fault kill", "4 problems",
    ]  # fmt: skip


def test_a_caret_stands_below_the_words_at_fault() -> None:
    shown, caret = refused(Override(FAULT, "at 1s  for 2s  partition 1, 2 / 9")).splitlines()[1:3]
    assert shown[caret.index("^") :] == "1, 2 / 9"


def test_one_word_of_a_links_condition_keeps_the_others_and_the_order() -> None:
    before = "network.links={'2 -> 1': delay 1ms loss 1%, '*': delay 2ms loss 2%, 1->2: loss 3%}"
    found = small(before, "network.links.*.loss=50 %", "network.links.2->1.delay=7 ms")
    assert (
        found.to_yaml()
        == small("network.links={2->1: delay 7ms loss 1%, '*': delay 2ms loss 50%, 1->2: loss 3%}").to_yaml()
    )
    assert small("network.links.*.loss=5%") == small("network.links={'*': loss 5%}")  # of links without a condition


def test_an_ideal_network_has_no_word_to_change() -> None:
    assert "is ideal and has no links" in refused("network=ideal", "network.links.*.loss=3%")
