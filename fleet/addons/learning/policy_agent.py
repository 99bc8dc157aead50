"""An agent whose decisions somebody else makes, now and then: it waits for them, and repeats them in between.

It hears and sends through the same network as any agent, and knows what its navigation believes, never the truth.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from agents.agent import Agent
from agents.codecs import codec
from agents.compact import OutOfRange
from agents.config import AgentConfig
from agents.errors import PayloadError
from agents.laws.kinematics import earth_velocity
from agents.laws.velocity_command import clip
from agents.loop import AgentLoop, Answer
from agents.message import pack, unpack
from agents.neighbours import NeighbourTable, own_time
from agents.payload import StateMessage
from agents.sample import Decision
from agents.trajectory import Motion
from netem.wire.messages import Delivery, Inbox, Nav
from world.vectors import Vec3

KIND = "policy"  # of messages that hold numbers
Numbers = tuple[float, ...]


class HeardMessage(NamedTuple):
    numbers: Numbers  # its content
    age_s: float  # since it was sent, by the clocks of both
    range_m: float | None  # as the modem measured it with that message


@dataclass(frozen=True, slots=True)
class Action:
    """The decision of a policy; it holds until the next one."""

    move: Vec3  # surge force [N], pitch and yaw moment [N m]; or a velocity over ground [m/s, NED]
    sends: bool
    message: Numbers


@dataclass(frozen=True, slots=True)
class Choices:
    """The choices that a policy has."""

    move: Literal["velocity", "force"]
    numbers: int  # of a message; 0: it is a state message of the scenario's payload
    resident: bool  # whether the scenario's own law computes along


@dataclass(slots=True)
class Seat:
    """The part of a vehicle's policy that survives when its agent is killed and begins again."""

    config: AgentConfig
    choices: Choices
    action: Action = Action((0.0, 0.0, 0.0), False, ())
    until: int = 0  # the tick at which the policy decides again
    life: HeldLife | None = None  # that of the agent which runs now
    heard: dict[int, HeardMessage] = field(default_factory=dict)  # by neighbour; at the tick of `nav`
    nav: Nav | None = None  # that the policy is asked about, or was last


