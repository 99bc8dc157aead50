"""What starting a command imports: the reason why the light ones answer at once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from marks import slow

READING = {"numpy", "pydantic", "zenoh", "matplotlib", "google.protobuf", "mcap", "piqp", "jinja2", "multiprocessing"}
LIGHT = READING | {"rich", "yaml", "msgspec", "fractions", "asyncio", "hashlib"}


def imported(*arguments: str, **environment: str) -> set[str]:
    """All modules that a command imports, in a process of its own."""
    return at_the_end("*sys.modules", *arguments, **environment)


def at_the_end(value: str, *arguments: str, **environment: str) -> set[str]:
    """The words that `print` makes of a value as a command ends, in a process of its own."""
    code = (
        "import atexit, os, sys; sys.argv[0] = 'fleet'; from fleet.__main__ import main; "
        f"atexit.register(lambda: print({value}, file=sys.stderr)); main()"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | environment, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout
    return set(ended.stderr.splitlines()[-1].split())


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [
        (("--version",), LIGHT),
        (("--help",), LIGHT),
        (("run", "--help"), LIGHT - {"fractions"}),  # for the defaults, which are times
        (("completion", "bash"), LIGHT),
        (("list",), READING | {"fleet.scenario.schema.spec", "fleet.scenario.loading"}),
    ],
)
def test_light_commands_import_nothing_heavy(arguments: tuple[str, ...], heavy: set[str]) -> None:
    assert imported(*arguments) & heavy == set()


@pytest.mark.parametrize(
    ("typed", "heavy"),
    [
        ("fleet run pap", READING),
        ("fleet inject ki", READING - {"pydantic"} | {"fleet.scenario.schema.spec"}),  # the kinds are in the schema
    ],
)
def test_completing_a_word_imports_nothing_heavy(typed: str, heavy: set[str]) -> None:
    words = {"_FLEET_COMPLETE": "bash_complete", "COMP_WORDS": typed, "COMP_CWORD": "2"}
    assert imported(**words) & heavy == set()


def test_a_run_in_one_process_imports_no_middleware_and_draws_nothing(tmp_path: Path) -> None:
    """The fork server's module above all, which would import the processes of a distributed run."""
    changes = ("--set", "checks={tumbled: waived}", "--duration", "100 ms", "--out", str(tmp_path))
    found = imported("run", "paper", "--in-process", *changes)
    distributed = {"zenoh", "multiprocessing.forkserver", "fleet.processes.preload", "fleet.execution.console"}
    assert "numpy" in found
    assert found & (distributed | {"matplotlib", "jinja2"}) == set()


@pytest.mark.skipif(sys.platform != "linux" or os.cpu_count() == 1, reason="counts threads where /proc lists them")
@pytest.mark.parametrize(("asked", "threads"), [(None, 1), *slow(("2", 2))])
def test_numpy_makes_threads_only_if_somebody_asks(
    asked: str | None, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread per core in each process of a fleet, which spun as numpy was imported."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    environment = {} if asked is None else {"OPENBLAS_NUM_THREADS": asked}
    assert at_the_end("len(os.listdir('/proc/self/task'))", "check", "paper", **environment) == {str(threads)}
