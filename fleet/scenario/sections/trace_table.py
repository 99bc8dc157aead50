"""Traces of links: what a modem's log says of each packet, or of each time, as CSV.

```csv
time [s],delivered,delay [ms],rate [bit/s],snr [dB]
0.0,1,412.5,80,14.2
4.0,0,,,
```

A row without a delivery may leave its other cells empty. Anywhere else an empty cell is a hole, which is refused, as is
a time before that of the row above. Numbers are read exactly: times and delays in whole ns.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from decimal import Decimal
from io import StringIO
from pathlib import Path

from fleet import quantities as q
from fleet.scenario.sections.data_files import DataFileError, read_beside
from netem.condition import Condition
from netem.files import read_file
from netem.limits import TRACE
from netem.parsing import LONGEST_NUMBER, NUMBER, nearest, quoted

_MOST_PROBLEMS = 5
_MOST_COLUMNS = 20  # every column costs a look at each row
_HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")
_UNITS = {"time": q.TIME, "delivered": q.NUMBER, "delay": q.TIME, "rate": q.BIT_RATE, "snr": q.LEVEL}
_PRINTED = {"time": "s", "delivered": "", "delay": "ms", "rate": "bit/s", "snr": "dB"}
_NS = 10**9
# Limits of what a column may hold, in SI units; delays and rates as in the grammar of conditions.
_BOUNDS = {"time": (Decimal(-(2**62)) / _NS, Decimal(2**62) / _NS), "delay": (Decimal(0), Decimal(86_400)),
           "rate": (Decimal(1), Decimal(10**12)), "snr": (Decimal(-1000), Decimal(1000))}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TraceRow:
    """A row of a trace: the measurements of one packet, or the values that hold from a time on. None: not measured."""

    time_ns: int | None
    delivered: bool
    delay_ns: int | None = None
    rate_bit_s: int | None = None
    snr_db: float | None = None

    def condition(self, lost_below_db: float | None) -> Condition:
        """The condition of a link with these values.

        `lost_below_db`: at or below this signal-to-noise ratio [dB] a packet is lost, too. None: only `delivered`
        decides.
        """
        lost = not self.delivered
        if lost_below_db is not None and self.snr_db is not None:
            lost = lost or self.snr_db <= lost_below_db
        return Condition(self.delay_ns or 0, loss=float(lost), rate_bit_s=self.rate_bit_s or 0)


@dataclass(frozen=True, slots=True)
class TraceTable:
    """The rows of a trace, and the columns that its file has."""

    columns: tuple[str, ...]
    rows: tuple[TraceRow, ...]

    def text(self) -> str:
        """The trace as CSV: `read_csv` of it gives an equal table."""
        headings = [name + (f" [{_PRINTED[name]}]" if _PRINTED[name] else "") for name in self.columns]
        lines = [",".join(headings), *(",".join(_cell(row, name) for name in self.columns) for row in self.rows)]
        return "\n".join(lines) + "\n"


def read_csv(text: str, name: str) -> TraceTable:
    """The trace in a text.

    `name`: of the text, for errors. Raises DataFileError: with the first mistakes that were found, each with its line.
    """
    reader = csv.reader(StringIO(text.removeprefix("\ufeff").rstrip("\r\n")), strict=True)
    lines: list[tuple[str, list[str]]] = []
    try:
        for cells in reader:
            if len(lines) > TRACE.items:
                raise DataFileError("trace", name, [f"it has more than {TRACE.items} rows"])
            lines.append((f"line {reader.line_num}", cells))
    except csv.Error as error:
        raise DataFileError("trace", name, [f"line {reader.line_num}: not CSV: {error}"]) from None
    if not lines:
        raise DataFileError("trace", name, ['it is empty: expected a header such as "time [s],delivered"'])
    (first, headings), *rows = lines
    if len(headings) > _MOST_COLUMNS:
        message = f"{first}: expected some of the columns {', '.join(_UNITS)}, got {len(headings)} columns"
        raise DataFileError("trace", name, [message])
    columns, problems = _columns(headings)
    if problems:
        raise DataFileError("trace", name, [f"{first}: {problem}" for problem in problems[:_MOST_PROBLEMS]])
    read: list[TraceRow] = []
    for place, cells in rows:
        try:
            read.append(_row(columns, cells, read[-1].time_ns if read else None))
        except ValueError as error:
            problems.append(f"{place}: {error}")
            if len(problems) >= _MOST_PROBLEMS:
                break
    if not read and not problems:
        problems.append(f"there is no row below {first}")
    if problems:
        raise DataFileError("trace", name, problems)
    return TraceTable(tuple(columns), tuple(read))


def _columns(headings: list[str]) -> tuple[dict[str, Decimal], list[str]]:
    """The size of each column's unit in SI units, by its name; and what is wrong with the headings."""
    found: dict[str, Decimal] = {}
    problems, twice = list[str](), set[str]()
    for heading in headings:
        try:
            name, size = _column(heading)
        except ValueError as error:
            problems.append(str(error))
            continue
        if name in found:
            twice.add(name)
        found[name] = size
    problems += [f"{name} is there twice" for name in sorted(twice)]
    if not problems and not set(found) - {"time"}:
        problems.append("no such column: expected one of delivered, delay, rate and snr beside the time")
    return found, problems


