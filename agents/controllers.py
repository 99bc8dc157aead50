"""The laws by name, and how they become the controller of one agent.

A guidance law turns a sample into a commanded velocity, a tracking law turns its speed and direction into forces;
any guidance goes with any tracking. The paper's five controllers are five of these pairs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from agents.config import AgentConfig, KeepApartParams, Law, LocalizationParams
from agents.laws.backstepping import BacksteppingTracking, NeurodynamicTracking, SlidingModeTracking
from agents.laws.guidance import FixedGuidance, OptimalGuidance
from agents.laws.keep_apart import KeepApart
from agents.laws.velocity_command import direction_command, floor_speed
from agents.localization.localizer import Localizer
from agents.neighbours import NeighbourTable
from agents.plugins.laws import FencedLaw, load
from agents.sample import Sample, VelocityCommand
from agents.signals import COMMANDED, HEARD, SignalLayout
from world.vectors import Vec3

GUIDANCE: dict[str, type[OptimalGuidance] | type[FixedGuidance]] = {
    "optimal": OptimalGuidance,
    "fixed": FixedGuidance,
}
TRACKING: dict[str, type[NeurodynamicTracking] | type[BacksteppingTracking] | type[SlidingModeTracking]] = {
    "neurodynamic": NeurodynamicTracking,
    "backstepping": BacksteppingTracking,
    "sliding-mode": SlidingModeTracking,
}


Notes = list[tuple[int, str]]  # (tick, text) for a person


class LawPair(NamedTuple):
    """A controller of the paper: its guidance law, its tracking law, and what it is."""

    guidance: str
    tracking: str
    meaning: str


CONTROLLERS: dict[str, LawPair] = {
    "nboc": LawPair("optimal", "neurodynamic", "neurodynamics-based backstepping optimal control: the paper's"),
    "boc": LawPair("optimal", "backstepping", "backstepping optimal control"),
    "nbc": LawPair("fixed", "neurodynamic", "neurodynamics-based backstepping control"),
    "bc": LawPair("fixed", "backstepping", "backstepping control"),
    "bsmc": LawPair("fixed", "sliding-mode", "backstepping sliding mode control"),
}

BUILT_IN: dict[str, Mapping[str, type[Any]]] = {
    "guidance": GUIDANCE,
    "tracking": TRACKING,
    "controller": {},
    "agent": {},
}


class RunningLaw(Protocol):
    """A law of one vehicle as the agent uses it: ours, or a user's behind a fence."""

    def step(self, sample: Sample, *more: Any) -> tuple[Vec3, tuple[float, ...]]: ...


def law_class(kind: str, law: Law) -> type[Any]:
    """The class of a law, ours or a user's. Raises PluginError: there is none, or it cannot be used."""
    ours = BUILT_IN[kind].get(law.name)
    return ours if ours is not None else load(kind, law)


class LawChoice(Protocol):
    """Which laws a vehicle runs; an `AgentConfig` is one."""

    @property
    def agent(self) -> Law | None: ...
    @property
    def controller(self) -> Law | None: ...
    @property
    def guidance_law(self) -> Law: ...
    @property
    def tracking_law(self) -> Law: ...
    @property
    def keep_apart(self) -> KeepApartParams | None: ...
    @property
    def localization(self) -> LocalizationParams | None: ...


def laws(config: LawChoice) -> dict[str, Law]:
    if config.agent is not None:
        return {"agent": config.agent}
    if config.controller is not None:
        return {"controller": config.controller}
    return {"guidance": config.guidance_law, "tracking": config.tracking_law}


def speaks(config: LawChoice) -> bool:
    """Whether the agent may have lines for the log. Raises PluginError: its class cannot be used."""
    return config.agent is not None and hasattr(law_class("agent", config.agent), "take_said")


