"""`fleet report`: one self-contained HTML page about one run or some; everything that is shown is in the file."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from msgspec import convert, structs

from fleet.addons.pictures.any_signal import file_name
from fleet.addons.pictures.beliefs import beliefs
from fleet.addons.pictures.found_signal import plain_name
from fleet.addons.pictures.gallery import PER_RUN, WHAT, draw
from fleet.addons.pictures.page import (
    Block,
    Contents,
    FoldedText,
    Heading,
    Mark,
    PageImage,
    Paragraph,
    SectionImages,
    Table,
    from_here,
    images,
    render,
    write_page,
)
from fleet.addons.pictures.runs import LoggedRun, View
from fleet.addons.pictures.scenario_facts import conditions_note, conditions_table, network_facts, scenario_facts
from fleet.addons.pictures.signal_limits import ERRORS, PICTURES
from fleet.logs.payload_kinds import KindCount, count_kinds
from fleet.logs.run_name import begin_time, run_name
from fleet.logs.topic_names import link_topic
from fleet.mcap.reader import OnProgress
from fleet.result.file import ResultError, read_result
from fleet.result.result import LinkAge, Result
from fleet.result.verdict import Verdict, sort_failed_first
from fleet.scenario.sections.signals import parse_name
from fleet.scenario.sections.vehicle_events import vehicle_events
from netem.ages import Ages
from netem.cause import Cause
from netem.ledger import Account
from netem.wire.messages import Fate

_OF_CHECKS = {
    "formation_error": "formation", "consensus_error": "error", "recovery_time": "formation", "tumbled": "formation",
    "min_separation": "track", "deaths": "track", "max_age": "ages", "connected": "links", "ledger": "links",
    "middleware_loss": "links",
}  # fmt: skip
_ELSE = ("formation", "error", "track", "links")  # what is looked at first where no check says more


def telling(run: LoggedRun) -> list[str]:
    """Names of pictures, the most telling first: what failed checks look at, then what others do, then errors."""
    failed = [verdict for verdict in run.verdicts if not verdict.passed]
    passed = [verdict for verdict in run.verdicts if verdict.passed and verdict.signals]
    return [*_pictures_of(failed), *_pictures_of(passed), *_ELSE]


def _pictures_of(verdicts: Iterable[Verdict]) -> list[str]:
    found = []
    for verdict in verdicts:
        signals = [name for name in map(parse_name, verdict.signals) if name is not None]
        found += [
            PICTURES[ERRORS[plain.name]] if (plain := plain_name(name)).name in ERRORS else file_name(name)
            for name in signals
        ]
        if verdict.check in _OF_CHECKS:
            found.append(_OF_CHECKS[verdict.check])
    return found


_Name = TypeVar("_Name", int, str)
MOST_ROWS = 40  # of a table of vehicles or links
_ONLY_IF_ANY = ("duplicated", "in flight", "corrupted")  # columns that are left out where every link has a 0


def side_by_side(runs: Sequence[LoggedRun], results: Sequence[Result | None]) -> Table:
    """A row per run: what one looks for first when runs are compared; None: the run has no result."""
    headings = (
        "run", "seed", "vehicles", "status", "checks passed", "slowest settle to 10 % [s]",
        "largest final formation error [m]", "surge effort, all [N s]", "delivered", "oldest heard [s]",
    )  # fmt: skip
    rows = []
    for run, result in zip(runs, results, strict=True):
        row: list[Any] = [run.label, run.log.run.get("seed", "-"), len(run.log.vehicles)]
        if result is None:
            rows.append([*row, *["-"] * (len(headings) - len(row))])
            continue
        good = sum(verdict.passed for verdict in result.checks)
        row += [
            Mark(result.passed, result.status.replace("_", " ")),
            f"{good} of {len(result.checks)}" if result.checks else "-",
        ]
        vehicles = list(result.vehicles.values())
        row += [
            _join_numbers([one.settle_10pct_s for one in vehicles], max, "not settled"),
            _join_numbers([one.formation_final_m for one in vehicles], max),
            _join_numbers([one.effort_Ns for one in vehicles], sum),
        ]
        accounts = result.ledger.values()
        entered = sum(account.sent + account.duplicated - account.replaced for account in accounts)
        row.append(f"{sum(account.delivered for account in accounts) / entered:.1%}" if entered else "-")
        age = result.ages.get("*")
        rows.append([*row, f"{age.max_s:.4g}" if age else "-"])
    return Table(headings, rows)


def believed_errors(run: LoggedRun, vehicles: Iterable[str]) -> dict[str, float]:
    """The last formation error of each vehicle that has to navigate, as it believes it [m]."""
    known = ((i, beliefs(run.log, int(i))) for i in vehicles)
    return {i: float(one.formation_norm[-1]) for i, one in known if one is not None}


def _join_numbers(numbers: Sequence[float | None], join: Callable[[list[float]], float], missing: str = "-") -> str:
    """One number for all vehicles; `missing`: what stands there if one of them has none."""
    known = [value for value in numbers if value is not None]
    return "-" if not numbers else f"{join(known):.4g}" if len(known) == len(numbers) else missing


def links_table(ledger: Mapping[str, Account], ages: Mapping[str, LinkAge]) -> Table:
    """Packets and ages of all links, or of the links with the oldest data; `ledger` and `ages` as in a result."""
    # What a modem never sent, because there were news, was not lost on the way.
    causes = sorted(
        {cause for account in ledger.values() for cause in account.lost}, key=lambda c: (c != Cause.REPLACED, c)
    )
    names = worst(ledger, {name: age.max_s for name, age in ages.items()})
    counted = ("sent", "duplicated", "delivered", "in_flight", "corrupted")
    rows = []
    for name in ["*", *names]:
        accounts = list(ledger.values()) if name == "*" else [ledger[name]]
        numbers = [sum(getattr(account, key) for account in accounts) for key in counted]
        losses = [sum(account.lost.get(cause, 0) for account in accounts) for cause in causes]
        age = ages.get(name)
        times = ["-"] * 3 if age is None else [f"{seconds:.3f}" for seconds in (age.mean_s, age.p95_s, age.max_s)]
        rows.append(("all" if name == "*" else name, *numbers, *losses, *times))
    headings = ("link", *(key.replace("_", " ") for key in counted),
                *(cause if cause == Cause.REPLACED else f"lost: {cause}" for cause in causes),
                "mean age [s]", "95 % [s]", "max [s]")  # fmt: skip
    kept = [k for k, heading in enumerate(headings) if heading not in _ONLY_IF_ANY or rows[0][k]]
    rows, headings = [tuple(row[k] for k in kept) for row in rows], tuple(headings[k] for k in kept)
    rows += rest(len(ledger) - len(names), "whose age stayed lower")
    return Table(headings, rows)


def kinds_table(kinds: Sequence[KindCount]) -> Table:
    rows = [
        (one.kind, one.packets, one.delivered, f"{one.delivered / one.packets:.1%}", f"{one.size / one.packets:.4g}")
        for one in kinds[:MOST_ROWS]
    ]
    left = rest(len(kinds) - len(rows), "of which there are fewer")
    return Table(("kind", "packets", "arrived whole", "share", "mean size [bytes]"), [*rows, *left])


def checks_table(verdicts: Sequence[Verdict]) -> Table:
    """The verdicts, failed checks on top."""
    rows = [(one.check, Mark(not one.failed, one.mark), one.asked, one.found) for one in sort_failed_first(verdicts)]
    return Table(("check", "verdict", "asked", "found"), rows, "words")


def worst(rows: Mapping[_Name, Any], how_bad: Mapping[_Name, float]) -> list[_Name]:
    """The names of all rows, or of too many those of the worst, the worst first."""
    if len(rows) <= MOST_ROWS:
        return list(rows)
    return sorted(rows, key=lambda name: -how_bad.get(name, 0.0))[:MOST_ROWS]


def rest(count: int, which: str) -> list[tuple[str]]:
    """A row that says how many rows are left out, and which; none if none are."""
    return [(f"{count} more, {which}",)] if count else []


def number(key: str, value: Any) -> str:
    """A value of a vehicle's result."""
    if value is None:
        return "not settled" if key.startswith("settle") else "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@dataclass(slots=True)
