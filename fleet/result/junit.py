"""Results as a JUnit file, which CI services show: one test case per run, check or point.

The form is that of Jenkins' schema (junit-10.xsd). All services read at least the parts that are written here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from fleet.errors import FleetError
from netem.private_file import write_whole

_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class JUnitCase:
    """One test case: `failure` names the failed checks, `error` the reason for a missing verdict, each empty without
    one; `said` is help to repeat the case, such as a command to paste; `wall_s` its wall time [s].
    """

    name: str
    failure: str = ""
    error: str = ""
    said: str = ""
    wall_s: float = 0.0


def junit_text(suite: str, cases: Sequence[JUnitCase]) -> bytes:
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


def write_junit(path: Path, suite: str, cases: Sequence[JUnitCase]) -> None:
    """Write a JUnit file; it is there as a whole or not at all. Raises FleetError."""
    try:
        write_whole(path, junit_text(suite, cases), 0o644)
    except OSError as error:
        raise FleetError(f"{path} cannot be written: {error.strerror}") from None


def _clean(text: str) -> str:
    return _NOT_XML.sub("?", text)
