"""`fleet report`: one self-contained HTML page about one run or some; everything that is shown is in the file."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec import convert, structs

from fleet.logs.payload_kinds import count_kinds
from fleet.logs.reader import Tell
from fleet.logs.run_name import begun_at, run_name
from fleet.logs.topic_names import link_topic
from fleet.pictures.gallery import PER_RUN, WHAT, draw
from fleet.pictures.page import PageImage, SectionImages, png, render, write_page
from fleet.pictures.report_scenario import conditions_note, conditions_table, network_facts, scenario_facts
from fleet.pictures.report_tables import (
    Mark,
    Table,
    believed_errors,
    checks_table,
    kinds_table,
    links_table,
    number,
    rest,
    side_by_side,
    worst,
)
from fleet.pictures.runs import Run, View
from fleet.pictures.telling import telling
from fleet.result.file import ResultError, read_result
from fleet.result.result import LinkAge, Result
from fleet.scenario.sections.vehicle_events import vehicle_events
from netem.ages import Ages
from netem.causes import Cause
from netem.ledger import Account
from netem.wire.messages import Fate

TEMPLATE = "report.html"


@dataclass(slots=True)
class RunResult:
    """The result of a run, if there is one and it is of this log."""

    result: Result | None
    why_none: str
    digest: str


@dataclass(frozen=True, slots=True)
class ReportSection:
    """The part of the page about one run."""

    anchor: str
    name: str
    missing: str  # of the log; "" if it is whole
    end: str  # of the log [s]
    title: str
    facts: Table
    network: Table
    conditions: Table
    conditions_note: str
    no_verdicts: str  # why there are none; "" if there are
    status: Mark | None
    reason: str
    first: PageImage | None  # that shows best what was found
    checks: Table
    faults: Table
    events: Table  # of vehicles
    tables: list[tuple[str, Table]]  # with their headings
    pictures: SectionImages
    place: str  # of the log, as a shell reads it
    metadata: Table
    scenario_text: str


def write(path: Path, runs: Sequence[Run], view: View, share: Tell = lambda _: None) -> None:
    """Write the page; `share` is called with the share of the pictures that is done.

    Raises:
        FleetError: the place cannot be written.
        LogReadError: a log has gone meanwhile.
    """
    write_page(path, lambda: page(runs, view, share))


def page(runs: Sequence[Run], view: View, share: Tell = lambda _: None) -> str:
    """The whole page as HTML."""
    results = [_result(run) for run in runs]
    together = None
    if len(runs) > 1:
        together = {
            "table": side_by_side(runs, [one.result for one in results]),
            "pictures": _pictures([k for k in WHAT if k not in PER_RUN], runs, view, share)[1],
        }
    kinds = list(WHAT) if len(runs) == 1 else sorted(PER_RUN)
    numbered = enumerate(zip(runs, results, strict=True), start=1 if len(runs) > 1 else 0)
    return render(
        "fleet.pictures",
        TEMPLATE,
        title="uuv-fleet: " + ", ".join(run_name(run.log.path) for run in runs),
        together=together,
        runs=[_section(n, run, result, kinds, view, share) for n, (run, result) in numbered],
    )


def _section(number: int, run: Run, found: RunResult, kinds: Sequence[str], view: View, share: Tell) -> ReportSection:
    """The section of a run: `number` counts from 1; 0 for the only one."""
    log, scenario, result = run.log, run.scenario, found.result
    name, path = run_name(log.path), log.path.resolve()
    facts = scenario_facts(scenario) if scenario is not None else []
    # The log holds simulated time only, so that it is the same each time.
    begun = begun_at(name)
    facts += [
        ("begun", f"{begun:%Y-%m-%d %H:%M:%S} UTC" if begun else "unknown: the name of the run does not say when"),
        ("log", f"{path}, {path.stat().st_size / 1e6:.1f} MB"),
        ("digest", found.digest),
    ]
    if number and run.label != name:
        facts.append(("in tables and pictures of several runs", run.label))
    faults = [(fault.id, f"{fault.begin:g}", f"{fault.end:g}", fault.what) for fault in log.faults]
    events = vehicle_events((event.what, event.begin) for event in log.events)
    first, pictures = _pictures(kinds, [run], view, share, [] if number else telling(run))
    return ReportSection(
        anchor=f"run-{number}",
        name=name,
        missing=log.missing,
        end=f"{log.end:g}",
        title=scenario.title if scenario is not None else "",
        facts=Table((), facts),
        network=Table((), network_facts(scenario) if scenario is not None else ()),
        conditions=conditions_table(scenario) if scenario is not None else Table((), ()),
        conditions_note=conditions_note(scenario) if scenario is not None else "",
        no_verdicts=found.why_none,
        status=None if result is None else Mark(result.passed, result.words),
        reason="" if result is None else result.reason,
        first=first,
        checks=checks_table([] if result is None else result.checks),
        faults=Table(("fault", "from [s]", "to [s]", "what"), faults),
        events=Table(("event", "times", "first at [s]"), [(e.what, e.times, f"{e.first_s:.10g}") for e in events]),
        tables=_tables(run, result),
        pictures=pictures,
        place=shlex.quote(str(path.parent if path.name == "run.mcap" else path)),
        metadata=Table((), sorted(log.run.items())),
        scenario_text=log.scenario_text,
    )


def _result(run: Run) -> RunResult:
    of_log = run.digest
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


def _tables(run: Run, result: Result | None) -> list[tuple[str, Table]]:
    """Tables of vehicles and of links, each with its heading."""
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


def _from_log(run: Run) -> tuple[dict[str, Account], dict[str, LinkAge]]:
    """Ledger and ages as a result has them, from the packets whose fate the log holds."""
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
    kinds: Sequence[str], runs: Sequence[Run], view: View, share: Tell, first: Sequence[str] = ()
) -> tuple[PageImage | None, SectionImages]:
    """The first picture of those names that is drawn, and all others."""
    drawn, missing = dict[str, PageImage](), []
    for name, title, figure in draw(kinds, runs, view, share):
        if isinstance(figure, str):
            missing.append(f"{name}: {figure}")
        else:
            drawn[name] = PageImage(title, png(figure))
    top = next((drawn.pop(name) for name in first if name in drawn), None)
    return top, SectionImages(list(drawn.values()), missing + [note for run in runs for note in run.notes])
