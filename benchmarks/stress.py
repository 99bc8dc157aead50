"""Large fleets, and what a participant with a login could do to a run: `python benchmarks/stress.py`.

Every run is compared with the same scenario in one process: whatever is done to it, the bytes are the same, or it did
not pass.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import click
from msgspec import Meta, Struct
from rich.table import Table
from soak import Soak, result_of

from agents.join_file import JoinFile
from fleet.cli.types import numbers
from fleet.terminal.width import stdout
from netem.errors import BusError
from netem.wire.bus import Bus
from netem.wire.codec import encode
from netem.wire.keys import Keys
from netem.wire.messages import PROTOCOL_VERSION, Hello, Note

READY_S = 60.0
CHECKS = "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived}"
FLOODED = 3  # the vehicle whose agent goes mad


class StressRow(Struct, frozen=True):
    """One thing that was tried."""

    tried: Annotated[str, Meta(description="What was tried.")]
    status: Annotated[str, Meta(description="As in result.json, with the reason if there is one.")]
    same_bytes: Annotated[bool, Meta(description="Whether the log has the same bytes as the undisturbed run.")]
    wall_s: Annotated[float, Meta(description="How long the run took after its start [s].")]
    alone_s: Annotated[float, Meta(description="The same run with nothing done to it [s]; 0: that is what this is.")]
    seen: Annotated[str, Meta(description="What was seen, in words.")]


def measure_stress(sizes: Sequence[int], suspend_s: float, say: Callable[[str], None]) -> list[StressRow]:
    """Try everything; fleets of these sizes first."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-stress-") as name:
        folder = Path(name)
        for n in sizes:
            say(f"{n} agents")
            arguments = ["paper", *_sets(f"vehicles={n}", "duration=1 s", CHECKS)]
            rows.append(_row(folder, f"{n} agents, 1 s", arguments, None))
        # Who waits for whom: a console that takes nothing, a world that cannot put, an agent that fills its queue.
        n, (what, *_) = min(sizes), FLOODS
        title = f"{n} agents, one floods: {what}; console suspended {suspend_s:g} s"
        say(title)
        both = _sets(f"vehicles={n}", "duration=3 s", "stall_timeout=120 s", CHECKS)
        rows.append(_row(folder, title, ["paper", *both], _Flood(what, suspend_s), more=_external()))
        arguments = ["paper", *_sets("duration=20 s", CHECKS)]
        alone = _run(folder, "alone", arguments, None)[1]
        say("floods")
        for what in FLOODS:
            title = f"agent {FLOODED} floods: {what}"
            rows.append(_row(folder, title, arguments, _Flood(what), alone, more=_external()))
        say(f"console suspended for {suspend_s:g} s")
        rows.append(_row(folder, f"console suspended {suspend_s:g} s", arguments, _Suspension(suspend_s), alone))
        say("a reader that never reads")
        published = ["paper", *_sets("duration=60 s", CHECKS), "--publish"]
        alone = _run(folder, "alone", published, None)[1]
        waiting = ["--wait-for-subscribers"]
        rows.append(_row(folder, "--publish, a reader that never reads", published, _Reader(), alone, waiting))
    return rows


class _Flood:
    """An agent that does its work, and a second session with its login that puts as fast as it can.

    Meanwhile the console may be suspended for some seconds.
    """

    def __init__(self, what: str, suspend_s: float = 0.0) -> None:
        self._what, self._suspension = what, _Suspension(suspend_s)
        self._puts = 0

    def __call__(self, soak: Soak, folder: Path) -> str:
        path = _wait_for(soak, folder, f"join-{FLOODED}.json")
        if not path.exists():
            return "the run did not wait for it"
        with _process(["agent", "--join", str(path)]):
            joining = JoinFile.read(path)
            keys = Keys(joining.run)
            with suppress(BusError):
                bus = Bus.connect(joining.endpoint, joining.credentials)
                puts = [(bus.publisher(key), data) for key, data in FLOODS[self._what](keys)]
                suspending = threading.Thread(target=self._suspension, args=(soak, folder))
                suspending.start()
                while soak.running:
                    for _ in range(200):
                        for put, data in puts:
                            put(data)
                            self._puts += 1
                suspending.join()
                bus.close()
            while soak.running:
                time.sleep(0.05)
        dropped = sum(result_of(folder).get("rejected", {}).values())
        return f"{self._puts} puts, {dropped} came through and were refused"


