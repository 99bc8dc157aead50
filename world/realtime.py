"""The world without a barrier: a tick lasts as long as the wall clock says, and who has not answered then is late.

A pure state machine like `Lockstep`, on the same `RunState`; the process decides when a tick begins and when it is
over. The command that answers Nav(k) acts over tick k, if it came before the tick was over. So a run without late
agents moves as in lockstep, to the last bit. Otherwise the newest command that is there acts:

| counted per vehicle | when |
|---|---|
| `missed` | a tick was over, and the answer to its nav had not come |
| `late` | an answer came after its tick, the newest by then: it acts if no newer one comes before the tick is over |
| `stale` | an answer came after its tick and after a newer one, and was dropped |

So every answer is in time, late or stale. `missed` is the sum of `late`, `stale` and the answers that never came.

An agent that has answered nothing for a while is *silent*: the network takes it for a dead receiver, and it gets a nav
only after once, twice, four times ... that while. Messages to a suspended process stay in buffers, and their sender
waits when these are full. The world sends few enough that they do not fill. With its next answer all is as before.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from netem.errors import OutOfPlace
from netem.wire.codec import encode
from netem.wire.messages import Command, Nav, Round
from world.config import WorldConfig
from world.lockstep import NavTo, Out
from world.run_state import NOT_SENSED, RunState
from world.vectors import ZERO


@dataclass(slots=True)
class Punctuality:
    """How one vehicle's agent kept up."""

    asked: int = 0  # ticks at which it was to answer
    missed: int = 0
    late: int = 0
    stale: int = 0
    longest: int = 0  # ticks missed in a row
    silent: int = 0  # missed ticks in which the vehicle's agent was taken for silent
    row: int = 0  # ticks missed in a row just now

    def to_values(self) -> dict[str, Any]:
        values = asdict(self)
        del values["row"]
        return values


