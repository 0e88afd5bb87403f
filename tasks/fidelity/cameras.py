"""The cameras that decide what could be seen: those of the scan's frames, else ones put into its free space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Frame, Shell
from tasks.geometry.rendering import Camera
from tasks.geometry.transforms import look_at, matrix

Array = NDArray[np.float64]

_PLACES = 4
"""Places for virtual cameras: from four that lie far apart, what stands in a room hides little of what is behind it."""

_YAWS = 4
_FOV_RADIANS = 1.75
"""100 degrees: four of them see all around, with some overlap at the sides."""

_PITCH_RADIANS = -0.25
"""A little down, as people hold a camera: furniture lies below the eye."""

_EYE_M = 1.5
_EYE_SHARE = 0.6
"""Height of virtual cameras: a hand-held camera's, in low rooms that share of the height."""

_GRID_M = 0.25
_MOST_PLACES = 10_000
"""A hall of 25 by 25 m in steps of the grid; where stray points lie farther apart, the steps are wider."""

_CLEARANCE_M = 0.3
"""Virtual cameras keep this far from all that was scanned, where there is such a place: an arm's length."""


def frame_cameras(frames: Sequence[Frame], most: int, width: int) -> list[Camera]:
    """Cameras of the frames with a pose, at most so many, evenly chosen in their order, of pictures of about `width` pixels."""
    posed = [frame for frame in sorted(frames, key=lambda f: f.frame_id) if frame.pose is not None and frame.intrinsics[0] > 0]
    chosen = [posed[i] for i in sorted({int(i) for i in np.linspace(0, len(posed) - 1, min(most, len(posed))).round()})] if posed else []
    return [_camera(frame, width) for frame in chosen]


def _camera(frame: Frame, width: int) -> Camera:
    across = width / frame.width
    height = max(1, round(frame.height * across))
    down = height / frame.height
    fx, fy, cx, cy = frame.intrinsics
    return Camera(matrix(frame.pose or ()), fx * across, fy * down, (cx + 0.5) * across - 0.5, (cy + 0.5) * down - 0.5, width, height)


def virtual_cameras(room: Shell | None, points: Array, width: int) -> list[Camera]:
    """Cameras at up to four places in the free space of a scan, each looking four ways, a little down.

    points: Of the scan's surface [m], shape (n, 3). The first place is the one farthest from all of them, each further one the
    place farthest from those before it; all lie over the floor. The same scan gives the same cameras.
    """
    from scipy.spatial import cKDTree

    low, high = points.min(axis=0), points.max(axis=0)
    height = room.height_m if room else float(high[2] - low[2])
    eye = (0.0 if room else float(low[2])) + min(_EYE_M, _EYE_SHARE * height)
    places = _grid(room, low, high, eye)
    clearance = cKDTree(points).query(places)[0]
    free = clearance >= min(_CLEARANCE_M, float(clearance.max()))
    places, clearance = places[free], clearance[free]
    chosen = [int(clearance.argmax())]
    far = np.full(len(places), np.inf)
    while len(chosen) < min(_PLACES, len(places)):
        far = np.minimum(far, np.linalg.norm(places - places[chosen[-1]], axis=1))
        if far.max() < _CLEARANCE_M:
            break
        chosen.append(int(far.argmax()))
    flat, rise = np.cos(_PITCH_RADIANS), np.sin(_PITCH_RADIANS)
    cameras = []
    for place in places[chosen]:
        for yaw in np.arange(_YAWS) * (2 * np.pi / _YAWS) + np.pi / 4:  # axes lie along the walls: towards the corners
            pose = look_at(place, place + np.array([np.cos(yaw) * flat, np.sin(yaw) * flat, rise]))
            cameras.append(Camera.with_fov(pose, width, max(1, round(0.75 * width)), _FOV_RADIANS))
    return cameras


def _grid(room: Shell | None, low: Array, high: Array, eye: float) -> Array:
    """Places at the height of the eye, over the floor where there is one [m], shape (n, 3); at least one, and no more than fit."""
    import shapely

    step = _GRID_M
    if room is not None and len(room.floor_polygon) >= 3 and _count(low, high, step) > _MOST_PLACES:
        corners = np.asarray(room.floor_polygon, dtype=np.float64)
        low, high = (np.clip(end[:2], corners.min(axis=0), corners.max(axis=0)) for end in (low, high))
    while _count(low, high, step) > _MOST_PLACES:
        step *= 2
    axes = [
        np.arange(a + step / 2, b, step) if b - a > step / 2 else np.array([(a + b) / 2]) for a, b in zip(low[:2], high[:2], strict=True)
    ]
    flat = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if room is not None and len(room.floor_polygon) >= 3:
        flat = flat[shapely.contains_xy(shapely.Polygon(room.floor_polygon), *flat.T)]
    if not len(flat):
        flat = (low[None, :2] + high[None, :2]) / 2
    return np.column_stack([flat, np.full(len(flat), eye)])


def _count(low: Array, high: Array, step: float) -> float:
    """Places of a grid between two corners [m], at least one along each axis."""
    return float(np.maximum(np.ceil((high[:2] - low[:2]) / step - 0.5), 1.0).prod())
