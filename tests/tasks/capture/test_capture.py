"""Capture against scans whose truth is known: frames, labels, boxes, rooms, views, and every way in which a scan may be written."""

from __future__ import annotations

import dataclasses
import io
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from schemas.errors import InputError
from schemas.tables import TABLES
from tasks.capture import STAGE, CaptureConfig, find_scans, run, scan_files
from tasks.capture.instances.views import run_lengths
from tasks.capture.labels import NYU40, label_map
from tasks.capture.posed_rgbd import read_posed_rgbd
from tasks.geometry.meshes import dump_glb, load_glb, read_points, surface_of
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import (
    OPENGL_TO_OPENCV,
    inverse,
    is_rigid,
    matrix,
    pose_from_quaternion_wxyz,
    quaternion_wxyz,
    quaternion_xyzw,
    transform_points,
    yaw_of,
    yaw_pose,
)
from tasks.stage import Context, Outcome
from tests.capture_scans import (
    OBJECTS,
    ROOM,
    SCAN_FROM_WORLD,
    TILT,
    BoxRoom,
    box_room,
    well_formed,
    write_posed_rgbd,
    write_scannet,
)

ROOM_INSTANCES = 6
"""Floor, four walls and ceiling come before the objects."""


@pytest.fixture(scope="module")
def room() -> BoxRoom:
    return box_room()


def captured(path: Path, format: str = "auto", config: CaptureConfig | None = None, seed: int = 3) -> Outcome:
    scans, errors = find_scans(path, format)
    assert not errors
    (scan,) = scans
    outcome = well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", seed, {}), config=config or CaptureConfig()))
    for table, rows in outcome.rows.items():
        for row in rows:
            for column in TABLES[table].blob_columns:
                name = getattr(row, column)
                assert name is None or name in outcome.blobs
    assert set(outcome.rows) == set(STAGE.writes)
    return outcome


def assert_box_room(outcome: Outcome, tolerance: float = 0.01) -> None:
    """The rows say what the truth says, up to the half turns that a box may have."""
    (scene,), (shape,) = outcome.rows["scenes"], outcome.rows["shells"]
    pose = matrix(scene.alignment)
    assert is_rigid(pose)
    # The world frame is the truth's up to a quarter turn and a shift along the floor: compare what does not depend on them.
    turned = pose @ SCAN_FROM_WORLD
    assert np.allclose(turned[:3, 2], [0, 0, 1], atol=1e-3)
    assert abs(turned[2, 3]) < tolerance
    assert min(abs(abs(yaw_of(turned)) - quarter) for quarter in (0, np.pi / 2, np.pi)) < 1e-3
    assert scene.floor_tilt_radians == pytest.approx(TILT, abs=2e-3)
    assert shape.floor_area_m2 == pytest.approx(ROOM[0] * ROOM[1], rel=0.02)
    assert shape.height_m == pytest.approx(ROOM[2], abs=0.02)
    assert len(shape.floor_polygon) == 4
    rows = outcome.rows["instances"][ROOM_INSTANCES:]
    for (label, center, size, yaw), row in zip(OBJECTS, rows, strict=True):
        assert row.category == label
        box = matrix(row.box_pose)
        assert np.allclose(transform_points([center], turned)[0], box[:3, 3], atol=tolerance)
        turn = (yaw_of(turned) + yaw - yaw_of(box)) % np.pi
        quarters = round(turn / (np.pi / 2))
        assert turn == pytest.approx(quarters * np.pi / 2, abs=0.02)
        expected = size if quarters % 2 == 0 else (size[1], size[0], size[2])
        assert np.allclose(row.box_size, expected, atol=2 * tolerance)
        assert row.box_volume_m3 == pytest.approx(np.prod(row.box_size))


