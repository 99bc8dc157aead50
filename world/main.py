"""Where the world process starts: it hosts or joins the router, and serves the sea."""

from __future__ import annotations

from pathlib import Path
from socket import socket
from typing import NamedTuple

from netem.clock import Clock
from netem.wire.bus import Bus
from netem.wire.certificate_router import CertificateRouter
from netem.wire.credentials import WORLD as WORLD
from netem.wire.credentials import Credentials, Listener, Members
from netem.wire.keys import Keys
from netem.wire.link_loss import end_with_link
from netem.wire.refusals import Refusals, listen
from netem.wire.session import quiet_zenoh
from world.config import WorldConfig
from world.lockstep import Lockstep
from world.process import WorldProcess
from world.realtime_process import RealtimeWorldProcess


class WorldSetup(NamedTuple):
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
    setup: WorldSetup,
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
    vehicles = tuple(vehicle.id for vehicle in setup.config.vehicles)
    bus = Bus.host(endpoint, keys, vehicles, credentials, private, listener, members)
    if certified is not None:
        CertificateRouter(bus, keys, vehicles, certified)
    _process(bus, keys, setup, ends, refusals, members).serve_or_give_up()


def join(endpoint: str, run_id: str, credentials: Credentials, setup: WorldSetup, ends: socket | None) -> None:
    """Serve the sea of a run through a router that is there already; as `run` otherwise. Raises BusError if the router
    does not let us in.
    """
    quiet_zenoh()
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    _process(bus, Keys(run_id), setup, ends).serve_or_give_up()


def _process(
    bus: Bus,
    keys: Keys,
    setup: WorldSetup,
    ends: socket | None,
    refusals: Refusals | None = None,
    members: Members = (),
) -> WorldProcess:
    if setup.clock is Clock.LOCKSTEP:
        run = Lockstep(setup.config, frame_every=setup.frame_every)
        return WorldProcess(bus, keys, run, refusals, setup.most_asked, members, ends)
    return RealtimeWorldProcess(bus, keys, setup.config, setup.frame_every, setup.speed, refusals)
