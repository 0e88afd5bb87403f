"""What a folder of posed RGB-D frames lacks while it is being copied."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.layout import frame_layout
from tasks.capture.scan import Scan
from tasks.capture.wholeness import Gap, frame_gaps


def gaps(scan: Scan) -> Iterator[Gap]:
    """What is missing of a scan, or cut."""
    layout = frame_layout(scan.path, scan.premises, above=True)
    if layout is None or not layout.frames:
        yield Gap(f"{scan.path.name}: holds no frames any more")
        return
    yield from frame_gaps(layout, scan.path, stated=False)
    if layout.trajectory is None and not any(frame.pose for frame in layout.frames):
        yield Gap(f"{scan.path.name}: poses are missing")
