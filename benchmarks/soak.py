"""A long run under random faults, watched from outside: `python benchmarks/soak.py`.

A fault every five seconds, kills with restarts among them. The same run twice in one process, side by side, and once
distributed: memory, ledger, digests, and processes that are left at its end.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import click
import psutil
from msgspec import Meta, Struct
from rich.console import Console as Terminal

from fleet.terminal.table import columns, show
from fleet.terminal.width import stdout

SAMPLE_S = 0.5
WARM = 0.25  # share of the run after which memory is compared with the end
TELL_S = 30.0
END_S = 5.0  # for a run that is to end before its time
_DEAD = (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)


class SoakRow(Struct, frozen=True):
    """One run of the soak."""

    run: Annotated[str, Meta(description="Which one: in-process, again, distributed, or the same in-process.")]
    simulated_s: Annotated[float, Meta(description="Simulated time [s].")]
    wall_s: Annotated[float, Meta(description="How long it took [s].")]
    status: Annotated[str, Meta(description="As in result.json.")]
    reason: Annotated[str, Meta(description="Why it broke; empty: it did not.")]
    restarts: Annotated[int, Meta(description="Agents that were killed and started again.")]
    ledger: Annotated[str, Meta(description="balanced, or what is wrong with it.")]
    warm_mb: Annotated[float, Meta(description="Memory of all its processes after a quarter of the run [MB].")]
    end_mb: Annotated[float, Meta(description="The same at its end: median of the last tenth [MB].")]
    orphans: Annotated[int, Meta(description="Processes that it left.")]
    digest: Annotated[str, Meta(description="SHA-256 of its messages, in hexadecimal.")]


class Soak:
    """One `fleet run` in a session of its own, whose memory is sampled while it lives."""

    def __init__(self, name: str, arguments: list[str], folder: Path) -> None:
        self.name, self._folder = name, folder
        self._began = time.monotonic()
        self._samples: list[tuple[float, float]] = []  # when [s], and the memory of all its processes [MB]
        self._output = (folder / f"{name}.txt").open("wb")
        command = [sys.executable, "-P", "-m", "fleet", "run", *arguments, "-q", "--out", str(folder / name)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=self._output, stderr=subprocess.STDOUT, start_new_session=True
        )

    @property
    def running(self) -> bool:
        """Whether it still runs; takes a sample of its memory."""
        if self._process.poll() is not None:
            return False
        self._samples.append((time.monotonic(), sum(map(pss_mb, of_session(self._process.pid)))))
        return True

    @property
    def pid(self) -> int:
        return self._process.pid

    def stop(self) -> None:
        """End it, so that it removes what it made outside of its directory; kill its processes that are left."""
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        for pid in of_session(self._process.pid):
            with suppress(ProcessLookupError):
                os.kill(pid, 9)
        self._process.kill()  # not by its number, which may be another's once it has been waited for
        self._process.wait()
        self._output.close()

    def row(self) -> SoakRow:
        """Its figures, once it has ended."""
        wall_s = time.monotonic() - self._began
        left = of_session(self._process.pid)
        self.stop()
        values = result_of(self._folder / self.name)
        said = (self._folder / f"{self.name}.txt").read_text("utf-8", "replace").strip()
        unbalanced = [c["found"] for c in values.get("checks", ()) if c["check"] == "ledger" and not c["passed"]]
        ran_s = float(values.get("wall", {}).get("run_s", 0.0))  # without the start, in which memory grows
        warm, late = warm_and_late(self._samples, ran_s)
        return SoakRow(
            self.name,
            float(values.get("sim_s", 0.0)),
            wall_s,
            str(values.get("status", "no result")),
            str(values.get("reason", "")) or (said if not values else ""),
            sum(f["action"] == "ends" and f["what"].startswith("kill") for f in values.get("faults", ())),
            ", ".join(unbalanced) or ("balanced" if values else "unknown"),
            warm,
            late,
            len(left),
            str(values.get("digest", "")),
        )


def warm_and_late(samples: Sequence[tuple[float, float]], ran_s: float) -> tuple[float, float]:
    """The memory after a quarter of a run, and the median of its last tenth.

    Args:
        samples: when [s], and how much; the last one at the end of the run.
        ran_s: how long the run took after its start [s].
    """
    if not samples:
        return 0.0, 0.0
    warm_s = samples[-1][0] - (1.0 - WARM) * ran_s
    late = sorted(size for _, size in samples[-max(1, len(samples) // 10) :])
    return next(size for at_s, size in samples if at_s >= warm_s), late[len(late) // 2]


def measure_soak(vehicles: int, seconds: float, distributed_s: float, say: Callable[[str], None]) -> list[SoakRow]:
    """The soak: `seconds` of simulated time twice in one process, `distributed_s` distributed and once in one."""
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-soak-") as name:
        folder = Path(name)
        long, short = _arguments(vehicles, seconds), _arguments(vehicles, distributed_s)
        rows = _together([("in-process", [*long, "--in-process"]), ("again", [*long, "--in-process"])], folder, say)
        rows += _together([("distributed", short)], folder, say)
        if seconds != distributed_s:
            rows += _together([("the same in-process", [*short, "--in-process"])], folder, say)
        return rows


def soak_failures(rows: list[SoakRow]) -> list[str]:
    """What is wrong with the rows; nothing, if the soak passed."""
    wrong = []
    for row in rows:
        if row.status != "pass":
            wrong.append(f"{row.run}: {row.status} {row.reason}")
        if row.ledger != "balanced":
            wrong.append(f"{row.run}: ledger {row.ledger}")
        if row.orphans:
            wrong.append(f"{row.run}: {row.orphans} processes were left")
    by_length: dict[float, set[str]] = {}
    for row in rows:
        by_length.setdefault(row.simulated_s, set()).add(row.digest)
    wrong += [f"runs of {length:g} s differ: {sorted(found)}" for length, found in by_length.items() if len(found) > 1]
    return wrong


def show_soak(rows: list[SoakRow], terminal: Terminal) -> None:
    """Print the rows as a table."""
    headings = {
        "run": 0, "simulated": 1, "wall": 3, "status": 0, "restarts": 2, "ledger": 0, "MB after\n1/4": 0,
        "MB at\nend": 0, "orphans": 0, "digest": 4,
    }  # fmt: skip
    cells = [
        (
            row.run,
            f"{row.simulated_s:g} s",
            f"{row.wall_s:.0f} s",
            row.status,
            str(row.restarts),
            row.ledger,
            f"{row.warm_mb:.0f}",
            f"{row.end_mb:.0f}",
            str(row.orphans),
            row.digest[:16],
        )
        for row in rows
    ]
    show(columns(headings, cells), "soak: a random fault every 5 s", terminal, "a wider terminal has all")


def _arguments(vehicles: int, seconds: float) -> list[str]:
    return [
        "nemesis",
        *("--set", f"vehicles={vehicles}"),
        *("--set", f"duration={seconds} s"),
        *("--set", f"nemesis={{every: 5 s, for: 4 s, until: {seconds - 5} s, pick: {PICK}}}"),
        *("--set", "log={every: 100 ticks}"),
        *("--set", "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived}"),
    ]


PICK = "[partition, down, deaf, pause, kill, kill, {link *: loss 60% delay 300ms}]"


def _together(what: list[tuple[str, list[str]]], folder: Path, say: Callable[[str], None]) -> list[SoakRow]:
    soaks = [Soak(name, arguments, folder) for name, arguments in what]
    told = began = time.monotonic()
    try:
        while sum(soak.running for soak in soaks):  # every one of them takes its sample
            time.sleep(SAMPLE_S)
            if time.monotonic() - told > TELL_S:
                told = time.monotonic()
                say(f"{', '.join(soak.name for soak in soaks)}: {told - began:.0f} s")
        return [soak.row() for soak in soaks]
    finally:
        for soak in soaks:
            soak.stop()


def result_of(folder: Path) -> dict[str, Any]:
    """The result of the last run in a folder; empty if it left none."""
    path = folder / "latest" / "result.json"
    values: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {}
    return values


def of_session(session: int) -> list[int]:
    """The processes of a session that are not dead."""
    members = []
    for pid in psutil.pids():
        with suppress(ProcessLookupError, psutil.Error):  # it ended meanwhile
            if os.getsid(pid) == session and psutil.Process(pid).status() not in _DEAD:
                members.append(pid)
    return members


def pss_mb(pid: int) -> float:
    """A process's own memory and its part of what it shares (PSS); 0 if it has ended."""
    try:
        return float(psutil.Process(pid).memory_full_info().pss) / 1e6
    except psutil.Error:
        return 0.0


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--vehicles", type=click.IntRange(2, 1000), default=20, show_default=True, help="Fleet size.")
@click.option("--duration", metavar="SECONDS", type=click.FloatRange(30.0, 1e6), default=3600.0, show_default=True,
              help="Simulated, in one process.")  # fmt: skip
@click.option("--distributed", metavar="SECONDS", type=click.FloatRange(30.0, 1e6), default=300.0, show_default=True,
              help="Simulated, distributed.")  # fmt: skip
def main(vehicles: int, duration: float, distributed: float) -> None:
    """Run for long under random faults: is memory flat, the ledger balanced, the digest the same, nobody left?

    The exit status is 1 if it is not.

    \b
    Examples:
      python benchmarks/soak.py
      python benchmarks/soak.py --vehicles 6 --duration 120 --distributed 60
    """
    rows = measure_soak(vehicles, duration, distributed, partial(click.echo, err=True))
    show_soak(rows, stdout())
    failures = soak_failures(rows)
    for line in failures:
        click.echo(f"FAIL  {line}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
