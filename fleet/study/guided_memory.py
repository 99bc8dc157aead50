"""The file of a guided search: its full state, so that the search can continue after an interruption."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct

from fleet.study.engine import Row
from fleet.study.errors import StudyError
from fleet.study.moves import Fault
from fleet.study.shrink import Tree
from netem.private_file import read_file, write_whole

FORMAT = 1
# The names in a row that a search looks at begin with these.
ROW_KEYS = ("key", "seed", "seen", "status", "reason", "digest", "version", "check.", "value.", "margin.", "at.",
            "sometimes.")  # fmt: skip
_MOST_BYTES = 64_000_000


class KnownRun(NamedTuple):
    """A run that was made, and that is worth changing."""

    tree: Tree
    drawn: list[Fault]  # its faults but those that the scenario has itself
    margins: dict[str, tuple[float, float | None]]  # by check: the margin, and when it was least [s]


class GuidedMemory(Struct, kw_only=True):
    """The values that determine all further generations."""

    format: int = FORMAT
    key: str  # of the scenario and the check
    number: int  # of the next generation
    next_seed: int
    nearest: dict[str, list[KnownRun]]
    novel: list[KnownRun]
    seen: list[int]
    spread: dict[str, list[float]]
    failed: list[str]
    fresh: list[list[dict[str, Any]]]
    runs: int
    without: int
    reason: str
    kinds: dict[str, int]
    reached: dict[str, tuple[int, int, int | None]]
    first: tuple[str, int, str] | None  # the first scenario that failed, its seed, and the check
    rows: list[Row] = []  # of that generation, as far as it was made


class GuidedMemoryFile:
    """The file. It may come from anybody, so it is read with bounds."""

    def __init__(self, folder: Path, name: str, key: str) -> None:
        """Prepare it; `key`: of the scenario and the check."""
        self.path = folder / f"{name}.guide.msgpack"
        self._key = key

    def read(self) -> GuidedMemory | None:
        """Read the file. None: there is no file yet.

        Raises:
            StudyError: it is damaged, or belongs to another search.
        """
        try:
            known = msgspec.msgpack.decode(read_file(self.path, _MOST_BYTES), type=GuidedMemory)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StudyError(f"{self.path} cannot be read: {error.strerror}") from None
        except (msgspec.MsgspecError, ValueError) as error:
            raise StudyError(f"{self.path} is damaged: {error!s:.200}") from None
        if known.format != FORMAT:
            raise StudyError(f"{self.path} has format {known.format}, expected {FORMAT}: a later fleet wrote it")
        if known.key != self._key:
            raise StudyError(f"{self.path} belongs to another search: choose another folder, or remove that file")
        return known

    def write(self, memory: GuidedMemory) -> None:
        """Write what is known. Raises StudyError."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, msgspec.msgpack.encode(memory), 0o644)
        except OSError as error:
            raise StudyError(f"{self.path} cannot be written: {error.strerror}") from None
