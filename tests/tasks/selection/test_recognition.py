"""Models that are recognized: in their own size, by points, seen-empty space and colors up to light."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from tasks.alignment import AlignmentConfig, Fit, align, make_target, sample_asset
from tasks.geometry.meshes import canonical, dump_glb
from tasks.geometry.transforms import matrix, yaw_pose
from tasks.selection import ScoreConfig
from tasks.selection.recognition import ModelLikeness, has_own_size, is_recognized, lit_similarity, recognized_first
from tests.tasks.selection.rooms import GRAY, WOOD, Room, cabinet, chair, part, scan

CROP = "scan_crop_closed"


def lamp() -> list[trimesh.Trimesh]:
    """A shade that hangs on a thin rod."""
    return [part((0.6, 0.4, 0.25), (0, 0, 0.125)), part((0.01, 0.01, 0.6), (0, 0, 0.55))]


def dark(parts: list[trimesh.Trimesh], share: float) -> list[trimesh.Trimesh]:
    for mesh in parts:
        visual: Any = mesh.visual
        visual.vertex_colors = (np.asarray(visual.vertex_colors) * [share, share, share, 1.0]).astype(np.uint8)
    return parts


def test_a_model_keeps_its_size_where_the_scan_lost_a_rod() -> None:
    """The box of the scan is that of the shade alone: fitted to it, the lamp would be squeezed to a third."""
    rng, room = np.random.default_rng(0), Room()
    points, colors = scan(lamp()[:1], yaw_pose(0.3, [0, 0, 1.8]), (1, 1, 1), rng)
    instance = room.instance(points, colors, 0.3)
    room.candidate(instance, 1, room.asset(lamp(), "lamp"))
    room.candidate(instance, 2, room.asset(lamp()[:1], "fitted", "procedural"), "procedural")
    by_slot = {row.slot: row for row in room.select()[0]}
    assert by_slot[1].scale == (1.0, 1.0, 1.0)
    assert matrix(by_slot[1].pose)[2, 3] == pytest.approx(1.8, abs=0.03)
    assert by_slot[1].coverage > 0.95


def test_a_model_of_another_size_is_still_scaled() -> None:
    rng, room = np.random.default_rng(1), Room()
    points, colors = scan(chair(), yaw_pose(0.2), (1.25, 1.2, 1.2), rng)
    room.candidate(room.instance(points, colors, 0.2), 1, room.asset(chair(), "chair"))
    (row,) = room.select()[0]
    assert np.allclose(row.scale, (1.25, 1.2, 1.2), atol=0.08)


def test_what_stands_on_the_floor_stays_on_it() -> None:
    """Of a cabinet whose lowest 4 cm were not scanned, in its own size."""
    rng, room = np.random.default_rng(2), Room()
    points, colors = scan(cabinet(), yaw_pose(0, [0, 0, 0.04]), (1, 1, 1), rng)
    room.candidate(room.instance(points, colors, 0.0), 1, room.asset(cabinet(), "cabinet"))
    (row,) = room.select()[0]
    assert matrix(row.pose)[2, 3] == pytest.approx(0.0, abs=1e-6)


def test_the_object_itself_goes_before_what_was_made_to_its_measure() -> None:
    """A cabinet of which the scan shows two sides, in the light of a room: the template in the color of the scan agrees better."""
    rng, room = np.random.default_rng(3), Room()
    points, colors = scan(dark(cabinet(), 0.7), np.eye(4), (1, 1, 1), rng, view=0.0)
    instance = room.instance(points, colors, 0.0)
    x, y, z = (float(side) for side in instance.box_size)
    copy = dark([part((x, y, z), (0, 0, z / 2))], 0.7)
    room.candidate(instance, 1, room.asset(copy, "copy", "procedural"), "procedural")
    room.candidate(instance, 2, room.asset(cabinet(), "cabinet"))
    rows, _ = room.select()
    assert [row.slot for row in rows] == [2, 1]
    assert rows[0].score - rows[1].score >= ScoreConfig().look_loss


def test_a_scan_without_colors_takes_models_of_any_color() -> None:
    rng, room = np.random.default_rng(3), Room()
    points, colors = scan(cabinet(), np.eye(4), (1, 1, 1), rng, view=0.0)
    instance = room.instance(points, np.full_like(colors, 180), 0.0)
    x, y, z = (float(side) for side in instance.box_size)
    room.candidate(instance, 1, room.asset([part((x, y, z), (0, 0, z / 2))], "copy", "procedural"), "procedural")
    room.candidate(instance, 2, room.asset(cabinet(), "cabinet"))
    rows, _ = room.select()
    assert [row.slot for row in rows] == [2, 1]


@pytest.mark.parametrize("model", [cabinet(GRAY), [part((0.46, 0.46, 0.6), (0, 0, 0.3))], chair()])
def test_models_of_other_colors_sizes_and_shapes_are_not_recognized(model: list[trimesh.Trimesh]) -> None:
    rng, room = np.random.default_rng(4), Room()
    points, colors = scan(cabinet((190, 60, 20)), np.eye(4), (1, 1, 1), rng)
    instance = room.instance(points, colors, 0.0)
    room.candidate(instance, 1, room.asset(cabinet((190, 60, 20)), "copy", CROP), CROP)
    room.candidate(instance, 2, room.asset(model, "model"))
    by_slot = {row.slot: row for row in room.select()[0]}
    assert by_slot[1].score > by_slot[2].score - 0.5 * ScoreConfig().recognized_lead


def test_light_does_not_change_what_a_color_is() -> None:
    rng = np.random.default_rng(5)
    colors = rng.integers(60, 200, (500, 3)).astype(np.uint8)
    assert lit_similarity((colors * 0.75).astype(np.uint8), colors) > 0.85
    red, blue = np.full((100, 3), (200, 30, 30), dtype=np.uint8), np.full((100, 3), (30, 30, 200), dtype=np.uint8)
    assert lit_similarity(red, blue) < 0.1
    assert lit_similarity(np.full((50, 3), 180, np.uint8), red) == 1.0  # the scan has no colors


def test_recognition_wants_points_space_and_color() -> None:
    config, likeness = ScoreConfig(), ModelLikeness(0.97, 0.95, 0.6)
    assert is_recognized(likeness, 1.0, 0.02, 0.0, config, True)
    for worse in (ModelLikeness(0.8, 0.95, 0.6), ModelLikeness(0.97, 0.7, 0.6), ModelLikeness(0.97, 0.95, 0.1)):
        assert not is_recognized(worse, 1.0, 0.02, 0.0, config, True)
    assert not is_recognized(likeness, 1.0, 0.2, 0.0, config, True)
    assert is_recognized(ModelLikeness(0.97, 0.6, 0.6), 1.0, 0.0, 0.0, config, False), "without frames unseen sides say little"


def test_the_strongest_goes_first_and_nothing_gains() -> None:
    scores = np.array([0.9, 0.7, 0.72])
    assert recognized_first(scores, [0.0, 0.0, 0.0], 0.06).tolist() == scores.tolist()
    ranked = recognized_first(scores, [0.0, 0.8, 0.5], 0.06)
    assert ranked.tolist() == [pytest.approx(0.64), 0.7, pytest.approx(0.64)]


def test_samples_of_a_textured_asset_have_its_texture() -> None:
    """Of a box of twelve triangles with a picture of two halves, of which its corners show little."""
    image = np.zeros((64, 64, 3), dtype=np.uint8)
    image[:, :32], image[:, 32:] = WOOD, GRAY
    mesh = trimesh.creation.box((0.4, 0.4, 0.4))
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    uv = np.column_stack([0.5 + 0.9 * mesh.vertices[:, 0], 0.5 + 0.9 * mesh.vertices[:, 1]])
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=trimesh.visual.material.PBRMaterial(baseColorTexture=Image.open(file)))
    room = Room()
    asset_id = room.asset([part((0.4, 0.4, 0.4), (0, 0, 0.2))], "box")
    row = room.assets[asset_id]
    object.__setattr__(row, "has_texture", True)
    sample = sample_asset(row, dump_glb(canonical([mesh])), AlignmentConfig(), np.random.default_rng(0))
    shown = {tuple(color) for color in sample.colors.tolist()}
    assert shown == {WOOD, GRAY}


def test_only_models_of_libraries_have_a_size_of_their_own() -> None:
    room, config = Room(), AlignmentConfig()
    fit = Fit(0.0, np.zeros(3), np.ones(3))
    for provider, is_sized in (("library", True), ("procedural", False), (CROP, False)):
        asset = room.assets[room.asset(cabinet(), provider, provider)]
        sample = sample_asset(asset, room.blobs[asset.mesh_blob], config, np.random.default_rng(0))
        assert has_own_size(sample, fit) == is_sized
        assert not has_own_size(sample, Fit(0.0, np.zeros(3), np.array([1.0, 1.2, 1.0])))
    points = sample.placed(fit)[0]
    target = make_target(points, np.zeros(points.shape, dtype=np.uint8), np.ptp(points, axis=0), config, np.random.default_rng(0))
    assert align(target, sample, 0.03, config)[1].coverage > 0.95
