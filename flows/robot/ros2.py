"""The cart over ROS 2: a pilot that drives a real one along a way of the lake, and the simulated one as a base for anybody's pilot.

`python -m flows.robot.ros2 pilot --lake ./lake --scene demo/office --episode 0003` listens to `scan` (sensor_msgs/LaserScan), `odom`
(nav_msgs/Odometry, of which it takes the speeds, as wheels say them) and `imu` (sensor_msgs/Imu), where there is one, and says `cmd_vel`
(geometry_msgs/Twist) and `pose` (geometry_msgs/PoseWithCovarianceStamped, frame `map`: the world frame of the replica and of its maps for
nav2). `base` is the other end: it listens to `cmd_vel` and says `odom`, `imu` and `scan`.

rclpy and the messages come with ROS 2, not from PyPI: they are imported when a node is made.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.families.policies import POLICIES

if TYPE_CHECKING:
    from tasks.robot.bodies import CartBody
    from tasks.robot.configuration import RobotConfig
    from tasks.robot.driving import DriveRoute
    from tasks.robot.floor_map import Floor
    from warehouse.lake import Lake

Array = NDArray[np.float64]

QUEUE = 10
"""Messages that wait at most; a pilot wants the newest."""


class RosNode(Protocol):
    """What is used of `rclpy.node.Node`."""

    def create_publisher(self, kind: Any, topic: str, queue: int) -> Any:
        """Something with `publish(message)`."""
        ...

    def create_subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], queue: Any) -> Any:
        """Calls back with every message. queue: How many wait at most, or a profile of rclpy's."""
        ...

    def create_timer(self, seconds: float, callback: Callable[[], None]) -> Any:
        """Calls back again and again."""
        ...

    def get_clock(self) -> Any:
        """What says `now()`."""
        ...

    def get_logger(self) -> Any:
        """What takes `warning(text)`."""
        ...


class PilotNode:
    """Drives whatever listens to `cmd_vel` along a route.

    It says to stand still until the first scan, when scans stay away for `estimation.buffer_s`, and once the way is over.
    """

    def __init__(self, node: RosNode, route: DriveRoute, config: RobotConfig) -> None:
        from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
        from nav_msgs.msg import Odometry
        from rclpy.qos import qos_profile_sensor_data as sensing  # drivers of lidars say scans once, to whoever hears them
        from sensor_msgs.msg import Imu, LaserScan

        self._node, self._config, self._twist, self._posed = node, config, Twist, PoseWithCovarianceStamped
        self.navigator, self.localization = route.navigator, route.guide
        self._start: float | None = None
        self._scanned_at = -math.inf
        self._commands = node.create_publisher(Twist, "cmd_vel", QUEUE)
        self._poses = node.create_publisher(PoseWithCovarianceStamped, "pose", QUEUE)
        node.create_subscription(LaserScan, "scan", self._scanned, sensing)
        node.create_subscription(Odometry, "odom", self._rolled, sensing)
        node.create_subscription(Imu, "imu", self._turned, sensing)
        node.create_timer(config.planner.period_s, self._decide)

    @property
    def is_over(self) -> bool:
        """Whether the way is over, for good or bad."""
        return self.navigator.phase.is_final

    def stop(self) -> None:
        """Say to stand."""
        self._commands.publish(self._twist())

    def _time(self, stamp: Any) -> float:
        """Seconds of a stamp since the first one."""
        seconds = float(stamp.sec) + float(stamp.nanosec) * 1e-9
        if self._start is None:
            self._start = seconds
        return seconds - self._start

    def _rolled(self, message: Any) -> None:
        from tasks.robot.drive import wheel_speeds

        twist = message.twist.twist
        if not self._are_finite("odom", twist.linear.x, twist.angular.z):
            return
        left, right = wheel_speeds(float(twist.linear.x), float(twist.angular.z), self._config.cart)
        self.localization.wheels(self._time(message.header.stamp), float(left), float(right))

    def _turned(self, message: Any) -> None:
        if self._are_finite("imu", message.angular_velocity.z):
            self.localization.gyro(self._time(message.header.stamp), float(message.angular_velocity.z))

    def _are_finite(self, topic: str, *values: float) -> bool:
        """Whether a reading is numbers; one that is not is left out, and named."""
        are_finite = all(map(math.isfinite, values))
        if not are_finite:
            self._node.get_logger().warning(f"{topic}: a reading of {values} is left out")
        return are_finite

    def _scanned(self, message: Any) -> None:
        from tasks.robot.driving import in_world, returns_at

        then = self._time(message.header.stamp)
        ranges: Array = np.array(message.ranges, dtype=np.float64)
        ranges[~((ranges >= message.range_min) & (ranges <= message.range_max))] = np.inf
        angles = np.array(float(message.angle_min) + float(message.angle_increment) * np.arange(len(ranges)), dtype=np.float64)
        points = returns_at(ranges, angles)
        self.localization.scan(then, points)
        pose = self.localization.at(then)[0]
        self.navigator.see(in_world(points, pose), pose)
        self._scanned_at = max(self._scanned_at, then)

    def _decide(self) -> None:
        if not math.isfinite(self._scanned_at):
            self.stop()  # it has not seen where it is
            return
        stamp = self._node.get_clock().now().to_msg()
        now = self._time(stamp)
        pose, speeds, covariance = self.localization.at(now)
        command = (0.0, 0.0)
        if not self.is_over and now - self._scanned_at <= self._config.estimation.buffer_s:  # else it is blind
            command = self.navigator.command(now, pose, float(speeds[0]), float(speeds[1]))
        message = self._twist()
        message.linear.x, message.angular.z = float(command[0]), float(command[1])
        self._commands.publish(message)
        self._poses.publish(_posed(self._posed(), stamp, pose, covariance))


