"""What this project wrote is no scan, and a sound scan of others is one, whatever it is called."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path

import pytest
import trimesh

from tasks.capture.formats import find_scans, scan_files
from tasks.capture.products import is_product, product_of
from tasks.capture.scan import PassedOver
from tasks.exports.gltf import aimed_glb
from tasks.exports.wavefront import dump_obj
from tasks.geometry.meshes import dump_glb
from tests.tasks.capture.discovery.test_search import OBJ, PLY, glb, put

BOX = trimesh.creation.box()
OWN_GLB, OWN_OBJ = aimed_glb(dump_glb([BOX], ["hull_00"])), dump_obj(BOX.vertices, BOX.faces)


def marked(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_own_files_are_known_by_their_marks_and_content(tmp_path: Path) -> None:
    place, mark = tmp_path / "scans", marked(OWN_GLB)[:16]
    glb(place / "attic.glb")
    glb(place / "scene.glb", "metascenes")
    put(place / f"chair_{mark}.glb", OWN_GLB)
    put(place / f"chair_{mark}.collider.glb", OWN_GLB)
    put(place / "parts" / "room_floor_part_00.obj", b"mtllib room_floor_part_00.mtl\nusemtl look\n" + OWN_OBJ)
    put(place / "parts" / "bed_1a2b3c4d_hull_01.obj", OWN_OBJ)
    with zipfile.ZipFile(place / "room.usdz", "w") as archive:
        archive.writestr("scene.usda", "#usda 1.0\n(\n customLayerData = {\n dictionary metascenes = {\n")
    scans, errors = find_scans(place)
    assert [scan.scene_id for scan in scans] == ["glb/attic"]
    assert scan_files(scans[0]) == [(place / "attic.glb").resolve()]
    assert [type(error) for error in errors] == [PassedOver, PassedOver]
    assert sorted(str(error) for error in errors) == [
        "parts: bed_1a2b3c4d_hull_01.obj, room_floor_part_00.obj: written by metascenes, not scans",
        f"scans: chair_{mark}.collider.glb, chair_{mark}.glb, room.usdz and 1 more file: written by metascenes, not scans",
    ]
    (refused,) = find_scans(place / "scene.glb")[1]
    assert str(refused) == "scene.glb: file: was written by metascenes and is not a scan; name the scan that it was made from"


def test_a_blob_of_a_lake_is_known_by_its_hash_and_writer(tmp_path: Path) -> None:
    put(tmp_path / f"{marked(OWN_GLB)}.glb", OWN_GLB)
    assert is_product(tmp_path / f"{marked(OWN_GLB)}.glb")
    glb(tmp_path / "room.glb")
    foreign = (tmp_path / "room.glb").read_bytes()
    put(tmp_path / f"{marked(foreign)}.glb", foreign)
    assert not is_product(tmp_path / f"{marked(foreign)}.glb"), "stores of others name files by content, too"


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("scan_1700000000000000.glb", OWN_GLB),
        ("scan_1700000000000000.collider.glb", OWN_GLB),
        (f"{'ab' * 32}.ply", PLY),
        (f"{'ab' * 32}.obj", OBJ),
        (f"{'ab' * 32}.glb", OWN_GLB),
        (f"{marked(PLY)}.ply", PLY),
        ("bed_20240101_part_00.obj", OBJ),
        ("room_floor_part_00.obj", b"# somebody\n" + OWN_OBJ),
        ("bed_20240101_hull_00.ply", PLY),
    ],
)
def test_no_name_alone_makes_a_scan_a_product(name: str, data: bytes, tmp_path: Path) -> None:
    put(tmp_path / "scans" / name, data)
    put(tmp_path / "scans" / "attic.ply", PLY)
    scans, errors = find_scans(tmp_path / "scans")
    assert {scan.path.name for scan in scans} == {name, "attic.ply"}
    assert errors == []
    assert len(find_scans(tmp_path / "scans" / name)[0]) == 1


@pytest.mark.parametrize("config", [None, "castles.scene_dataset_config.json"])
def test_a_stage_of_a_dataset_by_others_is_a_scan(config: str | None, tmp_path: Path) -> None:
    glb(tmp_path / "scans" / "castle.glb")
    put(tmp_path / "scans" / "castle.stage_config.json", b"{}")
    put(tmp_path / "scans" / "hut.ply", PLY)
    if config:
        put(tmp_path / "scans" / config, b"{}")
    assert [scan.scene_id for scan in find_scans(tmp_path / "scans")[0]] == ["glb/castle", "mesh/hut"]


def test_an_own_dataset_is_known_under_any_name(tmp_path: Path) -> None:
    root = tmp_path / "scans" / "homes"
    for name in ("homes.scene_dataset_config.json", "semantics/homes_lexicon.json", "metadata/attribution.csv"):
        put(root / name)
    glb(root / "stages" / "attic.glb")
    put(root / "stages" / "attic.stage_config.json", b"{}")
    assert product_of(root) == "an export"
    assert is_product(root / "stages" / "attic.glb")
    (root / "metadata" / "attribution.csv").unlink()
    assert product_of(root) == ""
