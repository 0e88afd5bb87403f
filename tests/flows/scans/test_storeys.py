"""Scans of several floors on disk: a scan of each in a format that is read, joined again to the same surface; nothing half or twice."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from flows.commands.storeys import command
from flows.scans import storeys as writing
from flows.scans.storeys import ScanStoreys, divide_scans
from tasks.capture import CaptureConfig
from tasks.capture.formats import find_scans, format_of, room_of
from tasks.capture.layout import STOREYS_RECORD as RECORD
from tasks.capture.reading import Reading
from tasks.capture.storeys.levels import StoreyConfig
from tasks.geometry.meshes import Surface, dump_glb, surface_of, union_of
from tasks.geometry.proximity import closest_points
from tasks.geometry.rendering import Camera
from tasks.geometry.transforms import inverse, look_at, transform_points
from tasks.geometry.triangles import surface_area
from tests.capture_scans import SCAN_FROM_WORLD, BoxRoom, ply_bytes, write_posed_rgbd, write_scannet
from tests.tasks.capture.formats.written import write_arkitscenes, write_record3d, write_stray_scanner
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


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """Three scans: a house, a flat, and one that is cut."""
    folder = tmp_path / "scans"
    folder.mkdir()
    (folder / "house.ply").write_bytes(ply_bytes(HOUSE.surface))
    (folder / "flat.ply").write_bytes(ply_bytes(house_of(1, (6.0, 7.0), 2.5, 0.3).surface))
    (folder / "broken.ply").write_bytes(ply_bytes(HOUSE.surface)[:-100])
    return folder


def test_one_bad_scan_stops_no_other_and_one_of_one_storey_stays_where_it_is(tmp_path: Path, scans: Path) -> None:
    rows = {row.scene_id: row for row in divide(scans, tmp_path / "out")}
    assert {name: row.action for name, row in rows.items()} == {"mesh/broken": "failed", "mesh/flat": "whole", "mesh/house": "divided"}
    assert rows["mesh/broken"].error.startswith("scans/broken.ply: element face: declares")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house"]


def test_a_storey_with_nothing_of_its_own_is_refused_and_stops_no_other(tmp_path: Path, scans: Path) -> None:
    """All of it is of instances that are mostly below."""
    whole = BoxRoom(HOUSE.surface, np.zeros_like(HOUSE.instance), ("chair",), ())
    write_scannet(tmp_path / "named" / "scene0000_00", whole, frames="none")
    (tmp_path / "drawn").mkdir()
    upper = (HOUSE.storey == 1)[HOUSE.surface.faces].all(axis=1)
    lower = Surface(HOUSE.surface.vertices, HOUSE.surface.faces[~upper], HOUSE.surface.colors)
    nodes = [  # every sixth face of the upper floor, and of the lower all
        union_of([lower, Surface(HOUSE.surface.vertices, HOUSE.surface.faces[upper][k::6], HOUSE.surface.colors)]).to_trimesh()
        for k in range(6)
    ]
    (tmp_path / "drawn" / "one.glb").write_bytes(dump_glb(nodes, [f"thing{k}|chair|0" for k in range(6)]))
    found = [scan for place in ("named", "drawn/one.glb", "scans") for scan in find_scans(tmp_path / place)[0]]
    rows = {row.scene_id: row for row in divide_scans(found, tmp_path / "out", CaptureConfig())}
    assert rows["mesh/house"].action == "divided"
    for scene, name in (("scannet/scene0000_00", "scene0000_00"), ("glb/one", "one.glb")):
        assert (rows[scene].error or "").startswith(f"{name}: instances: storey 1 has none of its own: "), rows[scene]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house"]


def test_what_nobody_foresaw_stops_no_other(tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tasks.capture.storeys import splitting

    layout_of, calls = splitting.layout_of, iter([True])
    (scans / "house2.ply").write_bytes((scans / "house.ply").read_bytes())

    def odd(*given: object) -> object:
        if next(calls, False):
            raise ZeroDivisionError("of a scan")
        return layout_of(*given)

    monkeypatch.setattr(splitting, "layout_of", odd)
    rows = {row.scene_id: row for row in divide(scans, tmp_path / "out")}
    assert "ZeroDivisionError: of a scan" in rows["mesh/house"].error
    assert rows["mesh/house2"].action == "divided"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house2"]


def test_the_same_scan_gives_the_same_bytes_and_is_divided_once(tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    divide(scans, tmp_path / "out")
    divide(scans, tmp_path / "other")
    made = tree(tmp_path / "out")
    assert made == tree(tmp_path / "other")
    assert sorted(made) == ["house/house_floor0/house_floor0.ply", "house/house_floor1/house_floor1.ply", f"house/{RECORD}"]
    monkeypatch.setattr(writing, "_write", lambda *_: pytest.fail("it was there already"))
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert (row.action, row.folders) == ("unchanged", ("house/house_floor0", "house/house_floor1"))
    assert tree(tmp_path / "out") == made


def test_a_scan_that_changed_is_divided_anew_and_takes_the_place_of_the_former(tmp_path: Path, scans: Path) -> None:
    divide(scans, tmp_path / "out")
    (scans / "house.ply").write_bytes(ply_bytes(house_of(3, (7.0, 9.0), 2.5, 0.3).surface))
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert (row.action, len(row.folders)) == ("divided", 3)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["house"]
    assert sorted(path.name for path in (tmp_path / "out" / "house").iterdir()) == [*(f"house_floor{k}" for k in range(3)), RECORD]
    again = divide_scans(find_scans(scans)[0], tmp_path / "out", CaptureConfig(storeys=StoreyConfig(min_cover=0.7)))
    assert [row.action for row in again if row.scene_id == "mesh/house"] == ["divided"]  # by other settings


def test_the_storeys_of_a_scan_that_has_one_now_are_taken_away(tmp_path: Path, scans: Path) -> None:
    divide(scans / "house.ply", tmp_path / "out")
    (scans / "house.ply").write_bytes(ply_bytes(house_of(1, (7.0, 9.0), 2.5, 0.3).surface))
    assert [row.action for row in divide(scans / "house.ply", tmp_path / "out", dry_run=True)] == ["whole"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["house"]
    assert [row.action for row in divide(scans / "house.ply", tmp_path / "out")] == ["whole"]
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("at", ["the second storey", "the record", "the place"])
def test_a_folder_is_there_whole_or_not_at_all(tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch, at: str) -> None:
    """Whatever stops it in between; the same command then does what is missing."""
    from tasks.capture.storeys import splitting

    owner, name, calls = {
        "the second storey": (splitting, "write_storey", 1), "the record": (splitting, "write_divided", 1), "the place": (os, "replace", 0)
    }[at]  # fmt: skip
    whole = getattr(owner, name)
    left = iter(range(calls))

    def stop(*given: object) -> object:
        if next(left, None) is None or at == "the record":
            if at == "the record":
                whole(*given)
            raise KeyboardInterrupt
        return whole(*given)

    with monkeypatch.context() as patched:
        patched.setattr(owner, name, stop)
        with pytest.raises(KeyboardInterrupt):
            divide(scans, tmp_path / "out")
    assert not (tmp_path / "out" / "house").exists()
    assert find_scans(tmp_path / "out")[0] == []
    divide(scans, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["house"]


@pytest.mark.parametrize("is_killed", [False, True])
def test_the_former_storeys_stay_where_new_ones_do_not_take_their_place(
    tmp_path: Path, scans: Path, monkeypatch: pytest.MonkeyPatch, is_killed: bool
) -> None:
    """The place is left empty by a rename that fails, or by who is killed before it; the next run finds the former ones there."""
    divide(scans / "house.ply", tmp_path / "out")
    made = tree(tmp_path / "out")
    (scans / "house.ply").write_bytes(ply_bytes(house_of(3, (7.0, 9.0), 2.5, 0.3).surface))
    replace = os.replace

    def stop(source: Path, target: Path) -> None:
        if Path(source).name == ".house.making":
            raise OSError(28, "No space left on device")
        replace(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", stop)
        if is_killed:
            patched.setattr(writing, "_mend", lambda _: None)
            patched.setattr(writing.shutil, "rmtree", lambda *_, **__: None)
        (row,) = divide(scans / "house.ply", tmp_path / "out")
    assert "No space left on device" in row.error
    if is_killed:
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [".house.former", ".house.making"]
        (scans / "house.ply").write_bytes(b"ply")  # nothing can be divided now
        assert [row.action for row in divide(scans / "house.ply", tmp_path / "out")] == ["failed"]
    assert tree(tmp_path / "out") == made


def test_what_is_no_folder_of_storeys_is_not_touched(tmp_path: Path, scans: Path) -> None:
    (tmp_path / "out" / "house").mkdir(parents=True)
    (tmp_path / "out" / "house" / "thesis.txt").write_text("mine")
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert row.error.endswith("house: folder: is there already, and is none of storeys; name another --out, or remove it")
    (tmp_path / "out" / "house" / RECORD).write_text("[]")
    (row,) = (row for row in divide(scans, tmp_path / "out") if row.scene_id == "mesh/house")
    assert row.error == f"house/{RECORD}: content: is no record of storeys; remove the folder"
    assert (tmp_path / "out" / "house" / "thesis.txt").read_text() == "mine"


def test_two_scans_of_one_name_do_not_take_each_others_folder(tmp_path: Path, scans: Path) -> None:
    divide(scans / "house.ply", tmp_path / "out")
    made = tree(tmp_path / "out")
    found, _ = find_scans(scans / "house.ply", dataset="other")
    (row,) = divide_scans(found, tmp_path / "out", CaptureConfig())
    assert row.error.endswith("house: folder: has the storeys of mesh/house; name another --out, or remove it")
    assert tree(tmp_path / "out") == made


def test_the_command_says_what_it_does_and_ends_with_1_where_a_scan_cannot_be_read(tmp_path: Path, scans: Path) -> None:
    words = ["--scans", str(scans), "--out", str(tmp_path / "out")]
    dry = CliRunner().invoke(command, [*words, "--dry-run", "--json"])
    listed = json.loads(dry.stdout)
    assert dry.exit_code == 1
    assert [(row["scene_id"], row["action"], len(row["floors"])) for row in listed["scans"]] == [
        ("mesh/broken", "failed", 0), ("mesh/flat", "whole", 0), ("mesh/house", "divided", 2),
    ]  # fmt: skip
    assert not (tmp_path / "out").exists()
    (scans / "broken.ply").unlink()
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 0
    assert [line.split() for line in done.stdout.splitlines()] == [
        ["mesh/flat", "one", "storey"], ["mesh/house", "2", "storeys,", "floors", "at", "0.00,", "2.80", "m:", "divided"],
        ["1", "scans", "divided,", "0", "unchanged,", "1", "of", "one", "storey,", "0", "failed"],
    ]  # fmt: skip


def test_rows_are_plain_values() -> None:
    row = ScanStoreys("mesh/a", "a.ply", "whole")
    assert json.loads(json.dumps(dataclasses.asdict(row)))["error"] is None


REAL: dict[str, Callable[[Path], Path]] = {
    "scene_aws_small_house": lambda folder: folder / "house.glb",
    "rgbd_slambook_dining": lambda folder: folder,
    "habitat_sim_test_assets": lambda folder: folder / "data/test_assets/scenes/simple_room.glb",
}


@pytest.mark.whole
@pytest.mark.parametrize("name", REAL)
def test_real_scans_of_one_storey_stay_one(name: str, realdata: Callable[[str], Path], tmp_path: Path) -> None:
    found, _ = find_scans(REAL[name](realdata(name)))
    rows = divide_scans(found, tmp_path / "out", CaptureConfig())
    assert [row.action for row in rows] == ["whole"]
    assert not (tmp_path / "out").exists()
