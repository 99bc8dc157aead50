"""A vehicle that is given as an FMU: a unit of co-simulation of FMI 2 or 3, behind the interface of plants.

The unit runs in a process of its own, so a crash or an endless loop of its native code does not end the console or the
world. The run then ends with an error that names vehicle and tick, and the log keeps everything up to there. See
docs/guide/fmu.md.
"""

from __future__ import annotations

import subprocess
import sys
import weakref
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ClassVar

import msgpack

from fleet.addons.fmu import fmu_host
from fleet.addons.fmu.fmu_archive import unpack
from fleet.addons.fmu.fmu_description import Description
from fleet.addons.fmu.fmu_variables import COMMAND, CURRENT, MOTION, WRENCH, Variables, describe, variables
from netem.private_folder import PrivateFolder
from world.api import PlantConfig, PlantState, Signal, Vec3, Vec6, Water
from world.errors import FmuError

_LONGEST_S = 60.0  # for any answer of the unit, also where no budget is set
_TOLERANCE = 1e-3  # by how much a unit may begin elsewhere than the scenario says [m, rad, m/s, rad/s]
_NO_LIMIT = 1e9  # [N, N m]; the limits of the scenario hold anyway


def fmu_class(path: Path, parameters: Mapping[str, Any]) -> type[FmuPlant]:
    """The plant that an FMU makes with some parameters. Its description is read, and nothing of it runs. Raises
    FmuError: the file is no FMU for this machine, or has not the variables that the parameters name."""
    model = describe(path)
    known = {"inputs", "outputs", "initial", "start", "signals"}
    if unknown := sorted(parameters.keys() - known):
        raise FmuError(f"there is no parameter {unknown[0]!r}", f"known: {', '.join(sorted(known))}")
    found = variables(model, **parameters)

    class Unit(FmuPlant):
        plugin_file = path
        facts = model
        uses = found
        signals = tuple(signal for signal, _ in found.signals)

    return Unit


