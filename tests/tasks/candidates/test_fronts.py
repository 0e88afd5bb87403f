"""Lines on fronts: templates draw drawers and doors only where the scan shows them."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.furniture import canonical_category, generate
from tasks.furniture.storage import FRONTED
from tasks.geometry.meshes import sample_surface, surface_of
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at, translation
from tasks.views.crops import Crop
from tasks.views.fronts import has_lines

SIZE = np.array([0.5, 1.0, 0.9])


def front(rows: int, contrast: float, relief_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Scanned points of the front of a box with drawers, by their gaps, and their colors."""
    places = rng.uniform(-0.5, 0.5, (20_000, 2)) * SIZE[1:]
    height = (places[:, 1] / SIZE[2] + 0.5) * rows
    is_gap = np.abs(height - np.round(height)) * SIZE[2] / rows < 0.012
    depth = 0.5 * SIZE[0] - relief_m * is_gap + rng.normal(0, 0.003, len(places))
    gray = 150 - contrast * is_gap + rng.normal(0, 4, len(places))
    return np.column_stack([depth, places]), np.repeat(np.clip(gray, 0, 255)[:, None], 3, axis=1).astype(np.uint8)


@pytest.mark.parametrize(
    ("contrast", "relief_m", "is_lined"), [(0.0, 0.0, False), (40.0, 0.0, True), (0.0, 0.02, True), (3.0, 0.002, False)]
)
def test_gaps_are_told_by_color_or_depth(contrast: float, relief_m: float, is_lined: bool) -> None:
    points, colors = front(4, contrast, relief_m, np.random.default_rng(0))
    assert has_lines(points, colors, SIZE, np.eye(4), None) == is_lined


def test_shading_from_top_to_bottom_is_no_line() -> None:
    points, colors = front(4, 0.0, 0.0, np.random.default_rng(1))
    shaded = (colors * (0.7 + 0.3 * (points[:, 2:] / SIZE[2] + 0.5))).astype(np.uint8)
    assert not has_lines(points, shaded, SIZE, np.eye(4), None)


def test_a_picture_shows_lines_that_points_do_not() -> None:
    """A dresser and a plain box of its size, seen by a camera two meters before them; the points are a single color."""
    answers = []
    for is_plain in (False, True):
        model = generate("dresser", (0.5, 1.0, 0.9), np.random.default_rng(0), (150, 110, 70), has_plain_front=is_plain)
        pose = translation((0.0, 0.0, 0.45))
        camera = Camera.with_fov(look_at(np.array([2.0, 0.3, 0.9]), np.array([0.0, 0.0, 0.45])), 480, 360, 0.8)
        rendering = RayScene(model.parts).render(camera, shade=False)
        points = np.random.default_rng(2).uniform(-0.5, 0.5, (4000, 3)) * SIZE
        points[:, 0] = 0.25
        colors = np.full((4000, 3), 120, dtype=np.uint8)
        view = Crop(rendering.color, camera, rendering.part >= 0)
        answers.append(has_lines(points, colors, SIZE, pose, view))
    assert answers == [True, False]


@pytest.mark.parametrize("category", FRONTED)
def test_plain_fronts_have_no_handles_and_keep_the_size(category: str) -> None:
    extents = (0.5, 0.9, 1.1)
    lined = generate(category, extents, np.random.default_rng(3), (150, 110, 70))
    plain = generate(category, extents, np.random.default_rng(3), (150, 110, 70), has_plain_front=True)
    assert canonical_category(category) == category
    assert "handles" in {part.metadata["name"] for part in lined.parts}
    assert "handles" not in {part.metadata["name"] for part in plain.parts}
    bounds = surface_of(plain.parts).bounds
    assert np.allclose(bounds[1] - bounds[0], extents)
    points, _, _ = sample_surface(surface_of(plain.parts), 2000, np.random.default_rng(0))
    assert (points[:, 0] > bounds[1, 0] - 0.06).mean() > 0.1
