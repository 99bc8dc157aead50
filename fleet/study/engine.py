"""Who makes the runs of a study: Dask workers, of a cluster that this program starts or of one that is there.

A plain local cluster lets everybody on the host run code as its user. So ours speaks TLS with certificates that exist
as long as it does: who does not have them cannot connect.
"""

from __future__ import annotations

import logging
import os
import sys
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from itertools import islice
from math import isfinite
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from fleet.processes.interrupts import out_of_reach
from fleet.processes.safe_path import children_ignore_the_folder
from fleet.processes.workers import TIMES, WorkerDied
from fleet.study.errors import StudyError
from fleet.study.modules import Modules, get_ready, packed
from fleet.study.one_run import FAILED, Task, TimedOut, make_run

if TYPE_CHECKING:
    from distributed import Client, Future

NEEDED = ("dask", "distributed", "pyarrow", "scipy", "pandas", "xarray", "cryptography")
_AHEAD = 3  # batches per worker that are under way, so that none of them waits
_BATCH_S = 0.5  # a batch takes about so long, and is one run if that takes longer
_LARGEST_BATCH = 16
_CONNECT_S = 10
_JOIN_S = 60  # for a worker of a cluster that is there
# Workers start again by themselves. Dask's cluster gives a place up for good that is empty so long after a worker died
# there, also when another one has died in it since.
_NEVER = "1000 days"
LOST = f"the worker that made it died {TIMES} times; is there enough memory?"

Row = dict[str, Any]