class RealtimeRun:
    """Moves the vehicles tick by tick with the commands that are there."""

    def __init__(self, config: WorldConfig, *, frame_every: int = 1, patience: int = 50) -> None:
        """Begin before tick 0. `frame_every`: ticks from one frame to the next. `patience`: ticks without an answer
        after which an agent is silent.
        """
        self.config = config
        self.state = RunState(config, frame_every)
        self.punctuality = {i: Punctuality() for i in self.state.ids}
        self._patience = patience
        self._heard = dict.fromkeys(self.state.ids, 0)  # newest tick with an answer, or at which none was asked for
        self._silent: set[int] = set()
        self._tick = -1  # the tick that is under way
        self._awaiting: dict[int, Nav] = {}
        self._newest: dict[int, tuple[Command, bytes]] = {}  # not used yet
        self._answered = dict.fromkeys(self.state.ids, -1)  # newest tick answered
        self._commanded = dict.fromkeys(self.state.ids, ZERO)  # forces by the newest command that was used
        self._taken: list[tuple[int, int]] = []  # (vehicle, tick) of commands taken, late ones too

    @property
    def waiting_for(self) -> list[tuple[int, int]]:
        """(vehicle, tick) of every command that is due."""
        return sorted((i, nav.tick) for i, nav in list(self._awaiting.items()))

    @property
    def finished(self) -> bool:
        return self.state.frames.finished

    def grant(self, until: int) -> list[Out]:
        """Ticks below `until` may be started, when their time has come."""
        self.state.grant(until)
        return []

    def begin(self) -> list[Out]:
        """Begin the next tick: every vehicle measures."""
        self._tick = k = self._tick + 1
        state, world = self.state, self.state.world
        out: list[Out] = []
        positions: dict[int, tuple[float, ...]] = {}
        paused = []
        for i in state.ids:
            if state.enter_tick(i, k):
                self._heard[i] = k
                self._silent.discard(i)
                continue
            if world.paused(i, k):
                self._heard[i] = k
                paused.append(i)
            else:
                nav = state.nav(i, state.lives.incarnation(i, k), k)
                self._awaiting[i] = nav
                self.punctuality[i].asked += 1
                if self._is_to_get(i, k):
                    out.append(NavTo(i, nav))
            if i not in self._silent:
                positions[i] = world.position(i)
        if k % self.config.round_ticks == 0:
            out.append(Round(k, tuple(positions), tuple(positions.values()), tuple(paused)))
        return out

    def _is_to_get(self, i: int, k: int) -> bool:
        whiles, rest = divmod(k - self._heard[i], self._patience)
        if not whiles:
            return True
        if i not in self._silent:
            self._silent.add(i)
            text = f"its agent has not answered for {self._patience} ticks: it hears nothing until it does"
            self.state.notes.append((i, k, text))
        self.punctuality[i].silent += 1
        return not rest and whiles.bit_count() == 1

    def command(self, i: int, command: Command, raw: bytes | None = None) -> list[Out]:
        """Take vehicle i's command: it acts over the tick that is under way, if no newer one comes before its end.
        Raises OutOfPlace if no nav of this tick was sent, or this nav already has an answer.
        """
        self.state.check(i, command)
        if command.tick > self._tick or command.tick == self._answered[i]:
            raise OutOfPlace("tick", f"an answer to the nav of tick {self._tick}, or before", command.tick)
        if i in self._silent:
            self._silent.remove(i)
            text = f"its agent answers again, after {self._tick - self._heard[i]} ticks"
            self.state.notes.append((i, self._tick, text))
        self._heard[i] = self._tick
        self._taken.append((i, command.tick))
        if command.said:  # a command that comes too late to act is heard all the same
            command, raw = self.state.listen(i, self._tick, command), None
        if command.tick < self._answered[i]:
            self.punctuality[i].stale += 1
            return []
        nav = self._awaiting.get(i)
        self.punctuality[i].late += nav is None or nav.tick != command.tick
        self._answered[i] = command.tick
        self._newest[i] = (command, encode(command) if raw is None else raw)
        return []

    def take_answered(self) -> list[tuple[int, int]]:
        """(vehicle, tick) of the commands taken since the last call."""
        taken, self._taken = self._taken, []
        return taken

    def end(self, i: int, incarnation: int, until: int | None = None) -> list[Out]:
        """Vehicle i's agent has ended: from the first tick without a command it drifts. `until`: another agent takes
        over at this tick. None: as planned.
        """
        state = self.state
        if incarnation != state.incarnation(i) or state.lacks_agent(i):
            return []
        tick = state.tick_of(i)
        if self._answered[i] >= tick:
            tick += 1
        state.lives.end(i, tick, until)
        return []

    def finish(self) -> list[Out]:
        """End the tick: every vehicle moves on with the commands that are there."""
        k = self._tick
        state, world = self.state, self.state.world
        for i in state.ids:
            nav = self._awaiting.pop(i, None)
            newest = self._newest.pop(i, None)
            measured = NOT_SENSED
            sent = b""
            if state.enter_tick(i, k):
                self._commanded[i] = tau = ZERO
            elif nav is None:
                tau = world.actuate(i, state.tau[i])
            else:
                self._count(i, in_time=newest is not None and newest[0].tick == k)
                if newest is not None:
                    command, sent = newest
                    x, y, z = command.tau
                    self._commanded[i] = (x, y, z)
                tau = world.actuate(i, state.effective(i, k, self._commanded[i]))
                measured = nav.eta + nav.nu + nav.roll, nav.belief
            if state.frames.due(k):
                state.frames.row(k, state.row(i, measured, tau, sent))
            state.integrate(i, k, tau)
        return [*state.frames.complete()]

    def _count(self, i: int, *, in_time: bool) -> None:
        count = self.punctuality[i]
        if in_time:
            count.row = 0
        else:
            count.missed += 1
            count.row += 1
            count.longest = max(count.longest, count.row)


class TickSchedule:
    """Tick k begins one period after tick k - 1, unless the schedule was moved because a tick was late."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self._tick, self._at_ns = 0, 0
        self.held_ns = 0  # moved because the ticks were not granted yet: paused, or waiting for a restart
        self.slipped_ns = 0  # moved because the world itself was late

    def start(self, tick: int, now_ns: int) -> None:
        """Let a tick begin at `now_ns` [ns], and the next ones at one period each."""
        self._tick, self._at_ns = tick, now_ns

    def at_ns(self, tick: int) -> int:
        """When a tick begins [ns]."""
        return self._at_ns + (tick - self._tick) * self.period_ns

    def begin(self, tick: int, now_ns: int, *, held: bool) -> int:
        """Begin the next tick; returns how late it is [ns]. `held`: it was granted only now.

        A world that is up to a period late shortens the tick and so catches up. Beyond that, or when the console held
        the clock, the schedule is moved: every tick has its whole length, and the run takes longer.
        """
        late = now_ns - self.at_ns(tick)
        if held:
            self.held_ns += max(0, late)
            self.start(tick, now_ns)
            return 0
        if late > self.period_ns:
            self.slipped_ns += late
            self.start(tick, now_ns)
        return max(0, late)
