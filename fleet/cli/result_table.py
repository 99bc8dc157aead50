"""The result of a run as tables for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from msgspec.structs import astuple
from rich.console import Console as Terminal
from rich.text import Text

from fleet.analysis.preflight import large_log_hint
from fleet.analysis.punctuality import summary
from fleet.cores import hidden_cores
from fleet.execution.notes import fold_notes, text_without_agent
from fleet.result.result import FaultEvent, LinkAge, Result, Status, VehicleResult
from fleet.result.verdict import sort_failed_first
from fleet.scenario.sections.vehicle_events import vehicle_events
from fleet.terminal import table
from fleet.terminal.table import TerminalColumn, width
from fleet.terminal.width import INDENT, fold
from netem.cause import Cause
from netem.ledger import Account

Say = Callable[..., None]
MOST_VEHICLES, MOST_LINKS, MOST_EVENTS = 10, 5, 10
MOST_NOTES = 20
_NOT_SETTLED = "not settled"
_P95 = 7  # the rank of the column that goes first


def show(result: Result, terminal: Terminal) -> None:
    """Print verdicts, failed ones first, what happened to vehicles, vehicles, links, and where everything is."""
    most = terminal.width if terminal.is_terminal else None

    def say(text: str, style: str = "", mark: str = "") -> None:
        """A line, folded on a terminal, with a styled mark before it; a mark that is no sentence makes a column."""
        mark += "" if not mark else " " if mark.endswith(":") else "  "
        line = Text(fold(mark + text, most, INDENT if mark.endswith(": ") else " " * len(mark) or INDENT))
        line.stylize(style, 0, len(mark))
        terminal.print(line, soft_wrap=True)

    if result.status in (Status.BROKEN, Status.INTERRUPTED, Status.HUNG_UP):
        say(result.reason, "red", "run broke:" if result.status is Status.BROKEN else "stopped:")
        for line in result.lines:
            say(line)
    for verdict in sort_failed_first(result.checks):
        style = "green" if verdict.passed else "red" if verdict.failed else "yellow"
        say(f"{verdict.check}: {verdict.asked}; found {verdict.words}", style, verdict.mark)
    _show_events(result.events, say)
    explained = {text_without_agent(line) for line in result.lines}
    notes = fold_notes(note for note in result.notes if text_without_agent(note) not in explained)
    room = table.shown_rows(len(notes), MOST_NOTES)
    for note in notes[:room]:
        say(note, mark="note")
    if len(notes) > room:
        say(f"... and {len(notes) - room} more in result.json", mark="note")
    if result.vehicles:
        show_vehicles = _show_protocols if all(row.agent for row in result.vehicles.values()) else _show_vehicles
        show_vehicles(result.vehicles, result.from_s, terminal, say)
    if len(result.vehicles) > 1 and result.formation.worst_m != 0.0:  # moored vehicles are where they began
        say(f"formation error at the end: {result.formation}")
    if any(account.sent for account in result.ledger.values()):
        _show_links(result, terminal, say)
    if result.timing is not None:
        say(summary(result.timing))
    wall, size = result.wall, result.log_bytes
    hosted = f" over {wall.processes} processes of up to {wall.per_process} agents" if wall.per_process > 1 else ""
    ready = f"ready in {wall.startup_s:.2f} s" if wall.startup_s else "never ready"
    how = "in-process" if wall.in_process else f"distributed{hosted}, {ready}"
    where = f", t = {result.from_s:g} to {result.sim_s:g} s," if result.from_s else ""
    passed = f"{result.sim_s - result.from_s:g} s"
    if result.punctual is None:
        passed += f" simulated{where} in {wall.run_s:.2f} s ({wall.x_real_time:.1f} x real time, {how})"
    say(
        f"{passed}; "
        f"{result.messages} messages, {f'{size / 1e6:.1f} MB' if size else 'no log'}, digest {result.digest[:16]}"
    )
    if hint := large_log_hint(size / 1e6):
        say(f"the log is large: {hint}", mark="note")
    if words := hidden_cores():
        say(words, mark="note")
    if result.status is Status.CHECK_FAILED:
        failed = [verdict.check for verdict in result.checks if verdict.failed]
        names = f": {', '.join(dict.fromkeys(failed))}" if failed else ""
        say(f"{len(failed)} of {len(result.checks)} checks{names}{result.not_judged}", "red", "FAIL")
    say(str(result.directory))


def _show_events(rows: list[FaultEvent], say: Say) -> None:
    events = vehicle_events((row.what, row.at_s) for row in rows if row.action == "begins")
    room = table.shown_rows(len(events), MOST_EVENTS)
    for event in events[:room]:
        say(str(event), mark="event")
    if len(events) > room:
        say(f"... and {len(events) - room} more in result.json", mark="event")


def _show_vehicles(rows: dict[str, VehicleResult], from_s: float, terminal: Terminal, say: Say) -> None:
    shown = _farthest(rows)

    def cells(of: Callable[[VehicleResult], float | None], form: str, none: str = "-") -> list[str]:
        return [none if (value := of(rows[i])) is None else format(value, form) for i in shown]

    columns = [
        TerminalColumn("UUV", shown),
        TerminalColumn("settle\n10 % [s]", cells(lambda row: row.settle_10pct_s, ".2f", _NOT_SETTLED), 1),
        TerminalColumn("settle\n5 cm [s]", cells(lambda row: row.settle_5cm_s, ".2f", _NOT_SETTLED), 2),
        TerminalColumn("RMS e, last\n10 s [m]", cells(lambda row: row.e_rms_m, ".4f"), 3),
        TerminalColumn("final\nformation\nerror [m]", cells(lambda row: row.formation_final_m, ".4f")),
        TerminalColumn("surge\neffort [N s]", cells(lambda row: row.effort_Ns, ".1f"), 5),
        TerminalColumn("max u_cmd\n[m/s]", cells(lambda row: row.u_cmd_max_mps, ".2f"), 4),
    ]
    title = f"vehicles; settling times count from the start at t = {from_s:g} s" if from_s else "vehicles"
    table.show(columns, title, terminal, "see result.json")
    _tell_more(len(rows) - len(shown), say)


def _show_protocols(rows: dict[str, VehicleResult], from_s: float, terminal: Terminal, say: Say) -> None:
    """Vehicles whose agents run a protocol: what these reported at the end. They need not settle anywhere."""
    shown = _farthest(rows)
    units = {name: signal.unit for row in rows.values() for name, signal in row.signals.items()}

    def cells(name: str) -> list[str]:
        signals = [rows[i].signals.get(name) for i in shown]
        return ["-" if one is None or one.value is None else f"{one.value:.6g}" for one in signals]

    columns = [
        TerminalColumn("UUV", shown),
        *(
            TerminalColumn(name if unit == "1" else f"{name}\n[{unit}]", cells(name), rank)
            for rank, (name, unit) in enumerate(units.items(), 1)
        ),
    ]
    if any(row.formation_final_m != 0.0 for row in rows.values()):
        errors = [f"{rows[i].formation_final_m:.4f}" for i in shown]
        columns.append(TerminalColumn("final formation\nerror [m]", errors))
    if len(columns) == 1:  # programs without signals, which are moored
        return
    laws = sorted({row.agent for row in rows.values()})
    table.show(columns, f"vehicles; what {', '.join(laws)} reported at the end", terminal, "see result.json")
    _tell_more(len(rows) - len(shown), say)


def _show_links(result: Result, terminal: Terminal, say: Say) -> None:
    """Packets and ages of the links: of all together, and of the links with the oldest information.

    Links with the same numbers are one row. Columns of zeros are left out. Where there is no room for every cause of a
    loss, one column has their sum.
    """
    rows, ages = result.ledger, result.ages
    causes = sorted({cause for row in rows.values() for cause in row.lost} - {Cause.REPLACED})
    alike = _alike(rows, ages)
    room = table.shown_rows(len(alike), MOST_LINKS)
    oldest = sorted(alike, key=lambda name: -ages[name].max_s if name in ages else 0.0)
    shown = oldest[:room] if room < len(alike) else list(alike)
    names = [name if len(alike[name]) == 1 else f"{name} ... ({len(alike[name])})" for name in shown]

    def counts(heading: str, count: Callable[[Account], int], rank: int = 0) -> list[TerminalColumn]:
        total = sum(map(count, rows.values()))
        cells = [str(total), *(str(count(rows[name])) for name in shown)]
        return [TerminalColumn(heading, cells, rank)] if total or not rank else []

    def times(heading: str, age: Callable[[LinkAge], float], rank: int) -> TerminalColumn:
        cells = [f"{age(ages[name]):.3f}" if name in ages else "-" for name in ("*", *shown)]
        return TerminalColumn(heading, cells, rank)

    def columns(lost: list[TerminalColumn]) -> list[TerminalColumn]:
        return [
            TerminalColumn("link", ["all", *names]),
            *counts("sent", lambda row: row.sent),
            *counts("duplicated", lambda row: row.duplicated, 5),
            # Replaced by newer data before it was sent: not lost on the way.
            *counts("replaced", lambda row: row.replaced, 2),
            *counts("delivered", lambda row: row.delivered),
            *lost,
            *counts("in\nflight", lambda row: row.in_flight, 4),
            *counts("corrupted", lambda row: row.corrupted, 3),
            times("mean\nage [s]", lambda age: age.mean_s, 6),
            times("p95\n[s]", lambda age: age.p95_s, _P95),
            times("max\n[s]", lambda age: age.max_s, 1),
        ]

    headings = {cause: "\n".join(["lost:", *cause.split()]) for cause in causes}
    wanted = columns([column for cause in causes for column in counts(headings[cause], _losses(cause))])
    merged = len(causes) > 1 and width([column for column in wanted if column.rank != _P95]) > terminal.width
    if merged:
        wanted = columns(counts("lost", _losses(*causes)))
    since = " since t = 0" if result.from_s else ""  # the ledger goes on, too, as what was on the way then must balance
    title = f"packets per directed link{since}, age of what was heard last"
    table.show(wanted, title, terminal, "see result.json")
    if rest := [link for name, links in alike.items() if name not in shown for link in links]:
        shares = [_lost_share(rows[link]) for link in rest]
        least, most = f"{100 * min(shares):.3g}", f"{100 * max(shares):.3g}"
        lost = f"{least} %" if least == most else f"{least} to {most} %"
        say(f"... and {len(rest)} more link{'s' * (len(rest) > 1)} with {lost} lost in result.json")
    if merged:
        totals = {cause: sum(map(_losses(cause), rows.values())) for cause in causes}
        say("lost: " + ", ".join(f"{totals[cause]} {cause}" for cause in sorted(causes, key=lambda c: -totals[c])))


def _tell_more(rows: int, say: Say) -> None:
    if rows:
        say(f"... and {rows} more in result.json")


def _farthest(rows: Mapping[str, VehicleResult]) -> list[str]:
    """The vehicles, given their rows: all, or of many those with the largest formation error at the end."""
    room = table.shown_rows(len(rows), MOST_VEHICLES)
    if room == len(rows):
        return list(rows)
    return sorted(rows, key=lambda name: -(rows[name].formation_final_m or 0.0))[:room]


def _alike(rows: Mapping[str, Account], ages: Mapping[str, LinkAge]) -> dict[str, list[str]]:
    """Links with the same displayed numbers, by the first of them."""
    first: dict[str, str] = {}
    found: dict[str, list[str]] = {}
    for name, row in rows.items():
        age = ages.get(name)
        shown = repr((row, age and [round(seconds, 3) for seconds in astuple(age)]))
        found.setdefault(first.setdefault(shown, name), []).append(name)
    return found


def _lost_share(row: Account) -> float:
    lost = sum(row.lost.values()) - row.replaced
    return lost / known if (known := lost + row.delivered) else 0.0


def _losses(*causes: str) -> Callable[[Account], int]:
    return lambda row: sum(row.lost.get(cause, 0) for cause in causes)
