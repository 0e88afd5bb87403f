"""Methods that need no weights: what they score by, and what happens where they lack it."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from schemas.capture import Frame
from schemas.errors import InputError
from schemas.families.selection_methods import SELECTION_METHODS
from tasks.alignment import AlignmentConfig
from tasks.alignment.free_pose import FreePose
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import matrix, transform_points, yaw_pose
from tasks.selection import SelectionConfig
from tasks.selection.methods.color_histogram import ColorHistogram
from tasks.selection.methods.extents import Extents, size_agreement
from tasks.selection.methods.geometric import Geometric
from tasks.selection.methods.image_similarity import ImageSimilarity, similarity
from tasks.selection.methods.members import METHODS
from tasks.selection.methods.method import chances
from tasks.selection.methods.model import ModelScores
from tasks.settings import adapter
from tasks.views.crops import Crop, crop_of, filling, resized, scaled, squared
from tests.tasks.selection.rooms import GRAY, RED, WOOD, Room, cabinet, canonical, chair, photographed, scan, shelf, table

EYE = (2.4, 1.3, 1.6)


def by(provider: Any) -> SelectionConfig:
    return SelectionConfig(provider=provider)


def room_of(parts: list, offered: list[list], turn: float = 0.4, view: float | None = None) -> Room:
    """A room with one thing, scanned and photographed, and what is offered for it by slot."""
    room, pose = Room(), yaw_pose(turn, [0.3, -0.2, 0.0])
    points, colors = scan(parts, pose, (1, 1, 1), np.random.default_rng(0), view=view)
    instance = room.instance(points, colors, turn)
    for slot, model in enumerate(offered, start=1):
        room.candidate(instance, slot, room.asset(model, f"model {slot}"))
    photographed(room, instance, parts, pose, EYE)
    return room


def test_every_method_is_a_choice_of_the_setting_and_the_first_is_the_default() -> None:
    kinds = [method.name for method in METHODS]
    assert kinds == list(SELECTION_METHODS)
    assert SelectionConfig() == SelectionConfig(provider=Geometric())
    assert SelectionConfig().provider.kind == kinds[0]
    plain = [name for name in kinds if not {"clip", "dinov2", "endpoint"} & set(METHODS[kinds.index(name)].needs)]
    for name in plain:
        assert adapter(SelectionConfig).validate_python({"provider": name}).provider.kind == name
    for name in set(kinds) - set(plain):
        with pytest.raises(InputError, match=r"^selection.provider: (weights: names no folder|model: names no model)"):
            Room().select(adapter(SelectionConfig).validate_python({"provider": name}))


def test_sizes_are_held_against_each_other_both_ways() -> None:
    rng = np.random.default_rng(0)
    for first, second in rng.uniform(0.01, 2.0, (50, 2, 3)):
        ways = [np.prod([min(a / b, b / a) for a, b in zip(first, second[list(order)], strict=True)]) for order in ((0, 1, 2), (1, 0, 2))]
        assert size_agreement(first, second) == pytest.approx(max(ways), rel=1e-12)
        assert size_agreement(first, second) == size_agreement(second, first)
    assert size_agreement(np.array([1.0, 2.0, 3.0]), np.array([2.0, 1.0, 3.0])) == 1.0


def test_extents_choose_the_size_whatever_the_shape() -> None:
    room = room_of(cabinet(), [shelf(), table(), cabinet()])
    rows, _ = room.select(by(Extents()))
    assert rows[0].slot == 3
    assert {(row.provider, row.provider_version) for row in rows} == {("extents", "1")}
    box = room.instances[0]
    size = np.array([*box.box_size[:2], box.box_pose[11] + 0.5 * box.box_size[2]])  # down to the floor
    for row in rows:
        assert row.score == pytest.approx(size_agreement(np.array(room.assets[row.asset_id].extents), size), abs=1e-6)


def test_colors_choose_the_color_whatever_the_shape() -> None:
    room = room_of(chair(RED), [chair(WOOD), cabinet(RED), chair(GRAY)])
    rows, _ = room.select(by(ColorHistogram()))
    assert rows[0].slot == 2
    assert all(row.score == row.color_similarity for row in rows)


def test_a_crop_comes_with_the_camera_and_the_silhouette_of_its_pixels() -> None:
    """What is drawn from the crop's camera is the crop; a point of the world is where the whole frame has it."""
    room = room_of(chair(RED), [chair(RED)])
    instance, frame, mask = room.instances[0], room.frames[0], room.masks[0]
    crop = crop_of(instance, frame, mask, room.blobs)
    assert crop is not None
    assert crop.camera is not None
    assert crop.silhouette is not None
    pose = yaw_pose(0.4, [0.3, -0.2, 0.0])
    placed = canonical(chair(RED))
    for part in placed:
        part.apply_transform(pose)
    drawn = RayScene(placed).render(crop.camera, background=(90, 110, 90))
    assert drawn.color.shape == crop.image.shape
    assert ((drawn.part >= 0) == crop.silhouette).mean() > 0.98
    assert np.abs(drawn.color.astype(float) - crop.image).mean() < 6  # the crop is a JPEG, and was shrunk
    point = transform_points([[0.2, 0.1, 0.4]], pose)
    (u, v), _ = (values[0] for values in crop.camera.project(point))
    camera = dataclasses.replace(
        crop.camera, fx=frame.intrinsics[0], fy=frame.intrinsics[1], cx=frame.intrinsics[2], cy=frame.intrinsics[3]
    )
    (x, y), _ = (values[0] for values in camera.project(point))
    share = crop.image.shape[1] / (crop.camera.fx and frame.intrinsics[0] / crop.camera.fx) / crop.image.shape[1]
    assert np.allclose(matrix(frame.pose or ()), crop.camera.pose)
    corner_x, corner_y = x - (u + 0.5) / share + 0.5, y - (v + 0.5) / share + 0.5
    left, top = mask.pixel_box[:2]
    margin = max(4, round(0.15 * max(mask.pixel_box[2] - left, mask.pixel_box[3] - top)))
    assert (corner_x, corner_y) == pytest.approx((left - margin, top - margin), abs=0.6)
    small = crop.shrunk(64)
    assert max(small.image.shape) == 64
    assert small.camera is not None
    assert np.allclose(
        (small.camera.project(point)[0] + 0.5) / 64, (crop.camera.project(point)[0] + 0.5) / max(crop.image.shape), atol=0.02
    )
    assert (crop.on_white()[~crop.silhouette] == 255).all()
    assert (crop.on_white()[crop.silhouette] == crop.image[crop.silhouette]).all()


