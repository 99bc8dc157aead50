"""`--net` and `--fault`: what they make of a scenario. (`--set`: test_scenario.)"""

from __future__ import annotations

from small_scenario import SMALL, read_back

from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario, timeline
from fleet.scenario.text.overrides import FAULT, NET, Override
from netem.grammar import parse_condition

HALVES, KILL = Override(FAULT, "at 200ms for 100 ms partition halves"), Override(FAULT, "at 500 ms kill 3")


def small(*overrides: str | Override) -> Scenario:
    return parse_scenario(SMALL, "small.yaml", overrides)


def test_a_fault_in_words_is_the_same_as_in_the_file() -> None:
    words = small(HALVES, KILL)
    assert words == small("faults=[{at: 200 ms, for: 100 ms, partition: halves}, {at: 500 ms, kill: 3}]")
    read_back(words)  # so it is recorded


def test_faults_come_behind_those_of_the_scenario() -> None:
    both = small("faults=[{at: 800 ms, mute: 1, id: quiet}]", HALVES)
    assert [fault.id for fault in timeline(both)] == ["f2", "quiet"]
    drawn = small("nemesis={every: 300 ms, for: 100 ms, pick: [mute]}", KILL)
    assert len(drawn.spec.faults) > 1
    assert "kill 3" in [fault.what for fault in timeline(drawn)]


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


def test_one_word_of_a_links_condition_keeps_the_others_and_the_order() -> None:
    before = "network.links={'2 -> 1': delay 1ms loss 1%, '*': delay 2ms loss 2%, 1->2: loss 3%}"
    found = small(before, "network.links.*.loss=50 %", "network.links.2->1.delay=7 ms")
    assert (
        found.to_yaml()
        == small("network.links={2->1: delay 7ms loss 1%, '*': delay 2ms loss 50%, 1->2: loss 3%}").to_yaml()
    )
    assert small("network.links.*.loss=5%") == small("network.links={'*': loss 5%}")  # of links without a condition
