"""`fleet whatif`: what one vehicle's agent would have commanded, had it been another.

A fresh agent is given the navigation and the inbox that the recorded one had, sample by sample: open loop, since the
vehicle went where the recorded commands sent it. Where the run goes on from another, it begins with the memory that the
recorded one had then. With nothing changed it commands the same to the last bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import astuple, replace

from agents.controllers import BUILT_IN, laws
from agents.errors import AgentError
from agents.loop import AgentCore
from agents.make_agent import make_agent
from fleet.errors import FleetError
from fleet.execution.in_process import InProcess
from fleet.execution.moments import reach
from fleet.logs.decoder import Decoder
from fleet.logs.schemas import BELIEF, COMMAND, PACKET, ROLL, STATE, MessageField
from fleet.logs.topic_names import link_of
from fleet.mcap.reader import LogReader, OnProgress, Record, log_path
from fleet.recorder.start import set_up_otherwise
from fleet.repeat.recorded_run import read_recorded_run as read
from fleet.repeat.verify import start_of
from fleet.scenario.scenario import Scenario, timeline
from fleet.scenario.text.overrides import Override
from fleet.scenario.trust import A_LOG, Policy, ran_from
from netem.lives import Lives
from netem.transit import with_sender_time
from netem.vehicle_clock import Clocks
from netem.wire.messages import Delivery, Nav
from world.errors import PluginError
from world.plugins.loading import admit
from world.plugins.trust import Permission

Array = np.ndarray[Any, np.dtype[np.float64]]
COMPONENTS = (("surge force", "N"), ("pitch moment", "N m"), ("yaw moment", "N m"))


class Component(Struct, frozen=True):
    """How far one component of the commands is from the recorded one."""

    unit: str
    max: float | None
    at_s: float
    rms: float | None


class OtherCommands(Struct, frozen=True):
    """`fleet whatif --json`: the commands of another agent, compared with the recorded ones."""

    agent: int
    samples: int
    messages: int
    identical: Annotated[bool, Meta(description="Whether every command is the recorded one, to the last bit.")]
    first_s: Annotated[float | None, Meta(description="Time of the first one that is not; null: there is none.")]
    components: Annotated[dict[str, Component], Meta(description="By component; none without a command.")]
    notes: list[str]


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

    @property
    def compared(self) -> OtherCommands:
        away = abs(self.found - self.recorded)
        components = {
            name: Component(unit, float(far.max()), float(self.t[far.argmax()]), float((far**2).mean() ** 0.5))
            for (name, unit), far in zip(COMPONENTS if len(self.t) else (), away.T, strict=False)
        }
        return OtherCommands(self.agent, len(self.t), self.heard, self.identical, self.first_s, components, self.notes)


def what_if(
    path: Path, agent: int, overrides: Sequence[str | Override] = (), progress: Callable[[float], None] = lambda _: None
) -> WhatIf:
    """Give a fresh agent what a recorded one was given. `overrides` are `key=value`, as for `fleet run --set`, for this
    agent alone. `progress` gets the share that is done: two readings of the log, then the agent. Raises FleetError if
    there is no log of ours, the agent is not there, its navigation was thinned, or its law may not run or failed;
    ScenarioError if an override is wrong.
    """
    path = log_path(path)
    source = read(path, progress)
    source.insist_on_lockstep(
        "what an agent had heard when is not in it", "fleet netem FILE --set tries another network, or other programs"
    )
    scenario, recorded = source.script(overrides, Policy(imports=False)), source.script()
    _check(path, agent, scenario, recorded, source.text)
    given = _read(path, agent, scenario.tick_ns, progress)
    if not given.navs:
        raise FleetError(f"{path} has no navigation of agent {agent}")
    start = start_of(source)
    before = None if start is None else reach(start, progress).run
    other = _OtherAgent(agent, scenario, recorded, given, before)
    for done, (tick, measured) in enumerate(given.navs):
        other.step(tick, measured)
        if done % 500 == 0:
            progress(done / len(given.navs))
    found = other.found()
    if source.reader.missing:
        found.notes.append(f"the log is NOT WHOLE: {source.reader.missing}")
    return found


def _check(path: Path, agent: int, scenario: Scenario, recorded: Scenario, text: str) -> None:
    """Raises FleetError: the log cannot say what this agent had known, or its laws may not run."""
    if scenario.vehicles != recorded.vehicles or scenario.tick_ns != recorded.tick_ns:
        raise FleetError("another number of vehicles, or another tick, is another run: use fleet run")
    if not 1 <= agent <= scenario.vehicles:
        raise FleetError(f"there is no agent {agent}: the agents are 1 to {scenario.vehicles}")
    for group in ("nav", "command", *(("belief",) if recorded.belief(agent) else ())):
        if (every := recorded.log_every[group]) > 1:
            raise FleetError(f"{path} has every {every}th {group} only: an agent needs all (log.{group}: 1 tick)")
    try:
        permission = Permission(ran_from(text), (Path(),), A_LOG)
        for kind, law in laws(scenario.controls[agent - 1]).items():
            if law.name not in BUILT_IN[kind]:
                admit(kind, law.name, permission)
        scenario.layout(agent)
    except (AgentError, PluginError) as error:
        raise FleetError(f"{path}: {error}") from None


@dataclass(slots=True)
class _Given:
    navs: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)  # tick; eta, nu and roll as measured
    beliefs: dict[int, tuple[float, ...]] = field(default_factory=dict)  # by tick: the covariance of its estimate
    commands: dict[int, tuple[float, ...]] = field(default_factory=dict)  # by tick
    deliveries: list[Delivery] = field(default_factory=list)  # in order


class _OtherAgent:
    """The agent that is asked: a fresh one for each life of the recorded one."""

    def __init__(
        self, agent: int, scenario: Scenario, recorded: Scenario, given: _Given, before: InProcess | None
    ) -> None:
        self._agent, self._scenario = agent, scenario
        self._beliefs, self._commands = given.beliefs, given.commands
        self._lives = Lives(recorded.faults.absences)
        self._senders, self._own = (
            Clocks.that_differ(s.clocks, s.faults.world, s.tick_ns) for s in (recorded, scenario)
        )
        self._begins = [0, *(end for _, end in self._lives.gaps(agent) if end is not None)]  # of its lives
        self._core: AgentCore | None = None
        self._life = -1
        self._ticks: list[int] = []
        self._recorded: list[tuple[float, ...]] = []
        self._found: list[tuple[float, ...]] = []
        self._heard = 0
        self._notes: list[str] = []
        first, deliveries = given.navs[0][0], given.deliveries
        self._first: AgentCore | None = None  # with which its first life begins; None: with a new one
        if before is not None and (known := before.life(agent)) is not None and first == before.granted:
            # It waits for what was on the way, which is in the log, too, beside what it had heard.
            heard = [delivery for delivery in deliveries if delivery.due_tick >= first]
            # What it has is stamped by the senders' clocks, what is in the log by simulated time.
            due_later = {(d.due_tick, d.src, d.seq, d.copy): d for d in [*known.waiting, *heard]}
            deliveries = sorted(due_later.values(), key=astuple)
            if set_up_otherwise(scenario, recorded, agent):
                at = f"t = {first * scenario.tick_ns / 1e9:g} s"
                self._notes.append(f"the log begins at {at}; the other agent has no memory then")
            elif not set_up_otherwise(recorded, before.scenario, agent):
                self._first = known.core
        self._waiting = deque(deliveries)
        if agent in recorded.external:
            self._notes.append(
                f"vehicle {agent} is external: what was recorded is what somebody else's agent commanded"
            )

    def step(self, tick: int, measured: tuple[float, ...]) -> None:
        try:
            life = self._lives.incarnation(self._agent, tick)
            if self._core is None or life != self._life:
                self._core = self._begin(life)
            due = self._due(tick)
            shown_ns = None if self._own is None else self._own.reading_ns(self._agent, tick)
            belief = self._beliefs.get(tick, ())
            known = () if belief and isnan(belief[0]) else belief
            nav = Nav(life, tick, measured[:5], measured[5:10], measured[10:], shown_ns, known)
            if tick % self._scenario.round_ticks == 0:
                self._core.transmit(nav)
            tau = self._core.decide(nav, due).tau
        except (AgentError, PluginError) as error:
            raise FleetError(str(error), status=3) from None
        tick_s = self._scenario.tick_ns / 1e9
        self._notes += [f"t = {at * tick_s:.2f} s: {text}" for at, text in self._core.take_notes()]
        if tick in self._commands:
            self._ticks.append(tick)
            self._recorded.append(self._commands[tick])
            self._found.append(tau)
            self._heard += len(due)

    def _begin(self, life: int) -> AgentCore:
        core, self._first = self._first or make_agent(self._scenario.agent_config(self._agent)), None
        self._life = life
        if self._begins[life]:
            self._due(self._begins[life])  # what fell due before was for the life before, or for none
        return core

    def _due(self, tick: int) -> list[Delivery]:
        """The deliveries that are due up to a tick; each is handed out once."""
        due = []
        while self._waiting and self._waiting[0].due_tick <= tick:
            delivery = self._waiting.popleft()
            due.append(delivery if self._senders is None else with_sender_time(delivery, self._senders))
        return due

    def found(self) -> WhatIf:
        return WhatIf(
            self._agent,
            self._scenario,
            np.array(self._ticks) * (self._scenario.tick_ns / 1e9),
            np.array(self._recorded).reshape(-1, 3),
            np.array(self._found).reshape(-1, 3),
            self._heard,
            self._life + 1,
            self._notes,
        )


def _ranged(delivery: Delivery, m: Any, tick_ns: int) -> Delivery:
    """A delivery with the range that its packet has in the log, if it has one."""
    if "range" not in m.DESCRIPTOR.fields_by_name or isnan(m.range):
        return delivery
    return replace(delivery, range_m=m.range, range_sd_m=m.range_sd, range_tick=round(m.ranged * 1e9 / tick_ns))


def _read(path: Path, agent: int, tick_ns: int, on_progress: OnProgress) -> _Given:
    given = _Given()
    reader = LogReader(path, on_progress)
    decoder = Decoder(reader)

    def decode(record: Record, columns: Sequence[MessageField]) -> Any:
        if (message := decoder.ours(record, columns)) is None:
            raise FleetError(f"{path}: a message of {record.topic} at t = {record.log_ns / 1e9:g} s is damaged")
        return message

    nav, belief, command = (f"uuv/{agent}/{group}" for group in ("nav", "belief", "command"))
    for record in reader:
        if record.topic == nav:
            m = decode(record, STATE)
            columns = STATE + ROLL if "phi" in m.DESCRIPTOR.fields_by_name else STATE
            given.navs.append((record.log_ns // tick_ns, tuple(getattr(m, column.name) for column in columns)))
        elif record.topic == belief:
            given.beliefs[record.log_ns // tick_ns] = tuple(decode(record, BELIEF).covariance)
        elif record.topic == command:
            given.commands[record.log_ns // tick_ns] = tuple(decode(record, COMMAND[:1]).tau)
        elif (link := link_of(record.topic)) is not None and link[1] == agent:
            m = decode(record, PACKET)
            if m.fate == "delivered":
                sent = record.publish_ns // tick_ns
                delivery = Delivery(record.log_ns // tick_ns, sent, link[0], m.seq, m.copy, m.payload)
                given.deliveries.append(_ranged(delivery, m, tick_ns))
    given.deliveries.sort(key=astuple)
    return given


def draw(found: WhatIf, path: Path, digest: str) -> None:
    """Write the picture, as wide as a column. `digest`: of the log that the agent heard. Raises FleetError if the file
    cannot be written, or its suffix is none of a picture.
    """
    from fleet.addons.pictures.axes import bounds
    from fleet.addons.pictures.caption import write_caption
    from fleet.addons.pictures.look import column_in
    from fleet.addons.pictures.shades import shade
    from fleet.addons.pictures.style import Provenance, format_of, legend, line, panels, save_as

    format_of(path)  # before the work
    figure, axes = panels(3, 1, column_in(), 4.6)
    notes: list[str] = []
    for k, (ax, (name, unit)) in enumerate(zip(axes, COMPONENTS, strict=True)):
        line(ax, 0, found.t, found.recorded[:, k], f"agent {found.agent} of {found.scenario.name}, recorded")
        line(ax, 1, found.t, found.found[:, k], "what if, open loop")
        most = found.scenario.controls[found.agent - 1].tau_max[k]
        notes.append(bounds(ax, [(-most, most)], f"limits of the {name}", unit))
        ax.set_ylabel(f"{name} [{unit}]")
    axes[0].set_xlim(float(found.t[0]), float(found.t[-1]))
    numbered = shade(axes, timeline(found.scenario))
    axes[-1].set_xlabel("time [s]")
    legend(figure, axes[0], 1)
    write_caption(figure, [*filter(None, notes), *numbered])
    facts = (("scenario", found.scenario.name), ("seed", str(found.scenario.seed)), ("digest", digest))
    save_as(figure, path, Provenance(f"What if: agent {found.agent}", facts))
