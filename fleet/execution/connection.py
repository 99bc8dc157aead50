"""A live run, seen from another terminal: find it by its name, from any folder, and ask its console."""

from __future__ import annotations

import os.path
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec

from fleet.errors import FleetError
from fleet.execution.directory import CONNECTION, OBSERVE, is_in_use
from fleet.execution.registry import registered_runs
from fleet.logs.run_name import RUN_NAME
from netem.errors import BusError
from netem.files import DamagedFile, parse_json, read_file
from netem.limits import CONNECTION_FILE
from netem.wire.bus import Bus
from netem.wire.control import read_map, request
from netem.wire.credentials import LEASE_MS, Credentials
from netem.wire.keys import Keys

ASK_S = 5.0


class RemoteError(FleetError):
    """There is no such run, it does not answer (`status` 3), or something else should have been asked for (2)."""

    def __init__(self, text: str, status: int = 3) -> None:
        super().__init__(text)
        self.status = status


class ConnectionFile(msgspec.Struct):
    """The content of a connection file; one with any other content is not ours."""

    scenario: str
    pid: Annotated[int, msgspec.Meta(gt=0, lt=2**31)]  # process of the console
    endpoint: str  # the run's router, as zenoh writes it
    run: Annotated[str, msgspec.Meta(pattern=r"^[\w-]+$")]  # the run's id
    user: str
    password: str
    ca: str = ""  # PEM, as are the next two
    certificate: str = ""
    key: str = ""
    lease_ms: Annotated[int, msgspec.Meta(gt=0)] = LEASE_MS


@dataclass(frozen=True, slots=True)
class LiveRun:
    """A live run: its directory and what its connection file says."""

    directory: Path
    scenario: str
    pid: int
    endpoint: str
    run: str
    credentials: Credentials

    @property
    def name(self) -> str:
        """The run's name in answers and for users: the name of its directory."""
        return self.directory.name

    def __repr__(self) -> str:
        return f"LiveRun({self.directory}, pid {self.pid})"


def live_runs() -> list[LiveRun]:
    """The runs of this user that can be asked, wherever they are, by name. A run in one process answers none. Raises
    RegistryError if it is not known which runs there are.
    """
    found = [_read(directory) for directory in published_runs(CONNECTION)]
    return sorted((one for one in found if one is not None), key=lambda one: (one.name, one.directory))


def find(run: str | None = None, *, to_act: bool = False) -> LiveRun:
    """Find a live run that can be asked. Arguments and errors as `choose`."""
    directory = choose(run, CONNECTION, to_act=to_act)
    one = _read(directory)
    if one is None:
        raise RemoteError(f"{directory} is no live run: there is no usable {CONNECTION}")
    return one


def published_runs(file: str) -> list[Path]:
    """The directories of the live runs that have such a file. Raises RegistryError: it is not known which."""
    return [directory for directory in registered_runs() if os.path.exists(directory / file)]


def choose(run: str | None, file: str, *, to_act: bool = False) -> Path:
    """The directory of the one live run that the user means.

    Args:
        run: its directory, or a name, a scenario or the beginning of a name. None: the only one. If several may be
            meant, the only one below the folder `runs` or the working directory is.
        file: what the directory must have.
        to_act: the run will be changed. Then one that is elsewhere has to be named: it may be of another trial.

    Raises:
        RemoteError: there is none, or there are several.
        RegistryError: it is not known which runs there are.
    """
    if run is not None and os.path.exists(Path(run) / file):  # unlike Path.exists it never raises
        directory = Path(run).resolve()  # `latest` is no name
        if not is_in_use(directory):
            raise RemoteError(f"the run in {directory} is over: its console is gone")
        return directory
    if run is not None and "/" in run:
        raise RemoteError(f"{run} is no live run: there is no {file}")
    known = published_runs(file)
    found = known if run is None else runs_named(run, known)
    if not found:
        raise RemoteError(_nothing(run, known, file))
    near = near_ones(found)
    if to_act and run is None and not near:
        raise RemoteError(
            f"no live run is below {_working_directory()}; one that is elsewhere has to be named:{_choices(found)}", 2
        )
    if len(near) == 1:
        return near[0]
    if len(found) > 1:
        asked = "" if run is None else f" that {run!r} may mean"
        raise RemoteError(f"{len(found)} live runs{asked}; say which:{_choices(found)}", 2)
    return found[0]


