"""The process that runs an FMU. An FMU is native code, so it may crash, print, or never return.

The process runs this file as a script, and imports nothing of this package. It answers requests on a connection until
the other side closes it. If its standard input ends, the process that started it no longer exists. It then removes the
unpacked unit and ends, even if the unit is busy.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgpack

_LINES = 3  # of what the unit says that an error quotes


class _Said:
    """Takes what fmpy prints of the unit's messages: it goes on to standard error, and errors quote its end."""

    def __init__(self) -> None:
        self.lines: deque[str] = deque(maxlen=_LINES)

    def write(self, text: str) -> int:
        self.lines.extend(line[:200] for line in text.splitlines() if line.strip())
        return sys.stderr.write(text)

    def flush(self) -> None:
        sys.stderr.flush()


class _Unit:
    def __init__(
        self,
        version: int,
        name: str,
        guid: str,
        folder: str,
        library: str,
        initial: list[int],
        start: list[tuple[str, int, Any]],
        inputs: list[int],
        outputs: list[int],
    ) -> None:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        self._version, self._initial, self._start = version, initial, start
        self._inputs, self._outputs = inputs, outputs
        slave = FMU2Slave if version == 2 else FMU3Slave
        self._fmu = slave(
            guid=guid,
            modelIdentifier=name,
            unzipDirectory=folder,
            instanceName=name,
            libraryPath=os.path.join(folder, library),
        )
        self._get = self._fmu.getReal if version == 2 else self._fmu.getFloat64
        self._set = self._fmu.setReal if version == 2 else self._fmu.setFloat64
        self._fmu.instantiate()
        self._begun = False

    def start(self, initial: list[float]) -> list[float]:
        fmu = self._fmu
        if self._begun:
            fmu.reset()
        for setter, reference, value in self._start:
            getattr(fmu, setter)([reference], [value])
        if self._initial:
            self._set(self._initial, initial)
        if self._version == 2:
            fmu.setupExperiment(startTime=0.0)
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=0.0)
        fmu.exitInitializationMode()
        self._begun = True
        return list(self._get(self._outputs))

    def step(self, time_s: float, dt_s: float, inputs: list[float]) -> list[float]:
        if self._inputs:
            self._set(self._inputs, inputs)
        answer = self._fmu.doStep(currentCommunicationPoint=time_s, communicationStepSize=dt_s)
        if answer is not None and answer[1]:  # FMI 3: event, terminate, returned early, last time
            raise RuntimeError("asks to end the simulation")
        return list(self._get(self._outputs))


def _end_with_parent(folder: str) -> threading.Thread:
    def watch() -> None:
        while os.read(0, 1):
            pass
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread


def main(number: int, folder: str) -> None:
    """Answer the requests on the connection of a file descriptor, about the unit that is unpacked in a folder."""
    end = _end_with_parent(str(Path(folder).resolve()))
    said = _Said()
    sys.stdout = said
    connection = Connection(number)
    unit: _Unit | None = None
    while True:
        try:
            verb, values = msgpack.unpackb(connection.recv_bytes())
        except EOFError:
            end.join()  # it has more to do than to end
            return
        said.lines.clear()
        try:
            if unit is None:
                unit, answer = _Unit(*values), None
            else:
                method: Callable[..., Any] = getattr(unit, verb)
                answer = method(*values)
        except Exception as error:  # whatever fmpy raises: the other side names vehicle and tick
            text = str(error).splitlines()[0] if str(error) else type(error).__name__
            connection.send_bytes(msgpack.packb([False, ": ".join([text[:300].rstrip("."), *said.lines])]))
        else:
            connection.send_bytes(msgpack.packb([True, answer]))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