class _Suspension:
    """The console is stopped for a while, and goes on."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def __call__(self, soak: Soak, folder: Path) -> str:
        if not self._seconds:
            return ""
        _wait_for(soak, folder, "connection.json")
        time.sleep(1.0)
        os.kill(soak.pid, signal.SIGSTOP)
        time.sleep(self._seconds)
        os.kill(soak.pid, signal.SIGCONT)
        return ""


class _Reader:
    """Somebody subscribes to the whole journal and is then stopped."""

    def __call__(self, soak: Soak, folder: Path) -> str:
        path = _wait_for(soak, folder, "observe.json")
        with _process(["record", "--run", str(path.parent), "-o", str(folder / "x.mcap"), "-q"]) as reader:
            _wait_for(soak, folder, "connection.json")
            time.sleep(1.0)
            reader.send_signal(signal.SIGSTOP)
            while soak.running:
                time.sleep(0.05)
        return ""  # what zenoh drops for such a reader, it does not count


FLOODS: dict[str, Callable[[Keys], list[tuple[str, bytes]]]] = {
    "garbage on each of its keys": lambda keys: [
        (key, b"\xc1" * 1000) for key in (keys.cmd(FLOODED), keys.tx(FLOODED), keys.note(f"agent-{FLOODED}"))
    ],
    "probes to world and netem": lambda keys: [
        (key, encode(Hello("agent", FLOODED, 0, PROTOCOL_VERSION, False)))
        for key in (keys.cmd(FLOODED), keys.tx(FLOODED))
    ],
    "notes": lambda keys: [(keys.note(f"agent-{FLOODED}"), encode(Note(f"agent-{FLOODED}", FLOODED, 0, "mad " * 100)))],
}


def _row(
    folder: Path,
    tried: str,
    arguments: list[str],
    abuse: Callable[[Soak, Path], str] | None,
    alone_s: float = 0.0,
    more: Sequence[str] = (),
) -> StressRow:
    here = [argument for argument in arguments if argument != "--publish"]
    same, _, _ = _run(folder, "same", [*here, "--in-process"], None)
    found, wall_s, seen = _run(folder, "abused", [*arguments, *more], abuse)
    if not seen:
        wall = found.get("wall", {})
        seen = f"ready in {wall.get('startup_s', 0):.1f} s, {100 * wall.get('x_real_time', 0):.0f} ticks/s"
    reason = f" {found['reason']}" if found.get("reason") else ""
    status = f"{found.get('status', 'no result')}{reason}"
    return StressRow(tried, status, found.get("digest") == same.get("digest"), wall_s, alone_s, seen)


def _run(
    folder: Path, name: str, arguments: list[str], abuse: Callable[[Soak, Path], str] | None
) -> tuple[dict[str, Any], float, str]:
    """(result, wall time without the start, what was seen)."""
    soak = Soak(name, arguments, folder)
    try:
        seen = "" if abuse is None else abuse(soak, folder / name)
        while soak.running:
            time.sleep(0.05)
    finally:
        soak.stop()
    values = result_of(folder / name)
    return values, float(values.get("wall", {}).get("run_s", 0.0)), seen


def _wait_for(soak: Soak, folder: Path, name: str) -> Path:
    path = folder / "latest" / name
    deadline = time.monotonic() + READY_S
    while soak.running and not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    return path


@contextmanager
def _process(arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    quiet = subprocess.DEVNULL
    command = [sys.executable, "-P", "-m", "fleet", *arguments]
    process = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _external() -> list[str]:
    return _sets(f"per_vehicle={{{FLOODED}: {{external: true}}}}")


def _sets(*overrides: str) -> list[str]:
    return [word for override in overrides for word in ("--set", override)]


def stress_failures(rows: Sequence[StressRow]) -> list[str]:
    """What is wrong with the rows; nothing, if all was withstood."""
    wrong = [f"{row.tried}: {row.status}" for row in rows if row.status != "pass"]
    return wrong + [f"{row.tried}: other bytes" for row in rows if row.status == "pass" and not row.same_bytes]


def stress_table(rows: Sequence[StressRow]) -> Table:
    """The rows for a terminal."""
    shown = Table(title="load and abuse", title_justify="left", box=None, pad_edge=False)
    for heading in ("tried", "status", "same bytes", "run", "left alone", "seen"):
        shown.add_column(heading, justify="left" if heading in ("tried", "status", "seen") else "right")
    for row in rows:
        alone = f"{row.alone_s:.1f} s" if row.alone_s else "-"
        same = "yes" if row.same_bytes else "no"
        shown.add_row(row.tried, row.status, same, f"{row.wall_s:.1f} s", alone, row.seen)
    return shown


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--agents", metavar="N,N,...", type=numbers(1, 1000, "4,20,100", whole=True), default="100,300",
              show_default=True, help="Fleet sizes.")  # fmt: skip
@click.option("--suspend", metavar="SECONDS", type=click.FloatRange(0.1, 3600.0), default=30.0, show_default=True,
              help="How long the console is stopped.")  # fmt: skip
def main(agents: list[int], suspend: float) -> None:
    """Try large fleets, floods by an agent, a stopped console and a reader that never reads.

    The exit status is 1 if a run did not withstand it.

    \b
    Examples:
      python benchmarks/stress.py
      python benchmarks/stress.py --agents 20 --suspend 1
    """
    rows = measure_stress(agents, suspend, partial(click.echo, err=True))
    stdout().print(stress_table(rows))
    failures = stress_failures(rows)
    for line in failures:
        click.echo(f"FAIL  {line}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
