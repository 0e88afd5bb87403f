"""Images of floor, walls and ceiling: baked from a scan whose colors are known, filled in where it was hidden."""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial import cKDTree

from schemas.capture import RoomSurface, Shell
from schemas.record import check
from tasks.captions.colors import lab
from tasks.capture import CaptureConfig, find_scans, run
from tasks.capture.rooms.textures import LOOSE, OBJECT, STRUCTURE, TextureConfig, baked_surfaces, filled, room_charts
from tasks.fidelity.colors import ciede2000
from tasks.furniture.rooms import FurnishedRoom, furnish
from tasks.geometry.meshes import Surface, read_points, union_of
from tasks.scanner import ScannerConfig, scan_scene
from tasks.shell import room_shell
from tasks.stage import Blobs, Context
from tasks.surfaces import chart_of, textured
from tests.capture_scans import plate
from tests.replicas import room_of

WIDTH, DEPTH, HEIGHT = 5.0, 4.0, 2.6
SQUARE = ((0.0, 0.0), (WIDTH, 0.0), (WIDTH, DEPTH), (0.0, DEPTH))
TILE = 0.5
DARK, LIGHT = (110, 70, 40), (215, 195, 160)
INNER = (2.0, 1.0, 2.0, 3.0, 0.12, 2.0)
"""A wall inside the room, lower than the room is high."""


def painted_colors(points: np.ndarray) -> np.ndarray:
    """The room's true colors: a floor of tiles, walls that go from dark at the bottom to light at the top and from red to blue."""
    x, y, z = points.T
    dark = ((np.floor(x / TILE) + np.floor(y / TILE)) % 2 == 0)[:, None]
    floor = np.where(dark, [90, 60, 40], [215, 195, 160])
    walls = np.column_stack([200 - 25 * (x + y), 80 + 50 * z, 60 + 20 * (x + y)])
    ceiling = np.tile([240, 240, 235], (len(points), 1))
    kind = np.where(z < 0.02, 0, np.where(z > HEIGHT - 0.02, 2, 1))[:, None]
    return np.clip(np.where(kind == 0, floor, np.where(kind == 1, walls, ceiling)), 0, 255).astype(np.uint8)


def surface_from(corner: tuple[float, ...], u: tuple[float, ...], v: tuple[float, ...], step: float = 0.04) -> Surface:
    vertices, faces = plate(corner, u, v, step)
    return Surface(vertices, faces, painted_colors(vertices))


def room_surface(step: float = 0.04) -> Surface:
    """The room from inside, ceiling and inner wall with it."""
    up, half = (0, 0, HEIGHT), INNER[4] / 2
    long, high = (0, INNER[3] - INNER[1], 0), (0, 0, INNER[5])
    return union_of(
        [
            surface_from((0, 0, 0), (WIDTH, 0, 0), (0, DEPTH, 0), step), surface_from((0, 0, HEIGHT), (0, DEPTH, 0), (WIDTH, 0, 0), step),
            surface_from((0, 0, 0), up, (WIDTH, 0, 0), step), surface_from((0, DEPTH, 0), (WIDTH, 0, 0), up, step),
            surface_from((0, 0, 0), (0, DEPTH, 0), up, step), surface_from((WIDTH, 0, 0), up, (0, DEPTH, 0), step),
            surface_from((INNER[0] - half, INNER[1], 0), high, long, step), surface_from((INNER[0] + half, INNER[1], 0), long, high, step),
        ]
    )  # fmt: skip


def the_room() -> Shell:
    return dataclasses.replace(room_of(polygon=SQUARE), height_m=HEIGHT, interior_walls=(INNER,))


def baked(
    surface: Surface, kinds: np.ndarray | None = None, room: Shell | None = None, config: TextureConfig | None = None
) -> tuple[dict[str, RoomSurface], Blobs]:
    blobs = Blobs()
    own = np.full(len(surface.faces), STRUCTURE, dtype=np.int8) if kinds is None else kinds
    rows = baked_surfaces(room or the_room(), [surface.to_trimesh()], [own], config or TextureConfig(), blobs)
    check(rows, RoomSurface)
    return {row.surface: row for row in rows}, blobs


