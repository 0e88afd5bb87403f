"""Models of a chair in every format, made with the libraries that own the formats."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import trimesh

from tasks.furniture import generate
from tasks.geometry.colors import linear_of_bytes
from tasks.geometry.meshes import Surface, dump_glb, surface_of
from tasks.geometry.transforms import Z_UP_TO_Y_UP

SIZE = (0.5, 0.55, 0.95)
"""Of the chair [m]: no two sides are alike, so that a wrong axis shows."""


def chair(seed: int = 0) -> list[trimesh.Trimesh]:
    """A chair, +Z up, bottom center at the origin [m]."""
    return generate("chair", SIZE, np.random.default_rng(seed)).parts


def in_file_axes(parts: list[trimesh.Trimesh], unit_m: float, up: str) -> Surface:
    """The same in a file's units and axes."""
    surface = surface_of(parts)
    return surface.transformed(Z_UP_TO_Y_UP if up == "y" else np.eye(4), [1 / unit_m] * 3)


def as_glb(parts: list[trimesh.Trimesh], scale: float = 1.0) -> bytes:
    copies = [part.copy() for part in parts]
    for part in copies:
        part.apply_scale(scale)
    return dump_glb(copies)


def as_obj(parts: list[trimesh.Trimesh], unit_m: float = 1.0, up: str = "y", head: str = "") -> bytes:
    surface = in_file_axes(parts, unit_m, up)
    lines = [head, *(f"v {x!r} {y!r} {z!r}" for x, y, z in surface.vertices.tolist())]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (surface.faces + 1).tolist()), ""]).encode()


def write_usd(path: Path, parts: list[trimesh.Trimesh], unit_m: float | None = 1.0, up: str | None = "z") -> None:
    """A layer of one mesh with display colors; without units or axis where they are None."""
    from pxr import Sdf, Usd, UsdGeom, Vt

    surface = in_file_axes(parts, unit_m or 1.0, up or "z")
    stage = Usd.Stage.CreateNew(str(path))
    if unit_m is not None:
        UsdGeom.SetStageMetersPerUnit(stage, unit_m)
    if up is not None:
        UsdGeom.SetStageUpAxis(stage, up.upper())
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Chair").GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/Chair/Mesh")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(surface.vertices.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(surface.faces))
    mesh.CreateFaceVertexIndicesAttr(surface.faces.ravel().tolist())
    colors = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex)
    colors.Set(Vt.Vec3fArray.FromNumpy(linear_of_bytes(surface.colors).astype(np.float32)))
    stage.GetRootLayer().Save()


def as_usdz(files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """A package of files in their order."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return buffer.getvalue()


def farthest(parts: list[trimesh.Trimesh], others: list[trimesh.Trimesh]) -> float:
    """How far the vertices of either lie from those of the other, at most [m]."""
    from scipy.spatial import cKDTree

    a, b = surface_of(parts).vertices, surface_of(others).vertices
    return float(max(cKDTree(a).query(b)[0].max(), cKDTree(b).query(a)[0].max()))
