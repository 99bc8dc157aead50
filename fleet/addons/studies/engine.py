"""The engine of a study's runs: workers of this machine, or an existing Dask cluster."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from itertools import chain
from typing import TYPE_CHECKING, Any, Protocol

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import Modules, get_ready, packed
from fleet.addons.studies.one_run import GRACE_S, Task, late, make_run, make_run_in_time
from fleet.addons.studies.row import FAILED, Row
from fleet.addons.studies.stack_runs import StackRuns
from fleet.processes.limits import processors
from fleet.processes.workers import TIMES, WorkerDied, WorkerLate, Workers

if TYPE_CHECKING:
    from distributed import Client, Future


NEEDED = ("scipy", "pandas", "xarray")
LOST = f"the worker that made it died {TIMES} times; is there enough memory?"


class Engine(Protocol):
    """What makes runs."""

    @property
    def here(self) -> bool:
        """Whether the workers are processes of this machine, of this user."""

    def carry(self, modules: Modules) -> Modules:
        """The modules of laws as runs on these workers need them. Raises StudyError: a worker cannot import them."""

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """Make every run, also if workers die meanwhile. `tasks`: the runs. A free worker takes the next one, so memory
        does not grow with their number. `take`: called with the rows of results as runs end. Raises RunBroken: no
        worker starts; StudyError: the workers are gone."""


def require_extra() -> None:
    """Raises StudyError: the libraries of the extra `study` are not installed."""
    require(NEEDED, "studies need", "study")


def require(libraries: Iterable[str], who: str, extra: str) -> None:
    """Raises StudyError: libraries of an extra are not installed."""
    missing = [name for name in libraries if find_spec(name) is None]
    if missing:
        raise StudyError(f"{who} {', '.join(missing)}: pip install 'uuv-fleet[{extra}]'")


def lost_row(task: Task, reason: str) -> Row:
    return Row(key=task.key, point=task.point, seed=task.seed, status=FAILED, reason=reason,
               version=version("uuv-fleet"))  # fmt: skip


# Processes of this machine make the runs of a study; they are there at once, and need no library.


@dataclass(frozen=True, slots=True)
class LocalEngine:
    workers: Workers
    stacks: StackRuns
    here: bool = True

    def carry(self, modules: Modules) -> Modules:
        """These are processes of this machine, which import them where they lie."""
        return modules

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """See `Engine.make`. Where a law hangs, the worker is killed soon after the time that its run may take."""
        if (first := next(tasks, None)) is None:
            return
        tasks = chain([first], tasks)
        if first.modules.programs:
            self.stacks.make(tasks, take, wait)
            return
        for task, future in self.workers.each(make_run, tasks, wait, lambda task: task.timeout_s + GRACE_S):
            error = future.exception()
            take([future.result() if error is None else lost_row(task, _reason(task, error))])


@contextmanager
def local_engine(workers: int | None, tell: Callable[[str], None] = warnings.warn) -> Iterator[LocalEngine]:
    """A pool of workers on this machine, closed on exit. None: one per core, and of runs of programs as many as the
    machine can take. `tell`: gets sentences on how these go. Raises RunBroken if they cannot be started."""
    with Workers(workers or processors()) as pool:
        yield LocalEngine(pool, StackRuns(workers, tell))


def engine_of(
    modules: Modules,
    workers: int | None = None,
    scheduler: Any = None,
    tell: Callable[[str], None] = warnings.warn,
) -> AbstractContextManager[Engine]:
    """The engine that was asked for.

    Args:
        modules: what the runs need.
        workers: of this machine; None: one per core.
        scheduler: of an existing Dask cluster, to be used instead: its address, or a cluster object.
        tell: gets sentences on how the runs go.

    Raises:
        RunBroken: there cannot be so many workers here.
        StudyError: the cluster cannot be used, or cannot make such runs.
    """
    if modules.programs and scheduler is not None:  # before anybody looks for it
        raise StudyError("programs of a stack run on this machine alone: leave --scheduler out")
    return local_engine(workers, tell) if scheduler is None else dask_engine(scheduler)


def _reason(task: Task, error: BaseException) -> str:
    match error:
        case WorkerLate():
            return str(late(task))
        case WorkerDied():
            return LOST
        case _:
            return f"{type(error).__name__}: {error!s:.500}"


# The workers of a Dask cluster that is there make the runs of a study.

_OF_CLUSTERS = ("dask", "distributed")
_AHEAD = 3  # runs per worker that are under way, so that none of them waits
_CONNECT_S = 10
_JOIN_S = 60  # for a worker


@dataclass(frozen=True, slots=True)
class DaskEngine:
    """Workers of a cluster. Dask gives a run to another worker where one dies, as often as its scheduler allows."""

    client: Client
    workers: int  # runs at a time
    here: bool = False

    def carry(self, modules: Modules) -> Modules:
        if not modules.names:
            return modules
        ready = packed(modules)
        check_modules(self.client, ready)
        return ready

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """See `Engine.make`. Dask blames a death on every run that the worker had been given. So a run that it gives up
        is made once more when all others are made, with no other one beside it; then it alone is to blame."""
        blamed: list[Task] = []
        for task, future in self._each(tasks, _AHEAD * self.workers, wait):
            if _killed(future):
                blamed.append(task)
            else:
                take([_row(task, future)])
        for task, future in self._each(iter(blamed), 1, wait):
            take([_row(task, future)])

    def _each(self, tasks: Iterator[Task], most: int, wait: Callable[[], None]) -> Iterator[tuple[Task, Future[Row]]]:
        under_way: dict[Future[Row], Task] = {}
        while True:
            while len(under_way) < most and (task := next(tasks, None)) is not None:
                under_way[self.client.submit(make_run_in_time, task, pure=False)] = task
            if not under_way:
                return
            for future in _finished(under_way, wait):
                yield under_way.pop(future), future


@contextmanager
def dask_engine(scheduler: str | Any, security: Any = None) -> Iterator[DaskEngine]:
    """The workers of a Dask cluster that is there. `scheduler`: its address, such as `tls://host:8786`, or a Dask
    cluster object. `security`: a `distributed.security.Security`; None: as Dask's configuration says. Raises
    StudyError: Dask is not installed; the cluster cannot be reached or has no worker; a worker has another version of
    something; or the cluster speaks TLS, and there are no certificates."""
    require(_OF_CLUSTERS, "a cluster needs", "cluster")
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
        with client.as_current():
            yield DaskEngine(client, sum(client.nthreads().values()))


def versions() -> dict[str, str]:
    """The versions that must be the same on both sides for the same bytes and a working connection."""
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


def _finished(under_way: dict[Future[Row], Task], wait: Callable[[], None]) -> list[Future[Row]]:
    from distributed import CancelledError
    from distributed import wait as until

    while True:
        try:
            return list(until(list(under_way), timeout=0.2, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            wait()
        except CancelledError as error:
            raise StudyError(f"the scheduler is gone: {error!s:.200}") from None


def _killed(future: Future[Row]) -> bool:
    return future.status != "finished" and type(future.exception()).__name__ == "KilledWorker"


def _row(task: Task, future: Future[Row]) -> Row:
    if future.status == "finished":
        return future.result()
    error = future.exception()
    return lost_row(task, LOST if _killed(future) else f"{type(error).__name__}: {error!s:.500}")
