"""The .navmesh codec and convex covers, against files and distances of the real simulator."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.geometry.meshes import Surface
from tasks.navigation.convex import convex_cover
from tasks.navigation.navmesh import (
    Settings,
    Tile,
    dump_navmesh,
    navmesh_from_polygons,
    polygon_areas,
    polygon_islands,
    read_navmesh,
)
from tasks.navigation.obstacles import footprint, free_space
from tasks.navigation.planar import PlanarPathFinder
from tests.conftest import REPOSITORY

GOLDEN = REPOSITORY / "tests" / "golden" / "navmesh"
INDEX = json.loads((GOLDEN / "index.json").read_text())
TO_PLAN = np.array([1.0, -1.0])
"""(x, z) of the glTF frame to (x, y) of the world."""


def region_of(tile: Tile) -> shapely.Geometry:
    """Union of a tile's polygons in the world frame."""
    rings = [tile.vertices[p["vertices"][: p["count"]]][:, [0, 2]].astype(float) * TO_PLAN for p in tile.polygons]
    return shapely.union_all([shapely.Polygon(ring) for ring in rings], grid_size=1e-5)


def room_with(holes: list[tuple[float, float, float, float, float]]) -> shapely.Geometry:
    """A 5 x 4 m room less turned boxes (x, y, width, depth, degrees)."""
    boxes = [shapely.affinity.rotate(shapely.box(x - w / 2, y - d / 2, x + w / 2, y + d / 2), turn) for x, y, w, d, turn in holes]
    return shapely.difference(shapely.box(0, 0, 5, 4), shapely.union_all(boxes)) if boxes else shapely.box(0, 0, 5, 4)


side = st.floats(0.2, 1.6)
rooms = st.lists(st.tuples(st.floats(0, 5), st.floats(0, 4), side, side, st.sampled_from([0.0, 0.0, 15.0, 37.0, 45.0])), max_size=8).map(
    room_with
)


@pytest.mark.parametrize("entry", INDEX, ids=lambda e: e["navmesh"])
def test_golden_files_survive_the_round_trip_bit_for_bit(entry: dict) -> None:
    data = (GOLDEN / entry["navmesh"]).read_bytes()
    navmesh = read_navmesh(data)
    assert dump_navmesh(navmesh) == data
    (tile,) = navmesh.tiles
    assert polygon_areas(tile).sum() == pytest.approx(entry["area_m2"], rel=1e-6)
    assert polygon_islands(tile).max() + 1 == entry["islands"]
    for name, value in entry["settings"].items():
        assert getattr(navmesh.settings, name) == pytest.approx(value)


def test_version_1_has_no_settings_and_survives_too() -> None:
    data = (GOLDEN / INDEX[0]["navmesh"]).read_bytes()
    old = data[:4] + (1).to_bytes(4, "little") + data[8:40] + data[96:]
    navmesh = read_navmesh(old)
    assert navmesh.version == 1
    assert navmesh.settings is None
    assert dump_navmesh(navmesh) == old


@pytest.mark.parametrize("entry", INDEX, ids=lambda e: e["navmesh"])
def test_exact_paths_on_the_simulators_navmesh_bound_its_own_from_below(entry: dict) -> None:
    """Detour strings its path through a corridor of polygons: never shorter than exact, and equal when the corridor is right."""
    (tile,) = read_navmesh((GOLDEN / entry["navmesh"]).read_bytes()).tiles
    finder = PlanarPathFinder(region_of(tile))
    paths = np.load(GOLDEN / entry["navmesh"].replace(".navmesh", "_paths.npz"))
    starts, goals = (finder.snap(paths[name][:, [0, 2]] * TO_PLAN) for name in ("start", "goal"))
    exact = np.array([finder.geodesic(a, b).length for a, b in zip(starts, goals, strict=True)])
    theirs = paths["geodesic_m"]
    assert (np.isfinite(exact) == np.isfinite(theirs)).all()
    reached = np.isfinite(theirs)
    assert reached.sum() >= 50
    assert (theirs[reached] >= exact[reached] - 1e-5).all()
    assert np.mean(np.abs(theirs[reached] - exact[reached]) < 1e-3) > 0.85


