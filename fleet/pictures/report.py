"""`fleet report`: one self-contained HTML page about one run or some; everything that is shown is in the file."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from fleet.errors import FleetError
from fleet.logs.reader import Tell, digest
from fleet.logs.result_file import ResultError, read_result
from fleet.pictures.gallery import PER_RUN, WHAT, draw
from fleet.pictures.report_tables import links_table, mark, number, side_by_side, table
from fleet.pictures.runs import Look, Run
from fleet.pictures.style import DPI
from fleet.pictures.whole_file import whole_file
from netem.ages import Ages
from netem.causes import Cause
from netem.wire.messages import Fate

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 66rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; } h3 { margin-top: 1.8rem; }
table { border-collapse: collapse; font-size: 0.87rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.2rem 0.7rem; text-align: right; border-bottom: 1px solid #e4e4e4; vertical-align: top; }
th { font-weight: 600; } th:first-child, td:first-child { text-align: left; white-space: nowrap; }
table.words th, table.words td, table.last td:last-child, table.last th:last-child { text-align: left; }
.scroll { overflow-x: auto; }
.fail, .pass { font-weight: 600; white-space: nowrap; } .fail { color: #b23c00; } .pass { color: #00694c; }
.warn { border-left: 4px solid #D55E00; padding: 0.4rem 0.8rem; background: #fdf3ec; }
figure { display: inline-block; margin: 0.5rem 1rem 1rem 0; vertical-align: top; }
figcaption { font-size: 0.87rem; max-width: 27rem; } img { width: 27rem; max-width: 100%; height: auto; }
pre { background: #f6f6f6; padding: 0.7rem; overflow-x: auto; font-size: 0.82rem; } summary { cursor: pointer; }
"""


class ReportError(FleetError):
    """The report cannot be written."""


@dataclass(slots=True)
class Verdict:
    """What result.json says of a run, if it is there and of this log."""

    values: dict[str, Any] | None
    word: str  # why there is none
    digest: str


def write(path: Path, runs: Sequence[Run], look: Look, share: Tell = lambda _: None) -> None:
    """Write the page; `share` is told the share that is done of what is at hand: a log's digest, or pictures.

    Raises:
        ReportError: the place cannot be written.
        LogReadError: a log has gone meanwhile.
    """
    try:
        with whole_file(path) as part:
            part.open("a").close()  # before the pictures, which take a while
            part.write_text(page(runs, look, share), "utf-8")
    except OSError as error:
        raise ReportError(f"cannot write {path}: {error.strerror}; choose another place with -o FILE") from error


def page(runs: Sequence[Run], look: Look, share: Tell = lambda _: None) -> str:
    """The whole page."""
    title = "uuv-fleet: " + ", ".join(run.label for run in runs)
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<style>{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
        f"<p>Made by <code>fleet report</code>, uuv-fleet {escape(version('uuv-fleet'))}. Times are simulated "
        "time; positions are north, east, down.</p>",
    ]
    verdicts = [_verdict(run, share) for run in runs]
    if len(runs) > 1:
        parts += [
            "<h2>The runs together</h2>",
            side_by_side(runs, [verdict.values for verdict in verdicts]),
            *_pictures([k for k in WHAT if k not in PER_RUN], runs, look, share),
        ]
    for run, verdict in zip(runs, verdicts, strict=True):
        kinds = list(WHAT) if len(runs) == 1 else sorted(PER_RUN)
        parts += _run(run, verdict, kinds, look, share)
    return "\n".join([*parts, "</body></html>", ""])


def _run(run: Run, verdict: Verdict, kinds: Sequence[str], look: Look, share: Tell) -> Iterator[str]:
    log = run.log
    yield f"<h2>{escape(run.label)}</h2>"
    if log.missing:
        yield f'<p class="warn">The log is not whole: {escape(log.missing)}. It ends at {log.end:g} s.</p>'
    scenario = run.scenario
    if scenario is not None:
        yield f"<p>{escape(scenario.title)}</p>" if scenario.title else ""
        facts: list[Sequence[Any]] = [
            ("vehicles", f"{scenario.vehicles}, {len(scenario.graph.links)} directed links"),
            ("duration", f"{scenario.duration_ns / 1e9:g} s in ticks of {scenario.tick_ns / 1e6:g} ms"),
            ("network", _network(run)),
            ("seed", scenario.seed),
        ]
    else:
        facts = []
    facts += [("log", f"{log.path}, {log.path.stat().st_size / 1e6:.1f} MB"), ("digest", verdict.digest)]
    yield table((), facts, "words")
    yield from _verdicts(verdict)
    if log.faults:
        yield "<h3>Faults</h3>"
        yield table(
            ("fault", "from [s]", "to [s]", "what"),
            ((f.id, f"{f.begin:g}", f"{f.end:g}", f.what) for f in log.faults),
            "last",
        )
    yield from _tables(run, verdict)
    yield from _pictures(kinds, [run], look, share)
    yield from _again(run)


def _network(run: Run) -> str:
    assert run.scenario is not None
    if run.scenario.ideal:
        return "ideal, without latency"
    acoustic = run.scenario.acoustic is not None
    period = run.scenario.round_ticks * run.scenario.tick_ns / 1e6
    return f"{'acoustic channel, ' if acoustic else ''}a round every {period:g} ms"