def _column(heading: str) -> tuple[str, Decimal]:
    """Name of a column, and the size of its unit. Raises ValueError."""
    match = _HEADING.fullmatch(heading)
    name, unit = ("", None) if match is None else (match["name"].lower(), match["unit"])
    if name not in _UNITS:
        hint = nearest(name, _UNITS) or f"there are {', '.join(_UNITS)}"
        raise ValueError(f"no such column {quoted(heading.strip())}; {hint}")
    units = _UNITS[name].units
    if (unit or "").strip() in units:
        size = units[(unit or "").strip()]
        return name, Decimal(size.numerator) / Decimal(size.denominator)
    wrong = f"has the unknown unit {quoted(unit.strip())}" if unit else "has no unit"
    expected = " or ".join(f"{name} [{known}]" if known else name for known in units)
    raise ValueError(f"the column {name} {wrong}: expected {expected}, got {quoted(heading.strip())}")


def _row(columns: dict[str, Decimal], cells: list[str], before_ns: int | None) -> TraceRow:
    """A row below one with the time `before_ns`. Raises ValueError."""
    if len(cells) != len(columns):
        raise ValueError(f"expected {len(columns)} cells, got {len(cells)}")
    texts = dict(zip(columns, map(str.strip, cells), strict=True))
    delivered = texts.pop("delivered", "1")
    if delivered not in ("0", "1"):
        hole = "" if delivered else "a hole: "
        raise ValueError(f"delivered: {hole}expected 0 or 1, got {quoted(delivered)}")
    needed = [name for name, text in texts.items() if text or name == "time" or delivered == "1"]
    numbers = {name: _number(name, texts[name], columns[name]) for name in needed}
    time, delay, rate = (
        None if name not in numbers else int((numbers[name] * parts).to_integral_value())
        for name, parts in (("time", _NS), ("delay", _NS), ("rate", 1))
    )
    if before_ns is not None and time is not None and time < before_ns:
        expected = f"expected {_decimal(before_ns, _NS)} s or later, got {_decimal(time, _NS)} s"
        raise ValueError(f"the time goes back: {expected}")
    return TraceRow(time, delivered == "1", delay, rate, float(numbers["snr"]) if "snr" in numbers else None)


def _number(name: str, text: str, size: Decimal) -> Decimal:
    """A cell in SI units. Raises ValueError."""
    if not text:
        raise ValueError(f"{name}: a hole: expected a number, got nothing")
    if len(text) > LONGEST_NUMBER or not NUMBER.fullmatch(text):
        raise ValueError(f"{name}: expected a number, got {quoted(text)}")
    value = Decimal(text) * size
    low, high = _BOUNDS[name]
    if not low <= value <= high:
        unit = next(unit for unit, factor in _UNITS[name].units.items() if factor == 1)
        raise ValueError(f"{name}: expected {float(low):g} to {float(high):g} {unit}, got {float(value):g} {unit}")
    return value


def _cell(row: TraceRow, name: str) -> str:
    """The inverse of `_row`, for one column."""
    if name == "delivered":
        return str(int(row.delivered))
    if name == "snr":
        return "" if row.snr_db is None else repr(row.snr_db)
    cells = {"time": (row.time_ns, _NS), "delay": (row.delay_ns, 10**6), "rate": (row.rate_bit_s, 1)}
    return _decimal(*cells[name])


def _decimal(number: int | None, parts: int) -> str:
    """A whole number of parts, exactly."""
    return "" if number is None else f"{(Decimal(number) / parts).normalize():f}"


INSIDE = "in the scenario"  # the name of a trace that has no file


def load_trace(text: str, folder: Path | None = None) -> TraceTable:
    """The trace that a scenario names, from `folder` (the scenario's) or the current directory.

    `text`: the path of a file that ends in `.csv`, or CSV with a line break. Raises DataFileError: there is no such
    file, it cannot be read, or it has mistakes, each with its line.
    """
    if "\n" in text:
        return read_csv(text, INSIDE)
    if not text.endswith(".csv"):
        raise DataFileError("trace", text[:80] or '""', ["expected a file that ends in .csv"])
    return read_beside("trace", text, folder, read_trace, most_shown=80)


def read_trace(path: Path) -> TraceTable:
    """The trace in a file. Raises FileNotFoundError: there is none; DataFileError: as `load_trace`."""
    try:
        return read_csv(read_file(path, TRACE.bytes).decode("utf-8"), str(path))
    except FileNotFoundError:
        raise
    except UnicodeDecodeError as error:
        raise DataFileError("trace", str(path), [f"not UTF-8 text (byte {error.start})"]) from None
    except (OSError, ValueError) as error:  # ValueError: the name has a null byte
        raise DataFileError("trace", str(path), [getattr(error, "strerror", None) or str(error)]) from None
