"""An agent process: connects, asks for its configuration, and answers in lockstep or on a wall clock."""

from __future__ import annotations

from time import monotonic, sleep

from agents.agent import make_agent
from agents.config import AgentConfig
from agents.errors import AgentError
from agents.loop import AgentCore, AgentLoop
from agents.process import READY_TIMEOUT_S, RETRY_S, AgentProcess, _give_up
from agents.realtime_loop import FreeLoop
from netem.errors import BusError
from netem.wire.access import Credentials, agent_role
from netem.wire.bus import Bus, quiet_zenoh
from netem.wire.control import read_map
from netem.wire.keys import Keys
from netem.wire.link_loss import end_with_link
from netem.wire.shell import Shell


def run(
    endpoint: str, run_id: str, vehicle: int, credentials: Credentials, incarnation: int = 0, begin: int = 0
) -> None:
    """Join a run as agent `vehicle` and answer navs, from tick `begin` on, until the process is told to end.

    Raises:
        BusError: the run cannot be joined.
        Exception: whatever the controller raised; the console has been told by then.
    """
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    config, clock = _ask_config(bus, keys, vehicle)
    begin_life(bus, keys, config, clock, incarnation, begin).serve()


def begin_life(bus: Bus, keys: Keys, config: AgentConfig, clock: str, incarnation: int, begin: int) -> AgentProcess:
    """An agent that is made, and known to world and netem.

    Args:
        clock: lockstep or real.

    Raises:
        BusError: world or netem does not answer.
        SystemExit: a law cannot be made; the console has been told by then.
    """
    vehicle = config.id
    try:
        core = make_agent(config)
    except AgentError as error:
        role = agent_role(vehicle)
        _give_up(Shell(bus, role, keys.note(role)), vehicle, begin, error)
    process = _process(bus, keys, vehicle, core, config, clock, incarnation, begin)
    process.get_ready()
    return process


def _process(
    bus: Bus, keys: Keys, vehicle: int, core: AgentCore, config: AgentConfig, clock: str, incarnation: int, begin: int
) -> AgentProcess:
    m = config.round_ticks
    if clock == "real":
        from agents.realtime_process import FreeAgentProcess

        return FreeAgentProcess(bus, keys, vehicle, FreeLoop(core, m, incarnation=incarnation, begin=begin))
    ticks = config.memory_ticks
    loop = AgentLoop(core, m, incarnation=incarnation, begin=begin, memory_ticks=ticks)
    return AgentProcess(bus, keys, vehicle, loop)


def _ask_config(bus: Bus, keys: Keys, vehicle: int) -> tuple[AgentConfig, str]:
    deadline = monotonic() + READY_TIMEOUT_S
    while monotonic() < deadline:
        answer = bus.ask(keys.cfg(vehicle))
        if answer is not None:
            values = read_map(answer)
            return AgentConfig.from_values(values["agent"]), str(values.get("clock", "lockstep"))
        sleep(RETRY_S)  # nobody to ask yet: zenoh says so at once
    raise BusError(f"the console did not answer on {keys.cfg(vehicle)} within {READY_TIMEOUT_S:.0f} s")
