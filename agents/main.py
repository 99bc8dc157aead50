"""Where a process of one agent, or of several, starts: it connects and asks for the configuration."""

from __future__ import annotations

from pathlib import Path
from socket import socket
from time import monotonic, sleep
from typing import Any

from agents.config import AgentConfig
from agents.errors import AgentError
from agents.host_process import HostProcess
from agents.host_progress import Running
from agents.loop import AgentCore, AgentLoop, RealtimeLoop
from agents.make_agent import make_agent
from agents.process import READY_TIMEOUT_S, RETRY_S, AgentProcess, OneAgent, give_up
from agents.realtime_process import RealtimeAgentProcess
from netem.clock import Clock
from netem.errors import BusError
from netem.wire.bus import Bus
from netem.wire.control import read_map
from netem.wire.credentials import Credentials, agent_role, host_role
from netem.wire.keys import Keys
from netem.wire.link_loss import end_with_link
from netem.wire.mailbox import Mailbox
from netem.wire.session import quiet_zenoh
from netem.wire.vehicle_bus import AgentEnd
from world.errors import PluginError
from world.plugins.kept_files import KeptFiles, files_are_kept
from world.plugins.loading import unit_file
from world.plugins.output import lines_go_into
from world.plugins.trust import allow_file


def run(
    endpoint: str,
    run_id: str,
    vehicle: int,
    credentials: Credentials,
    end: socket | None = None,
    incarnation: int = 0,
    begin: int = 0,
    kept: Path | None = None,
) -> None:
    """Join a run as agent `vehicle` and answer navs, from tick `begin` on, until the process is ended. `end`: of the
    vehicle's bus; None: that is on zenoh. `kept`: a folder whose files outlive this process. Raises BusError if the run
    cannot be joined. Passes on whatever the controller raised; the console has a note about it by then.
    """
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    values = _ask_config(bus, keys.cfg(vehicle))
    config = AgentConfig.from_values(values["agent"])
    wires = None if end is None else AgentEnd(end, keys.nav(vehicle))
    with files_are_kept(KeptFiles(kept)):
        life = begin_life(bus, keys, config, incarnation, begin, clock_of(values), end=wires)
    life.serve()


def run_host(endpoint: str, run_id: str, number: int, credentials: Credentials, running: Path) -> None:
    """Join a run as host `number`, and answer the navs of its agents in lockstep until the process is ended. `running`:
    a file that says at any time which of them is computing. Raises BusError if the run cannot be joined.
    """
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    values = _ask_config(bus, keys.cfg(host_role(number)))
    mark = Running(running)
    agents = []
    for slice_ in values["agents"]:
        config = AgentConfig.from_values(slice_)
        mark.at(config.id)
        core = _core(bus, keys, config, 0)
        loop = AgentLoop(core, config.round_ticks)
        agents.append(OneAgent(bus, keys, config.id, loop))
    mark.at(0)
    process = HostProcess(bus, keys, number, agents, mark)
    process.get_ready()
    process.serve()


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
    end: AgentEnd | None = None,
) -> AgentProcess:
    """Make an agent that is ready: world and netem have both answered it. `core` answers samples for a program that is
    not ours and gives no memory; None: the core that `config` names. `end`: of the vehicle's bus; None: that is on
    zenoh. Raises BusError if world or netem does not answer, and SystemExit if a law cannot be made. The console has a
    note about the law by then.
    """
    vehicle = config.id
    core = _core(bus, keys, config, begin) if core is None else core
    m = config.round_ticks
    process: AgentProcess
    if clock is Clock.REAL:
        process = RealtimeAgentProcess(bus, keys, vehicle, RealtimeLoop(core, m, incarnation=incarnation, begin=begin))
    else:
        loop = AgentLoop(core, m, incarnation=incarnation, begin=begin)
        process = AgentProcess(bus, keys, vehicle, loop, end)
    process.get_ready()
    return process


def _core(bus: Bus, keys: Keys, config: AgentConfig, begin: int) -> AgentCore:
    if config.agent is not None and (file := unit_file("agent", config.agent.name)):
        allow_file(config.agent.name, Path(file))  # the console, which has started this process, has let it run
    try:
        with lines_go_into(None):
            return make_agent(config)
    except (AgentError, PluginError) as error:
        role = agent_role(config.id)
        give_up(Mailbox(bus, role, keys.note(role)), config.id, begin, error)


def _ask_config(bus: Bus, key: str) -> dict[str, Any]:
    deadline = monotonic() + READY_TIMEOUT_S
    while monotonic() < deadline:
        answer = bus.ask(key)
        if answer is not None:
            return read_map(answer)
        sleep(RETRY_S)  # the console does not answer yet: zenoh returns at once
    raise BusError(f"the console did not answer on {key} within {READY_TIMEOUT_S:.0f} s")
