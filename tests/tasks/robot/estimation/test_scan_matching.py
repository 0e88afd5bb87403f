"""Scans held against maps: poses come back, within what the match says of them, and against an alignment by scipy and shapely."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import chi2

from tasks.robot.configuration import Estimation, Lidar
from tasks.robot.estimation.odometry import wrapped
from tasks.robot.estimation.scan_matching import HUBER_SIGMAS, LEAST_SIGMA_M, REACH_SIGMAS, ScanMatcher, _kernels
from tasks.robot.lidar import lidar_returns, ray_angles, visible
from tests.tasks.robot.floors import bare_floor, random_boxes

LIDAR, PERFECT, ESTIMATION = Lidar(), Lidar(noise_m=0.0, dropped=0.0), Estimation()


def returns(segments: np.ndarray, pose: np.ndarray, lidar: Lidar, rng: np.random.Generator | None = None) -> np.ndarray:
    """Where rays end, in the frame of the cart, shape (k, 2)."""
    ranges, angles = lidar_returns(segments, pose, lidar, rng), ray_angles(lidar)
    seen = np.isfinite(ranges)
    return (ranges[seen] * np.array([np.cos(angles[seen]), np.sin(angles[seen])])).T


def room(seed: int, clear: float = 0.4) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Segments of a room with boxes, and a pose in it."""
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(1.0, 5.0, 2), rng.uniform(-math.pi, math.pi)])
    return bare_floor(random_boxes(rng, clear=[pose[:2]], keep=clear)).segments, pose, rng


def apart(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.array([*(pose[:2] - other[:2]), wrapped(float(pose[2] - other[2]))])


def corridor(length: float, width: float = 2.0) -> np.ndarray:
    return np.array([[-length, 0.0, length, 0.0], [length, width, -length, width]])


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.1, -0.1, 0.05), (-0.15, 0.1, -0.1)])
def test_a_perfect_scan_gives_the_pose_back(off: tuple[float, float, float]) -> None:
    for seed in range(25):
        segments, pose, _ = room(seed)
        match = ScanMatcher(segments, PERFECT, ESTIMATION).match(returns(segments, pose, PERFECT), pose + off)
        assert match.is_used
        assert len(match.directions) == 3
        assert np.abs(apart(match.pose, pose)).max() < 1e-3, seed
        assert match.residual_m < 1e-3


def test_noisy_scans_err_as_much_as_the_match_says() -> None:
    """And a little less, for the map does not err there, but is taken to."""
    squares = []
    for seed in range(30):
        segments, pose, rng = room(seed)
        matcher = ScanMatcher(segments, LIDAR, ESTIMATION)
        for _ in range(8):
            match = matcher.match(returns(segments, pose, LIDAR, rng), pose + rng.normal(0, [0.02, 0.02, 0.01]))
            assert match.is_used
            error = match.directions @ apart(match.pose, pose)
            squares.append(float(error @ np.linalg.solve(match.covariance, error)))
    count = 3 * len(squares)
    assert 0.75 * 3.0 < np.mean(squares) < 3.0 * chi2.ppf(0.975, count) / count
    assert np.mean(np.array(squares) < chi2.ppf(0.99, 3)) > 0.98


@pytest.mark.parametrize("heading", [0.0, 0.7, math.pi / 2])
def test_of_a_corridor_a_scan_says_nothing_along_the_axis(heading: float) -> None:
    rng = np.random.default_rng(3)
    segments = corridor(40.0)
    pose, guess = np.array([0.0, 0.7, heading]), np.array([0.2, 0.78, heading + 0.05])
    match = ScanMatcher(segments, LIDAR, ESTIMATION).match(returns(segments, pose, LIDAR, rng), guess)
    assert match.is_used
    assert match.directions.shape == (2, 3)
    np.testing.assert_allclose(match.directions[:, 0], 0.0, atol=1e-9)
    assert match.pose[0] == pytest.approx(0.2, abs=1e-9), "left as it was"
    assert match.pose[1] == pytest.approx(0.7, abs=0.005)
    assert match.pose[2] == pytest.approx(heading, abs=0.002)
    error = match.directions @ apart(match.pose, pose)
    assert error @ np.linalg.solve(match.covariance, error) < chi2.ppf(0.999, 2)


def test_where_a_corridor_ends_within_reach_the_axis_is_known() -> None:
    segments = np.vstack([corridor(6.0), [[6.0, 0.0, 6.0, 2.0]]])
    pose = np.array([0.0, 0.7, 0.1])
    match = ScanMatcher(segments, PERFECT, ESTIMATION).match(returns(segments, pose, PERFECT), pose + np.array([0.1, 0.05, 0.02]))
    assert len(match.directions) == 3
    assert np.abs(apart(match.pose, pose)).max() < 1e-3


def test_what_the_map_lacks_does_not_pull_the_pose() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        pose = np.array([3.0, 3.0, rng.uniform(-3, 3)])
        boxes = random_boxes(rng, clear=[pose[:2]])
        whole, known = bare_floor(boxes).segments, bare_floor(boxes, unseen=range(3)).segments
        scan = returns(whole, pose, PERFECT)
        matcher = ScanMatcher(known, LIDAR, ESTIMATION)
        match, bare = matcher.match(scan, pose + np.array([0.05, 0.04, 0.02])), matcher.match(returns(known, pose, PERFECT), pose)
        assert match.is_used
        assert np.abs(apart(match.pose, pose)).max() < 0.005, seed
        assert match.share <= bare.share


