"""The parts of a scenario that may draw from the seed."""

from __future__ import annotations

from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.clocks import clock_sections
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace
from world.navigation.config import DeadReckoning


def may_draw(scenario: Scenario) -> list[str]:
    """The parts of a scenario that may draw from the seed. If there are none, every seed gives the same run."""
    spec, changing = scenario.spec, scenario.changing.values()
    conditions = [one for some in scenario.possible.values() for one in some]
    parts = {
        "initial scatter": spec.initial.scatter is not None and spec.initial.scatter.scatter > 0.0,
        "random graph": spec.graph.shape == "random",
        "sensor noise": not scenario.noise.off,
        "navigation": any(isinstance(control.navigation, DeadReckoning) for control in scenario.controls),
        "clocks": any(clock.drift or clock.offset for clock in clock_sections(spec)),
        "current": any(spec.sea.current.sigma),
        "link states": any(isinstance(its, LinkStates) for its in changing),
        "traces": any(isinstance(its, LinkTrace) and its.offset for its in changing),
        "link conditions": any(
            c.jitter_ns or c.loss or c.loss_model or c.duplicate or c.corrupt or c.reorder for c in conditions
        ),
        "acoustic channel": scenario.acoustic is not None,
        "faults": bool(spec.faults or spec.triggers or spec.nemesis),
        "laws of yours": bool(scenario.other_laws),
        "plants": bool(scenario.plants),
    }
    return [part for part, draws in parts.items() if draws]
