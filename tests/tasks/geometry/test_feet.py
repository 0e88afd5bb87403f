"""Bases of many corners stand on four that enclose the center of mass."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import shapely
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tasks.furniture import generate
from tasks.geometry.feet import LEAST_MARGIN, LIFT_M, NUDGE_M_S, UNDERSIDE_M, on_feet
from tasks.geometry.hulls import REDUCED, Hull, hull_of, is_within
from tasks.geometry.mass import mass_properties
from tasks.geometry.pieces import PieceConfig, pieces
from tasks.geometry.triangles import face_planes


def disc(corners: int, radius: float, height: float, turn: float = 0.0) -> Hull:
    """An upright prism on the ground [m]."""
    angles = turn + np.linspace(0, 2 * np.pi, corners, endpoint=False)
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return hull_of(np.concatenate([np.column_stack([ring, np.full(corners, z)]) for z in (0.0, height)]))


def touching(hull: Hull, low: float = 0.0) -> shapely.Geometry:
    return shapely.MultiPoint(hull.vertices[hull.vertices[:, 2] <= low + UNDERSIDE_M, :2])


def margin(base: shapely.Geometry, center: np.ndarray) -> float:
    """How far a point lies inside a polygon [m], negative outside."""
    area, point = base.convex_hull, shapely.Point(center[:2])
    return float(point.distance(area.boundary) if area.covers(point) else -point.distance(area))


@given(
    corners=st.integers(5, 29), radius=st.floats(0.03, 0.5), height=st.floats(0.005, 0.1), turn=st.floats(0, 7), share=st.floats(0, 0.98),
    way=st.floats(0, 7),
)  # fmt: skip
def test_the_only_four_corners_that_touch_enclose_the_center(
    corners: int, radius: float, height: float, turn: float, share: float, way: float
) -> None:
    hull = disc(corners, radius, height, turn)
    center = np.array([share * radius * np.cos(way), share * radius * np.sin(way), 1.0])
    before = margin(touching(hull), center)
    assume(before > 1e-6)
    made = on_feet([hull], center, 2)
    normals, offsets = face_planes(hull.vertices, hull.faces, 1e-14)
    assert all(is_within(after, REDUCED) and (after.vertices @ normals.T <= offsets + 1e-9).all() for after in made), (
        "inside of what it was"
    )
    if len(made) == 1:
        assert made[0] is hull
        return
    lifted, block = made
    feet = touching(block)
    assert len(feet.geoms) == 4
    assert lifted.vertices[:, 2].min() >= LIFT_M
    assert mass_properties(made).volume >= mass_properties([hull]).volume - LIFT_M * touching(hull).convex_hull.area - 1e-12
    assert on_feet([hull], center, 1) == (hull,)
    assert margin(feet, center) >= LEAST_MARGIN * before - 1e-9
    ring = shapely.get_coordinates(touching(hull).convex_hull.exterior)[:-1]
    best = max(margin(shapely.MultiPoint(four), center) for four in combinations(ring, 4)) if corners <= 12 else 0.0
    assert margin(feet, center) >= best - 1e-6


@given(st.integers(5, 30), st.floats(0.0, 0.4), st.floats(0, 7))
def test_a_base_under_the_middle_of_what_it_carries_stays_round(corners: int, share: float, way: float) -> None:
    hull = disc(corners, 0.1, 0.02)
    assume(corners > 8)
    assert on_feet([hull], 0.1 * share * np.array([np.cos(way), np.sin(way), 0]), 9) == (hull,)


def test_what_does_not_reach_the_ground_or_has_few_corners_stays_as_it_is() -> None:
    box = hull_of(np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 0.1)], dtype=np.float64))
    above = disc(24, 0.1, 0.1)
    hulls = [box, Hull(above.vertices + np.array([0.0, 0.0, 1.0]), above.faces)]
    assert on_feet(hulls, np.array([0.09, 0.01, 0.5]), 9) == tuple(hulls)


@given(st.floats(0.03, 0.4), st.integers(2, 3))
def test_a_ball_stands_on_a_patch_that_a_nudge_does_not_roll_it_off(radius: float, subdivisions: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions, radius)
    hull = hull_of(np.asarray(ball.vertices) @ Rotation.from_euler("y", 31.7, degrees=True).as_matrix().T)  # on one of its corners
    made = on_feet([hull], hull.vertices.mean(axis=0), 2)
    low = float(hull.vertices[:, 2].min())
    patch = touching(made[1], low)
    assert len(patch.geoms) == 4
    assert margin(patch, hull.vertices.mean(axis=0)) > NUDGE_M_S * np.sqrt(radius / 9.81)
    assert margin(patch, hull.vertices.mean(axis=0)) < 0.2 * radius
    assert made[1].vertices[:, 2].min() == low


@given(st.floats(0.02, 0.2), st.floats(0.3, 1.0))
def test_what_lies_on_a_line_or_a_face_gets_no_patch(radius: float, length: float) -> None:
    roll = trimesh.creation.cylinder(radius, length, sections=24)
    lying = hull_of(np.asarray(roll.vertices)[:, [2, 1, 0]])
    assert on_feet([lying], lying.vertices.mean(axis=0), 9) == (lying,)


def test_a_lamp_that_leans_out_over_its_round_foot_stands_on_four_corners() -> None:
    """PhysX keeps four of 24 points at random and tips such a lamp over the side between two of them."""
    counts = set()
    for seed in range(4):
        lamp = generate("desk lamp", (0.38, 0.18 + 0.01 * seed, 0.45), np.random.default_rng(seed))
        made = pieces(lamp.parts, lamp.pieces, PieceConfig())
        (foot,) = [hull for hull in made.hulls if hull.vertices[:, 2].min() <= UNDERSIDE_M]
        assert margin(touching(foot), made.properties.center) > 0.004
        counts.add(len(touching(foot).geoms))
    assert counts == {4}
