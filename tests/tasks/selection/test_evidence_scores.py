"""Scores by evidence: coverage and seen-empty space decide, whoever offers a candidate; among equals the whole model goes first."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from schemas.capture import Frame
from tasks.alignment import AlignmentConfig, Fit, sample_asset
from tasks.alignment.measures import f_score
from tasks.alignment.targets import make_target
from tasks.geometry.transforms import flat, look_at, yaw_pose
from tasks.selection import ScoreConfig
from tasks.selection.coloring import color_error
from tasks.selection.scoring import finest_first, pattern_first, whole_first
from tasks.views.sightlines import box_cells, depth_views, is_seen_empty
from tests.tasks.selection.rooms import WOOD, Room, cabinet, chair, part, scan, shelf

CROP = "scan_crop_closed"


def u_sofa() -> list[trimesh.Trimesh]:
    """Two arms of seats around an open bend."""
    back = part((2.8, 0.8, 0.7), (0, 0.8, 0.35))
    return [back, *(part((0.8, 1.6, 0.7), (x, -0.4, 0.35)) for x in (-1.0, 1.0))]


def bench() -> list[trimesh.Trimesh]:
    """What a template of a sofa has of it: the back alone."""
    return [part((2.8, 2.4, 0.25), (0, 0, 0.125)), part((2.8, 0.8, 0.45), (0, 0.8, 0.475))]


def noisy(parts: list[trimesh.Trimesh], rng: np.random.Generator, noise_m: float = 0.006) -> trimesh.Trimesh:
    """A crop of a scan of parts: their surface with noise."""
    crop = trimesh.util.concatenate([mesh.subdivide() for mesh in parts])
    crop.vertices += rng.normal(0, noise_m, crop.vertices.shape)
    crop.visual.vertex_colors = np.tile([*WOOD, 255], (len(crop.vertices), 1)).astype(np.uint8)
    return crop


def room_with(scanned: list[trimesh.Trimesh], crop: trimesh.Trimesh, model: list[trimesh.Trimesh], names: tuple[str, str]) -> Room:
    rng = np.random.default_rng(3)
    room = Room()
    instance = room.instance(*scan(scanned, yaw_pose(0.4), (1, 1, 1), rng), 0.4)
    for slot, (parts, name) in enumerate((([crop], names[0]), (model, names[1])), start=1):
        room.candidate(instance, slot, room.asset(parts, name, name, watertight=True), name)
    return room


def test_a_template_that_misses_points_loses_to_the_crop_that_covers_them() -> None:
    rows, _ = room_with(u_sofa(), noisy(u_sofa(), np.random.default_rng(1)), bench(), (CROP, "procedural")).select()
    assert rows[0].slot == 1
    assert rows[1].coverage < 0.6 < 0.85 < rows[0].coverage


def test_the_true_model_goes_before_the_crop_of_its_scan() -> None:
    rows, _ = room_with(chair(), noisy(chair(), np.random.default_rng(1)), chair(), (CROP, "library")).select()
    assert [row.slot for row in rows] == [2, 1]
    assert rows[0].score >= rows[1].score


@pytest.mark.parametrize("names", [("parametric", "procedural"), ("procedural", "shap_e"), ("shap_e", CROP)])
def test_scores_are_the_same_whoever_offers_what_fits_better(names: tuple[str, str]) -> None:
    """Of a crop that wins, under any names: the numbers of both are those under their own names."""
    crop = noisy(u_sofa(), np.random.default_rng(1))
    own, _ = room_with(u_sofa(), crop, bench(), (CROP, "procedural")).select()
    renamed, _ = room_with(u_sofa(), crop, bench(), names).select()
    assert [(row.slot, round(row.score, 12)) for row in own] == [(row.slot, round(row.score, 12)) for row in renamed]


def test_own_geometry_yields_to_equal_evidence_alone() -> None:
    margin, scores, own = ScoreConfig().whole_margin, np.array([0.95, 0.8]), [True, False]
    for f, foreign, yields in ((0.97, 0.0, True), (0.94, 0.0, True), (0.9, 0.0, False), (0.97, 0.2, False)):
        ranked = whole_first(scores, np.array([0.98, f]), np.array([0.0, foreign]), own, margin)
        assert (ranked[0] < ranked[1]) == yields
        assert ranked[1] == 0.8
        if not yields:
            assert ranked[0] == 0.95


def test_a_model_that_explains_little_does_not_go_before_own_geometry() -> None:
    """A box in the bend of a sofa of which a third was scanned: both explain two thirds."""
    for f_scores, yields in (([0.72, 0.69], False), ([0.85, 0.82], True)):
        ranked = whole_first(np.array([0.78, 0.75]), np.array(f_scores), np.zeros(2), [True, False], 0.05, least=0.8)
        assert (ranked[0] < ranked[1]) == yields


def test_a_plain_model_does_not_go_before_a_pattern() -> None:
    """Own geometry yields to a model of its shape only if that shows about the same colors; and it passes one that fits a little better."""
    scores, own, f_scores, foreign = np.array([0.92, 0.9]), [True, False], np.array([0.98, 0.98]), np.zeros(2)
    for errors, yields in (([2.0, 4.0], True), ([2.0, 12.0], False)):
        ranked = whole_first(scores, f_scores, foreign, own, 0.05, np.array(errors), 5.0)
        assert (ranked[0] < ranked[1]) == yields
    for model, error, passes in ((0.94, 12.0, True), (0.94, 4.0, False), (0.99, 12.0, False)):
        ranked = pattern_first(np.array([0.92, model]), own, np.array([2.0, error]), 0.05, 5.0)
        assert (ranked[0] > ranked[1]) == passes


def test_color_errors_tell_stripes_from_plain_and_from_other_stripes_in_any_light() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(0, 1, (2000, 3)) * [2.0, 0.02, 2.0]
    stripes = np.where((points[:, :1] * 5).astype(int) % 2 == 0, [[180, 60, 50]], [[220, 210, 190]]).astype(np.uint8)
    shifted = points + np.array([0.2, 0.0, 0.0])
    plain = np.tile(stripes.mean(axis=0), (len(points), 1)).astype(np.uint8)
    itself = color_error(points, (stripes * 0.9).astype(np.uint8), points, stripes)
    assert itself < 5.0
    assert color_error(points, stripes, points, plain) > itself + 5.0
    assert color_error(points, stripes, shifted, stripes) > itself + 5.0


def test_the_closed_crop_goes_before_its_pieces_unless_they_fit_clearly_better() -> None:
    providers = ["scan_crop_closed", "scan_crop_pieces", "procedural"]
    ranked = finest_first(np.array([0.9, 0.92, 0.91]), providers, 0.03)
    assert ranked[1] < ranked[0] < ranked[2]
    assert finest_first(np.array([0.8, 0.92, 0.91]), providers, 0.03).tolist() == [0.8, 0.92, 0.91]
    assert finest_first(np.array([0.92, 0.91]), providers[1:], 0.03).tolist() == [0.92, 0.91]


def test_f_scores_tell_a_template_from_the_object() -> None:
    """Of a sofa with an open bend: itself agrees with its points, a bench as large does not."""
    rng = np.random.default_rng(2)
    points = scan(u_sofa(), np.eye(4), (1, 1, 1), rng)[0]
    config = AlignmentConfig()
    target = make_target(points, np.zeros(points.shape, dtype=np.uint8), np.ptp(points, axis=0), config, rng)
    fit = Fit(0.0, np.zeros(3), np.ones(3))
    room = Room()
    values = []
    for parts in (u_sofa(), bench()):
        asset = room.assets[room.asset(parts, "a")]
        sample = sample_asset(asset, room.blobs[asset.mesh_blob], config, rng)
        values.append(f_score(target, sample, fit, 0.05, config))
    assert values[0] > 0.95
    assert values[1] < 0.7


def test_a_model_that_fills_space_that_frames_saw_empty_loses() -> None:
    """An open shelf before a camera: a closed block covers its sides as well, and stands in what the camera saw past."""
    rng = np.random.default_rng(5)
    room = Room()
    instance = room.instance(*scan(shelf(), np.eye(4), (1, 1, 1), rng, view=0.0), 0.0)
    block, whole = room.asset([part((0.3, 0.8, 1.5), (0, 0, 0.75))], "block"), room.asset(shelf(), "shelf")
    room.candidate(instance, 1, block)
    room.candidate(instance, 2, whole)
    blind = {row.slot: row for row in room.select()[0]}
    room.frames = [frame_at(number, eye) for number, eye in enumerate(([2.5, 0.0, 1.2], [2.2, 0.8, 1.4], [2.2, -0.8, 1.0]))]
    rows, _ = room.select()
    by_slot = {row.slot: row for row in rows}
    assert rows[0].slot == 2
    assert blind[1].foreign_share == blind[2].foreign_share == 0.0
    assert by_slot[1].foreign_share is not None
    assert by_slot[1].foreign_share > 0.1
    assert by_slot[2].foreign_share is not None
    assert by_slot[2].foreign_share < 0.02
    assert by_slot[1].score < blind[1].score


def test_a_solid_that_was_seen_fills_nothing_empty() -> None:
    room = Room()
    instance = room.instance(*scan(cabinet(), np.eye(4), (1, 1, 1), np.random.default_rng(0)), 0.0)
    room.candidate(instance, 1, room.asset(cabinet(), "cabinet"))
    room.frames = [frame_at(number, eye) for number, eye in enumerate(([2.5, 0.0, 1.2], [0.0, 2.5, 1.2], [-2.0, -2.0, 1.5]))]
    (row,), _ = room.select()
    assert row.foreign_share is not None
    assert row.foreign_share < 0.01


def test_only_what_lies_before_a_surface_was_seen_empty() -> None:
    y, z = (grid.ravel() for grid in np.meshgrid(np.arange(-2, 2, 0.04), np.arange(0, 2.4, 0.04)))
    wall = np.column_stack([np.zeros(len(y)), y, z])
    views = depth_views([frame_at(0, [3.0, 0.0, 1.2])], wall, 0.04)
    points = np.array([[1.0, 0.0, 1.2], [0.02, 0.0, 1.2], [-0.5, 0.0, 1.2], [4.0, 0.0, 1.2], [1.0, 0.0, 9.0]])
    assert is_seen_empty(points, views).tolist() == [True, False, False, False, False]
    assert depth_views([dataclasses.replace(frame_at(0, [3.0, 0.0, 1.2]), pose=None)], wall, 0.04) == []
    assert depth_views([], wall, 0.04) == []


def test_cells_fill_a_box_of_any_size() -> None:
    for low, high in (([0, 0, 0], [0.4, 0.4, 0.4]), ([-1, -1, 0], [1, 1, 0.0]), ([0, 0, 0], [40, 40, 3])):
        cells = box_cells(np.array(low, dtype=float), np.array(high, dtype=float), 0.04)
        assert 0 < len(cells) < 130_000
        assert (cells >= low).all()


def frame_at(number: int, eye: list[float]) -> Frame:
    """A frame of a camera that looks at the middle of what stands at the origin."""
    return Frame(
        scene_id="test/room", frame_id=f"{number:06d}", color_file="a.jpg", depth_file=None, width=320, height=240,
        intrinsics=(260.0, 260.0, 159.5, 119.5), depth_scale=1000.0,
        pose=flat(look_at(np.array(eye), np.array([0.0, 0.0, min(eye[2], 0.8)]))), pose_source="file",
    )  # fmt: skip
