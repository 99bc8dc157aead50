"""Worker processes: every item is done once, and one that dies costs nobody else's."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from repository import ROOT
from spawned import python
from worker_items import (
    copied,
    die_at_once,
    die_once,
    hang,
    known_to_the_worker_alone,
    masked,
    sleep,
    step,
    step_apart,
    unpicklable,
)

from fleet.errors import RunBroken
from fleet.processes.apart import can_copy, in_child_process
from fleet.processes.workers import WorkerDied, WorkerLate, Workers


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


def test_one_that_is_late_is_killed_and_the_others_go_on(workers: Workers) -> None:
    found = dict(workers.each(sleep, [3600.0, 0.0, 0.1, 0.2], limit_s=lambda item: 0.3 if item > 1.0 else 3600.0))
    with pytest.raises(WorkerLate):
        found[3600.0].result()
    assert [found[item].result() for item in (0.0, 0.1, 0.2)] == [0.0, 0.1, 0.2]


def test_an_error_that_cannot_travel_and_an_exit_are_told(workers: Workers) -> None:
    found = dict(workers.each(unpicklable, [0, 1]))
    assert str(found[0].exception()) == "LocalError: only here"
    assert isinstance(found[1].exception(), SystemExit)


def test_an_answer_whose_class_only_the_worker_knows_is_an_error_of_its_item(workers: Workers) -> None:
    found = dict(workers.each(known_to_the_worker_alone, [0, 1]))
    for future in found.values():
        with pytest.raises(RuntimeError, match="only_here"):
            future.result()
    assert [future.result() for _, future in workers.each(step, [1])] == [2]


def test_a_worker_has_copies_that_change_nothing_in_it(workers: Workers) -> None:
    """A worker has one thread, so it can be copied."""
    ((_, future),) = workers.each(copied, [10])
    assert future.result() == ([11, 12, 13], [10])


def test_what_a_copy_raises_and_its_death_are_told(workers: Workers) -> None:
    found = dict(workers.each(step_apart, [-1, 0, 4]))
    assert str(found[-1].exception()).startswith("the copy of a run ended without an answer (signal 9)")
    assert isinstance(found[0].exception(), ZeroDivisionError)
    assert found[4].result() == 8


@pytest.mark.parametrize("ended_by", [signal.SIGKILL, signal.SIGINT])
def test_a_copy_ends_with_the_process_that_it_is_of(ended_by: signal.Signals) -> None:
    code = "from worker_items import hang_apart; hang_apart()"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests" / "support")])}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
    ) as parent:
        assert parent.stdout is not None
        copy = os.pidfd_open(int(parent.stdout.readline()))
        parent.send_signal(ended_by)
        assert select.select([copy], [], [], 60.0)[0] == [copy]  # it has ended
        os.close(copy)


def test_a_process_with_several_threads_is_not_copied() -> None:
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    try:
        assert not can_copy()
        with pytest.raises(AssertionError, match="several threads"):
            in_child_process(int)
    finally:
        over.set()
        thread.join()


def test_who_asks_for_no_more_finds_workers_that_are_free(workers: Workers) -> None:
    asked = workers.each(sleep, [0.0, 3600.0])
    assert next(asked)[0] == 0.0
    asked.close()  # type: ignore[attr-defined]
    assert [future.result() for _, future in workers.each(step, [1])] == [2]


def test_workers_that_end_before_they_begin_blame_no_item_and_end_it() -> None:
    with Workers(1, die_at_once) as dying, pytest.raises(RunBroken, match=r"before they began \(exit status 7\)"):
        list(dying.each(step, [1]))


def test_a_worker_that_hangs_before_it_begins_is_ended_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.processes.workers._BEGIN_S", 0.5)
    with Workers(1, hang) as hanging, pytest.raises(RunBroken, match=r"did not begin with its work within 0\.5 s"):
        list(hanging.each(step, [1]))
    assert not hanging.pids


def test_too_few_open_files_are_said_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.processes.limits._raise_to", lambda wanted: 40)
    with pytest.raises(RunBroken, match=r"2 workers need \d+ open files in this process, and the limit here is 40"):
        Workers(2)


def test_a_process_that_cannot_start_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def start(_: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("multiprocessing.context.SpawnProcess.start", start)
    with Workers(2) as none, pytest.raises(RunBroken, match="cannot start a worker process: Resource temporarily"):
        list(none.each(step, [1]))


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
    done = python(tmp_path / "first.py", environment={"PYTHONPATH": place})
    assert (done.returncode, done.stdout.split()) == (0, [str(signal.SIGHUP.value), str(signal.SIGINT.value)]), done


def test_workers_leave_signals_to_the_one_who_started_them() -> None:
    """From their first moment on: what Ctrl-C raises while they import would be printed."""
    with Workers(1) as alone:
        ((_, future),) = alone.each(masked, [1])
    assert {signal.SIGINT, signal.SIGHUP} <= future.result()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