@pytest.mark.whole
@pytest.mark.parametrize("with_camera", [True, False])
def test_pictures_choose_what_looks_like_the_crop(with_camera: bool) -> None:
    """From the crop's own camera; from around, where it is not known, structure alone tells only what differs much."""
    shown = [("chair", chair(RED)), ("table", table()), ("shelf", shelf())]
    for truth, (name, parts) in enumerate(shown if with_camera else shown[:2]):
        room = room_of(parts, [chair(RED), table(), *([shelf()] if with_camera else []), cabinet()])
        if not with_camera:
            room.frames = [dataclasses.replace(row, pose=None) for row in room.frames]
        rows, degradations = room.select(by(ImageSimilarity()))
        assert not degradations
        assert rows[0].slot == truth + 1, (name, [(row.slot, row.score) for row in rows])
        assert rows[0].provider == "image_similarity"


def test_a_picture_is_like_itself_and_less_like_any_other() -> None:
    image = np.random.default_rng(0).integers(0, 255, (40, 30, 3)).astype(np.uint8)
    everywhere = np.ones((40, 30), dtype=bool)
    assert similarity(image, image, everywhere) == pytest.approx(1.0)
    assert similarity(image, image[::-1].copy(), everywhere) < 0.5
    assert similarity(image, image, ~everywhere) == 0.0


def test_squares_hold_the_whole_picture_and_what_is_cut_out_fills_them() -> None:
    image = np.zeros((10, 20, 3), dtype=np.uint8)
    square = squared(image, 40)
    assert square.shape == (40, 40, 3)
    assert (square == 0).all(axis=2).sum() == 40 * 20
    where = np.zeros((10, 20), dtype=bool)
    where[2:6, 3:7] = True
    assert (filling(image, where, 16) == 0).all()
    assert (filling(image, np.zeros((10, 20), dtype=bool), 16) == squared(image, 16)).all()


def test_cameras_of_other_sizes_see_the_same() -> None:
    crop = room_of(table(), [table()])
    frame = crop.frames[0]
    whole = scaled(_camera(frame), 64, 48)
    first, second = _camera(frame).rays(), whole.rays()
    assert np.allclose(first.reshape(48, 10, 64, 10, 6).mean(axis=(1, 3)), second, atol=1e-5)
    assert resized(np.full((4, 4, 3), 7, dtype=np.uint8), 9, 5).shape == (5, 9, 3)


def _camera(frame: Frame) -> Camera:
    return Camera(matrix(frame.pose or ()), *frame.intrinsics, frame.width, frame.height)


