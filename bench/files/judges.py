"""Independent judges of model files: the `assimp` command, USD itself, and three.js in a browser (`bench.files.threejs`)."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.files.measure import ModelMeasure, ModelPart, measure

ASSIMP = "assimp"
"""The command of Debian's assimp-utils."""

PATIENCE_SECONDS = 600.0
"""Longest wait for a judge, which only ends one that hangs; files of the corpus take less than 10 s."""

USD_ENDINGS = (".usd", ".usda", ".usdc", ".usdz")

Verdict = ModelMeasure | str
"""Measures by a judge, or the reason that it reads nothing."""


def has_assimp() -> bool:
    """True if the command is on this machine."""
    return shutil.which(ASSIMP) is not None


def by_assimp(path: Path) -> Verdict:
    """Triangles and bounds of a file as assimp reads it; colors are left out, since it does not convert them."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "model.assjson"
        command = [ASSIMP, "export", str(path), str(out), "-fassjson"]
        try:
            done = subprocess.run(command, capture_output=True, timeout=PATIENCE_SECONDS, check=False)
            if done.returncode or not out.is_file():
                lines = done.stdout.decode(errors="replace").strip().splitlines()
                return f"refuses it: {lines[-1] if lines else done.returncode}"[:120]
            return measure(list(_assimp_parts(json.loads(out.read_text(errors="replace")))))
        except (ValueError, KeyError, IndexError, TypeError, subprocess.TimeoutExpired) as error:
            return f"reads nothing ({error})"[:120]


def _assimp_parts(document: Any) -> Iterator[ModelPart]:
    waiting = [(document["rootnode"], np.eye(4))]
    while waiting:
        node, above = waiting.pop()
        pose = above @ np.array(node["transformation"], dtype=np.float64).reshape(4, 4)
        waiting += [(child, pose) for child in node.get("children", [])]
        for number in node.get("meshes", []):
            mesh = document["meshes"][number]
            points = np.array(mesh["vertices"], dtype=np.float64).reshape(-1, 3)
            fans = [(face[0], face[i], face[i + 1]) for face in mesh.get("faces", []) for i in range(1, len(face) - 1)]
            with np.errstate(invalid="ignore"):  # `measure` reports coordinates that are not finite
                placed = points @ pose[:3, :3].T + pose[:3, 3]
            yield ModelPart(placed, np.array(fans, dtype=np.int64).reshape(-1, 3))


def by_usd(path: Path) -> Verdict:
    """A USD file as USD itself poses and colors it, skinned meshes in the pose of their joints."""
    from pxr import Tf, Usd, UsdSkel

    try:
        stage = Usd.Stage.Open(str(path))
        UsdSkel.BakeSkinning(Usd.PrimRange(stage.GetPseudoRoot()))
        return measure(list(_usd_parts(stage)))
    except (Tf.ErrorException, ValueError) as error:
        return f"reads nothing ({error})"[:120]


def _usd_parts(stage: Any) -> Iterator[ModelPart]:
    from pxr import Usd, UsdGeom

    time = Usd.TimeCode.EarliestTime()
    places = UsdGeom.XformCache(time)
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Mesh) or UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible:
            continue
        mesh, pose = UsdGeom.Mesh(prim), np.array(places.GetLocalToWorldTransform(prim))
        points = np.array(mesh.GetPointsAttr().Get(time) or [], dtype=np.float64).reshape(-1, 3)
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get(time) or [], dtype=np.int64)
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(time) or [], dtype=np.int64)
        starts = np.cumsum(counts) - counts
        fans = [(start, start + i, start + i + 1) for start, count in zip(starts, counts, strict=True) for i in range(1, count - 1)]
        stated = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
        color = np.array(stated.Get(time) or [], dtype=np.float64).reshape(-1, 3) if stated else np.zeros((0, 3))
        faces = corners[np.array(fans, dtype=np.int64).reshape(-1, 3)]
        yield ModelPart(points @ pose[:3, :3] + pose[3, :3], faces, color[0] if len(color) == 1 else None)
