"""The ScanNet format, in all the variants in which its scans are found.

Aggregation under either of its two names, with or without axis alignment, with or without the dataset's prefix in
ids, frames in a `.sens` container, exported to folders, or absent.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.aggregation import vertex_groups
from tasks.capture.consistency.findings import Statements, settled
from tasks.capture.files.documents import floats, integers, license_of, name_of, read_json, read_text, settings
from tasks.capture.files.frames import exported_frames, frame_statements, sens_frames
from tasks.capture.files.ply import read_ply
from tasks.capture.premises import Premises
from tasks.capture.reading import FrameSource, Group, Reading
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
    frames, findings = settled(frames, _statements(layout, folder))
    degradations += notes + findings
    surface, groups = None, None
    if layout.mesh is None:
        if not frames:
            raise InputError(folder.name, f"{layout.scan}_vh_clean_2.ply", "there is no mesh and no frame to make one of", "copy the mesh")
        degradations.append("no mesh in the scan: fused from its frames")
    elif layout.aggregation is None:
        ply = read_ply(layout.mesh, name_of(layout.mesh, folder))
        surface = ply.surface
        degradations += ply.notes
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


def _statements(layout: ScanNetLayout, folder: Path) -> Statements:
    has_mesh = layout.mesh is not None
    if layout.frames is None:
        container = name_of(layout.sens, folder) if layout.sens is not None else folder.name
        return Statements(container, container, container, has_mesh=has_mesh)
    return frame_statements(layout.frames, folder, is_open=False, has_mesh=has_mesh)


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
    ply = read_ply(mesh, name_of(mesh, folder))
    surface = ply.surface
    segmented = name_of(segments, folder)
    of_vertex = integers(read_json(segments, segmented).get("segIndices"), segmented, "segIndices", minimum=-(2**62))
    if len(of_vertex) != len(surface.vertices):
        problem = f"has {len(of_vertex)} values, the mesh {mesh.name} has {len(surface.vertices)} vertices"
        raise InputError(segmented, "segIndices", problem, "use segments and mesh of one and the same scan")
    groups, notes = vertex_groups(document, aggregated, of_vertex, segmented, surface)
    return surface, groups, [*ply.notes, *notes]


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
    unread=("*_vh_clean*.ply",),
    signs=("*_vh_clean_2.ply", "*.segs.json", "*.aggregation.json"),
    room=r"(.*/scene\d{4})_\d{2}",  # rescans are scene0001_00, scene0001_01
)
