"""A USD scene as one file: aligned, the same bytes every time, and read back as the folder that it was made of."""

from __future__ import annotations

import io
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks import exports
from tasks.exports.usd import with_release, write_usd
from tasks.exports.usd.package import ALIGNMENT, package
from tasks.exports.usd.rules import check_usd
from tests.replicas import furnished, rows_of
from tests.tasks.exports.usd.test_exports_usd import open_stage, replica_of


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_usd(tmp_path_factory.mktemp("usd"), replica_of(*rows_of(furnished())), exports.ExportsConfig())


@pytest.fixture(scope="module")
def packed(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("usdz") / "office.usdz"
    path.write_bytes(package(files_of(scene.parent), "scene.usda"))
    return path


def told(path: Path) -> dict[str, Any]:
    """Every prim of a scene by path: its type, its schemas, its world pose, its mass, its friction, its positions."""
    from pxr import Usd, UsdGeom

    found = {}
    cache, stage = UsdGeom.XformCache(), open_stage(path)
    names = ["points", "semantics:labels:class"]
    names += [f"physics:{name}" for name in ("mass", "diagonalInertia", "centerOfMass", "staticFriction", "approximation")]
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        values = [str(prim.GetAttribute(name).Get()) for name in names]
        found[str(prim.GetPath())] = (
            str(prim.GetTypeName()), tuple(prim.GetAppliedSchemas()), np.array(cache.GetLocalToWorldTransform(prim)).tolist(), values,
        )  # fmt: skip
    return found


def test_a_package_is_read_back_as_its_folder_and_passes_the_gate(scene: Path, packed: Path) -> None:
    assert check_usd(packed) == []
    assert told(packed) == told(scene)
    assert len(told(packed)) > 50


def test_a_package_needs_nothing_beside_it(packed: Path, tmp_path: Path) -> None:
    alone = Path(shutil.copy(packed, tmp_path / "elsewhere.usdz"))
    assert check_usd(alone) == []
    assert told(alone) == told(packed)
    assert packed.read_bytes().count(b"/tmp/") == 0


_NAMES = st.from_regex(r"[a-z]{1,5}(/[a-z]{1,9}){0,3}\.(usda|usdc|png|jpg)", fullmatch=True)


@given(st.dictionaries(_NAMES, st.binary(max_size=300), max_size=6), st.randoms())
def test_any_files_are_aligned_stored_and_in_the_same_order(files: dict[str, bytes], shuffled: Any) -> None:
    files = files | {"scene.usda": b"#usda 1.0\n"}
    data = package(files, "scene.usda")
    names = list(files)
    shuffled.shuffle(names)
    assert data == package({name: files[name] for name in names}, "scene.usda"), "the order of the files must not matter"
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        entries = archive.infolist()
        assert entries[0].filename == "scene.usda"
        assert {entry.filename: archive.read(entry) for entry in entries} == files
    for entry in entries:
        head = data[entry.header_offset : entry.header_offset + 30]
        start = entry.header_offset + 30 + int.from_bytes(head[26:28], "little") + int.from_bytes(head[28:30], "little")
        assert start % ALIGNMENT == 0
        assert data[start : start + entry.file_size] == files[entry.filename]
        assert entry.compress_type == zipfile.ZIP_STORED


@pytest.mark.parametrize(
    ("files", "root"), [({"a.usda": b""}, "b.usda"), ({"a.png": b""}, "a.png"), ({"a.usda": b"", "b.exe": b""}, "a.usda")]
)
def test_what_is_no_package_is_not_made(files: dict[str, bytes], root: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        package(files, root)


def rezipped(
    compression: int, first: str | None = None, without: str = "?", rename: tuple[str, str] | None = None
) -> Callable[[Path], None]:
    """The same files by a writer that knows nothing of packages."""

    def damage(path: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            files = {name: archive.read(name) for name in archive.namelist()}
        names = sorted(files, key=lambda name: (name != (first or "scene.usda"), name))
        with zipfile.ZipFile(path, "w", compression) as archive:
            for name in names:
                if without not in name:
                    archive.writestr(rename[1] if rename and name == rename[0] else name, files[name])

    return damage


DAMAGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "cut": ("package", lambda path: path.write_bytes(path.read_bytes()[:-200])),
    "empty": ("package", lambda path: path.write_bytes(b"")),
    "compressed": ("package", rezipped(zipfile.ZIP_DEFLATED)),
    "not aligned": ("package", rezipped(zipfile.ZIP_STORED)),
    "no scene at the front": ("physics_scene", rezipped(zipfile.ZIP_STORED, without="scene.usda", first="room/room_geometry.usdc")),
    "a file outside": ("package", rezipped(zipfile.ZIP_STORED, rename=("room/room.usda", "/srv/room.usda"))),
    "lost geometry": ("closed_paths", rezipped(zipfile.ZIP_STORED, without="room_geometry")),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_to_a_package_is_refused_by_its_rule(name: str, packed: Path, tmp_path: Path) -> None:
    rule, damage = DAMAGES[name]
    copy = Path(shutil.copy(packed, tmp_path / packed.name))
    damage(copy)
    found = check_usd(copy)
    assert rule in {finding.rule for finding in found if finding.is_error}, found


def test_a_release_is_stated_beside_what_was_there(scene: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(scene.parent, tmp_path / "copy")) / scene.name
    data = with_release(copy.read_bytes(), 7, "v1.2")
    assert data == with_release(copy.read_bytes(), 7, "v1.2")
    copy.write_bytes(data)
    assert check_usd(copy) == []
    stage = open_stage(copy)
    objects = stage.GetPrimAtPath("/World/Objects").GetChildren()
    assert len({prim.GetCustomDataByKey("metascenes")["instance_id"] for prim in objects}) == len(objects) > 3
    for prim in objects:
        assert prim.GetCustomDataByKey("metascenes")["asset_id"]
        assert prim.GetCustomDataByKey("metascenes")["release"] == "v1.2"
    for stated in (stage.GetRootLayer().customLayerData["metascenes"], stage.GetDefaultPrim().GetCustomDataByKey("metascenes")):
        assert stated["release"] == "v1.2"
        assert stated["snapshot_id"] == 7
        assert stated["scene_id"] == "demo/room_01"
        assert stated["license"]
    assert told(copy) == told(scene)
    unreleased = open_stage(scene)
    plain = unreleased.GetRootLayer().customLayerData["metascenes"]
    assert "release" not in plain
    assert "snapshot_id" not in plain
