"""What stands in for rclpy: nodes whose topics and services are payloads of the agents, without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import Enum, IntEnum
from functools import partial
from itertools import count
from types import ModuleType, SimpleNamespace
from typing import Any

from agents.api import Nav, Vec3
from fleet.addons.programs.ros_messages import RosMessage, from_cdr, interfaces, to_cdr
from fleet.addons.programs.ros_time import Clock, ClockType, Duration, Time
from fleet.addons.programs.standard import EPOCH_NS
from fleet.addons.programs.turns import NS, Turns, Waiters
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
        self.clients: dict[int, Client] = {}
        self.numbers = count(1)
        self.ready: deque[Callable[[], object]] = deque()
        self.timers: list[Timer] = []
        self.waiters = Waiters(turns)
        self.ok = True
        self.command: Command = lambda *_: None  # surge force [N], pitch, yaw [N m]
        self.command_velocity: Command = lambda *_: None  # surge [m/s], pitch rate, yaw rate [rad/s]

    def later(self, call: Callable[[], object]) -> None:
        """A callback is ready for the next executor that spins."""
        self.ready.append(call)
        self.waiters.wake()

    def publish(self, topic: str, message: RosMessage) -> None:
        """Send a message, to nodes of this program, too. What steers the vehicle goes to nobody else."""
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
            if to == self.number and (client := self.clients.get(number)) is not None:
                self.later(lambda: client.answered(number, data))

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


class Timer:
    """A call again and again."""

    def __init__(self, ros: Ros, period_ns: int, callback: Callable[[], object]) -> None:
        self._ros, self.timer_period_ns, self.callback = ros, max(1, period_ns), callback
        self.due_ns, self._canceled = ros.turns.now_ns + self.timer_period_ns, False
        ros.timers.append(self)

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

    def destroy(self) -> None:
        """Forget it."""
        self._canceled = True
        if self in self._ros.timers:
            self._ros.timers.remove(self)


class Subscription:
    """Hears messages of a topic; of those that wait it keeps the newest, as many as its QoS says."""

    def __init__(
        self, ros: Ros, kind: type[RosMessage], topic: str, callback: Callable[[Any], object], depth: int
    ) -> None:
        self._ros, self.kind, self.topic, self.callback = ros, kind, topic, callback
        self.topic_name = topic
        self._waiting: deque[bytes] = deque(maxlen=max(1, depth))
        ros.subscriptions.append(self)

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

    def destroy(self) -> None:
        """Hear no more."""
        if self in self._ros.subscriptions:
            self._ros.subscriptions.remove(self)


class Publisher:
    """Publishes on a topic."""

    def __init__(self, ros: Ros, kind: type[RosMessage], topic: str) -> None:
        self._ros, self.msg_type, self.topic, self.topic_name = ros, kind, topic, topic

    def publish(self, msg: Any) -> None:
        """Send a message."""
        if not isinstance(msg, self.msg_type):
            raise TypeError(f"Expected {self.msg_type.__name__}, got {type(msg).__name__}")
        self._ros.publish(self.topic, msg)

    def get_subscription_count(self) -> int:
        """Who hears it is not known: one is told, so that a program does not wait for it."""
        return 1

    def destroy(self) -> None:
        """End it."""


class Service:
    """Answers requests."""

    def __init__(self, ros: Ros, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        self._ros, self.kind, self.name, self.callback = ros, kind, name, callback
        ros.services.append(self)

    def answer(self, src: int, number: int, data: bytes) -> None:
        """Answer a request."""
        try:
            request = from_cdr(self.kind.Request, data)
        except ValueError:
            return
        response = self.callback(request, self.kind.Response())
        self._ros.tell(src, [RESPONSE, src, self.kind.Response.name, number, to_cdr(response)])

    def destroy(self) -> None:
        """Answer no more."""
        if self in self._ros.services:
            self._ros.services.remove(self)


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


class Client:
    """Asks a service."""

    def __init__(self, ros: Ros, kind: Any, name: str) -> None:
        self._ros, self.srv_type, self.srv_name = ros, kind, name
        self._pending: dict[int, Future] = {}

    def call_async(self, request: RosMessage) -> Future:
        """Ask; the answer comes into a future. A request or an answer may be lost in the network."""
        number = next(self._ros.numbers)
        self._ros.clients[number], self._pending[number] = self, Future(self._ros)
        parts = [REQUEST, self.srv_name, self.srv_type.name, number, to_cdr(request)]
        self._ros.hear(self._ros.number, parts)
        self._ros.send(parts)
        return self._pending[number]

    def call(self, request: RosMessage, timeout_sec: float | None = None) -> Any:
        """Ask, and wait for the answer."""
        future = self.call_async(request)
        end = self._ros.turns.until(timeout_sec)
        while not future.done() and self._ros.spin_once(end):
            pass
        return future.result()

    def answered(self, number: int, data: bytes) -> None:
        """An answer has come."""
        future = self._pending.pop(number, None)
        self._ros.clients.pop(number, None)
        if future is not None:
            future.set_result(from_cdr(self.srv_type.Response, data))

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Who answers is not known: it is there, or the answer never comes."""
        return True

    def service_is_ready(self) -> bool:
        """As `wait_for_service`."""
        return True

    def remove_pending_request(self, future: Future) -> None:
        """Forget a request."""

    def destroy(self) -> None:
        """End it."""


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
        names = (
            "bool_value",
            "integer_value",
            "double_value",
            "string_value",
            "double_array_value",
            "string_array_value",
        )
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


