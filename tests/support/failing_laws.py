"""Laws of the user's, written to a module beside the scenario."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest
from small_scenario import SMALL

from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Writes a module beside the scenario-to-be and returns its name, another one each time."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(code: str) -> str:
        name = f"law_{random.getrandbits(40)}"
        (tmp_path / f"{name}.py").write_text(dedent(code), "utf-8")
        return name

    return write


def failing(at: int, line: str, vehicle: int = 2) -> str:
    """A law whose step does something wrong at one tick of one vehicle; the faulty line is line 10."""
    return f"""\
import asyncio, itertools, json, time, numpy as np
from agents.api import Signal

class Law:
    signals = (Signal("a", "1", ""),)
    def __init__(self, config):
        self.config = config
    def step(self, sample):
        if sample.tick == {at} and self.config.id == {vehicle}:
            {line}
        return (1.0, 0.0, 0.0), {{"a": 0.0}}
"""


def with_law(folder: Path, name: str, code: str) -> Scenario:
    """The small scenario with a law from a module beside it, which is trusted."""
    (folder / f"{name}.py").write_text(code, "utf-8")
    text = f"{SMALL}controller: {name}:Law\n"
    return parse_scenario(text, "small.yaml", folder=folder, policy=Policy(stranger=""))


# Code that makes a law of ours compute NaN once, in vehicle 3, whether the laws are compiled or not.
NAN_IN_THE_CORE = """
    from math import nan
    from agents.controllers import TRACKING
    Ours = TRACKING["neurodynamic"]

    class Failing:
        signals, uses = Ours.signals, Ours.uses

        def __init__(self, config):
            self._id, self._law = config.id, Ours(config)

        def __getattr__(self, name):
            return getattr(self._law, name)

        def __setattr__(self, name, value):  # `fleet.analysis.linear` sets the state of our law
            setattr(self._law, name, value) if name == "x" else super().__setattr__(name, value)

        def step(self, sample, command):
            demand, telemetry = self._law.step(sample, command)
            if (self._id, sample.tick) == (3, 57):
                return (nan, nan, nan), (*telemetry[:-3], nan, nan, nan)
            return demand, telemetry

    TRACKING["neurodynamic"] = Failing
"""