def image_of(row: RoomSurface, blobs: Blobs) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(blobs[row.texture_blob])))


def pixel_points(row: RoomSurface, shape: tuple[int, ...], thickness: float = 0.0) -> np.ndarray:
    """Where the middles of an image's pixels lie in the room, shape (h, w, 3) [m]."""
    chart = chart_of(row, thickness)
    across, up = (np.arange(shape[1]) + 0.5) / shape[1] * chart.width, (1 - (np.arange(shape[0]) + 0.5) / shape[0]) * chart.height
    return chart.points(*np.meshgrid(across, up))[0]


def away(image: np.ndarray, row: RoomSurface, inside: float = 0.06) -> np.ndarray:
    """Color differences (CIEDE2000) from the truth of pixels well inside of the room, and away from the tiles' edges."""
    points = pixel_points(row, image.shape, INNER[4])
    difference = ciede2000(lab(image.reshape(-1, 3)), lab(painted_colors(points.reshape(-1, 3)))).reshape(image.shape[:2])
    low, high = np.array([inside, inside, 0.0]), np.array([WIDTH, DEPTH, HEIGHT]) - [inside, inside, 0.0]
    if row.surface.startswith(("wall", "inner")):
        low, high = np.array([0.0, 0.0, inside]), np.array([WIDTH, DEPTH, HEIGHT]) - [0.0, 0.0, inside]
        along = (points - np.array(row.origin)) @ np.array(row.u_axis)
        keep = (along > inside) & (along < row.width_m - inside)
    else:
        offset = np.minimum(points[..., :2] % TILE, TILE - points[..., :2] % TILE).min(axis=-1)
        keep = offset > 0.07 if row.surface == "floor" else np.ones(image.shape[:2], dtype=bool)
    keep &= (points >= low - 1e-9).all(axis=-1) & (points <= high + 1e-9).all(axis=-1)
    return difference[keep]


@pytest.fixture(scope="module")
def bare() -> tuple[dict[str, RoomSurface], Blobs]:
    return baked(room_surface())


@pytest.mark.whole
def test_every_surface_comes_back_in_its_colors(bare: tuple[dict[str, RoomSurface], Blobs]) -> None:
    rows, blobs = bare
    assert list(rows) == ["floor", "ceiling", "wall_00", "wall_01", "wall_02", "wall_03", "inner_00"]
    for row in rows.values():
        image = image_of(row, blobs)
        height, width = image.shape[:2]
        assert width & (width - 1) == 0
        assert height & (height - 1) == 0
        assert max(row.texel_m) <= 0.0201
        differences = away(image, row)
        assert len(differences) > 1000
        assert np.quantile(differences, 0.99) < 2.5, row.surface
        assert row.seen_share > 0.85
        assert sum(len(blobs[name]) for name in blobs) < 400_000