class FmuPlant:
    """A vehicle inside an FMU. Its state is the time [s] and the outputs; the rest is inside the unit."""

    plugin_file: ClassVar[Path]  # by which the log knows it again
    facts: ClassVar[Description]
    uses: ClassVar[Variables]
    signals: ClassVar[tuple[Signal, ...]] = ()

    def __init__(
        self,
        config: PlantConfig,
        inputs: Any = None,
        outputs: Any = None,
        initial: Any = None,
        start: Any = None,
        signals: Any = None,
    ) -> None:
        """Unpack the unit, start its process and make the instance; what the parameters name is in `uses` already."""
        uses, facts = self.uses, self.facts
        self._outputs = [*uses.outputs.values(), *(variable for _, variable in uses.signals)]
        self._at = {key: place for place, key in enumerate(uses.outputs, start=1)}  # in the state, behind the time
        self._missing = [  # parts of the water that the unit does not take: our name, whether current, place there
            (key, group is CURRENT, place)
            for group in (CURRENT, WRENCH)
            for place, key in enumerate(group)
            if key not in uses.inputs and key not in uses.ignored
        ]
        largest = [uses.inputs[key].largest for key in COMMAND]
        x, y, z = (_NO_LIMIT if limit is None or limit < 0.0 else min(limit, _NO_LIMIT) for limit in largest)
        self.limits: Vec3 = (x, y, z)
        try:
            private = PrivateFolder("fmu")
        except OSError as error:
            raise FmuError(f"cannot be unpacked: {error.strerror} ({error.filename})", "set TMPDIR") from None
        folder = private.path
        try:
            unpack(self.plugin_file, folder)
            self._process, self._connection = _start(private)
        except BaseException:
            private.close()
            raise
        self._close = weakref.finalize(self, _end, self._process, self._connection, private)
        self._ask(
            "open",
            facts.version,
            facts.model,
            facts.guid,
            str(folder),
            facts.library,
            [variable.reference for variable in uses.initial.values()],
            uses.start,
            [variable.reference for variable in uses.inputs.values()],
            [variable.reference for variable in self._outputs],
        )

    def start(self, pose: Vec6, velocity: Vec6) -> PlantState:
        wanted = dict(zip(MOTION, (*pose, *velocity), strict=True))
        initial = self.uses.initial
        state = (0.0, *self._values(self._ask("start", [wanted[key] / v.factor for key, v in initial.items()])))
        for key, value in wanted.items():
            begins = self._output(state, key)
            if abs(begins - value) > _TOLERANCE:
                unit = MOTION[key]
                hint = f"map initial.{key} to a parameter of the unit that sets it"
                if key in initial:
                    hint = f"initial.{key} does not set it"
                elif key not in self._at:
                    hint = "the unit has no roll"
                raise FmuError(f"begins with {key} = {begins:g} {unit}, the scenario with {value:g} {unit}", hint)
        return state

    def step(self, state: PlantState, tau: Vec3, water: Water, dt: float) -> PlantState:
        for key, of_current, place in self._missing:
            if (water.current if of_current else water.wrench)[place]:
                what = "current" if of_current else "wrench"
                hint = f"map inputs.{key}, or write inputs: {{{what}: none}} where it is not to feel it"
                raise FmuError(f"takes no {key}, and the sea has one", hint)
        given = dict(zip((*COMMAND, *CURRENT, *WRENCH), (*tau, *water.current, *water.wrench), strict=True))
        inputs = [given[key] / variable.factor for key, variable in self.uses.inputs.items()]
        return (state[0] + dt, *self._values(self._ask("step", state[0], dt, inputs)))

    def pose(self, state: PlantState) -> Vec6:
        out = self._output
        return (
            out(state, "x"),
            out(state, "y"),
            out(state, "z"),
            out(state, "phi"),
            out(state, "theta"),
            out(state, "psi"),
        )

    def velocity(self, state: PlantState) -> Vec6:
        out = self._output
        return out(state, "u"), out(state, "v"), out(state, "w"), out(state, "p"), out(state, "q"), out(state, "r")

    def report(self, state: PlantState) -> Mapping[str, float]:
        first = 1 + len(self._at)
        return {signal.name: state[first + k] for k, signal in enumerate(self.signals)}

    def close(self) -> None:
        self._close()

    def _output(self, state: PlantState, key: str) -> float:
        return state[self._at[key]] if key in self._at else 0.0

    def _values(self, outputs: list[float]) -> list[float]:
        return [value * variable.factor for value, variable in zip(outputs, self._outputs, strict=True)]

    def _ask(self, verb: str, *values: Any) -> Any:
        """The answer of the unit's process. Raises FmuError: the unit failed, ended its process, or did not answer.
        After the last two it is not used again."""
        if not self._close.alive:
            raise FmuError("was ended after it failed")
        try:
            self._connection.send_bytes(msgpack.packb([verb, values]))
            if not self._connection.poll(_LONGEST_S):
                raise FmuError(f"did not answer within {_LONGEST_S:g} s, and was ended")
            good, answer = msgpack.unpackb(self._connection.recv_bytes())
        except (EOFError, OSError):
            status = self._process.wait()
            self._close()
            why = f"by signal {-status}" if status < 0 else f"with status {status}"
            raise FmuError(f"ended its process {why}", "the unit crashed, or ended the program") from None
        except BaseException:  # also the alarm of a budget: what it answers later would be taken for another answer
            self._close()
            raise
        if not good:
            raise FmuError(answer)
        return answer


def _start(private: PrivateFolder) -> tuple[subprocess.Popen[bytes], Connection]:
    ours, theirs = Pipe()
    with theirs:
        number = theirs.fileno()
        command = [sys.executable, "-P", fmu_host.__file__, str(number), str(private.path)]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=2, pass_fds=(number, private.lock), start_new_session=True
        )
    return process, ours


def _end(process: subprocess.Popen[bytes], connection: Connection, private: PrivateFolder) -> None:
    connection.close()
    process.kill()
    process.wait()
    if process.stdin is not None:
        process.stdin.close()
    private.close()
