"""The vehicles of a run: which of them have an agent, which command acts, which have tumbled or diverged.

`Lockstep` and `RealtimeRun` decide when a vehicle is sensed and when it moves on; what happens to it then is here.
"""

from __future__ import annotations

from msgspec import structs

from netem.errors import OutOfPlace
from netem.lives import Lives
from netem.wire.messages import Command, Life, Nav, Tumble, VehicleFrame
from world.config import WorldConfig
from world.errors import IntegrationError
from world.frames import FrameAssembly
from world.sea import World
from world.tumble import tumbles
from world.vectors import ZERO, Vec3

Sensed = tuple[tuple[float, ...], tuple[float, ...]]  # eta, nu and roll; the covariance of the estimate, or nothing
NOT_SENSED: Sensed = ((), ())


class RunState:
    """Every vehicle at the tick that it has reached."""

    def __init__(self, config: WorldConfig, frame_every: int) -> None:
        self.config = config
        self.world = World(config)
        self.ids = self.world.ids
        self.lives = Lives(config.absences)
        self.granted = 0  # ticks below it may be started
        self.frames = FrameAssembly(len(self.ids), config.ticks, frame_every)
        self.tau: dict[int, Vec3] = dict.fromkeys(self.ids, ZERO)  # the last command that took effect [N, N m]
        self.notes = self.world.notes  # (vehicle, tick, text) for a person; the reader clears it
        self._telemetry_size = {setup.id: setup.telemetry_size for setup in config.vehicles}
        self._tumble_limits = {setup.id: setup.tumble_limit for setup in config.vehicles}
        self._tick_s = config.tick_ns / 1e9
        self._absent: set[int] = set()  # vehicles without an agent at the tick that they have reached
        self.life = dict.fromkeys(self.ids, 0)  # which life of its agent each vehicle was in when it entered its tick
        self._delayed: dict[int, dict[int, Vec3]] = {i: {} for i in self.ids}  # commands of slow agents, by tick
        self._diverged: set[int] = set()  # vehicles that are not integrated any more
        self._tumbled: set[int] = set()
        self._tumblings: dict[int, tuple[int, int]] = {}  # how often each has tumbled, and since when the last time
        for i in self.ids:
            at_start = self.world.pitch(i)
            self._watch_pitch(i, 0, at_start, at_start)

    def grant(self, until: int) -> None:
        """Ticks below `until` may be started; a smaller grant than before changes nothing."""
        self.granted = max(self.granted, min(until, self.config.ticks))

    def tick_of(self, i: int) -> int:
        return self.world.tick(i)

    def incarnation(self, i: int) -> int:
        """Which life of its agent vehicle i is in at the tick that it has reached."""
        return self.lives.incarnation(i, self.tick_of(i))

    def lacks_agent(self, i: int) -> bool:
        """Whether vehicle i has no agent at the tick that it has reached."""
        return i in self._diverged or self.lives.lacks_agent(i, self.tick_of(i))

    def check(self, i: int, command: Command) -> None:
        """Check that a command is of the right life and has the declared telemetry. Raises OutOfPlace if it is not, or
        has not.
        """
        self.lives.check(i, self.world.tick(i), command.incarnation)
        size = self._telemetry_size[i]
        if command.telemetry and size not in (None, len(command.telemetry)):
            raise OutOfPlace("telemetry values", size, len(command.telemetry))

    def enter_tick(self, i: int, k: int) -> bool:
        """Put into the next frame that vehicle i lost or got its agent, if it did so at tick k. Returns whether it has
        no agent at this tick.
        """
        # A vehicle that diverged has none for good: lives stay those that the console and netem know of.
        diverged = i in self._diverged
        absent = diverged or self.lives.lacks_agent(i, k)
        changed = absent != (i in self._absent)
        life = self.lives.incarnation(i, k)
        # A life may have ended before it began.
        stillborn = absent and i in self._absent - self._diverged and life > self.life[i]
        self.life[i] = life
        if stillborn:
            self.frames.life(Life(k, i, True, False))
            self.frames.life(Life(k, i, False, False))
        elif changed:
            self.frames.life(Life(k, i, not absent, diverged))
        if changed:
            self._absent ^= {i}
            if not absent:
                self.tau[i] = ZERO
                self._delayed[i].clear()
        return absent

    def listen(self, i: int, k: int, command: Command) -> Command:
        """Put what vehicle i's agent says with its command into the next frame, also if that is not of this tick;
        returns the rest of the command.
        """
        self.frames.say(k, i, command.said)
        return structs.replace(command, said=())

    def effective(self, i: int, k: int, tau: tuple[float, ...]) -> Vec3:
        """The command that takes effect at tick k [N, N m]: that of some ticks ago when the agent is slow."""
        x, y, z = tau
        delayed = self._delayed[i]
        delay = self.world.slow(i, k)
        if delay or delayed:
            delayed[k] = (x, y, z)
            due = [tick for tick in delayed if tick <= k - delay]
            for tick in due[:-1]:
                del delayed[tick]
            if not delay:
                delayed.clear()
            else:
                x, y, z = delayed[due[-1]] if due else self.tau[i]
        self.tau[i] = taken = (x, y, z)
        return taken

    def integrate(self, i: int, k: int, tau: Vec3) -> None:
        """Move vehicle i from tick k to the next with `tau` [N, N m]; one that diverges stays in its place from then
        on. Raises IntegrationError if it does, and the run is not to go on without it.
        """
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
                    self.frames.life(Life(k + 1, i, False, True))  # if there is an agent, its end says it
                self.notes.append((i, k, f"error: {error.reason}; vehicle {i} is not integrated any more"))
                self.world.hold(i)
            else:
                self._watch_pitch(i, k + 1, before, self.world.pitch(i))
        if k + 1 == self.config.ticks:
            self.frames.row(k + 1, self.row(i, NOT_SENSED, (), b""))

    def nav(self, i: int, life: int, k: int) -> Nav:
        world = self.world
        shown_ns = None if world.clocks is None else world.clocks.reading_ns(i, k)
        navigation = world.navigation(i)
        belief = () if navigation is None else navigation.covariance()
        return Nav(life, k, *world.sense(i), shown_ns, belief)

    def row(self, i: int, sensed: Sensed, tau: tuple[float, ...], command: bytes) -> VehicleFrame:
        """Vehicle i in the frame of the tick that it has reached: what its sensor reported, with the covariance; the
        applied force and moments [N, N m]; the agent's command, encoded.
        """
        world = self.world
        clock = () if world.clocks is None else world.clock_error(i)
        navigation = world.navigation(i)
        fixes = () if navigation is None else navigation.take_fixes()
        return VehicleFrame(i, *world.state(i), sensed[0], tau, command, world.of_plant(i), clock, sensed[1], fixes)

    def take_over(self, tick: int, before: RunState) -> None:
        """Go on at a tick with the vehicles of another run, which have reached it."""
        self.world.take_over(before.world)
        self.tau, self._delayed, self._diverged = before.tau, before._delayed, before._diverged
        self._tumbled, self._tumblings = before._tumbled, before._tumblings
        self._absent = self._diverged | {i for i in self.ids if self.lives.lacks_agent(i, tick - 1)}
        self.life = {i: self.lives.incarnation(i, tick - 1) for i in self.ids}
        self.frames.begin(tick, before.frames)

    @property
    def tumbling(self) -> dict[int, tuple[int, int]]:
        """The vehicles that are tumbled: how often each has tumbled, and since when."""
        return {i: known for i, known in self._tumblings.items() if i in self._tumbled and i not in self._diverged}

    @property
    def diverged(self) -> list[int]:
        """The vehicles that are not integrated any more."""
        return sorted(self._diverged)

    def _watch_pitch(self, i: int, k: int, before: tuple[float, float], after: tuple[float, float]) -> None:
        tumbled = i in self._tumbled
        if tumbles(tumbled, self._tumble_limits[i], before, after, self._tick_s) != tumbled:
            self._tumbled ^= {i}
            if not tumbled:
                self._tumblings[i] = self._tumblings.get(i, (0, 0))[0] + 1, k
            self.frames.tumble(Tumble(k, i, not tumbled, self._tumblings[i][0]))
