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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from io import StringIO

from fleet import quantities as q
from fleet.scenario.sections.data_files import DataFileError
from netem.condition import Condition
from netem.parsing import LONGEST_NUMBER, NUMBER, nearest, quoted

MOST_ROWS = 100_000
_MOST_PROBLEMS = 5
_MOST_COLUMNS = 20  # of which each is looked at
_HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")
_MEASURED = {"delay": q.TIME, "rate": q.BIT_RATE, "snr": q.LEVEL}
_UNITS = {"time": q.TIME, "delivered": q.NUMBER, **_MEASURED}
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
            if len(lines) > MOST_ROWS:
                raise DataFileError("trace", name, [f"it has more than {MOST_ROWS} rows"])
            lines.append((f"line {reader.line_num}", cells))
    except csv.Error as error:
        raise DataFileError("trace", name, [f"line {reader.line_num}: not CSV: {error}"]) from None
    if not lines:
        raise DataFileError("trace", name, ['it is empty: expected a header such as "time [s],delivered"'])
    return read_cells(lines[0][1], lines[1:], name, lines[0][0])


def read_cells(
    headings: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], name: str, first: str = "the header"
) -> TraceTable:
    """The trace in cells of text. Raises DataFileError as `read_csv`.

    Args:
        headings: of the columns, with units.
        rows: the place of each row, in words, and its cells.
        first: the place of the headings, in words.
    """
    if len(headings) > _MOST_COLUMNS:
        message = f"{first}: expected some of the columns {', '.join(_UNITS)}, got {len(headings)} columns"
        raise DataFileError("trace", name, [message])
    problems: list[str] = []
    found = [_column(heading, problems) for heading in headings]
    known = [column for column, _ in found]
    problems += [f"{column} is there twice" for column in sorted({c for c in known if c and known.count(c) > 1})]
    if not problems and not set(known) - {"time"}:
        problems.append("no such column: expected one of delivered, delay, rate and snr beside the time")
    if problems:
        raise DataFileError("trace", name, [f"{first}: {problem}" for problem in problems[:_MOST_PROBLEMS]])
    read: list[TraceRow] = []
    for place, cells in rows:
        row = _row(found, cells, problems, place)
        if row is not None and read and row.time_ns is not None:
            before = read[-1].time_ns
            if before is not None and row.time_ns < before:
                expected = f"expected {_decimal(before, _NS)} s or later, got {_decimal(row.time_ns, _NS)} s"
                problems.append(f"{place}: the time goes back: {expected}")
                row = None
        if row is not None:
            read.append(row)
        if len(problems) >= _MOST_PROBLEMS:
            break
    if not read and not problems:
        problems.append(f"there is no row below {first}")
    if problems:
        raise DataFileError("trace", name, problems)
    return TraceTable(tuple(known), tuple(read))


def _column(heading: str, problems: list[str]) -> tuple[str, Decimal]:
    """Name of a column, and the size of its unit in SI units."""
    match = _HEADING.fullmatch(heading)
    name, unit = ("", None) if match is None else (match["name"].lower(), match["unit"])
    if name not in _UNITS:
        hint = nearest(name, _UNITS) or f"there are {', '.join(_UNITS)}"
        problems.append(f"no such column {quoted(heading.strip())}; {hint}")
        return "", Decimal(1)
    units = _UNITS[name].units
    if (unit or "").strip() in units:
        size = units[(unit or "").strip()]
        return name, Decimal(size.numerator) / Decimal(size.denominator)
    wrong = f"has the unknown unit {quoted(unit.strip())}" if unit else "has no unit"
    expected = " or ".join(f"{name} [{known}]" if known else name for known in units)
    problems.append(f"the column {name} {wrong}: expected {expected}, got {quoted(heading.strip())}")
    return name, Decimal(1)


def _row(columns: Sequence[tuple[str, Decimal]], cells: Sequence[str], problems: list[str], at: str) -> TraceRow | None:
    """A row, or None and a problem."""
    if len(cells) != len(columns):
        problems.append(f"{at}: expected {len(columns)} cells, got {len(cells)}")
        return None
    texts = {name: text.strip() for (name, _), text in zip(columns, cells, strict=True)}
    delivered = texts.get("delivered", "1")
    if delivered not in ("0", "1"):
        problems.append(
            f"{at}: delivered: {'a hole: ' if not delivered else ''}expected 0 or 1, got {quoted(delivered)}"
        )
        return None
    numbers: dict[str, Decimal | None] = {}
    for name, size in columns:
        if name == "delivered":
            continue
        if not texts[name] and name != "time" and delivered == "0":
            continue
        value, problem = _number(name, texts[name], size)
        if problem:
            problems.append(f"{at}: {name}: {problem}")
            return None
        numbers[name] = value
    delay, rate, snr = (numbers.get(name) for name in _MEASURED)
    time = numbers.get("time")
    return TraceRow(
        None if time is None else _whole(time * _NS),
        delivered == "1",
        None if delay is None else _whole(delay * _NS),
        None if rate is None else _whole(rate),
        None if snr is None else float(snr),
    )


def _number(name: str, text: str, size: Decimal) -> tuple[Decimal | None, str]:
    """A cell in SI units, or what is wrong with it."""
    if not text:
        return None, "a hole: expected a number, got nothing"
    if len(text) > LONGEST_NUMBER or not NUMBER.fullmatch(text):
        return None, f"expected a number, got {quoted(text)}"
    value = Decimal(text) * size
    low, high = _BOUNDS[name]
    if not low <= value <= high:
        unit = next(unit for unit, factor in _UNITS[name].units.items() if factor == 1)
        return None, f"expected {float(low):g} to {float(high):g} {unit}, got {float(value):g} {unit}"
    return value, ""


def _whole(value: Decimal) -> int:
    return int(value.to_integral_value())


def _cell(row: TraceRow, name: str) -> str:
    """The inverse of `_row`, for one column."""
    match name:
        case "time":
            return _decimal(row.time_ns, _NS)
        case "delivered":
            return str(int(row.delivered))
        case "delay":
            return _decimal(row.delay_ns, 10**6)
        case "rate":
            return _decimal(row.rate_bit_s, 1)
        case _:
            return "" if row.snr_db is None else repr(row.snr_db)


def _decimal(number: int | None, parts: int) -> str:
    """A whole number of parts, exactly."""
    return "" if number is None else f"{(Decimal(number) / parts).normalize():f}"
