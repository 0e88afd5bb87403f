"""Mesh files that a robot's or a world's description names: whether they can be read, and are what a simulator collides with."""

from __future__ import annotations

import io
import re
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import AnyPath, is_there, read_file
from tasks.exports.findings import Finding
from tasks.exports.usd.prims import dent
from tasks.exports.wavefront import load_obj
from tasks.geometry.transforms import Z_UP_TO_Y_UP

HULL_TOLERANCE_M = 2e-3
"""How far a mesh may lie inside its own hull [m] and still count as convex; as for USD."""

ELSEWHERE = re.compile(r"(package|model|fuel|https?)://")
"""Beginnings of addresses that ROS or Gazebo finds, wherever it keeps what they name."""

_KINDS = ("obj", "stl", "ply", "dae")  # beside GLB
_UNREAD = "is of a kind that cannot be read here"
_FARTHEST_M = 1e6  # what is computed of positions still has digits that matter
_PRODUCTS = 20_000_000  # vertices times triangles that are compared: 160 MB


def named_mesh(path: AnyPath, where: str, name: str, known: dict[Any, Any]) -> tuple[list[Finding], Any]:
    """What is wrong with a mesh file that the file at `path` names, and its positions and triangles where nothing is.

    known: What was read before, by path, which grows.
    """
    if ELSEWHERE.match(name):
        return [Finding("closed_paths", where, f"{name} is found by ROS or Gazebo only", False)], None
    pure = PurePosixPath(name)
    if not name or pure.is_absolute() or ".." in pure.parts or ":" in name or "\\" in name:
        return [Finding("closed_paths", where, f"mesh {pure.name!r} is absolute or leaves the folder")], None
    target = path.parent / name
    if not is_there(target):
        return [Finding("closed_paths", where, f"mesh {name!r} does not exist")], None
    if target not in known:
        known[target] = _read(target)
        known[target, "materials"] = _lost(target, name)
    loaded = known[target]
    if isinstance(loaded, str):
        return [Finding("mesh", where, f"{name} {loaded}", not loaded.startswith(_UNREAD))], None
    return [Finding("closed_paths", where, lost) for lost in known[target, "materials"]], loaded


def _lost(path: AnyPath, name: str) -> list[str]:
    """Files that an OBJ and its materials name, and that are not there."""
    lost = []
    try:
        libraries = re.findall(rb"^mtllib +(\S+)", read_file(path, name, BUDGET.model_bytes), re.M) if path.suffix.lower() == ".obj" else []
        for library in dict.fromkeys(libraries):
            material = path.parent / library.decode(errors="replace")
            if not is_there(material):
                lost.append(f"{name} names {material.name!r}, which does not exist")
                continue
            for image in dict.fromkeys(re.findall(rb"^map_Kd +(\S+)", read_file(material, material.name, BUDGET.text_bytes), re.M)):
                picture = path.parent / image.decode(errors="replace")
                if not is_there(picture):
                    lost.append(f"{material.name} names {picture.name!r}, which does not exist")
    except (InputError, ValueError) as error:
        lost.append(str(error))
    return lost


def hollow(path: AnyPath, loaded: Any, known: dict[Any, Any]) -> tuple[bool, float]:
    """Whether a mesh that was read is flat, and how far it lies inside its own hull [m]. known: As `named_mesh` has it."""
    if (path, "gap") not in known:
        vertices, faces = loaded
        every = -(-len(vertices) * len(faces) // _PRODUCTS)
        is_flat = bool(np.linalg.matrix_rank(vertices - vertices.mean(axis=0), tol=1e-7) < 3)
        known[path, "gap"] = is_flat, dent((vertices, faces[::every]))
    verdict: tuple[bool, float] = known[path, "gap"]
    return verdict


def _read(path: AnyPath) -> Any:
    """Positions [m], shape (n, 3), and triangles, shape (m, 3), of a mesh file, or what is wrong with it."""
    import trimesh

    from tasks.capture.files.ply_header import check_counts
    from tasks.geometry.meshes import load_glb, surface_of

    kind = path.suffix.lower().lstrip(".")
    try:
        data = read_file(path, path.name, BUDGET.model_bytes)
        plain = load_obj(data) if kind == "obj" else None  # a tenth of the time of a reader for all there is
        if plain is not None:
            return _sound(*plain)
        if kind == "glb":
            surface = surface_of(load_glb(data, path.name)).transformed(Z_UP_TO_Y_UP)  # a robot's frame is that of the file
            return _sound(surface.vertices, surface.faces)
        if kind not in _KINDS:
            return f"{_UNREAD}: {kind or 'no'} files"
        if kind == "ply":
            check_counts(data, path.name)
        mesh: Any = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False, skip_materials=True)
        mesh = mesh.to_mesh() if isinstance(mesh, trimesh.Scene) else mesh
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    except InputError as error:
        return f"cannot be read ({error})"
    except ImportError as error:  # Collada, for one, is read by packages that not everybody has
        return f"{_UNREAD}: {' '.join(str(error).split())[:100]}"
    except Exception as error:  # the loader raises whatever the bytes lead it to
        return f"cannot be read ({type(error).__name__})"
    return _sound(vertices, faces)


def _sound(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Any:
    """Positions and triangles, or what is wrong with them."""
    if not len(faces):
        return "has no triangles"
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        return "has positions that are not three numbers"
    if not np.isfinite(vertices).all():
        return "has positions that are not finite"
    if np.abs(vertices).max() > _FARTHEST_M:
        return "has positions farther away than 1,000 km"
    return (vertices, faces) if faces.min() >= 0 and faces.max() < len(vertices) else "has triangles of no vertices"