def node_class(ros: Ros) -> type:
    """The class `Node` of one program."""

    class Node:
        """A node."""

        def __init__(self, node_name: str, *, namespace: str = "", parameter_overrides: Any = (), **_: Any) -> None:
            self._name, self._namespace = node_name, namespace.strip("/")
            self._parameters: dict[str, Parameter] = {}
            self._set = {each.name: each.value for each in parameter_overrides or ()}
            self._on_set: list[Callable[[list[Parameter]], Any]] = []
            self._clock, self._logger = Clock(ros.turns), Logger(ros, node_name)
            self.executor: Any = None
            self.default_callback_group = object()

        def _whole(self, name: str) -> str:
            if name.startswith("/"):
                return name
            if name.startswith("~"):
                name = f"{self._name}/{name[1:].lstrip('/')}"
            return f"/{self._namespace}/{name}" if self._namespace else f"/{name}"

        def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any = 10, **_: Any) -> Publisher:
            return Publisher(ros, msg_type, self._whole(topic))

        def create_subscription(
            self, msg_type: Any, topic: str, callback: Any, qos_profile: Any = 10, **_: Any
        ) -> Subscription:
            depth = qos_profile if isinstance(qos_profile, int) else qos_profile.depth
            return Subscription(ros, msg_type, self._whole(topic), callback, depth)

        def create_timer(self, timer_period_sec: float, callback: Any, *_: Any, **__: Any) -> Timer:
            return Timer(ros, round(timer_period_sec * NS), callback)

        def create_service(self, srv_type: Any, srv_name: str, callback: Any, **_: Any) -> Service:
            return Service(ros, srv_type, self._whole(srv_name), callback)

        def create_client(self, srv_type: Any, srv_name: str, **_: Any) -> Client:
            return Client(ros, srv_type, self._whole(srv_name))

        def create_rate(self, frequency: float, *_: Any) -> Any:
            return SimpleNamespace(sleep=lambda: ros.turns.wait(ros.turns.now_ns + round(NS / frequency)))

        def get_clock(self) -> Clock:
            return self._clock

        def get_logger(self) -> Logger:
            return self._logger

        def get_name(self) -> str:
            return self._name

        def get_namespace(self) -> str:
            return f"/{self._namespace}"

        def get_fully_qualified_name(self) -> str:
            return self._whole(self._name)

        def declare_parameter(self, name: str, value: Any = None, *_: Any, **__: Any) -> Parameter:
            self._parameters[name] = Parameter(name, None, self._set.get(name, value))
            return self._parameters[name]

        def declare_parameters(self, namespace: str, parameters: Any) -> list[Parameter]:
            begin = f"{namespace}." if namespace else ""
            return [self.declare_parameter(begin + name, *more) for name, *more in parameters]

        def get_parameter(self, name: str) -> Parameter:
            if name not in self._parameters:
                raise KeyError(f"the parameter {name} was not declared")
            return self._parameters[name]

        def has_parameter(self, name: str) -> bool:
            return name in self._parameters

        def set_parameters(self, parameters: list[Parameter]) -> list[Any]:
            for each in self._on_set:
                each(parameters)
            for one in parameters:
                self._parameters[one.name] = one
            return [SimpleNamespace(successful=True, reason="") for _ in parameters]

        def add_on_set_parameters_callback(self, callback: Any) -> None:
            self._on_set.append(callback)

        def destroy_node(self) -> None: ...

        destroy_timer = destroy_publisher = destroy_client = destroy_service = destroy_subscription = staticmethod(
            lambda each: each.destroy()
        )

        def __enter__(self) -> Any:
            return self

        def __exit__(self, *_: object) -> None: ...

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            raise AttributeError(f"Node.{name} is not there in lockstep; fleet netem runs the node with rclpy itself")

    return Node


