"""The USD scene: the same geometry as the replica, a gate that catches damage, and bodies that rest in a simulator."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tasks import exports
from tasks.exports.bodies import Replica, gather
from tasks.exports.usd import write_usd
from tasks.exports.usd_rules import RULES, check_usd
from tasks.mass import principal_axes, solid_properties
from tasks.replica import placed_parts, room_shell
from tests.replicas import furnished, rows_of

Rows = dict[str, list[Any]]
TABLES = ("scenes", "rooms", "instances", "captions", "assets", "placements", "supports")


def replica_of(rows: Rows, blobs: Any, config: exports.ExportsConfig | None = None) -> Replica:
    replica, missed = gather(*[rows[name] for name in TABLES], blobs, config or exports.ExportsConfig())
    assert missed == []
    return replica


@pytest.fixture(scope="module")
def scene() -> tuple[Rows, Any]:
    return rows_of(furnished())


@pytest.fixture(scope="module")
def usd(scene: tuple[Rows, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_usd(tmp_path_factory.mktemp("usd"), replica_of(*scene), exports.ExportsConfig())


@pytest.fixture
def copy(usd: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(usd.parent, tmp_path / "moved" / "elsewhere")) / usd.name


def points_below(stage: Any, path: str, purpose: str) -> np.ndarray:
    """World positions [m] of the meshes of one purpose below a prim."""
    from pxr import Usd, UsdGeom

    found = []
    cache = UsdGeom.XformCache()
    for prim in Usd.PrimRange(stage.GetPrimAtPath(path), Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Mesh) and UsdGeom.Imageable(prim).ComputePurpose() == purpose:
            matrix = np.array(cache.GetLocalToWorldTransform(prim))
            found.append(np.asarray(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=np.float64) @ matrix[:3, :3] + matrix[3, :3])
    return np.concatenate(found)


def open_stage(path: Path) -> Any:
    from pxr import Usd

    return Usd.Stage.Open(str(path))


def test_a_sound_scene_has_no_findings_wherever_it_lies(usd: Path, copy: Path) -> None:
    assert check_usd(usd) == []
    shutil.rmtree(copy.parent / "nothing", ignore_errors=True)
    assert check_usd(copy) == []


@pytest.mark.parametrize("instanceable", [False, True])
def test_objects_are_drawn_where_the_replica_has_them(scene: tuple[Rows, Any], tmp_path: Path, instanceable: bool) -> None:
    rows, blobs = scene
    config = exports.ExportsConfig(usd=exports.UsdConfig(instanceable=instanceable))
    replica = replica_of(rows, blobs, config)
    path = write_usd(tmp_path, replica, config)
    assert check_usd(path) == []
    stage = open_stage(path)
    assets = {asset.asset_id: asset for asset in rows["assets"]}
    for placement, body in zip(rows["placements"], replica.bodies, strict=True):
        expected = np.concatenate([part.vertices for part in placed_parts(placement, blobs[assets[placement.asset_id].mesh_blob])])
        found = points_below(stage, f"/World/Objects/{body.name}", "default")
        assert len(found) == len(expected)
        np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0), atol=2e-5)
        solid = points_below(stage, f"/World/Objects/{body.name}", "guide")
        assert (solid.min(axis=0) >= expected.min(axis=0) - 0.005).all()
        assert (solid.max(axis=0) <= expected.max(axis=0) + 0.005).all()
        assert solid[:, 2].min() >= expected[:, 2].min() - 2e-5


def test_the_room_is_the_replicas_room(scene: tuple[Rows, Any], usd: Path) -> None:
    shell = np.concatenate([mesh.vertices for _, mesh in room_shell(scene[0]["rooms"][0])])
    found = points_below(open_stage(usd), "/World/Room", "default")
    np.testing.assert_allclose([found.min(axis=0), found.max(axis=0)], [shell.min(axis=0), shell.max(axis=0)], atol=1e-6)


def test_bodies_have_the_mass_and_friction_of_their_captions(scene: tuple[Rows, Any], usd: Path) -> None:
    from pxr import UsdPhysics, UsdShade

    stage = open_stage(usd)
    replica = replica_of(*scene)
    shapes = set()
    for body in replica.bodies:
        prim = stage.GetPrimAtPath(f"/World/Objects/{body.name}")
        moves = prim.HasAPI(UsdPhysics.RigidBodyAPI)
        assert moves == (not body.is_fixed)
        if moves:
            assert UsdPhysics.MassAPI(prim).GetMassAttr().Get() == pytest.approx(body.mass_kg)
        hull = stage.GetPrimAtPath(f"/World/Objects/{body.name}/Colliders/Hull_00")
        material, _ = UsdShade.MaterialBindingAPI(hull).ComputeBoundMaterial("physics")
        assert UsdPhysics.MaterialAPI(material).GetStaticFrictionAttr().Get() == pytest.approx(body.friction)
        assert prim.GetCustomDataByKey("metascenes")["instance_id"] == body.instance_id
        assert prim.GetAttribute("semantics:labels:category").Get() == [body.category]
        shapes.add(body.shape.name)
    assert len(shapes) == 5, "the two chairs are one asset"
    assert len(list((usd.parent / "assets").iterdir())) == 5
    assert sum(body.is_fixed for body in replica.bodies) == 1


def test_inertia_is_that_of_the_hulls_by_another_way(usd: Path) -> None:
    """Monte Carlo inside the hulls against what the file says."""
    from pxr import UsdPhysics
    from scipy.spatial import Delaunay

    stage = open_stage(usd)
    prim = stage.GetPrimAtPath("/World/Objects/table_0001")
    hulls = list(prim.GetChild("Colliders").GetChildren())
    clouds = [np.asarray(child.GetAttribute("points").Get(), dtype=np.float64) for child in hulls]
    everything = np.concatenate(clouds)
    low, high = everything.min(axis=0), everything.max(axis=0)
    samples = low + (high - low) * np.random.default_rng(0).random((400_000, 3))
    inside = np.zeros(len(samples), dtype=bool)
    for cloud in clouds:
        inside |= Delaunay(cloud).find_simplex(samples) >= 0
    solid = samples[inside]
    api = UsdPhysics.MassAPI(prim)
    center = np.array(api.GetCenterOfMassAttr().Get())
    np.testing.assert_allclose(center, solid.mean(axis=0), atol=0.01)
    around = solid - solid.mean(axis=0)
    covariance = around.T @ around / len(around)
    expected = api.GetMassAttr().Get() * (np.trace(covariance) * np.eye(3) - covariance)
    quaternion = api.GetPrincipalAxesAttr().Get()
    from scipy.spatial.transform import Rotation

    axes = Rotation.from_quat([*quaternion.GetImaginary(), quaternion.GetReal()]).as_matrix()
    stated = axes @ np.diag(api.GetDiagonalInertiaAttr().Get()) @ axes.T
    np.testing.assert_allclose(stated, expected, atol=0.03 * np.trace(expected))


def test_textures_are_kept_byte_for_byte(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    from tasks.exports.glb import node_textures
    from tasks.meshes import canonical, load_glb
    from tests.replicas import Thing

    parts = canonical(load_glb((realdata("assets") / "aws_ShoeRack_01.glb").read_bytes()))
    rows, blobs = rows_of([Thing("shoe rack", parts, [], np.eye(4), known=False, scale=(1.1, 0.9, 1.0))])
    path = write_usd(tmp_path, replica_of(rows, blobs), exports.ExportsConfig())
    assert check_usd(path) == []
    images = [data for data, _ in node_textures(blobs[rows["assets"][0].mesh_blob]).values()]
    assert sorted(file.read_bytes() for file in path.parent.rglob("textures/*")) == sorted(set(images))
    stage = open_stage(path)
    mesh = next(prim for prim in stage.Traverse() if prim.HasAttribute("primvars:st"))
    assert len(mesh.GetAttribute("primvars:st").Get()) == len(mesh.GetAttribute("points").Get())


# ---- damage


def edit_layer(path: Path, change: Callable[[Any], None]) -> None:
    """Change one layer through its stage and save it."""
    stage = open_stage(path)
    stage.SetEditTarget(stage.GetRootLayer())
    change(stage)
    stage.GetRootLayer().Save()


def in_scene(change: Callable[[Any], None]) -> Callable[[Path], None]:
    return lambda path: edit_layer(path, change)


def attribute(path: str, name: str, value: Any) -> Callable[[Path], None]:
    """Set an attribute that exists, in the scene's own layer."""

    def change(stage: Any) -> None:
        found = stage.GetPrimAtPath(path).GetAttribute(name)
        assert found, f"{path}.{name}"
        found.Set(value)

    return in_scene(change)