VARIANTS = {
    "exported": {},
    "flat": {"frames": "flat"},
    "inner folder": {"frames": "2d"},
    "container": {"frames": "sens"},
    "no frames": {"frames": "none"},
    "not aligned": {"aligned": False},
    "prefixed": {"prefix": "scannet.", "frames": "none"},
    "other aggregation name": {"aggregation": "_vh_clean.aggregation.json", "frames": "none"},
    "bare": {"prefix": "scannet.", "aggregation": "_vh_clean.aggregation.json", "frames": "none", "aligned": False, "scene_type": None},
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_scannet_variant_tells_the_same_truth(variant: str, room: BoxRoom, tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scene0001_00", room, **VARIANTS[variant])
    outcome = captured(folder)
    assert_box_room(outcome)
    (scene,) = outcome.rows["scenes"]
    assert (scene.scene_id, scene.room_id) == ("scannet/scene0001_00", "scannet/scene0001")
    assert (scene.dataset, scene.scan) == ("scannet", "scene0001_00")
    assert scene.alignment_source == ("estimated" if VARIANTS[variant].get("aligned") is False else "file")
    assert scene.segmentation == "file"
    assert scene.instance_count == len(room.labels)
    has_frames = VARIANTS[variant].get("frames") != "none"
    assert len(outcome.rows["frames"]) == (len(room.cameras) if has_frames else 0)
    assert bool(outcome.rows["masks"]) == has_frames
    assert outcome.rows["shells"][0].room_type == ("bedroom" if VARIANTS[variant].get("scene_type", 1) else "unknown")


@pytest.mark.whole
def test_frame_sources_agree_bit_by_bit(room: BoxRoom, tmp_path: Path) -> None:
    """A container and its export are the same scan: same poses, same masks, same views."""
    outcomes = [captured(write_scannet(tmp_path / kind / "scene0001_00", room, frames=kind)) for kind in ("exported", "2d", "flat")]
    for other in outcomes[1:]:
        assert other.rows["masks"] == outcomes[0].rows["masks"]
        assert other.rows["instances"] == outcomes[0].rows["instances"]
        assert set(other.blobs) == set(outcomes[0].blobs)
    container = captured(write_scannet(tmp_path / "sens" / "scene0001_00", room, frames="sens"))
    for mine, theirs in zip(container.rows["frames"], outcomes[0].rows["frames"], strict=True):
        # A container stores float32, the text eight digits.
        assert np.allclose(mine.pose, theirs.pose, atol=1e-6)
        assert mine.color_file == f"scene0001_00.sens#{int(mine.frame_id)}"


def test_nothing_of_the_scan_is_lost(room: BoxRoom, tmp_path: Path) -> None:
    """All vertices stay in the scene's mesh; points, colors and faces of instances are the scan's own."""
    labels = room.labels[:-1]
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, frames="none", labels=labels))
    (scene,) = outcome.rows["scenes"]
    mesh = surface_of(load_glb(outcome.blobs[scene.mesh_blob]))
    world = room.surface.transformed(matrix(scene.alignment) @ SCAN_FROM_WORLD)
    assert len(mesh.vertices) == len(world.vertices) == scene.vertex_count
    assert np.allclose(mesh.vertices, world.vertices, atol=2e-5)
    assert (mesh.colors == world.colors).all()
    assert len(outcome.rows["instances"]) == len(labels)
    for index, row in enumerate(outcome.rows["instances"]):
        own = room.instance == index
        points, colors = read_points(outcome.blobs[row.points_blob])
        assert row.point_count == own.sum() == len(points)
        assert np.allclose(points, world.vertices[own], atol=2e-5)
        assert (colors == world.colors[own]).all()
        crop = surface_of(load_glb(outcome.blobs[row.mesh_blob]))
        assert len(crop.faces) == own[room.surface.faces].all(axis=1).sum()


