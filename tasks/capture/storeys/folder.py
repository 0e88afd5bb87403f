"""A storey on disk, in a format that is read: what names instances as ScanNet lays it out, frames alone as a folder of posed RGB-D, drawn
scenes and bare meshes as they were."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.files import read_file
from tasks.capture.files.lenses import DEPTH_SCALE
from tasks.capture.reading import FrameSource, Group, Reading
from tasks.geometry.meshes import dump_glb
from tasks.scanner.folder import png, write_mesh

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

_KEPT = (".jpg", ".jpeg", ".png")
"""Color images that are copied as they are."""

_LENS_PX = 0.01
"""Lenses of a scan that differ by less are one."""

StoreyLayout = Literal["frames", "mesh", "nodes", "instances"]
"""Of the folders of storeys: posed frames alone, a bare PLY, a GLB, or as ScanNet lays out a mesh with instances or frames."""


def layout_of(storeys: Sequence[Reading], is_ply: bool) -> StoreyLayout:
    """The layout that all storeys of a scan have, also those that have none of what others of them have: beside a folder of instances or
    frames, a bare mesh would be taken for what is left over of one. is_ply: Bare meshes are written as PLY, else as GLB."""
    if any(storey.surface is None for storey in storeys):
        return "frames"
    has_frames = any(storey.frames for storey in storeys)
    if is_ply and not has_frames and all(storey.groups is None for storey in storeys):
        return "mesh"
    if any(storey.parts for storey in storeys) or not (has_frames or any(storey.groups for storey in storeys)):
        return "nodes"
    return "instances"


def write_storey(folder: Path, storey: Reading, scan: Path, layout: StoreyLayout, to_level: Array) -> None:
    """Write a storey as the folder of a scan, whose name is the scan's.

    storey: Its frames have one lens. scan: Folder that its frames are read from. layout: Of all storeys of the scan. to_level: Scan frame
    to the level of the storey, 4x4 [m], which is stated where the format can.

    Raises:
        InputError: a frame cannot be read.
    """
    name, surface = folder.name, storey.surface
    folder.mkdir(parents=True)
    if storey.license:
        (folder / "LICENSE.txt").write_text(storey.license + "\n")
    if surface is None:
        _write_frames(folder, storey.frames, scan)
    elif layout == "mesh":
        write_mesh(folder / f"{name}.ply", surface)
    elif layout == "nodes":
        parts: Sequence[trimesh.Trimesh] = storey.parts or (surface.to_trimesh(),)
        names = [str(part.metadata["name"]) for part in parts] if storey.parts else ["scan_0"]
        (folder / f"{name}.glb").write_bytes(dump_glb(parts, names))
    else:
        write_mesh(folder / f"{name}_vh_clean_2.ply", surface)
        (folder / f"{name}.txt").write_text(_metadata(storey, to_level))
        if storey.groups is not None:
            _write_instances(folder, name, storey.groups, len(surface.vertices))
        if storey.frames:
            _write_frames(folder, storey.frames, scan)


def is_of_one_lens(frames: Sequence[FrameSource]) -> bool:
    """Whether the folder of a storey can state the lens of its frames, which is one for all."""
    lenses = np.array([[*frame.intrinsics, *frame.depth_intrinsics] for frame in frames])
    return not len(frames) or float(np.ptp(lenses, axis=0).max()) <= _LENS_PX


def _metadata(storey: Reading, to_level: Array) -> str:
    lines = [f"axisAlignment = {' '.join(f'{value:.17g}' for value in to_level.ravel())}"]
    lines += [f"sceneType = {storey.room_type}"] if storey.room_type else []
    return "\n".join(lines) + "\n"


def _write_instances(folder: Path, name: str, groups: Sequence[Group], count: int) -> None:
    """A segment for each instance, and one that is none's; instances keep their numbers."""
    segments = np.full(count, len(groups), dtype=np.int64)
    for number, group in enumerate(groups):
        segments[group.vertices] = number
    listed: list[dict[str, Any]] = []
    taken = {int(group.source_id) for group in groups if _is_number(group.source_id)}
    for number, group in enumerate(groups):
        own = int(group.source_id) if _is_number(group.source_id) else max(taken, default=-1) + 1
        taken.add(own)
        listed.append({"id": number, "objectId": own, "segments": [number], "label": group.raw_label})
    segments_file = f"{name}_vh_clean_2.0.010000.segs.json"
    (folder / segments_file).write_text(json.dumps({"sceneId": name, "segIndices": segments.tolist()}))
    document = {"sceneId": name, "segGroups": listed, "segmentsFile": segments_file}
    (folder / f"{name}.aggregation.json").write_text(json.dumps(document))


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 19


def _write_frames(folder: Path, frames: Sequence[FrameSource], scan: Path) -> None:
    """`color`, `depth`, `pose`, `intrinsics.json` and the lens of the depth. Files are called by the ids of the frames."""
    for part in ("color", "depth", "pose", "intrinsic"):
        (folder / part).mkdir()
    lens = frames[0]
    scale = lens.depth_scale if lens.depth_scale >= DEPTH_SCALE else DEPTH_SCALE
    (fx, fy, cx, cy), (dx, dy, ex, ey) = lens.intrinsics, lens.depth_intrinsics
    stated = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": lens.width, "height": lens.height, "depth_scale": scale}
    (folder / "intrinsics.json").write_text(json.dumps(stated | {"pose_format": "camera-to-world, OpenCV"}, indent=1) + "\n")
    matrix = np.array([[dx, 0.0, ex, 0.0], [0.0, dy, ey, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    (folder / "intrinsic" / "intrinsic_depth.txt").write_text(_matrix_text(matrix))
    for frame in frames:
        path = scan / frame.color_file
        is_kept = path.suffix.lower() in _KEPT and path.is_file()
        color = read_file(path, frame.color_file, BUDGET.image_bytes) if is_kept else png(frame.color())
        (folder / "color" / f"{frame.frame_id}{path.suffix.lower() if is_kept else '.png'}").write_bytes(color)
        if frame.depth is not None:
            units = np.round(frame.depth().astype(np.float64) * scale).clip(0, 65535).astype(np.uint16)
            (folder / "depth" / f"{frame.frame_id}.png").write_bytes(png(units))
        if frame.pose is not None:
            (folder / "pose" / f"{frame.frame_id}.txt").write_text(_matrix_text(frame.pose))


def _matrix_text(matrix: Array) -> str:
    return "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in matrix)
