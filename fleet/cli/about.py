"""The command `fleet about`: everything that a bug report needs, and what `--json` prints."""

from __future__ import annotations

import os
import platform
import re
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click
import psutil

import fleet
from fleet.addon import PLACES, installed_addons, parts
from fleet.cli.completion import RUNS
from fleet.cli.declare import command
from fleet.cores import cores_and_reason, processor
from fleet.option import Option

if TYPE_CHECKING:
    from fleet.result.result import Result

# Variables of ours and of the libraries that change what a run does. Their values may be private and are left out.
_VARIABLES = re.compile(r"UUV_|ZENOH_|RUST_LOG|PYTHON|TMPDIR|XDG_RUNTIME_DIR|OMP_|OPENBLAS_|DASK_")
_MOST_CHECKS = 20


@command()
def about(
    words: Annotated[tuple[str, ...], Option(
        "A run directory; by default the newest run below runs, if there is one. With --schemas: a command.",
        "[RUN]")] = (),
    *,
    schemas: Annotated[bool, Option(
        "Print what --json prints: a page about all commands, or the JSON Schema of one.")] = False,
) -> None:  # fmt: skip
    """Print everything that a bug report needs: versions, the machine, its limits, and the result of RUN.

    It prints names of environment variables without their values, and `~` for your home directory. Read it before you
    send it: it contains names of folders and scenarios.

    \b
    Examples:
      fleet about
      fleet about runs/latest > report.txt
      fleet about --schemas run > run.schema.json
    """
    if schemas:
        _schemas(" ".join(words))  # "check LOG" is one of two words
        return
    from fleet.execution.past_runs import newest_run

    if len(words) > 1 or not all(Path(word).is_dir() for word in words):
        raise click.BadParameter(f"{' '.join(words)!r} is no run directory", param_hint="RUN")
    click.echo(report(Path(words[0]) if words else newest_run(RUNS) if RUNS.is_dir() else None))


def _schemas(command: str) -> None:
    from fleet.cli.documents.page import DOCUMENTS, page, schema

    if not command:
        click.echo(page(), nl=False)
        return
    if command not in DOCUMENTS:
        raise click.UsageError(f"{command} has no --json; there are {', '.join(sorted(DOCUMENTS))}")
    import json

    click.echo(json.dumps(schema(command), indent=2))


def report(run: Path | None) -> str:
    """The report, in lines of a name and a value; a home directory is written `~`.

    `run`: the directory of the run that it is about; None: of no run.
    """
    rows = [*_program(), *_packages(), *_system(), *(() if run is None else _run(run))]
    text = "\n".join(f"{name:14} {value}" for name, value in rows)
    return text.replace(str(Path.home()) + os.sep, "~" + os.sep)


def _program() -> Iterator[tuple[str, str]]:
    editable = '"editable": true' in (distribution("uuv-fleet").read_text("direct_url.json") or "")
    yield "uuv-fleet", f"{version('uuv-fleet')}, cores: {cores_and_reason()}{', editable' if editable else ''}"
    yield "sources", str(Path(fleet.__file__).parent)
    yield "python", f"{sys.version.split()[0]}, {sys.executable}"


def _packages() -> Iterator[tuple[str, str]]:
    names = sorted({re.split(r"[^\w.-]", text)[0] for text in requires("uuv-fleet") or () if "test" not in text})
    found, missing = [], []
    for name in names:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    yield "packages", ", ".join(text for text in found if not text.startswith("uuv-fleet "))
    yield "not installed", ", ".join(missing) or "none"
    addons = installed_addons()
    for kind in PLACES:
        parts(kind)
    yield "add-ons", ", ".join(addons.addons) or "none"
    yield from (("left out", f"{name}: {reason}") for name, reason in addons.left_out.items())


def _system() -> Iterator[tuple[str, str]]:
    cpus = os.cpu_count() or 1
    yield "system", platform.platform()
    yield "processors", f"{cpus} x {processor() or 'unknown'}, load {os.getloadavg()[0] / cpus:.2f} each"
    memory = psutil.virtual_memory()
    yield "memory", f"{memory.available / 1e9:.1f} of {memory.total / 1e9:.1f} GB free"
    limits = (resource.getrlimit(which)[0] for which in (resource.RLIMIT_NOFILE, resource.RLIMIT_NPROC))
    files, processes = ("unlimited" if value == resource.RLIM_INFINITY else str(value) for value in limits)
    yield "limits", f"open files {files}, processes {processes}"
    folder = tempfile.gettempdir()
    yield "temporary", f"{folder}, {shutil.disk_usage(folder).free / 1e9:.1f} GB free"
    yield "variables", ", ".join(sorted(name for name in os.environ if _VARIABLES.match(name))) or "none"


def _run(run: Path) -> Iterator[tuple[str, str]]:
    from fleet.result.file import ResultError, read_result

    yield "run", str(run)
    try:
        result = read_result(run)
    except FileNotFoundError:
        yield "result", "none: the run goes on, or was killed"
        return
    except ResultError as error:
        yield "result", str(error)
        return
    yield "scenario", f"{result.scenario}, seed {result.seed}, {result.sim_s:g} s, digest {result.digest or 'none'}"
    yield "status", f"{result.status}{f': {result.reason}' if result.reason else ''}"
    yield from _checks(result)
    yield "repeat it", f"fleet run {run / 'scenario.yaml'}"


def _checks(result: Result) -> Iterator[tuple[str, str]]:
    failed = [verdict for verdict in result.checks if not verdict.passed]
    for verdict in failed[:_MOST_CHECKS]:
        yield "failed", f"{verdict.check}: {verdict.asked}; found {verdict.found}"
    if len(failed) > _MOST_CHECKS:
        yield "failed", f"and {len(failed) - _MOST_CHECKS} more"
