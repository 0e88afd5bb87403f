"""Fragments of regions: scraps of walls are walls, pieces of one thing are one, and things of other paints stay apart."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.fragments import FragmentConfig, joined_fragments, without_wall_scraps
from tasks.capture.instances.regions import RegionConfig
from tasks.capture.instances.structure import RoomPlane
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import vertex_normals
from tests.capture_scans import plate

Point = tuple[float, float, float]
Color = tuple[int, int, int]
Plate = tuple[Point, Point, Point, Color]
"""Corner and two sides [m], and color."""

GRAY, RED = (150, 150, 150), (200, 60, 50)


def scene(*plates: Plate) -> tuple[Surface, np.ndarray]:
    """A surface of plates and the number of each vertex's plate."""
    pieces = [plate(list(corner), list(a), list(b), 0.02) for corner, a, b, _ in plates]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    colors = np.concatenate(
        [np.tile(np.array(color, dtype=np.uint8), (len(vertices), 1)) for (vertices, _), (*_, color) in zip(pieces, plates, strict=True)]
    )
    faces = np.concatenate([faces + start for (_, faces), start in zip(pieces, starts[:-1], strict=True)])
    surface = Surface(np.concatenate([vertices for vertices, _ in pieces]), faces, colors)
    return surface, np.repeat(np.arange(len(pieces)), np.diff(starts))


def board(x: float, color: Color = GRAY, width: float = 0.3) -> Plate:
    return ((x, 0.0, 1.0), (width, 0.0, 0.0), (0.0, 0.3, 0.0), color)


def joined(*plates: Plate, **constants: float) -> tuple[np.ndarray, np.ndarray]:
    surface, own = scene(*plates)
    region = joined_fragments(surface, vertex_areas(surface), own, FragmentConfig(**constants), RegionConfig())
    return own, np.array([region[own == k][0] for k in range(len(plates))])


@pytest.mark.parametrize(("gap", "color", "is_one"), [(0.03, GRAY, True), (0.03, RED, False), (0.12, GRAY, False)])
def test_pieces_of_one_paint_that_nearly_touch_are_one(gap: float, color: Color, is_one: bool) -> None:
    _, regions = joined(board(0.0), board(0.3 + gap, color))
    assert (regions[0] == regions[1]) == is_one
    assert regions.min() == 0


def test_a_chain_of_pieces_is_one_unless_it_is_too_large_for_an_object() -> None:
    chain = [board(0.33 * k) for k in range(6)]
    assert len(set(joined(*chain)[1])) == 1
    surface, own = scene(*chain)
    small = RegionConfig(most_share=0.0, most_m2=0.2)
    region = joined_fragments(surface, vertex_areas(surface), own, FragmentConfig(), small)
    areas = np.bincount(region, weights=vertex_areas(surface))
    assert areas.max() <= 0.2
    assert len(areas) >= 3


def test_a_scrap_is_a_part_of_what_it_touches_whatever_its_color() -> None:
    _, regions = joined(board(0.0), board(0.33, RED, width=0.04), board(0.9))
    assert regions[0] == regions[1] != regions[2]
    _, apart = joined(board(0.0), board(0.33, RED, width=0.04), board(0.9), small_m2=0.0)
    assert len(set(apart)) == 3


def test_every_vertex_keeps_a_region_and_joining_again_changes_nothing() -> None:
    surface, own = scene(board(0.0), board(0.33), board(0.7, RED), board(1.03, RED))
    own[own == 3] = -1
    areas = vertex_areas(surface)
    region = joined_fragments(surface, areas, own, FragmentConfig(), RegionConfig())
    assert ((region < 0) == (own < 0)).all()
    assert set(region) == {-1, 0, 1}
    assert (joined_fragments(surface, areas, region, FragmentConfig(), RegionConfig()) == region).all()


@pytest.mark.parametrize(("off", "width", "is_wall"), [(0.03, 0.2, True), (0.15, 0.2, False), (0.03, 0.6, False)])
def test_small_pieces_in_the_plane_of_a_wall_are_that_wall(off: float, width: float, is_wall: bool) -> None:
    surface, own = scene(
        ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, 2.4), GRAY), ((3.1, off, 1.0), (width, 0.0, 0.0), (0.0, 0.0, 0.2), RED)
    )
    normals, areas = vertex_normals(surface.vertices, surface.faces), vertex_areas(surface)
    wall = RoomPlane("wall", np.flatnonzero(own == 0))
    (grown,), region = without_wall_scraps(surface, normals, areas, [wall], np.where(own == 0, -1, 0), FragmentConfig())
    assert len(grown.members) == (len(own) if is_wall else len(wall.members))
    assert (region.max() == -1) == is_wall


def test_a_room_without_regions_has_none_afterwards() -> None:
    surface, _ = scene(board(0.0))
    none, planes = np.full(len(surface.vertices), -1), [RoomPlane("wall", np.arange(len(surface.vertices)))]
    normals, areas = vertex_normals(surface.vertices, surface.faces), vertex_areas(surface)
    kept, region = without_wall_scraps(surface, normals, areas, planes, none, FragmentConfig())
    assert [plane.category for plane in kept] == ["wall"]
    assert np.array_equal(region, none)
    assert np.array_equal(joined_fragments(surface, areas, none, FragmentConfig(), RegionConfig()), none)
