"""Scans of several floors on disk: a scan of each in a format that is read, joined again to the same surface; nothing half or twice."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from flows.scans.storeys import ScanStoreys, divide_scans
from tasks.capture import CaptureConfig
from tasks.capture.formats import find_scans, format_of, room_of
from tasks.capture.layout import STOREYS_RECORD as RECORD
from tasks.capture.reading import Reading
from tasks.geometry.meshes import Surface, dump_glb, surface_of, union_of
from tasks.geometry.proximity import closest_points
from tasks.geometry.rendering import Camera
from tasks.geometry.transforms import inverse, look_at, transform_points
from tasks.geometry.triangles import surface_area
from tests.capture_scans import SCAN_FROM_WORLD, BoxRoom, ply_bytes, write_posed_rgbd, write_scannet
from tests.tasks.capture.formats.phones import write_record3d, write_stray_scanner
from tests.tasks.capture.formats.written import write_arkitscenes
from tests.tasks.capture.storeys.houses import House, house_of

HOUSE = house_of(2, (7.0, 9.0), 2.5, 0.3)


def cameras(house: House, count: int = 3) -> tuple[Camera, ...]:
    """Some in each storey, at the height of eyes."""
    angles = 2 * np.pi * np.arange(count) / count
    return tuple(
        Camera.with_fov(look_at([3.5, 4.0, z + 1.5], [3.5 + 2 * np.cos(a), 4.0 + 2 * np.sin(a), z + 0.8]), 64, 48, 1.2)
        for z in house.floors
        for a in angles
    )


def room_from(house: House) -> BoxRoom:
    return BoxRoom(house.surface, house.instance, house.labels, cameras(house))


def divide(scans: Path, out: Path, dry_run: bool = False) -> list[ScanStoreys]:
    found, errors = find_scans(scans)
    assert not errors
    return divide_scans(found, out, CaptureConfig(), dry_run)


def readings(folder: Path) -> list[Reading]:
    """What the readers of their formats make of a scan's storeys, the lowest first."""
    found, errors = find_scans(folder)
    assert not errors
    return [format_of(scan).read(scan) for scan in sorted(found, key=lambda scan: scan.scan)]


def joined(folder: Path, parts: list[Reading]) -> Surface:
    """Storeys put together again, as their record says."""
    surfaces = [surface_of(part.parts) if part.parts else part.surface for part in parts]
    pairs = zip(surfaces, changes(folder), strict=True)
    return union_of([Surface(transform_points(surface.vertices, change), surface.faces, surface.colors) for surface, change in pairs])


def changes(folder: Path) -> list[np.ndarray]:
    """What brings each storey back, 4x4."""
    return [np.array(entry["to_original"]).reshape(4, 4) for entry in json.loads((folder / RECORD).read_text())["storeys"]]


