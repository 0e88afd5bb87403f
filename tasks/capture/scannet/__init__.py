"""The ScanNet format, in all the variants in which its scans are found.

Aggregation under either of its two names, with or without axis alignment, with or without the dataset's prefix in
ids, frames in a `.sens` container, exported to folders, or absent.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import floats, integers, license_of, name_of, read_json, read_text, settings
from tasks.capture.files.frames import exported_frames, sens_frames
from tasks.capture.files.ply import read_ply
from tasks.capture.premises import Premises
from tasks.capture.reading import FrameSource, Group, Reading, groups_of
from tasks.capture.scan import Scan, ScanFormat, license_path
from tasks.capture.scannet.layout import ScanNetLayout, scannet_layout
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import is_rigid, nearest_rigid

_RIGID_TOLERANCE = 1e-2
"""Alignments are written with six digits; a rotation off by more than this was never one."""


def read_scannet(scan: Scan) -> Reading:
    """Everything that a ScanNet scan states.

    Raises:
        InputError: a file is missing, cut, or contradicts another.
    """
    folder = scan.path
    layout = scannet_layout(folder, scan.premises)
    if layout is None:
        raise InputError(folder.name, "folder", "holds no ScanNet scan", "expected <scan>_vh_clean_2.ply or <scan>.sens")
    stated = settings(read_text(layout.metadata, name_of(layout.metadata, folder))) if layout.metadata else {}
    degradations: list[str] = []
    frames, notes = _frames(layout, folder, stated)
    degradations += notes
    surface, groups = None, None
    if layout.mesh is None:
        if not frames:
            raise InputError(folder.name, f"{layout.scan}_vh_clean_2.ply", "there is no mesh and no frame to make one of", "copy the mesh")
        degradations.append("no mesh in the scan: fused from its frames")
    elif layout.aggregation is None:
        surface = read_ply(layout.mesh, name_of(layout.mesh, folder))
        degradations.append("no aggregation in the scan: instances found in its geometry")
    else:
        surface, groups, notes = _segmented(layout, folder, layout.aggregation)
        degradations += notes
    if not frames:
        degradations.append("no frames in the scan: no views, no masks")
    return Reading(
        surface=surface,
        parts=(),
        groups=groups,
        frames=frames,
        alignment=_alignment(stated, layout, folder),
        room_type=_room_type(stated.get("sceneType", "")),
        license=license_of(license_path(folder, scan.premises)),
        is_dense=True,
        degradations=tuple(degradations),
    )


def _room_type(stated: str) -> str:
    """`Bedroom / Hotel` is a bedroom; `Misc.` says nothing."""
    text = " ".join(stated.partition(" / ")[0].lower().split())[:100]
    return "" if text in ("misc.", "misc") else text


def _frames(layout: ScanNetLayout, folder: Path, stated: dict[str, str]) -> tuple[tuple[FrameSource, ...], list[str]]:
    if layout.frames is not None:
        return exported_frames(layout.frames, folder, stated)
    if layout.sens is not None:
        return sens_frames(layout.sens, folder)
    return (), []


def _alignment(stated: dict[str, str], layout: ScanNetLayout, folder: Path) -> NDArray[np.float64] | None:
    """The stated axis alignment, None where there is none."""
    if "axisAlignment" not in stated or layout.metadata is None:
        return None
    name = name_of(layout.metadata, folder)
    matrix = floats(stated["axisAlignment"], name, "axisAlignment", 16).reshape(4, 4)
    remedy = "remove the line to have it estimated"
    if not np.isfinite(matrix).all():
        raise InputError(name, "axisAlignment", "has numbers that are not finite", remedy)
    determinant = float(np.linalg.det(matrix[:3, :3]))
    if abs(determinant) < 1e-6:
        raise InputError(name, "axisAlignment", "is singular", remedy)
    if not is_rigid(matrix, _RIGID_TOLERANCE):
        raise InputError(name, "axisAlignment", f"is no rotation and translation (determinant {determinant:.3g})", remedy)
    if np.abs(matrix[:3, 3]).max() > 10_000:
        raise InputError(name, "axisAlignment", "moves the scan by more than 10 km", remedy)
    return nearest_rigid(matrix)


def _segmented(layout: ScanNetLayout, folder: Path, aggregation: Path) -> tuple[Surface, tuple[Group, ...], list[str]]:
    """The mesh, its instances from segments and aggregation, and what was odd about them."""
    aggregated = name_of(aggregation, folder)
    document = read_json(aggregation, aggregated)
    segments, mesh = _pair(layout, folder, document, aggregated)
    surface = read_ply(mesh, name_of(mesh, folder))
    segmented = name_of(segments, folder)
    of_vertex = integers(read_json(segments, segmented).get("segIndices"), segmented, "segIndices", minimum=-(2**62))
    if len(of_vertex) != len(surface.vertices):
        problem = f"has {len(of_vertex)} values, the mesh {mesh.name} has {len(surface.vertices)} vertices"
        raise InputError(segmented, "segIndices", problem, "use segments and mesh of one and the same scan")
    groups, notes = _groups(document, aggregated, of_vertex, segmented, surface)
    return surface, groups, notes


def _pair(layout: ScanNetLayout, folder: Path, document: dict[str, Any], name: str) -> tuple[Path, Path]:
    """The segments that the aggregation speaks of, and the mesh that they index."""
    if not layout.segments:
        raise InputError(folder.name, f"{layout.scan}_vh_clean_2.0.010000.segs.json", "is missing", "copy the segments beside the mesh")
    by_name = {path.name: path for path in layout.segments}
    segments = by_name.get(f"{layout.scan}_vh_clean_2.0.010000.segs.json", layout.segments[0])
    for field in ("segmentsFile", "segmentsId"):
        if document.get(field) not in (None, ""):
            segments = _named_segments(document[field], by_name, name, field)
    stem = re.sub(r"(\.\d+\.\d+)?\.segs\.json$", "", segments.name)
    mesh = folder / f"{stem}.ply"
    if mesh in layout.meshes:
        return segments, mesh
    if layout.mesh is None:
        raise InputError(folder.name, f"{stem}.ply", "is missing", "copy the mesh that the segments index")
    return segments, layout.mesh


def _named_segments(stated: Any, by_name: dict[str, Path], name: str, field: str) -> Path:
    """The file that an aggregation names, with or without a dataset's prefix: `scannet.scene0000_00_vh_clean.segs.json`."""
    if not isinstance(stated, str):
        raise InputError(name, field, "is no file name", "is it the right file?")
    if "/" in stated or "\\" in stated:
        raise InputError(name, field, f"{stated!r:.100} is a path, not a file name", "give the name of a .segs.json beside the aggregation")
    for key, path in by_name.items():
        if stated == key or stated.endswith(f".{key}"):
            return path
    problem = f"names {stated!r:.100}, the scan has {', '.join(by_name)}"
    raise InputError(name, field, problem, "use aggregation and segments of one and the same scan")


