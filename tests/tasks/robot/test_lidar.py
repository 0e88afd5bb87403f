"""The lidar against shapely, and what its noise does."""

from __future__ import annotations

import math

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tasks.robot.configuration import Lidar
from tasks.robot.lidar import lidar_returns, ray_angles, visible

PERFECT = Lidar(noise_m=0.0, dropped=0.0)
SQUARE = np.array([[-2, -1, 2, -1], [2, -1, 2, 1], [2, 1, -2, 1], [-2, 1, -2, -1]], dtype=np.float64)

places = st.floats(-6, 6).map(lambda value: round(value, 3))
lines = st.lists(st.tuples(places, places, places, places), min_size=1, max_size=12)


@given(lines=lines, x=places, y=places, yaw=st.floats(-4, 4))
def test_each_ray_ends_where_shapely_says(lines: list[tuple[float, ...]], x: float, y: float, yaw: float) -> None:
    segments = np.array(lines)
    lidar = Lidar(rays=36, noise_m=0.0, dropped=0.0, least_m=0.0, range_m=20.0)
    found = lidar_returns(segments, [x, y, yaw], lidar)
    seen = shapely.multilinestrings(shapely.linestrings(segments.reshape(-1, 2, 2)))
    ends, here = shapely.multipoints(segments.reshape(-1, 2)), shapely.Point(x, y)
    for angle, distance in zip(ray_angles(lidar) + yaw, found, strict=True):
        ray = shapely.LineString([(x, y), (x + 25 * math.cos(angle), y + 25 * math.sin(angle))])
        if ray.distance(ends) < 1e-6 or here.distance(seen) < 1e-6:
            continue  # whether it passes an end or meets it is a matter of rounding
        true = here.distance(shapely.intersection(ray, seen))
        assert math.isinf(distance) if math.isnan(true) or true > 20 else abs(distance - true) < 1e-9


def test_a_room_is_seen_all_around_counterclockwise_from_ahead() -> None:
    ranges = lidar_returns(SQUARE, [0.5, 0.25, math.pi / 2], PERFECT)
    np.testing.assert_allclose(ranges[[0, 90, 180, 270]], [0.75, 2.5, 1.25, 1.5], atol=1e-12)
    assert np.isfinite(ranges).all()


def test_nothing_returns_from_beyond_the_range_or_from_within_the_cart() -> None:
    assert np.isinf(lidar_returns(SQUARE, [0.0, 0.0, 0.0], Lidar(range_m=0.9, noise_m=0.0, dropped=0.0))).all()
    near = lidar_returns([[0.05, -1, 0.05, 1]], [0.0, 0.0, 0.0], PERFECT)
    assert np.isinf(near[:45]).all()
    assert np.isinf(lidar_returns(np.zeros((0, 4)), [0.0, 0.0, 0.0], PERFECT)).all()


def test_noise_and_lost_returns_are_as_large_as_they_say_and_drawn_again_alike() -> None:
    lidar = Lidar(rays=36_000, noise_m=0.02, dropped=0.1)
    true = lidar_returns(SQUARE, [0.3, 0.1, 0.4], Lidar(rays=36_000, noise_m=0.0, dropped=0.0))
    read = lidar_returns(SQUARE, [0.3, 0.1, 0.4], lidar, np.random.default_rng(5))
    kept = np.isfinite(read)
    assert 0.89 < kept.mean() < 0.91
    errors = (read - true)[kept]
    assert abs(errors.mean()) < 0.001
    assert 0.0195 < errors.std() < 0.0205
    np.testing.assert_array_equal(read, lidar_returns(SQUARE, [0.3, 0.1, 0.4], lidar, np.random.default_rng(5)))


@given(lines=lines, x=places, y=places, yaw=st.floats(-4, 4))
def test_what_is_visible_alone_is_seen_as_all_is(lines: list[tuple[float, ...]], x: float, y: float, yaw: float) -> None:
    segments = np.array(lines)
    lidar = Lidar(rays=60, noise_m=0.0, dropped=0.0, least_m=0.0)
    met = visible(segments, [x, y, yaw], lidar)
    ranges = lidar_returns(segments, [x, y, yaw], lidar)
    np.testing.assert_array_equal(lidar_returns(segments[met], [x, y, yaw], lidar), ranges)
    nothing = lidar_returns(np.delete(segments, met, axis=0), [x, y, yaw], lidar)
    assert (nothing >= ranges).all()
    for number in met:
        rest = lidar_returns(np.delete(segments, number, axis=0), [x, y, yaw], lidar)
        assert (rest >= ranges).all()


def test_what_stands_behind_a_wall_is_not_visible() -> None:
    behind = [[3, -0.5, 3, 0.5]]
    assert visible([*SQUARE.tolist(), *behind], [0.0, 0.0, 0.0], PERFECT).tolist() == [0, 1, 2, 3]
