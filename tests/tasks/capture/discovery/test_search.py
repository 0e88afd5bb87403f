"""Folders as people and apps leave them: every file that may be a scan is one, or is named."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from flows.scans.listing import ScanFile, listed_folder
from schemas.errors import InputError
from tasks.capture.formats import find_scans, scan_files
from tasks.capture.scan import PassedOver, UnusableScan

PLY = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def glb(path: Path, generator: str = "somebody") -> None:
    text = json.dumps({"asset": {"version": "2.0", "generator": generator}}, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text)


def put(path: Path, data: bytes = b"x") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def scannet(folder: Path) -> None:
    put(folder / f"{folder.name}_vh_clean_2.ply", PLY)


def frames(folder: Path) -> None:
    for name in ("color/0.jpg", "depth/0.png", "pose/0.txt", "intrinsics.json"):
        put(folder / name)


def captured_room(path: Path) -> None:
    put(path, b"{}")
    put(path.with_suffix(".usdz"))


KINDS: dict[str, tuple[Callable[[Path], None], str]] = {
    "attic.ply": (lambda path: put(path, PLY), "mesh/attic"),
    "bath/room.obj": (lambda path: put(path, OBJ), "mesh/bath"),
    "cellar.glb": (glb, "glb/cellar"),
    "den.usdz": (put, "mesh/den"),
    "scene0007_00": (scannet, "scannet/scene0007_00"),
    "hall": (frames, "rgbd/hall"),
    "group/inner/loft.ply": (lambda path: put(path, PLY), "mesh/inner"),
}
"""Things in one folder, and the scene that each is next to another one."""


def found(folder: Path) -> list[str]:
    return [scan.scene_id for scan in find_scans(folder)[0]]


@pytest.mark.parametrize("first", KINDS)
@pytest.mark.parametrize("second", KINDS)
def test_no_scan_hides_another(first: str, second: str, tmp_path: Path) -> None:
    for name in {first, second}:
        KINDS[name][0](tmp_path / "scans" / name)
    scans, errors = find_scans(tmp_path / "scans")
    assert errors == []
    ids = {scan.scene_id for scan in scans}
    assert ids == {KINDS[first][1], KINDS[second][1]} if first != second else len(ids) == 1


def test_all_of_them_and_json_in_between(tmp_path: Path) -> None:
    for name, (make, _) in KINDS.items():
        make(tmp_path / name)
    put(tmp_path / "info.json", b"{}")
    put(tmp_path / "bath" / "meta.json", b"{}")
    scans, errors = find_scans(tmp_path)
    assert errors == []
    assert [scan.scene_id for scan in scans] == sorted(scene for _, scene in KINDS.values())


def test_a_listing_of_a_mixed_folder_finds_the_same(tmp_path: Path) -> None:
    for name, (make, _) in KINDS.items():
        make(tmp_path / "scans" / name)
    files = [path.relative_to(tmp_path / "scans").as_posix() for path in (tmp_path / "scans").rglob("*") if path.is_file()]
    listed = listed_folder("scans", [ScanFile(file, 1, 1) for file in files])
    assert found(listed) == found(tmp_path / "scans")


def test_a_lone_package_is_a_bare_mesh(tmp_path: Path) -> None:
    put(tmp_path / "scan" / "kitchen.usdz")
    assert found(tmp_path / "scan") == ["mesh/scan"]
    assert found(tmp_path / "scan" / "kitchen.usdz") == ["mesh/kitchen"]


@pytest.mark.parametrize("document", ["kitchen.json", "CapturedRoom.json"])
def test_a_captured_room_hides_no_mesh_next_to_it(document: str, tmp_path: Path) -> None:
    put(tmp_path / "scans" / document, b"{}")
    put(tmp_path / "scans" / "kitchen.usdz")
    assert found(tmp_path / "scans") == ["roomplan/scans"], "the package shows the same room"
    put(tmp_path / "scans" / "attic.ply", PLY)
    scans, errors = find_scans(tmp_path / "scans")
    assert [scan.scene_id for scan in scans] == ["mesh/attic", f"roomplan/{Path(document).stem}"]
    assert errors == []
    assert scan_files(scans[1]) == [(tmp_path / "scans" / document).resolve()]
    captured_room(tmp_path / "scans" / "den.json")
    assert "roomplan/den" in found(tmp_path / "scans")


def test_a_mesh_in_the_folder_of_a_recorded_scan_is_named(tmp_path: Path) -> None:
    frames(tmp_path / "home")
    put(tmp_path / "home" / "attic.ply", PLY)
    put(tmp_path / "home" / "more" / "bath.obj", OBJ)
    (scan,), (error,) = find_scans(tmp_path / "home")
    assert scan.scene_id == "rgbd/home"
    assert isinstance(error, PassedOver)
    assert str(error) == (
        "home: attic.ply, more/bath.obj are not part of the posed_rgbd scan and not read; "
        "a mesh that is a scan by itself belongs into a folder of its own"
    )
    scannet(tmp_path / "scene0001_00")
    for name in ("_vh_clean.ply", "_vh_clean_2.labels.ply"):
        put(tmp_path / "scene0001_00" / f"scene0001_00{name}", PLY)
    assert find_scans(tmp_path / "scene0001_00")[1] == [], "ScanNet's own meshes"


def test_a_broken_scan_withholds_its_meshes_and_says_how_they_are_read(tmp_path: Path) -> None:
    put(tmp_path / "scans" / "home" / "habitat" / "info_semantic.json", b"{}")
    put(tmp_path / "scans" / "home" / "mesh.ply", PLY)
    glb(tmp_path / "scans" / "room.glb")
    (scan,), (error,) = find_scans(tmp_path / "scans")
    assert scan.scene_id == "glb/scans"
    assert isinstance(error, UnusableScan)
    assert error.format == "replica_v1"
    assert "looks like replica_v1 without habitat/mesh_semantic.ply" in error.problem
    assert error.remedy.endswith("--format bare_mesh reads mesh.ply as it is")
    assert [scan.scene_id for scan in find_scans(tmp_path / "scans" / "home", "bare_mesh")[0]] == ["mesh/home"]


@pytest.mark.parametrize("name", ["poseidon.ply", "color_room.obj", "region_office.ply", "my.intrinsics_room.glb"])
def test_a_mesh_is_no_sign_of_a_recording(name: str, tmp_path: Path) -> None:
    put(tmp_path / "scans" / name, PLY)
    put(tmp_path / "scans" / "other.ply", PLY)
    scans, errors = find_scans(tmp_path / "scans")
    assert len(scans) == 2
    assert errors == []


def test_what_systems_and_browsers_leave_is_no_scan(tmp_path: Path) -> None:
    for name in ("._room.ply", ".DS_Store", "Thumbs.db", "desktop.ini", "room.ply:Zone.Identifier", "__MACOSX/._room.ply", ".hidden/b.ply"):
        put(tmp_path / "scans" / name)
    (only,) = find_scans(tmp_path / "scans")[1]
    assert only.problem == "is empty"
    put(tmp_path / "scans" / "room.ply", PLY)
    assert find_scans(tmp_path / "scans")[1] == []
    assert found(tmp_path / "scans") == ["mesh/scans"]


def test_archives_downloads_and_foreign_files_are_named_once(tmp_path: Path) -> None:
    put(tmp_path / "attic.ply", PLY)
    for name in ("a.zip", "b.7z", "c.zip", "d.tar.gz", "half.glb.part", "e.ply.crdownload", "f.fbx"):
        put(tmp_path / name)
    scans, errors = find_scans(tmp_path)
    assert len(scans) == 1
    assert all(isinstance(error, PassedOver) for error in errors)
    assert [str(error) for error in errors] == [
        "a.zip, b.7z, c.zip and 1 more file: not a scan; unpack it",
        "e.ply.crdownload, half.glb.part: not a scan; it is not whole: wait for the download, or download it again",
        "f.fbx: not a scan; export it as GLB, in Blender",
    ]


def test_materials_of_a_mesh_are_not_reported(tmp_path: Path) -> None:
    for name in ("room.obj", "hall.obj"):
        put(tmp_path / name, OBJ)
    for name in ("room.mtl", "room.jpg", "textures/wood.png", "textures/wood.mtl"):
        put(tmp_path / name)
    assert find_scans(tmp_path)[1] == []
    assert found(tmp_path) == ["mesh/hall", "mesh/room"]


def test_exports_of_one_app_in_several_formats_are_scenes_with_ids_of_their_own(tmp_path: Path) -> None:
    glb(tmp_path / "room.glb")
    put(tmp_path / "room.obj", OBJ)
    put(tmp_path / "room.usdz")
    scans, (error,) = find_scans(tmp_path)
    assert len({scan.scene_id.casefold() for scan in scans}) == 3
    assert {"glb/room", "mesh/room"} < {scan.scene_id for scan in scans}
    assert isinstance(error, PassedOver)
    assert "room.glb, room.obj, room.usdz: have one name, and each is a scene" in str(error)


def test_a_folder_that_is_too_deep_is_named(tmp_path: Path) -> None:
    put(tmp_path / "scans" / "attic.ply", PLY)
    put(tmp_path / "scans" / "a" / "b" / "c" / "d" / "room.ply", PLY)
    (scan,), (error,) = find_scans(tmp_path / "scans")
    assert scan.path.name in ("scans", "attic.ply")
    assert isinstance(error, UnusableScan)
    assert str(error) == (
        "a/b/c: folder: lies more than 2 folders deep and is not searched (d/room.ply); give a folder further down as --scans"
    )


# ------------------------------------------------------------------------------------------------ what this project wrote


def own_lake(folder: Path) -> None:
    put(folder / "lake.json", b"{}")
    glb(folder / "blobs" / "ab" / "cd" / f"{'ab' * 32}.glb")
    put(folder / "tables" / "scenes" / "a.parquet")


def own_export(folder: Path) -> None:
    put(folder / ".exported")
    glb(folder / "mesh_room.glb", "metascenes")
    put(folder / "mesh_room" / "assets" / "chair_1a2b3c4d_part_00.obj", OBJ)


def test_a_demo_folder_is_its_scans_and_one_line(tmp_path: Path) -> None:
    scannet(tmp_path / "demo" / "scans" / "scene0001_00")
    own_lake(tmp_path / "demo" / "lake")
    for name in ("glb", "habitat", "mjcf", "usd"):
        own_export(tmp_path / "demo" / name)
    put(tmp_path / "demo" / "release" / "release.json", b"{}")
    put(tmp_path / "demo" / "release" / "SHA256SUMS")
    put(tmp_path / "demo" / "report.html")
    (scan,), (error,) = find_scans(tmp_path / "demo")
    assert scan.scene_id == "scannet/scene0001_00"
    assert isinstance(error, PassedOver)
    names = "glb (export), habitat (export), lake (lake), mjcf (export), release (release), usd (export)"
    assert str(error) == f"demo: {names}: written by metascenes, not scans"


@pytest.mark.parametrize(
    "names",
    [
        ["scene.usda", "room/room.usda", "assets/a/a.usda"],
        ["room.urdf", "poses.json", "meshes/bed_1a2b3c4d_part_00.obj"],
        ["scene.xml", "assets/room_wall_01_part_00.obj"],
        ["world.sdf", "meshes/room_wall_01_hull_00.obj"],
        ["map.pgm", "map.yaml", "objects.json"],
        ["metascenes.scene_dataset_config.json", "stages/a.glb"],
    ],
)
def test_exported_scenes_are_known_without_the_mark_of_their_folder(names: list[str], tmp_path: Path) -> None:
    put(tmp_path / "scans" / "attic.ply", PLY)
    put(tmp_path / "scans" / "bath.ply", PLY)
    for name in names:
        put(tmp_path / "scans" / "mesh_attic" / name)
    scans, errors = find_scans(tmp_path / "scans")
    assert len(scans) == 2
    assert [str(error) for error in errors] == ["scans: mesh_attic (export): written by metascenes, not scans"]


def test_a_robot_model_by_others_is_no_export(tmp_path: Path) -> None:
    for name in ("scene.xml", "assets/base_link.obj", "assets/wheel.obj"):
        put(tmp_path / "scans" / "robot" / name)
    assert [scan.scan for scan in find_scans(tmp_path / "scans")[0]] == ["base_link", "wheel"]


@pytest.mark.parametrize(("make", "kind"), [(own_lake, "a lake"), (own_export, "an export")])
def test_an_own_folder_that_is_named_is_refused(make: Callable[[Path], None], kind: str, tmp_path: Path) -> None:
    make(tmp_path / "place")
    scans, (error,) = find_scans(tmp_path / "place")
    assert scans == []
    assert str(error) == f"place: folder: is {kind} of metascenes and not a scan; name the scan that it was made from"


def test_a_folder_of_nothing_but_own_files_holds_no_scan(tmp_path: Path) -> None:
    own_export(tmp_path / "out" / "glb")
    scans, errors = find_scans(tmp_path / "out")
    assert scans == []
    assert [isinstance(error, PassedOver) for error in errors] == [True, False]
    assert "holds no scan of a known format" in str(errors[1])


def test_links_that_leave_are_not_opened(tmp_path: Path) -> None:
    glb(tmp_path / "outside.glb", "metascenes")
    put(tmp_path / "scans" / "attic.ply", PLY)
    (tmp_path / "scans" / "scene.glb").symlink_to(tmp_path / "outside.glb")
    _, errors = find_scans(tmp_path / "scans")
    assert [str(error).partition(";")[0] for error in errors] == ["scene.glb: link: leads out of the folder of scans"]


def test_a_copied_folder_has_an_id_of_its_own(tmp_path: Path) -> None:
    scannet(tmp_path / "scene0001_00")
    shutil.copytree(tmp_path / "scene0001_00", tmp_path / "scene0001_00 (copy)")
    scans, errors = find_scans(tmp_path)
    assert errors == []
    assert scans[0].scene_id == "scannet/scene0001_00"
    assert scans[0].path.name == "scene0001_00"
    assert scans[1].scene_id.startswith("scannet/scene0001_00-")


def test_two_folders_of_one_name_are_two_errors(tmp_path: Path) -> None:
    scannet(tmp_path / "scene0001_00")
    for name in ("a", "b"):
        put(tmp_path / name / "half" / "habitat" / "info_semantic.json", b"{}")
        scannet(tmp_path / name / f"scene000{'ab'.index(name) + 2}_00")
    scans, errors = find_scans(tmp_path)
    assert len(scans) == 3
    assert ["looks like replica_v1" in str(error) for error in errors] == [True, True]
    assert len({error.path for error in errors if isinstance(error, UnusableScan)}) == 2


def test_errors_are_input_errors_of_one_line(tmp_path: Path) -> None:
    for name, (make, _) in KINDS.items():
        make(tmp_path / name)
    put(tmp_path / "empty" / ".keep")
    for error in find_scans(tmp_path)[1]:
        assert isinstance(error, InputError)
        assert "\n" not in str(error)
