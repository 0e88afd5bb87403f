"""Habitat datasets on disk, for tests."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tasks import exports
from tasks.exports.habitat import scene_handle
from tasks.exports.layout import layout, shared_files
from tasks.geometry.transforms import yaw_pose
from tests.replicas import cube, furnished, rows_of, with_navigation
from tests.tasks.exports.test_exports import export

Rows = dict[str, list[Any]]

FIRST = scene_handle("demo/room_01")
"""Name of the first scene in the dataset."""


def write_dataset(root: Path, scenes: Iterable[tuple[Rows, dict[str, bytes]]]) -> Path:
    """Export scenes, rows and blobs each, and lay their dataset out below `root`; the dataset's folder."""
    done = [export(*scene, exports.ExportsConfig(formats=("habitat",))) for scene in scenes]
    rows = [row for outcome in done for row in outcome.rows["export_files"]]
    blobs = {name: data for outcome in done for name, data in outcome.blobs.items()}
    exports.write_folder(root, {path: blobs[name] for path, name in layout(rows).items()} | shared_files(rows, blobs))
    return root / "habitat"


def office(episodes: int = 8) -> tuple[Rows, dict[str, bytes]]:
    """A furnished room, named so that the other's name contains its own."""
    return with_navigation(*rows_of(furnished()), episodes=episodes)


def other_room() -> tuple[Rows, dict[str, bytes]]:
    """A room with two boxes."""
    boxes = [cube((0.3, 0.3, 0.3), yaw_pose(0.3, [0.5, -0.5, 0.0])), cube((0.2, 0.3, 0.3), yaw_pose(1.0, [-1.5, 1.0, 0.0]))]
    return with_navigation(*rows_of(boxes, "demo/room_010"), episodes=3)


def scene_file(root: Path) -> Path:
    """The first scene's instance file."""
    return root / "scenes" / f"{FIRST}.scene_instance.json"
