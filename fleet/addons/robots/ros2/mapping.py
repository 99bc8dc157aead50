"""The mapping from a run to the topics of ROS 2: the one table that the bridge, bags and the page of the guide use.

Positions are in `map` (east, north, up), what a vehicle has of its own in its `base_link` (forward, port, up). The
frames of the log stay in the tree, as `ned` and `uuv-<i>` (forward, starboard, down), so /tf needs no change of axes.

Axes change from ours to those of ROS (REP 103, 105): north, east, down to east, north, up; forward, starboard, down
to forward, port, up.

| symbol | meaning | unit | frame |
|---|---|---|---|
| eta | x, y, z, theta, psi | m, rad | north, east, down |
| nu | u, v, w, q, r over ground | m/s, rad/s | body: forward, starboard, down |
| P | covariance of x, y, z, psi: upper triangle, row by row | m^2, m rad, rad^2 | north, east, down |

Both changes of axes are half turns, about the line north-east and about the forward axis. With R = Rz(psi) Ry(theta)
Rx(phi) from body to north, east, down, the same attitude in the axes of ROS is Rz(pi/2 - psi) Ry(-theta) Rx(phi).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import pi
from typing import Any, NamedTuple

from fleet.addons.robots.ros2.rmw import DEFAULT, LATCHED, SENSOR, Qos
from fleet.addons.robots.ros2.types import RosTypes
from fleet.logs.topic_names import link_of
from fleet.recorder.scene.primitives import NED, vehicle_frame
from fleet.recorder.transforms import MAP, NO_TURN, enu, quaternion
from world.vectors import Vec3

Quaternion = tuple[float, float, float, float]  # x, y, z, w
HALF_TURN_ABOUT_FORWARD: Quaternion = (1.0, 0.0, 0.0, 0.0)

# Of east, north, up, yaw: which of x, y, z, psi each is, and with which sign.
_AXES = ((1, 1.0), (0, 1.0), (2, -1.0), (3, -1.0))
_PLACES = (0, 1, 2, 5)  # of x, y, z and the turn about z in the covariance of a pose in ROS, which has six rows


def body(frd: Vec3) -> Vec3:
    """A vector in the axes forward, starboard, down in those of ROS: forward, port, up."""
    x, y, z = frd
    return x, -y, -z


frd = body  # a half turn is its own inverse


def attitude(theta: float, psi: float, phi: float = 0.0) -> Quaternion:
    """(x, y, z, w) that turns forward, port, up into east, north, up, by pitch, yaw and roll [rad] in our axes."""
    return quaternion(-theta, pi / 2 - psi, phi)


def pose_covariance(upper: Sequence[float]) -> list[float]:
    """The 36 values of a `PoseWithCovariance`, of P (10,); roll and pitch have none: they are measured as they are."""
    P = [[0.0] * 4 for _ in range(4)]
    values = iter(upper)
    for i in range(4):
        for j in range(i, 4):
            P[i][j] = P[j][i] = next(values)
    found = [0.0] * 36
    for row, (i, s) in zip(_PLACES, _AXES, strict=True):
        for column, (j, t) in zip(_PLACES, _AXES, strict=True):
            found[6 * row + column] = s * t * P[i][j]
    return found


SURFACE_PA = 101_325.0  # standard atmosphere
SEA_WATER = 1025.0  # [kg/m^3]
GRAVITY = 9.80665  # [m/s^2]
NOT_MEASURED = -1.0  # first value of a covariance whose quantity is not there (sensor_msgs/Imu)
TF, TF_STATIC, SCENE, DIAGNOSTICS, CLOCK = "/tf", "/tf_static", "/fleet/recorder/scene", "/diagnostics", "/clock"


class RosTopic(NamedTuple):
    """A topic of ROS and where it comes from; `{i}` stands for the number of a vehicle."""

    name: str
    type: str
    source: str  # topic of the log, or in words
    what: str
    qos: Qos = DEFAULT


OF_VEHICLES = (
    RosTopic("/uuv_{i}/odom", "nav_msgs/msg/Odometry", "uuv/{i}/nav",
             "where the vehicle believes it is, or measures it; with `navigation` the covariance of x, y, z and yaw"),
    RosTopic("/uuv_{i}/twist", "geometry_msgs/msg/TwistStamped", "uuv/{i}/nav",
             "its velocity over ground as it measures it, in `base_link`"),
    RosTopic("/uuv_{i}/imu", "sensor_msgs/msg/Imu", "uuv/{i}/nav",
             "attitude and rates as it measures them; no acceleration (covariance -1)", SENSOR),
    RosTopic("/uuv_{i}/pressure", "sensor_msgs/msg/FluidPressure", "uuv/{i}/nav",
             "of its depth as it measures it: 101325 Pa, and 1025 kg/m^3 of water", SENSOR),
    RosTopic("/uuv_{i}/ground_truth/odom", "nav_msgs/msg/Odometry", "uuv/{i}/state",
             "where it is and how it moves, which no vehicle knows"),
    RosTopic("/uuv_{i}/applied_wrench", "geometry_msgs/msg/WrenchStamped", "uuv/{i}/command",
             "surge force, pitch and yaw moment as the actuators applied them, in `base_link`"),
)  # fmt: skip
OF_FLEET = (
    RosTopic(TF, "tf2_msgs/msg/TFMessage", "transforms",
             "`map` to `reference`, `ned` to `uuv-<i>`: where the vehicles are, not where they believe to be",
             Qos(depth=100)),
    RosTopic(TF_STATIC, "tf2_msgs/msg/TFMessage", "the number of vehicles",
             "`map` to `ned`, `uuv-<i>` to `uuv_<i>/base_link`", LATCHED),
    RosTopic(SCENE, "visualization_msgs/msg/MarkerArray", "scene",
             "hulls, places in the formation, and each link with its state as colour and as text"),
    RosTopic(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray", "faults, and the checks",
             "faults (warning while they last) and checks (error if they failed)"),
)  # fmt: skip
OF_BRIDGE = (
    RosTopic(CLOCK, "rosgraph_msgs/msg/Clock", "the time of the run",
             "for nodes with `use_sim_time`; not in bags: `ros2 bag play --clock`", Qos(depth=1)),
)  # fmt: skip
TOPICS = OF_VEHICLES + OF_FLEET + OF_BRIDGE
# Topics of the log that become topics of ROS, as patterns of zenoh's keys.
SOURCES = ("uuv/*/nav", "uuv/*/state", "uuv/*/command", "uuv/*/belief", "transforms", "scene", "faults")


def table() -> str:
    """The table of topics in the guide."""
    rows = [f"| `{t.name.replace('{i}', '<i>')}` | `{t.type.replace('/msg/', '/')}` | {_source(t)} | {t.what} |"
            for t in TOPICS]  # fmt: skip
    return "\n".join(["| topic | type | from | what |", "|---|---|---|---|", *rows]) + "\n"


def _source(topic: RosTopic) -> str:
    known = "{i}" in topic.source or topic.source in SOURCES
    return f"`{topic.source.replace('{i}', '<i>')}`" if known else topic.source


def base_link(i: int) -> str:
    """The frame of vehicle i in the axes of ROS."""
    return f"uuv_{i}/base_link"


def vehicle_of(topic: str) -> tuple[int, str] | None:
    """The vehicle of a topic `uuv/<i>/<group>`, and its group; None: it is another topic."""
    parts = topic.split("/")
    if len(parts) != 3 or parts[0] != "uuv" or not parts[1].isdecimal() or len(parts[1]) > 9:
        return None
    return int(parts[1]), parts[2]


def is_source(topic: str) -> bool:
    found = vehicle_of(topic)
    return f"uuv/*/{found[1]}" in SOURCES if found else topic in SOURCES and link_of(topic) is None


class MessageMaker:
    """Makes the messages of one distribution's types; times are ns, of the run."""

    def __init__(self, types: RosTypes) -> None:
        self.types = types
        self._new: Callable[..., Any] = types.new
        self._zeros: dict[int, Any] = {}

    def time(self, ns: int) -> Any:
        return self._new("builtin_interfaces/msg/Time", sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)

    def header(self, ns: int, frame: str) -> Any:
        return self._new("std_msgs/msg/Header", stamp=self.time(ns), frame_id=frame)

    def odometry(self, ns: int, i: int, state: Any, covariance: Iterable[float] = ()) -> Any:
        upper = tuple(covariance)
        pose = self._new(
            "geometry_msgs/msg/Pose", position=self._point(enu((state.x, state.y, state.z))),
            orientation=self._quaternion(_attitude(state)),
        )  # fmt: skip
        known = self._array(pose_covariance(upper)) if len(upper) == 10 else self._none(36)
        return self._new(
            "nav_msgs/msg/Odometry",
            header=self.header(ns, MAP),
            child_frame_id=base_link(i),
            pose=self._new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=known),
            twist=self._new(
                "geometry_msgs/msg/TwistWithCovariance", twist=self.twist(state), covariance=self._none(36)
            ),
        )

    def twist(self, state: Any) -> Any:
        return self._new(
            "geometry_msgs/msg/Twist",
            linear=self.vector(body((state.u, state.v, state.w))),
            angular=self.vector(_rates(state)),
        )

    def twist_stamped(self, ns: int, i: int, state: Any) -> Any:
        return self._new(
            "geometry_msgs/msg/TwistStamped", header=self.header(ns, base_link(i)), twist=self.twist(state)
        )

    def imu(self, ns: int, i: int, state: Any) -> Any:
        """Attitude and rates; acceleration is not there."""
        return self._new(
            "sensor_msgs/msg/Imu",
            header=self.header(ns, base_link(i)),
            orientation=self._quaternion(_attitude(state)),
            orientation_covariance=self._none(9),
            angular_velocity=self.vector(_rates(state)),
            angular_velocity_covariance=self._none(9),
            linear_acceleration=self.vector((0.0, 0.0, 0.0)),
            linear_acceleration_covariance=self._array([NOT_MEASURED, *[0.0] * 8]),
        )

    def pressure(self, ns: int, i: int, state: Any) -> Any:
        pascal = SURFACE_PA + SEA_WATER * GRAVITY * state.z
        return self._new(
            "sensor_msgs/msg/FluidPressure", header=self.header(ns, base_link(i)), fluid_pressure=pascal, variance=0.0
        )

    def wrench_stamped(self, ns: int, i: int, tau: Vec3) -> Any:
        """Of surge force, pitch and yaw moment [N, N m] in our axes."""
        force, pitch, yaw = tau
        wrench = self._new(
            "geometry_msgs/msg/Wrench",
            force=self.vector((force, 0.0, 0.0)),
            torque=self.vector(body((0.0, pitch, yaw))),
        )
        return self._new("geometry_msgs/msg/WrenchStamped", header=self.header(ns, base_link(i)), wrench=wrench)

    def transform(self, ns: int, parent: str, child: str, place: Vec3, turn: Quaternion) -> Any:
        """Where a frame is in its parent."""
        moved = self._new(
            "geometry_msgs/msg/Transform", translation=self.vector(place), rotation=self._quaternion(turn)
        )
        header = self.header(ns, parent)
        return self._new("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=moved)

    def transforms(self, some: Iterable[Any]) -> Any:
        return self._new("tf2_msgs/msg/TFMessage", transforms=list(some))

    def static_transforms(self, ned: Quaternion, vehicles: Iterable[int]) -> Any:
        """The transforms that never change; `ned` turns the axes of `ned` into those of `map`."""
        nowhere = (0.0, 0.0, 0.0)
        links = [self.transform(0, vehicle_frame(i), base_link(i), nowhere, HALF_TURN_ABOUT_FORWARD) for i in vehicles]
        return self.transforms([self.transform(0, MAP, NED, nowhere, ned), *links])

    def clock(self, ns: int) -> Any:
        return self._new("rosgraph_msgs/msg/Clock", clock=self.time(ns))

    def vector(self, value: Vec3) -> Any:
        return self._new("geometry_msgs/msg/Vector3", **dict(zip("xyz", value, strict=True)))

    def _point(self, value: Vec3) -> Any:
        return self._new("geometry_msgs/msg/Point", **dict(zip("xyz", value, strict=True)))

    def pose(self, place: Vec3, turn: Quaternion = (NO_TURN.x, NO_TURN.y, NO_TURN.z, NO_TURN.w)) -> Any:
        return self._new("geometry_msgs/msg/Pose", position=self._point(place), orientation=self._quaternion(turn))

    def _quaternion(self, value: Quaternion) -> Any:
        return self._new("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", value, strict=True)))

    @staticmethod
    def _array(values: list[float]) -> Any:
        import numpy as np

        return np.array(values)

    def _none(self, size: int) -> Any:
        if size not in self._zeros:
            self._zeros[size] = self._array([0.0] * size)
        return self._zeros[size]


def _attitude(state: Any) -> Quaternion:
    return attitude(state.theta, state.psi, getattr(state, "phi", 0.0))


def _rates(state: Any) -> Vec3:
    return body((getattr(state, "p", 0.0), state.q, state.r))
