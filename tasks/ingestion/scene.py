"""A scene of a finished dataset, once found on disk and once read: what every reader gives, whatever the dataset's layout."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from schemas.capture import DATASET_LAYOUTS, DatasetLayout
from schemas.errors import InputError
from tasks.capture.labels import Label
from tasks.capture.scan import Scan

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

Kind: TypeAlias = DatasetLayout
KINDS = DATASET_LAYOUTS


@dataclasses.dataclass(frozen=True)
class Source:
    """A scene that was found, not yet read.

    root: Folder of the dataset, resolved; nothing outside of it is read. scan: The scene's name in the dataset.
    files: All files that the scene is read from, sorted. about: What the dataset's own files say of the scene, as JSON
    values. problem: Why it cannot be read, where that is known already.
    """

    kind: Kind
    root: Path
    dataset: str
    scan: str
    files: tuple[Path, ...]
    about: Mapping[str, Any]
    problem: InputError | None = None

    @property
    def scene_id(self) -> str:
        """`<dataset>/<scan>`, both reduced to what a scene id may hold."""
        return Scan(self.kind, self.root, self.dataset, self.scan).scene_id

    @property
    def room_id(self) -> str:
        """The physical room. MetaScenes stands for scans of ScanNet, so its rooms are ScanNet's; others are their own."""
        match = re.fullmatch(r"(scene\d{4})_\d{2}", self.scan)
        return f"scannet/{match[1]}" if match and self.kind == "metascenes" else self.scene_id


@dataclasses.dataclass(frozen=True)
class ImportedModel:
    """A mesh of the dataset, which several objects may show.

    parts: In a +Z-up frame of its own [m], unscaled, textures kept. pieces: Convex pieces in that frame, where the
    dataset has any. name, source, license, author: As rows of `assets` have them.
    """

    parts: tuple[trimesh.Trimesh, ...]
    pieces: tuple[trimesh.Trimesh, ...]
    name: str
    source: str
    license: str
    author: str | None = None


@dataclasses.dataclass(frozen=True)
class Physics:
    """What a dataset states of an object's body: mass [kg], coefficients, and where it says so."""

    mass_kg: float
    friction: float
    restitution: float
    source: str


@dataclasses.dataclass(frozen=True)
class FinishedObject:
    """An object as the dataset has it.

    pose: Model to world frame, rigid, 4x4 [m]. scale: Along the model's own axes, applied before the pose, shape (3,).
    proposed: The pose that the dataset had before it optimized the scene; None when it states one pose alone.
    is_annotated: People chose model and pose. remains: What is wrong with the pose, by the dataset's own account.
    instance_id: Zero-padded, unique in the scene. source_id: What the dataset calls it.
    """

    instance_id: str
    source_id: str
    raw_label: str
    label: Label
    model: ImportedModel
    pose: Array
    scale: Array
    proposed: Array | None = None
    is_annotated: bool = False
    remains: str | None = None
    physics: Physics | None = None


@dataclasses.dataclass(frozen=True)
class FloorLayout:
    """A floor that the dataset states: corners in the world frame, counter-clockwise [m], shape (n, 2), and height [m]."""

    polygon: Array
    height: float | None


@dataclasses.dataclass(frozen=True)
class FinishedScene:
    """A scene as read, in the world frame.

    stage: Floor and walls as the dataset draws them, with the label of each part; empty when it has none. layout: The
    floor as the dataset states it. alignment: The dataset's frame to the world frame, 4x4. notes: What had
    to be left out or assumed, a line each.
    """

    objects: tuple[FinishedObject, ...]
    stage: tuple[tuple[trimesh.Trimesh, Label], ...]
    layout: FloorLayout | None
    alignment: Array
    room_type: str
    license: str | None
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class IngestionConfig:
    """How finished datasets are read."""

    label_map: str | None = None  # The project's own map, as capture has it, so that categories mean the same everywhere.
    max_points: int = 20_000  # As capture has it.
    max_faces: int = 400_000  # As capture has it; more than that of a stage only fills the lake.
    test_share: float = 0.2  # As navigation has it, so that rooms of all datasets are split alike.
    agent: str = "habitat"  # Name of the agent of imported navmeshes: their files give its shape, not its name.


MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
"""Mirror image along a model's own x axis, 4x4."""


def is_mirrored(matrix: Array) -> bool:
    """True if a 4x4 matrix turns a model into its mirror image."""
    return bool(np.linalg.det(np.asarray(matrix, dtype=np.float64)[:3, :3]) < 0.0)


def mirrored_model(model: ImportedModel) -> ImportedModel:
    """The mirror image of a model along its own x axis, with outward faces."""
    copies = [tuple(part.copy().apply_transform(MIRROR) for part in parts) for parts in (model.parts, model.pieces)]
    return dataclasses.replace(model, parts=copies[0], pieces=copies[1])


def scaled_pose(matrix: Array, file: str, field: str) -> tuple[Array, Array]:
    """A 4x4 matrix as a rigid pose and a scale along the object's own axes, shape (3,), applied before the pose.

    Raises:
        InputError: it is not finite, shears, mirrors, or shrinks to nothing; names `file` and `field`.
    """
    values = np.asarray(matrix, dtype=np.float64)
    if values.shape != (4, 4) or not np.isfinite(values).all() or np.abs(values).max() > 1e6:
        raise InputError(file, field, "is no 4x4 matrix of finite numbers in metres", "export it again")
    if not np.allclose(values[3], [0, 0, 0, 1], atol=1e-6):
        raise InputError(file, field, "has a last row other than 0 0 0 1", "give object-to-world matrices, row by row")
    scale = np.linalg.norm(values[:3, :3], axis=0)
    if scale.min() < 1e-3:
        raise InputError(file, field, f"scales an axis by {scale.min():.3g}, to nothing", "export it again")
    rotation = values[:3, :3] / scale
    if np.linalg.det(rotation) < 0:
        raise InputError(file, field, "mirrors the object", "mirror its mesh instead")
    if not np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-3):
        raise InputError(file, field, "shears the object", "give rotation, scale along its own axes, and translation only")
    u, _, vt = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = u @ vt, values[:3, 3]
    return pose, scale