@pytest.mark.whole
def test_both_sides_of_an_inner_wall_are_seen_upright_and_not_mirrored() -> None:
    """Its left side is red at the bottom and green on top, its right one is blue and white; both are darker to the south."""
    surface = room_surface()
    x, y, z = surface.vertices.T
    half = INNER[4] / 2
    colors = surface.colors.copy()
    for side, (bottom, top) in ((INNER[0] - half, ((200, 0, 0), (0, 200, 0))), (INNER[0] + half, ((0, 0, 200), (200, 200, 200)))):
        own = (np.abs(x - side) < 1e-6) & (y >= INNER[1]) & (y <= INNER[3]) & (z <= INNER[5])
        shade = np.where(y > 2.0, 1.0, 0.5)[:, None]
        colors[own] = (np.where(z[:, None] > 1.0, top, bottom) * shade)[own].astype(np.uint8)
    rows, blobs = baked(dataclasses.replace(surface, colors=colors))
    shell = dict(textured(room_shell(the_room()), list(rows.values()), blobs))
    image, row = image_of(rows["inner_00"], blobs), rows["inner_00"]
    chart = chart_of(row, INNER[4])
    for side, bottom, top in ((-half, (200, 0, 0), (0, 200, 0)), (half, (0, 0, 200), (200, 200, 200))):
        for level, color in ((0.5, bottom), (1.5, top)):
            for place, shade in ((1.5, 0.5), (2.5, 1.0)):
                ((u, v),) = chart.places(np.array([[INNER[0] + side, place, level]]))
                pixel = image[int((1 - v) * image.shape[0]), int(u * image.shape[1])]
                assert np.abs(pixel - np.array(color) * shade).max() < 12, (side, level, place)
    assert np.ptp(np.asarray(shell["inner_00"].visual.uv)[:, 1]) > 0.9


@given(st.integers(0, 6), st.floats(0.02, 0.98), st.floats(0.02, 0.98))
@settings(max_examples=30, deadline=None)
def test_a_point_of_the_shell_has_the_pixel_of_that_point(which: int, across: float, up: float) -> None:
    """Whatever triangle of whatever piece it lies on, openings cut."""
    room = dataclasses.replace(the_room(), openings=((1.0, 0.0, 2.0, 0.0, 0.0, 2.0, 0.05), (WIDTH, 1.0, WIDTH, 2.0, 1.0, 2.0, 0.05)))
    name, chart = list(room_charts(room))[which]
    if name == "ceiling":
        return
    row = RoomSurface(
        scene_id=room.scene_id, surface=name, texture_blob="-", origin=tuple(chart.origin), u_axis=tuple(chart.u_axis),
        v_axis=tuple(chart.v_axis), width_m=chart.width, height_m=chart.height, texel_m=(0.02, 0.02), seen_share=1.0, color=(0, 0, 0),
    )  # fmt: skip
    out = io.BytesIO()
    Image.new("RGB", (8, 8)).save(out, format="JPEG")
    shell = textured(room_shell(room), [dataclasses.replace(row, texture_blob="a.jpg")], {"a.jpg": out.getvalue()})
    (point,), (normal,) = chart.points(np.array([across * chart.width]), np.array([up * chart.height]))
    hits = 0
    for part_name, part in shell:
        if not part_name.startswith(name) or part.visual.kind != "texture":
            continue
        origin = point + 1e-3 * normal
        for triangle, (a, b, c) in zip(part.faces, part.triangles, strict=True):
            facing = np.cross(b - a, c - a)
            facing = facing / np.linalg.norm(facing)
            if abs((origin - a) @ facing - 1e-3) > 1e-6 or facing @ normal < 0.99:
                continue
            weights = trimesh.triangles.points_to_barycentric(np.array([[a, b, c]]), point[None])[0]
            if (weights > -1e-9).all():
                hits += 1
                np.testing.assert_allclose(weights @ part.visual.uv[triangle], (across, up), atol=1e-6)
    # on an edge it is of two
    is_cut = name == "wall_00" and 1.0 < point[0] < 2.0 and point[2] < 2.0
    is_cut |= name == "wall_01" and 1.0 < point[1] < 2.0 and 1.0 < point[2] < 2.0
    is_outside = name == "floor" and not (0 <= point[0] <= WIDTH and 0 <= point[1] <= DEPTH)
    assert hits or is_cut or is_outside


