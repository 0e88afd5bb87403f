"""The USD scene: the same geometry as the replica, a gate that catches damage, and bodies that rest in a simulator."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import Polygon

from tasks import exports
from tasks.exports.lighting import lamps, viewpoint
from tasks.exports.usd import write_usd
from tasks.exports.usd.rules import RULES, check_usd
from tasks.geometry.mass import principal_axes, solid_properties
from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import translation
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tests.replicas import Object, furnished, obj, replica_of, rows_of

Rows = dict[str, list[Any]]


@pytest.fixture(scope="module")
def scene() -> tuple[Rows, Any]:
    return rows_of(furnished())


@pytest.fixture(scope="module")
def usd(scene: tuple[Rows, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_usd(tmp_path_factory.mktemp("usd"), replica_of(*scene), exports.ExportsConfig())


def with_bedding(rows_and_blobs: tuple[Rows, Any]) -> tuple[Rows, Any]:
    """The same captions, but what is named like bedding behaves like it."""
    rows, blobs = rows_and_blobs
    kinds = {"blanket": "cloth", "pillow": "soft"}
    categories = {row.instance_id: row.category for row in rows["instances"]}
    captions = [
        dataclasses.replace(row, body_type=kinds.get(categories[row.instance_id], "rigid"), materials=("fabric",))
        for row in rows["captions"]
    ]  # fmt: skip
    return rows | {"captions": captions}, blobs


def bedding() -> list[Object]:
    """The furnished office with a blanket and a cushion on its floor."""
    lying = np.array([[0.0, 0.0, 1.0, -2.4], [0.0, 1.0, 0.0, -1.4], [-1.0, 0.0, 0.0, 0.07], [0.0, 0.0, 0.0, 1.0]])
    blanket = obj("blanket", translation([-1.2, -1.4, 0.0]), seed=1, mass_kg=1.6)
    pillow = obj("pillow", lying, seed=2, mass_kg=0.6)
    lowest = float(surface_of(pillow.parts).vertices[:, 0].max())
    lying[2, 3] = lowest + 1e-4
    return [*furnished(), blanket, dataclasses.replace(pillow, pose=lying)]


@pytest.fixture(scope="module")
def soft(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_usd(tmp_path_factory.mktemp("soft"), replica_of(*with_bedding(rows_of(bedding()))), exports.ExportsConfig())


@pytest.fixture
def copy(soft: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(soft.parent, tmp_path / "moved" / "elsewhere")) / soft.name


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
    shell = np.concatenate([mesh.vertices for _, mesh in room_shell(scene[0]["shells"][0])])
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
    from tasks.exports.gltf import node_textures
    from tasks.geometry.meshes import canonical, load_glb
    from tests.replicas import Object

    parts = canonical(load_glb((realdata("assets") / "aws_ShoeRack_01.glb").read_bytes()))
    rows, blobs = rows_of([Object("shoe rack", parts, [], np.eye(4), known=False, scale=(1.1, 0.9, 1.0))])
    path = write_usd(tmp_path, replica_of(rows, blobs), exports.ExportsConfig())
    assert check_usd(path) == []
    images = [data for data, _ in node_textures(blobs[rows["assets"][0].mesh_blob]).values()]
    assert sorted(file.read_bytes() for file in path.parent.rglob("textures/*")) == sorted(set(images))
    stage = open_stage(path)
    mesh = next(prim for prim in stage.Traverse() if prim.HasAttribute("primvars:st"))
    assert len(mesh.GetAttribute("primvars:st:indices").Get()) == len(mesh.GetAttribute("points").Get())
    assert len(mesh.GetAttribute("primvars:st").Get()) == len({tuple(pair) for pair in mesh.GetAttribute("primvars:st").Get()})


@pytest.mark.filterwarnings("ignore:LoadUsdPhysicsFromRange:DeprecationWarning")
def test_usds_own_physics_parser_sees_the_friction_of_every_hull(scene: tuple[Rows, Any], usd: Path) -> None:
    from pxr import UsdPhysics

    stage = open_stage(usd)
    parsed = UsdPhysics.LoadUsdPhysicsFromRange(stage, ["/World"])
    read = {}
    for place, shape in zip(*parsed[UsdPhysics.ObjectType.MeshShape], strict=True):
        (material,) = shape.materials
        read[str(place)] = UsdPhysics.MaterialAPI(stage.GetPrimAtPath(material)).GetStaticFrictionAttr().Get()
    replica = replica_of(*scene)
    for body in replica.bodies:
        hulls = [friction for place, friction in read.items() if place.startswith(f"/World/Objects/{body.name}/")]
        assert hulls == pytest.approx([body.friction] * len(body.shape.hulls))
    assert len({body.friction for body in replica.bodies}) > 1
    assert len(read) == sum(len(body.shape.hulls) for body in replica.bodies) + len(room_shell(replica.room))


def test_the_scene_has_lamps_and_a_camera_that_looks_at_its_middle(scene: tuple[Rows, Any], usd: Path) -> None:
    from pxr import Gf, UsdGeom, UsdLux

    stage, replica = open_stage(usd), replica_of(*scene)
    cache = UsdGeom.XformCache()
    lights = [cache.GetLocalToWorldTransform(prim).ExtractTranslation() for prim in stage.Traverse() if prim.IsA(UsdLux.SphereLight)]
    np.testing.assert_allclose(np.array(lights), lamps(replica.room))
    eye = UsdGeom.Camera(stage.GetPrimAtPath(stage.GetRootLayer().customLayerData["cameraSettings"]["boundCamera"])).GetCamera(0)
    middle = np.array(Polygon(replica.room.floor_polygon).centroid.coords[0])
    assert eye.frustum.Intersects(Gf.Vec3d(*middle, 0.25))
    assert eye.GetFieldOfView(Gf.Camera.FOVHorizontal) == pytest.approx(75.0, abs=1e-4)
    np.testing.assert_allclose(np.array(eye.transform).T, viewpoint(replica), atol=1e-9)


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
    """A collider that reaches 4 mm below what is seen, as a decomposition could make them."""

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


def lengthen_rotation(path: Path) -> None:
    """A rotation that USD, which takes its angle from acos(w), and engines, which normalize it, read differently."""

    def change(stage: Any) -> None:
        orient = stage.GetPrimAtPath(CHAIR).GetAttribute("xformOp:orient")
        orient.Set(orient.Get() * 0.7)

    edit_layer(path, change)


def move(place: str, by: tuple[float, float, float]) -> Callable[[Path], None]:
    """Move a part of an object within it [m]."""

    def change(stage: Any) -> None:
        from pxr import Gf, UsdGeom

        prim = stage.GetPrimAtPath(place)
        parts = [prim] if prim.IsA(UsdGeom.Xformable) else prim.GetChildren()
        for part in parts:
            UsdGeom.Xformable(part).AddTranslateOp().Set(Gf.Vec3d(*by))

    return in_scene(change)


def flatten(array: np.ndarray) -> None:
    array[:, 2] = array[0, 2]


def disable_colliders(path: Path) -> None:
    def change(stage: Any) -> None:
        for child in stage.GetPrimAtPath(f"{CHAIR}/Colliders").GetChildren():
            child.GetAttribute("physics:collisionEnabled").Set(False)

    edit_layer(path, change)


def disable(place: str) -> Callable[[Path], None]:
    """A collider that is switched off."""

    def change(stage: Any) -> None:
        from pxr import UsdPhysics

        UsdPhysics.CollisionAPI(stage.GetPrimAtPath(place)).CreateCollisionEnabledAttr(False)

    return in_scene(change)


def clear_labels(path: Path) -> None:
    def change(stage: Any) -> None:
        for taxonomy in ("class", "category", "nyu40"):
            stage.GetPrimAtPath(CHAIR).GetAttribute(f"semantics:labels:{taxonomy}").Set([])

    edit_layer(path, change)


def unbind(path: Path) -> None:
    def change(stage: Any) -> None:
        from pxr import UsdShade

        for prim in stage.GetPrimAtPath(f"{BOX}/Colliders").GetChildren():
            UsdShade.MaterialBindingAPI(prim).UnbindDirectBinding("physics")

    edit_layer(path, change)


def bind_above(path: Path) -> None:
    """The physics material on the scope of the colliders, which inherit it."""

    def change(stage: Any) -> None:
        from pxr import UsdShade

        scope = stage.GetPrimAtPath(f"{BOX}/Colliders")
        material = UsdShade.Material(stage.GetPrimAtPath(f"{BOX}/PhysicsMaterial"))
        UsdShade.MaterialBindingAPI.Apply(scope).Bind(material, UsdShade.Tokens.strongerThanDescendants, "physics")
        for prim in scope.GetChildren():
            UsdShade.MaterialBindingAPI(prim).UnbindDirectBinding("physics")
            prim.RemoveAPI(UsdShade.MaterialBindingAPI)

    edit_layer(path, change)


def unlimited(stage: Any) -> None:
    stage.GetDefaultPrim().RemoveProperty("physxRigidBody:maxDepenetrationVelocity")


def round_hull(stage: Any) -> None:
    """A ball of 320 faces in the place of a hull."""
    import trimesh
    from pxr import UsdGeom, Vt

    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(HULL))
    points = np.asarray(ball.vertices, dtype=np.float32) + np.array(mesh.GetPointsAttr().Get()).mean(axis=0)
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, dtype=np.float32)))
    mesh.GetFaceVertexCountsAttr().Set([3] * len(ball.faces))
    mesh.GetFaceVertexIndicesAttr().Set(np.asarray(ball.faces).ravel().tolist())
    mesh.GetNormalsAttr().Set([(0.0, 0.0, 1.0)] * (3 * len(ball.faces)))
    mesh.GetExtentAttr().Set([tuple(points.min(axis=0).tolist()), tuple(points.max(axis=0).tolist())])


def without(place: str) -> Callable[[Path], None]:
    """A scene without one of its prims."""
    return lambda path: edit_layer(path, lambda stage: stage.RemovePrim(place))


def in_layer(pattern: str, change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Change every layer that fits a pattern through a stage of its own."""

    def damage(path: Path) -> None:
        files = sorted(path.parent.glob(pattern))
        assert files, pattern
        for file in files:
            edit_layer(file, change)

    return damage