def test_hopeless_guesses_and_scans_say_nothing() -> None:
    segments, pose, _ = room(1)
    matcher = ScanMatcher(segments, LIDAR, ESTIMATION)
    scan = returns(segments, pose, PERFECT)
    for guess in (pose + np.array([40.0, 0.0, 0.0]), pose + np.array([9.0, -9.0, 1.0])):
        assert not matcher.match(scan, guess).is_used
    assert not matcher.match(scan[:10], pose).is_used
    assert not matcher.match(np.zeros((0, 2)), pose).is_used
    assert not ScanMatcher(np.zeros((0, 4)), LIDAR, ESTIMATION).match(scan, pose).is_used
    elsewhere = ScanMatcher(room(2)[0] * 0.3, LIDAR, dataclasses.replace(ESTIMATION, match_share=0.9)).match(scan, [0.9, 0.9, 0.0])
    assert not elsewhere.is_used
    np.testing.assert_array_equal(elsewhere.pose, [0.9, 0.9, 0.0])


def aligned(points: np.ndarray, lines: np.ndarray, pose: np.ndarray, sigma: float, map_sigma: float) -> np.ndarray:
    """The pose with the least sum of Huber's losses over returns and their nearest lines: pairs by shapely, minimum by scipy."""
    drawn = shapely.linestrings(lines.reshape(-1, 2, 2))
    along = lines[:, 2:] - lines[:, :2]
    along /= np.linalg.norm(along, axis=1)[:, None]
    normals = np.array([-along[:, 1], along[:, 0]]).T
    reach = REACH_SIGMAS * math.hypot(sigma, map_sigma, LEAST_SIGMA_M)
    for _ in range(30):
        turn = np.array([[math.cos(pose[2]), -math.sin(pose[2])], [math.sin(pose[2]), math.cos(pose[2])]])
        placed = points @ turn.T + pose[:2]
        distances = shapely.distance(drawn[None, :], shapely.points(placed)[:, None])
        nearest = distances.argmin(axis=1)
        across = ((placed - lines[nearest, :2]) * normals[nearest]).sum(axis=1)
        kept = (distances.min(axis=1) < reach) & (np.abs(np.abs(across) - distances.min(axis=1)) < 1e-9)
        rays = (placed - pose[:2]) / np.linalg.norm(points, axis=1)[:, None]
        spread = np.sqrt((sigma * (rays * normals[nearest]).sum(axis=1)) ** 2 + map_sigma**2 + LEAST_SIGMA_M**2)

        def residuals(state: np.ndarray, kept: np.ndarray = kept, nearest: np.ndarray = nearest, spread: np.ndarray = spread) -> np.ndarray:
            cos, sin = math.cos(state[2]), math.sin(state[2])
            moved = points[kept] @ np.array([[cos, sin], [-sin, cos]]) + state[:2]
            return ((moved - lines[nearest[kept], :2]) * normals[nearest[kept]]).sum(axis=1) / spread[kept]

        before = pose
        pose = least_squares(residuals, before, loss="huber", f_scale=HUBER_SIGMAS, xtol=1e-12, ftol=1e-12, gtol=1e-12).x
        if np.abs(pose - before).max() < 1e-7:
            break
    return pose


def test_a_match_is_the_minimum_that_scipy_and_shapely_have() -> None:
    for seed in range(15):
        segments, pose, rng = room(seed)
        scan = returns(segments, pose, LIDAR, rng)
        guess = pose + rng.normal(0, [0.01, 0.01, 0.005])
        match = ScanMatcher(segments, LIDAR, ESTIMATION).match(scan, guess)
        lines = segments[visible(segments, guess, LIDAR)]
        for start, near in ((match.pose, 1e-4), (pose, 3e-4)):  # from elsewhere, returns at corners may come to be of other lines
            other = aligned(scan, lines, start, LIDAR.noise_m, ESTIMATION.map_sigma_m)
            assert np.abs(apart(match.pose, other)).max() < near, seed


coordinates = st.floats(-3, 3).map(lambda value: round(value, 2))


@given(
    points=st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=10),
    lines=st.lists(st.tuples(coordinates, coordinates, coordinates, coordinates), min_size=1, max_size=6),
    reach=st.floats(0.05, 4.0),
)
def test_returns_are_paired_with_the_line_that_shapely_says_is_nearest(
    points: list[tuple[float, float]], lines: list[tuple[float, float, float, float]], reach: float
) -> None:
    long = np.array([line for line in lines if math.hypot(line[2] - line[0], line[3] - line[1]) > 0.01]).reshape(-1, 4)
    normals, distances = _kernels()["_pair"](np.array(points), np.array(lines), reach)
    drawn = [shapely.LineString(line.reshape(2, 2)) for line in long]
    for point, normal, distance in zip(points, normals, distances, strict=True):
        away = np.array([line.distance(shapely.Point(point)) for line in drawn])
        if not len(away) or away.min() >= reach:
            assert math.isinf(distance)
            continue
        nearest = np.flatnonzero(away < away.min() + 1e-9)
        if math.isfinite(distance):
            assert abs(distance) == pytest.approx(away.min(), abs=1e-9)
            foot = np.array(point) - distance * normal
            assert np.linalg.norm(normal) == pytest.approx(1.0)
            assert min(drawn[index].distance(shapely.Point(foot)) for index in nearest) < 1e-9
        else:  # an end is nearest
            assert any(shapely.Point(point).distance(drawn[index].boundary) < away.min() + 1e-7 for index in nearest)
