"""Exports out of a lake into a folder: what is written, replaced, refused."""

from __future__ import annotations

import hashlib
import os
import zipfile
from pathlib import Path

import pytest

from flows.outputs.export import write_exports
from schemas.errors import InputError
from schemas.exports import ExportFile
from schemas.families.export_formats import EXPORT_FORMATS
from tests.conftest import made_once
from tests.scans import OBJECTS, write_scan
from tests.test_pipeline import QUICK, metascenes
from warehouse.lake import Lake
from warehouse.release import make_release

pytestmark = pytest.mark.whole

SCENES = ("scannet/scene0000_00", "scannet/scene0001_00")
OBJECTS = OBJECTS[1:2]
"""One object in each room: most of a run goes into candidates, and they cost the same for every object."""


def built(factory: pytest.TempPathFactory) -> tuple[dict[str, str], Path, Path]:
    """Environment, scans and lake of two rooms with an object in each, for every module that asks."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_"))}

    def environment(base: Path) -> dict[str, str]:
        return {**kept, "HOME": str(base / "home"), "XDG_CACHE_HOME": str(base / "home" / ".cache"), "NO_COLOR": "1"}

    def make(base: Path) -> None:
        (base / "home").mkdir()
        write_scan(base / "scans", "scene0000_00", objects=OBJECTS)
        write_scan(base / "scans", "scene0001_00", size=(4.5, 3.2, 2.5), objects=OBJECTS, shift=(0.01, 0.0))
        done = metascenes(environment(base), "run", "--scans", base / "scans", "--lake", base / "lake", "--workers", 2, *QUICK)
        assert done.returncode == 0, done.stderr + done.stdout

    base = made_once(factory, "two_rooms", make)
    return environment(base), base / "scans", base / "lake"


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return Lake.open(built(tmp_path_factory)[2])


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, by its path from there; empty folders count by their names."""
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    empty = {f"{p.relative_to(folder).as_posix()}/": b"" for p in folder.rglob("*") if p.is_dir() and not any(p.iterdir())}
    return {**found, **empty}


def rows_of(lake: Lake) -> list[ExportFile]:
    return list(lake.snapshot().rows(ExportFile))


