"""What a ScanNet++ scan lacks while it is being copied."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.scan import Scan
from tasks.capture.scannetpp import ANNOTATION, MESH, SCANNETPP, SEGMENTS
from tasks.capture.wholeness import Gap, file_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    files = {path.name: path for path in SCANNETPP.files(scan, scan.premises)}
    if MESH not in files:
        yield Gap(f"{MESH}: is missing")
    if ANNOTATION in files and SEGMENTS not in files:
        yield Gap(f"{SEGMENTS}: is missing")
    if ANNOTATION not in files:
        yield Gap(f"{ANNOTATION}: is missing", is_readable=True)
    for path in files.values():
        yield from file_gaps(path, scan.path)
