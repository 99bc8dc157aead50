"""The processes that stand for real computers: a `fleet agent` for each vehicle with a `gateway`."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from fleet.errors import FleetError
from fleet.execution.directory import RunDirectory
from fleet.processes.child_start import PARENT_PID_VARIABLE
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.gateway import GatewaySection

STOP_S = 10.0  # `fleet agent` stops its program, and then itself


def agent_options(section: GatewaySection) -> list[str]:
    """What `fleet agent` is told of a gateway."""
    words = [f"--zenoh={section.zenoh}"] if section.zenoh else []
    words += [f"--carry={each}" for each in section.carry]
    words += [f"--udp={port}={where}" for port, where in section.udp.items()]
    if section.modem is not None:
        words.append(f"--modem={section.modem.language}={section.modem.where}")
    return [*words, *([] if section.run is None else [f"--run={shlex.join(section.run)}"])]


class Gateways:
    """The gateways of a run, by vehicle."""

    def __init__(self, scenario: Scenario, directory: RunDirectory, print_line: Callable[[str], None]) -> None:
        """Prepare them; nothing is started. `print_line`: shows the operator what is started."""
        self._sections = {i: its.gateway for i, its in enumerate(scenario.controls, 1) if its.gateway is not None}
        self._directory, self._print_line = directory, print_line
        self._running: dict[int, subprocess.Popen[bytes]] = {}

    def __contains__(self, i: int) -> bool:
        return i in self._sections

    def start(self, i: int, join_file: Path) -> None:
        """Start the gateway of vehicle i, which joins with a file; one of a former life is over by then. Raises
        FleetError: it cannot be started.
        """
        self._end(i)
        options = agent_options(self._sections[i])
        words = [sys.executable, "-m", "fleet", "agent", "--join", str(join_file), "--wait", *options]
        log = self._log(i)
        environment = os.environ | {PARENT_PID_VARIABLE: str(os.getpid())}
        try:
            log.parent.mkdir(parents=True, exist_ok=True)
            with log.open("ab") as out:
                self._running[i] = subprocess.Popen(
                    words, stdin=subprocess.DEVNULL, stdout=out, stderr=out, env=environment, start_new_session=True
                )
        except OSError as error:
            raise FleetError(f"the gateway of vehicle {i} cannot be started: {error.strerror}") from None
        self._print_line(f"agent {i} is a real computer: fleet agent {shlex.join(options)} ({log})")

    def failure(self) -> str:
        """Which gateway has ended with a failure, and its last line; empty: none has."""
        for i, process in self._running.items():
            if process.poll() not in (None, 0):
                log = self._log(i)
                last = (log.read_text("utf-8", "replace").strip().splitlines() or ["(nothing printed)"])[-1]
                return f"the gateway of vehicle {i} ended with status {process.returncode}: {last} ({log})"
        return ""

    def _log(self, i: int) -> Path:
        return self._directory.path / "log" / f"gateway-{i}.log"

    def close(self) -> None:
        """End what is left. They end by themselves with the run, so most are gone."""
        for i in [*self._running]:
            self._end(i)

    def _end(self, i: int) -> None:
        process = self._running.pop(i, None)
        if process is None:
            return
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.5)
        for stop in (process.terminate, process.kill):
            if process.poll() is None:
                stop()
                with suppress(subprocess.TimeoutExpired):
                    process.wait(STOP_S)
