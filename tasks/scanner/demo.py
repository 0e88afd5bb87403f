"""The demo's scans: a few furnished rooms, each in another variant of the format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from schemas.errors import InputError
from tasks.furniture.rooms import furnish
from tasks.scanner import ScannerConfig, scan_scene

ROOMS: tuple[tuple[str, ScannerConfig], ...] = (
    ("bedroom", ScannerConfig(frames="exported", lost_poses=2)),
    ("office", ScannerConfig(frames="sens", axis_alignment=False)),
    ("living room", ScannerConfig(frames="exported", aggregation="vh_clean", prefix="scannet.")),
    ("kitchen", ScannerConfig(frames="sens")),
    ("dining room", ScannerConfig(frames="none")),
)
"""Kind of room and variant of each scan, in turn."""


def demo_scan(out: Path, index: int, seed: int) -> Path:
    """Make scan number `index` (from 0): a room of about 25 objects, in `<out>/scene<index>_00`. Returns its folder.

    Raises:
        InputError: the index is negative, or the folder is there already.
    """
    if index < 0:
        raise InputError("demo", "index", f"is {index}", "count from 0")
    rng = np.random.default_rng([seed, index])
    room_type, config = ROOMS[index % len(ROOMS)]
    room = furnish(room_type, rng, object_count=25, clutter=0.1 * (index // len(ROOMS) % 4))
    scan = f"scene{index:04d}_00"
    scan_scene(room, out, scan, config, rng)
    return out / scan
