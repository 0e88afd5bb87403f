"""Capture: a scan folder in; scene, room, frames, instances and masks out."""

from __future__ import annotations

from tasks.capture.formats import find_scans, scan_files
from tasks.capture.scan import Scan
from tasks.capture.scenes import CaptureConfig, run
from tasks.stage import Stage

STAGE = Stage(
    name="capture",
    reads=(),
    writes=("scenes", "shells", "rooms", "surfaces", "frames", "instances", "masks", "syntheses", "synthesis_objects"),
    config=CaptureConfig,
    run=run,
    outside=("scan",),
)

__all__ = ["STAGE", "CaptureConfig", "Scan", "find_scans", "run", "scan_files"]
