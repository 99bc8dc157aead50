"""The world's place in the lockstep: navs out, commands in, ticks integrated, frames for the log.

A pure state machine: messages in, addressed messages out. Vehicles touch each other only through netem, so
each runs ahead on its own (nav, command, integrate, nav ...) as far as the clock's grant allows; netem holds an
agent back at the round's end until everyone has transmitted. A frame leaves once every vehicle is past it.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import msgpack

from netem.errors import OutOfPlace
from netem.lives import Absence, Lives
from netem.wire.messages import Command, Frame, Life, Memory, Nav, Round, Tumble, VehicleFrame, encode
from world.config import WorldConfig
from world.errors import IntegrationError
from world.sea import World
from world.tumble import tumbles
from world.vectors import Vec3

STILL: Vec3 = (0.0, 0.0, 0.0)
DIVERGED = "diverged"  # in a memory


class NavTo(NamedTuple):
    """A nav addressed to agent `id`."""

    id: int
    nav: Nav


Out = NavTo | Round | Frame
_Change = TypeVar("_Change")


class Lockstep:
    """Feeds `World` with commands and hands out what follows from each."""

    def __init__(self, config: WorldConfig, *, frame_every: int = 1) -> None:
        self.config = config
        self.world = World(config)
        self._ids = self.world.ids
        self._telemetry_size = {setup.id: setup.telemetry_size for setup in config.vehicles}
        self._frame_every = frame_every
        self._granted = 0
        self.lives = Lives(config.absences)
        self._absent: set[int] = set()  # vehicles without an agent at the tick they have reached
        self._life = dict.fromkeys(self._ids, 0)  # which life of its agent each vehicle was in at the tick before
        self._changes: dict[int, list[Life]] = {}  # what happened to agents, by the frame that tells it
        self._awaiting: dict[int, Nav] = {}
        self._rows: dict[int, list[VehicleFrame]] = {}  # frames being assembled, by tick
        self._decided: dict[int, int] = {}  # round tick -> vehicles that are past it, alive or not
        self._positions: dict[int, dict[int, tuple[float, ...]]] = {}  # of those alive at a round tick
        self._paused: dict[int, list[int]] = {}  # round tick -> those that are suspended in it
        self._tau: dict[int, Vec3] = dict.fromkeys(self._ids, STILL)  # the last command that took effect
        self._late: dict[int, dict[int, Vec3]] = {i: {} for i in self._ids}  # commands of those that are slow
        self._diverged: set[int] = set()  # vehicles that are not integrated any more
        self._limits = {setup.id: setup.tumble_limit for setup in config.vehicles}
        self._tick_s = config.tick_ns / 1e9
        self._tumbles: dict[int, list[Tumble]] = {}  # who tumbled or came back, by the frame that tells it
        self._tumbled: set[int] = set()
        self._spells: dict[int, tuple[int, int]] = {}  # how often each has tumbled, and since when the last time
        for i in self._ids:
            at_start = self.world.pitch(i)
            self._watch(i, 0, at_start, at_start)
        self._memory: dict[int, dict[int, list[Any]]] = {}  # by tick and vehicle, before that tick
        self._agents: dict[int, bytes] = {}  # what an agent told that it remembers, before the command it owes
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

    def end(self, i: int, incarnation: int, until: int | None = None) -> list[Out]:
        """Vehicle i's agent has ended: from the first tick without a command it drifts.

        Args:
            until: the tick at which another one takes over, if it is to be another than what was planned.
        """
        if incarnation != self.incarnation(i) or self.dead(i):
            return []
        nav = self._awaiting.pop(i, None)
        tick = self.tick_of(i) if nav is None else nav.tick
        if i in self._memory.get(tick, {}):
            self._memory[tick][i][-1] = b""
        if until is None:
            self.lives.end(i, tick)
        else:
            self.lives.add(Absence(i, tick, until))
        return self._start(i) + self._frames()

    def dead(self, i: int) -> bool:
        """Whether vehicle i has no agent at the tick it has reached."""
        return i in self._diverged or self.lives.without_agent(i, self.tick_of(i))

    def incarnation(self, i: int) -> int:
        """Which life of its agent vehicle i is in at the tick it has reached."""
        return self.lives.incarnation(i, self.tick_of(i))

    def command(self, i: int, command: Command, raw: bytes | None = None) -> list[Out]:
        """Take vehicle i's command, advance it by one tick and say what follows.

        Args:
            raw: the encoded command if the caller has it, to save encoding it again for the frame.

        Raises:
            OutOfPlace: the command does not answer the nav that is waiting for one.
        """
        nav = self._awaiting.get(i)
        self._check(i, command)
        if nav is None:
            raise OutOfPlace("tick", "no command (no nav is unanswered)", command.tick)
        if command.tick != nav.tick:
            raise OutOfPlace("tick", nav.tick, command.tick)
        del self._awaiting[i]
        world, k = self.world, nav.tick
        if (told := self._agents.pop(i, None)) is not None and i in self._memory.get(k, {}):
            self._memory[k][i][-1] = told
        eta, nu = world.state(i)
        tau = world.actuate(i, self._effective(i, k, command.tau))
        if k % self._frame_every == 0:
            row = VehicleFrame(i, eta, nu, nav.eta + nav.nu, tau, encode(command) if raw is None else raw)
            self._rows.setdefault(k, []).append(row)
        return self._pass(i, k, tau, eta[:3]) + self._start(i) + self._frames()

    def _check(self, i: int, command: Command) -> None:
        self.lives.check(i, self.tick_of(i), command.incarnation)
        size = self._telemetry_size[i]
        if command.telemetry and size not in (None, len(command.telemetry)):
            raise OutOfPlace("telemetry values", size, len(command.telemetry))

    def remember(self, i: int, memory: Memory) -> None:
        """Take what agent i remembers before the command that it owes.

        Raises:
            OutOfPlace: it owes none for that tick.
        """
        nav = self._awaiting.get(i)
        if nav is None or (memory.incarnation, memory.tick) != (nav.incarnation, nav.tick):
            raise OutOfPlace("memory of tick", "none" if nav is None else nav.tick, memory.tick)
        self._agents[i] = memory.state

    def resume(self, tick: int, memory: dict[str, Any]) -> None:
        """Go on at a tick with what was remembered before it in another run of the same vehicles."""
        for told in (self._tumbled, self._tumbles, self._spells):
            told.clear()
        for i, vehicle, tau, late, state, _ in memory["vehicles"]:
            self.world.remember(i, vehicle)
            self._tau[i] = (tau[0], tau[1], tau[2])
            self._late[i] = {k: (x, y, z) for k, (x, y, z) in late}
            if state == DIVERGED:
                self._diverged.add(i)
            elif isinstance(state, list):  # older logs have a plain yes for a vehicle that was given up: it goes on
                tumbled, *spell = state
                self._spells[i] = (spell[0], spell[1])
                self._tumbled |= {i} if tumbled else set()
        self._absent = self._diverged | {i for i in self._ids if self.lives.without_agent(i, tick - 1)}
        self._life = {i: self.lives.incarnation(i, tick - 1) for i in self._ids}
        self._framed = tick

    def _keep(self, i: int, k: int, *, asked: bool) -> None:
        """Remember vehicle i as it is before tick k; its agent, if it is asked, has still to tell."""
        every = self.config.memory_ticks
        if every and k % every == 0 and k:
            late = [[tick, list(tau)] for tick, tau in sorted(self._late[i].items())]
            self._memory.setdefault(k, {})[i] = [
                i, self.world.memory(i), list(self._tau[i]), late, self._state(i), None if asked else b"",
            ]  # fmt: skip

    def _kept(self, k: int) -> bytes:
        """All that is to be remembered before tick k; nothing if an agent has not told, or is suspended."""
        kept = self._memory.pop(k, {})
        whole = len(kept) == len(self._ids) and all(vehicle[-1] is not None for vehicle in kept.values())
        return msgpack.packb({"vehicles": [kept[i] for i in self._ids]}) if whole else b""

    def _state(self, i: int) -> str | list[int] | bool:
        """What a memory says of vehicle i: that it diverged; or whether it is tumbled, how often, since when."""
        if i in self._diverged:
            return DIVERGED
        return [int(i in self._tumbled), *self._spells[i]] if i in self._spells else False

    def _effective(self, i: int, k: int, tau: tuple[float, ...]) -> tuple[float, ...]:
        """The command that takes effect at tick k: that of some ticks ago when the agent is slow."""
        late = self._late[i]
        delay = self.world.slow(i, k)
        if delay or late:
            x, y, z = tau
            late[k] = (x, y, z)
            due = [tick for tick in late if tick <= k - delay]
            for tick in due[:-1]:
                del late[tick]
            if not delay:
                late.clear()
            tau = (late[due[-1]] if due else self._tau[i]) if delay else tau
        x, y, z = tau
        self._tau[i] = (x, y, z)
        return tau

    def _pass(
        self, i: int, k: int, tau: Vec3, alive_at: tuple[float, ...] | None, *, paused: bool = False
    ) -> list[Out]:
        """Take vehicle i over tick k; `alive_at` is where it is if its agent is alive."""
        out: list[Out] = []
        if k % self.config.round_ticks == 0:
            positions = self._positions.setdefault(k, {})
            if alive_at is not None:
                positions[i] = alive_at
            if paused:
                self._paused.setdefault(k, []).append(i)
            self._decided[k] = self._decided.get(k, 0) + 1
            if self._decided[k] == len(self._ids):
                del self._decided[k], self._positions[k]
                alive = tuple(sorted(positions))
                silent = tuple(sorted(self._paused.pop(k, ())))
                out.append(Round(k, alive, tuple(positions[j] for j in alive), silent))
        self._integrate(i, k, tau)
        return out

    def _integrate(self, i: int, k: int, tau: Vec3) -> None:
        """Vehicle i from tick k to the next; one whose motion leaves the finite numbers ends."""
        if i in self._diverged:
            self.world.hold(i)
        else:
            before = self.world.pitch(i)
            try:
                self.world.advance(i, tau)
            except IntegrationError as error:
                if not self.config.keep_going:
                    raise
                self._diverged.add(i)
                if i in self._absent:
                    self._told(self._changes, k + 1).append(Life(k + 1, i, False, True))  # else its agent ends with it
                self.notes.append((i, k, f"error: {error.reason}; vehicle {i} is not integrated any more"))
                self.world.hold(i)
            else:
                self._watch(i, k + 1, before, self.world.pitch(i))
        if k + 1 == self.config.ticks:
            self._rows.setdefault(k + 1, []).append(VehicleFrame(i, *self.world.state(i), (), (), b""))

    def _watch(self, i: int, k: int, before: tuple[float, float], after: tuple[float, float]) -> None:
        """Tell when vehicle i begins to tumble, and when it has come back."""
        tumbled = i in self._tumbled
        if tumbles(tumbled, self._limits[i], before, after, self._tick_s) != tumbled:
            self._tumbled ^= {i}
            if not tumbled:
                self._spells[i] = self._spells.get(i, (0, 0))[0] + 1, k
            self._told(self._tumbles, k).append(Tumble(k, i, not tumbled, self._spells[i][0]))

    def _start(self, i: int) -> list[Out]:
        """What vehicle i may do now: measure; or, when it has no agent or that is suspended, go on without it as far
        as the grant allows."""
        out: list[Out] = []
        k = self.world.tick(i)
        while k < self._granted and i not in self._awaiting:
            dead = self._is_dead(i, k)
            self._keep(i, k, asked=not dead)
            if not dead and not self.world.paused(i, k):
                nav = Nav(self.lives.incarnation(i, k), k, *self.world.sense(i))
                self._awaiting[i] = nav
                return [*out, NavTo(i, nav)]
            eta, nu = self.world.state(i)
            tau = STILL if dead else self.world.actuate(i, self._tau[i])
            if k % self._frame_every == 0:
                self._rows.setdefault(k, []).append(VehicleFrame(i, eta, nu, (), tau, b""))
            out += self._pass(i, k, tau, None if dead else eta[:3], paused=not dead)
            k += 1
        return out

    def _is_dead(self, i: int, k: int) -> bool:
        """Whether vehicle i has no agent at tick k; the frame that follows tells when that changes."""
        # A vehicle that diverged has none for good: lives stay those that the console and netem know of.
        diverged = i in self._diverged
        dead = diverged or self.lives.without_agent(i, k)
        life = self.lives.incarnation(i, k)
        stillborn = dead and i in self._absent - self._diverged and life > self._life[i]  # it ended before it began
        self._life[i] = life
        if stillborn or dead != (i in self._absent):
            told = self._told(self._changes, k)
            if stillborn:
                told += [Life(k, i, True, False), Life(k, i, False, False)]
            else:
                told.append(Life(k, i, not dead, diverged))
        if dead != (i in self._absent):
            self._absent ^= {i}
            if not dead:
                self._tau[i] = STILL
                self._late[i].clear()
        return dead

    def _told(self, changes: dict[int, list[_Change]], k: int) -> list[_Change]:
        """Of changes by frame those of the frame that follows tick k, or is at it."""
        every = self._frame_every
        return changes.setdefault(min(-(-k // every) * every, self.config.ticks), [])

    def _frames(self) -> list[Out]:
        out: list[Out] = []
        while (rows := self._rows.get(self._framed)) is not None and len(rows) == len(self._ids):
            del self._rows[self._framed]
            rows.sort()
            changes = _in_order(self._changes.pop(self._framed, []))
            tumbled = tuple(sorted(self._tumbles.pop(self._framed, [])))
            out.append(Frame(self._framed, False, changes, tumbled, tuple(rows), self._kept(self._framed)))
            last = self.config.ticks
            self._framed = min(last, self._framed + self._frame_every) if self._framed < last else last + 1
        return out


def _in_order(changes: list[Life]) -> tuple[Life, ...]:
    """By tick and vehicle; what happened to one at one tick stays in its order: it began, and ended at once."""
    return tuple(sorted(changes, key=lambda life: (life.tick, life.vehicle)))