@pytest.fixture(scope="module")
def whole(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything, exported. Read only."""
    out = tmp_path_factory.mktemp("whole")
    written = write_exports(lake, out)
    assert written.findings == ()
    assert written.failed_checks == 0
    assert written.files == sum(not name.endswith(".exported") for name in contents(out))
    return out


def test_files_are_the_blobs_that_the_rows_name(lake: Lake, whole: Path) -> None:
    rows = rows_of(lake)
    assert {(row.format, row.scene_id) for row in rows} == {(name, scene) for name in EXPORT_FORMATS for scene in SCENES}
    for row in rows:
        data = (whole / row.format / row.path).read_bytes()
        assert data == lake.blobs[row.file_blob]
        assert hashlib.sha256(data).hexdigest() == row.file_blob.split(".")[0]
        assert len(data) == row.size_bytes
    beyond = {name for name in contents(whole) if not name.endswith(".exported")} - {f"{row.format}/{row.path}" for row in rows}
    assert beyond, "the files of the Habitat dataset, which belong to no scene alone"
    assert all(name.startswith("habitat/") for name in beyond)
    assert sorted(path.name for path in whole.iterdir()) == sorted(EXPORT_FORMATS), "nothing half made is left"


def test_files_are_copies_not_links_into_the_lake(lake: Lake, whole: Path) -> None:
    for path in whole.rglob("*"):
        assert not path.is_symlink()
        assert path.is_dir() or path.stat().st_nlink == 1, "whoever edits an export must not edit the lake"


def test_the_usd_scene_opens_with_all_that_stands_in_it(lake: Lake, whole: Path) -> None:
    from pxr import Usd, UsdGeom, UsdPhysics

    written = write_exports(lake, whole, formats=("usd",))
    assert len(written.usd_scenes) == len(SCENES)
    for file in written.usd_scenes:
        assert file.is_relative_to(whole / "usd")
        usd = Usd.Stage.Open(str(file))
        assert usd.GetDefaultPrim()
        assert UsdGeom.GetStageUpAxis(usd) == UsdGeom.Tokens.z
        assert UsdGeom.GetStageMetersPerUnit(usd) == 1.0
        prims = list(usd.Traverse(Usd.TraverseInstanceProxies()))
        assert sum(prim.HasAPI(UsdPhysics.RigidBodyAPI) for prim in prims) == len(OBJECTS)
        assert sum(prim.IsA(UsdGeom.Mesh) for prim in prims) > len(OBJECTS), "objects and room"
        missing = [layer for layer in usd.GetUsedLayers() if not layer.anonymous and not Path(layer.realPath).is_relative_to(whole)]
        assert missing == [], "layers from elsewhere"


def test_a_second_export_replaces_the_first(lake: Lake, whole: Path, tmp_path: Path) -> None:
    write_exports(lake, tmp_path)
    assert contents(tmp_path) == contents(whole)
    scene = next((tmp_path / "usd").rglob("scene.usda"))
    scene.write_text("edited")
    (tmp_path / "usd" / "stale.usda").write_text("of an older export")
    (tmp_path / "habitat" / "old").mkdir()
    write_exports(lake, tmp_path)
    assert contents(tmp_path) == contents(whole)


def test_a_format_alone_leaves_the_other_and_its_neighbors_alone(lake: Lake, whole: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    write_exports(lake, tmp_path, formats=("usd",))
    assert contents(tmp_path / "usd") == contents(whole / "usd")
    assert not (tmp_path / "habitat").exists()
    write_exports(lake, tmp_path, formats=("habitat",))
    assert contents(tmp_path / "usd") == contents(whole / "usd")
    assert contents(tmp_path / "habitat") == contents(whole / "habitat")
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("taken", EXPORT_FORMATS)
def test_a_folder_with_foreign_files_is_refused_before_anything_is_changed(lake: Lake, tmp_path: Path, taken: str) -> None:
    other = next(name for name in EXPORT_FORMATS if name != taken)
    write_exports(lake, tmp_path, formats=(other,), scenes=SCENES[:1])
    (tmp_path / taken).mkdir()
    (tmp_path / taken / "thesis.txt").write_text("mine")
    before = contents(tmp_path)
    with pytest.raises(InputError) as refused:
        write_exports(lake, tmp_path)
    assert str(tmp_path / taken) in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    assert contents(tmp_path) == before


def test_a_file_in_the_place_of_a_folder_is_refused_and_kept(lake: Lake, tmp_path: Path) -> None:
    (tmp_path / "usd").write_text("mine")
    with pytest.raises(InputError, match="usd"):
        write_exports(lake, tmp_path)
    assert contents(tmp_path) == {"usd": b"mine"}


def test_an_empty_folder_may_be_filled(lake: Lake, whole: Path, tmp_path: Path) -> None:
    (tmp_path / "usd").mkdir()
    write_exports(lake, tmp_path, formats=("usd",))
    assert contents(tmp_path / "usd") == contents(whole / "usd")


def test_one_scene_alone(lake: Lake, whole: Path, tmp_path: Path) -> None:
    write_exports(lake, tmp_path)
    written = write_exports(lake, tmp_path, scenes=SCENES[1:])
    assert written.findings == ()
    assert len(written.usd_scenes) == 1
    mine = {f"{row.format}/{row.path}" for row in rows_of(lake) if row.scene_id == SCENES[1]}
    assert mine <= set(contents(tmp_path))
    others = {f"{row.format}/{row.path}" for row in rows_of(lake)} - mine
    assert others
    assert not others & set(contents(tmp_path)), "the scene that was there before is gone with its folder"
    full = contents(whole)
    assert all(contents(tmp_path)[name] == full[name] for name in mine)
    text = b"".join(data for name, data in contents(tmp_path).items() if name.endswith(".json"))
    assert b"scene0000_00" not in text, "the dataset speaks of no scene that is not there"


def test_a_scene_that_is_not_there_is_refused_and_nothing_is_written(lake: Lake, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="scannet/scene0009_00"):
        write_exports(lake, tmp_path / "out", scenes=[*SCENES, "scannet/scene0009_00"])
    assert not (tmp_path / "out").exists()


def test_packages_stand_beside_their_folders_and_are_replaced_with_them(lake: Lake, whole: Path, tmp_path: Path) -> None:
    written = write_exports(lake, tmp_path, formats=("usd",), usdz=True)
    assert written.findings == ()
    assert [path.with_suffix("") for path in written.usd_packages] == [path.parent for path in written.usd_scenes]
    packages = {path.name: path.read_bytes() for path in written.usd_packages}
    for path in written.usd_packages:
        with zipfile.ZipFile(path) as archive:
            inside = {name: archive.read(name) for name in archive.namelist()}
        assert inside == contents(path.with_suffix(""))
    write_exports(lake, tmp_path, formats=("usd",), usdz=True)
    assert {path.name: path.read_bytes() for path in written.usd_packages} == packages
    write_exports(lake, tmp_path, formats=("usd",))
    assert contents(tmp_path / "usd") == contents(whole / "usd")
    with pytest.raises(InputError, match="--format usd"):
        write_exports(lake, tmp_path, formats=("habitat",), usdz=True)


def test_scenes_of_a_release_say_so_and_others_do_not(lake: Lake, whole: Path, tmp_path: Path) -> None:
    from pxr import Sdf

    with pytest.raises(InputError, match=r"no release 'v1'.*there are: none"):
        write_exports(lake, tmp_path, release="v1")
    release = make_release(lake, "v1")
    with pytest.raises(InputError, match="--snapshot"):
        write_exports(lake, tmp_path, snapshot_id=release.snapshot_id, release="v1")
    with pytest.raises(InputError, match=r"no release 'v2'.*there are: v1"):
        write_exports(lake, tmp_path, release="v2")
    assert contents(tmp_path) == {}
    assert write_exports(lake, tmp_path, formats=("usd",), release="v1").findings == ()
    first, plain = contents(tmp_path / "usd"), contents(whole / "usd")
    assert {name for name in plain if first[name] != plain[name]} == {name for name in plain if name.endswith("/scene.usda")}
    for path in (tmp_path / "usd").glob("*/scene.usda"):
        stated = Sdf.Layer.FindOrOpen(str(path)).customLayerData["metascenes"]
        assert (stated["release"], stated["snapshot_id"]) == ("v1", release.snapshot_id)
    write_exports(lake, tmp_path, formats=("usd",), release="v1")
    assert contents(tmp_path / "usd") == first


SPOILED = {"usd": "physics.usda", "habitat": ".scene_instance.json", "mjcf": "scene.xml", "urdf": "poses.json", "glb": ".glb",
           "nav2": "map.pgm", "sdf": "world.sdf"}  # fmt: skip
"""An ending of files that no scene is sound without, by format."""


@pytest.mark.parametrize("format_", EXPORT_FORMATS)
def test_what_is_written_is_checked_again_in_every_format(
    lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, format_: str
) -> None:
    """A disk that cuts files off: the rows in the lake have passed, the folder does not."""
    from flows.outputs import export

    copy = export._copy

    def cut(lake: Lake, blob: str, target: Path) -> None:
        copy(lake, blob, target)
        if target.name.endswith(SPOILED[format_]):
            target.write_bytes(target.read_bytes()[:100])

    monkeypatch.setattr(export, "_copy", cut)
    written = write_exports(lake, tmp_path, formats=(format_,), scenes=SCENES[:1])
    assert written.failed_checks
    assert all(line.startswith(str(tmp_path / format_)) and len(line.splitlines()) == 1 for line in written.findings)