LACKING = [(ImageSimilarity(), "no crop of it"), (ModelScores(), "no model")]


@pytest.mark.parametrize(("provider", "problem"), LACKING, ids=["image", "model"])
def test_where_something_is_lacking_geometry_stands_in_and_the_row_says_so(provider: Any, problem: str) -> None:
    room = room_of(chair(), [table(), chair(), cabinet()])
    room.instances = [dataclasses.replace(row, view_blob=None) for row in room.instances]
    rows, degradations = room.select(by(provider))
    assert rows == room.select()[0]
    assert {row.provider for row in rows} == {"geometric"}
    assert degradations == (f"0000: {provider.kind}: {problem}; scored by geometric",)


def test_a_crop_that_is_no_picture_is_said_and_stops_nothing() -> None:
    room = room_of(chair(), [table(), chair()])
    broken = room.blobs.add(b"no picture", "jpg")
    room.instances = [dataclasses.replace(row, view_blob=broken) for row in room.instances]
    rows, degradations = room.select(by(ImageSimilarity()))
    assert rows == room.select()[0]
    assert len(degradations) == 1
    assert "cannot be read as a picture" in degradations[0]


@pytest.mark.parametrize("provider", [Extents(), ColorHistogram(), ImageSimilarity()])
def test_the_order_of_rows_changes_nothing(provider: Any) -> None:
    room = room_of(chair(), [table(), chair(RED), chair(), shelf()])
    rows, _ = room.select(by(provider))
    assert all(0.0 <= row.score <= 1.0 for row in rows)
    assert [row.score for row in rows] == sorted((row.score for row in rows), reverse=True)
    room.candidates.reverse()
    room.assets = dict(reversed(room.assets.items()))
    assert room.select(by(provider))[0] == rows


def test_what_was_measured_is_the_same_whoever_scores() -> None:
    room = room_of(chair(), [table(), chair(RED), chair()])
    kept = ("slot", "asset_id", "chamfer_m", "coverage", "box_iou", "foreign_share", "color_similarity", "pose", "scale")
    rows = [
        sorted(tuple(getattr(row, name) for name in kept) for row in room.select(by(provider))[0])
        for provider in (Geometric(), Extents(), ColorHistogram(), ImageSimilarity())
    ]
    for first, second in itertools.pairwise(rows):
        assert first == second


def test_chances_are_shares_of_one_in_the_same_order() -> None:
    logits = np.array([900.0, -900.0, 1.0, 901.0])
    assert chances(logits).sum() == pytest.approx(1.0)
    assert (np.argsort(chances(logits)) == np.argsort(logits)).all() or chances(logits)[1] == chances(logits)[2] == 0.0
    assert chances(np.log(np.array([1.0, 3.0]))) == pytest.approx([0.25, 0.75])
    assert len(chances(np.zeros(0))) == 0


def test_a_crop_without_camera_is_a_picture_alone() -> None:
    room = room_of(chair(), [chair()])
    crop = crop_of(room.instances[0], None, None, room.blobs)
    assert crop is not None
    assert (crop.camera, crop.silhouette) == (None, None)
    assert (crop.on_white() == crop.image).all()
    assert isinstance(crop.shrunk(10_000), Crop)
    assert crop_of(dataclasses.replace(room.instances[0], view_blob=None), None, None, room.blobs) is None


def test_alignment_by_sight_is_told_where_the_crop_was_taken_from() -> None:
    room = room_of(chair(), [chair(), cabinet()])
    aligned = SelectionConfig(alignment=AlignmentConfig(method=FreePose()), provider=Geometric())
    rows, notes = room.select(aligned)
    instance = room.instances[0]
    to_camera = np.array(EYE[:2]) - np.array([instance.box_pose[3], instance.box_pose[7]])
    for row in rows:
        front = matrix(row.pose)[:2, 0]
        assert front @ to_camera / np.linalg.norm(to_camera) == pytest.approx(1.0, abs=1e-6)
    assert not notes
    room.frames = [dataclasses.replace(row, pose=None) for row in room.frames]
    _, notes = room.select(aligned)
    assert any("free_pose: nobody knows its camera" in note for note in notes)


def test_a_broken_crop_is_said_where_alignment_wants_it() -> None:
    room = room_of(chair(), [chair()])
    room.instances = [dataclasses.replace(room.instances[0], view_blob=room.blobs.add(b"no picture", "jpg"))]
    rows, notes = room.select(SelectionConfig(alignment=AlignmentConfig(method=FreePose()), provider=Geometric()))
    assert len(rows) == 1
    assert len(notes) == 2, "the picture, and that its camera is unknown"