def test_points_are_capped_by_a_seeded_choice(room: BoxRoom, tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scene0001_00", room, frames="none")
    config = CaptureConfig(max_points=500)
    first, same, other = captured(folder, config=config), captured(folder, config=config), captured(folder, config=config, seed=4)
    row = first.rows["instances"][0]
    assert row.point_count > 500
    assert len(read_points(first.blobs[row.points_blob])[0]) == 500
    assert first.rows["instances"] == same.rows["instances"]
    assert dict(first.blobs) == dict(same.blobs)
    assert row.points_blob != other.rows["instances"][0].points_blob


def test_masks_are_what_the_camera_sees(room: BoxRoom, tmp_path: Path) -> None:
    """Every mask equals the pixels at which an independent rendering of the truth shows the instance."""
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room))
    scene = RayScene([room.surface.to_trimesh()])
    face_instance = room.instance[room.surface.faces[:, 0]]
    assert outcome.rows["masks"]
    for mask in outcome.rows["masks"]:
        camera = room.cameras[int(mask.frame_id)]
        hit = scene.cast(camera.rays())["primitive_ids"].astype(np.int64)
        expected = np.where(hit < len(face_instance), face_instance[np.minimum(hit, len(face_instance) - 1)], -1) == int(mask.instance_id)
        found = np.zeros_like(expected)
        x0, y0, x1, y1 = mask.pixel_box
        found[y0:y1, x0:x1] = mask_of_runs(mask.run_lengths, mask.pixel_box)
        assert found.sum() == mask.pixel_count
        # Poses are written with eight digits: pixels on an edge may fall to either side.
        assert (found & expected).sum() / (found | expected).sum() > 0.97
    best = {row.instance_id: row.best_frames for row in outcome.rows["instances"]}
    for instance_id, frames in best.items():
        scores = [m.score for f in frames for m in outcome.rows["masks"] if (m.frame_id, m.instance_id) == (f, instance_id)]
        assert len(scores) == len(frames) <= 3
        assert scores == sorted(scores, reverse=True)
    for row in outcome.rows["instances"]:
        assert (row.view_blob is not None) == bool(row.best_frames)
        assert not (row.is_structure and row.best_frames)