def near_ones(directories: list[Path]) -> list[Path]:
    """The runs below the folder `runs`, or else below the working directory: others may be of another trial."""
    here = _working_directory()
    return [one for one in directories if one.is_relative_to(here / "runs")] or [
        one for one in directories if one.is_relative_to(here)
    ]


def _working_directory() -> Path:
    try:
        return Path.cwd()
    except FileNotFoundError:  # the folder was removed, so no run is below it
        return Path("/nowhere")


def runs_named(run: str, known: list[Path]) -> list[Path]:
    """The runs with this name, or else with this scenario, or else with a name that begins like this."""
    return (
        [directory for directory in known if directory.name == run]
        or [one for one in known if (found := RUN_NAME.fullmatch(one.name)) and found["scenario"] == run]
        or [directory for directory in known if directory.name.startswith(run)]
    )


def _nothing(run: str | None, known: list[Path], file: str) -> str:
    if run is None:
        return "no live run; fleet ls lists all runs below runs; a run with --in-process cannot be reached"
    if others := runs_named(run, registered_runs()):  # without the file
        return f"the live run {others[0].name} " + ("is not published" if file == OBSERVE else f"has no {file} yet")
    return f"no live run is called {run!r}" + (f"; there are:{_choices(known)}" if known else "; there is none at all")


def _choices(found: list[Path]) -> str:
    """A line for each, with what to type: the whole directory where a name is not unique."""
    names = [directory.name for directory in found]
    return "".join(f"\n  --run {d if names.count(d.name) > 1 else d.name}" for d in found)


def is_live(run: LiveRun) -> bool:
    return is_in_use(run.directory) and os.path.exists(run.directory / CONNECTION)


class OpenConnection:
    """A connection to the console of a run that is kept, for who asks again and again."""

    def __init__(self, run: LiveRun) -> None:
        self._run = run
        self._bus: Bus | None = None

    def ask(self, op: str, **fields: Any) -> dict[str, Any]:
        """Ask the console; connect before, if need be. Raises RemoteError: it does not answer in time, or refuses."""
        name = self._run.name
        try:
            bus = self._bus = self._bus or Bus.connect(self._run.endpoint, self._run.credentials, timeout_ms=2000)
        except BusError as error:
            raise RemoteError(f"{name} cannot be reached: {error}") from None
        answer = bus.ask(f"{Keys(self._run.run).op}/{op}", request(op, **fields), timeout_s=ASK_S)
        if answer is None:
            self.close()  # perhaps it is the connection
            raise RemoteError(f"{name} did not answer within {ASK_S:g} s; is it over?")
        values = read_map(answer)
        if "error" in values:
            raise RemoteError(f"{name}: refused: {values['error']}", 2 if values.get("status") == 2 else 3)
        return values

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
            self._bus = None


def ask(run: LiveRun, op: str, **fields: Any) -> dict[str, Any]:
    """Ask the console of a run; `op` is what `fleet.execution.operator.Operator.handle` understands. Raises RemoteError
    if it does not answer in time, or refuses.
    """
    with closing(OpenConnection(run)) as connection:
        return connection.ask(op, **fields)


def _read(directory: Path) -> LiveRun | None:
    """None: there is no connection file that is ours, or another user owns it."""
    try:
        values = parse_json(read_file(directory / CONNECTION, CONNECTION_FILE.bytes), ConnectionFile)
    except (OSError, DamagedFile):
        return None
    credentials = Credentials.from_values(msgspec.structs.asdict(values))
    return LiveRun(directory, values.scenario, values.pid, values.endpoint, values.run, credentials)