def layout(config: LawChoice) -> SignalLayout:
    """The values that an agent with these laws reports. Raises PluginError: one of its laws cannot be used."""
    signals = {kind: law_class(kind, law).signals for kind, law in laws(config).items()}
    if "agent" in signals:
        return SignalLayout((), signals["agent"])
    known = HEARD if config.localization is None else (*HEARD, *Localizer.signals_of(config.localization))
    if "controller" in signals:
        return SignalLayout(known, signals["controller"])
    keep_apart = () if config.keep_apart is None else KeepApart.signals
    return SignalLayout((*known, *COMMANDED, *signals["guidance"], *keep_apart), signals["tracking"])


class FencedController:
    """A user's controller behind a fence."""

    def __init__(self, config: AgentConfig, law: Law, notes: Notes) -> None:
        self._law = FencedLaw(config, law, load("controller", law), "(tau1, tau2, tau3)", notes)

    def step(self, sample: Sample) -> tuple[Vec3, tuple[float, ...]]:
        """Force and moments [N, N m] before the limits, and the telemetry as one flat tuple."""
        return self._law.step(sample)

    def counters(self) -> dict[str, int]:
        return {}


class Cascade:
    """A guidance law followed by a tracking law, and by what keeps vehicles apart between them."""

    def __init__(self, config: AgentConfig, notes: Notes, neighbours: NeighbourTable | None = None) -> None:
        """Make both laws; `notes` as for `build`. Without `neighbours` nothing is kept apart."""
        self._params = config.tracking
        self.guidance = _make("guidance", config, config.guidance_law, "velocity", notes)
        self.tracking = _make("tracking", config, config.tracking_law, "(tau1, tau2, tau3)", notes)
        self._neighbours = neighbours
        self._keep_apart: KeepApart | None = None
        if config.keep_apart is not None and neighbours is not None:
            self._keep_apart = KeepApart(config.keep_apart, config.tracking.u_floor)
        self._held: tuple[float, float] | None = None  # theta_cmd, psi_cmd of the previous sample

    def step(self, sample: Sample) -> tuple[Vec3, tuple[float, ...]]:
        """Force and moments [N, N m] before the limits, and the telemetry as one flat tuple."""
        params, nu = self._params, sample.nu
        theta, psi = sample.eta[3:] if self._held is None else self._held
        rho, guidance = self.guidance.step(sample)
        if self._keep_apart is not None and self._neighbours is not None:
            rho, change = self._keep_apart.step(rho, sample, self._neighbours.sampled_states())
            guidance = (*guidance, *change)
        u_cmd, theta, psi = direction_command(rho, theta, psi, params.rho_eps)
        self._held = (theta, psi)
        u_cmd = floor_speed(u_cmd, nu[1], nu[2], params.u_floor)
        demand, control = self.tracking.step(sample, VelocityCommand(u_cmd, theta, psi))
        return demand, (*rho, u_cmd, theta, psi, *guidance, *control)

    def counters(self) -> dict[str, int]:
        failures = getattr(self.guidance, "failures", None)
        found: dict[str, int] = {} if failures is None else {"qp_failures": failures}
        if self._keep_apart is not None:
            found["keep_apart_infeasible"] = self._keep_apart.infeasible
        return found


def build(config: AgentConfig, notes: Notes, neighbours: NeighbourTable) -> Cascade | FencedController:
    """The controller of one agent; `notes` takes (tick, text) of what a person should know about the laws. Raises
    PluginError if one of its laws cannot be used; ControllerError if one of its laws cannot be made.
    """
    if config.controller is not None:
        return FencedController(config, config.controller, notes)
    return Cascade(config, notes, neighbours)


def _make(kind: str, config: AgentConfig, law: Law, what: str, notes: Notes) -> RunningLaw:
    """The law of one kind; `what` names its answer in messages."""
    if (ours := BUILT_IN[kind].get(law.name)) is None:
        return FencedLaw(config, law, load(kind, law), what, notes)
    made: RunningLaw = ours(config)
    return made
