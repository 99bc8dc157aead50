"""The signals of nodes: the numbers that programs which are not ours tell in lines and messages."""

from __future__ import annotations

from functools import cache

from agents.signals import SignalLayout
from fleet.scenario.schema.programs import StackSignalSection, nodes_of
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.signals import VehicleSignals
from world.signal import Signal

PERIOD_NS = 10_000_000  # between two samples of them in the log


def signals_of_node(spec: ScenarioSpec, i: int) -> dict[str, StackSignalSection]:
    """The signals of node i by name, in the order of the file."""
    nodes = list(spec.nodes or ())
    return {name: each for name, each in (spec.signals or {}).items() if nodes[i - 1] in nodes_of(each.of, nodes)}


def node_layout(spec: ScenarioSpec, i: int) -> SignalLayout:
    """What node i reports, in the place of what the agent of a vehicle reports."""
    return SignalLayout((), tuple(_signal(name, each) for name, each in signals_of_node(spec, i).items()))


def node_signals(spec: ScenarioSpec, i: int) -> VehicleSignals:
    """All that a log has of node i: nobody measures where it is."""
    return VehicleSignals(node_layout(spec, i), measured=False)


@cache
def _signal(name: str, section: StackSignalSection) -> Signal:
    how = "number of such lines or messages" if section.count else "as programs told it last"
    return Signal(name, section.unit, how)
