"""The ROS 2 nodes against stand-ins of its messages (`messages.py`): the pilot drives the base, late scans and all."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely

from flows.evaluation.acting import in_this_process, planned_policy
from flows.robot import ros2
from flows.robot.ros2 import BaseNode, PilotNode, ride_of
from flows.run.configuration import configure
from schemas.errors import InputError
from tasks.robot.bodies import PlanarBody
from tasks.robot.configuration import RobotConfig
from tasks.robot.driving import route
from tasks.robot.navigator import Phase
from tests.flows.robot.messages import SENSING, Bus, Imu, LaserScan, Odometry, install
from tests.tasks.robot.floors import bare_floor
from tests.tasks.simulation.acted_scenes import STUDY, acted_lake

CONFIG = RobotConfig()
FLOOR = bare_floor([shapely.box(2.5, 0.0, 3.0, 3.5)])
START = (1.0, 1.0, 1.5)
GOALS = np.array([[1.0, 2.0], [1.0, 3.0], [1.6, 4.2], [2.7, 4.3], [4.0, 4.0], [4.5, 3.0]])


@pytest.fixture(autouse=True)
def messages(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)


def pair(bus: Bus, seed: int = 0) -> tuple[PilotNode, PlanarBody]:
    rng = np.random.default_rng(seed)
    body = PlanarBody(CONFIG.cart, CONFIG.noise, FLOOR, START, rng)
    BaseNode(bus.node(), body, FLOOR, CONFIG, rng)
    return PilotNode(bus.node(), route(GOALS, FLOOR, START, CONFIG), CONFIG), body


@pytest.mark.whole
@pytest.mark.parametrize("delays", [{}, {"scan": 0.15, "odom": 0.02}])
def test_the_pilot_drives_the_base_to_the_end(delays: dict[str, float]) -> None:
    bus = Bus(delays)
    pilot, body = pair(bus)
    bus.run(90.0, lambda: pilot.is_over or body.touched is not None)
    assert body.touched is None
    assert pilot.navigator.phase is Phase.ARRIVED
    assert np.hypot(*(body.pose[:2] - GOALS[-1])) < CONFIG.planner.arrive_m + 0.02
    pose, _, _ = pilot.localization.at(bus.now)
    assert np.hypot(*(pose[:2] - body.pose[:2])) < 0.02
    bus.run(1.0)
    last = bus.sent["cmd_vel"][-1]
    assert (last.linear.x, last.angular.z) == (0.0, 0.0)  # it says so again and again: a driver stops without


def said_to_stand(bus: Bus, since: int = 0) -> bool:
    commands = bus.sent["cmd_vel"][since:]
    return bool(commands) and all((sent.linear.x, sent.angular.z) == (0.0, 0.0) for sent in commands)


def test_until_the_first_scan_it_says_to_stand() -> None:
    bus = Bus()
    node = bus.node()
    PilotNode(node, route(GOALS, FLOOR, START, CONFIG), CONFIG)
    bus.run(1.0)
    assert said_to_stand(bus)
    for _ in range(20):
        odom = Odometry()
        odom.header.stamp = node.to_msg()
        bus.publish("odom", odom)
        bus.run(0.05)
    assert said_to_stand(bus)
    assert not bus.sent["pose"]
    assert all(bus.qualities[topic] == SENSING for topic in ("scan", "odom", "imu"))


@pytest.mark.whole
def test_when_scans_stay_away_it_says_to_stand() -> None:
    bus = Bus({"scan": 0.05})
    _, body = pair(bus)
    bus.run(4.0)
    assert not said_to_stand(bus, -5)
    bus.mute("scan")
    bus.run(CONFIG.estimation.buffer_s + 0.2)
    before = len(bus.sent["cmd_vel"])
    bus.run(1.0)
    assert said_to_stand(bus, before)
    bus.run(1.0)
    assert abs(body.speeds[0]) < 1e-3


def test_readings_that_are_no_numbers_are_left_out_and_named() -> None:
    bus = Bus()
    pilot, _ = pair(bus)
    bus.run(0.5)
    odom, imu = Odometry(), Imu()
    odom.header.stamp = imu.header.stamp = bus.node().to_msg()
    odom.twist.twist.linear.x, imu.angular_velocity.z = math.nan, math.inf
    bus.publish("odom", odom)
    bus.publish("imu", imu)
    bus.run(1.0)
    assert [text.partition(":")[0] for text in bus.warnings] == ["odom", "imu"]
    assert np.isfinite(pilot.localization.at(bus.now + 99.0)[0]).all()


def test_messages_are_in_frames_and_units_of_ros() -> None:
    bus = Bus()
    _, body = pair(bus)
    bus.run(3.0)
    scan, odom, pose = (bus.sent[topic][-1] for topic in ("scan", "odom", "pose"))
    assert (scan.header.frame_id, odom.header.frame_id, odom.child_frame_id, pose.header.frame_id) == (
        "base_link",
        "odom",
        "base_link",
        "map",
    )
    assert len(scan.ranges) == CONFIG.lidar.rays
    assert np.isclose(scan.angle_max, 2 * math.pi - scan.angle_increment)
    assert (scan.range_min, scan.range_max) == (CONFIG.lidar.least_m, CONFIG.lidar.range_m)
    assert 100.0 < scan.header.stamp.sec + scan.header.stamp.nanosec * 1e-9 <= 103.0
    place, turn = pose.pose.pose.position, pose.pose.pose.orientation
    assert np.hypot(place.x - body.pose[0], place.y - body.pose[1]) < 0.05
    assert abs(math.remainder(2 * math.atan2(turn.z, turn.w) - body.pose[2], 2 * math.pi)) < 0.05
    assert math.isclose(turn.z**2 + turn.w**2, 1.0)
    covariance = np.reshape(pose.pose.covariance, (6, 6))
    assert np.allclose(covariance, covariance.T)
    assert (np.diag(covariance)[[0, 1, 5]] > 0).all()
    assert (covariance[2:5] == 0).all()
    speed, w = odom.twist.twist.linear.x, odom.twist.twist.angular.z
    assert abs(speed - body.speeds[0]) < 0.1
    assert abs(w - body.speeds[1]) < 0.3
    assert len(bus.sent["cmd_vel"]) == pytest.approx(30, abs=2)


def test_scans_of_other_lidars_are_read_by_their_own_angles_and_ranges() -> None:
    """Half a turn, from right to left, too near and too far returns and gaps in it: it says where the cart is all the same."""
    bus, pilot = Bus(), PilotNode(Bus().node(), route(GOALS, FLOOR, START, CONFIG), CONFIG)
    truth = np.array([1.02, 1.03, 1.48])
    angles = np.linspace(-math.pi / 2, math.pi / 2, 400)
    lines = shapely.linestrings(FLOOR.segments.reshape(-1, 2, 2))
    for tick in range(20):
        ranges = []
        for angle in angles + truth[2]:
            ray = shapely.LineString([truth[:2], truth[:2] + 20 * np.array([math.cos(angle), math.sin(angle)])])
            ranges.append(float(shapely.distance(shapely.Point(truth[:2]), shapely.intersection(ray, shapely.multilinestrings(lines)))))
        ranges[3], ranges[4], ranges[5], ranges[6] = math.inf, math.nan, 0.01, 900.0
        bus.now = 0.1 * tick
        scan = LaserScan()
        scan.header.stamp = bus.node().to_msg()
        scan.angle_min, scan.angle_increment, scan.angle_max = -math.pi / 2, math.pi / 399, math.pi / 2
        scan.range_min, scan.range_max, scan.ranges = 0.05, 15.0, ranges
        pilot._scanned(scan)
        odom = Odometry()
        odom.header.stamp = scan.header.stamp
        pilot._rolled(odom)
    pose, _, _ = pilot.localization.at(1.9)
    assert np.hypot(*(pose[:2] - truth[:2])) < 0.005
    assert abs(pose[2] - truth[2]) < 0.005


@pytest.mark.whole
def test_a_way_of_the_lake_is_a_ride(tmp_path: Path) -> None:
    lake = acted_lake(tmp_path / "lake", (STUDY,))
    with pytest.raises(InputError, match=r"expert has no way in episode 0001 of demo/study_00; metascenes evaluate --policy expert"):
        ride_of(lake, STUDY, "0001", "expert", CONFIG)
    planned = planned_policy(lake, "expert", configure())
    assert not [run.error for run in in_this_process(planned.todo) if run.error]
    lake.commit(scenes=planned.batches)
    ride = ride_of(lake, STUDY, "0001", "expert", CONFIG)
    assert ride.floor.covers(ride.goals).all()
    assert ride.start.shape == (3,)


def test_without_ros_it_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2, "ride_of", lambda *_: ros2.Ride(FLOOR, np.array(START), GOALS))
    monkeypatch.setattr("warehouse.lake.Lake.existing", lambda _: None)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(SystemExit, match="rclpy is not installed; source ROS 2's setup file"):
        ros2.main(["pilot", "--lake", "x", "--scene", STUDY, "--episode", "0001"])
