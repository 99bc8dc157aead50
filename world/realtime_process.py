"""The world process of a realtime run: ticks begin and end by the wall clock."""

from __future__ import annotations

from socket import socket
from time import monotonic_ns
from typing import Any

from netem.histogram import Histogram
from netem.wire.bus import Bus
from netem.wire.codec import encode
from netem.wire.credentials import WORLD as WORLD
from netem.wire.keys import Keys, tail
from netem.wire.messages import Command, Nav, Pace
from netem.wire.refusals import Refusals
from world.config import WorldConfig
from world.lockstep import Out
from world.process import WorldProcess
from world.realtime import RealtimeRun, TickSchedule

AHEAD_NS = 50_000_000  # from the first grant to the first tick
PATIENCE_NS = 500_000_000  # after such a time without an answer an agent is silent
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
        self._began_ns: dict[int, int] = {}  # when the last ticks began, by tick
        self._lag, self._gap = Histogram(), Histogram()
        self._response = {i: Histogram() for i in run.state.ids}
        self._gaps = {i: Histogram() for i in run.state.ids}
        self._heard_ns: dict[int, int] = {}
        super().__init__(bus, keys, run, refusals)

    def _listen(self, bus: Bus, ends: socket | None) -> None:
        self._came = bus.stamped_queue(self._keys.cmd("*"))

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
        return True  # on a wall clock no agent waits for a turn

    def _ask(self, i: int, nav: Nav) -> None:
        self._send_navs([(i, nav)])

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