class RunResult:
    """The result of a run, if there is one and it is of this log."""

    result: Result | None
    why_none: str
    digest: str


def write(path: Path, runs: Sequence[LoggedRun], view: View, share: OnProgress = lambda _: None) -> None:
    """Write the page; `share` is called with the share of the pictures that is done. Raises FleetError if the place
    cannot be written; LogReadError if a log has gone meanwhile.
    """
    write_page(path, lambda: page(runs, view, share))


def page(runs: Sequence[LoggedRun], view: View, share: OnProgress = lambda _: None) -> str:
    results = [_result(run) for run in runs]
    names = [run_name(run.log.path) for run in runs]
    blocks: list[Block] = []
    if len(runs) > 1:
        titles = [f": {run.scenario.title}" if run.scenario and run.scenario.title else "" for run in runs]
        entries = [
            (f"run-{n}", name, title) for n, (name, title) in enumerate(zip(names, titles, strict=True), start=1)
        ]
        blocks += [
            Contents([("together", "The runs together", ""), *entries]),
            Heading("The runs together", 2, "together"),
            side_by_side(runs, [one.result for one in results]),
            _pictures([k for k in WHAT if k not in PER_RUN], runs, view, share)[1],
        ]
    kinds = list(WHAT) if len(runs) == 1 else sorted(PER_RUN)
    for n, (run, result) in enumerate(zip(runs, results, strict=True), start=1 if len(runs) > 1 else 0):
        blocks += _section(n, run, result, kinds, view, share)
    return render("uuv-fleet: " + ", ".join(names), blocks, "; positions are north, east, down")


