"""Placements that people chose come first, found again after a recapture, or are orphaned."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import trimesh

from schemas.annotation import Annotation
from schemas.selection import Selection
from tasks.geometry.transforms import flat, matrix, translation, yaw_pose
from tests.samples import START, sample
from tests.tasks.optimization.scenes import (
    SCENE,
    TABLE,
    Scene,
    block,
)


def annotated(scene: Scene, name: str, parts: Sequence[trimesh.Trimesh] | None, **values: Any) -> Annotation:
    instance = next(i for i in scene.instances if i.instance_id == name)
    given = {
        "scene_id": SCENE, "instance_id": name, "annotator": "ada", "answered_at": START, "batch_id": "b1", "ranking": (),
        "pose": None, "scale": None,
        "choice": scene.asset(parts) if parts is not None else None, "box_pose": instance.box_pose, "box_size": instance.box_size,
    }  # fmt: skip
    scene.annotations.append(sample(Annotation, **(given | values)))
    return scene.annotations[-1]


def test_a_persons_choice_comes_first() -> None:
    scene = Scene()
    name = scene.add(block(0.5, 0.5, 0.5), yaw_pose(0.3, [1, 0, 0]))
    pose = yaw_pose(1.0, [0.9, 0.1, 0.02])
    annotated(scene, name, TABLE, pose=flat(pose), scale=(1.0, 0.9, 1.0))
    row = scene.run().rows["placements"][0]
    assert (row.origin, row.annotator, row.annotation_match) == ("annotation", "ada", "same_box")
    assert row.asset_id == scene.annotations[0].choice
    assert np.allclose(row.proposed_pose, flat(pose))
    assert row.scale == (1.0, 0.9, 1.0)
    assert matrix(row.optimized_pose)[2, 3] == pytest.approx(0.0, abs=1e-9)


def test_a_choice_without_a_transform_is_placed_as_aligned() -> None:
    scene = Scene()
    name = scene.add(block(0.5, 0.5, 0.5), yaw_pose(0.3, [1, 0, 0]))
    other = scene.asset(TABLE)
    aligned = sample(
        Selection,
        scene_id=SCENE,
        instance_id=name,
        rank=2,
        slot=2,
        asset_id=other,
        pose=flat(yaw_pose(0.7, [1.1, 0, 0])),
        scale=(0.5, 0.5, 0.7),
    )
    scene.selections.append(aligned)
    annotated(scene, name, TABLE)
    row = scene.run().rows["placements"][0]
    assert (row.origin, row.asset_id, row.proposed_pose, row.scale) == ("annotation", other, aligned.pose, aligned.scale)


def test_annotations_are_found_again_after_a_recapture_or_orphaned() -> None:
    """Instances are numbered anew: what was 0000 is 0001 now, its box a little off; the other one is gone."""
    scene = Scene()
    for x in (-1.0, 1.0):
        scene.add(block(0.5, 0.5, 0.5), translation([x, 0, 0]))
    row = annotated(scene, "0000", TABLE, pose=flat(translation([1, 0, 0])), scale=(0.5, 0.5, 0.5))
    moved = flat(matrix(scene.instances[1].box_pose) @ yaw_pose(0.1, [0.03, 0.02, 0.01]))
    scene.annotations = [
        dataclasses.replace(row, box_pose=moved),
        dataclasses.replace(row, batch_id="b2", annotator="bob", box_pose=flat(translation([0, 1.5, 0.2]))),
    ]
    outcome = scene.run()
    first, second = outcome.rows["placements"]
    assert (first.origin, first.annotator, first.annotation_match) == ("selection", None, None)
    assert (second.origin, second.annotator, second.annotation_match) == ("annotation", "ada", "box_iou")
    assert [text for text in outcome.degradations if "orphaned" in text and "bob" in text and "b2" in text]
    assert len([text for text in outcome.degradations if "orphaned" in text]) == 1


def test_what_stands_in_is_said() -> None:
    scene = Scene()
    kept, gone, bare, broken = (scene.add(block(0.3, 0.3, 0.3 + i / 10), translation([i - 1.5, 0, 0])) for i in range(4))
    annotated(scene, kept, None)
    annotated(scene, gone, None, choice="e" * 64, pose=flat(np.eye(4)), scale=(1.0, 1.0, 1.0))
    scene.selections = [s for s in scene.selections if s.instance_id != bare]
    asset = next(s.asset_id for s in scene.selections if s.instance_id == broken)
    scene.assets[asset] = dataclasses.replace(scene.assets[asset], mesh_blob=scene.blobs.add(b"no mesh", "glb"))
    outcome = scene.run()
    assert [(row.instance_id, row.origin) for row in outcome.rows["placements"]] == [(kept, "selection"), (gone, "selection")]
    for name, word in (
        (kept, "no candidate fits"),
        (gone, "no candidate any more"),
        (bare, "no candidate could be used"),
        (broken, "not a readable GLB"),
    ):
        assert any(text.startswith(name) and word in text for text in outcome.degradations), (name, outcome.degradations)