def need_extra() -> None:
    """Raises StudyError: the libraries of the extra `study` are not installed."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise StudyError(f"studies need {', '.join(missing)}: pip install 'uuv-fleet[study]'")


@dataclass(frozen=True, slots=True)
class Engine:
    """Workers that are ready.

    Attributes:
        workers: how many runs go on at once.
        dashboard: the address of Dask's own page; empty: it has none.
        here: whether they are processes of this machine, of this user.
    """

    client: Client
    workers: int
    dashboard: str
    here: bool
    notes: str = ""  # a folder where workers of this machine say which run they make; empty: they do not

    def carry(self, modules: Modules) -> Modules:
        """The modules of laws as runs on these workers need them.

        Raises:
            StudyError: a worker cannot import them.
        """
        if self.here or not modules.names:
            return modules
        ready = packed(modules)
        check_modules(self.client, ready)
        return ready

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """Make every run, whoever dies meanwhile.

        Args:
            tasks: are asked for in their order as workers become free, so that memory does not grow with their number.
            take: gets rows, in the order in which runs end.
            wait: is called several times a second.
        """
        waiting: deque[list[Task]] = deque()
        under_way: dict[Future[Any], list[Task]] = {}
        died: Counter[str] = Counter()  # under which run how many workers did, by key
        unexplained = 0  # batches in a row that were lost, none of whose runs had begun
        size = 1

        def submit() -> None:
            while len(under_way) < _AHEAD * self.workers:
                batch = waiting.popleft() if waiting else list(map(self._noted, islice(tasks, size)))
                if not batch:
                    return
                future = self.client.submit(make_batch, batch, pure=False)
                under_way[future] = batch

        submit()
        while under_way:
            for future in _finished(under_way, wait):
                batch = under_way.pop(future)
                if future.status == "finished":
                    rows = future.result()
                    slowest = max((row["wall_s"] for row in rows if isfinite(row["wall_s"])), default=_BATCH_S)
                    size = max(1, min(_LARGEST_BATCH, int(_BATCH_S / max(slowest, 1e-3))))
                    take(rows)
                    unexplained = 0
                    continue
                guilty = self._guilty(batch)
                unexplained = 0 if guilty else unexplained + 1
                if unexplained > TIMES * _AHEAD * self.workers:  # workers die before they begin with any run
                    guilty = {task.key for task in batch}
                for task in batch:
                    died[task.key] += task.key in guilty
                    if task.note and _written(task.note):
                        take([lost_row(task, str(TimedOut(task)))])
                    elif task.key in guilty and died[task.key] >= self._most_deaths:
                        take([lost_row(task, reason_of(future.exception()))])
                    else:
                        waiting.append([task])
            submit()

    @property
    def _most_deaths(self) -> int:
        """After so many of them a run is given up. A scheduler that is there has its own limit."""
        return TIMES if self.here else 1

    def _noted(self, task: Task) -> Task:
        return task._replace(note=os.path.join(self.notes, f"{task.key}-{task.point}")) if self.notes else task

    def _guilty(self, batch: list[Task]) -> set[str]:
        """The keys of the runs of a lost batch under which its worker died: not of those that only waited there."""
        if self.notes:
            return {task.key for task in batch if _begun(task.note)}
        return {task.key for task in batch} if len(batch) == 1 else set()  # of several it is not known


def make_batch(tasks: list[Task]) -> list[Row]:
    """Make some runs; this is what a worker does."""
    return [make_run(task) for task in tasks]


@contextmanager
def local_engine(workers: int, *, dashboard: bool = False) -> Iterator[Engine]:
    """Workers on this machine, which end with the context.

    Args:
        workers: how many, one core each.
        dashboard: whether Dask serves its page, on loopback.

    Raises:
        StudyError: they do not start.
    """
    need_extra()
    import dask
    from distributed import Client, LocalCluster
    from distributed.security import Security

    children_ignore_the_folder()
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.deploy.lost-worker-timeout": _NEVER}))
        try:
            # Ctrl-C and the end of the terminal are for this process alone. Dask's profiler
            # keeps the stacks of each second for an hour, in each worker.
            with out_of_reach(), dask.config.set({"distributed.worker.profile.enabled": False}):
                security = Security.temporary()
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        protocol="tls://",
                        security=security,
                        dashboard_address="127.0.0.1:0",  # None would be the fixed port 8787 of all addresses
                        # or bokeh is loaded where it is installed; deaths of workers are counted here
                        scheduler_kwargs={"dashboard": dashboard, "allowed_failures": 0},
                        silence_logs=logging.CRITICAL,
                    )
                )
                client = stack.enter_context(Client(cluster, security=security))
        except (OSError, TimeoutError, RuntimeError) as error:
            raise StudyError(f"the workers do not start: {error!s:.200}") from None
        notes = stack.enter_context(TemporaryDirectory(prefix="uuv-fleet-study-", ignore_cleanup_errors=True))
        yield Engine(client, workers, client.dashboard_link if dashboard else "", here=True, notes=notes)


@contextmanager
def remote_engine(scheduler: str | Any, security: Any = None) -> Iterator[Engine]:
    """The workers of a Dask cluster that is there.

    Args:
        scheduler: its address, such as `tls://host:8786`, or a Dask cluster object.
        security: a `distributed.security.Security`; None: as Dask's configuration says.

    Raises:
        StudyError: it cannot be reached, has no worker, or a worker has another version of something; or it speaks TLS,
            and there are no certificates.
    """
    need_extra()
    from distributed import Client
    from distributed.security import Security

    if str(scheduler).startswith("tls://") and security is None:
        configured: Any = Security()
        if not (configured.tls_ca_file and configured.tls_client_cert):
            raise StudyError(
                f"{scheduler} needs certificates: set DASK_DISTRIBUTED__COMM__TLS__CA_FILE, ..._CLIENT__CERT and "
                "..._CLIENT__KEY, or the same in Dask's configuration"
            )
    try:
        client = Client(scheduler, security=security, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise StudyError(f"no Dask scheduler answers at {scheduler}: {error!s:.200}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_JOIN_S)
        except TimeoutError:
            raise StudyError(f"the scheduler at {scheduler} has no worker: start some with dask worker") from None
        check_versions(client)
        threads = sum(client.nthreads().values())
        with client.as_current():
            yield Engine(client, threads, client.dashboard_link, here=False)


def versions() -> dict[str, str]:
    """What must be the same on both sides for the same bytes and a working connection."""
    packages = ("uuv-fleet", "distributed", "numpy", "piqp", "msgspec")
    return {"python": ".".join(map(str, sys.version_info[:2]))} | {name: version(name) for name in packages}


def check_versions(client: Client) -> None:
    """Raises StudyError: a worker has another version of something that matters, or lacks it."""
    ours, problems = versions(), []
    try:
        theirs = client.run(versions, on_error="return")
    except Exception as error:  # of whatever kind the worker's is
        raise StudyError(f"the workers cannot be asked for their versions: {error!s:.200}") from None
    for worker, found in theirs.items():
        if isinstance(found, BaseException):
            problems.append(f"worker {worker} lacks {getattr(found, 'name', None) or found}")
            continue
        different = [
            f"{name} {found.get(name)} (here {mine})" for name, mine in ours.items() if found.get(name) != mine
        ]
        if different:
            problems.append(f"worker {worker} has {', '.join(different)}")
    if problems:
        raise StudyError("the cluster cannot be used: " + "; ".join(problems[:5]))


def check_modules(client: Client, modules: Modules) -> None:
    """Raises StudyError: a worker cannot import the modules of laws."""
    found = client.run(get_ready, modules, on_error="return")
    problems = []
    for worker, error in found.items():
        if isinstance(error, ModuleNotFoundError):
            problems.append(f"worker {worker} lacks {error.name}")
        elif isinstance(error, BaseException):
            problems.append(f"worker {worker}: {error!s:.200}")
    if problems:
        raise StudyError("the laws cannot be used there: " + "; ".join(problems[:5]))


def _finished(under_way: dict[Future[Any], list[Task]], wait: Callable[[], None]) -> list[Future[Any]]:
    """Those that ended, at least one."""
    from distributed import CancelledError
    from distributed import wait as until

    while True:
        try:
            return list(until(list(under_way), timeout=0.2, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            wait()
        except CancelledError as error:
            raise StudyError(f"the scheduler is gone: {error!s:.200}") from None


def reason_of(error: BaseException | None) -> str:
    """Why a worker gave no row."""
    killed = isinstance(error, WorkerDied) or type(error).__name__ == "KilledWorker"
    return LOST if killed else f"{type(error).__name__}: {error!s:.500}"


def _begun(note: str) -> bool:
    """Whether a run had begun; its next one has not."""
    if not _written(note):
        try:
            os.unlink(note)
        except FileNotFoundError:
            return False
    return True


def _written(note: str) -> bool:
    """Whether a worker ended itself because a run took too long."""
    try:
        return os.path.getsize(note) > 0
    except OSError:
        return False


def lost_row(task: Task, reason: str) -> Row:
    """The row of a run that no worker made."""
    return {"key": task.key, "point": task.point, "seed": task.seed, "status": FAILED, "reason": reason,
            "version": version("uuv-fleet")}  # fmt: skip
