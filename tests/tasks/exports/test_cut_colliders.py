"""Exports collide as the optimization's certificates did: where a placement has convex pieces of its own, they stand for the asset's."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics

from schemas.capture import Scene as SceneRow
from tasks.containers import open_glb
from tasks.exports.bodies import gather
from tasks.exports.config import ExportsConfig
from tasks.exports.files import write_folder
from tasks.exports.format import ExportedScene
from tasks.exports.formats import FORMATS
from tasks.geometry.mass import mass_properties
from tasks.geometry.transforms import translation
from tests.samples import sample
from tests.tasks.optimization.scenes import SCENE, Scene, block, colliders


def test_pieces_of_a_placement_alone_are_those_of_the_exported_body() -> None:
    scene = Scene()
    cabinet = scene.add(block(1.0, 1.0, 0.8), np.eye(4), "cabinet")
    box = scene.add(block(0.8, 0.8, 0.6), translation([0.8, 0.0, 0.0]), "box")  # 10 cm in the cabinet, which is cut
    other = scene.add(block(1.0, 1.0, 0.8), translation([-1.3, 1.0, 0.0]), "cabinet")  # the same asset, whole
    scene.selections[2] = dataclasses.replace(scene.selections[2], asset_id=scene.selections[0].asset_id)
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    assert rows[cabinet].collider_blob is not None
    assert rows[box].collider_blob is rows[other].collider_blob is None
    replica, missed = gather(
        [sample(SceneRow, scene_id=SCENE)], scene.shells, scene.instances, scene.captions, list(scene.assets.values()),
        outcome.rows["placements"], outcome.rows["supports"], {**scene.blobs, **outcome.blobs}, ExportsConfig(),
    )  # fmt: skip
    assert missed == []
    bodies = {body.instance_id: body for body in replica.bodies}
    for name, hulls in colliders(outcome, scene).items():
        placed = [hull.transformed(bodies[name].pose) for hull in bodies[name].shape.hulls]
        assert len(placed) == len(hulls)
        for made, expected in zip(placed, hulls, strict=True):
            assert np.sort(made.vertices, axis=0) == pytest.approx(np.sort(expected.vertices, axis=0), abs=1e-6)
        assert bodies[name].shape.properties.volume == pytest.approx(mass_properties(hulls).volume, rel=1e-4)
    assert bodies[cabinet].shape.name != bodies[other].shape.name, "one asset, two colliders"
    assert bodies[cabinet].shape.properties.volume < 0.95 * bodies[other].shape.properties.volume


def test_brackets_of_supports_are_static_parts_of_the_exported_room(tmp_path: Path) -> None:
    """What stands on a shelf that no scan shows stays there in exported files as in its certificate; nobody sees the shelf."""
    scene = Scene()
    vase = scene.add(block(0.12, 0.2, 0.3), translation([-1.8, 0.3, 1.4]), "vase")
    outcome = scene.run()
    replica, missed = gather(
        [sample(SceneRow, scene_id=SCENE)], scene.shells, scene.instances, scene.captions, list(scene.assets.values()),
        outcome.rows["placements"], outcome.rows["supports"], {**scene.blobs, **outcome.blobs}, ExportsConfig(),
    )  # fmt: skip
    assert missed == []
    ((name, board),) = replica.brackets
    assert name == f"bracket_{vase}"
    assert name not in dict(replica.shell)
    assert board.bounds[1][2] == pytest.approx(1.4, abs=1e-4)
    for export_format in FORMATS:
        export = export_format.make(ExportedScene(replica, (), (), {}, ExportsConfig()))
        assert export.findings == [], export_format.name
        if export_format.name in ("mjcf", "sdf", "urdf"):  # rooms of the others are one mesh, or binary
            assert any(f"bracket_{vase}".encode() in file.data for file in export.files), export_format.name
        write_folder(tmp_path / export_format.name, {file.path: file.data for file in export.files})
    stage = Usd.Stage.Open(str(next((tmp_path / "usd").rglob("scene.usda"))))
    assert stage.GetPrimAtPath(f"/World/Room/Bracket_{vase}/Collider").HasAPI(UsdPhysics.CollisionAPI)
    assert not stage.GetPrimAtPath(f"/World/Room/Bracket_{vase}").HasAPI(UsdPhysics.RigidBodyAPI)
    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh) and f"Bracket_{vase}" in str(prim.GetPath())]
    assert [UsdGeom.Imageable(prim).ComputePurpose() for prim in meshes] == [UsdGeom.Tokens.guide], "nothing of it is drawn"
    urdf = ElementTree.parse(next((tmp_path / "urdf").rglob("room.urdf")))
    (link,) = urdf.iterfind(f"link[@name='room_{name}']")
    assert (len(link.findall("collision")), len(link.findall("visual"))) == (1, 0)
    world = ElementTree.parse(next((tmp_path / "sdf").rglob("*.sdf"))).getroot()
    (room,) = world.iterfind("world/model[@name='room']/link")
    assert len([part for part in room.iterfind("collision") if name in part.attrib["name"]]) == 1
    assert not [part for part in room.iterfind("visual") if name in part.attrib["name"]]
    (file,) = (tmp_path / "glb").rglob("*.glb")
    assert not [node for node in open_glb(file.read_bytes(), file.name)[0]["nodes"] if "bracket" in node["name"]]
    settings = json.loads(next((tmp_path / "habitat").rglob("*.stage_config.json")).read_text())
    assert settings["render_asset"] != settings["collision_asset"]
    for key, parts in (("render_asset", replica.shell), ("collision_asset", (*replica.shell, *replica.brackets))):
        nodes = open_glb((tmp_path / "habitat" / "stages" / settings[key]).read_bytes(), settings[key])[0]["nodes"]
        assert {node["name"] for node in nodes if "mesh" in node} == {part for part, _ in parts}
    path = next((tmp_path / "mjcf").rglob("scene.xml"))
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.geom_group[model.geom_bodyid == model.body(f"room_{name}").id].tolist() == [3]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.qpos[2]
    for _ in range(round(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert data.qpos[2] == pytest.approx(start, abs=0.002)
