"""An external agent, started in any terminal that can reach the run: it connects, asks for its slice, and serves.

If `fleet run` does not start the agent of a vehicle, it writes a join file with the credentials of that agent alone. An
agent that joins with this file computes exactly the same as an agent that `fleet run` starts.
"""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread

from agents.config import AgentConfig
from agents.controllers import BUILT_IN, laws
from agents.join_file import ENDPOINT, JoinError, JoinFile, NotYetError
from agents.loop import AgentCore
from agents.main import begin_life, clock_of
from netem.clock import Clock
from netem.errors import BusError, MalformedMessage
from netem.wire.bus import Bus
from netem.wire.control import read_map
from netem.wire.keys import Keys
from netem.wire.messages import End
from world.errors import PluginError
from world.plugins.loading import admit
from world.plugins.trust import Permission

MakeCore = Callable[[AgentConfig, Clock], AgentCore]
CONNECT_MS = 3000
ASK_S = 10.0
WATCH_S = 0.2  # how often to look whether the run is still there


def serve(joining: JoinFile, notify: Callable[[str], None], make: MakeCore | None = None) -> End:
    """Serve as the agent of a join file until the world ends its life; returns the world's last message to it. `notify`
    gets a line when the agent has joined. `make` takes the configuration and the clock of the run, and makes the core;
    None: our agent.

    Raises NotYetError if the run is over, or expects no such agent now; JoinError if it asks for a law that may not
    run, or went away; SystemExit if the law failed, of which the console has a note by then.
    """
    keys = Keys(joining.run)
    bus = _connect(joining)
    lost = Event()
    bus.on_lost(lost.set)
    try:
        config, incarnation, begin, clock = _ask(bus, keys, joining.vehicle)
        core = None if make is None else make(config, clock)
        if core is None:
            _admit(config)
        ended: SimpleQueue[End | BaseException] = SimpleQueue()

        def live() -> None:
            try:
                process = begin_life(bus, keys, config, incarnation, begin, clock, core)
                notify(f"agent {config.id} has joined run {joining.run} at {joining.endpoint}")
                ended.put(process.serve())
            except BaseException as error:  # a law may raise anything, and ends with SystemExit
                ended.put(error)

        # In a thread, because Python handles a signal between two bytecodes only, and waiting for a nav is one.
        Thread(target=live, name="agent", daemon=True).start()
        return _outcome(lost, ended)
    finally:
        bus.close()


def _admit(config: AgentConfig) -> None:
    try:
        permission = Permission(elsewhere=(Path(),), because="the run names it")
        for kind, law in laws(config).items():
            if law.name not in BUILT_IN[kind]:
                admit(kind, law.name, permission)
    except PluginError as error:
        raise JoinError(str(error)) from None


def _outcome(lost: Event, ended: SimpleQueue[End | BaseException]) -> End:
    """Wait for the end of the agent's life or of its link. An agent that lost its link has left the run: zenoh would
    link again by itself, and messages that were on the way would be missing without notice.
    """
    link_lost = False
    while True:
        try:
            outcome = ended.get(timeout=WATCH_S)
        except Empty:
            if link_lost:
                raise JoinError("the link to the run has ended: its router closed it, or the line is cut") from None
            link_lost = lost.is_set()  # the outcome may still be on its way from the other thread
            continue
        if isinstance(outcome, BusError):
            raise JoinError(str(outcome))
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome


def _connect(joining: JoinFile) -> Bus:
    endpoints = joining.endpoint.split(",")
    reached = [endpoint for endpoint in endpoints if _reached(endpoint)]
    for endpoint in reached:
        with suppress(BusError):
            return Bus.connect(endpoint, joining.credentials, timeout_ms=CONNECT_MS)
    if not reached:
        where = " or ".join(endpoints)
        raise NotYetError(f"there is no router at {where}: run {joining.run} is over, or this machine cannot reach it")
    tls = "its certificate is not the one to expect, or it asks for another; " if "tls/" in joining.endpoint else ""
    raise NotYetError(
        f"the router at {' or '.join(reached)} refuses {joining.user}: {tls}the password is wrong, or another run "
        f"uses this address now"
    )


def _reached(endpoint: str) -> bool:
    parts = ENDPOINT.fullmatch(endpoint)
    if parts is None:
        return True
    try:
        if parts["path"]:
            with socket.socket(socket.AF_UNIX) as probe:
                probe.settimeout(CONNECT_MS / 1000)
                probe.connect(parts["path"])
        else:
            socket.create_connection((parts["host"].strip("[]"), int(parts["port"])), CONNECT_MS / 1000).close()
    except (OSError, OverflowError):
        return False
    return True


def _ask(bus: Bus, keys: Keys, vehicle: int) -> tuple[AgentConfig, int, int, Clock]:
    """The agent's own slice, which life of it this is, the tick of its first nav, and the clock of the run."""
    answer = bus.ask(keys.cfg(vehicle), timeout_s=ASK_S)
    if answer is None:
        raise NotYetError(
            f"nobody answered on {keys.cfg(vehicle)}: this login, or the certificate with it, is not that of agent "
            f"{vehicle}, or run {keys.run} is not going on there"
        )
    try:
        values = read_map(answer)
        if "error" in values:
            raise NotYetError(str(values["error"]))
        incarnation, begin = int(values["incarnation"]), int(values["begin"])
        return AgentConfig.from_values(values["agent"]), incarnation, begin, clock_of(values)
    except (MalformedMessage, KeyError, TypeError, ValueError) as error:
        raise JoinError(f"this version does not understand the answer on {keys.cfg(vehicle)}: {error}") from None
