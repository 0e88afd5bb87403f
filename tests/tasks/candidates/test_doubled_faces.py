"""Volumes of models whose faces are listed twice, crops of plain boxes and strips, and values that the tables refuse."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.candidates.assets import make_asset
from tasks.candidates.closing import closed_mesh, solid_field
from tasks.candidates.scan_crop import closed_crop, pieces_of_crop
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import enclosed_volume

BOX = trimesh.creation.box((0.5, 0.4, 0.3))
VOLUME = 0.06


def stool() -> trimesh.Trimesh:
    """A seat on four legs, which its hull is far from."""
    legs = [trimesh.creation.box((0.04, 0.04, 0.4)).apply_translation((x, y, -0.22)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    return trimesh.util.concatenate([trimesh.creation.box((0.5, 0.5, 0.04)), *legs])


def volume_of(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, bool]:
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    asset = make_asset([mesh], provider="p", name="n", category="stool", source="s", license="l").asset
    return asset.volume_m3, asset.is_watertight


@pytest.mark.parametrize("case", ["twice", "both sides", "turned", "unmerged", "two shells", "reversed shell", "thrice"])
def test_faces_listed_twice_count_once(case: str) -> None:
    mesh = stool()
    v, f = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    n = len(v)
    expected = volume_of(v, f)[0]
    vertices, faces = {
        "twice": (v, np.vstack([f, f])),
        "both sides": (v, np.vstack([f, f[:, ::-1]])),
        "turned": (v, np.vstack([f, np.roll(f, 1, axis=1)])),
        "unmerged": (np.vstack([v[f].reshape(-1, 3)] * 2), np.arange(6 * len(f)).reshape(-1, 3)),
        "two shells": (np.vstack([v, v]), np.vstack([f, f + n])),
        "reversed shell": (np.vstack([v, v]), np.vstack([f, f[:, ::-1] + n])),
        "thrice": (v, np.vstack([f, f[:, ::-1], f])),
    }[case]
    volume, is_watertight = volume_of(vertices, faces)
    assert volume == pytest.approx(expected, rel=1e-9)
    assert is_watertight


@settings(max_examples=20)
@given(st.lists(st.booleans(), min_size=12, max_size=12), st.permutations(range(24)))
def test_any_order_and_winding_of_double_faces_has_one_volume(is_turned: list[bool], order: list[int]) -> None:
    faces = np.asarray(BOX.faces)
    second = np.where(np.array(is_turned)[:, None], faces[:, ::-1], np.roll(faces, 1, axis=1))
    assert volume_of(BOX.vertices, np.vstack([faces, second])[order])[0] == pytest.approx(VOLUME)


@pytest.mark.parametrize("size", [(0.5, 0.4, 0.3), (1.8, 0.6, 2.0), (0.3, 0.3, 0.3), (1.2, 0.6, 0.05)])
def test_a_crop_of_a_plain_box_is_filled(size: tuple[float, float, float]) -> None:
    box = trimesh.creation.box(size).apply_translation((0, 0, size[2] / 2))
    crop = Surface(np.asarray(box.vertices), np.asarray(box.faces), np.full((8, 3), 99, np.uint8))
    field = solid_field(crop)
    solid = closed_crop(crop, field)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(np.prod(size), rel=0.15 if min(size) > 0.1 else 0.3)
    assert np.allclose(solid.bounds, box.bounds, atol=1e-6)
    assert pieces_of_crop(crop, field)[1]


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_a_closed_strip_encloses_something(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, z = np.meshgrid(np.arange(0, 0.3, 0.02), np.arange(0.0, 0.06, 0.02))
    strip = np.column_stack([x.ravel(), 0.003 * rng.standard_normal(x.size), z.ravel()])
    n = x.shape[1]
    corner = np.array([row * n + i for row in range(2) for i in range(n - 1)])
    faces = np.vstack([np.column_stack([corner, corner + 1, corner + n]), np.column_stack([corner + 1, corner + n + 1, corner + n])])
    field = solid_field(Surface(strip, faces, np.zeros((len(strip), 3), np.uint8)))
    vertices, closed = closed_mesh(field)
    assert enclosed_volume(vertices, closed) > 0
