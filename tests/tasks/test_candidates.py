"""Candidates: closing of scan crops, convex pieces, library retrieval, the ten slots."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from flows.run.fingerprints import FileHashes
from flows.run.plan import _library_hash
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.record import check
from tasks import captions
from tasks.candidates import STAGE, CandidatesConfig, SlotConfig, closing, run
from tasks.candidates.assets import MAX_FACES, make_asset
from tasks.candidates.closing import solid_field
from tasks.candidates.cutting import hull_area
from tasks.candidates.descriptors import Descriptor, describe, extents_similarity, shape_similarity, similarity
from tasks.candidates.library import LibraryRetrieval, category_of, index_library, library_asset, library_files
from tasks.candidates.procedural import Procedural, fronted_extents
from tasks.candidates.retrieval import category_similarity, retrieve
from tasks.candidates.scan_crop import ScanCrop, closed_crop, pieces_of_crop
from tasks.furniture import generate
from tasks.geometry.meshes import Surface, dump_glb, dump_points, load_glb, sample_surface, surface_of
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import flat, transform_points, yaw_pose
from tasks.stage import Blobs, Context, Outcome, in_turn
from tests import attacks

Array = NDArray[np.float64]
OPEN_BACK, OPEN_BOTTOM = "back", "bottom"


def crop_of_parts(
    parts: list[trimesh.Trimesh], seed: int = 0, hidden: tuple[str, ...] = (OPEN_BACK, OPEN_BOTTOM), noise: float = 0.003
) -> Surface:
    """What a scan has of parts: triangles of 3 cm, noisy vertices, nothing from within, no faces that look back (-x) or down."""
    surface = surface_of(parts)
    vertices, faces = trimesh.remesh.subdivide_to_size(surface.vertices, surface.faces, 0.03)
    rng = np.random.default_rng(seed)
    samples, paint, _ = sample_surface(surface, 4000, rng)
    from scipy.spatial import cKDTree

    colors = paint[cKDTree(samples).query(vertices)[1]]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    seen = is_visible(surface, (a + b + c) / 3, normal)
    if OPEN_BACK in hidden:
        seen &= normal[:, 0] > -0.7
    if OPEN_BOTTOM in hidden:
        seen &= normal[:, 2] > -0.7
    used = np.unique(faces[seen])
    number = np.full(len(vertices), -1)
    number[used] = np.arange(len(used))
    return Surface(vertices[used] + rng.normal(0, noise, (len(used), 3)), number[faces[seen]], colors[used])


def is_visible(surface: Surface, centers: Array, normals: Array) -> NDArray[np.bool_]:
    """Whether anything outside sees faces with these centers (n, 3) and normals (n, 3): one of 60 directions is free."""
    from tasks.geometry.rendering import RayScene

    scene = RayScene([surface.to_trimesh()])
    visible = np.zeros(len(centers), dtype=bool)
    for direction in trimesh.creation.icosphere(subdivisions=1).vertices:
        asked = np.flatnonzero(~visible & (normals @ direction > 0.15))
        rays = np.column_stack([centers[asked] + 1e-3 * normals[asked], np.tile(direction, (len(asked), 1))])
        visible[asked] = ~np.isfinite(scene.cast(rays.astype(np.float32))["t_hit"])
    return visible


def scanned(number: int, category: str, parts: list[trimesh.Trimesh], yaw: float, **changes: object) -> tuple[Instance, dict[str, bytes]]:
    """An instance of parts (canonical frame) that stand at some place in the world, turned by `yaw`."""
    extents = np.ptp(surface_of(parts).bounds, axis=0)
    position = np.array([1.0 + number, 2.0, 0.0])
    world = crop_of_parts(parts, number).transformed(yaw_pose(yaw, position))
    points, colors, _ = sample_surface(world, 1500, np.random.default_rng(number))
    files = Blobs()
    values = {
        "scene_id": "test/room", "instance_id": f"{number:04d}", "source_id": str(number), "raw_label": category,
        "category": category, "nyu40_id": 0, "nyu40_label": "unlabeled", "is_structure": False,
        "box_pose": flat(yaw_pose(yaw, position + np.array([0, 0, extents[2] / 2]))), "box_size": tuple(map(float, extents)),
        "box_volume_m3": float(np.prod(extents)), "hidden_m": None,
        "point_count": len(points), "points_blob": files.add(dump_points(points, colors), "ply"),
        "mesh_blob": files.add(dump_glb([world.to_trimesh()]), "glb"), "view_blob": None, "best_frames": (), "room_index": None,
    }  # fmt: skip
    return Instance(**{**values, **changes}), dict(files)  # type: ignore[arg-type]


def furniture(
    number: int, category: str, extents: tuple[float, float, float], yaw: float, **changes: object
) -> tuple[Instance, dict[str, bytes]]:
    return scanned(number, category, generate(category, extents, np.random.default_rng(number)).parts, yaw, **changes)


Spread = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]


def candidates_of(
    *pairs: tuple[Instance, dict[str, bytes]],
    library: Path | None = None,
    config: CandidatesConfig | None = None,
    seed: int = 3,
    spread: Spread = in_turn,
) -> Outcome:
    blobs = {name: data for _, files in pairs for name, data in files.items()}
    instances = [instance for instance, _ in pairs]
    words = captions.run(instances=instances, context=Context("test/room", "captions", seed, blobs), config=captions.CaptionsConfig())
    context = Context("test/room", "candidates", seed, blobs, spread=spread)
    outcome = run(
        instances=instances, captions=words.rows["captions"], library=library, context=context, config=config or CandidatesConfig()
    )
    check(outcome.rows["candidates"], Candidate)
    check(outcome.rows["assets"], Asset)
    return outcome


def cabinet_parts(extents: tuple[float, float, float]) -> list[trimesh.Trimesh]:
    box = trimesh.creation.box(extents)
    box.apply_translation([0, 0, extents[2] / 2])
    box.visual.vertex_colors = [150, 100, 60, 255]
    return [box]


def signed_distance(mesh: trimesh.Trimesh, points: Array) -> Array:
    """Distance of points (n, 3) to a closed mesh [m], negative inside; shape (n,)."""
    from tasks.geometry.proximity import closest_points
    from tasks.geometry.rendering import RayScene

    # Of three directions through no edge of the grid, most must meet a back first.
    directions = np.array([[0.31, 0.22, 0.92], [-0.83, 0.41, 0.37], [0.27, -0.9, -0.34]])
    votes = np.zeros(len(points), dtype=int)
    for direction in directions:
        hits = RayScene([mesh]).cast(np.column_stack([points, np.tile(direction, (len(points), 1))]).astype(np.float32))
        votes += np.isfinite(hits["t_hit"]) & (hits["primitive_normals"] @ direction > 0)
    return np.where(votes >= 2, -1.0, 1.0) * closest_points(mesh.vertices, mesh.faces, points).distance


# Closing


@pytest.mark.parametrize("extents", [(0.45, 0.8, 0.9), (0.6, 1.2, 2.0), (0.3, 0.4, 0.3), (2.0, 1.5, 0.5)])
def test_a_cabinet_seen_from_the_front_becomes_a_solid_box(extents: tuple[float, float, float]) -> None:
    crop = crop_of_parts(cabinet_parts(extents))
    mesh = closed_crop(crop, solid_field(crop))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert np.allclose(mesh.bounds, crop.bounds, atol=0.004)
    assert mesh.bounds[0][2] <= 0.004
    assert 0.85 < mesh.volume / np.prod(np.ptp(crop.bounds, axis=0)) < 1.01


@pytest.mark.parametrize("category", ["sofa", "bookshelf", "chair"])
def test_nodes_that_cast_no_further_rays_could_not_have_been_inside(category: str) -> None:
    model = generate(category, None, np.random.default_rng(3))
    crop = crop_of_parts(model.parts)
    scene = RayScene([crop.to_trimesh()])
    low, high = crop.bounds
    nodes = np.random.default_rng(0).uniform(low - 0.1, high + 0.1, (1500, 3)).astype(np.float32)
    backs, above, fronts = np.zeros((3, len(nodes)))
    for direction in closing._DIRECTIONS:
        hits = scene.cast(np.concatenate([nodes, np.tile(direction, (len(nodes), 1))], axis=1))
        met, leaving = np.isfinite(hits["t_hit"]), hits["primitive_normals"] @ direction > 0
        backs += met & leaving
        above += met & leaving & (direction[2] >= 0)
        fronts += met & ~leaving
    upward = (closing._DIRECTIONS[:, 2] >= 0).sum()
    closed_in = (backs >= closing.INSIDE_SHARE * 14) | (above >= closing.INSIDE_SHARE_ABOVE * upward)
    expected = closed_in & (fronts <= closing.FRONT_SHARE * 14)
    assert np.array_equal(closing._inside(scene, nodes), expected)
    assert 0.02 < expected.mean() < 0.9


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


# Pieces


@pytest.mark.whole
@pytest.mark.parametrize("category", ["chair", "table", "bookshelf", "bed"])
def test_pieces_are_convex_few_and_make_up_the_surface(category: str) -> None:
    model = generate(category, None, np.random.default_rng(2))
    crop = crop_of_parts(model.parts, hidden=(OPEN_BOTTOM,))
    field = solid_field(crop)
    surface, pieces = pieces_of_crop(crop, field)
    assert 1 <= len(pieces) <= 40
    assert surface.is_watertight
    for piece in pieces:
        assert piece.is_volume
        assert piece.convex_hull.volume == pytest.approx(piece.volume, rel=1e-4)
    corners = np.concatenate([piece.vertices for piece in pieces])
    assert np.allclose([corners.min(axis=0), corners.max(axis=0)], surface.bounds, atol=1e-6)
    # The union is no smaller than the solid and does not fill its box.
    closed = closed_crop(crop, field)
    assert surface.volume > 0.6 * closed.volume
    points, _, _ = sample_surface(crop, 1000, np.random.default_rng(0))
    distance = np.abs(signed_distance(surface, points))
    assert np.percentile(distance, 90) < 2.5 * field.step


def test_a_corner_sofa_is_cut_not_filled() -> None:
    parts = [trimesh.creation.box(bounds=[[-1, -1, 0], [1, -0.2, 0.6]]), trimesh.creation.box(bounds=[[-1, -0.2, 0], [-0.2, 1, 0.6]])]
    crop = crop_of_parts(parts, hidden=(OPEN_BOTTOM,))
    surface, pieces = pieces_of_crop(crop, solid_field(crop))
    assert len(pieces) >= 2
    assert surface.volume < 0.75 * 2 * 2 * 0.6
    assert signed_distance(surface, np.array([[0.6, 0.6, 0.3]]))[0] > 0.3


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 7), st.integers(0, 1), st.integers(0, 6))
def test_hulls_of_cells_have_the_area_that_shapely_says(seed: int, rows: int, columns: int, axis: int, position: int) -> None:
    import shapely
    from scipy.ndimage import label

    plan = np.random.default_rng(seed).random((rows, columns)) < 0.6
    side = np.zeros(plan.shape, dtype=bool)
    np.moveaxis(side, axis, 0)[:position] = True
    expected = 0.0
    for half in (plan & side, plan & ~side):
        bodies, count = label(half)
        for index in range(1, count + 1):
            expected += shapely.union_all([shapely.box(i, j, i + 1, j + 1) for i, j in np.argwhere(bodies == index)]).convex_hull.area
    assert hull_area(plan, axis, position) == pytest.approx(expected)


# Descriptors and retrieval


def chair_points(seed: int, category: str = "chair") -> tuple[Array, NDArray[np.uint8]]:
    parts = generate(category, (0.5, 0.5, 0.95), np.random.default_rng(1)).parts
    points, colors, _ = sample_surface(surface_of(parts), 1500, np.random.default_rng(seed))
    return points, colors


@settings(max_examples=15, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(0.3, 3.0), st.integers(0, 5))
def test_shape_does_not_change_with_yaw_place_and_size(yaw: float, scale: float, seed: int) -> None:
    points, colors = chair_points(seed)
    one = describe(points, colors, np.ptp(points, axis=0), np.random.default_rng(seed))
    moved = transform_points(points * scale, yaw_pose(yaw, (3, -2, 1)))
    other = describe(moved, colors, np.ptp(moved, axis=0), np.random.default_rng(seed))
    assert shape_similarity(one, other) > 0.99
    assert similarity(one.colors, other.colors) == pytest.approx(1)


histograms = st.lists(st.floats(0, 10), min_size=6, max_size=6).filter(lambda v: sum(v) > 0.1).map(lambda v: np.array(v) / sum(v))
sizes = st.tuples(*[st.floats(0.01, 4)] * 3)


@given(histograms, histograms)
def test_similarity_is_a_similarity(one: Array, other: Array) -> None:
    assert 0 <= similarity(one, other) <= 1
    assert similarity(one, other) == pytest.approx(similarity(other, one), abs=1e-7)
    assert similarity(one, one) == pytest.approx(1, abs=1e-6)


@given(sizes, sizes)
def test_extents_similarity_ignores_which_side_is_x(one: tuple[float, ...], other: tuple[float, ...]) -> None:
    value = extents_similarity(one, other)
    assert 0 < value <= 1
    assert value == pytest.approx(extents_similarity(other, one))
    assert value == pytest.approx(extents_similarity((one[1], one[0], one[2]), other))
    assert extents_similarity(one, one) == pytest.approx(1)


def test_shape_tells_a_chair_from_a_cabinet() -> None:
    rng = np.random.default_rng(0)

    def descriptor(category: str, seed: int) -> Descriptor:
        points, colors = chair_points(seed, category=category)
        return describe(points, colors, np.ptp(points, axis=0), rng)

    chair = descriptor("chair", 1)
    assert shape_similarity(chair, descriptor("chair", 2)) > shape_similarity(chair, descriptor("cabinet", 2)) + 0.1


def test_categories_are_compared_as_people_would() -> None:
    order = [
        category_similarity("couch", "sofa"),
        category_similarity("garden chair", "beach chair"),
        category_similarity("chair", "stool"),
        category_similarity("chair", "refrigerator"),
    ]
    assert order[0] == 1
    assert order == sorted(order, reverse=True)
    assert order[-1] == 0


def write_library(folder: Path, **categories: tuple[str, tuple[float, float, float]]) -> Path:
    folder.mkdir()
    for seed, (stem, (category, extents)) in enumerate(categories.items()):
        parts = generate(category, extents, np.random.default_rng(seed)).parts
        for part in parts:
            part.apply_translation([5, 3, -2])  # libraries have their origin anywhere
        (folder / f"{stem}.glb").write_bytes(dump_glb(parts))
    return folder


def test_a_library_is_indexed_whatever_lies_in_it(tmp_path: Path) -> None:
    folder = write_library(tmp_path / "lib", SomeChair_01=("chair", (0.5, 0.5, 0.9)), b=("table", (0.8, 1.2, 0.7)))
    (folder / "broken.glb").write_bytes(b"glTF no more")
    (folder / "LICENSE").write_text("\nCC-BY-4.0\nmore words")
    (tmp_path / "outside.glb").write_bytes((folder / "b.glb").read_bytes())
    (folder / "link.glb").symlink_to(tmp_path / "outside.glb")
    (folder / "more").symlink_to(tmp_path)
    (folder / "gone.glb").symlink_to("nothing.glb")
    (folder / "loop.glb").symlink_to("loop.glb")
    os.mkfifo(folder / "pipe.glb")
    listed = {"file": "b.glb", "category": "dining table", "licence": "MIT-0", "author": "A. Maker"}
    (folder / "index.json").write_text(json.dumps([listed]))
    index = index_library(folder)
    assert [(e.file, e.category, e.license, e.author) for e in index.entries] == [
        ("SomeChair_01.glb", "chair", "CC-BY-4.0", None),
        ("b.glb", "dining table", "MIT-0", "A. Maker"),
    ]
    assert len(index.problems) == 6
    assert "broken.glb left out" in index.problems[-1]
    assert index.problems[:-1] == tuple(f"library: {name} left out: {why}" for name, why in [
        ("gone.glb", "a link that leads nowhere"),
        ("link.glb", "a link that leads out of the library"),
        ("loop.glb", "a link that leads nowhere"),
        ("more", "a link that leads out of the library"),
        ("pipe.glb", "no regular file"),
    ])  # fmt: skip
    assert [path.name for path in library_files(folder)] == ["LICENSE", "SomeChair_01.glb", "b.glb", "broken.glb", "index.json"]
    made = library_asset(index.entries[1])
    low, high = surface_of(load_glb(made.files[made.asset.mesh_blob])).bounds
    assert np.allclose([*(low + high)[:2], low[2]], 0, atol=1e-6)
    assert np.allclose(made.asset.extents, (0.8, 1.2, 0.7), atol=1e-5)
    for broken in ("{", "[" * 900 + "]" * 900, "[" * 100_000, "[{" * 4_000_000):
        (folder / "index.json").write_text(broken)
        assert "index.json not used" in index_library(folder).problems[0]
    with pytest.raises(InputError, match="is no folder"):
        index_library(tmp_path / "nowhere")


def test_a_bad_file_of_a_library_is_left_out_and_named_and_the_others_are_used(tmp_path: Path) -> None:
    """Whatever is wrong with one file, every scene goes on with the others."""
    folder = write_library(tmp_path / "lib", chair=("chair", (0.5, 0.5, 0.9)))
    sound = index_library(folder).entries
    bad = {
        "number": attacks.textured(attacks.png(4), {"pbrMetallicRoughness": {"baseColorTexture": 7}}),
        "text": attacks.textured(attacks.png(4), {"pbrMetallicRoughness": {"baseColorTexture": "wood"}}),
        "factor": attacks.textured(attacks.png(4), {"pbrMetallicRoughness": {"baseColorFactor": 1}}),
        "cut": attacks.textured(attacks.png(300)[:100]),
        "hollow": attacks.without_buffer(),
        "deep": attacks.nested(),
        "json": attacks.deep_json(),
    }
    for name, data in bad.items():
        (folder / f"{name}.glb").write_bytes(data)
    (folder / "endless.glb").symlink_to("/dev/zero")
    with (folder / "large.glb").open("wb") as file:
        file.truncate(2**38)
    (folder / os.fsdecode(b"\xff.glb")).write_bytes((folder / "chair.glb").read_bytes())
    (folder / "index.json").write_text(json.dumps([{"file": "chair.glb", "category": "chair", "author": "A. \ud800"}]))
    index = index_library(folder)
    assert [(entry.file, entry.author) for entry in index.entries] == [("chair.glb", "A. ?")]
    assert np.array_equal(index.entries[0].descriptor.extents, sound[0].descriptor.extents)
    named = [problem.split()[1] for problem in index.problems]
    assert named == ["endless.glb", *sorted(f"{name}.glb" for name in [*bad, "large"]), "?.glb"]
    assert all(len(problem.splitlines()) == 1 and problem.isprintable() for problem in index.problems)
    made = _library_hash(folder, FileHashes(tmp_path / "hashes.json"))  # a plan is made of it all the same
    (folder / "cut.glb").unlink()
    assert _library_hash(folder, FileHashes(tmp_path / "hashes.json")) != made


@pytest.mark.parametrize("name", ["LICENSE", "LICENSE.txt", "index.json"])
def test_a_librarys_own_files_are_no_links_to_others(tmp_path: Path, name: str) -> None:
    folder = write_library(tmp_path / "lib", chair=("chair", (0.5, 0.5, 0.9)))
    (tmp_path / "secret").write_text("[]\nsecret")
    (folder / name).symlink_to(tmp_path / "secret")
    index = index_library(folder)
    assert [entry.license for entry in index.entries] == ["unknown"]
    assert index.problems == (f"library: {name} left out: a link that leads out of the library",)


@pytest.mark.parametrize(
    ("stem", "category"), [("aws_ChairA_01", "chair"), ("NightStand_02", "nightstand"), ("office-chair-3", "office chair"), ("x", "x")]
)
def test_a_file_name_tells_a_category(stem: str, category: str) -> None:
    assert category_of(stem) == category


@pytest.mark.whole
def test_real_assets_are_found_again_from_partial_scans(realdata: Callable[[str], Path]) -> None:
    folder = realdata("assets")
    index = index_library(folder)
    assert len(index.entries) == 39
    assert [line.split()[1] for line in index.problems] == ["aws_Dumbbell_01.glb", "aws_SeasoningBox_01.glb"]
    assert all(line.endswith("used as it is") for line in index.problems)
    assert all(entry.scale == 1.0 for entry in index.entries)
    by_stem = {entry.path.stem: entry for entry in index.entries}
    for stem in ("aws_ChairA_01", "aws_ChairD_01", "aws_SofaB_01", "aws_KitchenTable_01", "aws_AirconditionerB_01", "aws_Trash_01"):
        entry = by_stem[stem]
        crop = crop_of_parts(load_glb(entry.path.read_bytes()), seed=7)
        points, colors, _ = sample_surface(crop, 1500, np.random.default_rng(1))
        descriptor = describe(points, colors, np.ptp(crop.bounds, axis=0), np.random.default_rng(2))
        best = retrieve(entry.category, descriptor, index.entries, 4)
        assert best[0][1].file == entry.file
        # Even when the label says nothing, shape, size and color bring it among the first.
        blind = sorted(index.entries, key=lambda e, d=descriptor: -(0.25 * extents_similarity(d.extents, e.descriptor.extents)
                       + 0.2 * shape_similarity(d, e.descriptor) + 0.1 * similarity(d.colors, e.descriptor.colors)))  # fmt: skip
        assert entry in blind[:3]
    textured = library_asset(by_stem["aws_KitchenTable_01"])
    parts = load_glb(textured.files[textured.asset.mesh_blob])
    assert any(part.visual.kind == "texture" for part in parts)
    assert textured.asset.license.startswith("MIT-0")


# Assets


def test_an_asset_without_a_solid_is_refused() -> None:
    facts = {"provider": "x", "name": "x", "category": "x", "source": "x", "license": "x"}
    box = trimesh.creation.box((1, 1, 1))
    broken = box.copy()
    broken.vertices[0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        make_asset([broken], **facts)
    with pytest.raises(ValueError, match="no object of a room"):
        make_asset([trimesh.creation.box((1000, 1, 1))], **facts)
    with pytest.raises(ValueError, match="four of each"):
        make_asset([trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)], **facts)


def test_volume_and_closedness_are_those_of_the_solid() -> None:
    facts = {"provider": "x", "name": "x", "category": "x", "source": "x", "license": "x"}
    box = trimesh.creation.box((1, 2, 0.5))
    closed = make_asset([box], **facts).asset
    assert (closed.is_watertight, closed.volume_m3) == (True, pytest.approx(1.0))
    split = trimesh.Trimesh(box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    assert make_asset([split], **facts).asset.is_watertight
    open_box = trimesh.Trimesh(box.vertices, box.faces[2:], process=False)
    opened = make_asset([open_box], **facts).asset
    assert (opened.is_watertight, opened.volume_m3) == (False, pytest.approx(1.0))


@pytest.mark.slow
def test_huge_meshes_are_decimated() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=8)
    made = make_asset([sphere], provider="x", name="x", category="x", source="x", license="x").asset
    assert len(sphere.faces) > MAX_FACES >= made.face_count
    assert made.volume_m3 == pytest.approx(sphere.volume, rel=0.01)


# The stage


def a_room() -> list[tuple[Instance, dict[str, bytes]]]:
    return [
        furniture(2, "chair", (0.5, 0.48, 0.95), 0.4),
        furniture(1, "nightstand", (0.4, 0.55, 0.5), 1.9),
        furniture(4, "gizmo", (0.3, 0.2, 0.25), 0.0),
        furniture(3, "box", (0.3, 0.3, 0.3), 0.0, is_structure=True),
    ]


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return candidates_of(*a_room())


def test_ten_slots_are_filled_and_every_asset_is_canonical(outcome: Outcome) -> None:
    rows, assets = outcome.rows["candidates"], {asset.asset_id: asset for asset in outcome.rows["assets"]}
    assert [(row.instance_id, row.slot) for row in rows] == [(f"000{i}", s) for i in (1, 2, 4) for s in range(1, 11)]
    assert {row.outcome for row in rows} == {"filled"}
    assert {row.asset_id for row in rows} == set(assets)
    named = {blob for asset in assets.values() for blob in (asset.mesh_blob, asset.pieces_blob) if blob}
    assert named == set(outcome.blobs)
    for name, data in outcome.blobs.items():
        assert name.split(".")[0] == hashlib.sha256(data).hexdigest()
    for asset in assets.values():
        assert asset.mesh_blob == f"{asset.asset_id}.glb"
        surface = surface_of(load_glb(outcome.blobs[asset.mesh_blob]))
        low, high = surface.bounds
        assert np.allclose([*(low + high)[:2], low[2]], 0, atol=1e-6)
        assert np.allclose(high - low, asset.extents, atol=1e-6)
        assert (len(surface.vertices), len(surface.faces)) == (asset.vertex_count, asset.face_count)
        assert 0 < asset.volume_m3 < np.prod(asset.extents) * 1.2
        if asset.pieces_blob:
            corners = np.concatenate([piece.vertices for piece in load_glb(outcome.blobs[asset.pieces_blob])])
            assert np.allclose([corners.min(axis=0), corners.max(axis=0)], [low, high], atol=0.01 + 0.02 * np.ptp(surface.bounds))
        if asset.provider.startswith("scan_crop"):
            assert asset.is_watertight
            assert asset.source == "scan test/room"


def test_models_have_the_size_of_the_instance(outcome: Outcome) -> None:
    assets = {asset.asset_id: asset for asset in outcome.rows["assets"]}
    for row in outcome.rows["candidates"]:
        asset = assets[row.asset_id or ""]
        if row.provider == "procedural" and row.instance_id == "0002":
            assert np.allclose(sorted(asset.extents), sorted((0.5, 0.48, 0.95)), atol=1e-5)
            assert asset.category == "chair"
        if row.provider == "scan_crop_closed" and row.instance_id == "0001":
            assert np.allclose(asset.extents, (0.4, 0.55, 0.5), atol=0.03)
    styles = {row.asset_id for row in outcome.rows["candidates"] if row.instance_id == "0002" and row.slot <= 4}
    assert len(styles) >= 2


def test_a_missing_library_is_told_in_every_row_and_once_in_all() -> None:
    outcome = candidates_of(furniture(1, "table", (0.8, 1.3, 0.75), 0.2))
    for row in outcome.rows["candidates"]:
        assert row.is_fallback == (row.slot >= 7)
        assert row.provider == ("parametric" if row.slot == 4 else "procedural" if row.slot <= 3 or row.slot >= 7 else row.provider)
        assert (row.reason == "no library given") == (row.slot >= 7)
    assert sum("no library given" in text for text in outcome.degradations) == 1


@pytest.mark.whole
def test_a_library_fills_its_slots_and_the_same_asset_is_the_same_row(tmp_path: Path) -> None:
    folder = write_library(
        tmp_path / "lib", chair_a=("chair", (0.5, 0.5, 0.9)), chair_b=("chair", (0.45, 0.45, 0.8)), bed_c=("bed", (2.0, 1.6, 0.9))
    )
    pairs = [furniture(1, "chair", (0.5, 0.5, 0.9), 0.3), furniture(2, "chair", (0.48, 0.5, 0.92), 1.2)]
    both = candidates_of(*pairs, library=folder)
    alone = candidates_of(pairs[1], library=folder)
    for outcome in (both, alone):
        rows = [row for row in outcome.rows["candidates"] if row.instance_id == "0002" and row.slot >= 7]
        assert [(row.provider, row.is_fallback) for row in rows[:2]] == [("library", False)] * 2
        assert all(row.provider == "procedural" and row.is_fallback and "come near enough" in (row.reason or "") for row in rows[2:])
    found = [{a.asset_id: a for a in o.rows["assets"] if a.provider == "library"} for o in (both, alone)]
    assert found[0] == found[1]
    assert {asset.name for asset in found[0].values()} == {"chair_a", "chair_b"}


def test_one_bad_instance_costs_only_its_own_slots() -> None:
    good = furniture(1, "stool", (0.4, 0.4, 0.5), 0.2)
    instance, files = furniture(2, "box", (0.4, 0.4, 0.4), 0.2)
    broken = (instance, {name: (b"no glb" if name == instance.mesh_blob else data) for name, data in files.items()})
    bare = furniture(3, "box", (0.3, 0.4, 0.2), 0.2, mesh_blob=None)
    outcome = candidates_of(good, broken, bare)
    results = {(row.instance_id, row.slot): row for row in outcome.rows["candidates"]}
    assert {results["0001", slot].outcome for slot in range(1, 11)} == {"filled"}
    assert [results["0002", slot].outcome for slot in (4, 5, 6, 7)] == ["filled", "failed", "failed", "filled"]
    assert "is not a readable GLB" in (results["0002", 5].reason or "")
    assert [results["0003", slot].outcome for slot in (4, 5, 6)] == ["filled", "empty", "empty"]
    assert results["0003", 5].reason == "the scan has no faces of the instance"
    assert sum("0002 box: slot" in text for text in outcome.degradations) == 2


def elsewhere(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """As other processes do it: with copies, and done in another order."""
    assert len(items) > 1
    done = [pickle.loads(pickle.dumps(function(pickle.loads(pickle.dumps(item))))) for item in items[::-1]]
    return done[::-1]


@pytest.mark.whole
def test_the_same_input_gives_the_same_bytes_in_any_order(outcome: Outcome) -> None:
    other = candidates_of(*a_room()[::-1], spread=elsewhere)
    assert outcome.rows == other.rows
    assert outcome.degradations == other.degradations
    assert list(outcome.blobs.items()) == list(other.blobs.items())


def test_another_seed_draws_other_models() -> None:
    config = CandidatesConfig(slots=(SlotConfig(Procedural(1)),))
    one, other = (candidates_of(furniture(1, "chair", (0.5, 0.5, 0.9), 0.2), config=config, seed=seed) for seed in (1, 2))
    assert one.rows != other.rows


def test_slots_are_config() -> None:
    config = CandidatesConfig(slots=(SlotConfig(ScanCrop("closed")), SlotConfig(LibraryRetrieval(1)), SlotConfig(Procedural(1))))
    rows = candidates_of(furniture(1, "stool", (0.4, 0.4, 0.5), 0.2), config=config).rows["candidates"]
    assert [(row.provider, row.outcome) for row in rows] == [("scan_crop_closed", "filled"), ("library", "empty"), ("procedural", "filled")]
    assert rows[1].reason == "no library given"
    with pytest.raises(ValueError, match=r"^slots: must be a list of at least 1, is \(\)$"):
        CandidatesConfig(slots=())
    assert dataclasses.is_dataclass(STAGE.config)


def test_the_long_side_is_laid_as_the_category_has_it() -> None:
    assert fronted_extents("sofa", (2.0, 0.9, 0.8)) == (0.9, 2.0, 0.8)
    assert fronted_extents("sofa", (0.9, 2.0, 0.8)) == (0.9, 2.0, 0.8)
    assert fronted_extents("stool", (0.4, 0.35, 0.5)) == (0.4, 0.35, 0.5)
