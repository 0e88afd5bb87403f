"""What a scan of MultiScan lacks while it is being copied."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.multiscan import MESH, MULTISCAN
from tasks.capture.scan import Scan
from tasks.capture.wholeness import Gap, file_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    files = MULTISCAN.files(scan, scan.premises)
    if not any(path.name.endswith(MESH) for path in files):
        yield Gap(f"{scan.path.name}: its mesh is missing", is_readable=True)
    for path in files:
        yield from file_gaps(path, scan.folder)