def apply(path: str, name: str) -> Callable[[Path], None]:
    """Apply an API schema of UsdPhysics to a prim."""

    def change(stage: Any) -> None:
        from pxr import UsdPhysics

        getattr(UsdPhysics, name).Apply(stage.GetPrimAtPath(path))

    return in_scene(change)


def drop_mass(path: Path) -> None:
    """A file whose bodies lost their mass."""
    for file in path.parent.glob("assets/*/*_physics.usda"):
        file.write_text("\n".join(line for line in file.read_text().splitlines() if "physics:mass" not in line) + "\n")


def replace_text(pattern: str, old: str, new: str) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        files = sorted(path.parent.glob(pattern))
        hits = [file for file in files if old in file.read_text()]
        assert hits, old
        for file in hits:
            file.write_text(file.read_text().replace(old, new))

    return damage


def sink_hull(path: Path) -> None:
    """A collider that reaches 4 mm below what is seen, as CoACD's pre-processing makes them."""

    def change(stage: Any) -> None:
        points = stage.GetPrimAtPath(f"{CHAIR}/Colliders/Hull_00").GetAttribute("points")
        values = np.array(points.Get())
        values[:, 2] -= values[:, 2].min() + 0.004
        points.Set([tuple(map(float, value)) for value in values])

    edit_layer(path, change)


