"""Alignments of Scan2CAD: models go where they were aligned to, whatever frames lie between; what cannot be taken is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from tasks.annotation.batch import read_answers
from tasks.annotation.scan2cad import read_scan2cad
from tasks.geometry.transforms import Y_UP_TO_Z_UP, flat, inverse, matrix, pose_from_quaternion_wxyz, quaternion_wxyz, translation, yaw_pose
from tests.samples import START, sample

HALF, CENTER, UNIT = np.array([0.3, 0.5, 0.2]), np.array([0.1, -0.2, 0.05]), 0.8
"""Box of the model in its own frame, +Y up, and metres per unit of it in the library."""


def trs(pose: np.ndarray, scale: Any = (1.0, 1.0, 1.0)) -> dict[str, Any]:
    return {"translation": pose[:3, 3].tolist(), "rotation": list(quaternion_wxyz(pose)), "scale": list(scale)}


def lake_rows(
    target: np.ndarray, size: np.ndarray, alignment: np.ndarray
) -> tuple[list[Scene], list[Instance], list[Candidate], list[Asset]]:
    """A scene with an object where the model will stand, which is its second candidate."""
    extents = tuple(2 * UNIT * HALF[[0, 2, 1]])
    assets = [
        sample(Asset, asset_id="a" * 64, name="other", source="other.glb", extents=(1.0, 1.0, 1.0)),
        sample(Asset, asset_id="b" * 64, name="model_normalized", source="03001627/c0ffee/model_normalized.glb", extents=extents),
    ]
    box = target @ translation([0, 0, size[2] / 2])
    place = {"scene_id": "scannet/scene0470_00", "instance_id": "0003"}
    instances = [sample(Instance, **place, is_structure=False, box_pose=flat(box), box_size=tuple(size))]
    candidates = [sample(Candidate, **place, slot=slot, asset_id=letter * 64, outcome="filled") for slot, letter in ((1, "a"), (2, "b"))]
    scenes = [sample(Scene, scene_id="scannet/scene0470_00", scan="scene0470_00", alignment=flat(alignment))]
    return scenes, instances, candidates, assets


def scan(*models: dict[str, Any], frame: np.ndarray | None = None, **values: Any) -> list[dict[str, Any]]:
    return [{"id_scan": "scene0470_00", "trs": trs(np.eye(4) if frame is None else frame), "aligned_models": list(models)} | values]


def model(pose: np.ndarray, scale: Any, **values: Any) -> dict[str, Any]:
    usual = {"catid_cad": "03001627", "id_cad": "c0ffee", "center": CENTER.tolist(), "bbox": HALF.tolist(), "sym": "__SYM_NONE"}
    return usual | {"trs": trs(pose, scale)} | values


angles = st.floats(-3, 3)


@given(turns=st.tuples(angles, angles, angles), scale=st.tuples(*[st.floats(0.5, 2.0)] * 3), shift=st.tuples(*[st.floats(-5, 5)] * 3))
def test_every_point_of_a_model_goes_where_it_was_aligned_to(turns: Any, scale: Any, shift: Any) -> None:
    """Corners of the model by way of Scan2CAD's frames and the scene's, and by way of the answer, are the same points of the world."""
    alignment, frame = yaw_pose(turns[0], [1, 2, 3]), pose_from_quaternion_wxyz([0.5, -0.5, 0.5, 0.5], shift)
    world_from_cad = yaw_pose(turns[1], shift) @ Y_UP_TO_Z_UP
    pose = frame @ inverse(alignment) @ world_from_cad
    size = 2 * (HALF * scale)[[0, 2, 1]]
    bottom = world_from_cad @ np.array([*(scale * (CENTER - [0, HALF[1], 0])), 1.0])
    target = yaw_pose(turns[1], bottom[:3])
    rows = lake_rows(target, size, alignment)
    aligned = read_scan2cad(scan(model(pose, scale), frame=frame), "s.json", "b", "s2c", START, *rows)
    assert aligned.left_out == ()
    (answer,) = read_answers(aligned.document, "s.json").annotations
    assert (answer.scene_id, answer.instance_id, answer.choice, answer.tool) == ("scannet/scene0470_00", "0003", "b" * 64, "Scan2CAD")
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * HALF + CENTER
    world = (scale * corners) @ world_from_cad[:3, :3].T + world_from_cad[:3, 3]
    in_asset = UNIT * (corners @ Y_UP_TO_Z_UP[:3, :3].T)
    in_asset -= [*(in_asset.min(axis=0) + in_asset.max(axis=0))[:2] / 2, in_asset[:, 2].min()]
    placed = matrix(answer.pose or ())
    assert np.allclose((np.array(answer.scale) * in_asset) @ placed[:3, :3].T + placed[:3, 3], world, atol=1e-6)


def test_what_cannot_be_taken_is_named() -> None:
    alignment, scale = np.eye(4), (1.0, 1.0, 1.0)
    pose = yaw_pose(0.0, [0, 0, 1]) @ Y_UP_TO_Z_UP
    target = pose @ np.array([*(CENTER - [0, HALF[1], 0]), 1.0])
    rows = lake_rows(yaw_pose(0.0, target[:3]), 2 * HALF[[0, 2, 1]], alignment)
    away = translation([9, 0, 0]) @ pose
    near = translation([0.02, 0, 0]) @ pose
    document = scan(model(pose, scale), model(pose, scale, id_cad="beef"), model(away, scale), model(near, scale))
    document += scan(id_scan="scene9999_00")
    aligned = read_scan2cad(document, "s.json", "b", "s2c", START, *rows)
    assert aligned.left_out == (
        "[0].aligned_models[1]: 03001627/beef: no candidate of scannet/scene0470_00 0003 is that model",
        "[0].aligned_models[2]: 03001627/c0ffee: no instance lies where it is aligned",
        "[0].aligned_models[3]: 03001627/c0ffee: another model is aligned to scannet/scene0470_00 0003, too, and covers it no worse",
        "[1]: scan scene9999_00 is not in the lake",
    )
    (kept,) = aligned.document["annotations"]
    assert kept["transform"]["position"][0] == pytest.approx(target[0]), "the one that covers it best"


@pytest.mark.parametrize("is_better_first", [True, False])
def test_of_two_models_for_one_object_the_worse_is_left_out_and_named(is_better_first: bool) -> None:
    pose = yaw_pose(0.0, [0, 0, 1]) @ Y_UP_TO_Z_UP
    target = pose @ np.array([*(CENTER - [0, HALF[1], 0]), 1.0])
    rows = lake_rows(yaw_pose(0.0, target[:3]), 2 * HALF[[0, 2, 1]], np.eye(4))
    models = [model(pose, (1.0, 1.0, 1.0)), model(translation([0.02, 0, 0]) @ pose, (1.0, 1.0, 1.0))]
    aligned = read_scan2cad(scan(*(models if is_better_first else models[::-1])), "s.json", "b", "s2c", START, *rows)
    (line,) = aligned.left_out
    assert line.startswith(f"[0].aligned_models[{int(is_better_first)}]: ")
    (kept,) = aligned.document["annotations"]
    assert kept["transform"]["position"][0] == pytest.approx(target[0])


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"trs": 1}, "[0].trs"),
        ({"trs": trs(np.eye(4), (2, 2, 2))}, "[0].trs.scale"),
        ({"trs": trs(np.eye(4)) | {"rotation": [1, 1, 0, 0]}}, "[0].trs.rotation"),
        ({"aligned_models": [{}]}, "[0].aligned_models[0]"),
        ({"aligned_models": [model(np.eye(4), (1, -1, 1))]}, "[0].aligned_models[0].trs.scale"),
        ({"aligned_models": [model(np.eye(4), (1, 1, 1), bbox=[1, 0, 1])]}, "[0].aligned_models[0].bbox"),
        ({"aligned_models": [model(np.eye(4), (1, 1, 1), center=[1e9, 0, 1])]}, "[0].aligned_models[0].center"),
        ({"aligned_models": [model(np.eye(4), (1, 1, 1), id_cad="")]}, "[0].aligned_models[0].id_cad"),
        ({"aligned_models": [model(np.eye(4), (1, 1, 10**400))]}, "[0].aligned_models[0].trs.scale"),
        ({"id_scan": None}, "[0].id_scan"),
    ],
)
def test_a_file_that_is_not_scan2cads_is_refused_with_its_place(values: dict[str, Any], field: str) -> None:
    rows = lake_rows(np.eye(4), np.ones(3), np.eye(4))
    with pytest.raises(InputError) as caught:
        read_scan2cad(scan(**values), "s.json", "b", "s2c", START, *rows)
    assert (caught.value.file, caught.value.field) == ("s.json", field)