def _section(
    number: int, run: LoggedRun, found: RunResult, kinds: Sequence[str], view: View, share: OnProgress
) -> list[Block]:
    log, scenario, result = run.log, run.scenario, found.result
    name, path = run_name(log.path), from_here(log.path)
    first, pictures = _pictures(kinds, [run], view, share, [] if number else telling(run))
    blocks: list[Block] = [Heading(name, 2, f"run-{number}")]
    if log.missing:
        blocks.append(Paragraph(f"The log is not whole: {log.missing}. It ends at {log.end:g} s.", "warn"))
    if scenario is not None and scenario.title:
        blocks.append(Paragraph(scenario.title))
    blocks.append(Paragraph(found.why_none, "warn") if result is None else Mark(result.passed, result.words))
    if first is not None:
        blocks.append(first)
    if result is not None:
        blocks += [Heading("Verdicts"), *([Paragraph(result.reason)] if result.reason else [])]
        blocks.append(checks_table(result.checks) if result.checks else Paragraph("No check was judged."))
    faults = [(fault.id, f"{fault.begin:g}", f"{fault.end:g}", fault.what) for fault in log.faults]
    listed = Table(("fault", "from [s]", "to [s]", "what"), faults, "last")
    blocks += [Heading("Faults"), listed if faults else Paragraph("There was no fault.")]
    if events := vehicle_events((event.what, event.begin) for event in log.events):
        rows = [(event.what, event.times, f"{event.first_s:.10g}") for event in events]
        blocks += [Heading("What happened to vehicles"), Table(("event", "times", "first at [s]"), rows)]
    blocks += [Heading("Scenario"), Table((), _facts(number, run, found), "words")]
    if scenario is not None:
        blocks += [Heading("Network"), Table((), network_facts(scenario), "words")]
        if (conditions := conditions_table(scenario)).rows:
            blocks += [Heading("Conditions of the links"), conditions]
        if note := conditions_note(scenario):
            blocks.append(Paragraph(note))
    for heading, table in _tables(run, result):
        blocks += [Heading(heading), table]
    place = shlex.quote(str(path.parent if path.name == "run.mcap" else path))
    verb, said = ("netem", _SENT_BY_OTHERS) if run.of_nodes else ("run", _REPEATED)
    blocks += [
        pictures,
        Heading("How to repeat it"),
        Paragraph(said),
        FoldedText(f"fleet export {place} --scenario > again.yaml\nfleet {verb} again.yaml"),
        Table((), sorted(log.run.items()), "words"),
    ]
    return blocks + ([FoldedText(log.scenario_text, "scenario.yaml")] if log.scenario_text else [])


_REPEATED = (
    "The log holds the merged scenario; with the faults that were injected while it ran it is what "
    "`fleet export --scenario` prints. The same scenario and the same versions give the same digest."
)

_SENT_BY_OTHERS = (
    "The log holds the scenario; with the faults that were injected it is what `fleet export --scenario` prints. The "
    "fate of the n-th packet of a link comes again. Which message is the n-th is up to the programs."
)


def _facts(number: int, run: LoggedRun, found: RunResult) -> list[tuple[str, Any]]:
    name, path = run_name(run.log.path), from_here(run.log.path)
    facts = scenario_facts(run.scenario) if run.scenario is not None else []
    # The log holds simulated time only, so that it is the same each time.
    begun = begin_time(name)
    facts += [
        ("begun", f"{begun:%Y-%m-%d %H:%M:%S} UTC" if begun else "unknown: the name of the run does not say when"),
        ("log", f"{path}, {path.stat().st_size / 1e6:.1f} MB"),
        ("digest", found.digest),
    ]
    if number and run.label != name:
        facts.append(("in tables and pictures of several runs", run.label))
    return facts


def _result(run: LoggedRun) -> RunResult:
    of_log = run.log.digest
    try:
        result = read_result(run.log.path.parent)
    except FileNotFoundError:
        return RunResult(None, "There is no result.json beside this log, so there are no verdicts.", of_log)
    except ResultError as error:
        return RunResult(None, f"{error}; so there are no verdicts.", of_log)
    if result.digest != of_log:
        why = "The result.json beside this log is of another log, so its verdicts are left out."
        return RunResult(None, why, of_log)
    return RunResult(result, "", of_log)


