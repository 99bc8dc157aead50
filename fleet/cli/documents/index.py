"""The document of each command with `--json`."""

from __future__ import annotations

from msgspec import Struct

from fleet.cli.documents import live, runs
from fleet.cli.documents.check import Checked
from fleet.cli.documents.listing import Scenarios
from fleet.cli.documents.logs import Compared, LogContents, Verified
from fleet.cli.documents.result import Ran
from fleet.cli.documents.what_if import OtherCommands

DOCUMENTS: dict[str, type[Struct]] = {
    "check": Checked,
    "clock": live.ClockSet,
    "diff": Compared,
    "faults": live.Faults,
    "heal": live.Healed,
    "info": LogContents,
    "inject": live.Injected,
    "list": Scenarios,
    "ls": runs.Runs,
    "ps": live.LiveRuns,
    "run": Ran,
    "status": live.Status,
    "stop": live.Stopping,
    "verify": Verified,
    "whatif": OtherCommands,
}
