"""The world without a barrier: a tick lasts as long as the wall clock says; who has not answered by then is late.

A pure state machine like `Lockstep`, whose vehicles, lives and frames it shares; the shell says when a tick begins and
when it is over. Over tick k acts the command that answers Nav(k) if it came before the tick was over, so a run in
which nobody is late moves as in lockstep, to the last bit. Otherwise the newest command that is there acts:

| counted per vehicle | when |
|---|---|
| `missed` | a tick was over, and the answer to its nav had not come |
| `late` | an answer came after its tick, the newest by then: it acts if no newer one comes before the tick is over |
| `stale` | an answer came after its tick and after a newer one, and was dropped |

So every answer is in time, late or stale, and `missed` is `late` + `stale` + those that never came.

An agent that has answered nothing for a while is *silent*: the network takes it for a dead receiver, and it gets a nav
only after once, twice, four times ... that while. What is put on a link whose reader is suspended is kept in buffers;
once these are full whoever puts waits, so little is put that they do not fill. With its next answer all is as before.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from netem.errors import OutOfPlace
from netem.lives import Absence
from netem.wire.messages import Command, Memory, Nav, Round, VehicleFrame, encode
from world.config import WorldConfig
from world.lockstep import STILL, Lockstep, NavTo, Out


@dataclass(slots=True)
class Punctuality:
    """How one vehicle's agent kept up."""

    asked: int = 0  # ticks at which it was to answer
    missed: int = 0
    late: int = 0
    stale: int = 0
    longest: int = 0  # ticks missed in a row
    silent: int = 0  # ticks of those in which it was taken for silent
    row: int = 0  # of those just now

    def to_values(self) -> dict[str, Any]:
        values = asdict(self)
        del values["row"]
        return values


class FreeRun(Lockstep):
    """Feeds `World` tick by tick with the commands that are there."""

    def __init__(self, config: WorldConfig, *, frame_every: int = 1, patience: int = 50) -> None:
        """`patience`: ticks without an answer after which an agent is silent."""
        super().__init__(config, frame_every=frame_every)
        self._patience = patience
        self._heard = dict.fromkeys(self._ids, 0)  # newest tick in which an answer came, or none was asked for
        self._silent: set[int] = set()
        self.kept = {i: Punctuality() for i in self._ids}
        self._tick = -1  # that is under way
        self._newest: dict[int, tuple[Command, bytes]] = {}  # not used yet
        self._answered = dict.fromkeys(self._ids, -1)  # newest tick answered
        self._commanded = dict.fromkeys(self._ids, STILL)  # by the newest command that was used
        self._taken: list[tuple[int, int]] = []  # (vehicle, tick) of commands taken, late ones too

    @property
    def granted(self) -> int:
        """Ticks below it may be started."""
        return self._granted

    def grant(self, until: int) -> list[Out]:
        """Ticks below `until` may be started, when their time has come."""
        self._granted = max(self._granted, min(until, self.config.ticks))
        return []

    def begin(self) -> list[Out]:
        """The next tick is here: everybody measures."""
        self._tick = k = self._tick + 1
        out: list[Out] = []
        positions: dict[int, tuple[float, ...]] = {}
        paused = []
        for i in self._ids:
            if self._is_dead(i, k):
                self._heard[i] = k
                self._silent.discard(i)
                continue
            if self.world.paused(i, k):
                self._heard[i] = k
                paused.append(i)
            else:
                nav = Nav(self.lives.incarnation(i, k), k, *self.world.sense(i))
                self._awaiting[i] = nav
                self.kept[i].asked += 1
                if self._is_to_get(i, k):
                    out.append(NavTo(i, nav))
            if i not in self._silent:
                positions[i] = self.world.position(i)
        if k % self.config.round_ticks == 0:
            out.append(Round(k, tuple(positions), tuple(positions.values()), tuple(paused)))
        return out

    def _is_to_get(self, i: int, k: int) -> bool:
        """Whether vehicle i's agent gets its nav of tick k: always, unless it is silent."""
        whiles, rest = divmod(k - self._heard[i], self._patience)
        if not whiles:
            return True
        if i not in self._silent:
            self._silent.add(i)
            text = f"its agent has not answered for {self._patience} ticks: it hears nothing until it does"
            self.notes.append((i, k, text))
        self.kept[i].silent += 1
        return not rest and whiles.bit_count() == 1

    def command(self, i: int, command: Command, raw: bytes | None = None) -> list[Out]:
        """Take vehicle i's command: it acts over the tick that is under way, if no newer one comes before its end.

        Raises:
            OutOfPlace: it answers a nav that was not sent, or one that was answered.
        """
        self._check(i, command)
        if command.tick > self._tick or command.tick == self._answered[i]:
            raise OutOfPlace("tick", f"an answer to the nav of tick {self._tick}, or before", command.tick)
        if i in self._silent:
            self._silent.remove(i)
            self.notes.append((i, self._tick, f"its agent answers again, after {self._tick - self._heard[i]} ticks"))
        self._heard[i] = self._tick
        self._taken.append((i, command.tick))
        if command.tick < self._answered[i]:
            self.kept[i].stale += 1
            return []
        nav = self._awaiting.get(i)
        self.kept[i].late += nav is None or nav.tick != command.tick
        self._answered[i] = command.tick
        self._newest[i] = (command, encode(command) if raw is None else raw)
        return []

    def take_answered(self) -> list[tuple[int, int]]:
        """(vehicle, tick) of the commands taken since it was asked last."""
        taken, self._taken = self._taken, []
        return taken

    def end(self, i: int, incarnation: int, until: int | None = None) -> list[Out]:
        """Vehicle i's agent has ended: from the first tick without a command it drifts."""
        if incarnation != self.incarnation(i) or self.dead(i):
            return []
        tick = self.tick_of(i)
        if self._answered[i] >= tick:
            tick += 1
        if until is None:
            self.lives.end(i, tick)
        else:
            self.lives.add(Absence(i, tick, until))
        return []

    def remember(self, i: int, memory: Memory) -> None:
        """A run on a real clock cannot be gone on from, so nothing is kept."""

    def finish(self) -> list[Out]:
        """The tick is over: every vehicle moves on with what is there."""
        k = self._tick
        for i in self._ids:
            nav = self._awaiting.pop(i, None)
            newest = self._newest.pop(i, None)
            eta, nu = self.world.state(i)
            if self._is_dead(i, k):
                self._commanded[i] = STILL
                row = VehicleFrame(i, eta, nu, (), STILL, b"")
            elif nav is None:
                row = VehicleFrame(i, eta, nu, (), self.world.actuate(i, self._tau[i]), b"")
            else:
                kept = self.kept[i]
                if newest is None or newest[0].tick != k:
                    kept.missed += 1
                    kept.row += 1
                    kept.longest = max(kept.longest, kept.row)
                else:
                    kept.row = 0
                if newest is not None:
                    x, y, z = newest[0].tau
                    self._commanded[i] = (x, y, z)
                tau = self.world.actuate(i, self._effective(i, k, self._commanded[i]))
                row = VehicleFrame(i, eta, nu, nav.eta + nav.nu, tau, b"" if newest is None else newest[1])
            if k % self._frame_every == 0:
                self._rows.setdefault(k, []).append(row)
            x, y, z = row.tau
            self._integrate(i, k, (x, y, z))
        return self._frames()
