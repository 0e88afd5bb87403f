"""Models by others as furniture of wild rooms: GLB files of a folder with an index of their categories."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import json_value
from tasks.containers import GLB_MAGIC
from tasks.furniture.solids import hull
from tasks.furniture.wild.sheets import SizedModel, assembled
from tasks.geometry.meshes import load_glb
from tasks.geometry.pieces import Hull

Array = NDArray[np.float64]

INDEX = "index.json"

AT_WALLS: tuple[str, ...] = (
    "wardrobe", "refrigerator", "kitchen cabinet", "tv stand", "desk", "nightstand", "shoe rack", "exercise bench", "trash can",
)  # fmt: skip
"""Categories that stand with a side at a wall; others stand anywhere or on furniture."""

ON_TOPS: tuple[str, ...] = ("vase", "dish rack", "picture frame", "tablet", "spice rack")

ON_FLOORS: tuple[str, ...] = ("exercise ball", "barbell", "chair")

MAX_FLOOR_M = 2.0
"""Longest side in plan of a model that a wild room has place for next to its own furniture [m]."""


@dataclasses.dataclass(frozen=True)
class ForeignFile:
    """A model of the index. category: as the index states it."""

    path: Path
    category: str


def foreign_files(folder: Path) -> list[ForeignFile]:
    """The models of a folder's index that wild rooms have a place for, in its order.

    Raises:
        InputError: the folder has no index, or it cannot be read.
    """
    path = folder / INDEX
    data = read_file(path, str(path), BUDGET.text_bytes, "name a folder of models with an index")
    try:
        rows = json_value(data)
    except ValueError as problem:
        raise InputError(str(path), "content", str(problem), "write the index again") from problem
    if not isinstance(rows, list) or not all(isinstance(row, dict) and {"file", "category"} <= row.keys() for row in rows):
        raise InputError(str(path), "content", "must be a list of objects with file and category", "write the index again")
    files = [ForeignFile(folder / str(row["file"]), str(row["category"])) for row in rows]
    return [file for file in files if file.category in (*AT_WALLS, *ON_TOPS, *ON_FLOORS)]


def foreign_model(file: ForeignFile) -> SizedModel:
    """A model as its authors drew it, its long side along y; one convex piece for each of its parts.

    Raises:
        InputError: the file cannot be read.
    """
    parts = load_glb(read_file(file.path, file.path.name, BUDGET.scene_bytes, magic=GLB_MAGIC), file.path.name)
    points = np.concatenate([np.asarray(part.vertices) for part in parts])
    side = np.ptp(points, axis=0)
    quarter = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    pieces: list[Hull] = []
    for number, part in enumerate(parts):
        if side[0] > side[1]:
            part.apply_transform(quarter)
        part.metadata["name"] = f"part {number}"
        pieces.append(hull(_solid_points(np.asarray(part.vertices))))
    return assembled(file.path.stem, file.category, parts, pieces)


def _solid_points(vertices: Array) -> Array:
    """Vertices, shape (n, 3) [m]; those in one plane get a millimetre of thickness, so that they have a convex hull."""
    axes = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)
    if axes.S[-1] > 1e-3 * axes.S[0]:
        return vertices
    return np.concatenate([vertices - 0.0005 * axes.Vh[-1], vertices + 0.0005 * axes.Vh[-1]])
