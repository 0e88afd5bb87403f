"""Rooms along a ring of corners, as scans show them: noisy surfaces, openings without doors and the floor behind them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud, dense_cloud
from tasks.capture.labels import CEILING, FLOOR, WALL
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import yaw_pose
from tests.capture_scans import Mesh, box_plates, plate

Ring = Sequence[tuple[float, float]]
Box = tuple[tuple[float, float, float], tuple[float, float, float], float]
"""Center and size [m], and yaw [rad]."""

HEIGHT_M = 2.5
CLASSES = {"floor": FLOOR, "wall": WALL, "ceiling": CEILING}


@dataclasses.dataclass(frozen=True)
class Gap:
    """An opening from the floor up: the wall's number, where it begins, width and height [m]. behind_m: floor that is seen behind it."""

    wall: int
    start: float
    width: float
    height: float
    behind_m: float = 1.5


def cut_room(
    ring: Ring, gaps: Sequence[Gap] = (), boxes: Sequence[Box] = (), noise: float = 0.004, step: float = 0.05, ceiling: bool = True
) -> tuple[Surface, NDArray[np.int64], list[str]]:
    """The surface of a room, the instance of each vertex, and the label of each instance."""
    corners = np.array(ring, dtype=np.float64)
    pieces: list[tuple[str, Mesh]] = []
    ground = shapely.Polygon(corners)
    for number, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        vertices, faces = plate([*start, 0], [*(end - start), 0], [0, 0, HEIGHT_M], step)
        faces = faces[:, ::-1]
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        centers = vertices[faces].mean(axis=1)
        places = (centers[:, :2] - start) @ along
        for gap in gaps:
            if gap.wall == number:
                is_free = (places > gap.start) & (places < gap.start + gap.width) & (centers[:, 2] < gap.height)
                faces, places, centers = faces[~is_free], places[~is_free], centers[~is_free]
                out = gap.behind_m * np.array([along[1], -along[0]])
                low, high = start + gap.start * along, start + (gap.start + gap.width) * along
                ground = ground.union(shapely.Polygon([low, high, high + 0.4 * along + out, low - 0.4 * along + out]))
        pieces.append(("wall", (vertices, faces)))
    pieces.append(("floor", _flat(ground, 0.0, step)))
    if ceiling:
        vertices, faces = _flat(shapely.Polygon(corners), HEIGHT_M, step)
        pieces.append(("ceiling", (vertices, faces[:, ::-1])))
    pieces += [("cabinet", box_plates(size, yaw_pose(yaw, np.array(center)), step)) for center, size, yaw in boxes]
    places_of, faces_of, owners, count = [], [], [], 0
    for number, (_, (vertices, faces)) in enumerate(pieces):
        used = np.unique(faces)
        index = np.full(len(vertices), -1)
        index[used] = np.arange(len(used)) + count
        places_of.append(vertices[used])
        faces_of.append(index[faces])
        owners.append(np.full(len(used), number))
        count += len(used)
    points = np.concatenate(places_of)
    points += np.random.default_rng(3).normal(0.0, noise, points.shape)
    surface = Surface(points, np.concatenate(faces_of), np.full((count, 3), 150, dtype=np.uint8))
    return surface, np.concatenate(owners), [label for label, _ in pieces]


def cut_cloud(ring: Ring, gaps: Sequence[Gap] = (), boxes: Sequence[Box] = (), noise: float = 0.004) -> tuple[Cloud, NDArray[np.int64]]:
    """The room's points with the NYU40 class of each."""
    surface, owner, labels = cut_room(ring, gaps, boxes, noise)
    return dense_cloud(surface, owner), np.array([CLASSES.get(label, 3) for label in labels])[owner]


def _flat(shape: shapely.Geometry, height: float, step: float) -> Mesh:
    """A level surface that fills a shape."""
    low_x, low_y, high_x, high_y = shape.bounds
    vertices, faces = plate([low_x, low_y, height], [high_x - low_x, 0, 0], [0, high_y - low_y, 0], step)
    centers = vertices[faces].mean(axis=1)
    return vertices, faces[shapely.contains_xy(shape, centers[:, 0], centers[:, 1])]
