"""Scans of small rooms with one object in each, and settings that make every stage short.

All eight stages together take about half a second of one warm core, so that what is left of a run's time is orchestration.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface

Array = NDArray[np.float64]

Part = tuple[str, list[tuple[Array, NDArray[np.int64]]], tuple[int, int, int]]
"""A label, its patches (vertices (n, 3), faces (m, 3)), and its color."""

SETTINGS = (
    "capture.max_points=2000",
    "selection.alignment.yaw_count=4",
    "selection.alignment.starts=1",
    "selection.alignment.refine_steps=2",
    "selection.alignment.points=128",
    "selection.alignment.samples=128",
    "selection.alignment.coarse=64",
    "optimization.method.chains=1",
    "optimization.method.max_moves=500",
    "optimization.certificate.seconds=0.2",
    "navigation.train_episodes=4",
    "navigation.test_episodes=4",
    "fidelity.max_cameras=4",
    "fidelity.max_pictures=1",
    'exports.formats=["glb"]',
)
"""As for `metascenes run --set`. Each stage still does its own work, on little."""

_STEP = 0.2  # distance of the room's vertices [m]
_FINE = 0.1  # of an object's: coarser, there are too few points to close a crop of it
_AISLE = 1.2  # from object to object in a crowded hall: an agent passes between them [m]
_OBJECTS = (("box", (150, 120, 80)), ("cabinet", (200, 200, 190)), ("nightstand", (120, 90, 60)), ("chest", (60, 60, 160)))


def write_small_scans(folder: Path, count: int, seed: int = 0, first: int = 0) -> Path:
    """`count` scans `scene<number>_00` from number `first` on, below `folder`, which is returned.

    Rooms and objects differ in size, place, color and kind. The same seed and number give the same bytes.

    Raises:
        FileExistsError: one of the scans is there already.
    """
    for number in range(first, first + count):
        _write_scan(folder, f"scene{number:04d}_00", np.random.default_rng([seed, number]))
    return folder


def write_crowded_scan(folder: Path, objects: int, seed: int = 0) -> Path:
    """One scan `scene0000_00` of a hall with so many objects, below `folder`, which is returned: every third lies on another.

    Raises:
        FileExistsError: the scan is there already.
    """
    rng = np.random.default_rng([seed, objects])
    below = math.ceil(2 * objects / 3)
    side = math.ceil(math.sqrt(below))
    parts: list[Part] = []
    for index in range(below):
        i, j = divmod(index, side)
        kind, color = _OBJECTS[int(rng.integers(len(_OBJECTS)))]
        size = rng.uniform((0.5, 0.45, 0.3), (0.8, 0.6, 0.6))
        middle = np.array([_AISLE * (i + 0.75), _AISLE * (j + 0.75), size[2] / 2])
        parts.append((kind, _box(middle, size), color))
        if index % 2 == 0 and index // 2 < objects - below:
            top = rng.uniform((0.2, 0.2, 0.15), (0.3, 0.3, 0.3))
            parts.append(("box", _box(middle + np.array([0, 0, (size[2] + top[2]) / 2]), top), _OBJECTS[0][1]))
    room = np.array([_AISLE * (side + 0.5)] * 2 + [2.6])
    _write(folder, "scene0000_00", room, parts)
    return folder


def _write_scan(folder: Path, scan: str, rng: np.random.Generator) -> None:
    """A room from which one object is seen."""
    room = np.array([*rng.uniform(2.8, 3.4, 2), 2.2])
    size = rng.uniform((0.4, 0.35, 0.3), (0.7, 0.5, 0.8))
    kind, color = _OBJECTS[int(rng.integers(len(_OBJECTS)))]
    middle = np.array([*(room[:2] / 2 + rng.uniform(-0.3, 0.3, 2)), size[2] / 2])
    _write(folder, scan, room, [(kind, _box(middle, size), color)])


def _write(folder: Path, scan: str, room: Array, objects: list[Part]) -> None:
    """A room of a size [m] with objects in it, as ScanNet lays it out, without frames."""
    from tasks.scanner import ScannerConfig
    from tasks.scanner.folder import LICENSE, write_aggregation, write_mesh, write_metadata, write_segments

    x, y, z = np.diag(room)
    zero = np.zeros(3)
    walls = [(zero, x, z), (x, y, z), (x + y, -x, z), (y, -y, z)]
    parts: list[Part] = [("floor", [_grid(zero, x, y)], (120, 100, 80)), ("ceiling", [_grid(z, y, x)], (240, 240, 240))]
    parts += [("wall", [_grid(*wall)], (225, 220, 210)) for wall in walls]
    parts += objects
    config = ScannerConfig(frames="none", scene_type="Office")
    place = folder / scan
    place.mkdir(parents=True)
    surface, segments = _joined(parts)
    write_metadata(place / f"{scan}.txt", config, 0, np.eye(4))
    write_mesh(place / f"{scan}_vh_clean_2.ply", surface)
    segments_file = f"{scan}_vh_clean_2.0.010000.segs.json"
    write_segments(place / segments_file, scan, config, segments)
    groups = [(label, [index]) for index, (label, _, _) in enumerate(parts)]
    write_aggregation(place / f"{scan}.aggregation.json", scan, config, segments_file, groups)
    (place / "LICENSE.txt").write_text(f"{LICENSE}\nA generated room for measurements.\n")


def _grid(origin: Array, u: Array, v: Array, step: float = _STEP) -> tuple[Array, NDArray[np.int64]]:
    """A flat grid of triangles from `origin` along `u` and `v` [m]: vertices (n, 3), faces (m, 3)."""
    n, m = (max(2, round(float(np.linalg.norm(side)) / step) + 1) for side in (u, v))
    a, b = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m), indexing="ij")
    first = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).reshape(-1)
    faces = np.concatenate([np.stack([first, first + m, first + m + 1], 1), np.stack([first, first + m + 1, first + 1], 1)])
    return origin + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v, faces


def _box(middle: Array, size: Array) -> list[tuple[Array, NDArray[np.int64]]]:
    """The six sides of a box, facing outward."""
    sides = []
    for axis in range(3):
        for sign in (-1, 1):
            u, v = np.diag(size)[(axis + 1) % 3], np.diag(size)[(axis + 2) % 3]
            start = middle + sign * np.diag(size)[axis] / 2 - u / 2 - v / 2
            sides.append(_grid(start, *((u, v) if sign > 0 else (v, u)), _FINE))
    return sides


def _joined(parts: list[Part]) -> tuple[Surface, NDArray[np.int64]]:
    """One mesh of all parts, and the part that each vertex is of, shape (n,)."""
    vertices, faces, colors, segments = [], [], [], []
    offset = 0
    for index, (_, grids, color) in enumerate(parts):
        for points, triangles in grids:
            vertices.append(points)
            faces.append(triangles + offset)
            colors.append(np.tile(np.asarray(color, dtype=np.uint8), (len(points), 1)))
            segments.append(np.full(len(points), index, dtype=np.int64))
            offset += len(points)
    return Surface(np.concatenate(vertices), np.concatenate(faces), np.concatenate(colors)), np.concatenate(segments)


def write_tryout(folder: Path, count: int = 1) -> Path:
    """Scans in `scans`, and `quick.toml` for `metascenes run --config`, below a new folder, which is returned."""
    write_small_scans(folder / "scans", count)
    (folder / "quick.toml").write_text("\n".join(SETTINGS) + "\n")
    return folder


if __name__ == "__main__":  # `python -m bench.flows.small_scenes tryout`
    write_tryout(Path(sys.argv[1]))
