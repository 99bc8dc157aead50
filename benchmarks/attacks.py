"""Damaged files and killed studies: `python benchmarks/attacks.py --files 500 --kills 20`.

Files of every kind that commands read are damaged at random, and a command reads each: it may refuse it with words, but
must not print a traceback, or take more than 60 s of CPU time or 3 GiB. Then the console of a study is killed at random
moments, and the study goes on: no row may be lost, and no process left.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import click
import psutil
from click.testing import CliRunner

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.store import Store
from fleet.cli.main import cli

MOST_BYTES, LONGEST_S = 3 << 30, 60  # of address space; of CPU time
SHORT = ["--set", "duration=1 s", "--set", "checks={}"]
_BROKEN = 70  # the status of a child with a traceback
STUDY = ["sweep", "lossy", "--vary", "controller=nboc,bc", "--seeds", "40", *SHORT]
# What is damaged, and the commands that read it; {} is the folder of all.
READERS = {
    "run/run.mcap": [
        "info {}/run", "plot {}/run --what track -o {}/out", "report {}/run -o {}/out.html", "verify {}/run",
        "why {}/run --most-runs 0", "export {}/run --csv {}/out", "recover {}/run/run.mcap -o {}/out.mcap",
        "run --from {}/run --duration 1200ms -o {}/runs --quiet", "diff {}/run {}/run",
    ],
    "run/result.json": ["report {}/run -o {}/out.html", "report {}/run {}/run -o {}/out.html"],
    "own.yaml": ["check {}/own.yaml", "run {}/own.yaml --in-process --quiet -o {}/runs"],
    "study/study.json": ["sweep {}/study", "report {}/study -o {}/out.html"],
    "study/study.sqlite": ["sweep {}/study", "report {}/study -o {}/out.html", "export {}/study --csv {}/out"],
}  # fmt: skip


def damaged(data: bytes, draw: random.Random) -> bytes:
    """Some bits turned, a piece cut out, doubled, or replaced by what is no text, or deeply nested."""
    found = bytearray(data)
    for _ in range(draw.choice((1, 1, 3, 20))):
        at, size = draw.randrange(len(found) + 1), draw.choice((1, 2, 8, 100, 5000))
        match draw.randrange(5):
            case 0 if at < len(found):
                found[at] ^= 1 << draw.randrange(8)
            case 1:
                del found[at : at + size]
            case 2:
                found[at:at] = found[at : at + size]
            case 3:
                found[at : at + size] = draw.randbytes(size)
            case _:
                found[at:at] = draw.choice((b"[", b"{\n", b"- ", b"\xff", b"\x00", b"9" * 30)) * size
    return bytes(found)


def read(arguments: list[str]) -> str:
    """What is wrong with a command in a process of its own; empty: nothing."""
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S))
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
        error = CliRunner().invoke(cli, arguments, prog_name="fleet").exception
        if error is not None and not isinstance(error, SystemExit):
            sys.stderr.write(f"{error!r:.300}\n")
            os._exit(_BROKEN)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    if os.WIFSIGNALED(status):
        return f"signal {signal.Signals(os.WTERMSIG(status)).name}"
    return "traceback" if os.WEXITSTATUS(status) == _BROKEN else ""


def damage_files(begin: Path, count: int, draw: random.Random) -> int:
    found, tried = 0, Counter[str]()
    for number in range(count):
        with tempfile.TemporaryDirectory(prefix="uuv-fleet-damaged-") as name:
            folder = Path(name) / "all"
            shutil.copytree(begin, folder)
            file = draw.choice(list(READERS))
            (folder / file).write_bytes(damaged((folder / file).read_bytes(), draw))
            command = draw.choice(READERS[file]).replace("{}", str(folder))
            tried[file] += 1
            if wrong := read(command.split()):
                found += 1
                kept = Path(tempfile.mkdtemp(prefix="uuv-fleet-kept-")) / "all"
                shutil.copytree(folder, kept)
                click.echo(f"{number}: fleet {command.replace(str(folder), str(kept))}: {wrong}")
    click.echo(f"{count} damaged files ({dict(tried)}): {found} with a traceback, a hang or a signal")
    return found


def kill_studies(folder: Path, count: int, draw: random.Random) -> int:
    command = [sys.executable, "-m", "fleet"]
    subprocess.run([*command, *STUDY, "-o", folder / "studies", "--seeds", "1"], capture_output=True, check=True)
    (study,) = (folder / "studies").iterdir()
    record = (study / "study.json").read_text("utf-8").replace('"seeds": [\n  1\n ]', f'"seeds": {list(range(1, 41))}')
    (study / "study.json").write_text(record, "utf-8")
    lost = left = 0
    before: set[tuple[int, int]] = set()
    for _ in range(count):
        child = subprocess.Popen([*command, "sweep", study], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(draw.uniform(0.2, 4.0))
        family = [child.pid, *(each.pid for each in psutil.Process(child.pid).children(recursive=True))]
        child.kill()  # the console alone: its workers have to notice
        child.wait()
        deadline = time.monotonic() + 10.0
        while alive := [pid for pid in family if psutil.pid_exists(pid)]:
            if time.monotonic() > deadline:
                left += len(alive)
                for pid in alive:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                break
            time.sleep(0.05)
        try:
            done = Store.open(study).done()
        except StudyError as error:
            click.echo(f"the study cannot go on: {error}")
            return lost + left + 1
        lost += len(before - done)
        before = done
    click.echo(f"{count} killed studies: {len(before)} rows made, {lost} lost, {left} processes left")
    return lost + left


@click.command(help=__doc__)
@click.option("--files", default=500, show_default=True, help="So many damaged files.")
@click.option("--kills", default=20, show_default=True, help="So many killed studies.")
@click.option("--seed", default=1, show_default=True)
def main(files: int, kills: int, seed: int) -> None:
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-attacks-") as name:
        folder = Path(name)
        begin, command = folder / "begin", [sys.executable, "-m", "fleet"]
        begin.mkdir()
        made = [
            ["run", "lossy", "--in-process", "-o", folder / "runs", *SHORT, "--set"],
            [*STUDY, "--seeds", "2", "-o", folder / "made"],
        ]
        for arguments in made:
            subprocess.run([*command, *arguments], capture_output=True, check=True)
        shutil.copytree((folder / "runs" / "latest").resolve(), begin / "run")
        shutil.copytree(next((folder / "made").iterdir()), begin / "study")
        text = subprocess.run([*command, "export", begin / "run", "--scenario"], capture_output=True, check=True).stdout
        (begin / "own.yaml").write_bytes(text)
        found = damage_files(begin, files, draw) + kill_studies(folder, kills, draw)
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
