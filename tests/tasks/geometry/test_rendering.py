"""Pictures by rays: a window shows what the whole picture does, and colors are those of the corners."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.furniture import generate
from tasks.geometry.meshes import surface_of
from tasks.geometry.rendering import NOTHING, WHOLE, Camera, RayScene
from tasks.geometry.transforms import look_at

COMPARED = ("depth", "part", "color", "normal")


@settings(max_examples=15, deadline=None)
@given(
    category=st.sampled_from(["chair", "plant", "sofa", "picture"]), seed=st.integers(0, 9), yaw=st.floats(0, 6.3),
    away=st.floats(0.2, 4.0), aside=st.floats(-1.0, 1.0),
)  # fmt: skip
def test_nothing_of_a_picture_lies_outside_the_window_of_its_points(
    category: str, seed: int, yaw: float, away: float, aside: float
) -> None:
    """From near and far, with the object partly or wholly out of the picture, or behind the camera."""
    parts = generate(category, None, np.random.default_rng(seed)).parts
    eye = np.array([away * np.cos(yaw), away * np.sin(yaw), 0.6])
    camera = Camera.with_fov(look_at(eye, np.array([0.0, aside, 0.4])), 61, 47, 0.9)
    window = camera.window(np.concatenate([part.vertices for part in parts]))
    scene = RayScene(parts)
    whole, part = scene.render(camera), scene.render(camera, window=window)
    for name in COMPARED:
        assert np.array_equal(getattr(part, name), getattr(whole, name)), name
    assert np.array_equal(camera.rays(window), camera.rays()[window])


def test_the_window_of_what_lies_ahead_is_small_and_of_what_is_beside_the_camera_everything() -> None:
    camera = Camera.with_fov(look_at(np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])), 100, 80, 1.0)
    rows, columns = camera.window(np.array([[5.0, -0.2, -0.2], [5.0, 0.2, 0.2]]))
    assert rows.stop - rows.start < 20
    assert columns.stop - columns.start < 20
    assert camera.window(np.array([[-1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])) == WHOLE


@pytest.mark.parametrize("seed", range(3))
def test_colors_are_blended_by_where_a_face_is_hit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    part = surface_of(generate("sofa", None, rng).parts).to_trimesh()
    visual: Any = part.visual
    visual.vertex_colors = np.column_stack([rng.integers(0, 256, (len(part.vertices), 3)), np.full(len(part.vertices), 255)])
    camera = Camera.with_fov(look_at(np.array([2.0, 1.0, 1.5]), np.array([0.0, 0.0, 0.4])), 60, 60, 0.8)
    scene = RayScene([part])
    hits = scene.cast(camera.rays())
    seen = np.isfinite(hits["t_hit"])
    u, v = hits["primitive_uvs"][seen].astype(np.float64).T
    corners = np.asarray(visual.vertex_colors)[np.asarray(part.faces)[hits["primitive_ids"][seen]]][..., :3].astype(np.float64)
    expected = (1 - u - v)[:, None] * corners[:, 0] + u[:, None] * corners[:, 1] + v[:, None] * corners[:, 2]
    color = scene.colors(hits, (1, 2, 3))
    assert np.abs(color[seen] - expected).max() <= 0.5 + 1e-3
    assert (color[~seen] == [1, 2, 3]).all()
    assert 0.1 < seen.mean() < 0.9


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 3))
def test_first_faces_are_those_of_hits(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    poses = [trimesh.transformations.translation_matrix([i, 0, 0]) for i in range(count)]
    parts = [trimesh.creation.box(rng.uniform(0.2, 1, 3), pose) for pose in poses]
    scene = RayScene(parts)
    rays = np.concatenate([rng.normal(0, 3, (5, 4, 3)), rng.normal(size=(5, 4, 3))], axis=-1).astype(np.float32)
    hits, (far, face) = scene.cast(rays), scene.first_faces(rays)
    starts = np.cumsum([0, *(len(part.faces) for part in parts)])
    is_hit = hits["primitive_ids"] != NOTHING
    part = np.where(is_hit, hits["geometry_ids"], 0).astype(np.int64)
    assert np.array_equal(face, np.where(is_hit, hits["primitive_ids"].astype(np.int64) + starts[part], -1))
    assert np.array_equal(far, hits["t_hit"])
    assert far.dtype == np.float32
