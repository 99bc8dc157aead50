"""What commands take in place of a log, such as the directory of a study or the file of another tool."""

from __future__ import annotations

import atexit
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol

from mcap.records import Schema

from fleet.addon import leave_out, parts
from fleet.errors import FleetError, describe_error
from netem.private_folder import PrivateFolder


class MadeColumns(Protocol):
    """Makes columns of the messages of one topic."""

    nested: bool  # whether a message holds lists of messages

    def __call__(self, data: bytes | bytearray, lengths: Any, /) -> dict[str, Any]: ...


@dataclass(slots=True)
class Recovered:
    """The result of a recovery."""

    path: Path
    out: Path
    messages: int = 0
    until_s: float = 0.0
    undeclared: int = 0  # messages on channels of which nothing is known any more
    lost: str = ""  # what is gone, in words; "" if no message is
    rebuilt: bool = False  # the index was missing
    places: list[str] = field(default_factory=list)

    @property
    def nothing(self) -> bool:
        return not self.messages


class OtherData(ABC):
    """Something that is no log of ours, and that some commands take.

    Attributes:
        name: what it is, in errors: `a study`.
        is_log: every command reads it as a log, by itself or after `write_mcap`.
    """

    name: ClassVar[str]
    is_log: ClassVar[bool] = False

    @abstractmethod
    def recognises(self, path: Path) -> bool:
        """Look whether a file or a directory is of this kind, with as little reading as possible.

        Args:
            path: what the user named; it may not exist.

        Returns:
            Whether it is.
        """

    def write_mcap(self, path: Path, file: Path) -> None:
        """Write it as an MCAP file, which every command then reads as a log.

        Args:
            path: what the user named.
            file: to be written; its folder is there, and goes when the process ends.

        Raises:
            FleetError: there is no such form.
        """
        raise FleetError(f"{path} is {self.name}, and no log")

    def export(self, path: Path, folder: Path, form: str, *, force: bool) -> Path:
        """Write it as one table.

        Args:
            path: what the user named.
            folder: where the table goes.
            form: `csv`, `parquet` or `netcdf`.
            force: replace what is there.

        Returns:
            The file.

        Raises:
            FleetError: there is no such form, or it cannot be written.
        """
        raise FleetError(f"{path} is {self.name}, which cannot be written as {form}")

    def columns(self, topic: str, encoding: str, schema: Schema, fields: frozenset[str] | None) -> MadeColumns | None:
        """What makes columns of the messages of a topic that is not protobuf.

        Args:
            topic: its name.
            encoding: of its messages, as the log states it.
            schema: of its messages, as the log states it: a stranger's text.
            fields: keep only these, as numbers in floating point; None: all.

        Returns:
            A function of messages that stand one behind the other, and of their lengths; None: it knows no such type.
        """
        return None

    def recover(self, path: Path, out: Path | None, on_progress: Callable[[float], None]) -> Recovered | None:
        """Write what is left of it.

        Args:
            path: what the user named.
            out: the file to be written; None: a file beside it.
            on_progress: called with the share that was read, 0 to 1.

        Returns:
            What was found; None: it is recovered as a log is.
        """
        return None


def find_other_data(path: Path) -> OtherData | None:
    """What knows a file or a directory.

    Args:
        path: what the user named.

    Returns:
        The first kind that recognises it; None: no add-on does.
    """
    for made in (each() for each in parts("readers")):
        try:
            if made.recognises(path):
                return made  # type: ignore[no-any-return]
        except OSError:
            continue  # a name that is too long, a folder of others: the command itself tells it
        except Exception as error:
            leave_out(f"{type(made).__module__}:{type(made).__name__}", f"recognises: {describe_error(error)}")
    return None


def columns_of(topic: str, encoding: str, schema: Schema, fields: frozenset[str] | None = None) -> MadeColumns | None:
    """What makes columns of a topic that is not protobuf; None: no add-on knows its type. See `OtherData.columns`."""
    for made in (each() for each in parts("readers")):
        try:
            if (found := made.columns(topic, encoding, schema, fields)) is not None:
                return found  # type: ignore[no-any-return]
        except Exception as error:
            leave_out(f"{type(made).__module__}:{type(made).__name__}", f"columns: {describe_error(error)}")
    return None


def other_data(path: Path) -> OtherData | None:
    """What knows something that is no log.

    Args:
        path: what the user named.

    Returns:
        Its kind; None: it is a log, or no add-on knows it.
    """
    found = find_other_data(path)
    return None if found is None or found.is_log else found


def as_mcap(path: Path) -> Path | None:
    """The MCAP file that an add-on makes of what the core cannot read.

    Args:
        path: what the user named.

    Returns:
        The file, which goes when the process ends; None: no add-on can make one.

    Raises:
        FleetError: it cannot be read.
    """
    found = find_other_data(path)
    if found is None or not found.is_log:
        return None
    return _convert(found, path.absolute(), path.stat().st_mtime_ns)


_MADE: dict[tuple[Path, int], Path] = {}  # by what was named, and when that changed: commands ask more than once


def _convert(kind: OtherData, path: Path, changed_ns: int) -> Path:
    if (path, changed_ns) not in _MADE:
        folder = PrivateFolder("log")
        atexit.register(folder.close)
        file = folder.path / f"{path.stem}.mcap"
        try:
            kind.write_mcap(path, file)
        except FleetError:
            raise
        except Exception as error:
            raise FleetError(f"{path} cannot be read as {kind.name}: {type(error).__name__}: {error}") from error
        _MADE[path, changed_ns] = file
    return _MADE[path, changed_ns]
