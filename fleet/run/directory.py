"""The directory of a run: its log, its result and the logs of its processes; and a `latest` link beside it."""

from __future__ import annotations

import errno
import json
import os
import secrets
import time
from pathlib import Path
from typing import Any

from fleet.errors import FleetError
from netem.whole_file import write_whole

LATEST = "latest"


class RunDirectoryError(FleetError):
    """The run directory cannot be made or written; `status` is 3 where another place would not have been better."""

    def __init__(self, doing: str, error: OSError) -> None:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        if full:
            self.status = 3
        hint = "make room, or choose" if full else "choose"
        super().__init__(f"{doing}: {error.strerror}; {hint} another place with --out DIR")


class RunDirectory:
    """`<out>/<scenario>-<seed>-<UTC time>/` with scenario.yaml, run.mcap, result.json and log/<process>.log."""

    def __init__(self, out: Path, scenario: str, seed: int) -> None:
        """Make the directory.

        Args:
            out: where; it is made as well.
            scenario: its name.
            seed: of the scenario.

        Raises:
            RunDirectoryError: no directory can be made there.
        """
        stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        base = f"{scenario}-{seed}-{stamp}"
        try:
            out.mkdir(parents=True, exist_ok=True)
            self.path = _make_unique(out, base)
            (self.path / "log").mkdir()
        except OSError as error:
            raise RunDirectoryError(f"cannot make a run directory in {out}", error) from error
        self._link_latest(out)

    @property
    def log(self) -> Path:
        return self.path / "run.mcap"

    @property
    def connection(self) -> Path:
        """How to reach the run; mode 0600; it exists only while the run lives."""
        return self.path / "connection.json"

    @property
    def observe(self) -> Path:
        """Where and as whom to subscribe to a published run; mode 0600; it exists only while the run lives."""
        return self.path / "observe.json"

    def join(self, i: int) -> Path:
        """What the external agent i needs to join; mode 0600; it exists only while the run lives."""
        return self.path / f"join-{i}.json"

    def process_log(self, role: str) -> Path:
        return self.path / "log" / f"{role}.log"

    def write_scenario(self, text: str) -> None:
        """Write the merged scenario. Raises RunDirectoryError: there is no room."""
        path = self.path / "scenario.yaml"
        try:
            path.write_text(text, "utf-8")
        except OSError as error:
            raise RunDirectoryError(f"cannot write {path}", error) from error

    def write_result(self, values: dict[str, Any]) -> None:
        (self.path / "result.json").write_text(json.dumps(values, indent=2) + "\n", "utf-8")

    def remove_result(self) -> None:
        """Remove the result: half of one is worse than none."""
        (self.path / "result.json").unlink(missing_ok=True)

    def write_connection(self, values: dict[str, Any]) -> None:
        """Write the connection file. Raises RunDirectoryError: there is no room."""
        try:
            write_whole(self.connection, json.dumps(values).encode())
        except OSError as error:
            raise RunDirectoryError(f"cannot write {self.connection}", error) from error

    def _link_latest(self, out: Path) -> None:
        temporary = out / f".{LATEST}-{secrets.token_hex(4)}"
        try:
            temporary.symlink_to(self.path.name)
            os.replace(temporary, out / LATEST)
        except OSError:
            # A convenience only: the file system has no links, or `latest` is a directory.
            temporary.unlink(missing_ok=True)


def _make_unique(out: Path, base: str) -> Path:
    number = 1
    while True:
        path = out / (base if number == 1 else f"{base}-{number}")
        try:
            path.mkdir()
        except FileExistsError:
            number += 1
        else:
            return path