class PolicyAgent:
    """One life of an agent that does what its policy decided."""

    def __init__(self, seat: Seat) -> None:
        self._seat, self.config = seat, seat.config
        config, choices = seat.config, seat.choices
        self._tick_s = config.tick_ns / 1e9
        # The scenario's own law: it turns a velocity into forces, or computes along.
        self.resident = Agent(config) if choices.resident or choices.move == "velocity" else None
        self._codec = codec(config)
        self._states = NeighbourTable(replace(config, extrapolation="hold", drop_after_s=0.0), self._codec)
        self._numbers: dict[int, tuple[int, HeardMessage]] = {}  # by sender: tick of sending, and the message
        x, y, z = config.tau_max
        self._limits: tuple[Vec3, Vec3] = ((-x, -y, -z), config.tau_max)
        self._foreseen: tuple[int, Decision] | None = None
        self._notes: list[tuple[int, str]] = []

    def look(self, nav: Nav, due: list[Delivery]) -> None:
        """Learn what is known at a tick before the policy decides. It is taken in once more with the decision."""
        seat, now = self._seat, own_time(nav, self.config.tick_ns)[0]
        seat.nav = nav
        self._absorb(nav, due)
        if seat.choices.numbers:
            seat.heard = {
                i: heard._replace(age_s=max(0, now - sent) * self._tick_s) for i, (sent, heard) in self._numbers.items()
            }
        else:
            seat.heard = {
                one.id: HeardMessage((*one.position, *one.velocity), one.age, one.range_m)
                for one in self._states.states_at(now)
            }

    def foresee(self, nav: Nav, due: list[Delivery]) -> Action:
        """The answer of the scenario's own law at this tick; the law is called once."""
        assert self.resident is not None
        sends = nav.tick % self.config.round_ticks == 0
        payloads = self.resident.transmit(nav) if sends else ()
        decision = self.resident.decide(nav, due)
        self._foreseen = nav.tick, decision
        state = self._own_state(nav)
        return Action(decision.tau, bool(payloads), (*state.position, *state.velocity))

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """The payload that the policy wants to send, if it wants to send."""
        foreseen = self._foreseen is not None and self._foreseen[0] == nav.tick
        if self._seat.choices.resident and self.resident is not None and not foreseen:
            self.resident.transmit(nav)
        action, numbers = self._seat.action, self._seat.choices.numbers
        if not action.sends:
            return ()
        if numbers:
            return (pack(KIND, list(action.message)),)
        x, y, z, vx, vy, vz = action.message
        message = self._own_state(nav)._replace(position=(x, y, z), velocity=(vx, vy, vz))
        try:
            return (self._codec.encode(message),)
        except OutOfRange as error:
            text = f"a message that the {self.config.codec} payload cannot hold is not sent: {error}"
            self._notes.append((nav.tick, text))
            return ()

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> Decision:
        """The forces that the policy wants, or the forces that keep its wanted velocity."""
        due = list(deliveries)
        self._absorb(nav, due)
        move = self._seat.action.move
        if self._seat.choices.move == "velocity":
            assert self.resident is not None
            x, y, z = nav.eta[:3]
            return self.resident.decide(nav, due, Motion((x, y, z), move))
        tau = clip(move, *self._limits)
        if self.resident is None:
            return Decision(tau, ())
        if (foreseen := self._foreseen) is not None and foreseen[0] == nav.tick:
            return Decision(tau, foreseen[1].telemetry)
        return Decision(tau, self.resident.decide(nav, due).telemetry)

    def take_notes(self) -> list[tuple[int, str]]:
        """(tick, text) of what a person should know since the last call."""
        taken, self._notes = self._notes, []
        return [*taken, *(self.resident.take_notes() if self.resident is not None else ())]

    def _own_state(self, nav: Nav) -> StateMessage:
        x, y, z, theta, psi = nav.eta
        u, v, w, q, r = nav.nu
        velocity = earth_velocity((x, y, z, theta, psi), (u, v, w, q, r), nav.roll[0] if nav.roll else 0.0)
        return StateMessage(self.config.id, own_time(nav, self.config.tick_ns)[0], (x, y, z), velocity)

    def _absorb(self, nav: Nav, due: list[Delivery]) -> None:
        if not self._seat.choices.numbers:
            now, _, ahead = own_time(nav, self.config.tick_ns)
            self._states.absorb(due, now, ahead)
            return
        for one in due:
            try:
                content = unpack(KIND, one.payload)
            except PayloadError:
                continue  # damaged, or of another agent
            newer = one.src not in self._numbers or one.sent_tick > self._numbers[one.src][0]
            if newer and isinstance(content, list) and len(content) == self._seat.choices.numbers:
                numbers = tuple(float(number) for number in content)
                self._numbers[one.src] = one.sent_tick, HeardMessage(numbers, 0.0, one.range_m)


class HeldLife:
    """One life of such an agent in the lockstep. A tick that its policy has not decided yet waits for `go_on`."""

    def __init__(self, seat: Seat, loop: AgentLoop, core: PolicyAgent) -> None:
        self._seat, self._loop = seat, loop
        self.core = core
        self._held: Nav | None = None
        self._waiting: list[Delivery] = []  # what was delivered and may be due later
        seat.life = self

    @property
    def incarnation(self) -> int:
        return self._loop.incarnation

    @property
    def holds(self) -> tuple[Nav, list[Delivery]] | None:
        """The nav and the due messages of the tick that waits; None: no tick waits."""
        if self._held is None:
            return None
        tick = self._held.tick
        return self._held, [delivery for delivery in self._waiting if delivery.due_tick <= tick]

    def nav(self, nav: Nav) -> list[Answer]:
        """Answer a tick, or let it wait for the policy."""
        if nav.tick >= self._seat.until:
            self._held = nav
            return []
        return self._answer(nav)

    def inbox(self, inbox: Inbox) -> list[Answer]:
        self._waiting.extend(inbox.deliveries)
        return self._loop.inbox(inbox)

    def go_on(self) -> list[Answer]:
        """Answer the tick that waits, now that the policy has decided."""
        nav, self._held = self._held, None
        return [] if nav is None else self._answer(nav)

    @property
    def waiting(self) -> tuple[Delivery, ...]:
        return self._loop.waiting

    def take_over(self, before: AgentLoop, *, anew: bool) -> None:
        """A run with policies does not go on from another."""
        raise NotImplementedError

    def _answer(self, nav: Nav) -> list[Answer]:
        self._waiting = [delivery for delivery in self._waiting if delivery.due_tick > nav.tick]
        return self._loop.nav(nav)
