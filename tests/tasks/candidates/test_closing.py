"""Crops of a scan as closed solids: what is open stays open, what was not seen is closed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tasks.candidates.closing import solid_field
from tasks.candidates.completion import Unseen
from tasks.candidates.scan_crop import closed_crop, pieces_of_crop
from tasks.furniture import generate
from tasks.geometry.meshes import Surface, sample_surface, surface_of
from tests.tasks.candidates.crops import (
    cabinet_parts,
    crop_of_parts,
    signed_distance,
)


@pytest.mark.parametrize("extents", [(0.45, 0.8, 0.9), (0.6, 1.2, 2.0), (0.3, 0.4, 0.3), (2.0, 1.5, 0.5)])
def test_a_cabinet_seen_from_the_front_becomes_a_solid_box(extents: tuple[float, float, float]) -> None:
    crop = crop_of_parts(cabinet_parts(extents))
    mesh = closed_crop(crop, solid_field(crop))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert np.allclose(mesh.bounds, crop.bounds, atol=0.004)
    assert mesh.bounds[0][2] <= 0.004
    assert 0.85 < mesh.volume / np.prod(np.ptp(crop.bounds, axis=0)) < 1.01


def test_the_bottom_is_flat_where_the_object_stands() -> None:
    crop = crop_of_parts(cabinet_parts((0.5, 0.8, 0.9)))
    mesh = closed_crop(crop, solid_field(crop))
    down = mesh.face_normals[:, 2] < -0.99
    low = mesh.triangles_center[:, 2] < mesh.bounds[0][2] + 0.005
    assert mesh.area_faces[down & low].sum() > 0.7 * 0.5 * 0.8


def test_what_is_open_stays_open() -> None:
    shelf = generate("bookshelf", (0.3, 0.9, 1.6), np.random.default_rng(4))
    table = generate("table", (0.8, 1.4, 0.75), np.random.default_rng(4))
    for model, box in ((shelf, 0.3 * 0.9 * 1.6), (table, 0.8 * 1.4 * 0.75)):
        crop = crop_of_parts(model.parts, hidden=())
        mesh = closed_crop(crop, solid_field(crop))
        true = sum(part.volume for part in model.parts)
        assert mesh.is_watertight
        assert true * 0.7 < mesh.volume < 0.5 * box
    # Under the top, between the legs, is air.
    assert (signed_distance(mesh, np.array([[0, 0, 0.3], [0.1, 0.2, 0.4], [-0.1, -0.3, 0.2]])) > 0.02).all()


@pytest.mark.whole
@pytest.mark.parametrize("category", ["chair", "desk", "sofa", "nightstand", "lamp"])
def test_the_closed_surface_lies_near_the_scanned_one(category: str) -> None:
    model = generate(category, None, np.random.default_rng(8))
    crop = crop_of_parts(model.parts)
    field = solid_field(crop)
    mesh = closed_crop(crop, field)
    points, _, _ = sample_surface(crop, 1500, np.random.default_rng(0))
    distance = np.abs(signed_distance(mesh, points))
    assert mesh.is_watertight
    assert np.median(distance) < 0.6 * field.step
    assert np.percentile(distance, 80) < 1.5 * field.step  # clefts between cushions and the inside of a shade are filled


def test_colors_of_the_solid_are_those_of_the_scan() -> None:
    parts = cabinet_parts((0.5, 0.8, 0.9))
    crop = crop_of_parts(parts)
    for mesh in (closed_crop(crop, solid_field(crop)), pieces_of_crop(crop, solid_field(crop))[0]):
        assert (np.asarray(mesh.visual.vertex_colors)[:, :3] == [150, 100, 60]).all()


def test_nothing_to_enclose_is_said() -> None:
    vertices = np.array([[0, 0, 0], [1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]])
    speck = Surface(vertices, np.array([[0, 1, 2], [0, 1, 3]]), np.zeros((4, 3), np.uint8))
    with pytest.raises(ValueError, match="encloses nothing"):
        closed_crop(speck, solid_field(speck))
    with pytest.raises(ValueError, match="encloses nothing"):
        pieces_of_crop(speck, solid_field(speck))


def test_a_sheet_that_is_seen_in_parts_stays_near_its_scan() -> None:
    """A wavy curtain in five strips with gaps between them: no strip is left out."""
    rng = np.random.default_rng(4)
    strips = []
    for k in range(5):
        u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 0.16, 9), np.linspace(0.0, 2.2, 111)))
        across = u + 0.3 * k
        points = np.column_stack([across, 0.06 * np.sin(14 * across), v]) + rng.normal(0, 0.004, (len(u), 3))
        a = (np.arange(110)[:, None] * 9 + np.arange(8)).ravel()
        faces = np.concatenate([np.column_stack([a, a + 1, a + 10]), np.column_stack([a, a + 10, a + 9])])
        strips.append((points, faces + len(u) * k))
    vertices = np.concatenate([points for points, _ in strips]) - [0.68, 0.0, 0.0]
    crop = Surface(vertices, np.concatenate([faces for _, faces in strips]), np.full(vertices.shape, 128, dtype=np.uint8))
    mesh = closed_crop(crop, solid_field(crop))
    samples, _, _ = sample_surface(surface_of([mesh]), 40_000, rng)
    far = cKDTree(samples).query(vertices)[0]
    assert mesh.is_watertight
    assert (far <= 0.05).mean() > 0.95


def test_space_that_was_seen_empty_is_not_filled() -> None:
    """Under a table's top that reaches down out of sight, frames saw past: no skirt is drawn down there."""
    crop = crop_of_parts(cabinet_parts((1.0, 1.0, 0.1)))
    raised = Surface(crop.vertices + np.array([0.0, 0.0, 0.6]), crop.faces, crop.colors)
    unseen = Unseen((0.0, 0.0, 0.0, 0.0, 0.6), "body", stands=True)
    filled = solid_field(raised, unseen)
    carved = solid_field(raised, unseen, lambda nodes: (np.abs(nodes[:, :2]) < 0.6).all(axis=1) & (nodes[:, 2] < 0.5))
    below = int(0.3 / filled.step)
    assert (filled.values[:, :, below] < 0).mean() > 0.5
    assert (carved.values[:, :, below] < 0).mean() < 0.1
    assert (carved.values[:, :, 3] < 0).any(), "legs reach the floor"