class BaseNode:
    """A simulated cart that listens to `cmd_vel`, as a robot's driver does. rng: Draws what the lidar errs by."""

    def __init__(self, node: RosNode, body: CartBody, truth: Floor, config: RobotConfig, rng: np.random.Generator) -> None:
        from geometry_msgs.msg import Twist
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import Imu, LaserScan

        self._node, self.body, self._segments, self._config, self._rng = node, body, truth.segments, config, rng
        self._kinds = (Odometry, Imu, LaserScan)
        self._odom, self._imu = node.create_publisher(Odometry, "odom", QUEUE), node.create_publisher(Imu, "imu", QUEUE)
        self._scans = node.create_publisher(LaserScan, "scan", QUEUE)
        node.create_subscription(Twist, "cmd_vel", self._commanded, QUEUE)
        node.create_timer(config.substep_s, lambda: body.step(config.substep_s))
        node.create_timer(config.noise.encoder_period_s, self._roll)
        node.create_timer(config.noise.gyro_period_s, self._turn)
        node.create_timer(config.lidar.period_s, self._scan)

    def _commanded(self, message: Any) -> None:
        self.body.drive(float(message.linear.x), float(message.angular.z))

    def _roll(self) -> None:
        from tasks.robot.drive import body_speeds

        left, right = self.body.wheel_readings()
        speed, turn = body_speeds(left, right, self._config.cart)
        message = self._stamped(self._kinds[0], "odom")
        message.child_frame_id = "base_link"
        message.twist.twist.linear.x, message.twist.twist.angular.z = float(speed), float(turn)
        self._odom.publish(message)

    def _turn(self) -> None:
        message = self._stamped(self._kinds[1], "base_link")
        message.angular_velocity.z = float(self.body.gyro_reading())
        self._imu.publish(message)

    def _scan(self) -> None:
        from tasks.robot.lidar import lidar_returns

        lidar = self._config.lidar
        message = self._stamped(self._kinds[2], "base_link")
        message.angle_min, message.angle_increment = 0.0, 2 * math.pi / lidar.rays
        message.angle_max = message.angle_increment * (lidar.rays - 1)
        message.range_min, message.range_max = float(lidar.least_m), float(lidar.range_m)
        message.ranges = [float(value) for value in lidar_returns(self._segments, self.body.pose, lidar, self._rng)]
        self._scans.publish(message)

    def _stamped(self, kind: Any, frame: str) -> Any:
        message = kind()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.header.frame_id = frame
        return message


