"""Nodes of rclpy as agents, and programs that steer their vehicle."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent

import pytest
from own_program import RunProgram, lines, same_bytes, scenario

import fleet
from fleet.result.result import Status

WATER = {
    "moored": False,
    "duration": "2 s",
    "reference": "{start: 0 0 5 m, velocity: 0.5 0 0 m/s}",
    "formation": "{shape: line, spacing: 8 m}",
    "initial": "[{position: 0 0 5 m, surge: 0.1 m/s}, {position: 0 9 5 m, surge: 0.1 m/s}]",
}
STEER = """
    import json, time, zenoh
    session, last = zenoh.open(), {}
    session.declare_subscriber("self/nav", lambda s: last.update(json.loads(s.payload.to_bytes())))
    time.sleep(1.0)
    session.put("self/cmd", json.dumps({"force": 7.0, "yaw": 1.0}))
    print(f"{last['position'][1]:.3f} v")
    time.sleep(100)
"""
ROS_STEER = """
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    class Steer(Node):
        def __init__(self):
            super().__init__("steer")
            self.wrench = self.create_publisher(WrenchStamped, "/wrench", 10)
            self.create_subscription(Odometry, "/odom", self.heard, 1)
        def heard(self, odom):
            message = WrenchStamped()
            message.wrench.force.x, message.wrench.torque.z = 7.0, -1.0  # in ROS z is up
            self.wrench.publish(message)
            print(f"{odom.pose.pose.position.x:.3f} v")  # in ROS x is east
    rclpy.init()
    rclpy.spin(Steer())
"""


TUTORIAL = """
    import sys
    import rclpy
    from example_interfaces.srv import AddTwoInts
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import String
    me = int(sys.argv[1])
    class Publisher(Node):
        def __init__(self):
            super().__init__("minimal_publisher")
            self.declare_parameter("word", "Hello")
            qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
            self.publisher_ = self.create_publisher(String, "topic", qos)
            self.timer = self.create_timer(0.5, self.timer_callback)
            self.srv = self.create_service(AddTwoInts, "add_two_ints", self.add)
            self.i = 0
        def timer_callback(self):
            msg = String()
            msg.data = f"{self.get_parameter('word').value} World: {self.i}"
            self.publisher_.publish(msg)
            self.get_logger().info(f'Publishing: "{msg.data}"')
            self.i += 1
        def add(self, request, response):
            response.sum = request.a + request.b
            return response
    class Subscriber(Node):
        def __init__(self):
            super().__init__("minimal_subscriber")
            self.subscription = self.create_subscription(String, "topic", self.heard, 10)
            self.cli = self.create_client(AddTwoInts, "add_two_ints")
        def heard(self, msg):
            self.get_logger().info(f'I heard: "{msg.data}"')
    rclpy.init()
    if me == 1:
        rclpy.spin(Publisher())
    node = Subscriber()
    while not node.cli.wait_for_service(timeout_sec=1.0): pass
    future = node.cli.call_async(AddTwoInts.Request(a=2, b=3))
    rclpy.spin_until_future_complete(node, future)
    print(f"{future.result().sum} v")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin()
"""


def test_nodes_of_the_tutorials_of_ros(run: RunProgram) -> None:
    """A publisher with a timer, a subscriber, a service and its client, in the style of rclpy's tutorials."""
    pytest.importorskip("rosbags")
    result = run(TUTORIAL)
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert lines(result)[0] == '[INFO] [minimal_publisher]: Publishing: "Hello World: 0"'
    said = lines(result, 2)
    assert said[0] == "5 v" and said[1] == '[INFO] [minimal_subscriber]: I heard: "Hello World: 0"'


OWN_TYPES = """
    import sys
    import rclpy
    from {package}.msg import Report
    from more_things.srv import Scale
    from rclpy.node import Node
    from std_msgs.msg import String
    class Own(Node):
        def __init__(self):
            super().__init__("own")
            self.out = self.create_publisher(Report, "report", 10)
            self.create_subscription(Report, "report", self.heard, 10)
            self.create_service(Scale, "scale", self.scale)
            self.ask = self.create_client(Scale, "scale")
        def heard(self, message):
            first = message.parts[0]
            print(message.kind == Report.GOOD, message.note.data, first.values, isinstance(message.note, String))
        def scale(self, request, response):
            response.part.values = [2.0 * each for each in request.part.values]
            return response
    rclpy.init()
    node = Own()
    if sys.argv[1] == "1":
        report = Report(kind=Report.GOOD, note=String(data="deep"))
        report.parts = [type(Scale.Request().part)(values=[1.5, 2.5])]
        node.out.publish(report)
        future = node.ask.call_async(Scale.Request(part=report.parts[0]))
        rclpy.spin_until_future_complete(node, future)
        print(future.result().part.values, f"{{len(report.parts)}} v")
    rclpy.spin(node)
"""


