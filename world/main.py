"""The world process: hosts or joins the router, and serves the sea in lockstep or on a wall clock."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from netem.vehicle_clock import Clock
from netem.wire.access import WORLD as WORLD
from netem.wire.access import Credentials, Listener, Members
from netem.wire.bus import Bus
from netem.wire.certificate_router import CertificateRouter
from netem.wire.keys import Keys
from netem.wire.refusals import Refusals, listen
from netem.wire.session import quiet_zenoh
from netem.wire.shell import end_with_link
from world.config import WorldConfig
from world.lockstep import Lockstep
from world.process import WorldProcess


def run(
    endpoint: str,
    run_id: str,
    credentials: dict[str, Credentials],
    private: Path,
    config: WorldConfig,
    frame_every: int,
    clock: Clock,
    speed: float,
    most_asked: int,
    listener: Listener | None = None,
    certified: Listener | None = None,
    members: Members = (),
) -> None:
    """Host the router and serve the sea of a run until the process is ended.

    Args:
        credentials: the logins of all processes that may connect, by role.
        private: a folder that only this user can read, for the router's files.
        frame_every: ticks from one frame to the next.
        speed: how fast ticks begin on a wall clock, times real time.
        most_asked: in lockstep, the number of processes that have a turn at the same time.
        listener: further addresses of the router. None: it has only `endpoint`.
        certified: address of a second router, for agents without a password. None: no such router.
        members: the vehicles of each process that hosts several agents.
    """
    keys = Keys(run_id)
    bus, refusals = host(endpoint, keys, credentials, private, config, listener, certified, members)
    _process(bus, keys, config, frame_every, clock, speed, most_asked, refusals, members).serve_or_give_up()


def host(
    endpoint: str,
    keys: Keys,
    credentials: dict[str, Credentials],
    private: Path,
    config: WorldConfig,
    listener: Listener | None,
    certified: Listener | None,
    members: Members,
) -> tuple[Bus, Refusals]:
    """The run's router, with the one for agents without a password if there is one, and what they refuse."""
    refusals = Refusals()
    listen(refusals)
    vehicles = tuple(setup.id for setup in config.vehicles)
    bus = Bus.host(endpoint, keys, vehicles, credentials, private, listener, members)
    if certified is not None:
        CertificateRouter(bus, keys, vehicles, certified)
    return bus, refusals


def join(
    endpoint: str,
    run_id: str,
    credentials: Credentials,
    config: WorldConfig,
    frame_every: int,
    clock: Clock,
    speed: float,
    most_asked: int,
) -> None:
    """Serve the sea of a run through a router that is there already; as `run` otherwise. Raises BusError if the router
    does not let us in.
    """
    quiet_zenoh()
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    _process(bus, Keys(run_id), config, frame_every, clock, speed, most_asked).serve_or_give_up()


def _process(
    bus: Bus,
    keys: Keys,
    config: WorldConfig,
    frame_every: int,
    clock: Clock,
    speed: float,
    most_asked: int,
    refusals: Refusals | None = None,
    members: Members = (),
) -> WorldProcess:
    if clock is Clock.LOCKSTEP:
        if most_asked < len(config.vehicles):
            share_processor()
        return WorldProcess(bus, keys, Lockstep(config, frame_every=frame_every), refusals, most_asked, members)
    from world.realtime_process import RealtimeWorldProcess

    return RealtimeWorldProcess(bus, keys, config, frame_every, speed, refusals)


def share_processor() -> None:
    """Keep all threads of this process, present and future, on one of two processors.

    With many agents both processors are busy, and zenoh's threads here and ours do one thing after the other. On two
    processors they interrupt each other for each message (measured, N = 100: 15 to 20 % of the whole run's CPU time).
    With more processors there is room for them side by side.
    """
    processors = sorted(os.sched_getaffinity(0))
    if len(processors) == 2:
        one = {processors[os.getpid() % 2]}
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setaffinity(int(thread), one)