def _posed(message: Any, stamp: Any, pose: Array, covariance: Array) -> Any:
    """A pose on the floor and its covariance as ROS has them: x, y, z and turns about them, by rows."""
    message.header.stamp, message.header.frame_id = stamp, "map"
    message.pose.pose.position.x, message.pose.pose.position.y = float(pose[0]), float(pose[1])
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(pose[2] / 2), math.cos(pose[2] / 2)
    whole = np.zeros((6, 6))
    whole[np.ix_([0, 1, 5], [0, 1, 5])] = covariance[:3, :3]
    message.pose.covariance = [float(value) for value in whole.ravel()]
    return message


def main(words: Sequence[str] | None = None) -> None:
    """Entry point of `python -m flows.robot.ros2`."""
    from flows.run.configuration import configure
    from warehouse.lake import Lake

    parser = argparse.ArgumentParser(prog="python -m flows.robot.ros2", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("node", choices=("pilot", "base"))
    parser.add_argument("--lake", required=True, help="the lake, a folder or s3://bucket/prefix")
    parser.add_argument("--scene", required=True, help="scene of the lake")
    parser.add_argument("--episode", required=True, help="episode whose way is driven; the base stands where it begins")
    parser.add_argument("--policy", default=POLICIES[0], help="whose way it is")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="robot.field=value; may be repeated")
    chosen = parser.parse_args(words)
    configuration = configure(None, chosen.settings, None, None)
    config: RobotConfig = configuration.stages["robot"]
    ride = ride_of(Lake.existing(chosen.lake), chosen.scene, chosen.episode, chosen.policy, config)
    _spin(chosen.node, ride, config, configuration.seed)


@dataclasses.dataclass(frozen=True)
class Ride:
    """A way to drive over ROS 2. floor: As the map has it. start: Its first pose, world frame, shape (3,). goals: Shape (n, 2)."""

    floor: Floor
    start: Array
    goals: Array


def ride_of(lake: Lake, scene: str, episode: str, policy: str, config: RobotConfig) -> Ride:
    """The newest way of a policy in an episode, with the floor that it leads over.

    Raises:
        InputError: the lake has no such way, or the cart does not fit.
    """
    from flows.robot.driving import world_rows
    from schemas.errors import InputError
    from schemas.evaluation import Trajectory
    from schemas.record import arrow_to_rows
    from tasks.robot import floor_in
    from tasks.robot.subgoals import subgoals

    reader = lake.snapshot()
    wanted = {"scene_id": [scene], "episode_id": [episode], "policy": [policy]}
    ways = arrow_to_rows(reader.matching("trajectories", wanted), Trajectory)
    if not ways:
        problem = f"{policy} has no way in episode {episode} of {scene}"
        raise InputError(lake.address, "trajectories", problem, f"metascenes evaluate --policy {policy} --lake {lake.address}")
    poses = ways[-1].poses
    floor, _ = floor_in(world_rows(reader, scene), lake.blobs, config)
    goals = subgoals(poses, floor, config.cart, config.planner)
    if goals.problem is not None:
        raise InputError(scene, f"episode {episode}", goals.problem, "choose another episode or a smaller robot.cart")
    return Ride(floor, np.array(poses[0], dtype=np.float64), goals.points)


def _spin(kind: str, ride: Ride, config: RobotConfig, seed: int) -> None:
    """Run a node until its way is over, or for good."""
    try:
        import rclpy
    except ImportError:
        raise SystemExit("rclpy is not installed; source ROS 2's setup file (it comes with ROS 2, not from PyPI)") from None

    from tasks.robot.bodies import PlanarBody
    from tasks.robot.driving import route

    rclpy.init()
    node = rclpy.create_node(f"metascenes_{kind}")
    try:
        if kind == "base":
            rng = np.random.default_rng(seed)
            BaseNode(node, PlanarBody(config.cart, config.noise, ride.floor, ride.start, rng), ride.floor, config, rng)
            rclpy.spin(node)
            return
        pilot = PilotNode(node, route(ride.goals, ride.floor, ride.start, config), config)
        try:
            while rclpy.ok() and not pilot.is_over:
                rclpy.spin_once(node, timeout_sec=config.planner.period_s)
            print(pilot.navigator.problem or f"{pilot.navigator.phase.value} after {pilot.navigator.recoveries} recoveries")
        finally:
            pilot.stop()  # whatever ended it
    finally:
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
