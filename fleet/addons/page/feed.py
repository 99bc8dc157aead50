"""The common part of a live run and a log: how their messages become part of a picture, and their checks."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.message import DecodeError

from fleet.addons.page.chart_signals import Signals
from fleet.addons.page.view_state import Row, ViewState
from fleet.logs import fault_intervals as logged
from fleet.logs.decoder import decode_message
from fleet.logs.fault_intervals import FaultMessage
from fleet.logs.schemas import BELIEF, FAULT, LOCATED, PACKET, flat_schema
from fleet.logs.topic_names import believer_of, link_of
from fleet.result.file import ResultError, read_result
from fleet.result.result import Status
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import OF_LOCALIZATION, OF_NAVIGATION
from netem.cause import Cause

TRANSFORMS, FAULTS = "transforms", "faults"
MOST_CHARTED = 4  # signals of checks that have a chart from the start
_PACKET = flat_schema("Packet", PACKET).message
_FAULT = flat_schema("Fault", FAULT).message
_BELIEFS = {
    OF_NAVIGATION: flat_schema("Belief", BELIEF).message,
    OF_LOCALIZATION: flat_schema("Located", LOCATED).message,
}


def take(
    picture: ViewState, topic: str, at_s: float, data: bytes, signals: Signals | None = None, *, moving: bool = True
) -> None:
    """Bring one message into a picture, with the values of the signals that are followed. A message that is damaged, or
    too large to be one of ours, is left out."""
    for name, value in () if signals is None else signals.values(topic, data):
        picture.signal(name, at_s, value)
    with suppress(DecodeError):
        if topic == TRANSFORMS:
            picture.transforms(at_s, decode_message(FrameTransforms, data))
        elif topic == FAULTS:
            if (message := fault_message(data, picture.scenario.nodes)) is not None:
                picture.event(at_s, message)
        elif (believer := believer_of(topic)) is not None:
            picture.believes(*believer, at_s, decode_message(_BELIEFS[believer[1]], data))
        elif (link := link_of(topic)) is not None:
            picture.packet(link, decode_message(_PACKET, data), moving=moving)


def fault_message(data: bytes, names: Sequence[str] = ()) -> FaultMessage | None:
    """A message of the topic `faults`; None: it is damaged. `names`: of the nodes."""
    try:
        return logged.fault_message(decode_message(_FAULT, data), names)
    except DecodeError:
        return None


def is_lost(data: bytes) -> bool:
    """Whether a message of a topic `link/<src>-<dst>` tells of a packet that did not arrive whole."""
    with suppress(DecodeError):
        packet = decode_message(_PACKET, data)
        return bool(packet.corrupted or packet.fate not in (Cause.DELIVERED, Cause.IN_FLIGHT))
    return False


def checks_so_far(rows: list[Row]) -> Row:
    """Checks as a page gets them, of a run that goes on: `passed` may change; None: not judged yet."""
    return {"rows": rows, "final": False}


def checks_asked(scenario: Scenario) -> Row:
    checks = yaml.safe_load(scenario.to_yaml()).get("checks") or {}
    rows = [{"check": name, "asked": _words(value), "passed": None, "found": ""} for name, value in checks.items()]
    return checks_so_far(rows)


def checks_judged(log: Path) -> Row | None:
    """The verdicts beside a log, of the whole run; None: there is no result.

    A failed check has the time of the failure, `at_s`, if that is known. `signals` are those that it looked at.
    """
    try:
        result = read_result(log.parent)
    except (FileNotFoundError, ResultError):
        return None
    rows = [
        {
            "check": one.check,
            "asked": one.asked,
            "passed": one.outcome,
            "found": one.found,
            "at_s": None if one.passed or one.moment is None else one.moment.at_s,
            "signals": list(one.signals),
        }
        for one in result.checks
    ]
    unjudged = result.status == Status.CHECK_FAILED and not any(one.failed for one in result.checks)
    passed = None if unjudged else result.passed
    return {"rows": rows, "final": True, "verdict": {"passed": passed, "text": result.words}}


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {inner}" for key, inner in value.items())
    return "; ".join(map(_words, value)) if isinstance(value, list) else str(value)