def dent_hull(path: Path) -> None:
    """A collider with one vertex pushed to its middle."""

    def change(stage: Any) -> None:
        points = stage.GetPrimAtPath(f"{BOX}/Colliders/Hull_00").GetAttribute("points")
        values = np.array(points.Get())
        values[0] = values.mean(axis=0)
        points.Set([tuple(map(float, value)) for value in values])

    edit_layer(path, change)


def hide(path: Path) -> None:
    def change(stage: Any) -> None:
        from pxr import UsdGeom

        UsdGeom.Imageable(stage.GetPrimAtPath(CHAIR)).MakeInvisible()

    edit_layer(path, change)


def scale_body(path: Path) -> None:
    def change(stage: Any) -> None:
        from pxr import Gf, UsdGeom

        UsdGeom.Xformable(stage.GetPrimAtPath(CHAIR)).AddScaleOp().Set(Gf.Vec3f(1.0, 2.0, 1.0))

    edit_layer(path, change)


def disable_colliders(path: Path) -> None:
    def change(stage: Any) -> None:
        for child in stage.GetPrimAtPath(f"{CHAIR}/Colliders").GetChildren():
            child.GetAttribute("physics:collisionEnabled").Set(False)

    edit_layer(path, change)


def clear_labels(path: Path) -> None:
    def change(stage: Any) -> None:
        for taxonomy in ("class", "category", "nyu40"):
            stage.GetPrimAtPath(CHAIR).GetAttribute(f"semantics:labels:{taxonomy}").Set([])

    edit_layer(path, change)


def unbind(path: Path) -> None:
    def change(stage: Any) -> None:
        from pxr import UsdShade

        prim = stage.GetPrimAtPath(f"{BOX}/Colliders")
        UsdShade.MaterialBindingAPI(prim).UnbindDirectBinding("physics")

    edit_layer(path, change)


