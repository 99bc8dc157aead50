"""`fleet report` of a study: one self-contained HTML page. Every text of the study is escaped."""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from math import isfinite
from pathlib import Path
from typing import Any

from fleet.addons.pictures.page import (
    Block,
    FoldedText,
    Heading,
    Mark,
    Paragraph,
    Table,
    from_here,
    images,
    render,
    write_page,
)
from fleet.addons.pictures.report import rest
from fleet.addons.studies.pictures.gallery import draw
from fleet.addons.studies.pictures.points import NOT_MADE, NOT_NEEDED, Points, Quantity, factors, is_share, load, minus
from fleet.addons.studies.row import Row
from fleet.addons.studies.statistics import Estimate, compare, levels
from fleet.addons.studies.store import Store
from fleet.errors import printable
from fleet.logs.run_name import STAMP
from fleet.mcap.reader import OnProgress

MOST_POINTS, MOST_REASONS, MOST_VALUES = 200, 30, 12
_LONGEST = 400  # characters of a reason


def write(
    path: Path,
    store: Store,
    measures: Sequence[str] = (),
    log_scale: bool | None = None,
    share: OnProgress = lambda _: None,
) -> None:
    """Write the page. `measures`: in addition to the share of runs that passed; none: those of the table of `fleet
    sweep`. `log_scale`: numbers have a logarithmic axis; None: numbers of a wide range have one. Raises StudyError:
    there is no such measure, or the study is damaged; FleetError: the place cannot be written."""
    points = load(store, measures)
    write_page(path, lambda: page(store, points, log_scale, share))


def page(store: Store, points: Points, log_scale: bool | None = None, share: OnProgress = lambda _: None) -> str:
    """The whole page as HTML. Raises StudyError: the study is damaged."""
    rows = _Rows(store)
    directory = from_here(store.directory)
    first, pictures = images(draw(points, log_scale, share))
    place = shlex.quote(str(directory))
    blocks: list[Block] = [Paragraph(_verdict(rows.points), "verdict"), *([first] if first else [])]
    if (failed := _failed_table(rows)).rows:
        blocks += [Heading("Why runs failed", 2), failed]
    blocks += [Heading("What was run", 2), Table((), _facts(store, points, rows), "words")]
    if store.record.border is not None:
        blocks.append(Paragraph(_BORDER.format(place=place)))
    if missing := int((points.state == NOT_MADE).sum()):
        blocks.append(Paragraph(f"{missing} runs are not made yet; `fleet sweep {place}` makes them.", "warn"))
    if axes := [(one.key, one.unit or "", _some([*map(one.shown, one.values)])) for one in points.dimensions]:
        blocks += [Heading("What varies", 2), Table(("what varies", "unit", "values"), axes, "words")]
    blocks += [Heading("Results", 2), Paragraph(_STATISTICS)]
    if pictures.drawn or pictures.missing:
        blocks.append(pictures)
    blocks += [Heading("All points"), _results(points)]
    if comparisons := _comparisons(points):
        blocks += [Heading("In pairs", 2), Paragraph(_IN_PAIRS)]
        blocks += [block for key, table in comparisons for block in (Heading(key), table)]
    reasons = _reasons(rows)
    blocks += [Heading("Runs without a result", 2), reasons if reasons.rows else Paragraph("None.")]
    blocks.append(Heading("How to make a run again", 2))
    if again := _again(directory, rows):
        blocks += [Paragraph(_AGAIN), FoldedText(again)]
    blocks.append(Paragraph("All rows: `fleet.open_study(...).to_pandas()`."))
    if store.points:
        blocks.append(FoldedText(store.points[0].scenario, "The scenario of point 0"))
    return render(f"uuv-fleet: study {store.directory.resolve().name}", blocks)


_BORDER = (
    "This study looks for a border, so not every point is run with every seed; `fleet boundary {place}` shows what it "
    "found, and makes runs that are missing."
)
_STATISTICS = (
    "Shares of runs that passed with the Wilson score interval, medians with the one between two of their ordered "
    "values, which has the level that stands beside it. A median of fewer than six runs has none. A run without a "
    "result counts in neither; `inf`: half of the runs or more do not have the number, which counts as larger than "
    "every other."
)
_IN_PAIRS = (
    "Runs with the same seed meet the same network and sea, so values are compared run by run, at equal values of all "
    "else. Fewer than six pairs that differ cannot show a difference (p < 0.05)."
)
_AGAIN = "With its log, below `runs/`; the digest is that of the row. Then `fleet plot` shows it."


