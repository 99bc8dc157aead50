"""The workers of a Dask cluster that is there make the runs of a study."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from fleet.addons.studies.engine_interface import LOST, lost_row, require
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import Modules, get_ready, packed
from fleet.addons.studies.one_run import Task, make_run_in_time
from fleet.addons.studies.row import Row

if TYPE_CHECKING:
    from distributed import Client, Future

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
            if _is_killed(future):
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
            for future in _wait_for_finished(under_way, wait):
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


def _wait_for_finished(under_way: dict[Future[Row], Task], wait: Callable[[], None]) -> list[Future[Row]]:
    from distributed import CancelledError
    from distributed import wait as until

    while True:
        try:
            return list(until(list(under_way), timeout=0.2, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            wait()
        except CancelledError as error:
            raise StudyError(f"the scheduler is gone: {error!s:.200}") from None


def _is_killed(future: Future[Row]) -> bool:
    return future.status != "finished" and type(future.exception()).__name__ == "KilledWorker"


def _row(task: Task, future: Future[Row]) -> Row:
    if future.status == "finished":
        return future.result()
    error = future.exception()
    return lost_row(task, LOST if _is_killed(future) else f"{type(error).__name__}: {error!s:.500}")
