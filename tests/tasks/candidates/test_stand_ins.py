"""Plain boxes that captured rooms have in place of furniture: no candidate makes a solid block of them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from schemas.candidates import Candidate
from tasks.candidates.scan_crop import is_stand_in
from tasks.geometry.meshes import dump_glb, surface_of
from tasks.geometry.transforms import yaw_pose
from tasks.stage import Blobs
from tests.tasks.candidates.crops import candidates_of, furniture

FITTED_SLOT = 4
BOX_SLOTS = (5, 6)


def rows_of(category: str, size: tuple[float, float, float], parts: list[trimesh.Trimesh], yaw: float = 0.7) -> dict[int, Candidate]:
    """Each slot of an instance whose mesh is of parts that stand about the origin."""
    files = Blobs()
    _, blobs = furniture(1, category, size, yaw)
    posed = yaw_pose(yaw, np.array([2.0, 2.0, 0.0]))
    for part in parts:
        part.apply_transform(posed)
    changed, own = furniture(1, category, size, yaw, mesh_blob=files.add(dump_glb(parts), "glb"))
    return {row.slot: row for row in candidates_of((changed, {**blobs, **own, **files})).rows["candidates"]}


def outcomes(category: str, size: tuple[float, float, float], parts: list[trimesh.Trimesh]) -> dict[int, str]:
    """Outcome of each slot, as `rows_of`."""
    return {slot: row.outcome for slot, row in rows_of(category, size, parts).items()}


def box(size: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(size).apply_translation([0, 0, size[2] / 2])


@pytest.mark.parametrize(("category", "is_block"), [("table", True), ("chair", True), ("sofa", True), ("cabinet", False), ("box", False)])
def test_a_box_stands_in_for_what_does_not_fill_it(category: str, is_block: bool) -> None:
    assert is_stand_in(surface_of([box((1.0, 0.6, 0.7))]), category) == is_block


def test_what_is_no_plain_box_is_a_crop() -> None:
    corner = box((1.0, 0.6, 0.7))
    corner.vertices[0] += 0.05
    assert not is_stand_in(surface_of([corner]), "table")
    assert not is_stand_in(surface_of([box((1.0, 0.6, 0.7)).subdivide()]), "table")


def test_a_table_that_is_a_box_gets_no_block() -> None:
    size = (3.62, 0.95, 0.74)
    slots = outcomes("table", size, [box(size)])
    assert {slots[slot] for slot in BOX_SLOTS} == {"empty"}
    assert {outcome for slot, outcome in slots.items() if slot not in BOX_SLOTS} == {"filled"}


def test_a_cabinet_that_is_a_box_keeps_its_crop() -> None:
    size = (1.0, 0.5, 1.8)
    slots = outcomes("cabinet", size, [box(size)])
    assert {slots[slot] for slot in BOX_SLOTS} == {"filled"}


@pytest.mark.parametrize(("category", "size"), [("table", (3.62, 0.95, 0.74)), ("chair", (0.5, 0.5, 0.85))])
def test_no_template_is_fitted_to_a_box_that_stands_in_for_furniture(category: str, size: tuple[float, float, float]) -> None:
    # Panels on all sides would fit best, and leave no room for chairs that are tucked in.
    row = rows_of(category, size, [box(size)])[FITTED_SLOT]
    assert (row.provider, row.is_fallback) == ("procedural", True)
    assert row.reason is not None
    assert "box" in row.reason
    assert "box" not in (rows_of(category, size, [box(size).subdivide()])[FITTED_SLOT].reason or "")
