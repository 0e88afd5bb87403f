"""Cloth and soft bodies in USD: sound simulation meshes, a variant that never disturbs the rigid one, and rest in an engine."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks import exports
from tasks.exports.usd import write_usd
from tasks.exports.usd.deformables import deformable_of
from tasks.exports.usd.package import package
from tasks.exports.usd.rules import check_usd
from tasks.furniture import generate
from tasks.geometry.mass import mass_properties
from tasks.geometry.pieces import PieceConfig, convex_hull, pieces
from tasks.geometry.sheets import CELLS, THICKEST, THINNEST, sheet_of
from tasks.geometry.tetrahedra import COVERED, OUTSIDE_M, distance_to, manifold, tetrahedralize, volumes_of
from tasks.geometry.transforms import translation
from tests.conftest import REPOSITORY
from tests.replicas import cube, obj, rows_of
from tests.tasks.exports.usd.test_exports_usd import bedding, furnished, open_stage, replica_of, with_bedding

SOFT = ("mattress", "pillow", "backpack", "bag", "shoe", "stuffed animal", "toilet paper")
CLOTH = ("blanket", "curtain", "rug", "towel", "clothes")
_POINTS = st.lists(st.tuples(*[st.floats(-1.0, 1.0).map(lambda x: round(x, 3))] * 3), min_size=8, max_size=20, unique=True)


def hulls_of(clouds: list[list[tuple[float, float, float]]]) -> list[Any]:
    """Convex pieces of clouds that span a volume, stretched to one."""
    spread = [np.array(cloud) + np.random.default_rng(len(cloud)).normal(size=(len(cloud), 3)) * 0.05 for cloud in clouds]
    return [convex_hull(cloud, PieceConfig()) for cloud in spread]


def furniture(category: str, seed: int) -> tuple[Any, float]:
    """Convex pieces of a generated object, and the volume of their union [m3]."""
    model = generate(category, None, np.random.default_rng(seed))
    found = pieces(model.parts, model.pieces, PieceConfig())
    return found.hulls, found.properties.volume


def assert_sound(solid: Any, hulls: Any) -> None:
    """Positive volumes, faces that fit, a closed surface that touches itself nowhere, inside the box of the pieces."""
    points = np.concatenate([hull.vertices for hull in hulls])
    volumes = volumes_of(solid.vertices.astype(np.float32).astype(np.float64), solid.tetrahedra)
    assert (volumes > 0).all(), "in single precision, as it is written"
    corners = solid.tetrahedra[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3)
    faces = Counter(map(tuple, np.sort(corners, axis=1).tolist()))
    assert set(faces.values()) <= {1, 2}
    assert sum(count == 1 for count in faces.values()) == len(solid.surface)
    surface = trimesh.Trimesh(solid.vertices, solid.surface, process=False)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume == pytest.approx(float(solid.volumes.sum()))
    around = trimesh.Trimesh(solid.vertices, solid.surface, process=True, merge_norm=True)
    assert len(around.vertices) == len(np.unique(solid.surface)), "no two corners in one place"
    assert (solid.vertices >= points.min(axis=0) - 1e-12).all()
    assert (solid.vertices <= points.max(axis=0) + 1e-12).all()
    assert len(np.unique(solid.tetrahedra)) == len(solid.vertices)


@pytest.mark.whole
@settings(max_examples=40, deadline=None)
@given(st.lists(_POINTS, min_size=1, max_size=3), st.integers(20, 250))
def test_any_pieces_become_sound_tetrahedra(clouds: list[list[tuple[float, float, float]]], cells: int) -> None:
    hulls = hulls_of(clouds)
    solid = tetrahedralize(hulls, cells)
    assert_sound(solid, hulls)
    assert len(solid.tetrahedra) <= 6 * cells
    again = tetrahedralize(hulls, cells)
    assert again.vertices.tobytes() == solid.vertices.tobytes()


@pytest.mark.parametrize("category", SOFT)
def test_tetrahedra_of_furniture_hold_its_volume(category: str) -> None:
    for seed in range(2):
        hulls, volume = furniture(category, seed)
        solid = tetrahedralize(hulls)
        assert_sound(solid, hulls)
        assert COVERED < float(solid.volumes.sum()) / volume < 1.0 / COVERED
        beyond = distance_to(hulls, solid.vertices)[0]
        assert np.quantile(beyond, 0.99) < 2 * OUTSIDE_M
        assert beyond.max() < 4 * OUTSIDE_M, "a cell that keeps the surface from touching itself"


def test_a_box_is_filled_exactly() -> None:
    mesh = trimesh.creation.box((2.0, 1.4, 0.2))
    hulls = [convex_hull(np.asarray(mesh.vertices), PieceConfig())]
    solid = tetrahedralize(hulls)
    assert float(solid.volumes.sum()) == pytest.approx(0.56)
    assert mass_properties(hulls).volume == pytest.approx(0.56)


@pytest.mark.whole
@settings(deadline=None)
@given(st.integers(0, 2**27 - 1))
def test_cells_that_are_filled_touch_in_faces_only(code: int) -> None:
    grid = np.array([(code >> i) & 1 for i in range(27)], dtype=bool).reshape(3, 3, 3)
    full = manifold(grid)
    assert (full | ~grid).all(), "nothing is taken away"
    assert (manifold(full) == full).all()
    padded = np.pad(full, 1)
    around: Counter[tuple[int, ...]] = Counter()
    for axis in range(3):  # corners of every face between a filled cell and an empty one; every edge is one of two faces
        first, second = (tuple(slice(k, padded.shape[i] - 1 + k) if i == axis else slice(None) for i in range(3)) for k in (0, 1))
        u, v = (np.eye(3, dtype=int)[i] for i in range(3) if i != axis)
        for cell in np.argwhere(padded[first] != padded[second]):
            corner = cell + np.eye(3, dtype=int)[axis]
            for edge in ((corner, u), (corner, v), (corner + u, v), (corner + v, u)):
                around[(*edge[0].tolist(), *edge[1].tolist())] += 1
    assert set(around.values()) <= {2}


@pytest.mark.parametrize("category", CLOTH)
def test_sheets_of_furniture_are_manifold_and_lie_in_it(category: str) -> None:
    for seed in range(2):
        hulls, volume = furniture(category, seed)
        sheet = sheet_of(hulls, volume)
        mesh = trimesh.Trimesh(sheet.vertices, sheet.triangles, process=False)
        assert mesh.is_winding_consistent
        assert np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1].max() == 2
        assert mesh.body_count == 1
        assert 100 < len(sheet.triangles) <= 2 * CELLS
        assert sheet.area == pytest.approx(mesh.area)
        assert THINNEST <= sheet.thickness <= THICKEST
        points = np.concatenate([hull.vertices for hull in hulls])
        assert (sheet.vertices >= points.min(axis=0) - 1e-9).all()
        assert (sheet.vertices[:, 2] <= points[:, 2].max() + sheet.thickness).all()
        upright = int(np.argmin(np.ptp(points, axis=0))) == 2
        if upright:
            assert sheet.vertices[:, 2].min() - sheet.thickness / 2 >= points[:, 2].min() - 1e-9, "it starts above what carries it"


def prims(path: Path) -> dict[str, tuple[str, ...]]:
    stage = open_stage(path)
    return {str(prim.GetPath()): tuple(prim.GetAppliedSchemas()) for prim in stage.Traverse()}


def test_the_rigid_variant_is_what_it_was_without_one(tmp_path: Path) -> None:
    rows, blobs = with_bedding(rows_of(bedding()))
    with_variants = exports.ExportsConfig()
    without = dataclasses.replace(with_variants, usd=dataclasses.replace(with_variants.usd, deformables=False))
    ours = write_usd(tmp_path / "with", replica_of(rows, blobs), with_variants)
    plain = write_usd(tmp_path / "without", replica_of(rows, blobs), without)
    assert check_usd(ours) == check_usd(plain) == []
    assert prims(ours) == prims(plain)
    assert [file.name for file in plain.parent.rglob("*_simulation*")] == []
    assert len([file.name for file in ours.parent.rglob("*_simulation.usdc")]) == 2


def test_what_is_fixed_or_rigid_has_no_deformable(tmp_path: Path) -> None:
    rows, blobs = with_bedding(rows_of([*bedding(), obj("blanket", translation([0.0, 1.5, 1.0]), seed=1, relation="wall")]))
    replica = replica_of(rows, blobs)
    assert {body.category for body in replica.bodies if deformable_of(body)} == {"blanket", "pillow"}
    assert deformable_of(replica.bodies[-1]) is None
    assert len(furnished()) + 3 == len(replica.bodies)


@pytest.fixture
def selected(tmp_path: Path) -> Path:
    """A blanket and a cushion on a fixed table, deformable."""
    lying = np.array([[0.0, 0.0, 1.0, -0.1], [0.0, 1.0, 0.0, -0.55], [-1.0, 0.0, 0.0, 0.82], [0.0, 0.0, 0.0, 1.0]])
    objects = [
        cube((1.6, 1.6, 0.75), np.eye(4), relation="wall"),
        obj("blanket", translation([0.0, 0.15, 0.7505]), seed=1, mass_kg=1.6),
        obj("pillow", lying, seed=2, mass_kg=0.6),
    ]
    path = write_usd(tmp_path, replica_of(*with_bedding(rows_of(objects))), exports.ExportsConfig())
    stage = open_stage(path)
    for prim in stage.GetPrimAtPath("/World/Objects").GetChildren():
        if prim.GetVariantSets().HasVariantSet("physics"):
            assert prim.GetVariantSets().GetVariantSelection("physics") == "rigid"
            prim.GetVariantSets().SetSelection("physics", "deformable")
    stage.GetRootLayer().Export(str(path.with_name("deformable.usda")))
    return path.with_name("deformable.usda")


def test_the_deformable_variant_is_sound_and_states_both_families(selected: Path) -> None:
    from pxr import UsdGeom, UsdPhysics, UsdShade

    assert check_usd(selected) == []
    stage = open_stage(selected)
    for name, mass, kind in (("blanket_0002", 1.6, "Surface"), ("pillow_0003", 0.6, "Volume")):
        root = stage.GetPrimAtPath(f"/World/Objects/{name}")
        simulation = root.GetChild("Simulation")
        assert not root.HasAPI(UsdPhysics.RigidBodyAPI)
        assert not root.GetChild("Colliders").IsActive()
        material = UsdShade.MaterialBindingAPI(simulation).ComputeBoundMaterial("physics")[0].GetPrim()
        for family in ("Physics", "OmniPhysics"):
            assert f"{family}DeformableBodyAPI" in root.GetPrimTypeInfo().GetAppliedAPISchemas()
            assert f"{family}{kind}DeformableSimAPI" in simulation.GetPrimTypeInfo().GetAppliedAPISchemas()
            assert root.GetAttribute(f"{family.lower()}:mass").Get() == pytest.approx(mass)
            assert material.GetAttribute(f"{family.lower()}:youngsModulus").Get() > 0
        density = UsdPhysics.MaterialAPI(material).GetDensityAttr().Get()
        points = np.array(UsdGeom.PointBased(simulation).GetPointsAttr().Get(), dtype=np.float64)
        if kind == "Volume":
            tets = UsdGeom.TetMesh(simulation)
            corners = np.array(tets.GetTetVertexIndicesAttr().Get())
            volume = float(volumes_of(points, corners).sum())
            stated = {tuple(np.roll(face, -np.argmin(face))) for face in np.array(tets.GetSurfaceFaceVertexIndicesAttr().Get())}
            theirs = {tuple(np.roll(face, -np.argmin(face))) for face in np.array(UsdGeom.TetMesh.ComputeSurfaceFaces(tets))}
            assert stated == theirs, "USD finds the same surface, wound the same way"
            assert len(UsdGeom.TetMesh.FindInvertedElements(tets)) == 0
        else:
            faces = np.array(UsdGeom.Mesh(simulation).GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
            volume = trimesh.Trimesh(points, faces, process=False).area * simulation.GetAttribute("physics:thicknesses").Get()[0]
        assert density * volume == pytest.approx(mass, rel=1e-4)


def test_an_instance_can_be_deformable_too(tmp_path: Path) -> None:
    from pxr import UsdPhysics

    config = exports.ExportsConfig(usd=exports.UsdConfig(instanceable=True))
    path = write_usd(tmp_path, replica_of(*with_bedding(rows_of(bedding())), config), config)
    assert check_usd(path) == []
    stage = open_stage(path)
    pillow = stage.GetPrimAtPath("/World/Objects/pillow_0008")
    assert pillow.IsInstance()
    assert pillow.HasAPI(UsdPhysics.RigidBodyAPI)
    pillow.GetVariantSets().SetSelection("physics", "deformable")
    assert pillow.IsInstance()
    assert not pillow.HasAPI(UsdPhysics.RigidBodyAPI)
    assert stage.GetPrimAtPath("/World/Objects/pillow_0008/Simulation").GetTypeName() == "TetMesh"
    stage.GetRootLayer().Save()
    assert check_usd(path) == []


@pytest.mark.slow
def test_newton_lets_them_come_to_rest_on_a_table(selected: Path, tmp_path: Path) -> None:
    python = os.environ.get("METASCENES_NEWTON_PYTHON", "")
    if not python:
        pytest.skip("METASCENES_NEWTON_PYTHON names no interpreter with requirements/newton.lock installed")
    script, result = Path(__file__).with_name("newton_deformables.py"), tmp_path / "result.json"
    done = subprocess.run([python, str(script), str(selected), "1.0", str(result)], capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(result.read_text())
    assert {path.split("/")[3]: round(one["mass"], 4) for path, one in found.items()} == {"blanket_0002": 1.6, "pillow_0003": 0.6}
    for one in found.values():
        states = np.array([np.concatenate(state[:3]) for state in one["at"]])
        speeds = np.array([state[3] for state in one["at"]])
        assert np.isfinite(states).all()
        assert (states[:, 2] > 0.75).all(), "above the table's top at every time"
        assert np.abs(states[-1, 6:] - states[-4, 6:]).max() < 1e-3, "at rest"
        assert speeds[-1] < 0.05
        assert np.abs(states[-1] - states[0]).max() < 0.03, "where it lay, in the shape that it had"


_AGAIN = """
import sys
from pathlib import Path
from tests.tasks.exports.usd.test_exports_usd_deformables import written
print("\\n".join(f"{name} {digest}" for name, digest in sorted(written(Path(sys.argv[1])).items())))
"""


def written(folder: Path) -> dict[str, str]:
    """Digest of every file of a scene with bedding, by path, and of the package of them."""
    path = write_usd(folder, replica_of(*with_bedding(rows_of(bedding()))), exports.ExportsConfig())
    files = {file.relative_to(path.parent).as_posix(): file.read_bytes() for file in path.parent.rglob("*") if file.is_file()}
    files["scene.usdz"] = package(files, "scene.usda")
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


@pytest.mark.whole
def test_another_process_makes_the_same_bytes(tmp_path: Path) -> None:
    env = {"PYTHONHASHSEED": "7", "PXR_WORK_THREAD_LIMIT": "3", "PATH": "", "PYTHONPATH": str(REPOSITORY), "HOME": "/nonexistent"}
    command = [sys.executable, "-c", _AGAIN, str(tmp_path / "there")]
    again = subprocess.run(command, cwd=REPOSITORY, env=env, capture_output=True, text=True, check=True)
    here = written(tmp_path / "here")
    assert dict(line.split() for line in again.stdout.splitlines()) == here
    assert sum(name.endswith("_simulation.usdc") for name in here) == 2
