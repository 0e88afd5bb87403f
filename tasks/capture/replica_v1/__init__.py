"""Replica: the mesh that the data set exports for Habitat, whose faces say which object they are of, and the objects' classes.

Written from the public description of the data set. Its high-resolution textures are not read: vertices have colors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.annotated_rows import labels_by_number
from tasks.capture.files.documents import license_of, name_of, read_json
from tasks.capture.files.ply import read_labelled_ply
from tasks.capture.layout import folders_in
from tasks.capture.premises import Premises
from tasks.capture.reading import Group, Reading, groups_of_faces
from tasks.capture.rooms.alignment import rotation_to_z
from tasks.capture.scan import Scan, ScanFormat, license_path
from tasks.geometry.meshes import Surface

PLACE, MESH, OBJECTS = "habitat", "mesh_semantic.ply", "info_semantic.json"

NOTHING = ("undefined", "unknown", "")
"""Class names of what nobody named."""


def read_replica(scan: Scan) -> Reading:
    """The mesh turned to +Z up, and an instance for each object that has a class and a face.

    Raises:
        InputError: a file is missing or broken.
    """
    folder = scan.path
    place = _place(folder)
    mesh, info = place / MESH, place / OBJECTS
    admitted = _files(scan, scan.premises)
    for path in (mesh, info):
        if path not in admitted:
            raise InputError(name_of(path, folder), "file", "is missing, or a link that leaves", f"copy {MESH} and {OBJECTS}")
    ply = read_labelled_ply(mesh, name_of(mesh, folder), "face", "object_id")
    name = name_of(info, folder)
    document = read_json(info, name)
    surface = ply.surface.transformed(_upright(document.get("gravity_dir"), name))
    labels, notes = _labels(document, name)
    groups = _groups(labels, ply.labels, surface, name)
    return Reading(
        surface=surface,
        groups=groups,
        license=license_of(license_path(folder, scan.premises)),
        degradations=(*ply.notes, *notes, "no frames in the scan: no views, no masks"),
    )


def _upright(gravity: Any, name: str) -> NDArray[np.float64]:
    """The turn that has gravity point down, 4x4; none where the file does not say where it points."""
    pose = np.eye(4)
    if gravity is None:
        return pose
    is_direction = isinstance(gravity, list) and len(gravity) == 3 and all(isinstance(v, int | float) and abs(v) < 1e6 for v in gravity)
    if not is_direction or np.linalg.norm(gravity) < 1e-3:
        raise InputError(name, "gravity_dir", "is no direction", "give three numbers, or leave it out: +Z is up then")
    pose[:3, :3] = rotation_to_z(-np.array(gravity, dtype=np.float64))
    return pose


def _labels(document: dict[str, Any], name: str) -> tuple[dict[int, str], list[str]]:
    """Class of each object by its number, and notes on wrong rows."""
    objects = document.get("objects")
    if not isinstance(objects, list):
        raise InputError(name, "objects", "must be a list", "is it the right file?")
    labels, notes = labels_by_number(objects, Path(name).name, "objects", "class_name")
    return {number: label for number, (label, _) in labels.items()}, notes


def _groups(labels: dict[int, str], object_of_face: NDArray[np.int64], surface: Surface, name: str) -> tuple[Group, ...]:
    named = [(number, label) for number, label in sorted(labels.items()) if label.lower() not in NOTHING]
    present, dense = np.unique(object_of_face, return_inverse=True)
    index_of = {number: index for index, (number, _) in enumerate(named)}
    owner = np.array([index_of.get(int(number), -1) for number in present], dtype=np.int64)[dense]
    groups = groups_of_faces([(str(number), label) for number, label in named], owner, surface)
    file = Path(name).name
    return tuple(Group(g.source_id, g.raw_label, g.vertices, g.faces, f"{file}: object {g.source_id}") for g in groups)


def _place(folder: Path) -> Path:
    """The folder that the mesh lies in: `habitat` of a scene's folder, or the folder itself."""
    return folder / PLACE if (folder / PLACE).is_dir() else folder


def _is_scan(folder: Path) -> bool:
    place = _place(folder)
    return all((place / name).is_file() or (place / name).is_symlink() for name in (MESH, OBJECTS))


def _recognize(folder: Path) -> str | None:
    if not _is_scan(folder):
        return None
    return folder.parent.name if folder.name == PLACE and folder.parent.name else folder.name


def _files(scan: Scan, premises: Premises) -> list[Path]:
    place = _place(scan.folder)
    if not premises.admits(place):
        return []
    return [path for path in (place / MESH, place / OBJECTS) if path.is_file() and premises.admits(path)]


REPLICA_V1 = ScanFormat(
    name="replica_v1",
    dataset="replica",
    expected=f"{PLACE}/{MESH} and {PLACE}/{OBJECTS}",
    recognize=_recognize,
    is_recorded=lambda folder: _is_scan(folder) or any(map(_is_scan, folders_in(folder))),
    files=_files,
    read=read_replica,
    unread=("mesh*.ply", f"{PLACE}/*.ply"),
    signs=(f"{PLACE}/{MESH}", f"{PLACE}/{OBJECTS}"),
)
