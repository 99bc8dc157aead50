"""What stands in for rclpy: nodes whose topics and services are payloads of the agents, without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from itertools import count
from types import SimpleNamespace
from typing import Any

from agents.api import Nav, Vec3
from fleet.addons.programs.ros_messages import RosMessage, from_cdr, interfaces, to_cdr
from fleet.addons.programs.standard import EPOCH_NS
from fleet.addons.programs.turns import Turns, Waiters
from fleet.addons.robots.ros2.agent import NavState
from fleet.addons.robots.ros2.mapping import MessageMaker, frd

TOPIC, REQUEST, RESPONSE = range(3)
ODOMETRY = "/odom"
WRENCH, VELOCITY = "/wrench", "/cmd_vel"  # they stay within the vehicle; the axes are those of ROS (REP 103)
Command = Callable[[float, float, float], None]


class Ros:
    """The nodes of one program, and what comes for them."""

    def __init__(
        self, turns: Turns, number: int, send: Callable[[list[Any]], None], say: Callable[[str], object]
    ) -> None:
        """Have no node yet.

        Args:
            turns: the program's threads.
            number: of the agent.
            send: takes a message for all that hear this agent.
            say: gets a line of a logger.
        """
        self.turns, self.number, self.send, self.say = turns, number, send, say
        self.subscriptions: list[Subscription] = []
        self.services: list[Service] = []
        self.pending: dict[int, tuple[Future, Any]] = {}  # by the number of the request, with the class of its answer
        self.numbers = count(1)
        self.ready: deque[Callable[[], object]] = deque()
        self.timers: list[Timer] = []
        self.waiters = Waiters(turns)
        self.ok = True
        self.command: Command = lambda *_: None  # surge force [N], pitch, yaw [N m]
        self.command_velocity: Command = lambda *_: None  # surge [m/s], pitch rate, yaw rate [rad/s]

    def begin(self, *_: Any, **__: Any) -> None:
        """Let executors spin."""
        self.ok = True

    def end(self, *_: Any, **__: Any) -> None:
        """Let no executor spin any more."""
        self.ok = False
        self.waiters.wake()

    def later(self, call: Callable[[], object]) -> None:
        """A callback is ready for the next executor that spins."""
        self.ready.append(call)
        self.waiters.wake()

    def publish(self, topic: str, message: RosMessage) -> None:
        """Send a message, to nodes of this program, too. A command to the vehicle stays in this program."""
        parts = [TOPIC, topic, message.name, to_cdr(message)]
        self.hear(self.number, parts)
        if topic == WRENCH:
            wrench: Any = getattr(message, "wrench", message)
            self.command(*_axes(wrench.force.x, wrench.torque))
        elif topic == VELOCITY:
            twist: Any = getattr(message, "twist", message)
            self.command_velocity(*_axes(twist.linear.x, twist.angular))
        else:
            self.send(parts)

    def tell_odometry(self, now_ns: int, nav: Nav) -> None:
        """Tell the nodes where their vehicle is, if one listens."""
        hearing = [each for each in self.subscriptions if each.topic == ODOMETRY]
        if hearing:
            types = interfaces().types
            message = MessageMaker(types).odometry(EPOCH_NS + now_ns, self.number, NavState(nav), nav.belief)
            for each in hearing:
                each.take(types.encode("nav_msgs/msg/Odometry", message))

    def hear(self, src: int, parts: list[Any]) -> None:
        """A message has come. One that is damaged, or of another type, is dropped."""
        kind, *about = parts
        if kind == TOPIC:
            topic, name, data = about
            for each in [*self.subscriptions]:
                if each.topic == topic and each.kind.name == name:
                    each.take(data)
        elif kind == REQUEST:
            service, name, number, data = about
            for one in [*self.services]:
                if one.name == service and one.kind.name == name:
                    self.later(partial(one.answer, src, number, data))
        elif kind == RESPONSE:
            to, _, number, data = about
            if to == self.number and number in self.pending:
                future, answer = self.pending.pop(number)
                self.later(lambda: future.set_result(from_cdr(answer, data)))

    def tell(self, to: int, parts: list[Any]) -> None:
        """Send something that is for one agent."""
        if to == self.number:
            self.hear(to, parts)
        else:
            self.send(parts)

    def spin_once(self, until_ns: int | None) -> bool:
        """Run one callback; wait for it. False: there was none in time."""
        while self.ok:
            due = min(
                (each for each in self.timers if not each.is_canceled()), key=lambda each: each.due_ns, default=None
            )
            if self.ready:
                self.ready.popleft()()
                return True
            if due is not None and due.due_ns <= self.turns.now_ns:
                due.fire()
                return True
            if until_ns is not None and until_ns <= self.turns.now_ns:
                return False
            times = [at for at in (until_ns, None if due is None else due.due_ns) if at is not None]
            self.waiters.wait(min(times) if times else None)
        return False


def _axes(surge: float, turn: Any) -> Vec3:
    """What acts along the axis of the vehicle, and about the pitch and yaw axes: from the axes of ROS to ours."""
    _, pitch, yaw = frd((0.0, turn.y, turn.z))
    return surge, pitch, yaw


class Entity:
    """Something of a node, which can be destroyed."""

    def __init__(self, ros: Ros, among: list[Any]) -> None:
        self._ros, self._among = ros, among
        among.append(self)

    def destroy(self) -> None:
        """End it."""
        if self in self._among:
            self._among.remove(self)


class Timer(Entity):
    """A call again and again."""

    def __init__(self, ros: Ros, period_ns: int, callback: Callable[[], object]) -> None:
        super().__init__(ros, ros.timers)
        self.timer_period_ns, self.callback = max(1, period_ns), callback
        self.due_ns, self._canceled = ros.turns.now_ns + self.timer_period_ns, False

    def fire(self) -> None:
        """Call it, and set the next time."""
        self.due_ns += self.timer_period_ns
        self.callback()

    def cancel(self) -> None:
        """Call it no more."""
        self._canceled = True

    def reset(self) -> None:
        """Begin anew."""
        self._canceled, self.due_ns = False, self._ros.turns.now_ns + self.timer_period_ns

    def is_canceled(self) -> bool:
        """Whether it is called no more."""
        return self._canceled

    def is_ready(self) -> bool:
        """Whether it is due."""
        return self.due_ns <= self._ros.turns.now_ns


class Subscription(Entity):
    """Hears messages of a topic; of those that wait it keeps the newest, as many as its QoS says."""

    def __init__(
        self, ros: Ros, kind: type[RosMessage], topic: str, callback: Callable[[Any], object], depth: int
    ) -> None:
        super().__init__(ros, ros.subscriptions)
        self.kind, self.topic, self.topic_name, self.callback = kind, topic, topic, callback
        self._waiting: deque[bytes] = deque(maxlen=max(1, depth))

    def take(self, data: bytes) -> None:
        """A message has come."""
        if len(self._waiting) < (self._waiting.maxlen or 1):
            self._ros.later(self._hand_over)
        self._waiting.append(data)

    def _hand_over(self) -> None:
        try:
            message = from_cdr(self.kind, self._waiting.popleft())
        except ValueError:
            return
        self.callback(message)


class Publisher(Entity):
    """Publishes on a topic."""

    def __init__(self, ros: Ros, kind: type[RosMessage], topic: str) -> None:
        super().__init__(ros, [])
        self.msg_type, self.topic, self.topic_name = kind, topic, topic

    def publish(self, msg: Any) -> None:
        """Send a message."""
        if not isinstance(msg, self.msg_type):
            raise TypeError(f"Expected {self.msg_type.__name__}, got {type(msg).__name__}")
        self._ros.publish(self.topic, msg)

    def get_subscription_count(self) -> int:
        """Who hears it is not known: one is told, so that a program does not wait for it."""
        return 1


class Service(Entity):
    """Answers requests."""

    def __init__(self, ros: Ros, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        super().__init__(ros, ros.services)
        self.kind, self.name, self.callback = kind, name, callback

    def answer(self, src: int, number: int, data: bytes) -> None:
        """Answer a request."""
        try:
            request = from_cdr(self.kind.Request, data)
        except ValueError:
            return
        response = self.callback(request, self.kind.Response())
        self._ros.tell(src, [RESPONSE, src, self.kind.Response.name, number, to_cdr(response)])


class Future:
    """A result that is not there yet."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._done, self._result = False, None
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[Future], object]] = []
        self._cancelled = False

    def done(self) -> bool:
        """Whether it is there."""
        return self._done or self._cancelled

    def cancelled(self) -> bool:
        """Whether nobody wants it any more."""
        return self._cancelled

    def cancel(self) -> None:
        """Want it no more."""
        self._cancelled = True

    def result(self) -> Any:
        """The result; None: it is not there."""
        if self._error is not None:
            raise self._error
        return self._result

    def exception(self) -> Any:
        """What was raised."""
        return self._error

    def set_result(self, result: Any) -> None:
        """It is there."""
        self._done, self._result = True, result
        for each in self._callbacks:
            self._ros.later(lambda each=each: each(self))  # type: ignore[misc]
        self._ros.waiters.wake()

    def set_exception(self, error: BaseException) -> None:
        """It failed."""
        self._error = error
        self.set_result(None)

    def add_done_callback(self, callback: Callable[[Future], object]) -> None:
        """Call something when it is there."""
        if self._done:
            self._ros.later(lambda: callback(self))
        else:
            self._callbacks.append(callback)