def test_view_of_an_instance_shows_its_color(room: BoxRoom, tmp_path: Path) -> None:
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room))
    row = outcome.rows["instances"][ROOM_INSTANCES]
    image = np.asarray(Image.open(io.BytesIO(outcome.blobs[row.view_blob])), dtype=float)
    middle = image[image.shape[0] // 2, image.shape[1] // 2]
    color = room.surface.colors[room.instance == ROOM_INSTANCES][0].astype(float)
    # The rendering darkens by shading alone: the direction of the color stays.
    assert middle @ color / np.linalg.norm(middle) / np.linalg.norm(color) > 0.99


def test_an_occluded_view_scores_lower(room: BoxRoom, tmp_path: Path) -> None:
    """What the measured depth contradicts is not seen, whatever the mesh says."""
    folder = write_scannet(tmp_path / "scene0001_00", room)
    before = captured(folder)
    row = before.rows["instances"][ROOM_INSTANCES]
    best = int(row.best_frames[0])
    depth = np.asarray(Image.open(folder / "depth" / f"{best}.png"))
    Image.fromarray(np.minimum(depth, 300).astype(np.uint16)).save(folder / "depth" / f"{best}.png")
    after = captured(folder)
    assert f"{best:06d}" not in after.rows["instances"][ROOM_INSTANCES].best_frames


@pytest.mark.whole
def test_posed_rgbd_gets_mesh_room_and_instances(room: BoxRoom, tmp_path: Path) -> None:
    outcome = captured(write_posed_rgbd(tmp_path / "kitchen", room))
    (scene,), (shape,) = outcome.rows["scenes"], outcome.rows["shells"]
    assert (scene.scene_id, scene.segmentation, scene.alignment_source) == ("rgbd/kitchen", "geometry", "estimated")
    pose = matrix(scene.alignment) @ SCAN_FROM_WORLD
    assert np.arccos(pose[2, 2]) < np.deg2rad(1)
    assert abs(pose[2, 3]) < 0.02
    assert shape.floor_area_m2 == pytest.approx(12, rel=0.05)
    boxes = [(matrix(row.box_pose)[:3, 3], row) for row in outcome.rows["instances"] if not row.is_structure]
    for _, center, size, _ in OBJECTS:
        there = transform_points([center], pose)[0]
        nearest = min(boxes, key=lambda item: np.linalg.norm(item[0] - there))
        assert np.linalg.norm(nearest[0] - there) < 0.08
        assert np.allclose(sorted(nearest[1].box_size[:2]), sorted(size[:2]), atol=0.12)
        assert nearest[1].raw_label.startswith("geometry:")
        assert nearest[1].view_blob is not None
    assert sum(row.category == "wall" for row in outcome.rows["instances"]) == 4


CONVENTIONS = ("", "world-to-camera", "OpenGL", "OpenGL world-to-camera", "qw qx qy qz", "qw qx qy qz world-to-camera")


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_pose_convention_is_told_from_the_depth(convention: str, room: BoxRoom, tmp_path: Path) -> None:
    """Whatever a folder means by its poses, they are read as they are meant, and what was unusual is reported."""
    folder = write_posed_rgbd(tmp_path / "room", room)
    lines = []
    for line in (folder / "pose.txt").read_text().splitlines():
        x, y, z, *quaternion = (float(word) for word in line.split())
        pose = pose_from_quaternion_wxyz((quaternion[3], *quaternion[:3]), [x, y, z])
        pose = pose @ OPENGL_TO_OPENCV if "OpenGL" in convention else pose
        pose = inverse(pose) if "world" in convention else pose
        order = quaternion_wxyz(pose) if "qw" in convention else quaternion_xyzw(pose)
        lines.append(" ".join(f"{v:.8f}" for v in (*pose[:3, 3], *order)))
    truth = read_posed_rgbd(find_scans(folder)[0][0]).frames
    (folder / "pose.txt").write_text("\n".join(lines) + "\n")
    reading = read_posed_rgbd(find_scans(folder)[0][0])
    for mine, true in zip(reading.frames, truth, strict=True):
        assert np.allclose(mine.pose, true.pose, atol=1e-6)
    assert any(f"poses read as {convention}:" in note for note in reading.degradations) == bool(convention)


def test_glb_scene_is_taken_as_it_was_modelled(tmp_path: Path) -> None:
    import trimesh

    floor = trimesh.creation.box(extents=[4, 3, 0.1], transform=_moved(0, 0, -0.05))
    table = trimesh.creation.box(extents=[1.2, 0.6, 0.7], transform=yaw_pose(0.5, [0.5, 0.2, 0.35]))
    lid = trimesh.creation.box(extents=[1.2, 0.6, 0.05], transform=yaw_pose(0.5, [0.5, 0.2, 0.725]))
    obj = trimesh.creation.box(extents=[0.2, 0.2, 0.2], transform=_moved(-1, -1, 0.1))
    for part, color in ((floor, 90), (table, 160), (lid, 200), (obj, 30)):
        part.visual.vertex_colors = [color, color // 2, 10, 255]
    names = ["FloorB_01|floorb|0", "Desk_01|dining table|0", "Desk_01|dining table|1", "Gizmo.001"]
    path = tmp_path / "flat.glb"
    path.write_bytes(dump_glb([floor, table, lid, obj], names))
    outcome = captured(path)
    (scene,) = outcome.rows["scenes"]
    assert (scene.scene_id, scene.scan_format, scene.alignment_source) == ("glb/flat", "glb", "identity")
    rows = {row.source_id: row for row in outcome.rows["instances"]}
    assert set(rows) == {"FloorB_01", "Desk_01", "Gizmo.001"}
    assert (rows["FloorB_01"].category, rows["FloorB_01"].is_structure) == ("floor", True)
    assert (rows["Desk_01"].category, rows["Desk_01"].nyu40_label) == ("dining table", "table")
    assert np.allclose(rows["Desk_01"].box_size, [1.2, 0.6, 0.75], atol=1e-5)
    assert yaw_of(matrix(rows["Desk_01"].box_pose)) == pytest.approx(0.5, abs=1e-5)
    assert (rows["Gizmo.001"].nyu40_id, rows["Gizmo.001"].raw_label) == (0, "Gizmo")
    unknown = [note for note in outcome.degradations if "label map" in note]
    assert unknown == ["flat.glb: node 'Gizmo.001': 'Gizmo' is not in the label map, nyu40 class 0"]
    points, colors = read_points(outcome.blobs[rows["Gizmo.001"].points_blob])
    assert np.abs(points - [-1, -1, 0.1]).max() < 0.1 + 1e-5
    assert (colors == [30, 15, 10]).all()


def _moved(x: float, y: float, z: float) -> np.ndarray:
    return yaw_pose(0.0, [x, y, z])


@pytest.mark.parametrize("turn", [0.0, 0.3, -0.7])
def test_estimated_alignment_does_not_depend_on_how_the_scan_lay(turn: float, room: BoxRoom, tmp_path: Path) -> None:
    """A scan turned about the vertical beforehand comes out in the same world frame, up to quarter turns."""
    moved = dataclasses.replace(room, surface=room.surface.transformed(yaw_pose(turn, [3.0, 1.0, 2.0])))
    outcome = captured(write_scannet(tmp_path / "scene0001_00", moved, aligned=False, frames="none"))
    polygon = np.array(outcome.rows["shells"][0].floor_polygon)
    assert np.allclose(sorted(np.ptp(polygon, axis=0)), sorted(ROOM[:2]), atol=0.02)
    floor = outcome.rows["instances"][0]
    assert abs(floor.box_pose[11]) < 0.005
    assert floor.box_size[2] < 0.01


def test_l_shaped_room_keeps_its_corner(tmp_path: Path) -> None:
    from tests.capture_scans import plate

    pieces = [
        ("floor", plate([0, 0, 0], [4, 0, 0], [0, 2, 0])), ("floor", plate([0, 2, 0], [2, 0, 0], [0, 2, 0])),
        ("wall", plate([0, 0, 0], [0, 0, 2.5], [4, 0, 0])), ("wall", plate([4, 0, 0], [0, 0, 2.5], [0, 2, 0])),
        ("wall", plate([4, 2, 0], [0, 0, 2.5], [-2, 0, 0])), ("wall", plate([2, 2, 0], [0, 0, 2.5], [0, 2, 0])),
        ("wall", plate([2, 4, 0], [0, 0, 2.5], [-2, 0, 0])), ("wall", plate([0, 4, 0], [0, 0, 2.5], [0, -4, 0])),
    ]  # fmt: skip
    outcome = captured(write_scannet(tmp_path / "scene0001_00", _assembled(pieces), frames="none", aligned=False))
    (shape,) = outcome.rows["shells"]
    assert shape.floor_area_m2 == pytest.approx(12.0, abs=0.15)
    assert len(shape.floor_polygon) == 6
    assert (shape.height_m, shape.height_source) == (pytest.approx(2.5, abs=0.02), "walls")
    ring = np.array(shape.floor_polygon)
    following = np.roll(ring, -1, axis=0)
    assert 0.5 * (ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]).sum() == pytest.approx(shape.floor_area_m2, abs=1e-6)
    for wall, corner, end in zip(shape.walls, ring, following, strict=True):
        assert np.allclose(wall, [*corner, *end])


def _assembled(pieces: list) -> BoxRoom:  # type: ignore[type-arg]
    from tasks.geometry.meshes import Surface

    offsets = np.cumsum([0, *(len(points) for _, (points, _) in pieces)])
    vertices = np.concatenate([points for _, (points, _) in pieces])
    faces = np.concatenate([triangles + offset for (_, (_, triangles)), offset in zip(pieces, offsets, strict=False)])
    instance = np.concatenate([np.full(len(points), i) for i, (_, (points, _)) in enumerate(pieces)])
    surface = Surface(vertices, faces, np.full((len(vertices), 3), 99, dtype=np.uint8))
    return BoxRoom(surface, instance, tuple(label for label, _ in pieces), ())


def test_boxes_ignore_stray_points() -> None:
    from tasks.capture.instances.boxes import oriented_box

    rng = np.random.default_rng(5)
    body = rng.uniform(-0.5, 0.5, (6000, 3)) * [0.8, 0.5, 1.0]
    face = rng.integers(0, 3, len(body))
    body[np.arange(len(body)), face] = np.sign(body[np.arange(len(body)), face]) * (np.array([0.8, 0.5, 1.0]) / 2)[face]
    pose = yaw_pose(0.6, [1, 2, 0.5])
    stray = rng.uniform([-0.5, 0.5, -1.0], [2.5, 3.5, 2.0], (30, 3))
    box, size = oriented_box(np.concatenate([transform_points(body, pose), stray]))
    assert np.allclose(sorted(size), [0.5, 0.8, 1.0], atol=0.02)
    assert np.allclose(box[:3, 3], [1, 2, 0.5], atol=0.02)
    assert yaw_of(box) == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_boxes_of_a_few_points(count: int) -> None:
    from tasks.capture.instances.boxes import oriented_box

    points = np.array([[1.0, 2.0, 3.0], [1.5, 2.5, 3.0], [2.0, 3.0, 3.5]])[:count]
    box, size = oriented_box(points)
    local = transform_points(points, inverse(box))
    assert (np.abs(local) <= size / 2 + 1e-9).all()


def test_labels_agree_with_the_map_in_use(realdata: Callable[[str], Path]) -> None:
    """Where our own map and ScanNet's both know a label, they say the same class, but for a handful of judgement calls."""
    theirs = label_map(str(realdata("labels/scannetv2-labels.combined.tsv")))
    ours = label_map()
    common = [raw for raw in theirs.entries if raw in ours.entries]
    differ = [raw for raw in common if theirs.entries[raw][1] != ours.entries[raw][1]]
    assert len(common) > 350
    assert len(differ) <= 0.01 * len(common), differ


def test_own_labels_are_well_formed() -> None:
    labels = label_map()
    assert len(NYU40) == 41
    assert {nyu40 for _, nyu40 in labels.entries.values()} == set(range(1, 41))
    for category, nyu40 in set(labels.entries.values()):
        assert labels.entries[category] == (category, nyu40), "a category is its own raw label"
    assert labels["Kitchen_Cabinets"] == labels["kitchen cabinet"]
    assert labels["couch"].category == "sofa"
    assert labels["night stand"].nyu40_label == "night stand"
    assert (labels["flux capacitor"].nyu40_id, labels["flux capacitor"].is_known) == (0, False)


def test_labels_know_what_the_generator_makes() -> None:
    furniture = pytest.importorskip("tasks.furniture")
    labels = label_map()
    unknown = [category for category in furniture.CATEGORIES if not labels[category].is_known]
    assert not unknown


def test_user_label_map_is_used_and_fingerprinted(room: BoxRoom, tmp_path: Path) -> None:
    table = tmp_path / "map.tsv"
    table.write_text("id\traw_category\tcategory\tnyu40id\n1\ttable\twork surface\t14\n2\tfloor\tfloor\t2\n")
    config = CaptureConfig(label_map=str(table))
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, frames="none"), config=config)
    row = outcome.rows["instances"][ROOM_INSTANCES]
    assert (row.category, row.nyu40_id) == ("work surface", 14)
    assert any("'chair' is not in the label map" in note for note in outcome.degradations)
    table.write_text(table.read_text() + "3\tchair\tchair\t5\n")
    assert CaptureConfig(label_map=str(table)) != config
    with pytest.raises(InputError, match="has changed"):
        captured(tmp_path / "scene0001_00", config=config)


