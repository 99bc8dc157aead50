"""The world process: hosts or joins the router, and serves the sea in lockstep or on a wall clock."""

from __future__ import annotations

from pathlib import Path
from socket import socket
from time import monotonic_ns
from typing import Any, NamedTuple

from netem.histogram import Histogram
from netem.vehicle_clock import Clock
from netem.wire.access import WORLD as WORLD
from netem.wire.access import Credentials, Listener, Members
from netem.wire.bus import Bus
from netem.wire.certificate_router import CertificateRouter
from netem.wire.codec import encode
from netem.wire.keys import Keys, tail
from netem.wire.messages import Command, Nav, Pace
from netem.wire.refusals import Refusals, listen
from netem.wire.session import quiet_zenoh
from netem.wire.shell import end_with_link
from world.config import WorldConfig
from world.lockstep import Lockstep, Out
from world.process import WorldProcess
from world.realtime import RealtimeRun

# --- tick schedule: when ticks begin on a wall clock. Nothing here reads a clock: the caller passes the time.


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


AHEAD_NS = 50_000_000  # from the first grant to the first tick
PATIENCE_NS = 500_000_000  # without an answer, after which an agent is silent
LEAST_PATIENCE = 10  # ticks
REMEMBERED = 1000  # ticks whose answers are still measured


