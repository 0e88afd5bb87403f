"""What a recording of ARKitScenes lacks while it is being copied."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.arkitscenes import ARKITSCENES, BOXES, COLOR, DEPTH, LENSES, MESH, POSES
from tasks.capture.scan import Scan
from tasks.capture.wholeness import Gap, file_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    files = ARKITSCENES.files(scan, scan.premises)
    by_place = {name: {path.stem for path in files if path.parent.name == name} for name in (COLOR, DEPTH, LENSES)}
    if not any(path.name.endswith(MESH) for path in files):
        yield Gap(f"{scan.path.name}{MESH}: is missing", is_readable=bool(by_place[COLOR]))
    if not any(path.name.endswith(BOXES) for path in files):
        yield Gap(f"{scan.path.name}{BOXES}: is missing", is_readable=True)
    if by_place[COLOR] and not any(path.name == POSES for path in files):
        yield Gap(f"{POSES}: is missing", is_readable=any(path.name.endswith(MESH) for path in files))
    for name in (DEPTH, LENSES):
        if by_place[COLOR] and len(by_place[COLOR] & by_place[name]) < len(by_place[COLOR]):
            there = len(by_place[COLOR] & by_place[name])
            yield Gap(f"{name}: has {there} of the {len(by_place[COLOR])} frames", is_readable=there > 0)
    for path in files:
        if path.is_relative_to(scan.path):
            yield from file_gaps(path, scan.path)