class _Rows:
    """What the page says of the rows of a study, which may be too many to be held."""

    def __init__(self, store: Store) -> None:
        self.count, self.without = 0, 0  # without a result
        self.made_by = Counter[str]()
        self.walls, self.wall_s = 0, 0.0
        self.points: dict[int, list[int]] = {}  # of each: runs that were judged, and those that passed
        self.failed = Counter[str]()  # by check
        self.unjudged: dict[tuple[str, str], list[int]] = {}  # by status and reason: runs, point and seed of the first
        self.first: tuple[int, int] | None = None  # point and seed
        self.no_pass: tuple[int, int] | None = None  # the first that did not pass
        for row in store.rows(["wall_s"], checks=True, details=True):
            self._add(row)

    def _add(self, row: Row) -> None:
        self.count += 1
        self.without += not row.has_result
        self.made_by[f"uuv-fleet {row.version}, {row.cores} cores"] += 1
        if isfinite(wall_s := row.number("wall_s")):
            self.walls, self.wall_s = self.walls + 1, self.wall_s + wall_s
        if row.judged:
            counts = self.points.setdefault(row.point, [0, 0])
            counts[0] += row.passed is not None
            counts[1] += row.passed is True
            self.failed.update(row.failed_checks)
        else:
            self.unjudged.setdefault((row.status, row.reason[:_LONGEST]), [0, row.point, row.seed])[0] += 1
        self.first = self.first or (row.point, row.seed)
        if row.passed is not True:
            self.no_pass = self.no_pass or (row.point, row.seed)


def _facts(store: Store, points: Points, rows: _Rows) -> list[tuple[str, Any]]:
    record, planned = store.record, int((points.state != NOT_NEEDED).sum())
    seeds = store.seeds[: points.state.shape[1]]
    whole = seeds == list(range(seeds[0], seeds[0] + len(seeds))) if seeds else False
    listed = f"{seeds[0]} to {seeds[-1]}" if whole and len(seeds) > 1 else _some(list(map(str, seeds)))
    cost = "-"
    if rows.walls:
        cost = f"{_time(rows.wall_s)} of one core, {rows.wall_s / rows.walls:.3g} s per run"
    return [
        ("scenario", record.scenario),
        ("changed for every run", record.command or "nothing"),
        ("checks", ", ".join(record.checks)),
        *([("passed means", f"passed {record.check}")] if record.check else []),
        ("points", len(points.keys)),
        ("seeds of each", listed),
        ("runs", f"{planned}, of which {rows.count} are made and {rows.without} have no result"),
        ("begun", _begin_words(store.directory)),
        ("wall time of the runs", cost),
        ("made by", "; ".join(f"{which}: {count} runs" for which, count in rows.made_by.items()) or record.made_by),
        ("directory", str(from_here(store.directory))),
    ]  # fmt: skip


def _verdict(points: Mapping[int, Sequence[int]]) -> str:
    """How many runs passed, and between which shares the points are; an interval of all points would mean nothing."""
    if not points:
        return "no run has a result"
    judged, passed = (sum(counts) for counts in zip(*points.values(), strict=True))
    shares = [good / of for of, good in points.values()]
    spread = f"; of a point {min(shares):.0%} to {max(shares):.0%}" if len(points) > 1 else ""
    return f"{passed} of {judged} runs passed ({passed / judged:.0%}{spread})"


def _failed_table(rows: _Rows) -> Table:
    judged = sum(of for of, _ in rows.points.values())
    found = [(name, Mark(False, str(count)), f"{count / judged:.0%}") for name, count in rows.failed.most_common()]
    return Table(("check", "runs that failed it", "share"), found)


def _begin_words(directory: Path) -> str:
    found = re.search(r"\d{8}-\d{6}$", directory.resolve().name, re.ASCII)
    try:
        if found is not None:
            return f"{datetime.strptime(found[0], STAMP):%Y-%m-%d %H:%M:%S} UTC"
    except ValueError:  # no day has this number
        pass
    file = datetime.fromtimestamp((directory / "study.json").stat().st_mtime, UTC)
    return f"{file:%Y-%m-%d %H:%M:%S} UTC, by the time of its file"


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds < 60.0 else str(timedelta(seconds=round(seconds)))


