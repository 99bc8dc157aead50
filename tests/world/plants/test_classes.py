"""What the name of a plant stands for, and which classes are none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from failing_laws import module as module
from refusals import check_refusals

from world.plants.classes import SHIPPED, model_of, module_of, plant_class, signals_of

CLASS = """\
class Mine:
    limits = (1.0, 1.0, 1.0)
    {more}
    def __init__(self, config, *, mass=1.0): pass
    def start(self, pose, velocity): return (*pose, *velocity)
    def step(self, state, tau, water, dt): return state
    def pose(self, state): return state[:6]
    def velocity(self, state): return state[6:]
"""


def test_a_class_by_its_import_path(module: Callable[[str], str]) -> None:
    name = module(CLASS.format(more="model = 'paper'")) + ":Mine"
    assert plant_class(name, {"mass": 2.0}).__name__ == "Mine"
    assert (model_of(name, {}), signals_of(name, {})) == ("paper", ())
    assert module_of(name) == name.partition(":")[0]


def test_those_that_ship_need_no_module_of_the_user() -> None:
    for name in SHIPPED:
        assert module_of(name) is None
        assert plant_class(name, {}).__module__.startswith("world.plants.")


def test_a_class_that_is_no_plant(module: Callable[[str], str], tmp_path: Path) -> None:
    cases = [
        ("", {"length": 2.0}),
        ("signals = ('rpm',)", {}),
        ("from world.api import Signal; signals = (Signal('rpm', '1/s', 'turns'),)", {}),
        ("from world.api import Signal; signals = (Signal('phi', 'rad', 'roll'),)", {}),
        ("model = 3", {}),
    ]

    def load(more: str, parameters: dict[str, float]) -> None:
        name = module(CLASS.format(more=more))
        hide[name] = "mine"
        plant_class(f"{name}:Mine", parameters)

    hide = {str(tmp_path): "HERE"}

    check_refusals("plants/classes", load, cases, hide=hide)


def test_a_plant_that_cannot_be_used_brings_no_model() -> None:
    assert model_of("no_such_module_at_all:Plant", {}) is None
    assert model_of("own_plants:Rolling", {}) is None
