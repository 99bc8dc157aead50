"""Signals that reach `fleet` where Python cannot raise what they stand for."""

from __future__ import annotations

import subprocess
import sys

import pytest

# A command in whose middle something is collected: what its destructor raises is only printed by Python.
PROGRAM = """\
import os, signal, sys, time
import click
from fleet import __main__ as program
from fleet.cli.main import cli

class Collected:
    def __del__(self):
        os.kill(os.getpid(), signal.{signal})
        for _ in range(100):
            pass

@cli.command()
def work():
    thing = Collected()
    del thing
    print("the signal was lost", flush=True)
    time.sleep(20)

sys.argv = ["fleet", "work"]
program.main()
"""


@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 130), ("SIGINT", 130), ("SIGHUP", 129)])
def test_a_signal_within_a_destructor_ends_the_command(name: str, status: int) -> None:
    """It was printed and forgotten, and all signals after it were ignored."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(signal=name)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == status
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr


SLOW_TO_START = """
import threading

start = threading.Thread.start

def slowly(self):
    start(self)
    time.sleep(0.1)  # so much later the thread has sent the signal, and Python is still in its hook

threading.Thread.start = slowly
"""


def test_a_signal_that_comes_again_too_early_comes_once_more() -> None:
    """On a busy machine it came while the hook that asked for it was not done, and was lost for good."""
    program = PROGRAM.format(signal="SIGTERM").replace('sys.argv = ["fleet"', f'{SLOW_TO_START}\nsys.argv = ["fleet"')
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