def same_surface(surface: Surface, vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> None:
    """The same area, and every vertex of the one is one of the other."""
    from scipy.spatial import cKDTree

    assert surface_area(surface.vertices, surface.faces) == pytest.approx(surface_area(vertices, faces), rel=1e-5)
    assert cKDTree(surface.vertices).query(vertices[np.unique(faces)])[0].max() < tolerance
    assert closest_points(vertices, faces, surface.vertices).distance.max() < tolerance


def tree(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_bare_mesh_with_colors_stays_one(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "house.ply").write_bytes(ply_bytes(HOUSE.surface))
    (row,) = divide(tmp_path / "in" / "house.ply", tmp_path / "out")
    assert (row.scene_id, row.action) == ("mesh/house", "divided")
    assert row.floors == pytest.approx([0.0, 2.8], abs=0.01)
    assert row.folders == ("house/house_floor0", "house/house_floor1")
    parts = readings(tmp_path / "out" / "house")
    same_surface(joined(tmp_path / "out" / "house", parts), HOUSE.surface.vertices, HOUSE.surface.faces, 1e-5)
    found, _ = find_scans(tmp_path / "out")
    assert [scan.scene_id for scan in found] == ["mesh/house_floor0", "mesh/house_floor1"]
    assert [room_of(scan) for scan in found] == [scan.scene_id for scan in found]  # as of scans that people call so


def test_an_obj_with_its_texture_keeps_it_and_is_joined_in_its_own_units_and_axes(tmp_path: Path) -> None:
    """Centimetres, +Y up."""
    (tmp_path / "in" / "flat").mkdir(parents=True)
    surface = HOUSE.surface
    image = Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8))
    uv = np.clip(surface.vertices[:, :2] / 10.0, 0.0, 1.0)
    drawn = 100.0 * surface.vertices[:, [1, 2, 0]]
    image.save(tmp_path / "in" / "flat" / "flat.png")
    (tmp_path / "in" / "flat" / "flat.mtl").write_text("newmtl all\nmap_Kd flat.png\n")
    (tmp_path / "in" / "flat" / "LICENSE.txt").write_text("CC-BY-4.0\n")
    lines = ["mtllib flat.mtl", "usemtl all"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in drawn] + [f"vt {u:.6f} {v:.6f}" for u, v in uv]
    lines += ["f " + " ".join(f"{k}/{k}" for k in face) for face in surface.faces + 1]
    (tmp_path / "in" / "flat" / "flat.obj").write_text("\n".join(lines) + "\n")
    (row,) = divide(tmp_path / "in", tmp_path / "out")
    assert row.action == "divided"
    parts = readings(tmp_path / "out" / "flat")
    assert {path.suffix for path in (tmp_path / "out" / "flat").rglob("flat_floor*.*")} == {".glb"}
    same_surface(joined(tmp_path / "out" / "flat", parts), drawn, surface.faces, 0.01)
    for part in parts:
        (own,) = part.parts
        assert np.asarray(own.visual.material.baseColorTexture.convert("RGB")).tolist() == np.asarray(image).tolist()
        back = transform_points(own.vertices, changes(tmp_path / "out" / "flat")[0])
        assert own.visual.uv == pytest.approx(np.clip(back[:, [2, 0]] / 1000.0, 0, 1), abs=1e-4)
    assert all((tmp_path / "out/flat" / name / "LICENSE.txt").read_text() == "CC-BY-4.0\n" for name in ("flat_floor0", "flat_floor1"))


@pytest.mark.parametrize("frames", ["exported", "sens", "none"])
def test_a_scannet_folder_keeps_instances_frames_and_its_frame(tmp_path: Path, frames: str) -> None:
    room = room_from(HOUSE)
    write_scannet(tmp_path / "in" / "scene0000_01", room, frames=frames)
    (before,) = readings(tmp_path / "in")
    (row,) = divide(tmp_path / "in", tmp_path / "out")
    assert row.action == "divided"
    folder = tmp_path / "out" / "scene0000_01"
    found, _ = find_scans(folder)
    assert [(scan.format, room_of(scan)) for scan in found] == [("scannet", f"scannet/scene0000_floor{k}") for k in (0, 1)]
    again = [dataclasses.replace(scan, scan=scan.scan.replace("_01_", "_02_")) for scan in found]
    assert [room_of(scan) for scan in again] == [room_of(scan) for scan in found]  # a storey's rescan is one of the same storey
    parts = readings(folder)
    same_surface(joined(folder, parts), before.surface.vertices, before.surface.faces, 1e-5)
    assert {group.source_id: group.raw_label for part in parts for group in part.groups} == {
        group.source_id: group.raw_label for group in before.groups
    }
    assert sum(len(part.groups) for part in parts) == len(before.groups)
    kept = {frame.frame_id: frame for part in parts for frame in part.frames}
    assert sorted(kept) == [frame.frame_id for frame in before.frames]
    assert [len(part.frames) for part in parts] == ([3, 3] if frames != "none" else [0, 0])
    for frame in before.frames:
        own = kept[frame.frame_id]
        assert own.pose == pytest.approx(frame.pose, abs=1e-12)
        assert (own.color() == frame.color()).all()
        assert (own.depth() == frame.depth()).all()
        assert own.intrinsics == pytest.approx(frame.intrinsics)
        assert own.depth_intrinsics == pytest.approx(frame.depth_intrinsics)
    for storey, part in enumerate(parts):
        floor = next(group for group in part.groups if group.raw_label == "floor")
        height = part.surface.transformed(part.alignment).vertices[floor.vertices, 2]
        assert height == pytest.approx(0.0, abs=0.01), storey
        assert part.alignment[:3, :3] == pytest.approx(inverse(SCAN_FROM_WORLD)[:3, :3], abs=1e-5)


