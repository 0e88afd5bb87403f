"""3RScan: the mesh of a scan with the instance of each vertex, the instances' labels, frames where they were unpacked, and which scans
are of one room.

Written from the public description of the data set.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.capture.aggregation import vertex_groups
from tasks.capture.consistency.findings import Statements, settled
from tasks.capture.files.annotated_rows import labels_by_number
from tasks.capture.files.documents import integers, license_of, name_of, plain_text, read_bytes, read_json, read_text, settings
from tasks.capture.files.frames import exported_frames
from tasks.capture.files.images import image_size, read_color
from tasks.capture.files.obj import read_obj
from tasks.capture.files.ply import read_labelled_ply
from tasks.capture.layout import FrameLayout, frame_layout
from tasks.capture.premises import Premises
from tasks.capture.reading import FrameSource, Group, Reading, groups_of
from tasks.capture.scan import Scan, ScanFormat, license_path
from tasks.geometry.meshes import Surface

LABELLED = ("labels.instances.annotated.v2.ply", "labels.instances.annotated.ply")
MESH = ("mesh.refined.v2.obj", "mesh.refined.obj")
SEGMENTS = ("mesh.refined.0.010000.segs.v2.json", "mesh.refined.0.010000.segs.json")
ANNOTATION = ("semseg.v2.json", "semseg.json")
"""Files of the second release and of the first."""

TEXTURE, SEQUENCE, ARCHIVE, CAMERA, ROOMS = "mesh.refined_0.png", "sequence", "sequence.zip", "_info.txt", "3RScan.json"


def read_threerscan(scan: Scan) -> Reading:
    """The mesh, its instances, and the frames of an unpacked sequence. Without an annotation, instances are found in the geometry.

    Raises:
        InputError: a file is missing or broken, or two do not fit together.
    """
    folder = scan.path
    files = {path.relative_to(folder).as_posix(): path for path in _files(scan, scan.premises) if path.is_relative_to(folder)}
    labelled, mesh, segments, annotation = (_first(files, names) for names in (LABELLED, MESH, SEGMENTS, ANNOTATION))
    notes: list[str] = []
    colored = None
    if mesh is not None:
        colored, unread = _colored(mesh, files.get(TEXTURE), folder)
        notes += unread
    document = read_json(annotation, name_of(annotation, folder)) if annotation is not None else None
    groups: tuple[Group, ...] | None = None
    if annotation is not None and document is not None and labelled is not None:
        ply = read_labelled_ply(labelled, name_of(labelled, folder), "vertex", "objectId")
        surface = _painted(ply.surface, colored)
        groups, more = _labelled_groups(document, name_of(annotation, folder), ply.labels, surface)
        notes += [*ply.notes, *more]
    elif colored is not None:
        surface = colored
        if annotation is not None and document is not None and segments is not None:
            groups, more = _segmented_groups(document, name_of(annotation, folder), segments, folder, surface)
            notes += more
    else:
        raise InputError(folder.name, LABELLED[0], f"there is neither this with {ANNOTATION[0]} nor {MESH[0]}", "copy them")
    if groups is None:
        notes.append("no annotation in the scan: instances found in its geometry")
    if colored is None:
        notes.append(f"no {MESH[0]} in the scan: its mesh has no colors")
    frames, more = _frames(scan)
    notes += more
    license = license_of(license_path(folder, scan.premises))
    return Reading(surface=surface, groups=groups, frames=frames, license=license, degradations=tuple(notes))


def _colored(mesh: Path, texture: Path | None, folder: Path) -> tuple[Surface, tuple[str, ...]]:
    """The textured mesh, and parts of its file that are not read, a line each."""
    image = None
    if texture is not None:
        name = name_of(texture, folder)
        image = read_color(texture, name, image_size(texture, name))
    return read_obj(mesh, name_of(mesh, folder), image)


def _painted(surface: Surface, colored: Surface | None) -> Surface:
    """The labelled mesh, whose own colors tell instances apart, with those of the textured one: vertex by vertex, or of the
    nearest where they are others."""
    from scipy.spatial import cKDTree

    if colored is None:
        return dataclasses.replace(surface, colors=np.full_like(surface.colors, 180))
    if colored.vertices.shape == surface.vertices.shape and np.abs(colored.vertices - surface.vertices).max() < _SAME_M:
        return dataclasses.replace(surface, colors=colored.colors)
    nearest = cKDTree(colored.vertices).query(surface.vertices)[1]
    return dataclasses.replace(surface, colors=colored.colors[nearest])


_SAME_M = 1e-3
"""Both files have the vertices in one order, up to the digits that they are written with [m]."""


def _labelled_groups(
    document: dict[str, Any], name: str, object_of_vertex: NDArray[np.int64], surface: Surface
) -> tuple[tuple[Group, ...], list[str]]:
    """Instances by the number that each vertex has; 0, and numbers that the annotation lacks, are nobody's. And notes on wrong rows."""
    listed = document.get("segGroups")
    if not isinstance(listed, list):
        raise InputError(name, "segGroups", "must be a list of instances", "is it the right file?")
    file = Path(name).name
    labels, notes = labels_by_number(listed, file, "segGroups", minimum=1)
    present, dense = np.unique(object_of_vertex, return_inverse=True)
    numbers = [int(number) for number in present if int(number) in labels]
    index_of = {number: index for index, number in enumerate(numbers)}
    owner = np.array([index_of.get(int(number), -1) for number in present], dtype=np.int64)[dense]
    named = [(str(number), labels[number][0], np.flatnonzero(owner == index)) for index, number in enumerate(numbers)]
    groups = tuple(
        dataclasses.replace(group, origin=f"{file}: segGroups[{labels[number][1]}].label")
        for group, number in zip(groups_of(named, owner, surface), numbers, strict=True)
    )
    return groups, notes


