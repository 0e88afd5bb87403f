"""Mesh files of finished datasets: GLB, OBJ with its materials, PLY, STL. Nothing outside the dataset's folder is opened."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import stays_in
from tasks.capture.files.documents import name_of, read_bytes
from tasks.capture.files.ply import read_ply
from tasks.capture.files.survey import offset_error
from tasks.containers import GLB_MAGIC
from tasks.geometry.gltf.plain import read_features
from tasks.geometry.meshes import check_looks, load_glb
from tasks.geometry.transforms import Y_UP_TO_Z_UP, Z_UP_TO_Y_UP
from tasks.ingestion.materials import decoded
from tasks.ingestion.obj import obj_parts

if TYPE_CHECKING:
    import trimesh

ENDINGS = (".glb", ".obj", ".ply", ".stl")
"""How the names of mesh files end that are read."""

MAX_MODEL_BYTES, MAX_STAGE_BYTES = BUDGET.model_bytes, BUDGET.scene_bytes


MAX_OFFSET = 1e6
"""Objects of a dataset lie no farther from their origin [m]."""


def read_model(
    path: Path, root: Path, is_z_up: bool, limit: int = MAX_MODEL_BYTES, max_offset: float = MAX_OFFSET
) -> tuple[list[trimesh.Trimesh], list[str]]:
    """Parts of a mesh file in a +Z-up frame [m], textures kept; and notes on missing materials and unused features, a line each.

    is_z_up: Coordinates in the file have +Z up, else +Y up. max_offset: Largest coordinate, in units of the file.

    Raises:
        InputError: the file lies outside `root`, is missing, too large, of another kind, or no usable mesh; or its
            materials name a file outside `root`.
    """
    name = name_of(path, root)
    if not stays_in(path, root):
        raise InputError(name, "file", "lies outside the dataset's folder", "copy it in")
    kind = path.suffix.lower()
    if kind not in ENDINGS:
        raise InputError(name, "format", f"{kind or 'none'} is not read", f"convert it to {', '.join(ENDINGS)}")
    # Text takes many times its bytes.
    data = read_bytes(path, name, limit, GLB_MAGIC) if kind == ".glb" else read_bytes(path, name, min(limit, MAX_MODEL_BYTES))
    notes: list[str] = []
    if kind == ".glb":
        _check_self_contained(data, name)
        parts, notes = _guarded_glb(data, name)
        turn = Z_UP_TO_Y_UP if is_z_up else None
    else:
        parts, notes = _loaded(data, path, root, name, kind[1:])
        turn = None if is_z_up else Y_UP_TO_Z_UP
    for part in parts:
        if not np.isfinite(part.vertices).all():
            raise InputError(name, "vertices", "are not finite", "export it again")
        distance = float(np.abs(part.vertices).max())
        if distance > max_offset:
            raise offset_error(name, distance, max_offset)
        if turn is not None:
            part.apply_transform(turn)
    return parts, notes


def is_convex(parts: Sequence[trimesh.Trimesh]) -> bool:
    """Whether every part is a closed convex piece."""
    return bool(parts) and all(part.is_watertight and part.is_convex for part in parts)


def _check_self_contained(data: bytes, name: str) -> None:
    """Refuse a GLB that draws on other files: those are not part of what the scene is fingerprinted by."""
    length = int.from_bytes(data[12:16], "little")
    for match in re.finditer(rb'"uri"\s*:\s*"([^"]{0,200})', data[20 : 20 + length]):
        if not match[1].startswith(b"data:"):
            raise InputError(name, "uri", f"names another file, {match[1].decode('utf-8', 'replace')[:80]!r}", "pack it into the GLB")


def _guarded_glb(data: bytes, name: str) -> tuple[list[trimesh.Trimesh], list[str]]:
    try:
        plain = read_features(data, name)
        return load_glb(plain.data, name), list(plain.notes)
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise InputError(name, "meshes", f"are broken ({error})", "export it again") from error


def _loaded(data: bytes, path: Path, root: Path, name: str, kind: str) -> tuple[list[trimesh.Trimesh], list[str]]:
    """Parts of an OBJ, PLY or STL, in its own frame."""
    if kind == "ply":
        ply = read_ply(path, name, is_in_metres=False)
        return [ply.surface.to_trimesh()], list(ply.notes)
    if kind == "obj":
        return obj_parts(decoded(data), path, root, name)
    import trimesh

    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
    except Exception as error:  # the loader raises whatever the bytes lead it to
        raise InputError(name, "content", f"is no readable {kind.upper()} ({type(error).__name__}: {error})", "export it again") from error
    check_looks(scene, name)
    parts = [mesh for _, mesh in sorted(scene.geometry.items()) if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not parts:
        raise InputError(name, "meshes", "holds no triangles", "export it with its geometry")
    if sum(len(part.faces) for part in parts) > BUDGET.faces:
        raise InputError(name, "faces", f"more than {BUDGET.faces} triangles", "decimate the mesh")
    for part in parts:
        if part.vertices.shape[1:] != (3,):
            raise InputError(name, "vertices", f"have {part.vertices.shape[-1]} numbers, not 3", "export it again")
        if part.faces.min() < 0 or part.faces.max() >= len(part.vertices):
            raise InputError(name, "faces", "name vertices that are not there", "export it again")
    return parts, []
