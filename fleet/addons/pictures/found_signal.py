"""A signal as a log has it: which field of which topic it is, in which unit, and what it means."""

from __future__ import annotations

import re
from typing import NamedTuple

from fleet.addons.pictures.runs import LoggedRun
from fleet.logs.topic import Topic
from fleet.scenario.sections.signals import BELIEF, ERROR, GROUPS, LOCATED, SignalName

# `|error.e|` and `error.e_norm` are one signal under two names.
_NORMS = {
    f"{group}.{signal.name}"
    for group, signals in (("error", ERROR), ("belief", BELIEF), ("located", LOCATED))
    for signal in signals
    if signal.name.endswith("_norm")
}


class FoundSignal(NamedTuple):
    """A signal in a log."""

    name: str  # as the log has it, or a component of that
    field: str
    component: int | None  # None: the whole
    unit: str
    meaning: str
    width: int

    def unit_of(self, k: int | None) -> str:
        """The unit of a component; None: of the whole."""
        units = self.unit.split(", ")
        return units[k] if k is not None and len(units) == self.width else self.unit


def find_signal(run: LoggedRun, name: SignalName) -> FoundSignal | None:
    """The signal in the topic of the first vehicle that has it; of a component, the vector that it is one of."""
    group, _, field = name.name.partition(".")
    if group not in GROUPS:
        return None
    for i in run.log.vehicles:
        topic = topic_of(run, i, group)
        if topic is None or topic.too_many:
            continue
        part = re.fullmatch(r"(\w+)_(\d{1,4})", field)
        if field in topic:
            own, k = field, None
        elif part is not None and part[1] in topic and int(part[2]) < _width(topic, part[1]):
            own, k = part[1], int(part[2])
        else:
            continue
        unit, meaning = topic.declaration(own)
        return FoundSignal(f"{group}.{own}", own, k, unit or "1", meaning, _width(topic, own))
    return None


def topic_of(run: LoggedRun, i: int, group: str) -> Topic | None:
    """The topic of a group of vehicle i; None: it has no message."""
    topic = f"uuv/{i}/{group}"
    return run.log[topic] if topic in run.log and len(run.log[topic]) else None


def plain_name(name: SignalName) -> SignalName:
    """The one name of a signal that has two: `error.e_norm` for `|error.e|`."""
    if not name.absolute:
        return name
    own = next((norm for norm in (name.name, f"{name.name}_norm") if norm in _NORMS), None)
    return name if own is None else name._replace(name=own, absolute=False)


def _width(topic: Topic, field: str) -> int:
    values = topic[field]
    return 1 if values.ndim == 1 else values.shape[1]
