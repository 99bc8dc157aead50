"""All that an add-on may import of `fleet` besides what every program of Python may: `fleet` itself, and `fleet.addon`.

A module is imported when one of its names is asked for, so that a verb that needs a `Log` does not wait for pydantic.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fleet.addon import load

if TYPE_CHECKING:
    from fleet.cli.companion import Companion as Companion
    from fleet.cli.companion import RunCompanion as RunCompanion
    from fleet.cli.declare import command as command
    from fleet.cli.documents.output import print_result as print_result
    from fleet.cli.exporter import Exporter as Exporter
    from fleet.cli.exporter import Selection as Selection
    from fleet.cli.listing import Listing as Listing
    from fleet.cli.log_argument import Log as Log
    from fleet.cli.types import TIME as TIME
    from fleet.errors import FleetError as FleetError
    from fleet.execution.options import Options as Options
    from fleet.execution.wiring import Wiring as Wiring
    from fleet.mcap.other import OtherData as OtherData
    from fleet.option import Option as Option
    from fleet.scenario.faults.kind import FaultKind as FaultKind
    from fleet.scenario.faults.kind import FleetFaultKind as FleetFaultKind
    from fleet.scenario.faults.kind import LinkFaultKind as LinkFaultKind
    from fleet.scenario.faults.kind import VehicleFaultKind as VehicleFaultKind
    from fleet.scenario.scenario import Scenario as Scenario
    from fleet.terminal.width import say as say

_PLACES = {
    "Companion": "fleet.cli.companion",
    "Exporter": "fleet.cli.exporter",
    "FaultKind": "fleet.scenario.faults.kind",
    "FleetError": "fleet.errors",
    "FleetFaultKind": "fleet.scenario.faults.kind",
    "LinkFaultKind": "fleet.scenario.faults.kind",
    "Listing": "fleet.cli.listing",
    "Log": "fleet.cli.log_argument",
    "Option": "fleet.option",
    "Options": "fleet.execution.options",
    "OtherData": "fleet.mcap.other",
    "RunCompanion": "fleet.cli.companion",
    "Scenario": "fleet.scenario.scenario",
    "Selection": "fleet.cli.exporter",
    "TIME": "fleet.cli.types",
    "VehicleFaultKind": "fleet.scenario.faults.kind",
    "Wiring": "fleet.execution.wiring",
    "command": "fleet.cli.declare",
    "print_result": "fleet.cli.documents.output",
    "say": "fleet.terminal.width",
}
__all__ = sorted(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    return load(f"{_PLACES[name]}:{name}")
