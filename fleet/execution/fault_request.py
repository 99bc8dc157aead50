"""A fault that is to begin in a run that goes on: a request, checked by the rules of scenarios."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from fleet.errors import FleetError
from fleet.scenario.rules.faults import fault_problems
from fleet.scenario.rules.nodes import why_impossible
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.sections.node_names import values_to_numbers
from fleet.scenario.sections.triggers import read_entry
from fleet.scenario.value_types import mistake_words

BROKEN = 3  # the status of a refusal for which the asker can do nothing


class RefusedError(FleetError):
    """A request that cannot be carried out. `status` is 2 when something else should have been asked for, 3 when the
    run cannot do it now.
    """

    def __init__(self, text: str, status: int = 2) -> None:
        super().__init__(text)
        self.status = status


def check_fault(entry: Any, tick: int, scenario: Scenario) -> FaultSection:
    """The fault that an entry of a scenario's `faults` without `at` describes, beginning at a tick. Raises RefusedError
    if it is none, or none for this scenario; the text says what is wrong.
    """
    if not isinstance(entry, dict) or "at" in entry:
        raise RefusedError("expected a fault without `at`, because it begins now")
    try:
        entry = values_to_numbers(entry, scenario.nodes)
    except KeyError as error:
        nodes = ", ".join(scenario.nodes)
        raise RefusedError(f"there is no node {error.args[0]}; the nodes are {nodes}") from None
    try:
        section = read_entry(entry | {"at": f"{tick * scenario.tick_ns} ns"})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        context = first.get("ctx", {})
        said = mistake_words(context, scenario.nodes) if "message" in context else first["msg"]
        hint = context.get("hint", "")
        where = ".".join(str(step) for step in first["loc"] if step != "[key]")
        raise RefusedError(f"{where}: {said[:1].lower()}{said[1:]}{f'; {hint}' if hint else ''}") from None
    if scenario.nodes and (wrong := why_impossible(scenario.spec, section)) is not None:
        raise RefusedError("; ".join(wrong))
    problem = next(fault_problems(section, scenario.spec, scenario.graph.links), None)
    if problem is not None:
        raise RefusedError(str(problem))
    conditions = section.values.values() if section.kind.name == "link" else ()
    if any(condition.seed is not None for condition in conditions):
        raise RefusedError("a seed belongs in a scenario, because a link keeps its draws during a run")
    return section
