"""MultiScan: the annotation of a scan, with the mesh whose faces it names, or with nothing but the boxes of its objects.

Written from the public description of the data set, whose meshes name an object for each face, and from a sample of an earlier state of
it, in which a file beside the mesh lists the faces of each object and part. Images lie in videos and are not read.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.wording import counted
from tasks.capture.files.annotated_rows import whole_numbers
from tasks.capture.files.documents import license_of, name_of, plain_text, read_bytes, read_json
from tasks.capture.files.ply import read_labelled_ply, read_ply
from tasks.capture.files.ply_header import header
from tasks.capture.multiscan.annotation import AnnotatedObject, objects_of, upright
from tasks.capture.multiscan.boxes import box_surfaces
from tasks.capture.premises import Premises
from tasks.capture.reading import Group, Reading, groups_of_faces
from tasks.capture.roomplan.room import NO_SURFACE
from tasks.capture.scan import Scan, ScanFormat, license_path, own_file
from tasks.geometry.meshes import Surface

ANNOTATION, SEGMENTS, MESH = ".annotations.json", ".semseg.json", ".ply"
"""What the files of a scan end with, after its name."""

_SCENE = r"scene_\d{5}_\d{2}"
"""What scans are called."""

NUMBER = "objectId"
"""Property of the faces of a mesh: the object that each is of."""


def read_multiscan(scan: Scan) -> Reading:
    """The mesh turned to +Z up, and its objects; without a mesh the boxes of the objects, with a plain surface.

    Raises:
        InputError: a file is broken, or mesh and annotation do not fit together.
    """
    folder = scan.path
    path = own_file(scan, _annotation(folder).name)
    name = name_of(path, folder)
    listed, notes = objects_of(read_json(path, name), name)
    turn, more = upright(listed)
    notes += more
    from_file = None if np.array_equal(turn, np.eye(4)) else turn
    objects = [entry for entry in listed if not entry.is_removed]
    if not objects:
        raise InputError(name, "objects", "every object is marked to be removed", "is it the right annotation?")
    if removed := len(listed) - len(objects):
        notes.append(f"{removed} of {len(listed)} objects are marked to be removed: left out, with their faces")
    license = license_of(license_path(folder, scan.premises))
    mesh, segments = (_named(scan, ending) for ending in (MESH, SEGMENTS))
    if mesh is None:
        whole, more = box_surfaces(objects, turn, name, path.name)
        return Reading(
            surface=whole.surface,
            parts=whole.parts,
            groups=whole.groups,
            license=license,
            is_modelled=True,
            is_dense=False,
            degradations=(NO_SURFACE, *notes, *more, *whole.notes),
            from_file=from_file,
        )
    notes.append("no frames are read from this format: no views, no masks")
    surface, owner, more = _owned_faces(mesh, segments, folder, listed)
    notes += more
    groups = None
    if owner is not None:
        if (owner < 0).all():
            raise InputError(name, "objects", "no face of the mesh is of any of them", "use mesh and annotation of one and the same scan")
        surface, owner = _without_removed(surface, owner, listed, name)
        groups, more = _groups(listed, owner, surface, path.name)
        notes += more
    if from_file is not None:
        surface = surface.transformed(from_file)
    return Reading(surface=surface, groups=groups, license=license, degradations=tuple(notes), from_file=from_file)


def _owned_faces(
    mesh: Path, segments: Path | None, folder: Path, listed: list[AnnotatedObject]
) -> tuple[Surface, NDArray[np.int64] | None, list[str]]:
    """The mesh, and the place in the list of the object that each face is of, -1 for none, shape (m,); None where no file says it."""
    name = name_of(mesh, folder)
    is_labelled, is_numbered = _is_labelled(mesh, name), any(entry.number is not None for entry in listed)
    if is_labelled and is_numbered:
        labelled = read_labelled_ply(mesh, name, "face", NUMBER)
        places = {entry.number: index for index, entry in enumerate(listed) if entry.number is not None}
        unnumbered = [entry for entry in listed if entry.number is None and not entry.is_removed]
        notes = [f"{entry.field} ({entry.name}): has no {NUMBER}, by which the mesh names its faces" for entry in unnumbered]
        present, dense = np.unique(labelled.labels, return_inverse=True)
        notes = [*labelled.notes, *notes]
        return labelled.surface, np.array([places.get(int(number), -1) for number in present], dtype=np.int64)[dense], notes
    ply = read_ply(mesh, name)
    surface = ply.surface
    if segments is None:
        where = "in the annotation" if is_labelled else "at the faces" if is_numbered else "at the faces and in the annotation"
        why = f"no {NUMBER} {where}, and no {mesh.stem}{SEGMENTS} beside the mesh"
        return surface, None, [*ply.notes, f"{why}: instances found in its geometry"]
    segmented = name_of(segments, folder)
    owner, notes = _owner(read_json(segments, segmented), segmented, len(surface.faces), listed)
    return surface, owner, [*ply.notes, *notes]


def _is_labelled(mesh: Path, name: str) -> bool:
    _, elements, _ = header(read_bytes(mesh, name, BUDGET.scene_bytes, b"ply"), name)
    return any(element.name == "face" and any(field[0] == NUMBER for field in element.fields) for element in elements)


def _owner(document: dict[str, Any], name: str, count: int, listed: list[AnnotatedObject]) -> tuple[NDArray[np.int64], list[str]]:
    """The same by lists of faces under the names of objects, or of objects and parts, as in `door.1` and `door.1:door_frame.1`."""
    lists = document.get("triIndices")
    if not isinstance(lists, dict):
        raise InputError(name, "triIndices", "must be an object with lists of faces", "is it the right file?")
    places: dict[str, list[int]] = {}
    for index, entry in enumerate(listed):
        places.setdefault(entry.name, []).append(index)
    claims: dict[int, list[NDArray[np.int64]]] = {}
    unknown = 0
    notes: list[str] = []
    for key, value in lists.items():
        word = plain_text(key)
        place = places.get(word, places.get(word.partition(":")[0], []))
        if not place:
            unknown += 1
            continue
        faces, unreadable = whole_numbers(value)
        own = faces[(faces >= 0) & (faces < count)]
        lost = unreadable + len(faces) - len(own)
        if lost:
            field = f"{Path(name).name}: triIndices.{word[:60]}"
            notes.append(f"{field}: {counted(lost, 'value')} name no face of the mesh, which has {count}: left out")
        claims.setdefault(place[0], []).append(own)
    owner = np.full(count, -1, dtype=np.int64)
    shared = 0
    claimed = {index: np.unique(np.concatenate(parts)) for index, parts in claims.items()}
    for index in sorted(claimed, key=lambda index: (len(claimed[index]), index)):
        free = claimed[index][owner[claimed[index]] < 0]
        shared += len(claimed[index]) - len(free)
        owner[free] = index
    if unknown:
        notes.append(f"{Path(name).name}: {unknown} of its names are not in the annotation: their faces are nobody's")
    if shared:
        notes.append(f"{shared} faces are claimed by two objects: they stay with the smaller")
    return owner, notes


def _without_removed(
    surface: Surface, owner: NDArray[np.int64], listed: list[AnnotatedObject], name: str
) -> tuple[Surface, NDArray[np.int64]]:  # fmt: skip
    """The mesh without the faces that are marked to be removed, and without the vertices that only these have.

    Raises:
        InputError: nothing is left.
    """
    is_removed = np.array([*(entry.is_removed for entry in listed), False])[owner]  # -1, for nobody's, is the last
    if is_removed.all():
        raise InputError(name, "objects", "every face of the mesh is marked to be removed", "is it the right annotation?")
    if not is_removed.any():
        return surface, owner
    lost = np.setdiff1d(surface.faces[is_removed], surface.faces[~is_removed])
    kept = np.setdiff1d(np.arange(len(surface.vertices)), lost)
    faces = np.searchsorted(kept, surface.faces[~is_removed])
    return Surface(surface.vertices[kept], faces, surface.colors[kept]), owner[~is_removed]


def _groups(listed: list[AnnotatedObject], owner: NDArray[np.int64], surface: Surface, file: str) -> tuple[tuple[Group, ...], list[str]]:
    objects = [(index, entry) for index, entry in enumerate(listed) if not entry.is_removed]
    dense = np.full(len(listed) + 1, -1, dtype=np.int64)
    dense[[index for index, _ in objects]] = np.arange(len(objects))
    groups = groups_of_faces([(entry.source_id, entry.label) for _, entry in objects], dense[owner], surface)
    fields = {entry.source_id: entry.field for _, entry in objects}
    shown = {group.source_id for group in groups}
    notes = [f"{entry.field} ({entry.name}): has no face of the mesh, left out" for _, entry in objects if entry.source_id not in shown]
    own = [Group(g.source_id, g.raw_label, g.vertices, g.faces, f"{file}: {fields[g.source_id]}.label") for g in groups]
    return tuple(own), notes


def _annotations(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    named = (path for path in folder.iterdir() if re.fullmatch(rf"[^.].*{re.escape(ANNOTATION)}", path.name))
    return sorted(path for path in named if not path.is_dir() and _is_scan(folder, path.name.removesuffix(ANNOTATION)))


def _is_scan(folder: Path, stem: str) -> bool:
    """Whether an annotation is one of a scan: others name files so, too, beside scans of other formats."""
    own = (folder / f"{stem}{ending}" for ending in (MESH, SEGMENTS))
    return re.fullmatch(_SCENE, stem) is not None or stem == folder.name or any(os.path.lexists(path) for path in own)


def _annotation(folder: Path) -> Path:
    annotations = _annotations(folder)
    if len(annotations) != 1:
        raise InputError(folder.name, "folder", f"holds {len(annotations)} annotations, one is expected", "give every scan its own folder")
    return annotations[0]


def _recognize(folder: Path) -> str | None:
    return _stem(folder) if _annotations(folder) else None


def _stem(folder: Path) -> str:
    """What the files of a scan begin with: its name."""
    return _annotation(folder).name.removesuffix(ANNOTATION)


def mesh_of(folder: Path) -> Path:
    """Where the mesh of a scan is, or would be. Raises InputError where there is not one annotation."""
    return folder / f"{_stem(folder)}{MESH}"


def _named(scan: Scan, ending: str) -> Path | None:
    """A file of the scan by what it ends with; None where nothing has that name: a link to nothing is to be told, not a scan without it."""
    name = f"{_stem(scan.folder)}{ending}"
    return own_file(scan, name) if os.path.lexists(scan.folder / name) else None


def _files(scan: Scan, premises: Premises) -> list[Path]:
    own = (scan.folder / f"{_stem(scan.folder)}{ending}" for ending in (ANNOTATION, SEGMENTS, MESH))
    return [path for path in own if path.is_file() and premises.admits(path)]


MULTISCAN = ScanFormat(
    name="multiscan",
    dataset="multiscan",
    expected=f"<scan>{ANNOTATION}, with <scan>{MESH}",
    recognize=_recognize,
    is_recorded=lambda folder: bool(_annotations(folder)),
    files=_files,
    read=read_multiscan,
    unread=("scene_*.ply", "scene_*.obj", "textured_mesh/*.obj"),
    signs=(f"*{ANNOTATION}", f"*{SEGMENTS}"),
    room=r"(.*/scene_\d{5})_\d{2}",  # rescans are scene_00000_00, scene_00000_01
)
