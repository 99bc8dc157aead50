"""The commands that prove, compare or mend a log: verify, diff, recover."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document, print_result
from fleet.cli.log_argument import Log, newest_log
from fleet.cli.types import NoProgress, Trust
from fleet.option import Option
from fleet.terminal.progress import showing, showing_time
from fleet.terminal.width import say

if TYPE_CHECKING:
    pass

_VERIFY = "Exit status: 0 reproduced, 1 not, 2 no log of ours or it cannot be run here, 3 no message is left in it."
_DIFF = "Exit status: 0 the same (or within the tolerance), 1 different, 2 one of them is no log."
_RECOVER = "Exit status: 0 whole, 1 nothing can be recovered, 2 usage, 3 something is lost."


@command(epilog=_VERIFY, document="fleet.repeat.verify.Verification")
def verify(log: Log, *, trust: Trust = False, quiet: NoProgress = False) -> None:
    """Run LOG again and compare: every message, bit for bit.

    It repeats the log's scenario and seed with all injected faults and deaths, in this process, up to the end of the
    log. A log that was cut is verified up to the cut.

    \b
    Examples:
      fleet verify
    """
    from fleet.repeat.verify import verification_lines
    from fleet.repeat.verify import verify as check

    with showing(f"reading {log}") as reading, showing_time("verified") as on_progress:
        found = check(log, on_progress, reading)
    print_result(found, *verification_lines(found))
    sys.exit(0 if found.reproduced else 1)


@command(epilog=_DIFF, document="fleet.cli.documents.logs.Compared")
def diff(
    a: Annotated[Path, Option("An MCAP file, a run directory or a bag of ROS 2.")],
    b: Annotated[Path | None, Option("By default the newest run below runs.")] = None,
    *,
    tolerance: Annotated[float, click.FloatRange(min=0.0), Option(
        "The largest allowed difference of two numbers, each in its own unit.", "X")] = 0.0,
    everything: Annotated[bool, Option(
        "Every signal that differs, not only the first twenty.", flag="--all")] = False,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Compare the messages of logs A and B: whether they are the same, where they part, and how far signals differ.

    If one run continues another (fleet run --from), the comparison begins where the later one begins.

    \b
    Examples:
      fleet diff runs/paper-1-20261121-120000
      fleet diff a.mcap b.mcap --tolerance 1e-9
    """
    from fleet.logs.deviation import compare, deviation_lines
    from fleet.logs.difference import begin_ns, besides_messages
    from fleet.logs.schemas import FROM
    from fleet.mcap.reader import LogReader, log_path

    second = newest_log() if b is None else b
    if b is None and log_path(a).exists() and log_path(a).samefile(log_path(second)):
        raise click.UsageError("A is the newest run itself: name the log to compare it with")
    with showing(f"comparing {a} and {second}") as on_progress:
        left, right = LogReader(log_path(a), on_progress), LogReader(log_path(second))
        found = compare(left, right)
    status = 0 if found.first is None or (tolerance and found.within(tolerance)) else 1
    if json_is_asked():
        from fleet.cli.documents.logs import diff_document

        missing, besides = (left.missing, right.missing), besides_messages(left, right)
        print_document(diff_document((left.path, right.path), missing, found, tolerance, besides))
        sys.exit(status)
    for name, reader in (("a", left), ("b", right)):
        if reader.missing:
            say(f"{name} is NOT WHOLE: {reader.missing}")
    if found.begin_ns:
        name, reader = max(("a", left), ("b", right), key=lambda side: begin_ns(side[1]))
        source = reader.metadata.get("run", {}).get(FROM, "another log")
        say(f"compared from t = {found.begin_ns / 1e9:g} s on, where {name} begins: it goes on from {source}")
    names = [reader.metadata.get("run", {}).get("scenario", "") for reader in (left, right)]
    if names[0] != names[1] and all(names):
        say(f"different scenarios: a is of {names[0]}, b of {names[1]}")
    if found.first is None:
        say(f"the same bit for bit ({found.same} messages)")
    else:
        say(f"they part at {found.first.words}")
        say("\n".join(deviation_lines(found, None if everything else 20)))
    for other in besides_messages(left, right):
        say(f"besides, not the same: {other}")
    if found.first is not None and tolerance:
        say(f"{'within' if found.within(tolerance) else 'NOT within'} the tolerance of {tolerance:g}")
    sys.exit(status)


@command(epilog=_RECOVER)
def recover(
    log: Log,
    *,
    out: Annotated[Path | None, Option(
        "The file to write; by default LOG.recovered.mcap next to it.", "OUT", "-o --out")] = None,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Write the undamaged part of a cut or damaged LOG as a clean file with an index.

    Its metadata record `recovery` describes the missing parts. Damaged places are skipped and counted. The bag of a
    killed fleet record --ros2 becomes a new bag, BAG.recovered.

    \b
    Examples:
      fleet recover
      fleet recover cut.mcap -o clean.mcap
      fleet recover bag                   a bag whose recorder was killed
    """
    from fleet.mcap.other import find_other_data
    from fleet.mcap.recover import recover as write
    from fleet.mcap.recover import recovery_text

    with showing(f"recovering {log}") as on_progress:
        kind = find_other_data(log)
        found = (kind and kind.recover(log, out, on_progress)) or write(log, out, on_progress)
    say(recovery_text(found), err=found.nothing)
    sys.exit(1 if found.nothing else 3 if found.lost else 0)
