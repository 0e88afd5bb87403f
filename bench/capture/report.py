"""The benchmark of scans without labels: single frames, bare meshes, rooms of frames; held against goals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.capture.frames import frames_report
from bench.capture.houses import storeys_report
from bench.capture.meshes import meshes_report
from bench.capture.poses import poses_report
from bench.capture.rooms import rooms_report
from bench.machine import machine

FRAMES, MESHES, ROOMS, POSES, STOREYS = "frames", "meshes", "rooms", "poses", "storeys"

PARTS = (FRAMES, MESHES, ROOMS, POSES, STOREYS)
"""What can be measured: instances of single frames of tables, of meshes of rooms, and of rooms of frames; poses of walks that are withheld,
or drift; storeys of houses."""


@dataclasses.dataclass(frozen=True)
class CaptureBench:
    """What is measured. frames: Generated ones of tables. rooms: Generated ones, as meshes, and as many as frames. realdata: Folder with
    the real frames that drawings are of, and with scans by others; None for none. walks: Through rooms, each of `walk_frames` frames.
    houses: Generated ones of up to three storeys. open3d: An interpreter that has it, '' for this one. parts: Of `PARTS`."""

    frames: int = 30
    walks: int = 3
    walk_frames: int = 300
    open3d: str = ""
    seed: int = 0
    realdata: Path | None = None
    parts: tuple[str, ...] = PARTS
    rooms: int = 10
    houses: int = 16

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        return len(self.parts)


def run_capture_bench(config: CaptureBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each part of it that is done.

    Raises:
        InputError: a real frame that a drawing is of is not where it should be.
    """
    parts: dict[str, Any] = {}
    if FRAMES in config.parts:
        parts[FRAMES] = frames_report(config.frames, config.seed, config.realdata)
        advance(FRAMES)
    if MESHES in config.parts:
        parts[MESHES] = meshes_report(config.rooms, config.seed, config.realdata)
        advance(MESHES)
    if ROOMS in config.parts:
        parts[ROOMS] = rooms_report(config.rooms, config.seed)
        advance(ROOMS)
    if POSES in config.parts:
        parts[POSES] = poses_report(config.walks, config.walk_frames, config.seed, config.open3d)
        advance(POSES)
    if STOREYS in config.parts:
        parts[STOREYS] = storeys_report(config.houses, config.seed)
        advance(STOREYS)
    return {"machine": machine(), "seed": config.seed, "parts": parts, "goals": [row for part in parts.values() for row in part["goals"]]}
