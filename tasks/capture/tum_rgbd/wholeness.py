"""What a TUM RGB-D recording lacks while it is being copied."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.files.documents import MAX_TEXT_BYTES
from tasks.capture.scan import Scan
from tasks.capture.tum_rgbd import COLOR, DEPTH, POSES, TUM_RGBD, listed_images
from tasks.capture.wholeness import Gap, content, file_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    files = {path.relative_to(scan.path).as_posix(): path for path in TUM_RGBD.files(scan, scan.premises)}
    for name in (COLOR, DEPTH):
        if name not in files:
            yield Gap(f"{name}: is missing")
            continue
        text = content(files[name], MAX_TEXT_BYTES).decode("utf-8-sig", "replace")
        missing = [image for _, time, image in listed_images(text) if time is not None and image and image not in files]
        if missing:
            yield Gap(f"{name}: lists {len(missing)} images that are not there, as {missing[0]:.60}")
    if POSES not in files:
        yield Gap(f"{POSES}: is missing", is_readable=True)
    for path in files.values():
        yield from file_gaps(path, scan.path)
