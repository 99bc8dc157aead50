"""Mistakes in scenarios: the place, key and words of each, as `tests/expected/messages-scenario.txt` says.

There each section is a scenario, and each entry what is changed in it, as on the command line.
"""

from __future__ import annotations

from functools import partial

import pytest
from refusals import check_refusals
from small_scenario import SMALL

from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.fault_words import read_fault
from fleet.scenario.text.overrides import FAULT, NET, Override

ACOUSTIC = SMALL.replace("{period: 50 ms}", "{period: 2 s, payload: compact, acoustic: {modem: fsk-80}}")
STATES = "{'*': {states: {good: {condition: delay 50ms, mean: 8 s}, bad: {condition: loss 80%, mean: 2 s}}}}"
NODES = "title: A stack\nnodes: {m1: {}, m2: {}, shore: {}}\n"
BASES = {
    "small": SMALL,
    "acoustic": ACOUSTIC.replace("duration: 1 s", "duration: 8 s"),
    "link states": SMALL.replace("50 ms}", f"50 ms, links: {STATES}}}"),
    "links": SMALL.replace("50 ms}", "50 ms, links: {'*': delay 2ms}}"),
    "checks": SMALL
    + "faults: [{at: 100 ms, for: 100 ms, id: split, mute: 1}, {at: 300 ms, mute: 2}, {at: 500 ms, kill: 3}]\n",
    "stack": NODES + 'programs: {"m*": {run: sleep 1}, m1: {run: "member {listen}"}}\nduration: 5 s\n',
    "stack without programs": NODES,
    "programs without nodes": SMALL,
    "faults": SMALL + "faults: [{id: cut, at: 100 ms, for: 100 ms, down: 1->2}, {id: off, at: 300 ms, down: 2->3}]\n",
}


def changed(text: str, *changes: str) -> Scenario:
    kinds = {"--net": NET, "--fault": FAULT}
    overrides = [
        Override(kinds[kind], rest) if (kind := change.partition(" ")[0]) in kinds else change
        for change in changes
        for rest in [change.partition(" ")[2]]
    ]
    return parse_scenario(text, "small.yaml", overrides)


@pytest.mark.parametrize("name", BASES)
def test_a_mistake_is_told_with_its_place(name: str) -> None:
    check_refusals(f"scenario/{name}", partial(changed, BASES[name]))


def test_a_mistake_in_a_file_has_its_line() -> None:
    """Of what is written below the small scenario."""
    check_refusals("scenario/lines", lambda text: parse_scenario(SMALL + text, "small.yaml"))


@pytest.mark.parametrize("name", ["follow-the-leader"])
def test_a_mistake_in_a_shipped_scenario_too(name: str) -> None:
    check_refusals(f"scenario/{name}", lambda *overrides: load_scenario(name, overrides))


def test_a_mistake_in_a_fault_in_words_is_told_with_its_place() -> None:
    check_refusals("scenario/faults in words", read_fault)
