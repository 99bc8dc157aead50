"""The modules of rclpy, as a program imports them."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

from fleet.addons.programs.ros_node import (
    Client,
    Future,
    Logger,
    Parameter,
    Publisher,
    Ros,
    Service,
    Subscription,
    Timer,
)
from fleet.addons.programs.ros_time import Clock, ClockType, Duration, Time
from fleet.addons.programs.standard import stand_in
from fleet.addons.programs.turns import NS


class Node:
    """A node; each program has the class for itself."""

    _of_program: ClassVar[Ros]

    def __init__(self, node_name: str, *, namespace: str = "", parameter_overrides: Any = (), **_: Any) -> None:
        self._name, self._namespace = node_name, namespace.strip("/")
        self._parameters: dict[str, Parameter] = {}
        self._overrides = {each.name: each.value for each in parameter_overrides or ()}
        self._on_set: list[Callable[[list[Parameter]], Any]] = []
        self._clock, self._logger = Clock(self._of_program.turns), Logger(self._of_program, node_name)
        self.executor: Any = None
        self.default_callback_group = object()

    def _whole(self, name: str) -> str:
        if name.startswith("/"):
            return name
        if name.startswith("~"):
            name = f"{self._name}/{name[1:].lstrip('/')}"
        return f"/{self._namespace}/{name}" if self._namespace else f"/{name}"

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any = 10, **_: Any) -> Publisher:
        return Publisher(self._of_program, msg_type, self._whole(topic))

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: Any = 10, **_: Any
    ) -> Subscription:
        depth = qos_profile if isinstance(qos_profile, int) else qos_profile.depth
        return Subscription(self._of_program, msg_type, self._whole(topic), callback, depth)

    def create_timer(self, timer_period_sec: float, callback: Any, *_: Any, **__: Any) -> Timer:
        return Timer(self._of_program, round(timer_period_sec * NS), callback)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **_: Any) -> Service:
        return Service(self._of_program, srv_type, self._whole(srv_name), callback)

    def create_client(self, srv_type: Any, srv_name: str, **_: Any) -> Client:
        return Client(self._of_program, srv_type, self._whole(srv_name))

    def create_rate(self, frequency: float, *_: Any) -> Any:
        return SimpleNamespace(
            sleep=lambda: self._of_program.turns.wait(self._of_program.turns.now_ns + round(NS / frequency))
        )

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
        self._parameters[name] = Parameter(name, None, self._overrides.get(name, value))
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


class Executor:
    """Spins all nodes of the program; each program has the class for itself."""

    _of_program: ClassVar[Ros]

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def add_node(self, node: Any) -> bool:
        """All nodes are there already."""
        return True

    def remove_node(self, node: Any) -> None:
        """It stays."""

    def shutdown(self, timeout_sec: Any = None) -> bool:
        """End it."""
        return True

    def spin(self) -> None:
        """Run callbacks until rclpy is shut down."""
        while self._of_program.ok:
            self._of_program.spin_once(None)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, and wait for it; a time below 0 has no end, as in rclpy."""
        self._of_program.spin_once(
            None if timeout_sec is None or timeout_sec < 0 else self._of_program.turns.until(timeout_sec)
        )

    def spin_until_future_complete(self, future: Any, timeout_sec: float | None = None) -> None:
        """Run callbacks until something is there."""
        ros = self._of_program
        end = ros.turns.until(timeout_sec)
        while ros.ok and not future.done() and ros.spin_once(end):
            pass


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
    node, executor = (type(kind.__name__, (kind,), {"_of_program": ros}) for kind in (Node, Executor))
    top = ModuleType("rclpy")
    top.__path__ = []
    made = {"rclpy": top}
    for name, values in _parts(ros, node, executor).items():
        made[f"rclpy.{name}"] = module = stand_in(ModuleType(f"rclpy.{name}"), **values)
        setattr(top, name, module)
    vars(top).update(_functions(ros, executor()), create_node=node, Parameter=Parameter, Future=Future)
    vars(top).update(get_global_executor=executor, __getattr__=_missing)
    return made


def _missing(name: str) -> Any:
    raise AttributeError(f"rclpy.{name} is not there in lockstep; fleet netem runs the node with rclpy itself")


def _functions(ros: Ros, every: Executor) -> dict[str, Callable[..., object]]:
    """The functions of `rclpy` itself. Which node or executor spins makes no difference: all nodes do."""
    return {
        "init": ros.begin, "shutdown": ros.end, "try_shutdown": ros.end, "ok": lambda **_: ros.ok,
        "spin": lambda *_, **__: every.spin(),
        "spin_once": lambda *_, timeout_sec=None, **__: every.spin_once(timeout_sec),
        "spin_until_future_complete":
            lambda _, future, executor=None, timeout_sec=None: every.spin_until_future_complete(future, timeout_sec),
    }  # fmt: skip


def _parts(ros: Ros, node: type, executor: type) -> dict[str, dict[str, Any]]:
    """What the modules below `rclpy` hold, by their names."""
    return {
        "node": {"Node": node},
        "executors": {
            "Executor": executor, "SingleThreadedExecutor": executor, "MultiThreadedExecutor": executor,
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
