"""The agent that ships, for use inside a whole agent of one's own.

A protocol of one's own seldom wants to steer its vehicle anew. It makes one of these, lets it send and decide as the
scenario's `guidance` and `tracking` say, and adds messages of its own to what is sent:

```python
class MyProtocol:
    signals = (Signal("value", "1", "what it agrees on"),)

    def __init__(self, config):
        self._formation = FormationAgent(config)

    def transmit(self, nav):
        return [*self._formation.transmit(nav), pack("mine", [nav.tick, 1.5])]

    def decide(self, nav, deliveries):
        deliveries = list(deliveries)
        tau, _ = self._formation.decide(nav, deliveries)
        ...
        return tau, {"value": 1.5}
```
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from agents.agent import Agent
from agents.config import AgentConfig
from agents.message import VERSION
from agents.own_time import to_simulated_time
from agents.signals import SignalLayout
from agents.trajectory import Motion
from netem.wire.messages import Delivery, Nav
from world.signal import Signal
from world.vectors import Vec3


class FormationAgent:
    """The agent that a vehicle has if the user gives it no whole agent: it keeps the formation.

    On a moored vehicle there is nothing to steer: it sends nothing, reports nothing, and its forces are 0.
    """

    def __init__(self, config: AgentConfig) -> None:
        """Make the agent.

        Args:
            config: the agent's own slice of the scenario.
        """
        self.signals: tuple[Signal, ...] = ()
        self._where: dict[str, tuple[int, slice]] = {}
        self._agent: Agent | None = None
        if config.moored:
            return
        self._agent = Agent(replace(config, agent=None))
        layout: SignalLayout = self._agent.layout
        self._where = {signal.name: (signal.width, place) for _, signal, place in layout.signals()}
        self.signals = (*layout.guidance, *layout.control)  # what `decide` returns values for

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """Choose what to send to every neighbour, at round ticks.

        Args:
            nav: own measured state.

        Returns:
            One payload with the own position [m, NED] and velocity [m/s, NED]; none on a moored vehicle.
        """
        return () if self._agent is None else self._agent.transmit(to_simulated_time(nav))

    def decide(
        self, nav: Nav, deliveries: Iterable[Delivery], course: Motion | None = None
    ) -> tuple[Vec3, dict[str, float | tuple[float, ...]]]:
        """Answer one sample.

        Args:
            nav: own measured state.
            deliveries: what is due at this tick. Payloads that `pack` made are passed over.
            course: where to be now [m, NED] and how to move [m/s, NED], alone; None: as the formation asks.

        Returns:
            Surge force [N], pitch and yaw moment [N m]; and what it reports, by the names in `signals`.

        Raises:
            ControllerError: the measurement is not finite, time went back, or a law failed.
        """
        if self._agent is None:
            return (0.0, 0.0, 0.0), {}
        states = [d for d in deliveries if d.payload[:1] != _OWN]
        own, motion = to_simulated_time(nav), None if course is None else _motion(course)
        tau, telemetry, _ = self._agent.decide(own, states, motion)
        return tau, {
            name: telemetry[place.start] if width == 1 else telemetry[place]
            for name, (width, place) in self._where.items()
        }


_OWN = bytes((VERSION,))


def _motion(course: Motion) -> Motion:
    """The same in tuples of floats, whatever sequences it has."""
    (x, y, z), (vx, vy, vz) = course
    return Motion((float(x), float(y), float(z)), (float(vx), float(vy), float(vz)))
