"""The world's place in the lockstep: navs out, commands in, ticks integrated, frames for the log.

A pure state machine: messages in, addressed messages out. Vehicles touch each other only through netem. So each runs
ahead on its own (nav, command, integrate, nav ...) as far as the clock's grant allows. Netem holds an agent back at the
round's end until everyone has transmitted. A frame leaves once every vehicle is past it.
"""

from __future__ import annotations

from typing import NamedTuple

from netem.errors import OutOfPlace
from netem.wire.codec import encode
from netem.wire.messages import Command, Frame, Nav, Round
from world.config import WorldConfig
from world.run_state import NOT_SENSED, RunState
from world.vectors import ZERO, Vec3


class NavTo(NamedTuple):
    """A nav addressed to agent `id`."""

    id: int
    nav: Nav


Out = NavTo | Round | Frame


class Lockstep:
    """Takes commands for the vehicles, and returns the messages that follow from each command."""

    def __init__(self, config: WorldConfig, *, frame_every: int = 1) -> None:
        self.config = config
        self.state = RunState(config, frame_every)
        self._awaiting: dict[int, Nav] = {}
        self._decided: dict[int, int] = {}  # round tick -> how many vehicles are past it, with an agent or without
        # By round tick: positions of the vehicles with an agent.
        self._positions: dict[int, dict[int, tuple[float, ...]]] = {}
        self._paused: dict[int, list[int]] = {}  # round tick -> those that are suspended in it
        self._round_ticks = config.round_ticks

    @property
    def waiting_for(self) -> list[tuple[int, int]]:
        """(vehicle, tick) of every command that is due, the furthest behind first."""
        return sorted(((i, nav.tick) for i, nav in list(self._awaiting.items())), key=lambda w: (w[1], w[0]))

    @property
    def finished(self) -> bool:
        """Whether the state at the end tick exists for every vehicle and its frame has left."""
        return self.state.frames.finished

    def grant(self, until: int) -> list[Out]:
        """Ticks below `until` may be started; a smaller grant than before changes nothing."""
        self.state.grant(until)
        out: list[Out] = []
        for i in self.state.ids:
            self._start(i, out)
        return self._with_frames(out)

    def end(self, i: int, incarnation: int, until: int | None = None) -> list[Out]:
        """Vehicle i's agent has ended: from the first tick without a command it drifts. `until`: another agent takes
        over at this tick. None: as planned.
        """
        state = self.state
        if incarnation != state.incarnation(i) or state.lacks_agent(i):
            return []
        nav = self._awaiting.pop(i, None)
        tick = state.tick_of(i) if nav is None else nav.tick
        state.lives.end(i, tick, until)
        out: list[Out] = []
        self._start(i, out)
        return self._with_frames(out)

    def command(self, i: int, command: Command, raw: bytes | None = None) -> list[Out]:
        """Take vehicle i's command, advance it by one tick and return what follows. `raw`: the encoded command, if
        there, to save encoding it again. Raises OutOfPlace if it does not answer the nav that is waiting for one.
        """
        state = self.state
        nav = self._awaiting.get(i)
        state.check(i, command)
        if nav is None:
            raise OutOfPlace("tick", "no command (no nav is unanswered)", command.tick)
        if command.tick != nav.tick:
            raise OutOfPlace("tick", nav.tick, command.tick)
        del self._awaiting[i]
        world, k = state.world, nav.tick
        if command.said:
            command, raw = state.listen(i, k, command), None
        place = world.position(i)
        tau = world.actuate(i, state.effective(i, k, command.tau))
        if state.frames.due(k):
            sent = encode(command) if raw is None else raw
            state.frames.row(k, state.row(i, (nav.eta + nav.nu + nav.roll, nav.belief), tau, sent))
        out: list[Out] = []
        self._pass(i, k, tau, place, out)
        self._start(i, out)
        return self._with_frames(out)

    def take_over(self, tick: int, before: Lockstep) -> None:
        """Go on at a tick with the vehicles of another run, which have reached it."""
        self.state.take_over(tick, before.state)

    def _pass(self, i: int, k: int, tau: Vec3, alive_at: Vec3 | None, out: list[Out], *, paused: bool = False) -> None:
        """Take vehicle i over tick k; `alive_at` is where it is if it has an agent."""
        if k % self._round_ticks == 0:
            positions = self._positions.setdefault(k, {})
            if alive_at is not None:
                positions[i] = alive_at
            if paused:
                self._paused.setdefault(k, []).append(i)
            self._decided[k] = self._decided.get(k, 0) + 1
            if self._decided[k] == len(self.state.ids):
                del self._decided[k], self._positions[k]
                alive = tuple(sorted(positions))
                suspended = tuple(sorted(self._paused.pop(k, ())))
                out.append(Round(k, alive, tuple(positions[j] for j in alive), suspended))
        self.state.integrate(i, k, tau)

    def _start(self, i: int, out: list[Out]) -> None:
        """Measure. Without an agent, or with a suspended one, vehicle i goes on as far as the grant allows."""
        state, world = self.state, self.state.world
        k = world.tick(i)
        while k < state.granted and i not in self._awaiting:
            absent = state.enter_tick(i, k)
            if not absent and not world.paused(i, k):
                self._awaiting[i] = nav = state.nav(i, state.life[i], k)
                out.append(NavTo(i, nav))
                return
            place = world.position(i)
            tau = ZERO if absent else world.actuate(i, state.tau[i])
            if state.frames.due(k):
                state.frames.row(k, state.row(i, NOT_SENSED, tau, b""))
            self._pass(i, k, tau, None if absent else place, out, paused=not absent)
            k += 1

    def _with_frames(self, out: list[Out]) -> list[Out]:
        out += self.state.frames.complete()
        return out
