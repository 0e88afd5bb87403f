"""What the page is told of a scene: what the rows say, of one snapshot, and nothing that they do not name."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from flows.outputs.explain import explain, explain_objects, settings_of
from flows.view import scene
from flows.view.application import explanation
from flows.view.frames import picture
from flows.view.scene import Scenes
from schemas.capture import Frame, Instance, Scene
from schemas.errors import InputError
from schemas.optimization import Placement
from schemas.selection import Selection
from tasks.geometry.meshes import load_glb
from tasks.lineage.outline import outline
from tests.flows.view.lakes import EVIL, FRAME_PX, OBJECTS, SCENES, UNSTABLE, shown_lake
from tests.samples import sample
from warehouse.lake import Lake


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return shown_lake(tmp_path_factory.mktemp("view"))


@pytest.fixture(scope="module")
def scenes(lake: Lake) -> Scenes:
    return Scenes(lake)


def test_objects_are_told_as_their_rows_say(lake: Lake, scenes: Scenes) -> None:
    reader = lake.snapshot()
    told = {row["id"]: row for row in scenes.shown(SCENES[0]).document["objects"]}
    assert list(told) == [row.instance_id for row in reader.rows(Instance, SCENES[0])]
    for row in reader.rows(Placement, SCENES[0]):
        placed = told[row.instance_id]["placed"]
        assert (placed["asset"], placed["scale"]) == (row.asset_id, row.scale)
        assert placed["poses"] == {"proposed": row.proposed_pose, "optimized": row.optimized_pose, "settled": row.settled_pose}
    for row in reader.rows(Selection, SCENES[0]):
        (offer,) = [offer for offer in told[row.instance_id]["candidates"] if offer["slot"] == row.slot]
        assert (offer["asset"], offer["rank"], offer["score"], offer["pose"]) == (row.asset_id, row.rank, row.score, row.pose)
    for row in told.values():
        assert [offer["rank"] for offer in row["candidates"]] == [1, 2, None]
        assert [offer["placed"] for offer in row["candidates"]] == [True, False, False]
        assert row["unstable"] == (["mujoco"] if row["id"] == UNSTABLE else [])
    assert told["0003"]["support"] == {"relation": "on", "parent": "0001", "against": None, "fixed": False}


def test_structure_is_no_object_and_boxes_alone_are_no_contact(scenes: Scenes) -> None:
    document = scenes.shown(SCENES[0]).document
    assert len(document["objects"]) == OBJECTS
    assert [(row["phase"], row["a"], row["b"], row["depth"]) for row in document["contacts"]] == [
        ("proposed", "0000", "0001", 0.05), ("proposed", "0002", "wall_00", 0.001),
    ]  # fmt: skip


def test_colliders_are_those_of_the_export(scenes: Scenes) -> None:
    """In the asset's frame, as many pieces as were exported; an object that was not exported has none."""
    blobs = [row["collider"] for row in scenes.shown(SCENES[0]).document["objects"]]
    assert len({*blobs[:-1]}) == 1
    assert blobs[-1] is None
    assert len(load_glb(scenes.blob(blobs[0]))) == 2


def test_the_navmesh_is_told_in_the_world_frame(scenes: Scenes) -> None:
    (row,) = scenes.shown(SCENES[0]).document["navmeshes"]
    told = json.loads(scenes.blob(row["blob"]))
    corners = np.array(told["points"])[np.array(told["triangles"])]
    (a, b) = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    signed = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    assert (signed > 0).all(), "counter-clockwise, seen from above"
    assert signed.sum() / 2 == pytest.approx(6.0, abs=1e-3)
    assert np.abs(corners.reshape(-1, 2)).max(axis=0) == pytest.approx([1.5, 1.0], abs=1e-3)


def test_the_room_has_a_part_for_every_wall(scenes: Scenes) -> None:
    document = scenes.shown(SCENES[0]).document
    names = {str(part.metadata.get("name")) for part in load_glb(scenes.blob(document["shell"]))}
    assert names >= {"floor", *(f"wall_{index:02d}" for index in range(len(document["room"]["polygon"])))}


def test_only_what_a_shown_scene_names_is_given_out(lake: Lake) -> None:
    scenes, hidden = Scenes(lake), lake.blobs.put(b"of no row", "glb")
    named = lake.snapshot().rows(Scene, SCENES[0])[0].mesh_blob
    with pytest.raises(KeyError):
        scenes.blob(named)
    shown = scenes.shown(SCENES[0])
    assert scenes.blob(named) == lake.blobs[named]
    for name in (*shown.blobs, *shown.made):
        assert scenes.blob(name)
    points = lake.snapshot().rows(Instance, SCENES[0])[0].points_blob
    for name in (hidden, points, "../lake.json", "lake.json", ""):
        with pytest.raises(KeyError):
            scenes.blob(name)


