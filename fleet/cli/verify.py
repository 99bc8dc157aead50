"""The commands that prove, explain, compare or mend a log: verify, diff, why, whatif, recover."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.addons.studies.verbs.study_options import WorkerOptions
from fleet.cli.changes import Overrides, key_options
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document, print_result
from fleet.cli.log_argument import Log, newest_log
from fleet.cli.types import FILE, NoProgress, Trust, Whole
from fleet.option import Option
from fleet.terminal.status_line import StatusLine, showing, showing_time
from fleet.terminal.table import Piece, say

if TYPE_CHECKING:
    from fleet.addons.studies.explanation.what_if import WhatIf

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

    with showing(f"reading {log}") as reading, showing_time("verified") as tell:
        found = check(log, tell, reading)
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
    from fleet.logs.deviation import begin_ns, besides_messages, compare, deviation_lines
    from fleet.logs.reader import LogReader, log_path
    from fleet.logs.schemas import FROM

    second = newest_log() if b is None else b
    if b is None and log_path(a).exists() and log_path(a).samefile(log_path(second)):
        raise click.UsageError("A is the newest run itself: name the log to compare it with")
    with showing(f"comparing {a} and {second}") as tell:
        left, right = LogReader(log_path(a), tell), LogReader(log_path(second))
        found = compare(left, right)
    status = 0 if found.first is None or (tolerance and found.within(tolerance)) else 1
    if json_is_asked():
        from fleet.cli.documents.logs import compared

        missing, besides = (left.missing, right.missing), besides_messages(left, right)
        print_document(compared((left.path, right.path), missing, found, tolerance, besides))
        sys.exit(status)
    for name, reader in (("a", left), ("b", right)):
        if reader.missing:
            say(f"{name} is NOT WHOLE: {reader.missing}")
    if found.begin_ns:
        name, reader = max(("a", left), ("b", right), key=lambda side: begin_ns(side[1]))
        source = reader.metadata.get("run", {}).get(FROM, "another log")
        say(f"compared from t = {found.begin_ns / 1e9:g} s on, where {name} begins: it goes on from {source}")
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
    from fleet.addons.robots.ros2.bag import bag_file, repair
    from fleet.logs.recover import recover as write
    from fleet.logs.recover import recovery_text

    with showing(f"recovering {log}") as tell:
        found = write(log, out, tell) if bag_file(log) is None else repair(log, out, tell)
    say(recovery_text(found), err=found.nothing)
    sys.exit(1 if found.nothing else 3 if found.lost else 0)


@command(document="fleet.addons.studies.explanation.what_if.OtherCommands")
def whatif(
    log: Log,
    *,
    agent: Annotated[int, Whole(min=1), Option("The number of the vehicle.")],
    controller: Annotated[str | None, Option(
        "Short for --set controller=LAW: a name, or package.module:Class.", "LAW")] = None,
    overrides: Overrides = (),
    trust: Trust = False,
    plot: Annotated[Path | None, Option("Draw both commands into this file (png, svg, pdf).")] = None,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Give another agent the navigation and messages of one in LOG, and compare their commands.

    This is open loop: the vehicle still moves by the recorded commands. Without a change the commands are identical.

    \b
    Examples:
      fleet whatif --agent 3
      fleet whatif --agent 3 --controller bsmc --plot 3.png
      fleet whatif --agent 1 --set 'tracking.k_u=2 1/s' --set profile=hardened
      fleet whatif --agent 2 --controller my_module:MyController
    """
    from fleet.addons.studies.explanation.what_if import what_if

    changes = [*overrides, *key_options(controller=controller)]
    with showing(f"agent {agent}") as tell:
        found = what_if(log, agent, changes, tell)
    if plot is not None:
        from fleet.addons.studies.explanation.what_if import draw
        from fleet.logs.reader import digest, log_path

        draw(found, plot, digest(log_path(log)))
    for note in () if json_is_asked() else found.notes:
        say(f"note  {note}", err=True)
    print_result(found.compared, *what_if_lines(found), *([str(plot)] if plot is not None else []))


def what_if_lines(found: WhatIf) -> list[str]:
    """The comparison in words."""
    shown = found.compared
    if not len(found.t):
        return [f"agent {found.agent} commanded nothing in this log"]
    lines = [
        f"agent {found.agent}: {shown.samples} samples from t = {found.t[0]:g} to {found.t[-1]:g} s, "
        f"{found.heard} messages heard, {found.lives} {'life' if found.lives == 1 else 'lives'}"
    ]
    if found.identical:
        return [*lines, "identical: every command is that of the log, to the last bit"]
    lines.append(f"the commands differ from t = {found.first_s:g} s on")
    lines += [
        f"  {name:<13} at most {c.max:.4g} {c.unit} away (t = {c.at_s:g} s), RMS {c.rms:.4g} {c.unit}"
        for name, c in shown.components.items()
    ]
    return lines


@command(document="fleet.addons.studies.explanation.why.Why")
def why(
    log: Log,
    *,
    check: Annotated[str | None, Option("The check that failed; by default the first one that did.", "NAME")] = None,
    picture: Annotated[Path | None, FILE, Option("Draw it into this file (png, svg, pdf).")] = None,
    budget: Annotated[int, Whole(0, 10_000), Option(
        "Healed runs that are tried; 0: only what the log says.", "RUNS")] = 24,
    how: WorkerOptions,
) -> None:  # fmt: skip
    """Explain why a check failed in LOG: faults, messages that did not arrive, and what each vehicle knew.

    It also finds the point of no return: the last moment from which the run still passes if all faults are healed. For
    that it makes the run again, and then runs that are healed at some moment.

    \b
    Examples:
      fleet why
      fleet why runs/latest --check formation_error --picture why.png
      fleet why runs/latest --budget 0
      fleet why runs/latest --json
    """
    from fleet.addons.studies.explanation.why import Explanation, Question, lines

    if picture is not None:
        from fleet.addons.pictures.style import format_of
        from fleet.addons.studies.explanation.picture import draw

        format_of(picture)
    with how.showing(_pieces) as tell:
        explanation = Explanation(Question(log, check, budget), tell)
        if explanation.searches:
            with how.engine() as engine:
                found = explanation.find(engine, engine.carry(explanation.modules))
        else:
            found = explanation.without_runs()
    if picture is not None:
        draw(found, explanation.path, explanation.scenario, picture)
    print_result(found, *lines(found), *([str(picture)] if picture is not None else []))


def _pieces(line: StatusLine, doing: str, runs: int) -> list[Piece]:
    from fleet.addons.studies.explanation.no_return import RUNS

    return [Piece(0, [doing]), Piece(1, [f"{runs} runs" if doing == RUNS else ""])]


COMMANDS = (verify, diff, recover, whatif, why)