def deformed(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Change a scene in which everything that can be is deformable; the variants stay selected."""

    def damage(path: Path) -> None:
        def select(stage: Any) -> None:
            for prim in stage.GetPrimAtPath("/World/Objects").GetChildren():
                if prim.GetVariantSets().HasVariantSet("physics"):
                    prim.GetVariantSets().SetSelection("physics", "deformable")
            change(stage)

        edit_layer(path, select)

    return damage


def values(path: str, name: str, change: Callable[[np.ndarray], None]) -> Callable[[Any], None]:
    """Change an array attribute of a stage's prim in place."""

    def edit(stage: Any) -> None:
        found = stage.GetPrimAtPath(path).GetAttribute(name)
        array = np.array(found.Get())
        change(array)
        found.Set(type(found.Get()).FromNumpy(array))

    return edit


def overwrite(path: str, name: str, value: Any) -> Callable[[Any], None]:
    def edit(stage: Any) -> None:
        found = stage.GetPrimAtPath(path).GetAttribute(name)
        assert found, f"{path}.{name}"
        found.Set(value)

    return edit


def first_twice(array: np.ndarray) -> None:
    """The first triangle once more, in place of the second and the third."""
    array[3:6] = array[6:9] = array[:3]


def inverted(array: np.ndarray) -> None:
    array[0, [0, 1]] = array[0, [1, 0]]


def add_joint(first: str | None, second: str | None) -> Callable[[Path], None]:
    """A fixed joint between prims."""

    def change(stage: Any) -> None:
        from pxr import UsdPhysics

        joint = UsdPhysics.FixedJoint.Define(stage, "/World/Joint")
        for place, relation in ((first, joint.CreateBody0Rel()), (second, joint.CreateBody1Rel())):
            if place:
                relation.SetTargets([place])

    return in_scene(change)


def scatter(path: Path) -> None:
    """A point instancer whose prototype is a body."""

    def change(stage: Any) -> None:
        from pxr import Gf, UsdGeom

        instancer = UsdGeom.PointInstancer.Define(stage, "/World/Scattered")
        prototype = stage.DefinePrim("/World/Scattered/Prototype")
        prototype.GetReferences().AddInternalReference(BOX)
        instancer.CreatePrototypesRel().SetTargets([prototype.GetPath()])
        instancer.CreateProtoIndicesAttr([0])
        instancer.CreatePositionsAttr([Gf.Vec3f(0, 0, 1)])

    edit_layer(path, change)


def animate(path: Path) -> None:
    def change(stage: Any) -> None:
        from pxr import Gf

        place = stage.GetPrimAtPath(CHAIR).GetAttribute("xformOp:translate")
        for time in range(3):
            place.Set(Gf.Vec3d(0, 0, time), time)

    edit_layer(path, change)


def second_body(path: Path) -> None:
    """Two bodies side by side in one model, with no joint between them."""

    def change(stage: Any) -> None:
        from pxr import Gf, Kind, Usd

        pair = stage.DefinePrim("/World/Objects/pair", "Xform")
        Usd.ModelAPI(pair).SetKind(Kind.Tokens.component)
        for name in ("one", "other"):
            prim = stage.DefinePrim(f"/World/Objects/pair/{name}")
            prim.GetReferences().AddInternalReference(BOX)
            prim.GetAttribute("xformOp:translate").Set(Gf.Vec3d(0, 0, 5 if name == "one" else 6))

    edit_layer(path, change)


def sink_object(path: Path) -> None:
    """A box half a hand deep in its table."""

    def change(stage: Any) -> None:
        place = stage.GetPrimAtPath(BOX).GetAttribute("xformOp:translate")
        x, y, z = place.Get()
        place.Set(type(place.Get())(x, y, z - 0.02))

    edit_layer(path, change)


def label_inside(path: Path) -> None:
    """An instance whose label is authored in its prototype only."""

    def change(stage: Any) -> None:
        chair = stage.GetPrimAtPath(CHAIR)
        for taxonomy in ("class", "category", "nyu40"):
            chair.GetAttribute(f"semantics:labels:{taxonomy}").Set([])
        chair.SetInstanceable(True)

    def label_parts(stage: Any) -> None:
        from pxr import UsdSemantics

        root = stage.GetDefaultPrim().GetPath()
        for prim in stage.Traverse():
            if prim.GetPath().GetParentPath() == root.AppendChild("Visual"):
                UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr(["chair"])

    in_layer("assets/chair_*/*_geometry.usdc", label_parts)(path)
    edit_layer(path, change)


def rigid_within(path: Path) -> None:
    def change(stage: Any) -> None:
        from pxr import UsdPhysics

        UsdPhysics.RigidBodyAPI.Apply(stage.GetPrimAtPath(PILLOW))

    deformed(change)(path)


def two_meshes(stage: Any) -> None:
    """A second simulation mesh in one body."""
    stage.GetPrimAtPath(f"{BLANKET}/Visual/Part_00").AddAppliedSchema("PhysicsSurfaceDeformableSimAPI")
    stage.GetPrimAtPath(f"{BLANKET}").AddAppliedSchema("PhysicsSurfaceDeformableSimAPI")


def _stretch(stage: Any) -> None:
    """Principal axes that are no unit quaternion."""
    from pxr import Gf

    stage.GetPrimAtPath(BOX).GetAttribute("physics:principalAxes").Set(Gf.Quatf(2, 0, 0, 0))


def _root(stage: Any) -> str:
    return f"{stage.GetDefaultPrim().GetPath()}/Simulation"


CHAIR, BOX = "/World/Objects/chair_0002", "/World/Objects/box_0004"
BLANKET, PILLOW = "/World/Objects/blanket_0007", "/World/Objects/pillow_0008"
LOOKS = "assets/*/*_looks.usda"
HULL = f"{BOX}/Colliders/Hull_00"
SIMULATION = "assets/{}_*/*_simulation.usdc"
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
    "rotation of another length": ("rigid_pose", lengthen_rotation),
    "position that is no number": ("finite_geometry", attribute(HULL, "points", [(float("nan"), 0, 0)] * 8)),
    "triangle of no vertices": ("finite_geometry", attribute(f"{BOX}/Visual/Part_00", "faceVertexIndices", [0, 1, 99] * 12)),
    "body without collider": ("collider", disable_colliders),
    "raw triangles": ("triangle_collider", attribute(HULL, "physics:approximation", "none")),
    "simplified triangles": ("triangle_collider", attribute(HULL, "physics:approximation", "meshSimplification")),
    "decomposition left to the engine": ("explicit_hulls", attribute(HULL, "physics:approximation", "convexDecomposition")),
    "dented hull": ("explicit_hulls", dent_hull),
    "hull of many faces": ("hull_limits", in_scene(round_hull)),
    "flat hull": ("collider", in_scene(lambda stage: values(HULL, "points", flatten)(stage))),
    "approximation of no kind": ("explicit_hulls", attribute(HULL, "physics:approximation", "convexhull")),
    "distance field that one engine knows": ("explicit_hulls", attribute(HULL, "physics:approximation", "sdf")),
    "collider away from what is seen": ("protrusion", move(f"{CHAIR}/Colliders", (0.0, 0.0, 0.3))),
    "what is seen away from its colliders": ("visual", move(f"{CHAIR}/Visual", (3.0, 0.0, 0.0))),
    "no mass": ("mass", drop_mass),
    "mass below zero": ("mass", attribute(BOX, "physics:mass", -1.0)),
    "no inertia": ("inertia", attribute(BOX, "physics:diagonalInertia", (0, 0, 0))),
    "inertia below zero": ("inertia", attribute(BOX, "physics:diagonalInertia", (-1, 1, 1))),
    "inertia of no solid": ("inertia", attribute(BOX, "physics:diagonalInertia", (1, 1, 9))),
    "inertia in other units": ("inertia", attribute(BOX, "physics:diagonalInertia", (900, 900, 900))),
    "center of mass outside": ("center_of_mass", attribute(BOX, "physics:centerOfMass", (5, 0, 0))),
    "center of mass that is no number": ("center_of_mass", attribute(BOX, "physics:centerOfMass", (float("nan"), 0, 0))),
    "sunken collider": ("support_plane", sink_hull),
    "friction of 7": ("physics_material", attribute(f"{BOX}/PhysicsMaterial", "physics:staticFriction", 7.0)),
    "hidden object": ("visual", hide),
    "asset in centimetres": ("layer_units", replace_text("assets/chair_*/*_payload.usda", "metersPerUnit = 1", "metersPerUnit = 0.01")),
    "asset with +Y up": ("layer_units", replace_text("assets/chair_*/*_looks.usda", 'upAxis = "Z"', 'upAxis = "Y"')),
    "floor that does not collide": ("ground", disable("/World/Room/Floor/Collider")),
    "object beside the floor": ("ground", attribute(BOX, "xformOp:translate", (50.0, 0.0, 1.0))),
    "joint of nothing": ("joints", add_joint(None, None)),
    "joint of a body with itself": ("joints", add_joint(BOX, BOX)),
    "joint of a prim that is not there": ("joints", add_joint(BOX, "/World/Objects/gone")),
    "joint of the light with the world": ("joints", add_joint("/World/Light", None)),
    "articulation without joints": ("joints", apply(CHAIR, "ArticulationRootAPI")),
    "scattered bodies": ("point_instancer", scatter),
    "animated body": ("animated_body", animate),
    "extent of somewhere else": ("extents", attribute(f"{BOX}/Visual/Part_00", "extent", [(5, 5, 5), (6, 6, 6)])),
    "gravity that is no number": ("physics_scene", attribute("/World/PhysicsScene", "physics:gravityMagnitude", float("nan"))),
    "inertia axes of no rotation": ("inertia", in_scene(lambda stage: _stretch(stage))),
    "dynamic friction below zero": ("physics_material", attribute(f"{BOX}/PhysicsMaterial", "physics:dynamicFriction", -0.1)),
    "restitution of 2": ("physics_material", attribute(f"{BOX}/PhysicsMaterial", "physics:restitution", 2.0)),
    "mass that is no number": ("mass", attribute(BOX, "physics:mass", float("nan"))),
    "model below no group": ("model_hierarchy", replace_text("scene.usda", 'kind = "group"', 'kind = "subcomponent"')),
    "two bodies in one model": ("one_body", second_body),
    "collider that is drawn": ("guides", attribute(HULL, "purpose", "default")),
    "object in its table": ("start_overlap", sink_object),
    "label in the prototype": ("labels", label_inside),
    "rigid and deformable": ("deformable_body", rigid_within),
    "cloth of no weight": ("deformable_mass", deformed(overwrite(BLANKET, "physics:mass", 0.0))),
    "cushion of no weight in one family": ("deformable_mass", deformed(overwrite(PILLOW, "omniphysics:mass", -1.0))),
    "inverted tetrahedron": ("tetrahedra", deformed(values(f"{PILLOW}/Simulation", "tetVertexIndices", inverted))),
    "tetrahedron of no vertices": (
        "tetrahedra",
        deformed(values(f"{PILLOW}/Simulation", "tetVertexIndices", lambda array: array.__setitem__((0, 0), 9999))),
    ),
    "surface of another solid": (
        "tetrahedra",
        deformed(values(f"{PILLOW}/Simulation", "surfaceFaceVertexIndices", lambda array: array.__setitem__(0, array[1]))),
    ),
    "three triangles in one edge": ("sheet", deformed(values(f"{BLANKET}/Simulation", "faceVertexIndices", first_twice))),
    "flat triangle": (
        "sheet",
        deformed(values(f"{BLANKET}/Simulation", "faceVertexIndices", lambda array: array.__setitem__(1, array[0]))),
    ),
    "two simulation meshes": ("deformable", deformed(two_meshes)),
    "stiffness of nothing": ("deformable_material", deformed(overwrite(f"{BLANKET}/PhysicsMaterial", "physics:youngsModulus", 0.0))),
    "ratio of no solid": ("deformable_material", deformed(overwrite(f"{PILLOW}/PhysicsMaterial", "omniphysics:poissonsRatio", 0.7))),
    "damage behind a variant that is not selected": (
        "tetrahedra",
        in_layer(SIMULATION.format("pillow"), lambda stage: values(_root(stage), "tetVertexIndices", inverted)(stage)),
    ),
    "no friction": ("physics_material", unbind),
    "friction bound above the colliders": ("physics_material", bind_above),
    "depenetration left to PhysX": ("depenetration", in_layer("assets/*/*_physics.usda", unlimited)),
    "depenetration at a run": ("depenetration", attribute(BOX, "physxRigidBody:maxDepenetrationVelocity", 3.0)),
    "no light": ("viewing", without("/World/Lights")),
    "no camera": ("viewing", without("/World/Camera")),
    "camera outside of the room": ("viewing", attribute("/World/Camera", "xformOp:translate", (0.0, 0.0, 20.0))),
    "no label": ("labels", clear_labels),
}
WARNINGS = {
    "no friction", "no label", "model below no group", "two bodies in one model", "collider that is drawn",
    "label in the prototype", "floor that does not collide", "object beside the floor",
    "collider away from what is seen", "distance field that one engine knows",
}  # fmt: skip
"""Damage that only makes a scene worse, not wrong."""


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_its_rule(name: str, copy: Path) -> None:
    rule, damage = DAMAGES[name]
    damage(copy)
    found = check_usd(copy)
    assert rule in {finding.rule for finding in found if finding.is_error != (name in WARNINGS)}, found


@pytest.mark.parametrize("name", [name for name in DAMAGES if DAMAGES[name][0] in ("mass", "inertia", "explicit_hulls")])
def test_what_usd_leaves_to_engines_is_a_warning_in_files_by_others(name: str, copy: Path) -> None:
    """Values that cannot be stay errors, whoever wrote them."""
    rule, damage = DAMAGES[name]
    damage(copy)
    ours = {finding for finding in check_usd(copy) if finding.rule == rule}
    copy.write_text(copy.read_text().replace("dictionary metascenes", "dictionary theirs"))
    theirs = {finding for finding in check_usd(copy) if finding.rule == rule}
    assert {(f.where, f.message) for f in theirs} == {(f.where, f.message) for f in ours}
    for finding in theirs - ours:
        assert not finding.is_error
        assert "not stated" in finding.message or "own hull" in finding.message or "decompose" in finding.message


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {rule for rule, _ in DAMAGES.values()} == set(RULES) - {"package"}
    assert len(DAMAGES) > 60


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
        # Axes are rounded at 1e-12, and every moment is carried by them.
        np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, properties.inertia, rtol=0, atol=4e-12 * moments.max())
