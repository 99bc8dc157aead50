"""The option `--junit` of the commands that judge: a JUnit file, which CI services show, and what each writes into it.

The form is that of Jenkins' schema (junit-10.xsd). All services read at least the parts that are written here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fleet.cli.types import FILE
from fleet.errors import FleetError
from fleet.option import Option

if TYPE_CHECKING:
    from fleet.result.result import Result


Junit = Annotated[Path | None, FILE, Option("Also write the result as a JUnit file, for CI services.")]


# Compiling it takes 6 ms, which `fleet run --help` need not wait for.
_NOT_XML = r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"


@dataclass(frozen=True, slots=True)
class JUnitCase:
    """One test case. `failure` names the failed checks, and `error` the reason for a missing verdict. `said` helps to
    repeat the case, for instance with a command to paste. `wall_s` is its wall time [s].
    """

    name: str
    failure: str = ""
    error: str = ""
    said: str = ""
    wall_s: float = 0.0


def run_cases(result: Result, command: str) -> list[JUnitCase]:
    """A case for each check, and one for a run that did not come to its end. They share the wall time of the run.

    Args:
        result: of the run.
        command: the command line that made it.
    """
    meant = result.passed  # a run that is meant to fail
    again = f"{command}  # seed {result.seed}, sha256 {result.digest[:16]}"
    count = len(result.checks) + bool(result.reason)
    wall_s = (result.wall.startup_s + result.wall.run_s) / max(1, count)
    cases = [
        JUnitCase(one.check, "" if one.passed or meant else f"{one.asked}; found {one.found}", "", again, wall_s)
        for one in result.checks
    ]
    if result.reason:
        cases.append(JUnitCase("run", error=result.reason, said=again, wall_s=wall_s))
    return cases


def junit_text(suite: str, cases: Sequence[JUnitCase]) -> bytes:
    from xml.etree.ElementTree import Element, SubElement, indent, tostring

    counts = {"tests": len(cases), "failures": sum(bool(case.failure) for case in cases),
              "errors": sum(bool(case.error) for case in cases), "skipped": 0}  # fmt: skip
    numbers = {key: str(count) for key, count in counts.items()}
    wall = f"{sum(case.wall_s for case in cases):.3f}"
    root = Element("testsuites", numbers | {"time": wall})
    shown = SubElement(root, "testsuite", {"name": _clean(suite)} | numbers | {"time": wall})
    for case in cases:
        about = {"name": _clean(case.name), "classname": f"fleet.{_clean(suite)}", "time": f"{case.wall_s:.3f}"}
        element = SubElement(shown, "testcase", about)
        for tag, text in (("failure", case.failure), ("error", case.error)):
            if text:
                SubElement(element, tag, {"message": _clean(text)}).text = _clean(case.said or text)
        if case.said:
            SubElement(element, "system-out").text = _clean(case.said)
    indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode").encode() + b"\n"


def write(path: Path | None, suite: str, cases: Sequence[JUnitCase]) -> None:
    """Write the file, as a whole or not at all, if one was asked for. Raises FleetError: it cannot be written."""
    if path is None:
        return
    from netem.whole_file import write_whole

    try:
        write_whole(path, junit_text(suite, cases), 0o666)
    except OSError as error:
        raise FleetError(f"{path} cannot be written: {error.strerror}") from None


def _clean(text: str) -> str:
    return re.sub(_NOT_XML, "?", text)
