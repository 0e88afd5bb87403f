"""What a recording of Stray Scanner lacks while it is being copied."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.scan import Scan
from tasks.capture.stray_scanner import CAMERA, COLOR, DEPTH, ODOMETRY, STRAY_SCANNER
from tasks.capture.wholeness import Gap, file_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    files = {path.relative_to(scan.path).as_posix(): path for path in STRAY_SCANNER.files(scan, scan.premises)}
    for name in (ODOMETRY, CAMERA):
        if name not in files:
            yield Gap(f"{name}: is missing")
    count = {name: sum(key.startswith(f"{name}/") for key in files) for name in (*COLOR, DEPTH)}
    if not count[DEPTH]:
        yield Gap(f"{DEPTH}: is missing")
    colors = max(count[name] for name in COLOR)
    if colors and count[DEPTH] < colors:
        yield Gap(f"{DEPTH}: has {count[DEPTH]} images for {colors} of color", is_readable=True)
    for path in files.values():
        yield from file_gaps(path, scan.path)