def _groups(
    document: dict[str, Any], name: str, of_vertex: NDArray[np.int64], segmented: str, surface: Surface
) -> tuple[tuple[Group, ...], list[str]]:
    """Instances of the aggregation, in its order."""
    listed = document.get("segGroups")
    if not isinstance(listed, list):
        raise InputError(name, "segGroups", "must be a list of instances", "is it the right file?")
    segments, dense = np.unique(of_vertex, return_inverse=True)
    order = np.argsort(dense, kind="stable")
    starts = np.searchsorted(dense[order], np.arange(len(segments) + 1))
    owner = np.full(len(of_vertex), -1, dtype=np.int64)
    named_groups: list[tuple[str, str, NDArray[np.int64]]] = []
    origins: list[str] = []
    notes: list[str] = []
    seen: set[int] = set()
    shared = 0
    for index, entry in enumerate(listed):
        object_id, label, ids = _group(entry, name, f"segGroups[{index}]")
        if object_id in seen:
            raise InputError(name, f"segGroups[{index}].objectId", f"{object_id} names two instances", "give every instance its own number")
        seen.add(object_id)
        places = np.minimum(np.searchsorted(segments, ids), len(segments) - 1)
        missing = ids[segments[places] != ids]
        if len(missing):
            problem = f"names segment {missing[0]}, which {Path(segmented).name} does not have"
            raise InputError(name, f"segGroups[{index}].segments", problem, "use aggregation and segments of one and the same scan")
        vertices = np.sort(np.concatenate([order[starts[p] : starts[p + 1]] for p in np.unique(places)])) if len(ids) else ids
        # A segment that an earlier instance has stays with it: a vertex belongs to one instance.
        free = vertices[owner[vertices] < 0]
        shared += len(vertices) - len(free)
        owner[free] = len(named_groups)
        if len(free):
            named_groups.append((str(object_id), label, free))
            origins.append(f"{Path(name).name}: segGroups[{index}].label")
        else:
            notes.append(f"instance {object_id} ({label}): has no vertices of its own, left out")
    if shared:
        notes.append(f"{shared} vertices are claimed by two instances: they stay with the first")
    groups = groups_of(named_groups, owner, surface)
    return tuple(dataclasses.replace(group, origin=origin) for group, origin in zip(groups, origins, strict=True)), notes


def _group(entry: Any, name: str, field: str) -> tuple[int, str, NDArray[np.int64]]:
    if not isinstance(entry, dict):
        raise InputError(name, field, "must be an object", "is it the right file?")
    object_id = entry.get("objectId", entry.get("id"))
    if not isinstance(object_id, int) or isinstance(object_id, bool) or not 0 <= object_id < 2**62:
        raise InputError(name, f"{field}.objectId", "must be a number from 0", "is it the right file?")
    label = entry.get("label", "")
    if not isinstance(label, str):
        raise InputError(name, f"{field}.label", "must be a text", "is it the right file?")
    ids = integers(entry.get("segments"), name, f"{field}.segments", minimum=-(2**62))
    # A byte that is no UTF-8 cannot come from JSON, a lone surrogate can.
    return object_id, " ".join(label.encode("utf-8", "replace").decode().split())[:200], ids


def _recognize(folder: Path) -> str | None:
    layout = scannet_layout(folder)
    return layout.scan if layout is not None else None


def _files(scan: Scan, premises: Premises) -> list[Path]:
    layout = scannet_layout(scan.folder, premises)
    return layout.files if layout is not None else []


SCANNET = ScanFormat(
    name="scannet",
    dataset="scannet",
    expected="<scan>_vh_clean_2.ply, .segs.json and .aggregation.json, or <scan>.sens",
    recognize=_recognize,
    is_recorded=lambda folder: _recognize(folder) is not None,
    files=_files,
    read=read_scannet,
    room=r"(.*/scene\d{4})_\d{2}",  # rescans are scene0001_00, scene0001_01
)
