"""The world's place in the lockstep: navs out, commands in, ticks integrated, frames for the log.

A pure state machine: messages in, addressed messages out. Vehicles touch each other only through netem, so
each runs ahead on its own (nav, command, integrate, nav ...) as far as the clock's grant allows; netem holds an
agent back at the round's end until everyone has transmitted. A frame leaves once every vehicle is past it.
"""

from __future__ import annotations

from typing import NamedTuple

from netem.errors import OutOfPlace
from netem.messages import Command, Frame, Nav, Round, VehicleFrame, encode
from world.config import WorldConfig
from world.errors import IntegrationError
from world.sea import World
from world.vehicle import Vec3

STILL: Vec3 = (0.0, 0.0, 0.0)


class NavTo(NamedTuple):
    """A nav addressed to agent `id`."""

    id: int
    nav: Nav


Out = NavTo | Round | Frame


class Lockstep:
    """Feeds `World` with commands and hands out what follows from each."""

    def __init__(self, config: WorldConfig, *, frame_every: int = 1) -> None:
        self.config = config
        self.world = World(config)
        self._ids = self.world.ids
        self._telemetry_size = {setup.id: setup.telemetry_size for setup in config.vehicles}
        self._frame_every = frame_every
        self._granted = 0
        self._incarnation = dict.fromkeys(self._ids, 0)
        self._awaiting: dict[int, Nav] = {}
        self._rows: dict[int, list[VehicleFrame]] = {}  # frames being assembled, by tick
        self._decided: dict[int, int] = {}  # round tick -> vehicles that are past it, alive or not
        self._positions: dict[int, dict[int, tuple[float, ...]]] = {}  # of those alive at a round tick
        self._died: dict[int, int] = dict(config.kills)  # vehicle -> first tick without an agent
        self._lost: set[int] = set()  # vehicles that are not integrated any more
        self.notes: list[tuple[int, int, str]] = []  # (vehicle, tick, text) for a person; whoever reads empties it
        self._framed = 0  # next tick whose frame has not left

    @property
    def waiting_for(self) -> list[tuple[int, int]]:
        """(vehicle, tick) of every command that is due, the furthest behind first."""
        return sorted(((i, nav.tick) for i, nav in list(self._awaiting.items())), key=lambda w: (w[1], w[0]))

    @property
    def finished(self) -> bool:
        """Whether the state at the end tick exists for every vehicle and its frame has left."""
        return self._framed > self.config.ticks

    def tick_of(self, i: int) -> int:
        """The tick vehicle i has reached."""
        return self.world.tick(i)

    def grant(self, until: int) -> list[Out]:
        """Ticks below `until` may be started; a smaller grant than before changes nothing."""
        self._granted = max(self._granted, min(until, self.config.ticks))
        return [out for i in self._ids for out in self._start(i)] + self._frames()

    def end(self, i: int, incarnation: int, tick: int = 0) -> list[Out]:
        """Vehicle i's agent ends at `tick`, or has ended: from the first tick without a command it drifts."""
        if incarnation != self._incarnation[i] or self.dead(i):
            return []
        nav = self._awaiting.get(i)
        missing = self.tick_of(i) if nav is None else nav.tick
        self._died[i] = max(tick, missing)
        if tick <= missing:
            self._awaiting.pop(i, None)
        return self._start(i) + self._frames()

    def dead(self, i: int) -> bool:
        """Whether vehicle i has no agent at the tick it has reached."""
        return self._died.get(i, self.config.ticks + 1) <= self.tick_of(i)

    def command(self, i: int, command: Command, raw: bytes | None = None) -> list[Out]:
        """Take vehicle i's command, advance it by one tick and say what follows.

        Args:
            raw: the encoded command if the caller has it, to save encoding it again for the frame.

        Raises:
            OutOfPlace: the command does not answer the nav that is waiting for one.
        """
        nav = self._awaiting.get(i)
        if command.incarnation != self._incarnation[i]:
            raise OutOfPlace("incarnation", self._incarnation[i], command.incarnation)
        if nav is None:
            raise OutOfPlace("tick", "no command (no nav is unanswered)", command.tick)
        if command.tick != nav.tick:
            raise OutOfPlace("tick", nav.tick, command.tick)
        size = self._telemetry_size[i]
        if size not in (None, len(command.telemetry)):
            raise OutOfPlace("telemetry values", size, len(command.telemetry))
        del self._awaiting[i]
        world, k = self.world, nav.tick
        eta, nu = world.state(i)
        tau = world.actuate(i, command.tau)
        if k % self._frame_every == 0:
            row = VehicleFrame(i, eta, nu, nav.eta + nav.nu, tau, encode(command) if raw is None else raw)
            self._rows.setdefault(k, []).append(row)
        return self._pass(i, k, tau, eta[:3]) + self._start(i) + self._frames()

    def _pass(self, i: int, k: int, tau: Vec3, alive_at: tuple[float, ...] | None) -> list[Out]:
        """Take vehicle i over tick k; `alive_at` is where it is if its agent is alive."""
        out: list[Out] = []
        if k % self.config.round_ticks == 0:
            positions = self._positions.setdefault(k, {})
            if alive_at is not None:
                positions[i] = alive_at
            self._decided[k] = self._decided.get(k, 0) + 1
            if self._decided[k] == len(self._ids):
                del self._decided[k], self._positions[k]
                alive = tuple(sorted(positions))
                out.append(Round(k, alive, tuple(positions[j] for j in alive)))
        if i in self._lost:
            self.world.hold(i)
        else:
            try:
                self.world.advance(i, tau)
            except IntegrationError as error:
                if not self.config.keep_going:
                    raise
                self._lost.add(i)
                self._died[i] = min(self._died.get(i, k + 1), k + 1)
                self.notes.append((i, k, f"{error.reason}: the vehicle is lost and stays where it is"))
                self.world.hold(i)
        if k + 1 == self.config.ticks:
            self._rows.setdefault(k + 1, []).append(VehicleFrame(i, *self.world.state(i), (), (), b""))
        return out

    def _start(self, i: int) -> list[Out]:
        """What vehicle i may do now: measure, or drift as far as the grant allows when it has no agent."""
        out: list[Out] = []
        k = self.world.tick(i)
        while k < self._granted and self.dead(i):
            eta, nu = self.world.state(i)
            if k % self._frame_every == 0:
                self._rows.setdefault(k, []).append(VehicleFrame(i, eta, nu, (), STILL, b""))
            out += self._pass(i, k, STILL, None)
            k += 1
        if i in self._awaiting or k >= self._granted or self.dead(i):
            return out
        nav = Nav(self._incarnation[i], k, *self.world.sense(i))
        self._awaiting[i] = nav
        return [*out, NavTo(i, nav)]

    def _frames(self) -> list[Out]:
        out: list[Out] = []
        while (rows := self._rows.get(self._framed)) is not None and len(rows) == len(self._ids):
            del self._rows[self._framed]
            rows.sort()
            out.append(Frame(self._framed, False, tuple(rows)))
            last = self.config.ticks
            self._framed = min(last, self._framed + self._frame_every) if self._framed < last else last + 1
        return out
