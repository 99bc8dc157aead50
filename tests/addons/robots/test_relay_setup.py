"""What the relay of a stack file is told of its nodes."""

from __future__ import annotations

import json
import pickle
from math import radians
from pathlib import Path

import pytest

from fleet.addons.robots import relay_run
from fleet.scenario.loading import load_scenario, parse_scenario


@pytest.mark.parametrize(("carry", "silent"), [("", [True, False]), ("carry: ['**']\n", [False, False])])
def test_a_node_with_a_modem_carries_what_carry_names(carry: str, silent: list[bool], tmp_path: Path) -> None:
    text = (
        "title: one modem\n" + carry + "nodes:\n  a: {modem: {unet: 0}, place: 0 0 10 m, listen: 'tcp/127.0.0.1:0'}\n"
        "  b: {listen: 'tcp/127.0.0.1:7599', place: 9 0 10 m}\nnetwork: {acoustic: {modem: s2c, queue: 10}}\n"
    )
    (tmp_path / "one.yaml").write_text(text)
    scenario = load_scenario(str(tmp_path / "one.yaml"))
    setup = relay_run.setup_of(scenario, None)
    assert [robot.silent for robot in setup.robots] == silent


def test_an_evologics_modem_gets_its_mode_and_its_error() -> None:
    """What the file says reaches the language, which the process of the relay makes."""
    nodes = {"a": {"modem": {"evologics": 0, "mode": "command", "usbl": "2 deg"}, "place": "0 0 9 m"},
             "b": {"modem": {"evologics": 0}, "place": "9 0 9 m"}}  # fmt: skip
    text = json.dumps({"title": "Modems", "nodes": nodes, "network": {"acoustic": {"queue": 4}}})
    found = []
    for modem in relay_run.modems_of(parse_scenario(text, "modems.yaml")):
        language = pickle.loads(pickle.dumps(modem))._make()  # as it comes to the other process
        found.append((language._mode, language._usbl))
    assert found == [("command", pytest.approx(radians(2.0))), ("data", None)]