def mask_of_runs(lengths: Sequence[int], pixel_box: Sequence[int]) -> np.ndarray:
    """The mask, shape (y1 - y0, x1 - x0), of run lengths; inverse of `run_lengths`."""
    values = np.arange(len(lengths)) % 2 == 1
    return np.repeat(values, lengths).reshape(pixel_box[3] - pixel_box[1], pixel_box[2] - pixel_box[0])


def test_run_lengths_round_trip() -> None:
    rng = np.random.default_rng(0)
    for height, width in ((1, 1), (3, 5), (17, 9)):
        for share in (0.0, 0.3, 1.0):
            mask = rng.random((height, width)) < share
            assert (mask_of_runs(run_lengths(mask), (0, 0, width, height)) == mask).all()
            assert sum(run_lengths(mask)) == mask.size


@pytest.mark.whole
def test_real_dining_room(realdata: Callable[[str], Path]) -> None:
    """Five Kinect frames of a real room: instances are found, and the floor is level after alignment."""
    outcome = captured(realdata("rgbd_slambook_dining"))
    (scene,) = outcome.rows["scenes"]
    objects = [row for row in outcome.rows["instances"] if not row.is_structure]
    assert len(objects) >= 5
    assert sum(row.view_blob is not None for row in objects) >= 5
    # Independent of how the floor was found: the plane through everything low, fitted anew.
    vertices = surface_of(load_glb(outcome.blobs[scene.mesh_blob])).vertices
    low = vertices[np.abs(vertices[:, 2]) < 0.15]
    for _ in range(10):
        normal = np.linalg.svd(low - low.mean(axis=0), full_matrices=False)[2][2]
        low = low[np.abs((low - low.mean(axis=0)) @ normal) < 0.04]
    assert len(low) > 5000
    assert np.arccos(abs(normal[2])) < np.deg2rad(3)
    assert abs(low[:, 2].mean()) < 0.03
    # The cameras were carried by a person, above the floor and below any ceiling.
    heights = [frame.pose[11] for frame in outcome.rows["frames"]]
    assert all(0.8 < height < 2.0 for height in heights)


