"""An agent that says lines for the log."""

from __future__ import annotations

from collections.abc import Callable

from small_scenario import SMALL

from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario

TALKER = '''\
from agents.api import Said

class Talker:
    """Vehicle i says something at tick i and each 7 ticks later, a flood at tick 3, and how it ends."""

    signals = ()

    def __init__(self, config, fails_at=-1, ends_at=-1, floods=0):
        self.config, self.fails_at, self.ends_at, self.floods = config, fails_at, ends_at, floods
        self.said = []

    def transmit(self, nav):
        return ()

    def decide(self, nav, deliveries):
        i, tick = self.config.id, nav.tick
        def say(stream, text):
            self.said.append(Said(tick * self.config.tick_ns + i, stream, text))
        if tick % 7 == i:
            say("out", f"tick {tick}")
            say("err", "caf\\udce9 \\x1b[31m")
        if tick == 3:
            for k in range(self.floods):
                say("out", f"flood {k}")
        if tick == self.fails_at and i == 2:
            say("err", "ValueError: planned")
            say("failed", "exit status 1")
        if tick == self.ends_at:
            say("end", "exit status 0")
        return (0.0, 0.0, 0.0), {}

    def take_said(self):
        said, self.said = self.said, []
        return said
'''


MOORED = """\
title: Three moored vehicles
vehicles: 3
moored: true
tick: 10 ms
duration: 1 s
graph: {shape: path}
network: {period: 50 ms}
"""


def talking(module: Callable[[str], str], *changes: str, text: str = SMALL, **parameters: int) -> Scenario:
    """Three vehicles that talk for a second, in ticks of 10 ms. `module`: the fixture that writes modules."""
    given = ", ".join(f"{name}: {value}" for name, value in parameters.items())
    agent = f'agent: {{law: "{module(TALKER)}:Talker", parameters: {{{given}}}}}'
    return parse_scenario(f"{text}{agent}\nchecks: {{tumbled: waived}}\n", "talk.yaml", changes)
