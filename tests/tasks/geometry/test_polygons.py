"""Triangles of polygons: fans of convex ones, and the whole area of those that are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.files import polygons
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


def write_quad(folder: Path, points: np.ndarray) -> None:
    """Write a quad as `a.obj`, `a.ply` and `a.usda`."""
    lines = [f"{x} {y} {z}" for x, y, z in points]
    (folder / "a.obj").write_text("".join(f"v {line}\n" for line in lines) + "f 1 2 3 4\n")
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (folder / "a.ply").write_text(head + faces + "\n".join(lines) + "\n4 0 1 2 3\n")
    listed = ", ".join(f"({x}, {y}, {z})" for x, y, z in points)
    values = ("int[] faceVertexCounts = [4]", "int[] faceVertexIndices = [0, 1, 2, 3]", f"point3f[] points = [{listed}]")
    (folder / "a.usda").write_text("\n".join(["#usda 1.0", 'def Mesh "m"', "{", *values, "}", ""]))


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


@pytest.mark.parametrize(
    "outline",
    [
        [[0.0, 0], [1, 1], [1, 0], [0, 1.5]],
        # Halves of the same size cancel out.
        [[0.0, 0], [1, 1], [1, 0], [0, 1]],
        [[0.0, 0], [1, 1], [1, 0.5], [1, 0], [0, 1], [0, 0.5]],
        [[0.0, 0], [2, 2], [2, 0], [0, 2], [-1, 1]],
    ],
)
@pytest.mark.parametrize("first", range(4))
def test_outlines_that_cross_themselves_stay_fans_and_are_counted(outline: list[list[float]], first: int) -> None:
    bow = np.column_stack([np.roll(outline, first, axis=0), np.zeros(len(outline))])
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    triangulation = triangulate(np.concatenate([square, bow]), np.array([4, len(bow)]))
    fan = [[4, 4 + step, 5 + step] for step in range(1, len(bow) - 1)]
    assert triangulation.corners.tolist() == [[0, 1, 2], [0, 2, 3], *fan]
    assert triangulation.notes == ("outlines that cross themselves (1): their area is not exact",)


def test_quads_that_are_not_finite_or_have_no_area_stay_fans_without_a_note() -> None:
    broken = np.array([[0.0, 0, 0], [2, 2, 0], [0, np.nan, 0], [-2, 2, 0]])
    line = np.array([[0.1, 0.1, 0], [0.7, 0.7, 0], [0.3, 0.3, 0], [0.9, 0.9, 0]])
    for outline in (broken, line, np.zeros((4, 3))):
        triangulation = triangulate(outline, np.array([4]))
        assert (triangulation.corners.tolist(), triangulation.notes) == ([[0, 1, 2], [0, 2, 3]], ())


@given(st.floats(-0.9, 0.9), st.floats(0.05, 0.45), st.integers(0, 3), st.integers(0, 2), st.booleans())
def test_concave_quads_are_split_without_ear_clipping(across: float, depth: float, first: int, axis: int, is_turned: bool) -> None:
    outline = ARROW.copy()
    outline[2] = [across * depth, depth * 2 + abs(across) * depth, 0]
    quad = np.roll(np.roll(outline[::-1] if is_turned else outline, first, axis=0), axis, axis=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(polygons, "_clipped", None)
        triangulation = triangulate(np.concatenate([quad, quad + 9.0]), np.array([4, 4]))
    assert triangulation.owner.tolist() == [0, 0, 1, 1]
    assert triangulation.notes == ()
    faces = triangulation.corners[:2]
    crosses = np.cross(quad[faces[:, 1]] - quad[faces[:, 0]], quad[faces[:, 2]] - quad[faces[:, 0]])
    assert crosses[0] @ crosses[1] > 0, "both keep the winding"
    assert face_areas(quad, faces).sum() == pytest.approx(area_of(outline))


def test_readers_note_outlines_that_cross_themselves(tmp_path: Path) -> None:
    from tasks.capture.files.ply import read_ply

    write_quad(tmp_path, np.array([[0.0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1.5, 0]]))
    note = "outlines that cross themselves (1): their area is not exact"
    for name in ("a.obj", "a.usda"):
        assert [text.endswith(note) for text in read_model(tmp_path / name, tmp_path).notes] == [True], name
    assert read_ply(tmp_path / "a.ply", "a.ply").notes == (f"a.ply: {note}",)


def test_readers_fill_a_concave_polygon(tmp_path: Path) -> None:
    from tasks.capture.files.ply import read_ply

    write_quad(tmp_path, np.roll(ARROW, -1, axis=0))
    for name in ("a.obj", "a.usda"):
        parts = read_model(tmp_path / name, tmp_path).parts
        assert sum(part.area for part in parts) == pytest.approx(2.0), name
    surface = read_ply(tmp_path / "a.ply", "a.ply").surface
    assert face_areas(surface.vertices, surface.faces).sum() == pytest.approx(2.0)
