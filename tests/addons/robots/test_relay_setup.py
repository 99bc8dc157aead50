"""What the relay of a stack file is told of its nodes."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.addons.robots import relay_run
from fleet.scenario.loading import load_scenario


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
