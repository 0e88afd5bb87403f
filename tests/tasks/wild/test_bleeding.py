"""Labels that bleed over seams: by as much as stated, never away from them, and never over most of an object."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.scanner.bleeding import Bleed, BleedingSettings, bleed, blurred, cut_segments
from tasks.scanner.scenery import Scenery, SceneryObject


def scene(categories: tuple[str, ...]) -> Scenery:
    objects = [SceneryObject(f"{name}_{k}", name, np.eye(4), np.ones(3)) for k, name in enumerate(categories)]
    return Scenery([], np.zeros(0, dtype=np.int64), objects, None)


def strips(gap: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Two sheets of a meter each that meet at x = 0, 2 cm between points, and their owners."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-0.99, 1.0, 0.02), np.arange(0.0, 0.4, 0.02), indexing="ij"))
    return np.column_stack([x + gap * (x > 0), y, np.zeros_like(x)]), (x > 0).astype(np.int64)


ALWAYS = BleedingSettings(seams=1.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_label_reaches_as_far_as_stated(seed: int) -> None:
    points, owner = strips()
    labels, (row,) = bleed(scene(("sofa", "table")), owner, points, ALWAYS, np.random.default_rng(seed))
    moved = labels != owner
    assert isinstance(row, Bleed)
    assert row.vertices == moved.sum()
    assert set(owner[moved]) == {row.source}
    assert set(labels[moved]) == {row.into}
    assert 0.05 <= row.reach_m <= 0.15
    assert np.abs(points[moved, 0]).max() + 0.01 == pytest.approx(row.reach_m, abs=0.021)


def test_only_neighbors_have_a_seam_and_walls_do_not_bleed_into_floors() -> None:
    points, owner = strips(gap=0.2)
    assert bleed(scene(("sofa", "table")), owner, points, ALWAYS, np.random.default_rng(0))[1] == []
    points, owner = strips()
    assert bleed(scene(("floor", "wall")), owner, points, ALWAYS, np.random.default_rng(0))[1] == []
    assert bleed(scene(("sofa", "table")), owner, points, BleedingSettings(seams=0.0), np.random.default_rng(0))[1] == []


def test_a_small_object_keeps_its_share() -> None:
    points, owner = strips()
    cup = (np.abs(points[:, 0] - 0.05) < 0.045) & (points[:, 1] < 0.09)
    owner = np.where(cup, 1, 0)
    for seed in range(8):
        labels, _ = bleed(scene(("table", "cup")), owner, points, ALWAYS, np.random.default_rng(seed))
        assert (labels[cup] == 1).mean() >= ALWAYS.kept


def test_segments_are_cut_along_strips() -> None:
    segments = np.array([0, 0, 0, 0, 4, 4])
    owner, labels = np.array([1, 1, 1, 1, 2, 2]), np.array([2, 1, 1, 2, 2, 2])
    assert cut_segments(segments, owner, labels).tolist() == [0, 1, 1, 0, 4, 4]
    assert cut_segments(segments, owner, owner).tolist() == segments.tolist()


def test_blur_averages_colors_over_neighbors() -> None:
    faces = np.array([[k, k + 1, k + 2] for k in range(28)])
    colors = np.zeros((30, 3), dtype=np.uint8)
    colors[15:] = 240
    surface = Surface(np.column_stack([np.arange(30.0), np.arange(30) % 2, np.zeros(30)]), faces, colors)
    soft = blurred(surface, 3)
    assert soft.colors[0].tolist() == [0, 0, 0]
    assert soft.colors[-1].tolist() == [240, 240, 240]
    assert 60 < soft.colors[14, 0] < 180
    assert (np.diff(soft.colors[:, 0].astype(int)) >= 0).all()
