"""Stand-ins for ROS 2: messages with the fields that `geometry_msgs`, `nav_msgs` and `sensor_msgs` give them, and a bus that carries them.

No ROS is at hand where these tests run. The field names are those of the public message definitions; a field that a message does not have
is an error, as it is there.
"""

from __future__ import annotations

import math
import sys
import types
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import pytest


class Time:
    """builtin_interfaces/Time."""

    __slots__ = ("nanosec", "sec")

    def __init__(self, sec: int = 0, nanosec: int = 0) -> None:
        self.sec, self.nanosec = sec, nanosec


def message(name: str, **fields: Callable[[], Any]) -> type:
    """A class of messages that have these fields, made anew for each, and no others."""

    def begin(self: Any) -> None:
        for field, make in fields.items():
            setattr(self, field, make())

    return type(name, (), {"__slots__": tuple(fields), "__init__": begin})


Header = message("Header", stamp=Time, frame_id=str)
Vector3 = message("Vector3", x=float, y=float, z=float)
Quaternion = message("Quaternion", x=float, y=float, z=float, w=lambda: 1.0)
Pose = message("Pose", position=Vector3, orientation=Quaternion)
PoseWithCovariance = message("PoseWithCovariance", pose=Pose, covariance=lambda: [0.0] * 36)
PoseWithCovarianceStamped = message("PoseWithCovarianceStamped", header=Header, pose=PoseWithCovariance)
Twist = message("Twist", linear=Vector3, angular=Vector3)
TwistWithCovariance = message("TwistWithCovariance", twist=Twist, covariance=lambda: [0.0] * 36)
Odometry = message("Odometry", header=Header, child_frame_id=str, pose=PoseWithCovariance, twist=TwistWithCovariance)
Imu = message(
    "Imu", header=Header, orientation=Quaternion, orientation_covariance=lambda: [0.0] * 9, angular_velocity=Vector3,
    angular_velocity_covariance=lambda: [0.0] * 9, linear_acceleration=Vector3, linear_acceleration_covariance=lambda: [0.0] * 9,
)  # fmt: skip
LaserScan = message(
    "LaserScan", header=Header, angle_min=float, angle_max=float, angle_increment=float, time_increment=float, scan_time=float,
    range_min=float, range_max=float, ranges=list, intensities=list,
)  # fmt: skip


SENSING = "best effort, depth 5"
"""`rclpy.qos.qos_profile_sensor_data`."""


def install(patched: pytest.MonkeyPatch) -> None:
    """Let the packages of ROS 2's messages be imported, as these stand-ins."""
    packages = {
        "geometry_msgs": [PoseWithCovarianceStamped, Twist], "nav_msgs": [Odometry], "sensor_msgs": [Imu, LaserScan],
    }  # fmt: skip
    for package, kinds in packages.items():
        module = types.ModuleType(f"{package}.msg")
        for kind in kinds:
            setattr(module, kind.__name__, kind)
        patched.setitem(sys.modules, package, types.ModuleType(package))
        patched.setitem(sys.modules, f"{package}.msg", module)
    qos = types.ModuleType("rclpy.qos")
    qos.qos_profile_sensor_data = SENSING  # type: ignore[attr-defined]
    patched.setitem(sys.modules, "rclpy", types.ModuleType("rclpy"))
    patched.setitem(sys.modules, "rclpy.qos", qos)


class Bus:
    """Topics, timers and a clock; messages of late topics arrive after a delay, in the order in which they were published."""

    def __init__(self, delays: dict[str, float] | None = None) -> None:
        self.now, self._delays = 0.0, delays or {}
        self.sent: dict[str, list[Any]] = defaultdict(list)
        self.qualities: dict[str, Any] = {}
        self.warnings: list[str] = []
        self._listeners: dict[str, list[Callable[[Any], None]]] = defaultdict(list)
        self._timers: list[list[Any]] = []
        self._under_way: list[tuple[float, int, str, Any]] = []

    def node(self) -> Node:
        return Node(self)

    def publish(self, topic: str, sent: Any) -> None:
        self.sent[topic].append(sent)
        self._under_way.append((self.now + self._delays.get(topic, 0.0), len(self._under_way), topic, sent))

    def mute(self, topic: str) -> None:
        """Let nobody hear a topic any more."""
        self._listeners[topic].clear()

    def listen(self, topic: str, callback: Callable[[Any], None]) -> None:
        self._listeners[topic].append(callback)

    def repeat(self, seconds: float, callback: Callable[[], None]) -> None:
        self._timers.append([seconds, seconds, callback])

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Let time pass in milliseconds."""
        end = self.now + seconds
        while self.now < end and not until():
            self.now = round(self.now + 0.001, 6)
            for timer in self._timers:
                if self.now >= timer[0] - 1e-9:
                    timer[0] = round(timer[0] + timer[1], 6)
                    timer[2]()
            due = sorted((item for item in self._under_way if item[0] <= self.now + 1e-9), key=lambda item: item[:2])
            self._under_way = [item for item in self._under_way if item[0] > self.now + 1e-9]
            for _, _, topic, sent in due:
                for callback in self._listeners[topic]:
                    callback(sent)


class Publisher:
    """kind: Of the messages that it takes; others are refused, as rclpy does."""

    def __init__(self, bus: Bus, kind: Any, topic: str) -> None:
        self._bus, self._kind, self._topic = bus, kind, topic

    def publish(self, sent: Any) -> None:
        assert isinstance(sent, self._kind)
        self._bus.publish(self._topic, sent)


class Node:
    """What is used of `rclpy.node.Node`."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def create_publisher(self, kind: Any, topic: str, queue: int) -> Publisher:
        assert queue > 0
        return Publisher(self._bus, kind, topic)

    def create_subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], queue: Any) -> None:
        assert queue == SENSING or queue > 0
        self._bus.qualities[topic] = queue
        self._bus.listen(topic, callback)

    def create_timer(self, seconds: float, callback: Callable[[], None]) -> None:
        self._bus.repeat(seconds, callback)

    def get_clock(self) -> Node:
        return self

    def get_logger(self) -> Node:
        return self

    def warning(self, text: str) -> None:
        self._bus.warnings.append(text)

    def now(self) -> Node:
        return self

    def to_msg(self) -> Time:
        sec = math.floor(self._bus.now + 100.0)  # a clock of the wall does not begin at nought
        return Time(sec, round((self._bus.now + 100.0 - sec) * 1e9))
