"""What a scan of 3RScan lacks while it is being copied."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from tasks.capture.layout import frame_layout
from tasks.capture.scan import Scan
from tasks.capture.threerscan import ANNOTATION, ARCHIVE, CAMERA, LABELLED, MESH, SEQUENCE, THREERSCAN
from tasks.capture.wholeness import Gap, file_gaps, frame_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    folder = scan.path
    files = [path for path in THREERSCAN.files(scan, scan.premises) if path.is_relative_to(folder)]
    names = {path.name for path in files}
    if not names & {*LABELLED, *MESH}:
        yield Gap(f"{LABELLED[0]}: is missing")
    if names & set(LABELLED) and not names & set(ANNOTATION):
        yield Gap(f"{ANNOTATION[0]}: is missing", is_readable=bool(names & set(MESH)))
    if not names & set(ANNOTATION):
        yield Gap(f"{ANNOTATION[0]}: is missing", is_readable=True)
    if (folder / ARCHIVE).is_file() and not (folder / SEQUENCE).is_dir():
        yield Gap(f"{SEQUENCE}: is missing", is_readable=True)
    layout = frame_layout(folder / SEQUENCE, scan.premises) if (folder / SEQUENCE).is_dir() else None
    if layout is not None and layout.folder / CAMERA in files:
        layout = dataclasses.replace(layout, color_intrinsics=layout.folder / CAMERA)
    for path in files:
        if layout is None or path not in layout.files:
            yield from file_gaps(path, folder)
    if layout is not None:
        yield from frame_gaps(layout, folder, stated=True)