def _some(values: Sequence[str]) -> str:
    if len(values) <= MOST_VALUES:
        return ", ".join(values)
    return f"{', '.join(values[: MOST_VALUES - 1])}, ... {values[-1]}; {len(values)} in all"


def _results(points: Points) -> Table:
    shown = [points.quantity(name) for name in points.numbers]
    headings = ["point", *(f"{each.name} [{each.unit}]" if each.unit else each.name for each in points.dimensions)]
    headings += [
        "runs",
        "without result",
        *(f"{each.what}, {'95 % interval' if each.kind == 'share' else 'median'}" for each in shown),
    ]
    rows: list[Sequence[Any]] = []
    for number, key in enumerate(points.keys[:MOST_POINTS]):
        cell = shown[0].cells[key]
        varied = [f"{value:g}" if isinstance(value, float) else value for value in key]
        counts = [cell.runs - cell.lack.not_made, cell.lack.failed]
        rows.append((number, *varied, *counts, *(_number(each, key) for each in shown)))
    rows += rest(len(points.keys) - len(rows), "which fleet.open_study has")
    return Table(headings, rows, "numbers")


def _number(quantity: Quantity, key: tuple[float | str, ...]) -> str:
    cell = quantity.cells[key]
    if quantity.kind == "share":
        return _share(cell.estimate)
    have = len(cell.values)
    return _estimate(cell.estimate) + (f" (of {have} runs)" if cell.lack.without and have else "")


def _share(rate: Estimate) -> str:
    if rate.runs == 0:
        return "-"
    return f"{100 * rate.value:.0f} %   {100 * rate.low:.0f}..{100 * rate.high:.0f} %"


def _estimate(found: Estimate) -> str:
    if found.runs == 0:
        return "-"
    interval = f"{found.low:.3g}..{found.high:.3g} ({levels([found])})"
    return f"{found.value:.3g}" + (f"   {interval}" if found.low < found.high else "")


def _comparisons(points: Points) -> list[tuple[str, Table]]:
    found = []
    for place in factors(points):
        dimension = points.dimensions[place]
        first, *others = dimension.values
        rows: list[Sequence[Any]] = []
        for other in others:
            pairs = [(k, base) for key, k, base in points.pairs(place) if key[place] == other]
            for name, column in points.numbers.items():
                one = [float(value) for _, base in pairs for value in column[base]]
                two = [float(value) for k, _ in pairs for value in column[k]]
                result = compare(one, two)
                if not result.difference.runs:
                    continue
                difference, smaller = _estimate(result.difference), f"{100 * result.better:.0f} %"
                if is_share(name):
                    only = [sum(a == win and b == 1 - win for a, b in zip(one, two, strict=True)) for win in (1.0, 0.0)]
                    difference, smaller = f"only {first}: {only[0]}, only {other}: {only[1]}", ""
                p = f"{result.p:.2g}" if isfinite(result.p) else result.note
                rows.append((minus(other, first), points.words(name), result.difference.runs, difference, smaller, p))
        found.append((dimension.key, Table(_COMPARED, rows, "words")))
    return found


_COMPARED = ("values", "of what", "pairs", "median difference, interval (level)", "difference below 0", "p (sign test)")


def _reasons(rows: _Rows) -> Table:
    most = sorted(rows.unjudged.items(), key=lambda item: -item[1][0])
    table: list[Sequence[Any]] = [
        (Mark(False, status), count, f"point {point}, seed {seed}", printable(reason))
        for (status, reason), (count, point, seed) in most[:MOST_REASONS]
    ]
    table += rest(len(most) - len(table), "reasons of fewer runs")
    return Table(("status", "runs", "the first", "reason"), table, "last")


def _again(directory: Path, rows: _Rows) -> str:
    if rows.first is None:
        return ""
    point, seed = rows.no_pass or rows.first
    code = f"import fleet; fleet.open_study({json.dumps(str(directory))}).rerun({point}, seed={seed})"
    return f"python -c {shlex.quote(code)}"