def write_types(folder: Path, place: str) -> None:
    """Definitions beside a program: a message in a place, and a message and a service in a package of theirs."""
    for file, text in {
        Path(place, "msg/Report.msg"): "uint8 GOOD=7\nuint8 kind\nstd_msgs/String note\nmore_things/Part[] parts\n",
        Path("more_things/msg/Part.msg"): "float64[] values\n",
        Path("more_things/srv/Scale.srv"): "# ---\nPart part\n---\nPart part\n",
    }.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text)


@pytest.mark.parametrize(
    ("place", "package"), [("plain_things", "plain_things"), ("", "some_interfaces"), ("", "FOLDER")]
)
def test_a_node_has_messages_and_services_of_its_own(place: str, package: str, run: RunProgram, tmp_path: Path) -> None:
    """In a folder of the package, or in `msg` of the folder in which the program lies."""
    pytest.importorskip("rosbags")
    package = package.replace("FOLDER", tmp_path.name)
    write_types(tmp_path, place)
    result = run(OWN_TYPES.format(package=package))
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert lines(result) == ["True deep [1.5, 2.5] True", "[3.0, 5.0] 1 v"]
    assert lines(result, 2) == ["True deep [1.5, 2.5] True"]


@pytest.mark.parametrize("text", [STEER, ROS_STEER, "import time\ntime.sleep(100)\n"], ids=["zenoh", "rclpy", "none"])
def test_a_program_steers_its_vehicle_or_leaves_it_to_the_laws(text: str, run: RunProgram, tmp_path: Path) -> None:
    if "rclpy" in text:
        pytest.importorskip("rosbags")
    assert run("pass").status is Status.PASS
    (tmp_path / "program.py").write_text(dedent(text))
    result = fleet.run("own.yaml", out=tmp_path / "runs", set=WATER)
    assert result.directory is not None
    log = fleet.open_log(result.directory)
    commanded = log["uuv/2/command"]["tau"][-1].tolist() == [7.0, 0.0, 1.0]
    assert commanded == ("Steer" in text or "self/cmd" in text), result.reason
    if commanded:
        assert abs(float(lines(result, 2)[0].split()[0]) - 9.0) < 1.0


ROS_VELOCITY = """
    import rclpy
    from geometry_msgs.msg import Twist, TwistStamped
    from rclpy.node import Node
    class Swim(Node):
        def __init__(self):
            super().__init__("swim")
            self.stamped = self.declare_parameter("stamped", {stamped}).value
            self.out = self.create_publisher(TwistStamped if self.stamped else Twist, "cmd_vel", 10)
            self.create_subscription(TwistStamped if self.stamped else Twist, "cmd_vel", lambda _: print("1 v"), 10)
            self.create_timer(0.1, self.tell)
            self.tell()
        def tell(self):
            message = TwistStamped() if self.stamped else Twist()
            twist = message.twist if self.stamped else message
            twist.linear.x, twist.angular.z = {surge}, {turn}  # in ROS a positive turn is to port
            self.out.publish(message)
    rclpy.init()
    rclpy.spin(Swim())
"""


@pytest.mark.parametrize(
    ("surge", "turn", "stamped"), [(1.0, 0.0, False), (1.0, 0.1, True), (0.5, -0.1, False), (-0.3, 0.0, True)]
)
def test_a_twist_gives_the_vehicle_its_velocity(
    surge: float, turn: float, stamped: bool, run: RunProgram, tmp_path: Path
) -> None:
    pytest.importorskip("rosbags")
    (tmp_path / "own.yaml").write_text(scenario())
    (tmp_path / "program.py").write_text(dedent(ROS_VELOCITY.format(surge=surge, turn=turn, stamped=stamped)))
    result = fleet.run("own.yaml", out=tmp_path / "runs", set=WATER | {"duration": "12 s"})
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert result.directory is not None
    state = fleet.open_log(result.directory)["uuv/2/state"]
    u, r, turned = state["u"][-1], state["r"][-1], state["psi"][-1] - state["psi"][0]
    assert u == pytest.approx(surge, abs=0.02) and r == pytest.approx(-turn, abs=0.005), (u, r)  # ours is to starboard
    assert turned == pytest.approx(-turn * 11, abs=0.2)  # 12 s, and a second until it turns
    assert lines(result)[0] == "1 v"


def test_a_command_that_is_not_finite_ends_the_run(run: RunProgram) -> None:
    pytest.importorskip("rosbags")
    result = run(ROS_VELOCITY.format(surge="float('nan')", turn=0.0, stamped=False))
    assert result.status is Status.BROKEN and "every number must be finite" in result.reason, result.reason


def test_nodes_have_the_same_bytes_in_processes_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rosbags")
    monkeypatch.chdir(tmp_path)
    write_types(tmp_path, "plain")
    assert same_bytes(tmp_path, OWN_TYPES.format(package="plain"))
    assert same_bytes(tmp_path, ROS_VELOCITY.format(surge=1.0, turn=0.1, stamped=True), WATER)
