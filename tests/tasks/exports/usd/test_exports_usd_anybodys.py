"""The gate on files that are not ours: odd but sound stages, and stages that nobody would write. It never crashes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tasks.exports.usd.rules import RULES, check_usd


def new(path: Path, up: str = "Z", meters: float = 1.0) -> Any:
    """A stage with gravity and a default prim."""
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, meters)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    gravity = UsdPhysics.Scene.Define(stage, "/World/Physics")
    gravity.CreateGravityDirectionAttr(Gf.Vec3f(0, -1, 0) if up == "Y" else Gf.Vec3f(0, 0, -1))
    gravity.CreateGravityMagnitudeAttr(9.81 / meters)
    return stage


def body(stage: Any, path: str, shape: str, at: tuple[float, float, float] = (0, 0, 0), kinematic: bool = False) -> Any:
    """A body that is one primitive: a cube, a sphere, a capsule, seen and collided with."""
    from pxr import Gf, UsdGeom, UsdPhysics

    root = UsdGeom.Xform.Define(stage, path)
    root.AddTranslateOp().Set(Gf.Vec3d(*at))
    prim = root.GetPrim()
    api = UsdPhysics.RigidBodyAPI.Apply(prim)
    if kinematic:
        api.CreateKinematicEnabledAttr(True)
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(1.0)
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(0.1, 0.1, 0.1))
    mass.CreatePrincipalAxesAttr(Gf.Quatf(1.0))
    part = getattr(UsdGeom, shape).Define(stage, f"{path}/Shape")
    part.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(part, 0))
    UsdPhysics.CollisionAPI.Apply(part.GetPrim())
    return prim


def errors(path: Path) -> set[str]:
    return {finding.rule for finding in check_usd(path) if finding.is_error}


@pytest.mark.parametrize("shape", ["Cube", "Sphere", "Capsule", "Cylinder", "Cone"])
def test_primitives_collide_as_they_are(shape: str, tmp_path: Path) -> None:
    stage = new(tmp_path / "scene.usda")
    body(stage, "/World/Thing", shape, (0, 0, 3))
    body(stage, "/World/Moved", shape, (5, 0, 3), kinematic=True)
    stage.Save()
    assert errors(tmp_path / "scene.usda") == set()


def put_below(stage: Any) -> None:
    """A collider of the thing that reaches 1 m below what is seen of it."""
    from pxr import Gf, UsdGeom, UsdPhysics

    below = UsdGeom.Cube.Define(stage, "/World/Thing/Below")
    below.CreatePurposeAttr("guide")
    below.AddTranslateOp().Set(Gf.Vec3d(0, 0, -1))
    UsdPhysics.CollisionAPI.Apply(below.GetPrim())


def test_the_box_of_a_primitive_counts(tmp_path: Path) -> None:
    from pxr import Gf, UsdPhysics

    stage = new(tmp_path / "scene.usda")
    obj = body(stage, "/World/Thing", "Sphere", (0, 0, 3))
    UsdPhysics.MassAPI(obj).CreateCenterOfMassAttr(Gf.Vec3f(0, 0, -1.5))
    put_below(stage)
    stage.Save()
    assert errors(tmp_path / "scene.usda") == {"support_plane"}
    UsdPhysics.MassAPI(obj).CreateCenterOfMassAttr(Gf.Vec3f(0, 0, 2.5))
    stage.Save()
    assert errors(tmp_path / "scene.usda") == {"support_plane", "center_of_mass"}


def test_a_collider_that_stands_in_for_an_unseen_support_may_reach_below(tmp_path: Path) -> None:
    stage = new(tmp_path / "scene.usda")
    obj = body(stage, "/World/Thing", "Cube", (0, 0, 3))
    put_below(stage)
    stage.Save()
    assert errors(tmp_path / "scene.usda") == {"support_plane"}
    obj.SetCustomDataByKey("metascenes", {"support": "inferred"})
    stage.Save()
    assert errors(tmp_path / "scene.usda") == set()


@pytest.mark.parametrize(
    ("degrees", "deep", "expected"),
    [(0.5, 0.003, True), (12.0, 0.003, False), (12.0, 0.009, False), (12.0, 0.013, True), (180.0, 0.013, True)],
)
def test_what_leans_may_be_off_by_more(degrees: float, deep: float, expected: bool, tmp_path: Path) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    stage = new(tmp_path / "scene.usda")
    obj = body(stage, "/World/Thing", "Cube", (0, 0, 3))
    UsdGeom.Xformable(obj).AddRotateXOp().Set(degrees)
    below = UsdGeom.Cube.Define(stage, "/World/Thing/Below")
    below.CreatePurposeAttr("guide")
    turn = Gf.Rotation(Gf.Vec3d(1, 0, 0), -degrees)
    below.AddTranslateOp().Set(turn.TransformDir(Gf.Vec3d(0, 0, -deep)))
    UsdPhysics.CollisionAPI.Apply(below.GetPrim())
    stage.Save()
    assert ("support_plane" in errors(tmp_path / "scene.usda")) == expected


def test_heights_are_measured_along_the_upward_axis_in_metres(tmp_path: Path) -> None:
    """A collider reaches 0.3 mm below in centimetres with +Y up: within the tolerance; 3 mm is not."""
    from pxr import Gf, UsdGeom, UsdPhysics

    for deep, expected in ((0.03, False), (0.3, True)):
        path = tmp_path / f"scene_{expected}.usda"
        stage = new(path, "Y", 0.01)
        body(stage, "/World/Thing", "Cube", (0, 300, 0))
        below = UsdGeom.Cube.Define(stage, "/World/Thing/Below")
        below.CreatePurposeAttr("guide")
        below.AddTranslateOp().Set(Gf.Vec3d(0, -deep, 0))
        UsdPhysics.CollisionAPI.Apply(below.GetPrim())
        stage.Save()
        found = errors(path)
        assert ("support_plane" in found) == expected
        assert {"up_axis", "units"} <= found
        assert "physics_scene" not in found, "gravity is Earth's in its own units"


def test_files_of_others_are_read(realdata: Callable[[str], Path]) -> None:
    files = [path for path in sorted(realdata("usd_physics").rglob("*")) if path.suffix in (".usd", ".usda", ".usdc")]
    assert files
    for path in files:
        for finding in check_usd(path):
            assert finding.rule in RULES
            assert "\n" not in finding.message


def kinds(path: Path) -> dict[str, set[bool]]:
    """Which rules find something, and whether an error."""
    found: dict[str, set[bool]] = {}
    for finding in check_usd(path):
        found.setdefault(finding.rule, set()).add(finding.is_error)
    return found


def test_a_mass_that_is_left_to_the_engine_is_less_than_stated_but_not_wrong(tmp_path: Path) -> None:
    from pxr import UsdPhysics

    for where in ("body", "collider", "collider's mass", "nowhere"):
        path = tmp_path / f"{where}.usda"
        stage = new(path)
        obj = body(stage, "/World/Thing", "Cube", (0, 0, 3))
        obj.RemoveAPI(UsdPhysics.MassAPI)
        for name in ("physics:mass", "physics:diagonalInertia", "physics:principalAxes"):
            obj.RemoveProperty(name)
        if where != "nowhere":
            api = UsdPhysics.MassAPI.Apply(obj if where == "body" else stage.GetPrimAtPath("/World/Thing/Shape"))
            (api.CreateMassAttr if "mass" in where else api.CreateDensityAttr)(300.0)
        stage.Save()
        found = kinds(path)
        assert found["mass"] == found["inertia"] == {False}, where


def test_a_room_may_be_scaled_but_not_what_moves_in_it(tmp_path: Path) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    path = tmp_path / "scene.usda"
    stage = new(path)
    body(stage, "/World/Thing", "Cube", (0, 0, 3))
    ground = UsdGeom.Mesh.Define(stage, "/World/Ground")
    ground.CreatePointsAttr([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    ground.CreateFaceVertexCountsAttr([4])
    ground.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    ground.CreateSubdivisionSchemeAttr("none")
    ground.AddScaleOp().Set(Gf.Vec3f(9, 9, 1))
    UsdPhysics.CollisionAPI.Apply(ground.GetPrim())
    stage.Save()
    assert kinds(path)["rigid_pose"] == {False}
    UsdGeom.Xformable(stage.GetPrimAtPath("/World/Thing")).AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    stage.Save()
    assert kinds(path)["rigid_pose"] == {False, True}


def test_an_articulation_may_begin_at_a_body_beside_its_joints(tmp_path: Path) -> None:
    from pxr import UsdPhysics

    path = tmp_path / "scene.usda"
    stage = new(path)
    first, second = (body(stage, f"/World/{name}", "Cube", (x, 0, 3)) for name, x in (("First", 0), ("Second", 3)))
    UsdPhysics.ArticulationRootAPI.Apply(first)
    stage.Save()
    assert errors(path) == {"joints"}
    joint = UsdPhysics.FixedJoint.Define(stage, "/World/Joints/Between")
    joint.CreateBody0Rel().SetTargets([first.GetPath()])
    joint.CreateBody1Rel().SetTargets([second.GetPath()])
    stage.Save()
    assert errors(path) == set()


def test_one_object_leaves_gravity_to_its_scene(tmp_path: Path) -> None:
    from pxr import Kind, Usd

    path = tmp_path / "scene.usda"
    stage = new(path)
    body(stage, "/World/Thing", "Cube", (0, 0, 3))
    stage.RemovePrim("/World/Physics")
    stage.Save()
    assert errors(path) == {"physics_scene"}
    Usd.ModelAPI(stage.GetDefaultPrim()).SetKind(Kind.Tokens.component)
    stage.Save()
    assert errors(path) == set()


def test_tiles_and_materials_of_omniverse_are_no_lost_files(tmp_path: Path) -> None:
    from pxr import Sdf, UsdShade

    path = tmp_path / "scene.usda"
    stage = new(path)
    UsdShade.Material.Define(stage, "/World/Look")
    surface = UsdShade.Shader.Define(stage, "/World/Look/Surface")
    surface.CreateImplementationSourceAttr("sourceAsset")
    surface.SetSourceAsset(Sdf.AssetPath("OmniPBR.mdl"), "mdl")
    image = UsdShade.Shader.Define(stage, "/World/Look/Image")
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath("./wood.<UDIM>.png"))
    stage.Save()
    assert kinds(path)["closed_paths"] == {False, True}, "there is no tile"
    (tmp_path / "wood.1001.png").write_bytes(b"")
    assert errors(path) == set()
    assert kinds(path)["closed_paths"] == {False}, "the material is not here"


PRIMS = (
    "/World",
    "/World/Thing",
    "/World/Thing/Shape",
    "/World/Other",
    "/World/Mesh",
    "/World/Physics",
    "/World/Joint",
    "/World/Soft",
    "/New",
)
TYPES = ("Xform", "Mesh", "Cube", "TetMesh", "PointInstancer", "PhysicsFixedJoint", "PhysicsScene", "Material", "Camera", "", "NoSuchType")
SCHEMAS = (
    "PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMeshCollisionAPI", "PhysicsMassAPI", "PhysicsMaterialAPI",
    "PhysicsArticulationRootAPI", "PhysicsDeformableBodyAPI", "PhysicsVolumeDeformableSimAPI", "OmniPhysicsSurfaceDeformableSimAPI",
    "SemanticsLabelsAPI:class", "MaterialBindingAPI", "PhysicsSurfaceDeformableMaterialAPI", "NoSuchAPI",
)  # fmt: skip
ATTRIBUTES = (
    "points", "faceVertexIndices", "faceVertexCounts", "tetVertexIndices", "surfaceFaceVertexIndices", "extent", "physics:mass",
    "physics:centerOfMass", "physics:diagonalInertia", "physics:principalAxes", "physics:approximation", "physics:collisionEnabled",
    "physics:rigidBodyEnabled", "physics:kinematicEnabled", "physics:gravityDirection", "physics:gravityMagnitude", "xformOp:translate",
    "xformOpOrder", "semantics:labels:class", "visibility", "purpose", "omniphysics:mass", "physics:youngsModulus", "size", "orientation",
    "positions", "protoIndices", "physics:staticFriction",
)  # fmt: skip
_NUMBERS = st.sampled_from([0.0, 1.0, -1.0, 1e30, float("nan"), float("inf"), 0.5, 1e-12])
_WHOLE = st.integers(-2, 9)
VALUES: dict[str, Any] = {
    "Float": _NUMBERS, "Double": _NUMBERS, "Token": st.sampled_from(["none", "convexHull", "inherited", "leftHanded", "x"]),
    "Bool": st.booleans(), "Int": _WHOLE, "String": st.text(max_size=3), "IntArray": st.lists(_WHOLE, max_size=6),
    "FloatArray": st.lists(_NUMBERS, max_size=4), "Float3": st.tuples(_NUMBERS, _NUMBERS, _NUMBERS),
    "Double3": st.tuples(_NUMBERS, _NUMBERS, _NUMBERS), "Float3Array": st.lists(st.tuples(_NUMBERS, _NUMBERS, _NUMBERS), max_size=6),
    "Point3fArray": st.lists(st.tuples(_NUMBERS, _NUMBERS, _NUMBERS), max_size=6),
    "Int4Array": st.lists(st.tuples(_WHOLE, _WHOLE, _WHOLE, _WHOLE), max_size=3),
    "Int3Array": st.lists(st.tuples(_WHOLE, _WHOLE, _WHOLE), max_size=3),
    "TokenArray": st.lists(st.sampled_from(["a", "xformOp:translate"])),
}  # fmt: skip
EDITS = st.lists(
    st.one_of(
        st.tuples(st.just("type"), st.sampled_from(PRIMS), st.sampled_from(TYPES)),
        st.tuples(st.just("apply"), st.sampled_from(PRIMS), st.sampled_from(SCHEMAS)),
        st.tuples(st.just("drop"), st.sampled_from(PRIMS), st.none()),
        st.tuples(st.just("block"), st.sampled_from(PRIMS), st.sampled_from(ATTRIBUTES)),
        st.sampled_from(sorted(VALUES)).flatmap(
            lambda kind: st.tuples(
                st.just("set"), st.sampled_from(PRIMS), st.tuples(st.sampled_from(ATTRIBUTES), st.just(kind), VALUES[kind], st.booleans())
            )
        ),
        st.tuples(
            st.just("refer"), st.sampled_from(PRIMS), st.sampled_from(["./gone.usda", "/srv/gone.usd", "../up.usdc", "here.png", "#"])
        ),
        st.tuples(
            st.just("relate"),
            st.sampled_from(PRIMS),
            st.tuples(st.sampled_from(["physics:body0", "physics:body1"]), st.sampled_from(PRIMS)),
        ),
        st.tuples(st.just("instance"), st.sampled_from(PRIMS), st.sampled_from(PRIMS)),
        st.tuples(st.just("variant"), st.sampled_from(PRIMS), st.sampled_from(["rigid", "deformable"])),
        st.tuples(st.just("kind"), st.sampled_from(PRIMS), st.sampled_from(["component", "group", "nonsense"])),
        st.tuples(
            st.just("stage"),
            st.just("/"),
            st.sampled_from([("upAxis", "X"), ("metersPerUnit", 0.0), ("metersPerUnit", -1.0), ("defaultPrim", "No")]),
        ),
    ),
    max_size=12,
)


def edit(stage: Any, what: str, place: str, more: Any) -> None:
    """One edit of a stage; what USD itself refuses to write is left out."""
    from pxr import Sdf

    if what == "stage":
        stage.GetRootLayer().pseudoRoot.SetInfo(*more)
        return
    if what == "drop":
        stage.RemovePrim(place)
        return
    prim = stage.GetPrimAtPath(place) or stage.DefinePrim(place)
    if what == "type":
        prim.SetTypeName(more)
    elif what == "apply":
        prim.AddAppliedSchema(more)
    elif what == "block":
        (prim.GetAttribute(more) or prim.CreateAttribute(more, Sdf.ValueTypeNames.Float)).Block()
    elif what == "set":
        name, kind, value, timed = more
        prim.RemoveProperty(name)
        made = prim.CreateAttribute(name, getattr(Sdf.ValueTypeNames, kind))
        _ = made.Set(value, 1.0) if timed else made.Set(value)
    elif what == "refer":
        prim.GetReferences().AddReference(more)
    elif what == "relate":
        prim.CreateRelationship(more[0]).AddTarget(more[1])
    elif what == "instance":
        prim.GetReferences().AddInternalReference(more)
        prim.SetInstanceable(True)
    elif what == "variant":
        choice = prim.GetVariantSets().AddVariantSet("physics")
        choice.AddVariant(more)
        choice.SetVariantSelection(more)
        with choice.GetVariantEditContext():
            prim.AddAppliedSchema("PhysicsRigidBodyAPI" if more == "rigid" else "PhysicsDeformableBodyAPI")
    elif what == "kind":
        prim.SetMetadata("kind", more)


@pytest.mark.whole
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(EDITS)
def test_no_stage_is_too_odd(edits: list[tuple[str, str, Any]]) -> None:
    from pxr import Tf, UsdGeom, UsdPhysics

    with tempfile.TemporaryDirectory() as place:
        path = Path(place).resolve() / "scene.usda"
        stage = new(path)
        body(stage, "/World/Thing", "Cube", (0, 0, 3))
        body(stage, "/World/Other", "Sphere", (4, 0, 3), kinematic=True)
        mesh = UsdGeom.Mesh.Define(stage, "/World/Mesh")
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
        mesh.CreatePointsAttr([tuple(map(float, corner)) for corner in corners])
        mesh.CreateFaceVertexCountsAttr([3, 3, 3, 3])
        mesh.CreateFaceVertexIndicesAttr([0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2])
        UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr("convexHull")
        soft = UsdGeom.TetMesh.Define(stage, "/World/Soft")
        soft.CreatePointsAttr([tuple(map(float, corner)) for corner in corners])
        soft.CreateTetVertexIndicesAttr([(0, 1, 2, 3)])
        for name in ("PhysicsDeformableBodyAPI", "PhysicsVolumeDeformableSimAPI"):
            soft.GetPrim().AddAppliedSchema(name)
        UsdPhysics.FixedJoint.Define(stage, "/World/Joint").CreateBody0Rel().SetTargets(["/World/Thing"])
        for one in edits:
            try:
                edit(stage, *one)
            except (Tf.ErrorException, RuntimeError):  # USD will not write it
                continue
        try:
            stage.GetRootLayer().Save()
        except Tf.ErrorException:
            return
        del stage
        first = check_usd(path)
        assert {finding.rule for finding in first} <= {*RULES, "budget"}, "an instance of its own parent multiplies without end"
        assert all("\n" not in finding.message and place not in str(finding) for finding in first)
        assert check_usd(path) == first
