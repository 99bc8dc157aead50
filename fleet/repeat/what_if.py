"""`fleet whatif`: what one vehicle's agent would have commanded, had it been another.

A fresh agent is given the navigation and the inbox that the recorded one had, sample by sample: open loop, since the
vehicle went where the recorded commands sent it. Where the run goes on from another, it begins with the memory that the
recorded one had then. With nothing changed it commands the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import astuple

from agents.agent import Agent
from agents.controllers import BUILT_IN, laws
from agents.errors import AgentError
from agents.loop import restore
from agents.make_agent import make_agent
from agents.plugged_agent import PluggedAgent
from fleet.errors import FleetError
from fleet.logs.decoder import Decoder
from fleet.logs.reader import LogReader, Record, Tell, log_path
from fleet.logs.schemas import COMMAND, PACKET, ROLL, STATE, Column
from fleet.recorder.snapshot import Start
from fleet.repeat.recorded_run import recorded as read
from fleet.repeat.resume import start_of
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import A_LOG, Policy
from netem.lives import Lives
from netem.transit import stamped
from netem.vehicle_clock import Clocks
from netem.wire.messages import Delivery, Nav
from world.errors import PluginError
from world.plugins.loading import admit
from world.plugins.trust import NOTHING, Permission, Trust

Array = np.ndarray[Any, np.dtype[np.float64]]
COMPONENTS = (("surge force", "N"), ("pitch moment", "N m"), ("yaw moment", "N m"))


class WhatIfError(FleetError):
    """The log does not hold what an agent would need, or its law may not run."""


class LawFailedError(WhatIfError):
    """The agent's law raised, or returned what cannot be used; the text names vehicle, tick, file and line."""

    status = 3  # as of a run


@dataclass(slots=True)
class WhatIf:
    """The commands of two agents with the same senses; shapes (samples,) and (samples, 3)."""

    agent: int
    scenario: Scenario  # with the changes
    t: Array  # s
    recorded: Array  # N, N m, N m, as commanded
    found: Array
    heard: int  # messages
    lives: int  # how often the agent began
    notes: list[str] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """Whether every command is the same to the last bit."""
        return bool(np.array_equal(self.recorded, self.found))

    @property
    def first_s(self) -> float | None:
        """Time of the first command that differs [s]."""
        different = np.flatnonzero((self.recorded != self.found).any(axis=1))
        return float(self.t[different[0]]) if len(different) else None


