"""The commands that prove a log right or make it usable: verify, check-log, diff, script, recover."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from fleet.cli.documents.output import json_option, print_document
from fleet.cli.log_argument import log_argument, newest_log
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import NO_PROGRESS
from fleet.terminal.table import say
from world.plugins.trust import Trust

_VERIFY = "Exit status: 0 reproduced, 1 not, 2 no log of ours or it cannot be run here, 3 no message is left in it."
_CHECK_LOG = "Exit status: 0 every check passes, 1 one does not, 2 no log of ours, or a check makes no sense."
_DIFF = "Exit status: 0 the same (or within the tolerance), 1 different, 2 one of them is no log."
_RECOVER = "Exit status: 0 whole, 1 nothing can be recovered, 2 usage, 3 something is lost."
_log = click.Path(path_type=Path)


@click.command(cls=TrustingCommand, epilog=_VERIFY)
@log_argument
@trust_option
@json_option
@NO_PROGRESS
def verify(log: Path, trust: Trust, as_json: bool, quiet: bool) -> None:
    """Run LOG again and compare: every message, bit for bit.

    It repeats the log's scenario and seed with all injected faults and deaths, in this process, up to the end of the
    log. A log that was cut is verified up to the cut.

    \b
    Examples:
      fleet verify
    """
    from fleet.repeat.verify import verification_lines
    from fleet.repeat.verify import verify as check
    from fleet.terminal.status_line import showing, showing_time

    with (
        showing(f"reading {log}", quiet=quiet) as reading,
        showing_time("verified", quiet=quiet) as tell,
    ):
        found = check(log, tell, trust, reading)
    if as_json:
        from fleet.cli.documents.logs import verified

        print_document(verified(found))
    else:
        say("\n".join(verification_lines(found)))
    sys.exit(0 if found.reproduced else 1)


@click.command(cls=TrustingCommand, epilog=_CHECK_LOG)
@log_argument
@click.option("--set", "overrides", metavar="checks=...", multiple=True,
              help="Other checks than those of the run, as in a scenario; repeatable.")  # fmt: skip
@trust_option
@json_option
@NO_PROGRESS
def check_log(log: Path, overrides: tuple[str, ...], trust: Trust, as_json: bool, quiet: bool) -> None:
    """Judge LOG by your own checks, on signals and in Python, without running it again.

    Those of its scenario, or others. A log that was cut is judged up to where it is whole. Checks of other kinds,
    such as formation_error, are judged by the run.

    \b
    Examples:
      fleet check-log --set 'checks={signal: {topic: state.z, below: 30 m}}'
      fleet check-log runs/latest --set 'checks={"my_checks:OneLeader": {grace: 2 s}}'
    """
    from fleet.repeat.check_log import check_log as check
    from fleet.terminal.status_line import showing

    with showing(f"reading {log}", quiet=quiet) as reading:
        found = check(log, overrides, trust, reading)
    if as_json:
        from fleet.cli.documents.logs import judged

        print_document(judged(found))
    else:
        for verdict in sorted(found.verdicts, key=lambda verdict: verdict.passed):  # failed ones on top
            say(f"{'pass' if verdict.passed else 'FAIL'}  {verdict.check}: {verdict.asked}; found {verdict.words}")
        how_far = f"judged up to t = {found.until_s:g} s of {found.end_s:g} s"
        say(f"{how_far}, as far as the file goes: {found.missing}" if found.missing else how_far)
    sys.exit(0 if found.passed else 1)


@click.command(epilog=_DIFF)
@click.argument("a", type=_log, help="An MCAP file or a run directory.")
@click.argument("b", type=_log, required=False, help="By default the newest run below runs.")
@click.option("--tolerance", metavar="X", type=click.FloatRange(min=0.0), default=0.0, show_default=True,
              help="The largest allowed difference of two numbers, each in its own unit.")  # fmt: skip
@click.option("--all", "everything", is_flag=True, help="Every signal that differs, not only the first twenty.")
@json_option
@NO_PROGRESS
def diff(a: Path, b: Path | None, tolerance: float, everything: bool, as_json: bool, quiet: bool) -> None:
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
    from fleet.terminal.status_line import showing

    second = newest_log() if b is None else b
    if b is None and log_path(a).exists() and log_path(a).samefile(log_path(second)):
        raise click.UsageError("A is the newest run itself: name the log to compare it with")
    with showing(f"comparing {a} and {second}", quiet=quiet) as tell:
        left, right = LogReader(log_path(a), tell), LogReader(log_path(second))
        found = compare(left, right)
    status = 0 if found.first is None or (tolerance and found.within(tolerance)) else 1
    if as_json:
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
        say(f"they part at {found.first}")
        say("\n".join(deviation_lines(found, None if everything else 20)))
    for other in besides_messages(left, right):
        say(f"besides, not the same: {other}")
    if found.first is not None and tolerance:
        say(f"{'within' if found.within(tolerance) else 'NOT within'} the tolerance of {tolerance:g}")
    sys.exit(status)


@click.command()
@log_argument
def script(log: Path) -> None:
    """Print the scenario that runs LOG again, with everything that was injected while it was made.

    \b
    Examples:
      fleet script > again.yaml && fleet run again.yaml
    """
    from fleet.repeat.recorded_run import script as make
    from fleet.terminal.status_line import showing

    with showing(f"reading {log}") as tell:
        made = make(log, tell)
    click.echo(made.to_yaml(), nl=False)


@click.command(epilog=_RECOVER)
@log_argument
@click.option(
    "-o", "--out", metavar="OUT", type=_log, help="The file to write; by default LOG.recovered.mcap next to it."
)
def recover(log: Path, out: Path | None) -> None:
    """Write the undamaged part of a cut or damaged LOG as a clean file with an index.

    Its metadata record `recovery` describes the missing parts. Damaged places are skipped and counted. The bag of a
    killed fleet record --ros2 becomes a new bag, BAG.recovered.

    \b
    Examples:
      fleet recover
      fleet recover cut.mcap -o clean.mcap
      fleet recover bag                   a bag whose recorder was killed
    """
    from fleet.logs.recover import recover as write
    from fleet.logs.recover import recovery_text
    from fleet.ros2.bag import bag_file, repair
    from fleet.terminal.status_line import showing

    with showing(f"recovering {log}") as tell:
        found = write(log, out, tell) if bag_file(log) is None else repair(log, out, tell)
    say(recovery_text(found), err=found.nothing)
    sys.exit(1 if found.nothing else 3 if found.lost else 0)


COMMANDS = (verify, check_log, diff, script, recover)