class Client(Entity):
    """Asks a service."""

    def __init__(self, ros: Ros, kind: Any, name: str) -> None:
        super().__init__(ros, [])
        self.srv_type, self.srv_name = kind, name

    def call_async(self, request: RosMessage) -> Future:
        """Ask; the answer comes into a future. A request or an answer may be lost in the network."""
        number, future = next(self._ros.numbers), Future(self._ros)
        self._ros.pending[number] = future, self.srv_type.Response
        parts = [REQUEST, self.srv_name, self.srv_type.name, number, to_cdr(request)]
        self._ros.hear(self._ros.number, parts)
        self._ros.send(parts)
        return future

    def call(self, request: RosMessage, timeout_sec: float | None = None) -> Any:
        """Ask, and wait for the answer."""
        future = self.call_async(request)
        end = self._ros.turns.until(timeout_sec)
        while not future.done() and self._ros.spin_once(end):
            pass
        return future.result()

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Who answers is not known: it is there, or the answer never comes."""
        return True

    def service_is_ready(self) -> bool:
        """As `wait_for_service`."""
        return True

    def remove_pending_request(self, future: Future) -> None:
        """Forget a request."""


class Parameter:
    """A value of a node."""

    class Type(IntEnum):
        """Kinds of values."""

        NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
        BYTE_ARRAY, BOOL_ARRAY, INTEGER_ARRAY, DOUBLE_ARRAY, STRING_ARRAY = range(5, 10)

    def __init__(self, name: str, type_: Any = None, value: Any = None) -> None:
        self.name, self.type_, self.value = name, type_, value

    def get_parameter_value(self) -> Any:
        """The value under the name of each type, as a message of ROS has it."""
        names = (f"{kind}_value" for kind in ("bool", "integer", "double", "string", "double_array", "string_array"))
        return SimpleNamespace(**dict.fromkeys(names, self.value), integer_array_value=self.value)


class Logger:
    """Says lines."""

    def __init__(self, ros: Ros, name: str) -> None:
        self._ros, self.name = ros, name
        for level in ("debug", "info", "warn", "warning", "error", "fatal"):
            setattr(self, level, lambda text, level=level, **_: self._say(level, text))

    def _say(self, level: str, text: Any) -> None:
        if level != "debug":
            self._ros.say(f"[{level.upper()}] [{self.name}]: {text}\n")

    def get_child(self, name: str) -> Logger:
        """A logger below it."""
        return Logger(self._ros, f"{self.name}.{name}")

    def set_level(self, level: Any) -> None:
        """Take a level."""