class QoSProfile:
    """Only its depth is used: what the network loses is lost, whatever the reliability says."""

    def __init__(self, *, depth: int = 10, **settings: Any) -> None:
        self.depth = depth
        vars(self).update(settings)


class _Policy(Enum):
    """Settings of QoS, which are taken and not used."""

    SYSTEM_DEFAULT, RELIABLE, BEST_EFFORT, TRANSIENT_LOCAL, VOLATILE, KEEP_LAST, KEEP_ALL, AUTOMATIC = range(8)


def rclpy_modules(ros: Ros) -> dict[str, ModuleType]:
    """The modules `rclpy` and those below it, of one program."""

    def spin(node: Any = None, executor: Any = None) -> None:
        while ros.ok:
            ros.spin_once(None)

    def spin_once(node: Any = None, *, executor: Any = None, timeout_sec: float | None = None) -> None:
        ros.spin_once(None if timeout_sec is None or timeout_sec < 0 else ros.turns.until(timeout_sec))

    def until_complete(node: Any, future: Any, executor: Any = None, timeout_sec: float | None = None) -> None:
        end = ros.turns.until(timeout_sec)
        while ros.ok and not future.done() and ros.spin_once(end):
            pass

    def shutdown(*_: Any, **__: Any) -> None:
        ros.ok = False
        ros.waiters.wake()

    def init(*_: Any, **__: Any) -> None:
        ros.ok = True

    class Executor:
        """Spins all nodes of the program."""

        def __init__(self, *_: Any, **__: Any) -> None: ...

        def add_node(self, node: Any) -> bool:
            return True

        def remove_node(self, node: Any) -> None: ...

        def shutdown(self, timeout_sec: Any = None) -> bool:
            return True

        def spin(self) -> None:
            spin()

        def spin_once(self, timeout_sec: float | None = None) -> None:
            spin_once(timeout_sec=timeout_sec)

        def spin_until_future_complete(self, future: Any, timeout_sec: float | None = None) -> None:
            until_complete(None, future, None, timeout_sec)

    def __getattr__(name: str) -> Any:  # noqa: N807
        raise AttributeError(f"rclpy.{name} is not there in lockstep; fleet netem runs the node with rclpy itself")

    node = node_class(ros)
    parts: dict[str, dict[str, Any]] = {
        "node": {"Node": node},
        "executors": {
            "Executor": Executor, "SingleThreadedExecutor": Executor, "MultiThreadedExecutor": Executor,
            "ExternalShutdownException": type("ExternalShutdownException", (Exception,), {}),
        },
        "qos": {
            "QoSProfile": QoSProfile, "qos_profile_sensor_data": QoSProfile(depth=5),
            "qos_profile_system_default": QoSProfile(), "qos_profile_services_default": QoSProfile(),
            **{
                f"{prefix}{name}Policy": _Policy
                for name in ("Reliability", "Durability", "History", "Liveliness") for prefix in ("", "QoS")
            },
        },
        "time": {"Time": Time},
        "duration": {"Duration": Duration},
        "clock": {"Clock": lambda **_: Clock(ros.turns), "ClockType": ClockType},
        "parameter": {"Parameter": Parameter},
        "timer": {"Timer": Timer},
        "task": {"Future": lambda **_: Future(ros)},
        "callback_groups": {
            "MutuallyExclusiveCallbackGroup": object, "ReentrantCallbackGroup": object, "CallbackGroup": object,
        },
        "logging": {"get_logger": lambda name: Logger(ros, name)},
        "subscription": {"Subscription": Subscription},
        "publisher": {"Publisher": Publisher},
        "exceptions": {"ParameterNotDeclaredException": KeyError},
        "utilities": {"ok": lambda **_: ros.ok},
    }  # fmt: skip
    top = ModuleType("rclpy")
    top.__path__ = []
    made = {"rclpy": top}
    for name, values in parts.items():
        made[f"rclpy.{name}"] = module = ModuleType(f"rclpy.{name}")
        vars(module).update(values)
        setattr(top, name, module)
    vars(top).update(
        init=init, shutdown=shutdown, try_shutdown=shutdown, ok=lambda **_: ros.ok, spin=spin, spin_once=spin_once,
        spin_until_future_complete=until_complete, create_node=node, Parameter=Parameter, __getattr__=__getattr__,
        Future=Future, get_global_executor=Executor,
    )  # fmt: skip
    return made
