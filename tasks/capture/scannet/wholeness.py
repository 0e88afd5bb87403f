"""What a ScanNet scan lacks while it is being copied."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from schemas.budget import BUDGET
from schemas.files import open_file
from schemas.parsing import json_value
from tasks.capture.files.documents import MAX_JSON_BYTES, name_of
from tasks.capture.scan import Scan
from tasks.capture.scannet.layout import scannet_layout
from tasks.capture.wholeness import HEADER_BYTES, Gap, content, file_gaps, frame_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    layout = scannet_layout(scan.path, scan.premises)
    if layout is None:
        yield Gap(f"{scan.path.name}: holds no ScanNet scan any more")
        return
    if layout.mesh is None and layout.sens is None and layout.frames is None:
        yield Gap(f"{layout.scan}_vh_clean_2.ply: is missing")
    if layout.aggregation is not None and not layout.segments:
        yield Gap(f"{layout.scan}_vh_clean_2.0.010000.segs.json: is missing")
    if layout.aggregation is not None and layout.mesh is None:
        yield Gap(f"{layout.scan}_vh_clean_2.ply: is missing")
    if layout.segments and layout.aggregation is None:
        yield Gap(f"{layout.scan}.aggregation.json: is missing", is_readable=True)
    for path in (layout.metadata, layout.aggregation, layout.sens, *layout.meshes, *layout.segments):
        if path is not None:
            yield from file_gaps(path, scan.path)
    yield from _counted(layout.meshes, layout.segments, scan.path)
    if layout.frames is not None:
        yield from frame_gaps(layout.frames, scan.path, stated=layout.metadata is not None)


def _counted(meshes: tuple[Path, ...], segments: tuple[Path, ...], folder: Path) -> Iterator[Gap]:
    """Segments that index another number of vertices than their mesh has: one of both is of an older copy."""
    for path in segments:
        own = folder / f"{re.sub(r'([.][0-9]+[.][0-9]+)?[.]segs[.]json$', '', path.name)}.ply"
        if own not in meshes:
            continue
        with open_file(own, own.name, BUDGET.scene_bytes) as file:
            head = file.read(HEADER_BYTES)
        declared = re.search(rb"element vertex ([0-9]{1,18})\s", head)
        try:
            indices = json_value(content(path, MAX_JSON_BYTES)).get("segIndices")
        except (ValueError, AttributeError):
            continue
        if declared and isinstance(indices, list) and len(indices) != int(declared[1]):
            what = f"{name_of(path, folder)}: has {len(indices)} values for the {int(declared[1])} vertices of {own.name}"
            yield Gap(what, is_readable=True)
