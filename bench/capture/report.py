"""The benchmark of scans without labels: single frames, bare meshes; held against goals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.capture.frames import frames_report
from bench.capture.meshes import meshes_report
from bench.machine import machine

FRAMES, MESHES = "frames", "meshes"

PARTS = (FRAMES, MESHES)
"""What can be measured: instances of single frames of tables, and of meshes of rooms."""


@dataclasses.dataclass(frozen=True)
class CaptureBench:
    """What is measured. frames, rooms: Generated ones. realdata: Folder with scans by others, None for none. parts: Of `PARTS`."""

    frames: int = 30
    seed: int = 0
    parts: tuple[str, ...] = PARTS
    rooms: int = 10
    realdata: Path | None = None

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        return len(self.parts)


def run_capture_bench(config: CaptureBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each part of it that is done."""
    parts: dict[str, Any] = {}
    if FRAMES in config.parts:
        parts[FRAMES] = frames_report(config.frames, config.seed)
        advance(FRAMES)
    if MESHES in config.parts:
        parts[MESHES] = meshes_report(config.rooms, config.seed, config.realdata)
        advance(MESHES)
    return {"machine": machine(), "seed": config.seed, "parts": parts, "goals": [row for part in parts.values() for row in part["goals"]]}
