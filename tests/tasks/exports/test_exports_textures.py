"""The room's images in every format, read back by readers of others; and ceilings, where they are wanted."""

from __future__ import annotations

import dataclasses
import io
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from PIL import Image

from tasks import exports
from tasks.containers import open_glb
from tasks.exports.bodies import Replica
from tasks.exports.files import write_folder
from tasks.exports.glb import glb_files
from tasks.exports.glb.rules import check_glb
from tasks.exports.lighting import lamps, viewpoint
from tasks.exports.mjcf import mjcf_files
from tasks.exports.mjcf.rules import check_mjcf
from tasks.exports.urdf import urdf_files
from tasks.exports.urdf.rules import check_urdf
from tasks.exports.usd import write_usd
from tasks.exports.usd.package import package
from tasks.exports.usd.rules import check_usd
from tasks.shell import ShellConfig, room_shell
from tasks.stage import Context
from tests.replicas import cube, painted, replica_of, room_of, rows_of, translation, with_navigation

OPENING = (-2.0, -2.0, -1.0, -2.0, 0.0, 2.0, 0.05)
INNER = (-2.0, 1.0, 0.0, 1.0, 0.1, 2.0)
CEILING = dataclasses.replace(exports.ExportsConfig(), shell=ShellConfig(ceiling=True))
BARE = "wall_03"
"""The wall that has no image."""


def rows_and_blobs() -> tuple[dict[str, list[Any]], Any]:
    """An L-shaped room with a doorway and an inner wall, and a box in it."""
    rows, blobs = rows_of([cube((0.3, 0.2, 0.25), translation([1.0, -1.0, 0.0]))])
    rows["shells"] = [dataclasses.replace(rows["shells"][0], openings=(OPENING,), interior_walls=(INNER,))]
    return painted(rows, blobs), blobs


@pytest.fixture(scope="module")
def replica() -> Replica:
    return replica_of(*rows_and_blobs())


@pytest.fixture(scope="module")
def closed() -> Replica:
    return replica_of(*rows_and_blobs(), CEILING)


def images(replica: Replica) -> dict[str, bytes]:
    """The file of every part's image."""
    return {name: part.visual.material.baseColorTexture.info["encoded file"] for name, part in replica.shell if name != BARE}


def test_pieces_of_a_wall_share_its_image(replica: Replica) -> None:
    names = [name for name, _ in replica.shell]
    assert {"floor", "wall_00", "wall_00_1", "inner_00", BARE} <= set(names)
    assert "ceiling" not in names
    files = images(replica)
    assert files["wall_00"] == files["wall_00_1"]
    assert len(set(files.values())) == len({name.rsplit("_", name.count("_") - 1)[0] for name in files})
    bare = dict(room_shell(replica.room))
    for name, part in replica.shell:
        np.testing.assert_array_equal(part.vertices, bare[name].vertices)
        assert part.is_volume == bare[name].is_volume


def test_a_glb_has_every_image_once_as_it_is(replica: Replica, tmp_path: Path) -> None:
    (file,) = glb_files(replica, exports.ExportsConfig())
    (tmp_path / "scene.glb").write_bytes(file.data)
    assert check_glb(tmp_path / "scene.glb") == []
    document, binary = open_glb(file.data)
    views = document["bufferViews"]
    places = {image["bufferView"] for image in document["images"]}
    kept = [binary[views[place]["byteOffset"] :][: views[place]["byteLength"]] for place in places]
    assert sorted(data.rstrip(b"\0") for data in kept) == sorted(set(images(replica).values()))
    scene: Any = trimesh.load_scene(tmp_path / "scene.glb")
    for name, part in replica.shell:
        node = scene.graph[f"room_{name}"][1]
        visual = scene.geometry[node].visual
        assert (visual.kind == "texture" and visual.material.baseColorTexture is not None) == (name != BARE)
        if name != BARE:
            np.testing.assert_allclose(visual.uv, part.visual.uv, atol=1e-6)


