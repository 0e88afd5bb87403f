"""Instances of rooms that were recorded as posed frames, against the truth: hard rooms without labels and mesh, by this code and the former
one."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.capture.former import former_scans, has_former
from bench.capture.meshes import BareRoom, MeshScore, bare_room, carried, regions_of, room_score, score_former, summed
from bench.goals import goal
from tasks.capture import CaptureConfig
from tasks.capture.formats import find_scans
from tasks.capture.fusion import fused_surface
from tasks.capture.instances.segmentation import geometry_instances
from tasks.capture.leveling import read_scan
from tasks.capture.rooms.alignment import align
from tasks.capture.segmentation.gravity import scan_level
from tasks.capture.segmentation.votes import spacing_of, voted_groups

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

WANTED, WANTED_DEGREES, WANTED_M = 0.5, 1.0, 0.01
"""Of the objects that are found at an IoU of 0.5, and how far off the floor may be."""


def rooms_report(rooms: int, seed: int) -> dict[str, Any]:
    """Figures of hard rooms that are frames alone."""
    with tempfile.TemporaryDirectory(prefix="rooms-", ignore_cleanup_errors=True) as temporary:
        place = Path(temporary)
        posed = [bare_room(place / "rooms", 2 * index, seed) for index in range(rooms)]
        scores = [("now", [score_frames(room) for room in posed])]
        if has_former():
            former = former_scans([room.folder for room in posed], place / "former")
            scores.insert(0, ("before", [score_former(room, scan) for room, scan in zip(posed, former, strict=True)]))
    now = summed(scores[-1][1])
    return {
        "rows": [{"material": "hard rooms", "code": code, "rooms": rooms} | dataclasses.asdict(summed(each)) for code, each in scores],
        "rooms": [
            {"room": room.truth.scan, "code": code} | dataclasses.asdict(score)
            for code, each in scores
            for room, score in zip(posed, each, strict=True)
        ],
        "goals": room_goals(now),
    }


def room_goals(now: MeshScore) -> list[dict[str, Any]]:
    """What this code is held against; the former one only stands beside it."""
    return [
        goal("rooms of frames: objects at IoU 0.5 [share]", now.half / max(now.objects, 1), ">=", WANTED),
        goal("rooms of frames: floor off at worst [degrees]", now.degrees, "<=", WANTED_DEGREES),
        goal("rooms of frames: floor off at worst [m]", now.off_m, "<=", WANTED_M),
    ]


def score_frames(room: BareRoom) -> MeshScore:
    """What this code finds in a room's frames; seconds are of a processor."""
    clock = time.process_time()
    region, pose = found_in_frames(room.folder, room.vertices)
    return room_score(room, region, pose, time.process_time() - clock)


def found_in_frames(folder: Path, vertices: Array) -> tuple[Indices, Array]:
    """Region of each vertex of a surface of the frames in a folder, -1 for none and for the room, shape (n,); and scan frame to world
    frame, 4x4. vertices: Scan frame [m], shape (n, 3)."""
    config = CaptureConfig()
    (scan,), _ = find_scans(folder, "posed_rgbd")
    reading = read_scan(scan)
    surface, _ = fused_surface(reading.frames, config.fusion, folder.name)
    pose = align(surface, level=scan_level(reading.frames, spacing_of(surface), config.votes.frame)).pose
    world = surface.transformed(pose)
    by_surface = geometry_instances(world, config.segmentation)
    by_frames = voted_groups(world, by_surface, reading.frames, pose, config.segmentation.naming, config.votes)
    return carried(regions_of(by_frames.groups, len(surface.vertices)), surface.vertices, vertices), pose