@pytest.mark.whole
def test_real_modelled_house(realdata: Callable[[str], Path]) -> None:
    """A house of named nodes: instances, boxes and floor as its own description gives them."""
    folder = realdata("scene_aws_small_house")
    truth = {entry["name"]: entry for entry in json.loads((folder / "house.json").read_text())}
    outcome = captured(folder / "house.glb")
    rows = {row.source_id: row for row in outcome.rows["instances"]}
    assert set(rows) == set(truth)
    for name, row in rows.items():
        low, high = (np.array(corner) for corner in truth[name]["bounds"])
        pose, half = matrix(row.box_pose), np.array(row.box_size) / 2
        reach = np.abs(pose[:3, :3]) @ half
        assert (pose[:3, 3] + reach >= high - 0.01).all()
        assert (pose[:3, 3] - reach <= low + 0.01).all()
    (shape,) = outcome.rows["shells"]
    assert shape.height_m == pytest.approx(3.0, abs=0.05)
    # Its outer walls are 20 cm thick, and its floor runs on below them: the room ends at their inner faces.
    ring = np.array(shape.floor_polygon)
    assert np.allclose([ring.min(axis=0), ring.max(axis=0)], [[-9.3, -5.5], [9.3, 5.5]], atol=0.03)
    assert len(ring) == 8
    assert {rows[name].category for name in rows if "Wall" in name} == {"wall"}
    assert rows["FloorB_01_001"].category == "floor"


