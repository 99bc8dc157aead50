"""Lets one system call after another fail: `python benchmarks/failing_calls.py`. Needs gcc and Linux.

Each command is run again and again, and each time the next `open`, `write`, `rename`, `fsync`, `mmap` or `malloc` fails
that it makes after it first touched its folder. A command may then end with an error, or do without. It must not print
a traceback, hang, or say with status 0 that it wrote something else than it writes undisturbed. Of allocations, which
are many, a sample fails.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import NamedTuple

import click

from fleet.mcap.reader import digest

_SOURCE = Path(__file__).with_name("failing_calls.c")
_SHORT = ["--set", "duration=1 s", "--set", "checks={}"]
COMMANDS = {  # and what each writes
    "run": (["run", "lossy", "--in-process", "-o", "runs", *_SHORT], "runs/lossy*/run.mcap"),
    "report": (["report", "made", "-o", "report.html"], "report.html"),
    "plot": (["plot", "made", "--what", "track", "-o", "pictures"], "pictures/*"),
    "export": (["export", "made", "--csv", "tables"], "tables/*"),
    "recover": (["recover", "cut.mcap", "-o", "whole.mcap"], "whole.mcap"),
    "sweep": (["sweep", "lossy", "--vary", "controller=nboc,bc", "--seeds", "1", "--workers", "1", *_SHORT], None),
}
KINDS = ("open", "write", "rename", "fsync", "mmap", "malloc")
LONGEST_S = 60.0
# What Rust, C++ and Python themselves print where they have no memory: no code of ours can catch that.
THEIRS = ("memory allocation of", "std::bad_alloc", "error return without exception set", "can't allocate lock")


class Tried(NamedTuple):
    status: int | None  # None: it hung
    reached: bool  # the call that was to fail was made
    wrong: str  # what must not be; empty: nothing


class _Calls:
    """One command in a folder that begins the same each time."""

    def __init__(self, folder: Path, library: Path, name: str) -> None:
        self._folder, self._library, self.name = folder, library, name
        self._arguments, self._written = COMMANDS[name]
        self._expected: dict[str, bytes] = {}
        if self.attempt("none", 0).status:
            raise click.ClickException(f"fleet {name} fails undisturbed")
        self._expected = self._output()

    def attempt(self, kind: str, nth: int) -> Tried:
        work, seen = self._folder / "work", self._folder / "seen"
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(self._folder / "begin", work)
        seen.unlink(missing_ok=True)
        names = {"FAIL_BELOW": str(work), "FAIL_SEEN": str(seen), "FAIL_KIND": kind, "FAIL_NTH": str(nth)}
        command = [sys.executable, "-m", "fleet", *self._arguments]
        preload = {"LD_PRELOAD": str(self._library)}
        try:
            done = subprocess.run(
                command, cwd=work, env=os.environ | preload | names, capture_output=True, text=True, timeout=LONGEST_S
            )
        except subprocess.TimeoutExpired:
            return Tried(None, seen.exists(), f"it hangs for {LONGEST_S:g} s")
        wrong = ""
        if kind in ("mmap", "malloc") and any(words in done.stderr for words in THEIRS):
            pass
        elif "Traceback" in done.stderr:
            wrong = f"traceback: {done.stderr.strip().splitlines()[-1]:.120}"
        elif done.returncode < 0:
            wrong = f"ended by signal {-done.returncode}"
        elif done.returncode == 0 and self._expected and (other := self._differs()):
            wrong = f"status 0, and {other} is another file"
        return Tried(done.returncode, seen.exists(), wrong)

    def _output(self) -> dict[str, bytes]:
        work = self._folder / "work"
        files = sorted(work.glob(self._written)) if self._written else []
        return {file.name: digest(file).encode() if file.suffix == ".mcap" else file.read_bytes() for file in files}

    def _differs(self) -> str:
        try:
            found = self._output()
        except Exception as error:  # a log that cannot be read is another file
            return str(error)
        other = (name for name in self._expected | found if self._expected.get(name) != found.get(name))
        return next((name for name in other if b"cannot be read" not in found.get(name, b"")), "")  # a page may say so


def _numbers(kind: str, sample: int) -> Iterator[int]:
    return count(1) if kind != "malloc" else (round(1.6**k) + k for k in range(sample))


@click.command(help=__doc__)
@click.option("--command", "names", multiple=True, type=click.Choice(list(COMMANDS)), help="Only this; repeatable.")
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), help="Only this call; repeatable.")
@click.option("--most", default=60, show_default=True, help="At most so many calls of a kind fail in turn.")
def main(names: tuple[str, ...], kinds: tuple[str, ...], most: int) -> None:
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-calls-") as name:
        folder = Path(name).resolve()
        library, begin = folder / "failing_calls.so", folder / "begin"
        subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-o", library, _SOURCE, "-ldl"], check=True)
        begin.mkdir()
        made = ["run", "lossy", "--in-process", "-o", str(begin / "runs"), "--quiet", *_SHORT]
        subprocess.run([sys.executable, "-m", "fleet", *made], check=True, stdout=subprocess.DEVNULL)
        shutil.copytree((begin / "runs" / "latest").resolve(), begin / "made")
        (begin / "cut.mcap").write_bytes((begin / "made" / "run.mcap").read_bytes()[:-2000])
        shutil.rmtree(begin / "runs")
        found = 0
        for command in names or COMMANDS:
            calls = _Calls(folder, library, command)
            for kind in kinds or KINDS:
                statuses = Counter[int | None]()
                for nth in _numbers(kind, most):
                    tried = calls.attempt(kind, nth)
                    if not tried.reached or sum(statuses.values()) >= most:
                        break
                    statuses[tried.status] += 1
                    if tried.wrong:
                        found += 1
                        click.echo(f"fleet {command}, {kind} {nth}: {tried.wrong}")
                ended = ", ".join(f"{many} with {status}" for status, many in sorted(statuses.items(), key=str))
                click.echo(f"fleet {command}, {kind}: {sum(statuses.values())} failed in turn: {ended or 'none'}")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
