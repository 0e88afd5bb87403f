"""How far colliders are from what cameras see: exact on boxes, and seams apart."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.geometry.hulls import Hull, hull_of
from tasks.geometry.transforms import translation
from tasks.optimization.colliders.distances import SEAM_M, depths, distance_from
from tests.tasks.optimization.scenes import TABLE, Scene, block


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Hull:
    return hull_of(np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3))


def test_distances_from_boxes_are_those_of_the_nearest_side() -> None:
    points = np.random.default_rng(3).uniform(-1.0, 2.0, (2000, 3))
    low, high = np.zeros(3), np.array([1.0, 0.5, 0.7])
    beyond = np.maximum(np.maximum(low - points, points - high), 0.0)
    within = np.minimum(points - low, high - points).min(axis=1)
    true = np.where(within > 0.0, within, np.linalg.norm(beyond, axis=1))
    assert distance_from(points, [box((0.0, 0.0, 0.0), (1.0, 0.5, 0.7))]) == pytest.approx(true, abs=1e-9)


def test_depths_in_many_pieces_are_the_deepest_and_never_beyond_the_distance() -> None:
    points = np.random.default_rng(4).uniform(-1.0, 2.0, (500, 3))
    pieces = [box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), box((0.5, 0.5, 0.5), (1.5, 1.2, 1.6))]
    all_depths = depths(points, pieces)
    assert np.array_equal(all_depths, np.maximum(*(depths(points, [piece]) for piece in pieces)))
    outside = all_depths <= 0.0
    assert (-all_depths[outside] <= distance_from(points[outside], pieces) + 1e-9).all()


def test_a_collider_that_is_the_object_is_at_no_distance_and_seams_do_not_count() -> None:
    scene = Scene()
    alone = scene.add(block(0.6, 0.6, 0.4), translation([3.0, 0.0, 0.0]), "box")
    table = scene.add(TABLE, np.eye(4), "table")
    sunk = scene.add(block(1.0, 1.0, 0.8), translation([0.0, 1.6, 0.0]), "cabinet")
    beside = scene.add(block(0.8, 1.0, 0.8), translation([0.8, 1.6, 0.0]), "box")  # 10 cm in the cabinet: one of them is cut
    rows = {row.instance_id: row for row in scene.run().rows["placements"]}
    assert rows[alone].collider_distance_m == pytest.approx(0.0, abs=1e-6)
    assert rows[table].collider_distance_m < SEAM_M
    assert max(rows[name].collider_cut_share for name in (sunk, beside)) > 0.05
    assert max(rows[name].collider_distance_m for name in (sunk, beside)) < SEAM_M