def test_usd_binds_the_images_and_they_lie_in_its_package(replica: Replica, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdShade

    path = write_usd(tmp_path, replica, exports.ExportsConfig())
    assert check_usd(path) == []
    files = {f.relative_to(path.parent).as_posix(): f.read_bytes() for f in path.parent.rglob("*") if f.is_file()}
    (tmp_path / "scene.usdz").write_bytes(package(files, "scene.usda"))
    with zipfile.ZipFile(tmp_path / "scene.usdz") as archive:
        names = archive.namelist()
    for opened in (path, tmp_path / "scene.usdz"):
        stage = Usd.Stage.Open(str(opened))
        for name, part in replica.shell:
            prim = stage.GetPrimAtPath(f"/World/Room/{name.capitalize()}/Visual")
            material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
            shaders = [UsdShade.Shader(p) for p in Usd.PrimRange(material.GetPrim()) if p.IsA(UsdShade.Shader)]
            images_ = [s for s in shaders if s.GetIdAttr().Get() == "UsdUVTexture"]
            assert len(images_) == (name != BARE)
            coordinates = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st")
            if name == BARE:
                assert not coordinates
                continue
            assert coordinates.IsIndexed()
            np.testing.assert_allclose(np.array(coordinates.ComputeFlattened()), part.visual.uv, atol=1e-6)
            file = images_[0].GetInput("file").Get()
            assert file.resolvedPath, "the file is where the stage looks for it"
            assert any(entry.endswith(file.path.removeprefix("./")) for entry in names)


def test_mujoco_loads_the_images(replica: Replica, tmp_path: Path) -> None:
    import mujoco

    files = mjcf_files(replica, exports.ExportsConfig())
    write_folder(tmp_path, {file.path: file.data for file in files})
    path = tmp_path / replica.stem / "scene.xml"
    assert check_mjcf(path) == []
    model = mujoco.MjModel.from_xml_path(str(path))
    for name, _ in replica.shell:
        material = int(model.geom(f"room_{name}_part_00").matid[0])
        assert (material >= 0) == (name != BARE)
        if material >= 0:
            texture = int(model.mat_texid[material].max())
            assert (model.tex_width[texture], model.tex_height[texture]) == (128, 64)
            start = int(model.tex_adr[texture])
            pixels = model.tex_data[start : start + 128 * 64 * 3].reshape(64, 128, 3)
            true = np.asarray(Image.open(io.BytesIO(images(replica)[name])))
            assert np.array_equal(pixels, true)
    assert sum(file.role == "texture" for file in files) == len(set(images(replica).values()))


@pytest.mark.whole
def test_urdf_and_habitat_have_the_images(replica: Replica, tmp_path: Path) -> None:
    files = urdf_files(replica, exports.ExportsConfig())
    write_folder(tmp_path, {file.path: file.data for file in files})
    assert check_urdf(tmp_path / replica.stem) == []
    assert {file.data for file in files if file.role == "texture"} == set(images(replica).values())
    rows, blobs = with_navigation(*rows_and_blobs())
    context = Context("demo/room_01", "exports", 0, blobs)
    config = dataclasses.replace(exports.ExportsConfig(), formats=("habitat",))
    outcome = exports.run(**{name: rows[name] for name in exports.STAGE.reads}, context=context, config=config)
    assert all(check.passed for check in outcome.rows["export_checks"]), outcome.rows["export_checks"]
    (stage,) = [row for row in outcome.rows["export_files"] if row.path.startswith("stages/") and row.path.endswith(".glb")]
    document, _ = open_glb(outcome.blobs[stage.file_blob])
    assert len({image["bufferView"] for image in document["images"]}) == len(set(images(replica).values()))


def test_a_ceiling_closes_the_room_over_lamps_and_camera(closed: Replica, tmp_path: Path) -> None:
    parts = dict(closed.shell)
    assert set(parts) - {name for name, _ in room_shell(closed.room)} == {"ceiling"}
    ceiling = parts["ceiling"]
    height = closed.room.height_m
    assert ceiling.bounds[:, 2] == pytest.approx([height, height + ShellConfig().thickness_m])
    np.testing.assert_allclose(ceiling.bounds[:, :2], parts["floor"].bounds[:, :2])
    assert ceiling.is_volume
    assert ceiling.visual.kind == "texture"
    assert (lamps(closed.room)[:, 2] < height - 0.05).all()
    assert viewpoint(closed)[2, 3] < height - 0.05
    (file,) = glb_files(closed, CEILING)
    (tmp_path / "scene.glb").write_bytes(file.data)
    assert check_glb(tmp_path / "scene.glb") == []
    assert check_usd(write_usd(tmp_path, closed, CEILING)) == []
    files = mjcf_files(closed, CEILING)
    write_folder(tmp_path, {f.path: f.data for f in files})
    path = tmp_path / closed.stem / "scene.xml"
    assert check_mjcf(path) == []
    names = {geom.get("name") for geom in ElementTree.parse(path).iter("geom")}
    assert {"room_ceiling_part_00", "room_ceiling_hull_00"} <= names


def test_navigation_and_episodes_are_the_same_under_a_ceiling() -> None:
    rows, blobs = with_navigation(*rows_and_blobs())
    checks = {}
    for name, config in (("open", exports.ExportsConfig()), ("closed", CEILING)):
        config = dataclasses.replace(config, formats=("habitat",))
        context = Context("demo/room_01", "exports", 0, blobs)
        outcome = exports.run(**{table: rows[table] for table in exports.STAGE.reads}, context=context, config=config)
        assert all(check.passed for check in outcome.rows["export_checks"]), outcome.rows["export_checks"]
        checks[name] = {row.path: row.file_blob for row in outcome.rows["export_files"] if row.role in ("navmesh", "episodes")}
    assert checks["open"] == checks["closed"]
    assert checks["open"]


def test_without_images_and_ceiling_a_room_is_as_before() -> None:
    for _, part in replica_of(*rows_of([])).shell:
        assert part.visual.kind == "vertex"
    names = [name for name, _ in room_shell(room_of())]
    assert [name for name, _ in room_shell(room_of(), ShellConfig(ceiling=True))] == [*names, "ceiling"]