def test_what_was_made_for_a_scene_is_made_again_after_others(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page stays open longer than what was made for it is kept."""
    monkeypatch.setattr(scene, "shell_glb", lambda shells, *_: shells[0].scene_id.encode())  # else both rooms have the same
    scenes = Scenes(lake, kept=1)
    made = [dict(scenes.shown(scene_id).made) for scene_id in SCENES]
    assert all(made)
    for name, data in [*made[0].items(), *made[1].items(), *made[0].items()]:
        assert scenes.blob(name) == data


def test_a_snapshot_stays_as_it_was(tmp_path: Path) -> None:
    lake = shown_lake(tmp_path)
    before = Scenes(lake, lake.snapshot().snapshot_id)
    lake.remove_scene(SCENES[1])
    assert [row["id"] for row in before.listed()["scenes"]] == list(SCENES)
    assert before.shown(SCENES[1]).document["id"] == SCENES[1]
    now = Scenes(lake)
    assert [row["id"] for row in now.listed()["scenes"]] == [SCENES[0]]
    with pytest.raises(InputError, match="there is no such scene"):
        now.shown(SCENES[1])


def test_a_lake_without_scenes_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no snapshot yet"):
        Scenes(Lake.open(tmp_path / "new"))
    lake = shown_lake(tmp_path)
    for scene_id in SCENES:
        lake.remove_scene(scene_id)
    with pytest.raises(InputError, match="has no scene"):
        Scenes(lake).first()


def test_explanations_are_those_of_the_command(lake: Lake, scenes: Scenes) -> None:
    """Of one object and of several at once, whose rows are read once."""
    ids = [f"{index:04d}" for index in range(OBJECTS)]
    several = explain_objects(lake, SCENES[1], ids)
    for instance_id in ids:
        alone = explain(lake, f"{SCENES[1]}/{instance_id}")
        assert several[instance_id].document() == alone.document()
        assert explanation(scenes, SCENES[1], instance_id) == outline(alone, settings_of)
    with pytest.raises(InputError, match="no such object"):
        explanation(scenes, SCENES[1], "9999")
    with pytest.raises(InputError, match="no instance 9999"):
        explain_objects(lake, SCENES[1], ["9999"])


def test_labels_are_told_as_they_are(scenes: Scenes) -> None:
    assert {row["category"] for row in scenes.shown(SCENES[1]).document["objects"]} == {EVIL}


def test_frames_are_drawn_anew_from_the_scans_folder(scenes: Scenes) -> None:
    document = scenes.shown(SCENES[0]).document
    assert document["frames"] == {"excuse": "", "rows": [{"id": "000000", "masks": OBJECTS}]}
    masks = scenes.masks(SCENES[0], "000000")
    for mask in masks["masks"]:
        x0, y0, x1, y1 = mask["box"]
        assert sum(mask["runs"]) == (x1 - x0) * (y1 - y0)
    frame = scenes.frame(SCENES[0], "000000")
    with Image.open(io.BytesIO(picture(scenes.scan_path(SCENES[0]), frame))) as image:
        assert (image.format, image.size) == ("JPEG", FRAME_PX)
    with pytest.raises(InputError, match="no such frame"):
        scenes.masks(SCENES[0], "000001")


def test_frames_that_are_not_in_the_scans_folder_are_not_shown(tmp_path: Path) -> None:
    scan, secret = tmp_path / "scan", tmp_path / "secret.jpg"
    scan.mkdir()
    Image.new("RGB", (8, 6)).save(secret)
    (scan / "link.jpg").symlink_to(secret)
    (scan / "text.jpg").write_text("no picture")
    names = ("../secret.jpg", str(secret), "link.jpg", "text.jpg", "no.jpg")
    frames = {name: sample(Frame, color_file=name, width=8, height=6) for name in names}
    for frame in frames.values():
        with pytest.raises(InputError):
            picture(str(scan), frame)
    with pytest.raises(InputError, match="not at hand"):
        picture(str(tmp_path / "gone"), frames["no.jpg"])
    with pytest.raises(InputError, match="not at hand"):
        picture("s3://bucket/scan", frames["no.jpg"])
