"""Every format says the same of every object: pose, mass, center of mass, inertia, extents; each read by itself, from its files."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from schemas.families.export_formats import EXPORT_FORMATS
from tasks import exports
from tasks.exports.bodies import gather
from tasks.geometry.transforms import yaw_pose
from tests.replicas import Object, cube, furnished, obj, rows_of
from tests.tasks.exports.test_exports import export

Y_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""+Y up to +Z up, for readers of glTF and Habitat."""

TOLERANCE = 1e-5


@dataclasses.dataclass(frozen=True)
class Read:
    """An object as a format has it, in the world frame (+Z up). mass, center, inertia: None where it does not move, or is on a map."""

    pose: np.ndarray
    mass: float | None
    center: np.ndarray | None
    inertia: np.ndarray | None
    box: np.ndarray


def posed(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def moving(pose: np.ndarray, mass: float, center: Any, inertia: Any, points: np.ndarray) -> Read:
    """A reading out of mass properties in the object's own frame; points are in the world."""
    turn, local = pose[:3, :3], np.asarray(center, dtype=np.float64)
    box = np.array([points.min(axis=0), points.max(axis=0)])
    return Read(pose, mass, turn @ local + pose[:3, 3], turn @ np.asarray(inertia, dtype=np.float64) @ turn.T, box)


def read_usd(root: Path) -> dict[str, Read]:
    from pxr import Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.Open(str(next((root / "usd").glob("*/scene.usda"))))
    cache, found = UsdGeom.XformCache(), {}
    for prim in stage.GetPrimAtPath("/World/Objects").GetChildren():
        pose = np.array(cache.GetLocalToWorldTransform(prim)).T
        points = []
        for below in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()):
            if below.IsA(UsdGeom.Mesh) and UsdGeom.Imageable(below).ComputePurpose() == "default":
                to_world = np.array(cache.GetLocalToWorldTransform(below)).T
                points.append(
                    np.asarray(UsdGeom.Mesh(below).GetPointsAttr().Get(), dtype=np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
                )
        cloud = np.concatenate(points)
        if not prim.HasAPI(UsdPhysics.RigidBodyAPI):
            found[prim.GetName()] = Read(pose, None, None, None, np.array([cloud.min(axis=0), cloud.max(axis=0)]))
            continue
        api = UsdPhysics.MassAPI(prim)
        axes = api.GetPrincipalAxesAttr().Get()
        turn = Rotation.from_quat([*axes.GetImaginary(), axes.GetReal()]).as_matrix()
        tensor = turn @ np.diag(api.GetDiagonalInertiaAttr().Get()) @ turn.T
        found[prim.GetName()] = moving(pose, api.GetMassAttr().Get(), api.GetCenterOfMassAttr().Get(), tensor, cloud)
    return found


def read_mjcf(root: Path) -> dict[str, Read]:
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(next((root / "mjcf").glob("*/scene.xml"))))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    found = {}
    for body in range(1, model.nbody):
        name = model.body(body).name
        if name.startswith("room_"):
            continue
        cloud = []
        for geom in np.flatnonzero((model.geom_bodyid == body) & (model.geom_group == 2)):
            first, count = model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]]
            cloud.append(model.mesh_vert[first : first + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
        points = np.concatenate(cloud)
        axes = data.ximat[body].reshape(3, 3)
        pose = posed(data.xmat[body].reshape(3, 3), data.xpos[body])
        box = np.array([points.min(axis=0), points.max(axis=0)])
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        found[name] = Read(pose, float(model.body_mass[body]), data.xipos[body].copy(), inertia, box)
    return found


def read_urdf(root: Path) -> dict[str, Read]:
    import yourdfpy

    folder = next((root / "urdf").iterdir())
    told, found = json.loads((folder / "poses.json").read_text()), {}
    for item in told["objects"]:
        w, x, y, z = item["rotation_wxyz"]
        pose = posed(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(item["position_m"]))
        robot = yourdfpy.URDF.load(str(folder / item["file"]))
        (link,) = robot.robot.links
        assert link.name == item["name"]
        at = link.inertial.origin
        assert np.allclose(at[:3, :3], np.eye(3)), "inertia is told along the link's axes"
        points = trimesh.transform_points(np.asarray(robot.scene.to_mesh().vertices), pose)
        assert item["mass_kg"] == link.inertial.mass
        found[item["name"]] = moving(pose, link.inertial.mass, at[:3, 3], link.inertial.inertia, points)
    return found


def read_habitat(root: Path) -> dict[str, Read]:
    folder = root / "habitat"
    scene = json.loads(next((folder / "scenes").glob("*.scene_instance.json")).read_text())
    found = {}
    for item in scene["object_instances"]:
        config = json.loads((folder / "objects" / f"{item['template_name']}.object_config.json").read_text())
        w, x, y, z = item["rotation"]
        pose = posed(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(item["translation"]))
        assert item["translation_origin"] == "asset_local"
        mesh = trimesh.load_scene(folder / "objects" / config["render_asset"]).to_mesh()
        points = trimesh.transform_points(mesh.vertices, pose) @ Y_UP.T
        upright = posed(Y_UP @ pose[:3, :3] @ Y_UP.T, Y_UP @ pose[:3, 3])
        tensor = np.array(config["user_defined"]["inertia_kg_m2"])
        np.testing.assert_array_equal(config["inertia"], np.diag(tensor))
        name = f"{item['user_defined']['category']}_{item['user_defined']['instance_id']}"
        found[name] = moving(upright, config["mass"], Y_UP @ np.array(config["COM"]), Y_UP @ tensor @ Y_UP.T, points)
    return found


def read_glb(root: Path) -> dict[str, Read]:
    data = next((root / "glb").glob("*.glb")).read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    binary = data[28 + int.from_bytes(data[12:16], "little") :]
    found = {}

    def cloud(index: int, above: np.ndarray) -> list[np.ndarray]:
        """Positions of a node and all below it in the world."""
        node = document["nodes"][index]
        local = np.array(node["matrix"]).reshape(4, 4).T if "matrix" in node else np.eye(4)
        if "matrix" not in node:
            turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
            local = posed(turn * np.array(node.get("scale", [1, 1, 1])), np.array(node.get("translation", [0, 0, 0])))
        points = [p for child in node.get("children", []) for p in cloud(child, above @ local)]
        for primitive in document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
            accessor = document["accessors"][primitive["attributes"]["POSITION"]]
            view = document["bufferViews"][accessor["bufferView"]]
            start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
            flat = np.frombuffer(binary, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
            points.append(trimesh.transform_points(flat, above @ local) @ Y_UP.T)
        return points

    for index in document["scenes"][document["scene"]]["nodes"]:
        node = document["nodes"][index]
        if node["name"] == "room":
            continue
        pose = posed(Rotation.from_quat(node["rotation"]).as_matrix(), np.array(node["translation"]))
        upright = posed(Y_UP @ pose[:3, :3] @ Y_UP.T, Y_UP @ pose[:3, 3])
        about = node["extras"]
        tensor, center = Y_UP @ np.array(about["inertia_kg_m2"]) @ Y_UP.T, Y_UP @ np.array(about["center_of_mass_m"])
        found[node["name"]] = moving(upright, about["mass_kg"], center, tensor, np.concatenate(cloud(index, np.eye(4))))
    return found


READERS: dict[str, Callable[[Path], dict[str, Read]]] = {
    "usd": read_usd, "habitat": read_habitat, "mjcf": read_mjcf, "urdf": read_urdf, "glb": read_glb,
}  # fmt: skip


def readers() -> dict[str, Callable[[Path], dict[str, Read]]]:
    """The reader of every format: `read_objects` of the format's test, where it has none here."""
    others = [name for name in EXPORT_FORMATS if name not in READERS]
    return READERS | {name: import_module(f"tests.tasks.exports.test_exports_{name}").read_objects for name in others}


def differences(a: Read, b: Read) -> dict[str, float]:
    """How far two readings are apart: metres, radians, and relative to the greater."""
    turn = a.pose[:3, :3].T @ b.pose[:3, :3]
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    found = {
        "place": float(np.linalg.norm(a.pose[:3, 3] - b.pose[:3, 3])),
        "turn": float(np.arctan2(0.5 * np.linalg.norm(skew), 0.5 * (np.trace(turn) - 1.0))),
        "extents": float(np.abs(a.box - b.box).max()),
    }
    if a.mass is not None and b.mass is not None:
        assert a.center is not None
        assert b.center is not None
        assert a.inertia is not None
        assert b.inertia is not None
        found["mass"] = abs(a.mass - b.mass) / max(a.mass, b.mass)
        found["center"] = float(np.linalg.norm(a.center - b.center))
        found["inertia"] = float(np.abs(a.inertia - b.inertia).max() / np.abs(a.inertia).max())
    return found


def compare(objects: Sequence[Object], root: Path) -> None:
    """Export in every format, read each by itself, compare all with all, and with what was to be exported."""
    rows, blobs = rows_of(objects)
    config = exports.ExportsConfig()
    outcome = export(rows | {"navmeshes": [], "episodes": []}, blobs, config)
    exports.write_folder(root, {f"{row.format}/{row.path}": outcome.blobs[row.file_blob] for row in outcome.rows["export_files"]})
    tables = ("scenes", "shells", "instances", "captions", "assets", "placements", "supports")
    replica, _ = gather(*[rows[name] for name in tables], blobs, config)
    expected = {}
    for body in replica.bodies:
        points = np.concatenate([trimesh.transform_points(part.vertices, body.pose) for part in body.shape.parts])
        expected[body.name] = moving(body.pose, body.mass_kg, body.shape.properties.center, body.inertia, points)
    assert set(readers()) == set(EXPORT_FORMATS)
    assert len(expected) == len(objects)
    read = {"rows": expected, **{name: reader(root) for name, reader in readers().items()}}
    for name, seen in read.items():
        assert set(seen) == set(expected), name
    still = {body.name for body in replica.bodies if body.is_fixed}
    assert {name for name, one in read["usd"].items() if one.mass is None} == still
    assert all(one.mass is None for one in read["nav2"].values()), "a map says nothing of masses"
    assert all(one.mass is not None for kind in EXPORT_FORMATS if kind not in ("usd", "nav2") for one in read[kind].values())
    for first in read:
        for second in read:
            for name in expected:
                apart = differences(read[first][name], read[second][name])
                assert max(apart.values()) <= TOLERANCE, (first, second, name, apart)


@pytest.mark.whole
def test_an_office_is_the_same_in_every_format(tmp_path: Path) -> None:
    compare(furnished(), tmp_path)


@pytest.mark.whole
def test_textured_objects_are_the_same_in_every_format(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    from tasks.geometry.meshes import canonical, load_glb

    objects = []
    for place, name in enumerate(("aws_ShoeRack_01", "aws_Ball_01")):
        parts = canonical(load_glb((realdata("assets") / f"{name}.glb").read_bytes()))
        hull = trimesh.util.concatenate(parts).convex_hull
        objects.append(Object("thing", parts, [hull], yaw_pose(0.3 + place, [2.0 * place - 1.0, 0.0, 0.0]), scale=(1.1, 0.7, 1.3)))
    compare(objects, tmp_path)


@pytest.mark.parametrize("yaw", [1e-6, 1e-4, 2e-3, -2e-3, np.pi - 1e-4])
def test_small_turns_are_the_same_in_every_format(yaw: float, tmp_path: Path) -> None:
    """Where an angle is taken from the cosine of its half, single precision loses it."""
    compare([obj("chair", yaw_pose(yaw, [0.3, -0.2, 0.0]), 4), cube((1.5, 0.4, 0.7), yaw_pose(-3 * yaw))], tmp_path)


_NUMBER = st.floats(-1.0, 1.0, allow_nan=False)
_SIZE = st.floats(0.02, 2.0)


@st.composite
def objects(draw: st.DrawFn) -> list[Object]:
    """Furniture and boxes anywhere, turned any way, stretched any way, as light as a feather or as heavy as a safe."""
    found = []
    for _ in range(draw(st.integers(1, 3))):
        w, x, y, z = (draw(_NUMBER) for _ in range(4))
        turn = Rotation.from_quat([x, y, z, w if abs(w) + abs(x) + abs(y) + abs(z) > 1e-3 else 1.0]).as_matrix()
        pose = posed(turn, np.array([2 * draw(_NUMBER), 2 * draw(_NUMBER), 1.5 + draw(_NUMBER)]))
        scale = tuple(draw(st.floats(0.3, 3.0)) for _ in range(3))
        rest: dict[str, Any] = {
            "scale": scale,
            "mass_kg": draw(st.floats(1e-3, 300.0)),
            "relation": draw(st.sampled_from(["floor", "wall"])),
        }
        if draw(st.booleans()):
            found.append(cube(tuple(draw(_SIZE) for _ in range(3)), pose, **rest))
        else:
            found.append(obj(draw(st.sampled_from(["chair", "table", "mug", "bookshelf"])), pose, draw(st.integers(0, 50)), **rest))
    return found


@pytest.mark.whole
@settings(max_examples=12, deadline=None)
@given(drawn=objects())
def test_any_scene_is_the_same_in_every_format(drawn: list[Object], tmp_path_factory: pytest.TempPathFactory) -> None:
    compare(drawn, tmp_path_factory.mktemp("drawn"))
