"""What a scan of MultiScan lacks while it is being copied."""

from __future__ import annotations

import os
from collections.abc import Iterator

from tasks.capture.multiscan import MULTISCAN, mesh_of
from tasks.capture.scan import Scan
from tasks.capture.wholeness import Gap, file_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    mesh = mesh_of(scan.folder)
    if not os.path.lexists(mesh):
        yield Gap(f"{scan.path.name}: its mesh is missing", is_readable=True)
    elif not mesh.is_file():
        yield Gap(f"{scan.path.name}/{mesh.name}: is no file, or a link to nothing", is_readable=False)
    for path in MULTISCAN.files(scan, scan.premises):
        yield from file_gaps(path, scan.folder)
