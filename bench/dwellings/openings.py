"""Doors, windows and openings without a door as one sees them from inside: rays from eyes in the room to the true rectangle.

A ray counts when the truth shows the door or window there: what a curtain covers is nobody's fault. Its silhouette is the share of
these rays that meet the instance that stands for it before anything else of the replica.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bench.dwellings.replicas import FirstHits
from tasks.scanner.truth import DwellingTruth, TruePassage

Array = NDArray[np.float64]

GRID = 16
"""Rays along either side of a rectangle."""

EYES_M = (0.8, 1.4, 2.2)
"""Distances of eyes from the rectangle [m], where the room is so deep."""

TURNS = (-0.7, 0.0, 0.7)
"""From the normal, to either side [rad]."""

EYE_HEIGHT_M = 1.5

BEHIND_M = 0.35
"""An opening is free to so far behind its rectangle: an outer wall, and half as much for walls that stand a little off."""

SEEN = 0.8
"""A door or window of which so much is seen is there."""

LEAST_RAYS = 50
"""With fewer rays that see it in truth, nothing can be said: a curtain hangs before it."""


def silhouettes(
    truth: DwellingTruth, drawn: FirstHits, replica: FirstHits, stands_for: Mapping[str, set[str]], moved: Array
) -> list[float]:
    """Share that is seen of every door and window that can be seen in truth; 0 for what no instance stands for.

    stands_for: instances by name of the true object. moved: from the frame of the truth to the replica's world, 4x4 [m].
    """
    shares = []
    for opening in truth.openings:
        if opening.instance is None:
            continue
        seen = total = 0
        points = _grid(np.array(opening.leaf))
        for eye in eyes(truth, opening):
            met = drawn.first(eye, points)
            ours = np.array([name == opening.instance for name in met])
            total += int(ours.sum())
            own = stands_for.get(opening.instance, set())
            if own and ours.any():
                there = points[ours] @ moved[:3, :3].T + moved[:3, 3]
                seen += sum(name in own for name in replica.first(moved[:3, :3] @ eye + moved[:3, 3], there))
        if total >= LEAST_RAYS:
            shares.append(seen / total)
    return shares


def open_shares(truth: DwellingTruth, drawn: FirstHits, replica: FirstHits, moved: Array) -> list[float]:
    """Share of every opening without a door that one can see through; what the truth has in it or before it does not count.

    moved: from the frame of the truth to the replica's world, 4x4 [m].
    """
    shares = []
    for opening in (row for row in truth.openings if row.kind == "passage"):
        points = _grid(np.array(opening.corners))
        clear = total = 0
        for eye in eyes(truth, opening):
            far = np.linalg.norm(points - eye, axis=1) + BEHIND_M
            is_open = drawn.distances(eye, points) > far
            there = points[is_open] @ moved[:3, :3].T + moved[:3, 3]
            total += int(is_open.sum())
            if len(there):
                clear += int((replica.distances(moved[:3, :3] @ eye + moved[:3, 3], there) > far[is_open]).sum())
        if total >= LEAST_RAYS:
            shares.append(clear / total)
    return shares


def eyes(truth: DwellingTruth, opening: TruePassage) -> list[Array]:
    """Places before a leaf, pane or opening, inside of its room [m]; for a leaf that stands open on both of its sides."""
    import shapely

    floor = shapely.Polygon(truth.rooms[opening.room].polygon).buffer(-0.1)
    leaf = np.array(opening.leaf or opening.corners)
    middle, along = leaf[:, :2].mean(axis=0), leaf[1, :2] - leaf[0, :2]
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    places = []
    for side in (1.0, -1.0):
        for turn in TURNS:
            c, s = np.cos(turn), np.sin(turn)
            way = side * np.array([c * normal[0] - s * normal[1], s * normal[0] + c * normal[1]])
            for far in EYES_M:
                at = middle + far * way
                if floor.contains(shapely.Point(*at)):
                    places.append(np.array([*at, EYE_HEIGHT_M]))
    return places


def _grid(corners: Array) -> Array:
    """Points inside of a rectangle, shape (GRID * GRID, 3) [m]."""
    u, v = np.meshgrid((np.arange(GRID) + 0.5) / GRID, (np.arange(GRID) + 0.5) / GRID, indexing="ij")
    across, up = corners[1] - corners[0], corners[3] - corners[0]
    return np.asarray(corners[0] + u.reshape(-1, 1) * across + v.reshape(-1, 1) * up)
