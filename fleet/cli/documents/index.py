"""The document of each command with `--json`."""

from __future__ import annotations

from msgspec import Struct

from fleet.cli.documents import live
from fleet.cli.documents.boundary import BoundaryFound
from fleet.cli.documents.check import Checked
from fleet.cli.documents.listing import Runs, Scenarios
from fleet.cli.documents.logs import Compared, LogContents, LogJudged, Verified
from fleet.cli.documents.search import FirstFailing, RegressedFolder
from fleet.cli.documents.study import Less, Swept
from fleet.cli.documents.what_if import OtherCommands
from fleet.explanation.why import Why
from fleet.result.result import Result
from fleet.study.rare import RareFound

DOCUMENTS: dict[str, type[Struct]] = {
    "boundary": BoundaryFound,
    "check": Checked,
    "check-log": LogJudged,
    "clock": live.ClockSet,
    "diff": Compared,
    "heal": live.Healed,
    "info": LogContents,
    "inject": live.Injected,
    "list": Scenarios,
    "ls": Runs,
    "ps": live.LiveRuns,
    "rare": RareFound,
    "regress": RegressedFolder,
    "run": Result,
    "search": FirstFailing,
    "shrink": Less,
    "status": live.RunStatus,
    "stop": live.Stopping,
    "sweep": Swept,
    "verify": Verified,
    "whatif": OtherCommands,
    "why": Why,
}