@pytest.mark.parametrize("has_frames", [True, False])
def test_all_storeys_of_a_scan_have_one_layout(tmp_path: Path, has_frames: bool) -> None:
    """Filmed, or labelled, on the lowest floor alone."""
    scan = tmp_path / "in" / "scene0000_01"
    count = int(HOUSE.instance[HOUSE.storey == 1].min())
    room = dataclasses.replace(room_from(HOUSE), instance=np.minimum(HOUSE.instance, count), cameras=cameras(HOUSE)[:3])
    write_scannet(scan, room, frames="exported" if has_frames else "none", labels=HOUSE.labels[:count])
    if has_frames:
        for path in [*scan.glob("*.segs.json"), *scan.glob("*.aggregation.json")]:
            path.unlink()
    (before,) = readings(tmp_path / "in")
    assert (before.groups is None) == has_frames
    (row,) = divide(tmp_path / "in", tmp_path / "out")
    assert row.action == "divided", row
    found, errors = find_scans(tmp_path / "out")
    assert errors == []
    assert [(scan.scan, scan.format) for scan in found] == [(f"scene0000_01_floor{k}", "scannet") for k in (0, 1)]
    parts = readings(tmp_path / "out" / "scene0000_01")
    assert [len(part.frames) for part in parts] == [3 * has_frames, 0]
    assert [None if part.groups is None else len(part.groups) for part in parts] == ([None, None] if has_frames else [count, 0])
    same_surface(joined(tmp_path / "out" / "scene0000_01", parts), before.surface.vertices, before.surface.faces, 1e-5)


def test_a_trial_says_what_frames_would_be_left_out(tmp_path: Path) -> None:
    """Where each has a lens of its own, as phones write them."""
    write_scannet(tmp_path / "as" / "scene0000_01", room_from(HOUSE))
    (before,) = readings(tmp_path / "as")
    frames = tuple(
        dataclasses.replace(frame, intrinsics=tuple(value + 0.1 * number for value in frame.intrinsics))
        for number, frame in enumerate(before.frames)
    )
    write_arkitscenes(tmp_path / "in" / "41069021", dataclasses.replace(before, frames=frames))
    (trial,) = divide(tmp_path / "in", tmp_path / "out", dry_run=True)
    assert [note for note in trial.notes if "lens" in note] == [
        f"storey {k} is without its 3 frames: its frames have a lens each, which the folder of a storey cannot state" for k in (0, 1)
    ]
    (row,) = divide(tmp_path / "in", tmp_path / "out")
    assert (row.action, row.notes) == ("divided", trial.notes)
    record = json.loads((tmp_path / "out" / "41069021" / RECORD).read_text())
    assert [storey["frames"] for storey in record["storeys"]] == [0, 0]
    assert [part.frames for part in readings(tmp_path / "out" / "41069021")] == [(), ()]


