"""The project's readers of model files, each as it is used, with results in the frame and unit of the file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.files.measure import ModelMeasure, ModelPart, measure
from schemas.errors import InputError
from tasks.capture.bare_mesh import BARE_MESH
from tasks.capture.bare_mesh import SUFFIXES as SCANNED
from tasks.capture.glb import GLB
from tasks.capture.scan import Scan, ScanFormat
from tasks.exports.format import ExportFormat
from tasks.exports.formats import FORMATS as EXPORTS
from tasks.geometry.colors import linear_of
from tasks.geometry.meshes import Surface, material_of, surface_of
from tasks.geometry.transforms import Z_UP_TO_Y_UP
from tasks.ingestion import models
from tasks.library import formats as library

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class FileReading:
    """The result of reading a file. measure: None if refused. reason: of the refusal. notes: features that were not read."""

    measure: ModelMeasure | None
    reason: str = ""
    notes: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class FileReader:
    """A reader of the project. endings: of the files that it accepts. read: the outcome of a file below a folder."""

    name: str
    endings: tuple[str, ...]
    read: Callable[[Path, Path], FileReading]


def _guarded(read: Callable[[Path, Path], tuple[Sequence[ModelPart], Sequence[str]]]) -> Callable[[Path, Path], FileReading]:
    def outcome(path: Path, root: Path) -> FileReading:
        try:
            parts, notes = read(path, root)
            return FileReading(measure(parts), notes=tuple(notes))
        except InputError as error:
            return FileReading(None, f"{error.field}: {error.problem}")

    return outcome


def _moved(points: Any, matrix: Any) -> Any:
    """Points, shape (n, 3), moved by a 4x4 matrix."""
    return np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def parts_of(meshes: Sequence[trimesh.Trimesh], matrix: Any) -> list[ModelPart]:
    """Parts of meshes as their readers color them, moved by a 4x4 matrix."""
    parts = []
    for mesh in meshes:
        visual: Any = mesh.visual
        vertices, faces = _moved(mesh.vertices, matrix), np.asarray(mesh.faces, dtype=np.int64)
        if visual.kind == "texture":
            image, factor = material_of(mesh)
            uv = None if visual.uv is None or image is None else np.asarray(visual.uv, dtype=np.float64)[:, :2] * [1, -1] + [0, 1]
            parts.append(ModelPart(vertices, faces, factor, uv=uv, image=image))
        else:
            parts.append(_colored(surface_of([mesh]), vertices))
    return parts


def _colored(surface: Surface, vertices: Any) -> ModelPart:
    return ModelPart(vertices, surface.faces, np.ones(3), linear_of(surface.colors / 255.0))


def _scan(format_: ScanFormat) -> Callable[[Path, Path], tuple[Sequence[ModelPart], Sequence[str]]]:
    def read(path: Path, root: Path) -> tuple[Sequence[ModelPart], Sequence[str]]:
        reading = format_.read(Scan(format_.name, path, format_.dataset, path.stem, (root,)))
        assert reading.surface is not None
        matrix = np.eye(4) if reading.from_file is None else np.linalg.inv(reading.from_file)
        if reading.parts:
            return parts_of(reading.parts, matrix), reading.degradations
        return [_colored(reading.surface, _moved(reading.surface.vertices, matrix))], reading.degradations

    return read


def _library(path: Path, root: Path) -> tuple[Sequence[ModelPart], Sequence[str]]:
    model = library.read_model(path, root)
    return parts_of(model.parts, Z_UP_TO_Y_UP if model.is_turned else np.eye(4)), model.notes


def _import(path: Path, root: Path) -> tuple[Sequence[ModelPart], Sequence[str]]:
    parts, notes = models.read_model(path, root, is_z_up=False)
    return parts_of(parts, Z_UP_TO_Y_UP), notes


def _doctor(format_: ExportFormat) -> Callable[[Path, Path], FileReading]:
    """The first error of a gate as the reason, warnings as notes; its file is not measured."""

    def outcome(path: Path, root: Path) -> FileReading:
        findings = format_.check(path)
        errors = [str(finding) for finding in findings if finding.is_error]
        return FileReading(None, errors[0] if errors else "", tuple(str(finding) for finding in findings if not finding.is_error))

    return outcome


READERS = (
    FileReader("scan", SCANNED, _guarded(_scan(BARE_MESH))),
    FileReader("scan of objects", GLB.suffixes, _guarded(_scan(GLB))),
    FileReader("library", tuple(ending for kind in library.FORMATS for ending in kind.endings), _guarded(_library)),
    FileReader("import", models.ENDINGS, _guarded(_import)),
)
"""Readers whose geometry is compared."""

DOCTORS = tuple(
    FileReader(f"doctor {kind.name}", endings, _doctor(kind))
    for kind in EXPORTS
    for endings in [{"glb": (".glb",), "usd": (".usd", ".usda", ".usdc", ".usdz")}.get(kind.name, ())]
    if endings
)
"""Gates that look at files of others without measuring them."""