@pytest.mark.parametrize("entry", INDEX, ids=lambda e: e["navmesh"])
def test_free_floor_of_the_same_boxes_agrees_with_the_simulators_up_to_its_voxels(entry: dict) -> None:
    room = np.load(GOLDEN / entry["room"])
    vertices = np.column_stack([room["vertices"][:, 0], -room["vertices"][:, 2], room["vertices"][:, 1]]).astype(float)
    radius, height = entry["settings"].get("agent_radius", 0.1), entry["settings"].get("agent_height", 1.5)
    cell = entry["settings"].get("cell_size", 0.05)
    boxes = [vertices[i : i + 8] for i in range(0, len(vertices), 8)]
    faces = [room["faces"][i : i + 12].astype(int) - 8 * (i // 12) for i in range(0, len(room["faces"]), 12)]
    prints = [footprint(Surface(v, f, np.zeros((8, 3), np.uint8)), 0.2, height) for v, f in zip(boxes, faces, strict=True)]
    (x0, y0), (x1, y1) = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    floor = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    (tile,) = read_navmesh((GOLDEN / entry["navmesh"]).read_bytes()).tiles
    region, slack = region_of(tile), 3 * cell
    # What Recast calls free is free for a slightly thinner agent, and what is free for a thicker one it calls free.
    assert region.difference(free_space(floor, prints, radius - slack)).area < 0.01 * region.area
    # It drops parts of less than 20 x 20 cells.
    assert free_space(floor, prints, radius + slack, (20 * cell) ** 2).difference(region).area < 0.01 * region.area


@given(free=rooms)
@settings(max_examples=60, deadline=None)
def test_convex_cover_tiles_the_region_and_keeps_its_connections(free: shapely.Geometry) -> None:
    finder = PlanarPathFinder(free)
    if finder.free.is_empty:
        return
    navmesh = read_navmesh(dump_navmesh(finder.navmesh(Settings())))
    (tile,) = navmesh.tiles
    areas, islands = polygon_areas(tile), polygon_islands(tile)
    assert areas.sum() == pytest.approx(finder.free.area, abs=1e-3)
    assert (areas > 0).all()
    by_island = sorted((areas[islands == i].sum() for i in range(islands.max() + 1)), reverse=True)
    assert by_island == pytest.approx(finder.islands, abs=1e-3)
    assert region_of(tile).symmetric_difference(finder.free).area < 1e-3
    for number, polygon in enumerate(tile.polygons):
        count = polygon["count"]
        assert 3 <= count <= 6
        corners = tile.vertices[polygon["vertices"][:count]][:, [0, 2]].astype(float) * TO_PLAN
        ahead = np.roll(corners, -1, axis=0) - corners
        turn = ahead[:, 0] * np.roll(ahead, -1, axis=0)[:, 1] - ahead[:, 1] * np.roll(ahead, -1, axis=0)[:, 0]
        assert (turn > -1e-5).all()
        for k, beyond in enumerate(polygon["neighbors"][:count].astype(int) - 1):
            if beyond < 0:
                continue
            edge = {int(polygon["vertices"][k]), int(polygon["vertices"][(k + 1) % count])}
            other = tile.polygons[beyond]
            back = other["neighbors"][: other["count"]].astype(int) - 1
            shared = [{int(other["vertices"][j]), int(other["vertices"][(j + 1) % other["count"]])} for j in np.flatnonzero(back == number)]
            assert edge in shared


def test_header_says_what_habitat_needs_to_take_the_file_as_it_is() -> None:
    navmesh = navmesh_from_polygons(convex_cover(room_with([(2.5, 2, 1, 1, 30)])), Settings())
    data = dump_navmesh(navmesh)
    (tile,) = navmesh.tiles
    assert navmesh.settings is not None
    assert navmesh.settings.include_static_objects
    assert data[92:96] == b"\x01\x01\x01\x01"
    assert len(tile.links) >= tile.polygons["count"].sum()
    assert tile.reference == 1 << int(np.ceil(np.log2(len(tile.polygons))))
    assert tile.details["triangle_count"].sum() == len(tile.detail_triangles)
    low, high = np.array(tile.bounds[:3]), np.array(tile.bounds[3:])
    assert (tile.vertices >= low).all()
    assert (tile.vertices <= high).all()
    golden = read_navmesh((GOLDEN / "room1_agent.navmesh").read_bytes())
    # Tile numbers and polygon winding follow the same rule as in the simulator's own file.
    assert golden.tiles[0].reference == 1 << int(np.ceil(np.log2(golden.most_polygons)))
    assert (polygon_areas(golden.tiles[0]) > 0).all()


def test_detail_triangles_cover_their_polygons_and_mark_outer_edges() -> None:
    (tile,) = navmesh_from_polygons(convex_cover(room_with([(2, 2, 1.3, 0.6, 37), (4, 1, 0.5, 0.5, 15)])), Settings()).tiles
    for polygon, detail, area in zip(tile.polygons, tile.details, polygon_areas(tile), strict=True):
        count, total, outer = int(polygon["count"]), 0.0, set()
        first = int(detail["triangle_base"])
        for a, b, c, flags in tile.detail_triangles[first : first + int(detail["triangle_count"])].astype(int):
            ax, bx, cx = (tile.vertices[polygon["vertices"][k]][[0, 2]] * TO_PLAN for k in (a, b, c))
            total += 0.5 * float((bx - ax)[0] * (cx - ax)[1] - (bx - ax)[1] * (cx - ax)[0])
            outer |= {edge for shift, edge in enumerate([(a, b), (b, c), (c, a)]) if flags >> 2 * shift & 3}
        assert total == pytest.approx(area, abs=1e-5)
        assert outer == {(k, (k + 1) % count) for k in range(count)}


@given(cut=st.integers(0, 10_000), at=st.integers(0, 10_000), value=st.integers(0, 255))
@settings(max_examples=150, deadline=None)
def test_damaged_files_are_refused_by_name_or_read_consistently(cut: int, at: int, value: int) -> None:
    data = (GOLDEN / "room1_agent.navmesh").read_bytes()
    with pytest.raises(InputError, match=r"^broken\.navmesh: "):
        read_navmesh(data[: cut % len(data)], "broken.navmesh")
    changed = bytearray(data)
    changed[at % 300] = value
    refused, navmesh = "", None
    try:
        navmesh = read_navmesh(bytes(changed), "broken.navmesh")
    except InputError as error:
        refused = str(error)
    if navmesh is None:
        assert refused.startswith("broken.navmesh: ")
    else:
        # A NaN's bits and a boolean above one are the only objects that reading may normalize.
        assert len(dump_navmesh(navmesh)) == len(data)


def test_an_empty_region_and_one_that_does_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="0 polygons"):
        navmesh_from_polygons(convex_cover(shapely.MultiPolygon()), Settings())