@pytest.mark.whole
def test_furniture_leaves_no_color_on_the_floor() -> None:
    """A green box hides a part of the floor; the faces around its foot have a part of its color, as fused scans have."""
    surface = room_surface(step=0.02)
    x, y, z = surface.vertices.T
    foot = (np.abs(x - 3.7) < 0.51) & (np.abs(y - 2.0) < 0.41) & (z < 0.01)
    rim = (np.abs(x - 3.7) < 0.53) & (np.abs(y - 2.0) < 0.43) & (z < 0.01) & ~foot
    colors = surface.colors.copy()
    colors[foot] = (0, 250, 0)
    colors[rim] = (colors[rim] // 2 + np.array([0, 125, 0])).astype(np.uint8)
    kinds = np.full(len(surface.faces), STRUCTURE, dtype=np.int8)
    kinds[foot[surface.faces].any(axis=1)] = OBJECT
    rows, blobs = baked(dataclasses.replace(surface, colors=colors), kinds)
    image = image_of(rows["floor"], blobs).astype(int)
    assert (image[..., 1] - image[..., 0]).max() < 10
    plain, _ = baked(surface)
    assert rows["floor"].seen_share < plain["floor"].seen_share - 0.03
    points = pixel_points(rows["floor"], image.shape)
    under = (np.abs(points[..., 0] - 3.7) < 0.5) & (np.abs(points[..., 1] - 2.0) < 0.4)
    assert image[under].min(axis=0) == pytest.approx([90, 60, 40], abs=60)
    assert image[under].std(axis=0).max() < 60
    assert (image[under] >= [70, 40, 20]).all()
    assert (image[under] <= [235, 215, 180]).all()


@pytest.mark.whole
def test_what_nothing_calls_a_floor_counts_only_where_the_floor_is() -> None:
    surface = room_surface()
    lifted = Surface(surface.vertices + np.array([0.0, 0.0, 0.05]), surface.faces, surface.colors)
    kinds = np.full(len(surface.faces), LOOSE, dtype=np.int8)
    assert "floor" in baked(surface, kinds)[0]
    assert "floor" not in baked(lifted, kinds)[0]
    assert "floor" in baked(lifted)[0]
    assert baked(surface, np.full(len(surface.faces), OBJECT, dtype=np.int8))[0] == {}


@given(st.integers(0, 2**32 - 1), st.sampled_from([(8, 8), (32, 8), (16, 64)]), st.floats(0.01, 0.9))
@settings(max_examples=40, deadline=None)
def test_what_is_filled_in_lies_between_what_was_seen_and_leaves_it_alone(seed: int, shape: tuple[int, int], share: float) -> None:
    rng = np.random.default_rng(seed)
    colors = rng.integers(0, 256, (*shape, 3)).astype(np.float32)
    seen = rng.random(shape) < share
    seen.flat[int(rng.integers(seen.size))] = True
    image = filled(colors, seen)
    np.testing.assert_array_equal(image[seen], colors[seen])
    assert (image >= colors[seen].min(axis=0)).all()
    assert (image <= colors[seen].max(axis=0)).all()


def test_what_is_filled_in_is_like_what_lies_nearest() -> None:
    """Half an image is red and half is blue, with a hole in each: no hole takes the other half's color."""
    colors = np.zeros((64, 128, 3), dtype=np.float32)
    colors[:, :64, 0], colors[:, 64:, 2] = 200, 200
    seen = np.ones((64, 128), dtype=bool)
    seen[20:40, 20:40], seen[20:40, 90:110] = False, False
    image = filled(colors, seen)
    assert (np.abs(image.astype(int) - colors) <= 1).all()
    ramp = np.tile(np.linspace(0, 255, 128, dtype=np.float32)[None, :, None], (64, 1, 3))
    smooth = filled(ramp, seen).astype(int)
    assert np.abs(np.diff(smooth, axis=1)).max() < 16, "no edges where it was filled in"


@pytest.mark.whole
def test_too_little_of_a_surface_is_no_image() -> None:
    surface = room_surface()
    few = surface.vertices[surface.faces].mean(axis=1)
    kinds = np.where((few[:, 2] < 0.01) & (few[:, 0] > 0.5), OBJECT, STRUCTURE).astype(np.int8)
    assert "floor" in baked(surface, kinds)[0]
    assert "floor" not in baked(surface, kinds, config=TextureConfig(min_seen=0.2))[0]


def test_a_coarse_mesh_has_no_holes_between_its_vertices() -> None:
    rows, blobs = baked(room_surface(step=0.1))
    assert rows["wall_00"].seen_share > 0.85
    assert np.quantile(away(image_of(rows["wall_00"], blobs), rows["wall_00"], inside=0.15), 0.99) < 2.5


@pytest.mark.whole
def test_the_same_scan_gives_the_same_bytes(bare: tuple[dict[str, RoomSurface], Blobs]) -> None:
    assert baked(room_surface())[0] == bare[0]


def repainted(room: FurnishedRoom) -> FurnishedRoom:
    """A room whose floor has tiles and whose walls go from dark to light."""
    structure = []
    for name, mesh in room.structure:
        fine = mesh.subdivide_to_size(0.05, max_iter=20) if "|ceiling|" not in name else mesh.copy()
        if "|floor|" in name or "|wall|" in name:
            x, y, z = np.asarray(fine.vertices).T
            dark = ((np.floor(x / TILE) + np.floor(y / TILE)) % 2 == 0)[:, None]
            colors = (
                np.where(dark, [110, 70, 40], [215, 195, 160])
                if "|floor|" in name
                else np.column_stack([90 + 50 * z, 150 + 0 * z, 200 - 40 * z])
            )
            look = np.column_stack([colors, np.full(len(colors), 255)]).astype(np.uint8)
            fine.visual = trimesh.visual.ColorVisuals(fine, vertex_colors=look)
        structure.append((name, fine))
    return dataclasses.replace(room, structure=structure)


@pytest.mark.slow
@pytest.mark.whole
def test_a_scanned_room_has_the_tiles_and_walls_that_it_had(tmp_path: Path) -> None:
    """The virtual scanner walks through a furnished room: light and noise of its camera are a part of what comes back."""
    room = repainted(furnish("bedroom", np.random.default_rng(7), object_count=10))
    config = ScannerConfig(voxel_m=0.03, view_limit=60, segment_least=12)
    scan_scene(room, tmp_path, "scene0000_00", config, np.random.default_rng(1))
    (scan,), _ = find_scans(tmp_path)
    outcomes = [run(scan=scan, context=Context(scan.scene_id, "capture", 0, Blobs()), config=CaptureConfig()) for _ in range(2)]
    rows = {row.surface: row for row in outcomes[0].rows["surfaces"]}
    assert outcomes[1].rows["surfaces"] == outcomes[0].rows["surfaces"]
    floor = rows["floor"]
    image = image_of(floor, outcomes[0].blobs)
    points = pixel_points(floor, image.shape)
    (own,) = [row for row in outcomes[0].rows["instances"] if row.category == "floor"]
    scanned, colors = read_points(outcomes[0].blobs[own.points_blob])
    offset = np.minimum(points[..., :2] % TILE, TILE - points[..., :2] % TILE).min(axis=-1)
    apart, nearest = cKDTree(scanned[:, :2]).query(points[..., :2].reshape(-1, 2))
    seen = (apart < 0.02) & (offset.ravel() > 0.08)
    dark = ((np.floor(points[..., 0] / TILE) + np.floor(points[..., 1] / TILE)) % 2 == 0).ravel()
    true = np.where(dark[:, None], DARK, LIGHT)
    away_from_scan = ciede2000(lab(image.reshape(-1, 3)[seen]), lab(colors[nearest[seen]]))
    away_from_truth = ciede2000(lab(image.reshape(-1, 3)[seen]), lab(true[seen]))
    assert seen.sum() > 1000
    assert np.quantile(away_from_scan, 0.5) < 1.0
    assert np.quantile(away_from_scan, 0.9) < 6.0, "round what hides the floor its colors are not the scan's"
    assert np.quantile(away_from_truth, 0.5) < 5.0, "the camera's exposure is a part of it"
    assert np.quantile(away_from_truth, 0.9) < 8.0