class RealtimeWorldProcess(WorldProcess):
    """On a wall clock: begins and ends ticks by it, whichever agents have answered, and measures how all keep up."""

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        config: WorldConfig,
        frame_every: int,
        speed: float,
        refusals: Refusals | None = None,
    ) -> None:
        """`frame_every`: ticks from one frame to the next. `speed`: how fast ticks begin, times real time. `refusals`:
        counts the router's refusals, if the router lives here.
        """
        self._schedule = TickSchedule(round(config.tick_ns / speed))
        patience = max(LEAST_PATIENCE, PATIENCE_NS // self._schedule.period_ns)
        self._realtime = run = RealtimeRun(config, frame_every=frame_every, patience=patience)
        self._began_ns: dict[int, int] = {}  # by tick, of the last ones
        self._lag, self._gap = Histogram(), Histogram()
        self._response = {i: Histogram() for i in run.state.ids}
        self._gaps = {i: Histogram() for i in run.state.ids}
        self._heard_ns: dict[int, int] = {}
        super().__init__(bus, keys, run, refusals)

    def _listen(self, bus: Bus, ends: socket | None) -> None:
        self._came = bus.stamped(self._keys.cmd("*"))

    def serve(self) -> None:
        """Begin and end one tick after the other, until the process is ended."""
        run, schedule = self._realtime, self._schedule
        self._wait_for_grant(0)
        schedule.start(0, monotonic_ns() + AHEAD_NS)
        for k in range(run.config.ticks):
            self._wait(schedule.at_ns(k))
            self._begin(k, held=self._wait_for_grant(k))
            self._wait(schedule.at_ns(k + 1))
            self._publish(run.finish())
            self._flush_frames()
        while True:
            self._take_next()

    def _begin(self, k: int, *, held: bool) -> None:
        schedule, now = self._schedule, monotonic_ns()
        self._lag.add(schedule.begin(k, now, held=held))
        if k and not held:
            self._gap.add(now - self._began_ns[k - 1])
        self._began_ns[k] = now
        self._began_ns.pop(k - REMEMBERED, None)
        if k % self._realtime.config.round_ticks == 0:
            self._round(encode(Pace(k, schedule.at_ns(k), schedule.period_ns)))
        self._publish(self._realtime.begin())

    def _asked(self, i: int) -> bool:
        return True  # nobody waits for a turn

    def _ask(self, i: int, nav: Nav) -> None:
        self._send_navs([(i, nav)])  # nobody waits for a turn

    def _take_command(self, i: int, command: Command, data: bytes) -> list[Out]:
        return self._realtime.command(i, command, data)

    def _wait(self, until_ns: int) -> None:
        while (left := until_ns - monotonic_ns()) > 0:
            self._take_next(left / 1e9)
        for _ in range(len(self._came)):
            self._take_next()

    def _wait_for_grant(self, k: int) -> bool:
        if self._state.granted > k:
            return False
        while self._state.granted <= k:
            self._take_next()
        return True

    def _take_next(self, timeout_s: float | None = None) -> None:
        item = self._came.get(timeout_s)
        if item is None:
            return
        key, data, at_ns = item
        self._handle(key, data)
        for i, tick in self._realtime.take_answered():
            self._response[i].add(at_ns - self._began_ns.get(tick, at_ns))
            if i in self._heard_ns:
                self._gaps[i].add(at_ns - self._heard_ns[i])
            self._heard_ns[i] = at_ns

    def _rejected(self) -> dict[str, int]:
        floods = {f"{tail(key)}: flood": n for key, n in self._came.flooded.copy().items()}
        return super()._rejected() | floods

    def _timing(self) -> dict[str, Any]:
        schedule = self._schedule
        vehicles = {
            str(i): counts.to_values() | {"response": self._response[i].to_values(), "gap": self._gaps[i].to_values()}
            for i, counts in self._realtime.punctuality.items()
        }
        world = {
            "period_ms": schedule.period_ns / 1e6,
            "run_s": (max(self._began_ns, default=0) + 1) * schedule.period_ns / 1e9,
            "held_s": schedule.held_ns / 1e9,
            "slipped_s": schedule.slipped_ns / 1e9,
            "lag": self._lag.to_values(),
            "gap": self._gap.to_values(),
        }
        return {"world": world, "vehicles": vehicles}


class Sea(NamedTuple):
    """The parameters of a world process, whether it hosts the router or joins one."""

    config: WorldConfig
    frame_every: int  # ticks from one frame to the next
    clock: Clock
    speed: float  # how fast ticks begin on a wall clock, times real time
    most_asked: int  # in lockstep, the number of processes that have a turn at the same time


def run(
    endpoint: str,
    run_id: str,
    credentials: dict[str, Credentials],
    private: Path,
    sea: Sea,
    listener: Listener | None,
    certified: Listener | None,
    members: Members,
    ends: socket | None,
) -> None:
    """Host the router and serve the sea of a run until the process is ended.

    Args:
        credentials: the logins of all processes that may connect, by role.
        private: a folder that only this user can read, for the router's files.
        listener: further addresses of the router. None: it has only `endpoint`.
        certified: address of a second router, for agents without a password. None: no such router.
        members: the vehicles of each process that hosts several agents.
        ends: where the console hands over the ends of vehicles' buses; None: they are on zenoh.
    """
    keys, refusals = Keys(run_id), Refusals()
    listen(refusals)
    vehicles = tuple(setup.id for setup in sea.config.vehicles)
    bus = Bus.host(endpoint, keys, vehicles, credentials, private, listener, members)
    if certified is not None:
        CertificateRouter(bus, keys, vehicles, certified)
    _process(bus, keys, sea, ends, refusals, members).serve_or_give_up()


def join(endpoint: str, run_id: str, credentials: Credentials, sea: Sea, ends: socket | None) -> None:
    """Serve the sea of a run through a router that is there already; as `run` otherwise. Raises BusError if the router
    does not let us in.
    """
    quiet_zenoh()
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    _process(bus, Keys(run_id), sea, ends).serve_or_give_up()


def _process(
    bus: Bus, keys: Keys, sea: Sea, ends: socket | None, refusals: Refusals | None = None, members: Members = ()
) -> WorldProcess:
    if sea.clock is Clock.LOCKSTEP:
        run = Lockstep(sea.config, frame_every=sea.frame_every)
        return WorldProcess(bus, keys, run, refusals, sea.most_asked, members, ends)
    return RealtimeWorldProcess(bus, keys, sea.config, sea.frame_every, sea.speed, refusals)
