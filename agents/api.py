"""The interface of control laws: the input and the output of a law. It is the same for shipped laws and for yours.

A *controller* turns a sample into forces. It may consist of two laws. A *guidance law* turns the sample into a
commanded velocity. A *tracking law* turns that command into forces. Any guidance law works with any tracking law.
A whole *agent* also decides what it sends to its neighbours. A law needs no other module of this package. The names in
`__all__` are stable. `docs/guide/plugins.md` is the guide; `fleet new controller NAME` writes a template.

The agent makes its law once per run, as `Law(config, **parameters)`. `config` is the agent's own slice of the scenario,
and `parameters` are the values that the scenario gives the law. A law has

* `signals`: its reported values, a tuple of `Signal` on the class;
* `step`: answers one sample, see `Controller`, `Guidance`, `Tracking`. An agent has `transmit` and `decide` instead.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar, Protocol

import agents
from agents.config import AgentConfig
from agents.errors import PayloadError
from agents.formation_agent import FormationAgent
from agents.laws.angles import wrap
from agents.laws.kinematics import earth_velocity, flight_path
from agents.message import pack, unpack
from agents.sample import NeighbourState, Sample, VelocityCommand
from agents.trajectory import Motion
from agents.udp_port import Received, UdpPort
from netem.wire.messages import Delivery, Nav, Said
from world.signal import Signal
from world.vectors import Vec3, Vec5

__all__ = [
    "AgentConfig",
    "Controller",
    "Delivery",
    "FormationAgent",
    "Guidance",
    "Motion",
    "Nav",
    "NeighbourState",
    "PayloadError",
    "Received",
    "Said",
    "Sample",
    "Signal",
    "Telemetry",
    "Tracking",
    "UdpPort",
    "Vec3",
    "Vec5",
    "VelocityCommand",
    "WholeAgent",
    "earth_velocity",
    "flight_path",
    "pack",
    "unpack",
    "wrap",
]

if sys.flags.optimize < 2 and not (agents.__doc__ or "").startswith("Agents: "):
    # Another distribution has overwritten files of this package; what is left of it may seem to work.
    raise ImportError(
        f"the package agents in {agents.__path__[0]} is not that of uuv-fleet, or mixed with it; install uuv-fleet "
        "into an environment of its own: uv tool install, or pipx install"
    )

Telemetry = Mapping[str, float | Sequence[float] | None]  # by the name of a signal, in its unit; None: not known yet


class Controller(Protocol):
    """A law that turns a sample into forces."""

    signals: ClassVar[tuple[Signal, ...]]

    def step(self, sample: Sample) -> tuple[Vec3, Telemetry]:
        """Answer one sample.

        Args:
            sample: all that the law may know now.

        Returns:
            Surge force [N], pitch moment and yaw moment [N m], before the actuators' limits; and the telemetry: a
            number, or a sequence of `width` numbers, for each name in `signals`.
        """


class Guidance(Protocol):
    """A law that turns a sample into a commanded velocity."""

    signals: ClassVar[tuple[Signal, ...]]

    def step(self, sample: Sample) -> tuple[Vec3, Telemetry]:
        """Answer one sample.

        Args:
            sample: all that the law may know now.

        Returns:
            The commanded velocity over ground [m/s, NED], and the telemetry.
        """


class Tracking(Protocol):
    """A law that turns a sample and a command into forces."""

    signals: ClassVar[tuple[Signal, ...]]

    def step(self, sample: Sample, command: VelocityCommand) -> tuple[Vec3, Telemetry]:
        """Answer one sample.

        Args:
            sample: all that the law may know now.
            command: speed [m/s], pitch and course of the velocity [rad, NED] that guidance asks for.

        Returns:
            Surge force [N], pitch moment and yaw moment [N m], before the actuators' limits; and the telemetry.
        """


class WholeAgent(Protocol):
    """A whole agent: it decides what it sends as well as how its vehicle moves.

    It may have a third method, `take_said(self) -> Sequence[Said]`, which is called after each `decide`: the lines for
    the log that it has to say since the last call. A line is `Said(at_ns, stream, text)`: the simulated time from the
    beginning of the run [ns]; `out`, `err`, `end` or `failed`; and a text without a line break. If an agent says
    something on `failed`, the run does not pass. The log takes at most 200 lines of a vehicle with each tick, and the
    others later.
    """

    signals: ClassVar[tuple[Signal, ...]]

    def transmit(self, nav: Nav) -> Sequence[bytes]:
        """Choose what to send to every neighbour, at round ticks.

        Args:
            nav: the own measured state. `tick` is the time by the vehicle's own clock. `eta` is x, y, z [m, NED],
                theta, psi [rad]. `nu` is u, v, w [m/s, body, over ground], q, r [rad/s]. `roll` is phi [rad], p
                [rad/s]; it is empty without a plant. `belief` is the covariance of x, y, z, psi [m, rad]: the upper
                triangle, row by row. It is empty if the vehicle does not estimate its position.

        Returns:
            The payloads, at most 40 kB together; an empty sequence if there is nothing to say.
        """

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Answer one sample, at every tick.

        Args:
            nav: the own measured state, as for `transmit`.
            deliveries: the packets that are due at this tick, ordered by (due_tick, sent_tick, src, seq, copy). Each
                has `src`, `sent_tick` (by the sender's clock), `due_tick` (by the own clock), `seq`, `copy` and
                `payload`. If modems measure ranges, it also has the range to the sender `range_m` [m], its standard
                deviation `range_sd_m` [m], and `range_tick`: the vehicles had this distance at that tick, by the own
                clock. Without a range these three are None.

        Returns:
            Surge force [N], pitch moment and yaw moment [N m], before the actuators' limits; and the telemetry.
        """