def test_frames_are_referred_to_where_they_lie(room: BoxRoom, tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scene0001_00", room, frames="2d")
    outcome = captured(folder)
    for frame, camera in zip(outcome.rows["frames"], room.cameras, strict=True):
        assert (folder / frame.color_file).is_file()
        assert (folder / frame.depth_file).is_file()
        assert frame.intrinsics == pytest.approx((camera.fx, camera.fy, camera.cx, camera.cy))
    listed = scan_files(find_scans(folder)[0][0])
    assert listed == sorted(listed)
    assert {folder / frame.color_file for frame in outcome.rows["frames"]} <= set(listed)


def test_license_is_the_first_line(room: BoxRoom, tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scene0001_00", room, frames="none")
    assert captured(folder).rows["scenes"][0].license is None
    (folder / "LICENSE.txt").write_text("CC0-1.0\nand more words\n")
    assert captured(folder).rows["scenes"][0].license == "CC0-1.0"
    assert folder / "LICENSE.txt" in scan_files(find_scans(folder)[0][0])


def test_large_mesh_is_thinned_and_says_so(room: BoxRoom, tmp_path: Path) -> None:
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, frames="none"), config=CaptureConfig(max_faces=9000))
    (scene,) = outcome.rows["scenes"]
    assert scene.face_count == len(room.surface.faces)
    parts = load_glb(outcome.blobs[scene.mesh_blob])
    assert len(parts[0].faces) <= 9500
    assert any("thinned" in note for note in outcome.degradations)
    assert len(outcome.rows["instances"]) == len(room.labels)


def test_where_the_scan_lies_does_not_matter(room: BoxRoom, tmp_path: Path) -> None:
    """The same files elsewhere give the same rows, but for the volatile path, and the same blobs."""
    here = write_scannet(tmp_path / "a" / "scene0001_00", room)
    there = tmp_path / "b" / "c" / "scene0001_00"
    shutil.copytree(here, there)
    first, second = captured(here), captured(there)
    assert set(first.blobs) == set(second.blobs)
    for table in first.rows:
        volatile = TABLES[table].volatile_columns
        plain = [[dataclasses.replace(row, **dict.fromkeys(volatile, "")) for row in o.rows[table]] for o in (first, second)]
        assert plain[0] == plain[1]
    assert str(tmp_path) not in repr([row for table, rows in first.rows.items() if table != "scenes" for row in rows])


