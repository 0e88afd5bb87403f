"""What a region of Matterport3D lacks while it is being copied."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.matterport3d import ANNOTATION, MATTERPORT3D, SEGMENTS
from tasks.capture.scan import Scan
from tasks.capture.wholeness import Gap, file_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    files = {path.name: path for path in MATTERPORT3D.files(scan, scan.premises)}
    segments, annotation = (f"{scan.path.stem}{ending}" for ending in (SEGMENTS, ANNOTATION))
    if scan.path.name not in files:
        yield Gap(f"{scan.path.name}: is missing")
    if annotation in files and segments not in files:
        yield Gap(f"{segments}: is missing")
    if annotation not in files:
        yield Gap(f"{annotation}: is missing", is_readable=True)
    for path in files.values():
        yield from file_gaps(path, scan.folder)