def _tables(run: LoggedRun, result: Result | None) -> list[tuple[str, Table]]:
    tables: list[tuple[str, Table]] = []
    reported = [i for i in run.log.vehicles if f"uuv/{i}/error" in run.log]
    if result and result.vehicles:
        believed = believed_errors(run, result.vehicles)
        headings = {
            "settle_10pct_s": "settle to 10 % [s]", "settle_5cm_s": "settle to 5 cm [s]",
            "e_rms_m": "RMS consensus error, last 10 s [m]",
            "formation_final_m": "final formation error [m]",
            **({"believed_m": "as it believes it [m]"} if believed else {}),
            "effort_Ns": "surge effort [N s]", "u_cmd_max_mps": "max u_cmd [m/s]", "qp_failures": "QP failures",
            "payloads_rejected": "payloads rejected",
        }  # fmt: skip
        vehicles = result.vehicles
        shown = worst(vehicles, {i: row.formation_final_m or 0.0 for i, row in vehicles.items()})
        rows = {i: structs.asdict(row) | {"believed_m": believed.get(i)} for i, row in vehicles.items()}
        measured = [(i, *(number(key, rows[i][key]) for key in headings)) for i in shown]
        measured += rest(len(vehicles) - len(shown), "whose final formation error is smaller")
        tables.append(("Vehicles", Table(("UUV", *headings.values()), measured)))
    elif reported:
        errors = [(i, run.log[f"uuv/{i}/error"]) for i in reported]
        known = {i: e for i, e in errors if not e.too_many and len(e)}
        farthest = worst(known, {i: e["formation_norm"][-1] for i, e in known.items()})
        final = [(i, *(f"{known[i][name][-1]:.4f}" for name in ("e_norm", "formation_norm"))) for i in farthest]
        final += rest(len(known) - len(farthest), "whose formation error is smaller")
        headings_ = ("UUV", "consensus error [m]", "formation error [m]")
        tables.append(("Vehicles at the end of the log", Table(headings_, final)))
    ledger, ages, source = (result.ledger, result.ages, "") if result else (*_from_log(run), ", from the log")
    kinds = count_kinds(run.log[link_topic(link)] for link in run.log.links) or []
    if len(kinds) > 1:
        tables.append(("Packets by kind of payload", kinds_table(kinds)))
    if any(account.sent for account in ledger.values()):
        heading = f"Packets per directed link, and age of what was heard last{source}"
        tables.append((heading, links_table(ledger, ages)))
    return tables


def _from_log(run: LoggedRun) -> tuple[dict[str, Account], dict[str, LinkAge]]:
    ledger: dict[str, Account] = {}
    ages = Ages(run.log.links)
    tick_s = int(run.log.run.get("tick_ns", 0)) / 1e9
    ticks = round(run.log.end / tick_s) + 1 if tick_s else 0
    for src, dst in run.log.links:
        packets = run.log[link_topic((src, dst))]
        if not len(packets) or packets.too_many:
            continue
        fates = Counter(packets["fate"].tolist())
        ledger[f"{src}->{dst}"] = Account(
            sent=int((packets["copy"] == 0).sum()),
            duplicated=int((packets["copy"] > 0).sum()),
            delivered=fates[Cause.DELIVERED],
            in_flight=fates[Cause.IN_FLIGHT],
            corrupted=int(packets["corrupted"].sum()),
            lost={cause: count for cause, count in fates.items() if cause not in (Cause.DELIVERED, Cause.IN_FLIGHT)},
        )
        if tick_s:
            rows = zip(packets["seq"], packets["copy"], packets["sent"], packets["due"], packets["fate"],
                       packets["corrupted"], packets.t, strict=True)  # fmt: skip
            for seq, copy, sent, due, fate, corrupted, final in rows:
                ages.settle(
                    Fate(
                        src=src, dst=dst, seq=int(seq), copy=int(copy), sent_tick=round(sent / tick_s),
                        due_tick=round(due / tick_s), final_tick=round(final / tick_s), delay_ns=0, cause=fate,
                        payload=b"", corrupted=bool(corrupted),
                    )
                )  # fmt: skip
    ages.count(min(ticks, int(run.log.run.get("ticks", ticks))))
    return ledger, convert(ages.summary(round(tick_s * 1e9)), dict[str, LinkAge]) if tick_s else {}


def _pictures(
    kinds: Sequence[str], runs: Sequence[LoggedRun], view: View, share: OnProgress, first: Sequence[str] = ()
) -> tuple[PageImage | None, SectionImages]:
    top, pictures = images(draw(kinds, runs, view, share), first)
    pictures.missing.extend(note for run in runs for note in run.notes)
    return top, pictures