def what_if(
    path: Path,
    agent: int,
    overrides: Sequence[str] = (),
    progress: Callable[[float], None] = lambda _: None,
    trust: Trust = NOTHING,
) -> WhatIf:
    """Give a fresh agent what a recorded one was given.

    Args:
        overrides: `key=value`, as for `fleet run --set`; they concern this agent alone.
        progress: called with the share that is done: of the two readings of the log, and then of the agent.
        trust: which modules of this agent's laws may run besides those that are installed and those in `overrides`.

    Raises:
        FleetError: there is no log of ours.
        ScenarioError: an override is wrong.
        WhatIfError: the agent is not there, its navigation was thinned, or its law may not run.
        LawFailedError: its law failed.
    """
    path = log_path(path)
    source = read(path, progress)
    source.insist_on_lockstep("what an agent had heard when is not in it")
    scenario, recorded = source.script(overrides, Policy(trust, imports=False)), source.script()
    if scenario.vehicles != recorded.vehicles or scenario.tick_ns != recorded.tick_ns:
        raise WhatIfError("another number of vehicles, or another tick, is another run: use fleet run")
    if not 1 <= agent <= scenario.vehicles:
        raise WhatIfError(f"there is no agent {agent}: they are 1 to {scenario.vehicles}")
    for group in ("nav", "command"):
        if (every := recorded.log_every[group]) > 1:
            raise WhatIfError(f"{path} has every {every}th {group} only: an agent needs all (log.{group}: 1 tick)")
    try:
        permission = Permission(trust, elsewhere=(Path(),), because=A_LOG)
        for kind, law in laws(scenario.controls[agent - 1]).items():
            if law.name not in BUILT_IN[kind]:
                admit(kind, law.name, permission)
        scenario.layout(agent)
    except (AgentError, PluginError) as error:
        raise WhatIfError(f"{path}: {error}") from None
    navs, commands, deliveries, start = _read(path, agent, scenario.tick_ns, progress)
    if not navs:
        raise WhatIfError(f"{path} has no navigation of agent {agent}")
    memory = None if start is None or navs[0][0] != start.snapshot.tick else start.snapshot.memories.get(agent)
    same = _law(scenario, agent) == _law(recorded, agent)
    keeps = same and start is not None and agent not in start.anew
    if memory is not None:  # it waits for what was on the way, which is in the log, too, beside what it had heard
        heard = [delivery for delivery in deliveries if delivery.due_tick >= navs[0][0]]
        # What it has is stamped by the senders' clocks; what is in the log, too, by simulated time.
        due_later = {(d.due_tick, d.src, d.seq, d.copy): d for d in [*restore(None, memory), *heard]}
        deliveries = sorted(due_later.values(), key=astuple)
    lives = Lives(recorded.faults.absences)
    begins = [0, *(end for _, end in lives.gaps(agent) if end is not None)]
    result = _Answers()
    if memory is not None and not same:
        result.notes.append(
            f"the log begins at t = {navs[0][0] * scenario.tick_ns / 1e9:g} s; the other agent has no memory then"
        )
    if agent in recorded.external:
        result.notes.append(f"vehicle {agent} is external: what was recorded is what somebody else's agent commanded")
    senders, own = (Clocks.that_differ(s.clocks, s.faults.world, s.tick_ns) for s in (recorded, scenario))
    core: Agent | PluggedAgent | None = None
    life, waiting = -1, 0
    for done, (tick, measured) in enumerate(navs):
        incarnation = lives.incarnation(agent, tick)
        if core is None or incarnation != life:
            try:
                first = core is None
                core, life = make_agent(scenario.agent_config(agent)), incarnation
                if first and memory is not None and keeps:
                    restore(core, memory)
            except (AgentError, PluginError) as error:
                raise LawFailedError(str(error)) from None
            # What fell due before was for the life before, or for none.
            while begins[life] and waiting < len(deliveries) and deliveries[waiting].due_tick <= begins[life]:
                waiting += 1
        due = []
        while waiting < len(deliveries) and deliveries[waiting].due_tick <= tick:
            due.append(deliveries[waiting] if senders is None else stamped(deliveries[waiting], senders))
            waiting += 1
        try:
            shown_ns = None if own is None else own.reading_ns(agent, tick)
            step = core.step(Nav(life, tick, measured[:5], measured[5:10], measured[10:], shown_ns), due)
        except (AgentError, PluginError) as error:
            raise LawFailedError(str(error)) from None
        result.notes += [f"t = {at * scenario.tick_ns / 1e9:.2f} s: {text}" for at, text in core.take_notes()]
        if tick in commands:
            result.ticks.append(tick)
            result.recorded.append(commands[tick])
            result.found.append(step.tau)
            result.heard += len(due)
        if done % 500 == 0:
            progress(done / len(navs))
    t = np.array(result.ticks) * (scenario.tick_ns / 1e9)
    return WhatIf(
        agent,
        scenario,
        t,
        np.array(result.recorded).reshape(-1, 3),
        np.array(result.found).reshape(-1, 3),
        result.heard,
        life + 1,
        result.notes,
    )


def _law(scenario: Scenario, agent: int) -> object:
    """What must be the same for an agent to take the memory of another."""
    return laws(scenario.controls[agent - 1]), scenario.graph.links


@dataclass(slots=True)
class _Answers:
    ticks: list[int] = field(default_factory=list)
    recorded: list[tuple[float, ...]] = field(default_factory=list)
    found: list[tuple[float, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    heard: int = 0


def _read(
    path: Path, agent: int, tick_ns: int, tell: Tell
) -> tuple[list[tuple[int, tuple[float, ...]]], dict[int, tuple[float, ...]], list[Delivery], Start | None]:
    """(tick, measured eta, nu, roll) of every sample; commands by tick; what was delivered, in order; its beginning."""
    navs: list[tuple[int, tuple[float, ...]]] = []
    commands: dict[int, tuple[float, ...]] = {}
    deliveries: list[Delivery] = []
    reader = LogReader(path, tell)
    decoder = Decoder(reader)

    def decode(record: Record, columns: Sequence[Column]) -> Any:
        if (message := decoder.ours(record, columns)) is None:
            raise WhatIfError(f"{path}: a message of {record.topic} at t = {record.log_ns / 1e9:g} s is damaged")
        return message

    nav, command = f"uuv/{agent}/nav", f"uuv/{agent}/command"
    for record in reader:
        if record.topic == nav:
            m = decode(record, STATE)
            columns = STATE + ROLL if "phi" in m.DESCRIPTOR.fields_by_name else STATE
            navs.append((record.log_ns // tick_ns, tuple(getattr(m, column.name) for column in columns)))
        elif record.topic == command:
            commands[record.log_ns // tick_ns] = tuple(decode(record, COMMAND[:1]).tau)
        elif record.topic.startswith("link/") and record.topic.endswith(f"-{agent}"):
            m = decode(record, PACKET)
            if m.fate == "delivered":
                src = int(record.topic.removeprefix("link/").split("-")[0])
                sent = record.publish_ns // tick_ns
                deliveries.append(Delivery(record.log_ns // tick_ns, sent, src, m.seq, m.copy, m.payload))
    return navs, commands, sorted(deliveries, key=astuple), start_of(reader)