def test_camera_of_the_truth_projects_into_masks(room: BoxRoom, tmp_path: Path) -> None:
    """Poses in the lake are camera to world: an instance's points project into its own mask's box."""
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, aligned=False))
    frames = {frame.frame_id: frame for frame in outcome.rows["frames"]}
    points = {row.instance_id: read_points(outcome.blobs[row.points_blob])[0] for row in outcome.rows["instances"]}
    for mask in outcome.rows["masks"]:
        frame = frames[mask.frame_id]
        camera = Camera(matrix(frame.pose), *frame.intrinsics, frame.width, frame.height)
        pixel, depth = camera.project(points[mask.instance_id])
        x0, y0, x1, y1 = mask.pixel_box
        inside = (depth > 0) & (pixel >= -0.5).all(axis=1) & (pixel[:, 0] < frame.width - 0.5) & (pixel[:, 1] < frame.height - 0.5)
        in_box = (pixel >= [x0 - 1.5, y0 - 1.5]).all(axis=1) & (pixel <= [x1 + 0.5, y1 + 0.5]).all(axis=1)
        if mask.visible_share > 0.6:
            assert (inside & in_box).sum() > 0.9 * inside.sum()


@pytest.mark.whole
def test_scan_of_a_furnished_room_against_its_truth(tmp_path: Path) -> None:
    """A noisy virtual scan, without alignment: room and boxes come out where the furniture stood."""
    import shapely

    from tasks.furniture.rooms import furnish
    from tasks.scanner import ScannerConfig, scan_scene

    rng = np.random.default_rng(8)
    room = furnish("bedroom", rng, object_count=10)
    scan_scene(room, tmp_path, "scene0000_00", ScannerConfig(axis_alignment=False, frames="sens"), rng)
    truth = json.loads((tmp_path / "scene0000_00.truth.json").read_text())
    outcome = captured(tmp_path / "scene0000_00")
    (scene,), (shape,) = outcome.rows["scenes"], outcome.rows["shells"]
    world = matrix(scene.alignment) @ inverse(matrix(np.ravel(truth["alignment"])))
    assert np.arccos(min(1.0, world[2, 2])) < np.deg2rad(0.5)
    assert abs((yaw_of(world) + np.pi / 4) % (np.pi / 2) - np.pi / 4) < np.deg2rad(0.7)
    assert abs(world[2, 3]) < 0.03
    corners = np.column_stack([truth["polygon"], np.zeros(len(truth["polygon"]))])
    expected, found = shapely.Polygon(transform_points(corners, world)[:, :2]), shapely.Polygon(shape.floor_polygon)
    assert expected.intersection(found).area / expected.union(found).area > 0.95
    assert shape.height_m == pytest.approx(truth["height_m"], abs=0.05)
    of_id = {str(obj["object_id"]): obj for obj in truth["objects"] if obj["object_id"] is not None}
    errors = []
    for row in outcome.rows["instances"]:
        obj = of_id[row.source_id]
        assert row.category == obj["category"]
        if not row.is_structure:
            center = matrix(np.ravel(obj["pose"])) @ [0, 0, obj["extents"][2] / 2, 1]
            errors.append(np.linalg.norm((world @ center)[:3] - matrix(row.box_pose)[:3, 3]))
    assert len(errors) >= 8
    assert np.median(errors) < 0.04
    for row in outcome.rows["instances"]:
        assert (row.hidden_m is None) == row.is_structure
        if row.hidden_m is not None:
            true_bottom = (world @ matrix(np.ravel(of_id[row.source_id]["pose"])))[2, 3]
            drawn = row.box_pose[11] - 0.5 * row.box_size[2] - row.hidden_m[4]
            assert row.hidden_m[4] == 0 or drawn == pytest.approx(true_bottom, abs=0.03), "drawn to where it ends, and no farther"
    assert scene.license == "CC0-1.0"
