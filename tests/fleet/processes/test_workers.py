"""Worker processes: every item is done once, and one that dies costs nobody else's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from repository import ROOT
from worker_items import die_once, masked, step

from fleet.processes.workers import WorkerDied, Workers


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    with Workers(2) as found:
        yield found


def test_one_that_dies_and_one_that_fails_cost_only_their_own_items(workers: Workers) -> None:
    found = dict(workers.each(step, [1, -1, 2, 0, 3, 4]))
    assert {item: found[item].result() for item in (1, 2, 3, 4)} == {1: 2, 2: 4, 3: 6, 4: 8}
    with pytest.raises(WorkerDied):
        found[-1].result()
    with pytest.raises(ZeroDivisionError):
        found[0].result()


def test_what_died_is_done_again(workers: Workers, tmp_path: Path) -> None:
    ((_, future),) = workers.each(die_once, [tmp_path / "mark"])
    assert future.result() != os.getpid()


def test_a_worker_that_was_killed_meanwhile_is_replaced(workers: Workers) -> None:
    ((_, future),) = workers.each(die_once, [Path()])
    os.kill(future.result(), signal.SIGKILL)
    assert sorted(future.result() for _, future in workers.each(step, [1, 2, 3])) == [2, 4, 6]


def test_items_are_asked_for_as_workers_become_free(workers: Workers) -> None:
    asked: list[int] = []

    def items() -> Iterator[int]:
        for number in range(1, 20):
            asked.append(number)
            yield number

    for done, _ in enumerate(workers.each(step, items()), start=1):
        assert len(asked) <= done + workers.count


FIRST = """
from fleet.processes.workers import Workers
from repository import ROOT
from worker_items import masked
if __name__ == "__main__":
    with Workers(1) as alone:
        ((_, future),) = alone.each(masked, [1])
    print(*sorted(future.result()))
"""


def test_so_does_the_first_process_of_a_program(tmp_path: Path) -> None:
    """What multiprocessing starts before it lifts the block of SIGINT."""
    (tmp_path / "first.py").write_text(FIRST)
    place = os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "support")))
    done = subprocess.run(
        [sys.executable, tmp_path / "first.py"], env=os.environ | {"PYTHONPATH": place}, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout.split()) == (0, [str(signal.SIGHUP.value), str(signal.SIGINT.value)]), done


def test_workers_leave_signals_to_the_one_who_started_them() -> None:
    """From their first moment on: what Ctrl-C raises while they import would be printed."""
    with Workers(1) as alone:
        ((_, future),) = alone.each(masked, [1])
    assert {signal.SIGINT, signal.SIGHUP} <= future.result()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
