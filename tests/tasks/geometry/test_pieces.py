"""Convex pieces, mass properties, shading, GLB surgery, and the room's shell."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.containers import close_glb, open_glb
from tasks.exports.gltf import node_textures, scaled_glb
from tasks.furniture import generate
from tasks.geometry.colors import linear_of_bytes
from tasks.geometry.hulls import REDUCED, hull_of, is_within
from tasks.geometry.mass import mass_properties
from tasks.geometry.meshes import canonical, dump_glb, load_glb, surface_of
from tasks.geometry.pieces import PieceConfig, Uncut, _cached, asset_pieces, convex_hull, cut_ahead, pieces
from tasks.geometry.triangles import corner_normals
from tasks.replica import scaled_parts
from tasks.shell import floor_ring, room_shell
from tests.replicas import ROOM, room_of

CONFIG = PieceConfig()
sizes = st.floats(0.05, 3.0)


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return mesh


def as_trimesh(hull: object) -> trimesh.Trimesh:
    return trimesh.Trimesh(hull.vertices, hull.faces, process=False)  # type: ignore[attr-defined]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(4, 300), st.tuples(sizes, sizes, st.floats(0.0, 1.0)))
def test_hulls_are_closed_convex_and_small(seed: int, count: int, size: tuple[float, float, float]) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 3)) * size
    hull = convex_hull(points, CONFIG)
    mesh = as_trimesh(hull)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert hull.volume > 0
    assert is_within(hull, REDUCED)
    assert mesh.convex_hull.volume == pytest.approx(hull.volume, rel=1e-6, abs=1e-12)
    whole = hull_of(points) if size[2] > 0.01 else None
    if whole is not None and is_within(whole, REDUCED):
        assert whole.volume == pytest.approx(hull.volume, rel=1e-6)


def test_pieces_of_furniture_stay_inside_the_box_and_cover_the_volume() -> None:
    rng = np.random.default_rng(0)
    for category in ("chair", "table", "mug", "bookshelf", "picture", "rug", "lamp", "bottle", "ball"):
        model = generate(category, None, rng)
        made = pieces(model.parts, model.pieces, CONFIG)
        bounds = surface_of(model.parts).bounds
        points = np.concatenate([hull.vertices for hull in made.hulls])
        thin = np.ptp(bounds, axis=0) < CONFIG.thickness_m
        slack = np.where(thin, CONFIG.thickness_m, 1e-9)
        assert made.method == "generator"
        assert (points.min(axis=0) >= bounds[0] - slack).all(), category
        assert points[:, 2].min() >= bounds[0, 2] - 1e-9, f"{category}: nothing reaches below what carries it"
        assert (points.max(axis=0) <= bounds[1] + slack).all(), category
        assert all(is_within(hull, REDUCED) for hull in made.hulls)
        assert max(made.shares) <= 0.02, f"{category}: {made.shares}"
        known = sum(piece.convex_hull.volume for piece in model.pieces)
        assert sum(hull.volume for hull in made.hulls) == pytest.approx(known, rel=0.12), category


def test_convex_parts_need_no_decomposition() -> None:
    parts = [box((1, 1, 0.1), (0, 0, 0.95)), *(box((0.1, 0.1, 0.9), (x, y, 0.45)) for x in (-0.4, 0.4) for y in (-0.4, 0.4))]
    made = pieces(parts, None, CONFIG)
    assert made.method == "hulls"
    assert len(made.hulls) == 5
    assert mass_properties(made.hulls).volume == pytest.approx(0.1 + 4 * 0.009)


def test_a_flat_picture_gets_a_body_that_does_not_reach_down() -> None:
    plane = trimesh.Trimesh([[0, -0.5, 0], [0, 0.5, 0], [0, 0.5, 0.6], [0, -0.5, 0.6]], [[0, 1, 2], [0, 2, 3]], process=False)
    made = pieces([plane], None, CONFIG)
    points = np.concatenate([hull.vertices for hull in made.hulls])
    assert points[:, 2].min() >= 0.0
    assert np.ptp(points[:, 0]) == pytest.approx(CONFIG.thickness_m)
    assert mass_properties(made.hulls).volume > 0
    mat = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    heights = np.concatenate([hull.vertices for hull in pieces([mat], None, CONFIG).hulls])[:, 2]
    assert heights.min() >= 0.0
    assert np.ptp(heights) > 0.0


def unasked() -> list[trimesh.Trimesh]:
    raise AssertionError("the mesh was asked for though its pieces are known")


def test_dented_objects_are_decomposed_the_same_way_every_time() -> None:
    ell = trimesh.creation.extrude_polygon(__import__("shapely").Polygon([(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)]), 0.3)
    first, second = pieces([ell], None, CONFIG), pieces([ell], None, CONFIG)
    assert first.method == "cut"
    assert len(first.hulls) == 2
    assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(first.hulls, second.hulls, strict=True))
    assert mass_properties(first.hulls).volume == pytest.approx(ell.volume, rel=0.03)
    once = asset_pieces("x" * 64, lambda: [ell], None, CONFIG)
    assert asset_pieces("x" * 64, unasked, None, CONFIG) is once, "the second time from memory"


def test_overlapping_hulls_count_once() -> None:
    one = pieces([box((1, 1, 1))], [box((1, 1, 1))], CONFIG)
    two = pieces([box((1.5, 1, 1), (0.25, 0, 0))], [box((1, 1, 1)), box((1, 1, 1), (0.5, 0, 0))], CONFIG)
    assert mass_properties(one.hulls).volume == pytest.approx(1.0)
    together = mass_properties(two.hulls)
    assert len(two.hulls) == 2
    assert together.volume == pytest.approx(1.5)
    np.testing.assert_allclose(together.center, [0.25, 0, 0], atol=1e-9)
    assert together.inertia[0, 0] == pytest.approx(1.5 * (1 + 1) / 12)
    inner = pieces([box((1, 1, 1))], [box((1, 1, 1)), box((0.5, 0.5, 0.5))], CONFIG)
    assert len(inner.hulls) == 1, "a hull inside another one is no obstacle"


@given(st.tuples(sizes, sizes, sizes), st.tuples(sizes, sizes, sizes))
@settings(max_examples=40, deadline=None)
def test_scaling_hulls_scales_their_volume(size: tuple[float, float, float], scale: tuple[float, float, float]) -> None:
    hull = convex_hull(np.asarray(box(size).vertices), CONFIG)
    grown = hull.transformed(np.eye(4), scale)
    assert grown.volume == pytest.approx(hull.volume * np.prod(scale), rel=1e-9)
    assert as_trimesh(grown).is_watertight


def test_normals_are_smooth_on_a_ball_and_flat_on_a_box() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    normals = corner_normals(np.asarray(ball.vertices), np.asarray(ball.faces), 0.6)
    np.testing.assert_allclose(normals, np.asarray(ball.vertices)[ball.faces], atol=0.02)
    cube = box((1, 1, 1))
    flat = corner_normals(np.asarray(cube.vertices), np.asarray(cube.faces), 0.6)
    np.testing.assert_allclose(flat, np.repeat(cube.face_normals[:, None], 3, axis=1), atol=1e-12)
    assert np.allclose(np.linalg.norm(normals, axis=2), 1.0)


def test_colors_become_linear() -> None:
    found = linear_of_bytes(np.array([[0, 128, 255]], dtype=np.uint8))[0]
    np.testing.assert_allclose(found, [0.0, 0.21586, 1.0], atol=1e-4)


@given(st.tuples(sizes, sizes, sizes))
@settings(max_examples=25, deadline=None)
def test_a_scaled_glb_is_the_scaled_asset(scale: tuple[float, float, float]) -> None:
    glb = dump_glb([box((0.4, 0.6, 0.8), (0.1, 0.0, 0.4)), box((0.2, 0.2, 0.2), (0, 0.3, 0.9))])
    scaled = surface_of(load_glb(scaled_glb(glb, scale)))
    np.testing.assert_allclose(scaled.vertices, surface_of(scaled_parts(glb, scale)).vertices, atol=1e-6)
    assert open_glb(scaled_glb(glb, scale))[1] == open_glb(glb)[1], "geometry stays byte for byte"


def test_glb_containers_open_and_close() -> None:
    glb = dump_glb([box((1, 1, 1))])
    document, binary = open_glb(glb)
    assert open_glb(close_glb(document, binary)) == (document, binary)
    assert trimesh.load_scene(io.BytesIO(close_glb(document, binary)), file_type="glb").geometry
    for wrong in (b"", b"glTF", glb[:11], b"x" + glb[1:], glb[:40]):
        with pytest.raises(InputError):
            open_glb(wrong)


def test_textures_are_found_by_node(realdata: Callable[[str], Path]) -> None:
    from PIL import Image

    for name in ("aws_Bed_01", "aws_KitchenTable_01"):
        data = (realdata("assets") / f"{name}.glb").read_bytes()
        parts = {part.metadata["name"]: part for part in load_glb(data)}
        images = node_textures(data)
        assert set(images) <= set(parts)
        assert images
        for node, (encoded, extension) in images.items():
            image = Image.open(io.BytesIO(encoded))
            assert image.format == {"png": "PNG", "jpg": "JPEG"}[extension]
            assert image.size == parts[node].visual.material.baseColorTexture.size


@pytest.mark.slow
def test_library_models_get_pieces(realdata: Callable[[str], Path]) -> None:
    for name in ("aws_Ball_01", "aws_ShoeRack_01", "aws_KitchenTable_01", "aws_ChairD_01", "aws_PortraitA_01"):
        parts = canonical(load_glb((realdata("assets") / f"{name}.glb").read_bytes()))
        made = pieces(parts, None, CONFIG)
        bounds = surface_of(parts).bounds
        points = np.concatenate([hull.vertices for hull in made.hulls])
        slack = CONFIG.thickness_m
        assert points[:, 2].min() >= bounds[0, 2] - 1e-9
        assert (np.abs([points.min(axis=0), points.max(axis=0)] - bounds) < np.maximum(0.03 * np.ptp(bounds, axis=0), slack)).all(), name


# ---- the room's shell


@st.composite
def polygons(draw: st.DrawFn) -> list[tuple[float, float]]:
    """Simple polygons: a star around a point."""
    count = draw(st.integers(3, 10))
    turns = np.sort(draw(st.lists(st.floats(0, 6.2), min_size=count, max_size=count, unique_by=lambda t: round(t, 1))))
    radii = draw(st.lists(st.floats(0.5, 5), min_size=count, max_size=count))
    return [(r * np.cos(t), r * np.sin(t)) for t, r in zip(turns, radii, strict=True)]


@pytest.mark.whole
@settings(max_examples=150, deadline=None)
@given(polygons())
def test_shells_are_closed_and_leave_the_room_free(polygon: list[tuple[float, float]]) -> None:
    import shapely

    room = room_of(polygon=polygon)
    try:
        shell = room_shell(room)
    except InputError:
        assert not shapely.Polygon(polygon).is_valid or shapely.Polygon(polygon).area <= 1e-4
        return
    ring = shapely.Polygon(floor_ring(room))
    assert [name for name, _ in shell[:2]] == ["floor", "wall_00"]
    assert len(shell) == 1 + len(ring.exterior.coords) - 1
    for name, mesh in shell:
        assert mesh.is_volume, name
        assert mesh.volume > 0, name
        if name == "floor":
            assert mesh.bounds[1, 2] == 0.0
            continue
        assert mesh.is_convex
        footprint = shapely.MultiPoint(np.asarray(mesh.vertices)[:, :2]).convex_hull
        assert footprint.intersection(ring).area < 1e-6, "walls stand outside"
        assert mesh.bounds[0, 2] == 0.0
        assert mesh.bounds[1, 2] == pytest.approx(room.height_m)


@pytest.mark.parametrize("polygon", [[], [(0, 0), (1, 0)], [(0, 0), (1, 0), (2, 0)], [(0, 0), (1, 1), (1, 0), (0, 1)]])
def test_rooms_without_a_floor_are_refused(polygon: list[tuple[float, float]]) -> None:
    with pytest.raises(InputError, match="floor_polygon"):
        room_shell(room_of(polygon=polygon))


def test_the_direction_of_the_polygon_does_not_matter() -> None:
    there, back = (room_shell(room_of(polygon=p)) for p in (ROOM, ROOM[::-1]))
    assert sum(mesh.volume for _, mesh in there) == pytest.approx(sum(mesh.volume for _, mesh in back))


def test_pieces_out_of_the_cache_are_those_that_went_in() -> None:
    ell = trimesh.util.concatenate([trimesh.creation.box((1, 0.2, 0.2)), trimesh.creation.box((0.2, 0.2, 1))])
    cache: dict[str, bytes] = {}
    first = _cached("y" * 64, lambda: [ell], None, CONFIG, cache)
    assert len(cache) == 1
    again = _cached("y" * 64, unasked, None, CONFIG, cache)
    assert first.method == again.method == pieces([ell], None, CONFIG).method
    assert first.shares == again.shares
    assert first.properties.volume == again.properties.volume
    assert np.array_equal(first.properties.center, again.properties.center)
    assert np.array_equal(first.properties.inertia, again.properties.inertia)
    _cached("y" * 64, lambda: [ell], lambda: [ell], CONFIG, cache)
    assert len(cache) == 2, "pieces from construction are others"
    for a, b, c in zip(first.hulls, again.hulls, pieces([ell], None, CONFIG).hulls, strict=True):
        assert np.array_equal(a.vertices, b.vertices)
        assert np.array_equal(a.vertices, c.vertices)
        assert np.array_equal(a.faces, c.faces)


def test_pieces_cut_ahead_are_those_cut_when_asked_for() -> None:
    ell = trimesh.util.concatenate([box((1, 0.2, 0.2)), box((0.2, 0.2, 1))])
    glb, own = dump_glb([ell], ["ell"]), dump_glb([box((1, 0.2, 0.2)), box((0.2, 0.2, 1))], ["a", "b"])

    def gone() -> tuple[bytes, bytes | None]:
        raise KeyError("blob")

    def damaged() -> tuple[bytes, bytes | None]:
        raise InputError("blobs/ab", "", "does not have the content that its name says", "restore it")

    def aside(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        return [pickle.loads(pickle.dumps(function(pickle.loads(pickle.dumps(item))))) for item in items]

    ahead: dict[str, bytes] = {}
    assets = [
        Uncut("c" * 64, lambda: (glb, None), False, "c.glb"),
        Uncut("d" * 64, lambda: (glb, own), True, "d.glb"),
        Uncut("e" * 64, gone, False, "e.glb"),
        Uncut("f" * 64, lambda: (b"no GLB", None), False, "f.glb"),
        Uncut("0" * 64, damaged, False, "0.glb"),
    ]
    cut_ahead(assets, CONFIG, ahead, aside)
    asked: dict[str, bytes] = {}
    _cached("c" * 64, lambda: load_glb(glb), None, CONFIG, asked)
    _cached("d" * 64, lambda: load_glb(glb), lambda: load_glb(own), CONFIG, asked)
    assert ahead == asked
    cut_ahead(assets[:2], CONFIG, ahead, lambda function, items: [unasked() for _ in items])


@pytest.mark.parametrize("points", [[[0, 0, 0]] * 3, [[0, 0, 0], [1e-7, 0, 0], [0, 1e-7, 0]], [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]]])
def test_what_has_no_surface_gets_a_body(points: list[list[float]]) -> None:
    made = pieces([trimesh.Trimesh(points, [[0, 1, 2]], process=False)], None, CONFIG)
    cloud = np.concatenate([hull.vertices for hull in made.hulls])
    reach = np.maximum(np.ptp(np.asarray(points, dtype=float), axis=0), CONFIG.thickness_m)
    assert (np.ptp(cloud, axis=0) <= reach + 1e-9).all()
    assert cloud[:, 2].min() >= 0.0
    assert 0.0 < made.properties.volume <= reach.prod() * (1 + 1e-6)


@given(scale=st.tuples(*[st.floats(0.2, 5.0)] * 3), seed=st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_stretched_mass_properties_are_those_of_the_stretched_solid(scale: tuple[float, float, float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    hulls = [convex_hull(rng.normal(size=(12, 3)) * 0.3 + rng.uniform(-0.2, 0.2, 3), CONFIG) for _ in range(2)]
    found = mass_properties(hulls).scaled(scale)
    expected = mass_properties([hull.transformed(np.eye(4), scale) for hull in hulls])
    assert found.volume == pytest.approx(expected.volume, rel=1e-6)
    assert np.allclose(found.center, expected.center, atol=1e-6)
    assert np.allclose(found.inertia, expected.inertia, rtol=1e-5, atol=1e-7)
