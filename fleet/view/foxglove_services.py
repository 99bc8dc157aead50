"""The services that a viewer may call in a live run: `fleet inject`, `heal`, `faults` and `clock` as services with
JSON.
"""

from __future__ import annotations

from typing import Any

from fleet.errors import FleetError
from fleet.execution.connection import LiveRun, ask
from fleet.scenario.text.fault_words import read_fault
from fleet.view.foxglove_server import ServiceOffer

_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_DO = {"type": "string", "enum": ["pause", "resume", "step", "speed"]}


def services(run: LiveRun) -> list[ServiceOffer]:
    """The services; each asks the console of the run, and an error of its is the answer."""

    def inject(asked: dict[str, Any]) -> dict[str, Any]:
        _known("inject", asked, ("what", "for", "id"))
        what = asked.get("what")
        if not isinstance(what, str) or not what.strip():
            raise FleetError("what? The words of fleet inject, such as \"down '1<->2' for 5s\"")
        fault = read_fault(what)
        for key in ("for", "id"):
            if asked.get(key) not in (None, ""):
                fault[key] = asked[key]
        return ask(run, "inject", fault=fault)

    def heal(asked: dict[str, Any]) -> dict[str, Any]:
        _known("heal", asked, ("id",))
        return ask(run, "heal", id=asked.get("id") or None)

    def faults(asked: dict[str, Any]) -> dict[str, Any]:
        _known("faults", asked, ())
        return ask(run, "faults")

    def clock(asked: dict[str, Any]) -> dict[str, Any]:
        _known("clock", asked, ("do", "value"))
        do, value = asked.get("do"), asked.get("value")
        return ask(run, "clock", do=do, value=1 if do == "step" and value is None else value)

    return [
        ServiceOffer("/fleet/inject", _object(what=_TEXT, **{"for": _TEXT}, id=_TEXT),
                     _object(id=_TEXT, what=_TEXT, from_s=_NUMBER, to_s=_NUMBER), inject),
        ServiceOffer("/fleet/heal", _object(id=_TEXT), _object(healed=_list(_TEXT), at_s=_NUMBER), heal),
        ServiceOffer("/fleet/faults", _object(),
                     _object(faults=_list(_object(id=_TEXT, what=_TEXT, state=_TEXT))), faults),
        ServiceOffer("/fleet/clock", _object(do=_DO, value=_NUMBER),
                     _object(clock=_TEXT, at_s=_NUMBER), clock),
    ]  # fmt: skip


def _known(service: str, asked: dict[str, Any], keys: tuple[str, ...]) -> None:
    for key in asked:
        if key not in keys:
            raise FleetError(f"{service} takes {', '.join(keys) or 'nothing'}, not {key:.40}")


def _object(**properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}
