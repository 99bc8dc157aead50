"""The document of each command with `--json`."""

from __future__ import annotations

from msgspec import Struct

from fleet.cli.documents.logs import Compared, LogContents, Verified
from fleet.cli.documents.result import Ran
from fleet.cli.documents.scenarios import Checked, Scenarios
from fleet.cli.documents.what_if import OtherCommands

DOCUMENTS: dict[str, type[Struct]] = {
    "check": Checked,
    "diff": Compared,
    "info": LogContents,
    "list": Scenarios,
    "run": Ran,
    "verify": Verified,
    "whatif": OtherCommands,
}
