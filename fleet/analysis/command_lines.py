"""Programs and scripts that command lines name, and that this machine does not have. A run would break for them, and
the user learns it before.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.programs import ProgramSection, programs_of
from netem.parsing import nearest

_INTERPRETERS = re.compile(r"((ba|da|z|k)?sh|node|perl|python|ruby)[\d.]*")


def search_path() -> str:
    """Where programs are looked for: first where this Python is, so that `python` is the one that runs `fleet`."""
    return f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', os.defpath)}"


def warnings(scenario: Scenario) -> Iterator[str]:
    """The programs and scripts that are not there. A run says so, too, but only when it has begun."""
    found: dict[str, list[str]] = {}
    for name, _, section in programs_of(scenario.spec.programs or {}, scenario.nodes):
        if said := _missing(section):
            found.setdefault(said, []).append(name)
    for said, names in found.items():
        yield f"{', '.join(names)}: {said}"


def _missing(section: ProgramSection) -> str:
    """The program or script of a command line that is not there, in words. Empty: both are there, or a placeholder
    stands for one.
    """
    folder, program = Path(section.folder or "."), section.run[0]
    if "{" in program:
        return ""
    if "/" in program and not (folder / program).exists():
        return _not_in(folder, program)
    if "/" not in program and shutil.which(program, path=section.env.get("PATH", search_path())) is None:
        return f"there is no program {program} on the path"
    script = section.run[1] if len(section.run) > 1 else "-"
    if not _INTERPRETERS.fullmatch(Path(program).name) or script.startswith("-") or "{" in script:
        return ""
    return "" if (folder / script).exists() else _not_in(folder, script)


def _not_in(folder: Path, name: str) -> str:
    hint = nearest(name, (path.name for path in folder.iterdir()) if folder.is_dir() else ())
    return f"there is no file {name} in {folder}{f'; {hint}' if hint else ''}"