CHAIR, BOX = "/World/Objects/chair_0002", "/World/Objects/box_0004"
LOOKS = "assets/*/*_looks.usda"
HULL = f"{BOX}/Colliders/Hull_00"
DAMAGES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "cut file": ("stage_opens", lambda path: path.write_text(path.read_text()[:-40])),
    "shader of no kind": ("usd_validation", replace_text(LOOKS, "UsdPreviewSurface", "UsdPreviewSurfac")),
    "binding without its schema": ("usd_validation", replace_text(LOOKS, 'prepend apiSchemas = ["MaterialBindingAPI"]', "active = true")),
    "unreadable layer": ("stage_opens", replace_text(LOOKS, '["MaterialBindingAPI"]', "[]")),
    "no default prim": ("default_prim", in_scene(lambda stage: stage.ClearDefaultPrim())),
    "no units": ("units", replace_text("scene.usda", "    metersPerUnit = 1\n", "")),
    "centimetres": ("units", replace_text("scene.usda", "metersPerUnit = 1", "metersPerUnit = 0.01")),
    "grams": ("units", replace_text("scene.usda", "kilogramsPerUnit = 1", "kilogramsPerUnit = 0.001")),
    "+Y up": ("up_axis", replace_text("scene.usda", 'upAxis = "Z"', 'upAxis = "Y"')),
    "no up axis": ("up_axis", replace_text("scene.usda", '    upAxis = "Z"\n', "")),
    "absolute path": ("closed_paths", replace_text("scene.usda", "@./room/room.usda@", "@/srv/room/room.usda@")),
    "path out of the folder": ("closed_paths", replace_text("scene.usda", "@./room/room.usda@", "@../room/room.usda@")),
    "lost geometry": ("closed_paths", lambda path: sorted(path.parent.glob("assets/*/*.usdc"))[0].unlink()),
    "gravity of the moon": ("physics_scene", attribute("/World/PhysicsScene", "physics:gravityMagnitude", 1.62)),
    "gravity sideways": ("physics_scene", attribute("/World/PhysicsScene", "physics:gravityDirection", (0, -1, 0))),
    "no physics scene": ("physics_scene", in_scene(lambda stage: stage.RemovePrim("/World/PhysicsScene"))),
    "nested bodies": ("nested_bodies", apply("/World/Objects", "RigidBodyAPI")),
    "body within a body": ("nested_bodies", apply(f"{CHAIR}/Visual", "RigidBodyAPI")),
    "scaled body": ("rigid_pose", scale_body),
    "position that is no number": ("finite_geometry", attribute(HULL, "points", [(float("nan"), 0, 0)] * 8)),
    "triangle of no vertices": ("finite_geometry", attribute(f"{BOX}/Visual/Part_00", "faceVertexIndices", [0, 1, 99] * 12)),
    "body without collider": ("collider", disable_colliders),
    "raw triangles": ("triangle_collider", attribute(HULL, "physics:approximation", "none")),
    "simplified triangles": ("triangle_collider", attribute(HULL, "physics:approximation", "meshSimplification")),
    "decomposition left to the engine": ("explicit_hulls", attribute(HULL, "physics:approximation", "convexDecomposition")),
    "dented hull": ("explicit_hulls", dent_hull),
    "no mass": ("mass", drop_mass),
    "mass below zero": ("mass", attribute(BOX, "physics:mass", -1.0)),
    "no inertia": ("inertia", attribute(BOX, "physics:diagonalInertia", (0, 0, 0))),
    "inertia below zero": ("inertia", attribute(BOX, "physics:diagonalInertia", (-1, 1, 1))),
    "inertia of no solid": ("inertia", attribute(BOX, "physics:diagonalInertia", (1, 1, 9))),
    "center of mass outside": ("center_of_mass", attribute(BOX, "physics:centerOfMass", (5, 0, 0))),
    "sunken collider": ("support_plane", sink_hull),
    "friction of 7": ("physics_material", attribute(f"{BOX}/PhysicsMaterial", "physics:staticFriction", 7.0)),
    "hidden object": ("visual", hide),
    "no friction": ("physics_material", unbind),
    "no label": ("labels", clear_labels),
}
WARNINGS = {"no friction", "no label"}
"""Damage that only makes a scene worse, not wrong."""


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_its_rule(name: str, copy: Path) -> None:
    rule, damage = DAMAGES[name]
    damage(copy)
    found = check_usd(copy)
    assert rule in {finding.rule for finding in found if finding.is_error != (name in WARNINGS)}, found


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _ in DAMAGES.values()} == set(RULES)


def test_scenes_of_others_are_read(realdata: Callable[[str], Path]) -> None:
    root = realdata("usd_physics")
    found = {path.name: {f.rule for f in check_usd(path) if f.is_error} for path in sorted(root.rglob("*.usda"))}
    assert found["boxes_fourbar.usda"] == set(), "a sound scene of Newton's"
    assert "up_axis" in found["simple_physics_scene.usda"], "+Y up, as its authors say"
    assert "physics_scene" in found["sensor_contact_scene.usda"], "it has none"
    assert all("nested_bodies" not in rules and "stage_opens" not in rules for rules in found.values())


def test_principal_axes_give_the_inertia_back() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        points = rng.normal(size=(12, 3)) * rng.uniform(0.01, 3, 3)
        from scipy.spatial import ConvexHull

        hull = ConvexHull(points)
        faces = hull.simplices.copy()
        corners = points[faces]
        turned = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), hull.equations[:, :3]) < 0
        faces[turned] = faces[turned][:, ::-1]
        properties = solid_properties(points, faces)
        assert properties.volume == pytest.approx(hull.volume)
        moments, axes = principal_axes(properties.inertia)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, properties.inertia, rtol=1e-9, atol=1e-12)
