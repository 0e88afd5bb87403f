"""ScanNet++: the mesh that its annotations are on, its segments, and the labels of its instances.

Written from the public description of the data set. Images lie in videos and archives of their own and are not read.
"""

from __future__ import annotations

from pathlib import Path

from schemas.errors import InputError
from tasks.capture.aggregation import vertex_groups
from tasks.capture.files.documents import integers, license_of, name_of, read_json
from tasks.capture.files.ply import read_ply
from tasks.capture.layout import folders_in
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, leaving, license_path

PLACE = "scans"
"""Folder of a scene that has its mesh."""

MESH, SEGMENTS, ANNOTATION = "mesh_aligned_0.05.ply", "segments.json", "segments_anno.json"


def read_scannetpp(scan: Scan) -> Reading:
    """The mesh, and the instances of its annotation; where it has none, they are found in its geometry.

    Raises:
        InputError: a file is missing or broken, or segments and mesh do not fit together.
    """
    folder, place = scan.path, _place(scan.path)
    files = [path for path in _files(scan, scan.premises) if path.parent == place]
    by_name = {path.name: path for path in files}
    if MESH not in by_name:
        raise leaving(place / MESH) if (place / MESH).is_symlink() else InputError(folder.name, MESH, "is missing", "copy the mesh")
    mesh = read_ply(by_name[MESH], name_of(by_name[MESH], folder))
    surface = mesh.surface
    notes = [*mesh.notes, "no frames are read from this format: no views, no masks"]
    groups = None
    if ANNOTATION in by_name:
        if SEGMENTS not in by_name:
            raise InputError(name_of(place / SEGMENTS, folder), "file", "is missing", "copy the segments beside the annotation")
        segmented, annotated = (name_of(by_name[name], folder) for name in (SEGMENTS, ANNOTATION))
        of_vertex = integers(read_json(by_name[SEGMENTS], segmented).get("segIndices"), segmented, "segIndices", minimum=-(2**62))
        if len(of_vertex) != len(surface.vertices):
            problem = f"has {len(of_vertex)} values, the mesh {MESH} has {len(surface.vertices)} vertices"
            raise InputError(segmented, "segIndices", problem, "use segments and mesh of one and the same scan")
        document = read_json(by_name[ANNOTATION], annotated)
        groups, more = vertex_groups(document, annotated, of_vertex, segmented, surface)
        notes += more
    else:
        notes.append(f"no {ANNOTATION} in the scan: instances found in its geometry")
    return Reading(surface=surface, groups=groups, license=license_of(license_path(folder, scan.premises)), degradations=tuple(notes))


def _place(folder: Path) -> Path:
    """The folder that the mesh lies in: `scans` of a scene's folder, or the scene's folder itself."""
    return folder / PLACE if (folder / PLACE).is_dir() else folder


def _has_mesh(folder: Path) -> bool:
    path = _place(folder) / MESH
    return path.is_file() or path.is_symlink()


def _files(scan: Scan, premises: Premises) -> list[Path]:
    place = _place(scan.folder)
    if not premises.admits(place):
        return []
    return [path for path in (place / MESH, place / SEGMENTS, place / ANNOTATION) if path.is_file() and premises.admits(path)]


SCANNETPP = ScanFormat(
    name="scannetpp",
    dataset="scannetpp",
    expected=f"{PLACE}/{MESH} with {SEGMENTS} and {ANNOTATION}",
    recognize=lambda folder: folder.name if _has_mesh(folder) else None,
    is_recorded=lambda folder: _has_mesh(folder) or any(map(_has_mesh, folders_in(folder))),
    files=_files,
    read=read_scannetpp,
    unread=("scans/*.ply", "iphone", "dslr", "panocam"),
    signs=(f"{PLACE}/{MESH}", f"{PLACE}/{SEGMENTS}", f"{PLACE}/{ANNOTATION}"),
)
