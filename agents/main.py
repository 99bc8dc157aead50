"""An agent process: connects, asks for its configuration, and answers in lockstep or on a wall clock."""

from __future__ import annotations

from time import monotonic, sleep
from typing import Any

from agents.config import AgentConfig
from agents.errors import AgentError
from agents.loop import AgentCore, AgentLoop
from agents.make_agent import make_agent
from agents.process import READY_TIMEOUT_S, RETRY_S, AgentProcess, _give_up
from agents.realtime_loop import RealtimeLoop
from netem.clock import Clock
from netem.errors import BusError
from netem.wire.access import Credentials, agent_role
from netem.wire.bus import Bus
from netem.wire.control import read_map
from netem.wire.keys import Keys
from netem.wire.link_loss import end_with_link
from netem.wire.session import quiet_zenoh
from netem.wire.shell import Shell
from world.errors import PluginError


def run(
    endpoint: str, run_id: str, vehicle: int, credentials: Credentials, incarnation: int = 0, begin: int = 0
) -> None:
    """Join a run as agent `vehicle` and answer navs, from tick `begin` on, until the process is ended.

    Raises:
        BusError: the run cannot be joined.
        Exception: whatever the controller raised; a note about it has been sent to the console by then.
    """
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    config, clock = _ask_config(bus, keys, vehicle)
    begin_life(bus, keys, config, incarnation, begin, clock).serve()


def clock_of(values: dict[str, Any]) -> Clock:
    """The clock of the run of a cfg reply, which names it only where it is a wall clock."""
    return Clock(values.get("clock", Clock.LOCKSTEP))


def begin_life(
    bus: Bus,
    keys: Keys,
    config: AgentConfig,
    incarnation: int,
    begin: int,
    clock: Clock,
    core: AgentCore | None = None,
) -> AgentProcess:
    """Make an agent that is ready: world and netem have both answered it.

    Args:
        core: what answers samples, of a program that is not ours and tells no memory; None: what `config` asks for.
        incarnation: which life of the agent it is, from 0.
        begin: tick of its first nav.
        clock: of the run.

    Raises:
        BusError: world or netem does not answer.
        SystemExit: a law cannot be made; a note about it has been sent to the console by then.
    """
    vehicle = config.id
    memory_ticks = config.memory_ticks if core is None else 0
    try:
        core = make_agent(config) if core is None else core
    except (AgentError, PluginError) as error:
        role = agent_role(vehicle)
        _give_up(Shell(bus, role, keys.note(role)), vehicle, begin, error)
    m = config.round_ticks
    process: AgentProcess
    if clock is Clock.REAL:
        from agents.realtime_process import RealtimeAgentProcess

        process = RealtimeAgentProcess(bus, keys, vehicle, RealtimeLoop(core, m, incarnation=incarnation, begin=begin))
    else:
        loop = AgentLoop(core, m, incarnation=incarnation, begin=begin, memory_ticks=memory_ticks)
        process = AgentProcess(bus, keys, vehicle, loop)
    process.get_ready()
    return process


def _ask_config(bus: Bus, keys: Keys, vehicle: int) -> tuple[AgentConfig, Clock]:
    deadline = monotonic() + READY_TIMEOUT_S
    while monotonic() < deadline:
        answer = bus.ask(keys.cfg(vehicle))
        if answer is not None:
            values = read_map(answer)
            return AgentConfig.from_values(values["agent"]), clock_of(values)
        sleep(RETRY_S)  # the console does not answer yet: zenoh returns at once
    raise BusError(f"the console did not answer on {keys.cfg(vehicle)} within {READY_TIMEOUT_S:.0f} s")