def _segmented_groups(
    document: dict[str, Any], annotated: str, segments: Path, folder: Path, surface: Surface
) -> tuple[tuple[Group, ...], list[str]]:
    segmented = name_of(segments, folder)
    of_vertex = integers(read_json(segments, segmented).get("segIndices"), segmented, "segIndices", minimum=-(2**62))
    if len(of_vertex) != len(surface.vertices):
        problem = f"has {len(of_vertex)} values, the mesh has {len(surface.vertices)} vertices"
        raise InputError(segmented, "segIndices", problem, "use segments and mesh of one and the same scan")
    return vertex_groups(document, annotated, of_vertex, segmented, surface)


def _frames(scan: Scan) -> tuple[tuple[FrameSource, ...], list[str]]:
    """Frames of `sequence`, whose camera `_info.txt` describes."""
    folder = scan.path
    layout = _layout(folder, scan.premises)
    if layout is None:
        is_packed = (folder / ARCHIVE).is_file()
        packed = f"; {ARCHIVE} is not read: unzip {ARCHIVE} -d {SEQUENCE}" if is_packed else ""
        return (), [f"no frames in the scan: no views, no masks{packed}"]
    info = layout.folder / CAMERA
    stated = _camera(info, name_of(info, folder)) if info.is_file() and scan.premises.admits(info) else {}
    frames, notes = exported_frames(layout, folder, stated)
    place = name_of(layout.folder, folder)
    frames, findings = settled(frames, Statements(place, f"{place}/{CAMERA}", f"{place}/{CAMERA}", has_mesh=True))
    return frames, notes + findings


def _camera(path: Path, name: str) -> dict[str, str]:
    """Sizes and intrinsics as ScanNet's metadata calls them."""
    read = settings(read_text(path, name))
    stated = {f"{word}{side}": read.get(f"m_{word}{side}", "") for word in ("color", "depth") for side in ("Width", "Height")}
    for word in ("Color", "Depth"):
        numbers = read.get(f"m_calibration{word}Intrinsic", "").split()
        if len(numbers) == 16:
            keys = {"fx": 0, "fy": 5, "mx": 2, "my": 6}
            stated |= {f"{key}_{word.lower()}": numbers[at] for key, at in keys.items()}
    return stated


def _layout(folder: Path, premises: Premises) -> FrameLayout | None:
    place = folder / SEQUENCE
    return frame_layout(place, premises) if place.is_dir() and premises.admits(place) else None


def _room(scan: Scan) -> str | None:
    """Name of the first scan of the room, as `3RScan.json` beside the scan or above it says."""
    for path in (scan.path / ROOMS, scan.path.parent / ROOMS):
        if path.is_file() and scan.premises.admits(path):
            try:
                listed = json_value(read_bytes(path, path.name, BUDGET.json_bytes))
            except ValueError as error:
                raise InputError(path.name, "content", f"is no JSON ({error})", "copy it again, or take it away") from error
            for entry in listed if isinstance(listed, list) else []:
                if not isinstance(entry, dict) or not isinstance(entry.get("reference"), str):
                    continue  # a room of another scan, or none that can be named
                rescans = entry.get("scans")
                again = [other.get("reference") for other in rescans if isinstance(other, dict)] if isinstance(rescans, list) else []
                if scan.path.name in (entry["reference"], *again):
                    return plain_text(entry["reference"]) or None
            return None
    return None


def _first(files: dict[str, Path], names: tuple[str, ...]) -> Path | None:
    return next((files[name] for name in names if name in files), None)


def _is_scan(folder: Path) -> bool:
    return any((folder / name).is_file() or (folder / name).is_symlink() for name in (*LABELLED, *MESH))


def _files(scan: Scan, premises: Premises) -> list[Path]:
    folder = scan.folder
    layout = _layout(folder, premises)
    files = [folder / name for name in (*LABELLED, *MESH, *SEGMENTS, *ANNOTATION, TEXTURE, ROOMS)]
    files += [folder.parent / ROOMS]
    files += [*layout.files, layout.folder / CAMERA] if layout is not None else []
    return [path for path in files if path.is_file() and premises.admits(path)]


THREERSCAN = ScanFormat(
    name="threerscan",
    dataset="3rscan",
    expected=f"{LABELLED[0]} and {ANNOTATION[0]}, or {MESH[0]}",
    recognize=lambda folder: folder.name if _is_scan(folder) else None,
    is_recorded=_is_scan,
    files=_files,
    read=read_threerscan,
    unread=("mesh.refined*.obj", "labels.instances*.ply"),
    signs=(LABELLED[0], ANNOTATION[0], SEGMENTS[0]),
    room_stated=_room,
    shared=True,
)
