"""The begin and the end of each fault in a log, and of each event of a vehicle."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, NamedTuple

from msgspec import Meta, Struct

from fleet.logs.topic import Topic
from fleet.mcap.reader import LogReadError
from fleet.scenario.sections.timeline import FaultInterval
from fleet.scenario.text.fault_words import entry_of_words
from netem.limits import LOG_FAULTS


class FaultMessage(NamedTuple):
    """One message of the topic `faults`."""

    fault: str  # id
    action: str  # begins | ends
    what: str  # in words
    entry: str  # the same as data

    @classmethod
    def read(cls, fault: str, action: str, what: str, names: Sequence[str]) -> FaultMessage:
        """A log has a fault in the words of a scenario, which are read here and nowhere else."""
        return cls(fault, action, what, entry_of_words(what, tuple(names)))


def fault_message(message: Any, names: Sequence[str] = ()) -> FaultMessage | None:
    """A message of the topic `faults`, as it was decoded. None: it is not one of ours. `names`: of the nodes."""
    found = [getattr(message, field, None) for field in ("fault", "action", "what")]
    if not all(isinstance(text, str) for text in found):
        return None
    fault, action, what = map(str, found)
    return FaultMessage.read(fault, action, what, names)


class FaultTime(Struct, frozen=True):
    """The same fault as `--json` prints it."""

    id: str
    from_s: float
    to_s: Annotated[float, Meta(description="When it ends, at the latest with the run or the log.")]
    what: Annotated[str, Meta(description="What it does, as a scenario writes it.")]

    @classmethod
    def of(cls, fault: FaultInterval) -> FaultTime:
        return cls(fault.id, fault.begin, fault.end, fault.what)


def fault_intervals(topic: Topic, end: float, names: Sequence[str] = ()) -> list[FaultInterval]:
    """Faults and events of vehicles, in the order of their beginnings, from a message for each begin and each end. One
    without an end lasts to `end` of the log [s]. `names`: of the nodes. Raises LogReadError for more than
    LOG_FAULTS.items messages.
    """
    if len(topic) > LOG_FAULTS.items:
        raise LogReadError(
            f"the log holds {len(topic)} events of faults, more than the {LOG_FAULTS.items} that are read"
        )
    if not len(topic):
        return []
    columns = zip(topic["fault"], topic["action"], topic["what"], strict=True)
    messages = [FaultMessage.read(*row, names) for row in columns]
    return intervals(zip(topic.t, messages, strict=True), end)


def intervals(happened: Iterable[tuple[float, FaultMessage]], end: float) -> list[FaultInterval]:
    """As `fault_intervals`, from time [s] and message."""
    found: dict[str, FaultInterval] = {}
    for at, message in happened:
        name = message.fault
        if message.action == "begins":
            found[name] = FaultInterval(name, float(at), end, message.what, message.entry)
        elif name in found:
            found[name] = found[name]._replace(end=float(at))
    return list(found.values())