def _verdict(run: Run, share: Tell) -> Verdict:
    found = digest(run.log.path, share)
    try:
        values = read_result(run.log.path)
    except FileNotFoundError:
        return Verdict(None, "There is no result.json beside this log, so there are no verdicts.", found)
    except ResultError as error:
        return Verdict(None, f"{error}; so there are no verdicts.", found)
    if values["digest"] != found:
        return Verdict(None, "The result.json beside this log is of another log, so its verdicts are left out.", found)
    return Verdict(values, "", found)


def _verdicts(verdict: Verdict) -> Iterator[str]:
    yield "<h3>Verdicts</h3>"
    if verdict.values is None:
        yield f'<p class="warn">{escape(verdict.word)}</p>'
        return
    values = verdict.values
    status = values["status"]
    yield f"<p>Status: {mark(status == 'pass', status.replace('_', ' '))} {escape(values['reason'])}</p>"
    rows = [
        (check["check"], mark(check["passed"], "pass" if check["passed"] else "FAIL"), check["asked"], check["found"])
        for check in values["checks"]
    ]
    if rows:
        yield table(("check", "verdict", "asked", "found"), rows, "words")
    else:
        yield "<p>No check was judged.</p>"


def _tables(run: Run, verdict: Verdict) -> Iterator[str]:
    values = verdict.values
    if values and values["vehicles"]:
        yield "<h3>Vehicles</h3>"
        headings = {
            "settle_10pct_s": "settle to 10 % [s]", "settle_5cm_s": "settle to 5 cm [s]",
            "e_rms_m": "RMS e, last 10 s [m]", "formation_final_m": "final formation error [m]",
            "effort_Ns": "surge effort [N s]", "u_cmd_max_mps": "max u_cmd [m/s]", "qp_failures": "QP failures",
            "payloads_rejected": "payloads rejected",
        }  # fmt: skip
        rows = ((i, *(number(key, row[key]) for key in headings)) for i, row in values["vehicles"].items())
        yield table(("UUV", *headings.values()), rows)
    elif any(f"uuv/{i}/error" in run.log for i in run.log.vehicles):
        yield "<h3>Vehicles at the end of the log</h3>"
        final = ((i, run.log[f"uuv/{i}/error"]) for i in run.log.vehicles if f"uuv/{i}/error" in run.log)
        final = ((i, e) for i, e in final if not e.too_many)
        rows_ = ((i, f"{e['e_norm'][-1]:.4f}", f"{e['formation_norm'][-1]:.4f}") for i, e in final if len(e))
        yield table(("UUV", "consensus error [m]", "formation error [m]"), rows_)
    ledger, ages, where = (values["ledger"], values["ages"], "") if values else (*_from_log(run), ", from the log")
    if any(account["sent"] for account in ledger.values()):
        yield f"<h3>Packets per directed link, and age of what was heard last{where}</h3>"
        yield links_table(ledger, ages)


def _from_log(run: Run) -> tuple[dict[str, Any], dict[str, Any]]:
    """Ledger and ages as a result has them, from the packets whose fate the log holds."""
    ledger: dict[str, Any] = {}
    ages = Ages(run.log.links)
    tick_s = int(run.log.run.get("tick_ns", 0)) / 1e9
    ticks = round(run.log.end / tick_s) + 1 if tick_s else 0
    for src, dst in run.log.links:
        packets = run.log[f"link/{src}-{dst}"]
        if not len(packets) or packets.too_many:
            continue
        fates = Counter(packets["fate"].tolist())
        ledger[f"{src}->{dst}"] = {
            "sent": int((packets["copy"] == 0).sum()),
            "duplicated": int((packets["copy"] > 0).sum()),
            "delivered": fates[Cause.DELIVERED],
            "in_flight": fates[Cause.IN_FLIGHT],
            "corrupted": int(packets["corrupted"].sum()),
            "lost": {cause: count for cause, count in fates.items() if cause not in (Cause.DELIVERED, Cause.IN_FLIGHT)},
        }
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
    return ledger, ages.summary(round(tick_s * 1e9)) if tick_s else {}


def _pictures(kinds: Sequence[str], runs: Sequence[Run], look: Look, share: Tell) -> Iterator[str]:
    yield "<h3>Pictures</h3>"
    missing = []
    for name, title, figure in draw(kinds, runs, look, share):
        if isinstance(figure, str):
            missing.append(f"{name}: {figure}")
        else:
            yield (
                f'<figure><img alt="{escape(title)}" src="data:image/png;base64,{_png(figure)}">'
                f"<figcaption>{escape(title)}</figcaption></figure>"
            )
    notes = [note for run in runs for note in run.notes]
    if missing or notes:
        yield "<p>Not drawn: " + escape("; ".join([*missing, *notes])) + "</p>"


def _png(figure: Figure) -> str:
    file = BytesIO()
    figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return base64.b64encode(file.getvalue()).decode("ascii")


def _again(run: Run) -> Iterator[str]:
    yield "<h3>How to repeat it</h3>"
    yield (
        "<p>The log holds the merged scenario; with the faults that were injected while it ran it is what "
        "<code>fleet script</code> prints. The same scenario and the same versions give the same digest.</p>"
    )
    place = run.log.path.parent if run.log.path.name == "run.mcap" else run.log.path
    yield f"<pre>fleet script {escape(str(place))} &gt; again.yaml\nfleet run again.yaml</pre>"
    yield table((), sorted(run.log.run.items()), "words")
    text = run.log.scenario_text
    if text:
        yield f"<details><summary>scenario.yaml</summary><pre>{escape(text)}</pre></details>"