@pytest.mark.parametrize("form", ["stray_scanner", "record3d"])
def test_frames_of_phones_are_joined_in_their_own_axes(tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """+Y up; what is fused of the frames is the house, whose fusion is another test's."""
    from tasks.capture.storeys import splitting

    write_scannet(tmp_path / "as" / "scene0000_01", room_from(HOUSE))
    (before,) = readings(tmp_path / "as")
    {"stray_scanner": write_stray_scanner, "record3d": write_record3d}[form](tmp_path / "in" / "walk", before.frames)
    monkeypatch.setattr(splitting, "fused_surface", lambda *_: (before.surface, []))
    (row,) = divide(tmp_path / "in", tmp_path / "out")
    assert row.action == "divided", row
    folder = tmp_path / "out" / "walk"
    poses = [change @ frame.pose for part, change in zip(readings(folder), changes(folder), strict=True) for frame in part.frames]
    if form == "stray_scanner":
        rows = np.loadtxt(tmp_path / "in" / "walk" / "odometry.csv", delimiter=",", skiprows=1, ndmin=2)
        places = rows[:, 2:5]
    else:
        places = np.array(json.loads((tmp_path / "in" / "walk" / "metadata").read_text())["poses"])[:, 4:]
    assert np.array([pose[:3, 3] for pose in poses]) == pytest.approx(places, abs=1e-6)


@pytest.mark.whole  # frames are fused
def test_a_folder_of_posed_frames_becomes_one_for_each_storey(tmp_path: Path) -> None:
    house = house_of(2, (5.0, 6.5), 2.5, 0.3, is_stair=False)
    views = tuple(
        Camera.with_fov(look_at([2.5 + 0.8 * np.cos(a), 3.2 + 0.8 * np.sin(a), z + 1.5],
                                [2.5 - 2 * np.cos(a), 3.2 - 2 * np.sin(a), z + low]), 160, 120, 1.4)
        for z in house.floors for a in 2 * np.pi * np.arange(8) / 8 for low in (0.1, 1.5)
    )  # fmt: skip
    write_posed_rgbd(tmp_path / "in" / "walk", BoxRoom(house.surface, house.instance, house.labels, views))
    (before,) = readings(tmp_path / "in")
    (row,) = divide(tmp_path / "in", tmp_path / "out")
    assert row.action == "divided", row
    assert row.floors == pytest.approx([0.0, 2.8], abs=0.03)
    found, _ = find_scans(tmp_path / "out")
    assert [scan.format for scan in found] == ["posed_rgbd"] * 2
    parts = readings(tmp_path / "out" / "walk")
    ids = [[frame.frame_id for frame in part.frames] for part in parts]
    assert ids == [[frame.frame_id for frame in before.frames[:16]], [frame.frame_id for frame in before.frames[16:]]]
    for part, frames in zip(parts, (before.frames[:16], before.frames[16:]), strict=True):
        for own, frame in zip(part.frames, frames, strict=True):
            assert own.pose == pytest.approx(frame.pose, abs=1e-12)
            assert (own.depth() == frame.depth()).all()
            assert (own.color() == frame.color()).all()


def test_a_drawn_scene_keeps_its_nodes(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    parts, names = [], []
    for number, label in enumerate(HOUSE.labels):
        own = HOUSE.instance == number
        faces = HOUSE.surface.faces[own[HOUSE.surface.faces].all(axis=1)]
        used, corners = np.unique(faces, return_inverse=True)
        parts.append(Surface(HOUSE.surface.vertices[used], corners.reshape(-1, 3), HOUSE.surface.colors[used]).to_trimesh())
        names.append(f"thing{number}|{label}|0")
    (tmp_path / "in" / "house.glb").write_bytes(dump_glb(parts, names))
    (row,) = divide(tmp_path / "in" / "house.glb", tmp_path / "out")
    assert (row.scene_id, row.action) == ("glb/house", "divided")
    pieces = readings(tmp_path / "out" / "house")
    labels = [sorted((group.source_id, group.raw_label) for group in piece.groups) for piece in pieces]
    storey = [int(HOUSE.storey[HOUSE.instance == number][0]) for number in range(len(HOUSE.labels))]
    assert labels == [sorted((f"thing{n}", label) for n, label in enumerate(HOUSE.labels) if storey[n] == k) for k in (0, 1)]
    turned = HOUSE.surface.vertices[:, [0, 2, 1]] * [1, 1, -1]
    same_surface(joined(tmp_path / "out" / "house", pieces), turned, HOUSE.surface.faces, 1e-4)
