"""Navigation traces: the navigation error of a real vehicle over time, as CSV.

```csv
time [s], north [m], east [m], down [m], heading [deg]
0, 0, 0, 0, 0.5
10, 0.12, -0.3, 0.05, 0.6
```

The error is the vehicle's estimate minus its true position. Time ascends; the column of the heading may be left out.
"""

from __future__ import annotations

from math import radians
from pathlib import Path

from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError
from netem.limits import NAVIGATION_TRACE
from netem.parsing import exact_number
from world.navigation.config import TracePoint

TRACE = "navigation trace"
COLUMNS = ("time [s]", "north [m]", "east [m]", "down [m]", "heading [deg]")
_MOST = 1e7  # s, m, deg: larger ones are slips


def load_trace(text: str, folder: Path | None) -> tuple[TracePoint, ...]:
    """The points of a trace.

    `text`: the name of a file, which is looked for in `folder` and in the current directory; or its content, which has
    more than one line. Raises DataFileError: the file is missing or wrong; with its lines.
    """
    return parse_trace(*_content(text, folder))


def _content(text: str, folder: Path | None) -> tuple[str, str]:
    """Its content, and what it is called."""
    if "\n" in text:
        if len(text) > NAVIGATION_TRACE.bytes:
            raise DataFileError(TRACE, "in the scenario", [f"it has more than {NAVIGATION_TRACE.bytes} characters"])
        return text, "in the scenario"
    data, path = data_files.find_beside(TRACE, text, folder, NAVIGATION_TRACE.bytes)
    try:
        content = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DataFileError(TRACE, path, ["it is not text in UTF-8"]) from None
    # Lines end as in the rest of the scenario; one line alone would be taken for a name.
    return "\n".join(content.splitlines()) + "\n", path


def parse_trace(text: str, name: str) -> tuple[TracePoint, ...]:
    """The points in the text of a trace. Raises DataFileError: with the first ten lines that are wrong."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not lines:
        raise DataFileError(TRACE, name, ["it is empty"])
    titles = tuple(title.strip() for title in lines[0][1].split(","))
    if titles not in (COLUMNS, COLUMNS[:4]):
        expected = f'expected the columns "{", ".join(COLUMNS)}" (the last may be left out)'
        raise DataFileError(TRACE, name, [f'line {lines[0][0]}: {expected}, got "{lines[0][1].strip()[:80]}"'])
    points: list[TracePoint] = []
    problems: list[str] = []
    for number, line in lines[1:]:
        cells = [cell.strip() for cell in line.split(",")]
        values = [exact_number(cell) for cell in cells]
        if len(cells) != len(titles):
            problems.append(f"line {number}: expected {len(titles)} values, got {len(cells)}")
            continue
        wrong = [cell for cell, value in zip(cells, values, strict=True) if value is None or abs(value) > _MOST]
        if wrong:
            problems.append(f'line {number}: expected a number up to {_MOST:g}, got "{wrong[0][:40]}"')
            continue
        t, north, east, down, *heading = (float(value) for value in values if value is not None)
        if points and t <= points[-1].t:
            problems.append(f"line {number}: time must ascend: {t:g} s follows {points[-1].t:g} s")
        points.append(TracePoint(t, north, east, down, *map(radians, heading)))
    if not points and not problems:
        problems.append("it has no point")
    if problems:
        more = [f"and {len(problems) - 10} more lines"] if len(problems) > 10 else []
        raise DataFileError(TRACE, name, problems[:10] + more)
    return tuple(points)
