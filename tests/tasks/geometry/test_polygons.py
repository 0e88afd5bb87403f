"""Triangles of polygons: fans of convex ones, and the whole area of those that are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.files.polygons import triangulate
from tasks.geometry.triangles import face_areas
from tasks.library.formats import read_model

ARROW = np.array([[0.0, 0, 0], [2, 2, 0], [0, 1, 0], [-2, 2, 0]])
"""A quad whose third corner points inward: a fan from its second corner would leave it. Its area is 2."""


def star(corners: int, inner: float) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, 2 * corners, endpoint=False)
    radii = np.where(np.arange(2 * corners) % 2, inner, 1.0)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(len(angles))])


def area_of(outline: np.ndarray) -> float:
    x, y = outline[:, 0], outline[:, 1]
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


@given(st.integers(3, 12), st.floats(0.1, 0.9), st.integers(0, 30), st.integers(0, 2))
def test_triangles_cover_the_outline_once_and_keep_its_winding(corners: int, inner: float, first: int, axis: int) -> None:
    outline = np.roll(star(corners, inner), first, axis=0)
    turned = np.roll(outline, axis, axis=1)
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    made = triangulate(np.concatenate([square, turned, square[:3]]), np.array([4, len(outline), 3]))
    assert made.owner.tolist() == [0, 0, *[1] * (len(outline) - 2), 2]
    faces = made.corners[made.owner == 1] - 4
    crosses = np.cross(turned[faces[:, 1]] - turned[faces[:, 0]], turned[faces[:, 2]] - turned[faces[:, 0]])
    normal = np.roll([0.0, 0, 1], axis)
    assert (crosses @ normal > -1e-9).all()
    assert face_areas(turned, faces).sum() == pytest.approx(area_of(outline))


def test_outlines_that_cross_themselves_stay_fans() -> None:
    bow = np.array([[0.0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1.5, 0]])
    assert triangulate(bow, np.array([4])).corners.tolist() == [[0, 1, 2], [0, 2, 3]]
    broken = np.array([[0.0, 0, 0], [2, 2, 0], [0, np.nan, 0], [-2, 2, 0]])
    assert len(triangulate(broken, np.array([4])).corners) == 2


def test_readers_fill_a_concave_polygon(tmp_path: Path) -> None:
    from tasks.capture.files.ply import read_ply

    points = np.roll(ARROW, -1, axis=0)
    lines = [f"{x} {y} {z}" for x, y, z in points]
    (tmp_path / "a.obj").write_text("".join(f"v {line}\n" for line in lines) + "f 1 2 3 4\n")
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(head + faces + "\n".join(lines) + "\n4 0 1 2 3\n")
    listed = ", ".join(f"({x}, {y}, {z})" for x, y, z in points)
    values = ("int[] faceVertexCounts = [4]", "int[] faceVertexIndices = [0, 1, 2, 3]", f"point3f[] points = [{listed}]")
    (tmp_path / "a.usda").write_text("\n".join(["#usda 1.0", 'def Mesh "m"', "{", *values, "}", ""]))
    for name in ("a.obj", "a.usda"):
        parts = read_model(tmp_path / name, tmp_path).parts
        assert sum(part.area for part in parts) == pytest.approx(2.0), name
    surface = read_ply(tmp_path / "a.ply", "a.ply")
    assert face_areas(surface.vertices, surface.faces).sum() == pytest.approx(2.0)
