"""Planes of a depth frame, largest first, without knowing which way is up: what carries things, the floor, and walls."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.segmentation.organized import OrganizedFrame
from tasks.settings import Config, Count, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_SEED = 22
_SAMPLE = 6000
"""Pixels by which hypotheses are weighed: shares of a percent are told apart."""

MIN_ANGLE_COS = 0.15
"""Of a support's normal with the camera's own up: cameras that look down steeper, or are rolled, take the largest plane of all."""

_LEVEL_DEGREES = 20.0
"""Between a support and what is known to be up: a tracker's drift, and a plane of few pixels."""

_MIN_CARRIER_SHARE, _MIN_AROUND_SHARE = 0.1, 0.5
"""Least pixels of a table as a share of the level of things that hide it; and least share of that level within the
outline of the table: a drawer or a shelf next to a table shows as many pixels, and lies on one side."""

_RIVAL = 0.25
"""Share of the largest plane's pixels that another one needs to be the support in its place."""


@dataclasses.dataclass(frozen=True)
class PlaneConfig(Config):
    """What is a plane."""

    hypotheses: Count = 400  # half from three pixels, half from one and its normal: of a fifth of a frame, a hundred hit
    inlier_sigmas: Positive = 3.0  # of depth noise: what noise alone throws out of a plane is one pixel of 400
    normal_degrees: Positive = 25.0  # normals of windows are off by ten degrees, surfaces of things by more than twice that
    refits: Count = 4  # to what the last one left; the fifth changes nothing
    most: Count = 6  # a corner of a room has floor, two walls, a table and a wardrobe's front
    least_share: Share = 0.012  # of the pixels with a depth, smaller planes are sides of things
    remove_sigmas: Positive = 4.0  # what is nearer to a support than so many times the noise is it; 2 or 8 hardly differ
    remove_m: Positive = 0.006  # nor is less of a thing than this
    level_degrees: Positive = 8.0  # between parallel planes: their noise
    storey_m: Positive = 0.1  # between a support and the floor below it, or a table on it: what is less high is a thing on it
    top_m2: Positive = 0.2  # of a plane over the support that carries things itself; less is the lid of a box
    behind_share: Share = 0.04  # of the pixels that may lie behind a wall; the front of a cupboard has the wall behind it
    large_m2: Positive = 1.2  # from which on a plane is no furniture's, and more may lie behind it ...
    beside_share: Share = 0.25  # ... so much of the pixels: the next room or the garden, seen where the wall ends
    wall_m2: Positive = 0.25  # less is the side of a box ...
    low_share: Share = 0.4  # ... unless so much of it is far below the support: the room behind a table


@dataclasses.dataclass(frozen=True)
class Plane:
    """normal . p + offset = 0 [m], in the frame of its points; the normal is unit, shape (3,), and points to the camera's side."""

    normal: Array
    offset: float

    def heights(self, points: Array) -> Array:
        """Distance over the plane [m] of points, shape (..., 3), negative on the side away from the camera."""
        return np.asarray(points @ self.normal + self.offset)


@dataclasses.dataclass(frozen=True)
class FramePlane:
    """A plane with its pixels, shape (h, w), and their area [m2], slants counted."""

    plane: Plane
    pixels: Bools
    area_m2: float


@dataclasses.dataclass(frozen=True)
class FramePlanes:
    """support: What carries most of what is seen; None where there is no plane. lower: Planes below it that look up as it does, as the
    floor below a table. tops: Large ones above it, as a table on the floor. walls: Upright planes with nothing behind them."""

    support: FramePlane | None
    lower: tuple[FramePlane, ...] = ()
    tops: tuple[FramePlane, ...] = ()
    walls: tuple[FramePlane, ...] = ()


def frame_planes(frame: OrganizedFrame, config: PlaneConfig, up: Array | None = None) -> FramePlanes:
    """The planes of a frame, and what each is.

    up: Up in the camera's frame, shape (3,), where it is known; else the support tells.
    """
    planes = largest_planes(frame, config)
    support = _support(planes, up)
    if support is not None:
        support = _carrier(frame, support, planes, config)
    upward = support.plane.normal if support is not None else up
    if upward is None:
        return FramePlanes(None)
    cosine = np.cos(np.deg2rad(config.level_degrees))
    lower, tops, walls = [], [], []
    for each in planes:
        along = float(each.plane.normal @ upward)
        if support is not None and each is not support and along > cosine:
            height = float(np.median(support.plane.heights(frame.points[each.pixels])))
            if height < -config.storey_m:
                lower.append(each)
            elif height > config.storey_m and each.area_m2 >= config.top_m2:
                tops.append(each)
        elif abs(along) < np.sin(np.deg2rad(2 * config.level_degrees)) and _is_wall(frame, each, support, config):
            walls.append(each)
    return FramePlanes(support, tuple(lower), tuple(tops), tuple(walls))


def _support(planes: list[FramePlane], up: Array | None) -> FramePlane | None:
    """The largest plane that looks up: where the camera stands on its feet, no wall in front of it does. None where up is known, and none
    looks there."""
    if up is not None:
        planes = [each for each in planes if float(each.plane.normal @ up) > np.cos(np.deg2rad(_LEVEL_DEGREES))]
    if not planes or up is not None:
        return max(planes, key=lambda each: int(each.pixels.sum()), default=None)
    largest = max(int(each.pixels.sum()) for each in planes)
    upward = [each for each in planes if -each.plane.normal[1] > MIN_ANGLE_COS and each.pixels.sum() >= _RIVAL * largest]
    return max(upward or planes, key=lambda each: int(each.pixels.sum()))


def _carrier(frame: OrganizedFrame, support: FramePlane, planes: list[FramePlane], config: PlaneConfig) -> FramePlane:
    """The lowest level among and around the pixels of a support, less than a storey below it; the support if there is none.

    Things of one height that stand close together show more of their tops than of the table below.
    """
    import shapely

    cosine = np.cos(np.deg2rad(config.level_degrees))
    first, second = np.linalg.svd(support.plane.normal[None])[2][1:]
    plan = np.stack([frame.points @ first, frame.points @ second], axis=-1)
    carrier, lowest = support, 0.0
    for each in planes:
        if float(each.plane.normal @ support.plane.normal) <= cosine:
            continue
        height = float(np.median(support.plane.heights(frame.points[each.pixels])))
        clear = max(config.remove_m, config.remove_sigmas * float(np.median(frame.noise[each.pixels])))
        if not -config.storey_m <= height < min(-clear, lowest) or each.pixels.sum() < _MIN_CARRIER_SHARE * support.pixels.sum():
            continue
        outline = shapely.LineString(plan[each.pixels]).convex_hull
        shapely.prepare(outline)
        if shapely.contains_xy(outline, plan[support.pixels]).mean() >= _MIN_AROUND_SHARE:
            carrier, lowest = each, height
    return carrier


def _is_wall(frame: OrganizedFrame, each: FramePlane, support: FramePlane | None, config: PlaneConfig) -> bool:
    """Whether an upright plane has nothing behind it, and is large, or goes on below what carries things."""
    heights = each.plane.heights(frame.points[frame.valid])
    behind = heights < -np.maximum(0.05, config.remove_sigmas * frame.noise[frame.valid])
    low = 0.0 if support is None else float((support.plane.heights(frame.points[each.pixels]) < -config.storey_m).mean())
    stands = support is None or -support.plane.normal[1] > MIN_ANGLE_COS  # else the support may be a wall, and this what stands before it
    most = config.beside_share if stands and each.area_m2 >= config.large_m2 else config.behind_share
    return (each.area_m2 >= config.wall_m2 or low >= config.low_share) and float(behind.mean()) <= most


def largest_planes(frame: OrganizedFrame, config: PlaneConfig) -> list[FramePlane]:
    """Planes, each the largest of the pixels that those before it left."""
    rng = np.random.default_rng(_SEED)
    free = frame.valid & frame.has_normal
    least = config.least_share * frame.valid.sum()
    planes: list[FramePlane] = []
    while len(planes) < config.most and free.sum() > max(least, 50):
        plane = dominant_plane(frame, free, config, rng)
        if plane is None:
            break
        pixels = free & on_plane(frame, plane, config)
        if pixels.sum() < least:
            break
        slant = np.abs((frame.normals[pixels] * frame.points[pixels]).sum(axis=-1)) / np.linalg.norm(frame.points[pixels], axis=-1)
        area = float((frame.pixel_m[pixels] ** 2 / np.maximum(slant, 0.1)).sum())
        planes.append(FramePlane(plane, pixels, area))
        free &= ~pixels
    return planes


def on_plane(frame: OrganizedFrame, plane: Plane, config: PlaneConfig) -> Bools:
    """Pixels that are a plane's: as near to it as noise leaves them, half of that where the normal is another one, shape (h, w)."""
    limit = np.maximum(config.remove_m, config.remove_sigmas * frame.noise)
    agrees = frame.normals @ plane.normal > np.cos(np.deg2rad(config.normal_degrees))
    return np.asarray(frame.valid & (np.abs(plane.heights(frame.points)) < np.where(agrees, limit, 0.5 * limit)))


def dominant_plane(frame: OrganizedFrame, free: Bools, config: PlaneConfig, rng: np.random.Generator) -> Plane | None:
    """The plane with most of the pixels in `free`, shape (h, w); None where no two hypotheses find one."""
    rows = np.flatnonzero(free)
    some = np.sort(rng.choice(rows, min(_SAMPLE, len(rows)), replace=False))
    points, normals = frame.points.reshape(-1, 3)[some], frame.normals.reshape(-1, 3)[some]
    limit = config.inlier_sigmas * frame.noise.ravel()[some]
    cosine = np.cos(np.deg2rad(config.normal_degrees))
    three = points[rng.integers(len(some), size=(config.hypotheses // 2, 3))]
    crosses = np.cross(three[:, 1] - three[:, 0], three[:, 2] - three[:, 0])
    sizes = np.linalg.norm(crosses, axis=1)
    crosses, three = crosses[sizes > 1e-9] / sizes[sizes > 1e-9, None], three[sizes > 1e-9]
    single = rng.integers(len(some), size=config.hypotheses - config.hypotheses // 2)
    directions, places = np.concatenate([crosses, normals[single]]), np.concatenate([three[:, 0], points[single]])
    offsets = -(directions * places).sum(axis=1)
    near = np.abs(points @ directions.T + offsets) < limit[:, None]
    votes = (near & (np.abs(normals @ directions.T) > cosine)).sum(axis=0)
    if not len(votes) or votes.max() < 3:
        return None
    best = int(votes.argmax())
    plane: Plane | None = toward_camera(directions[best], float(offsets[best]))
    every = np.flatnonzero(free)
    points, normals = frame.points.reshape(-1, 3)[every], frame.normals.reshape(-1, 3)[every]
    noise = frame.noise.ravel()[every]
    for _ in range(config.refits):
        assert plane is not None
        inlier = (np.abs(plane.heights(points)) < config.inlier_sigmas * noise) & (normals @ plane.normal > cosine)
        fitted = fitted_plane(points[inlier], 1.0 / noise[inlier] ** 2)
        if fitted is None:
            break
        plane = fitted
    return plane


def fitted_plane(points: Array, weights: Array) -> Plane | None:
    """The plane through points, shape (n, 3), in the camera's frame, by weights, shape (n,); None where they span none."""
    if len(points) < 3:
        return None
    middle = np.average(points, axis=0, weights=weights)
    spread = points - middle
    values, vectors = np.linalg.eigh((spread * weights[:, None]).T @ spread / weights.sum())
    return toward_camera(vectors[:, 0], float(-vectors[:, 0] @ middle)) if values[1] > 1e-8 else None


def toward_camera(normal: Array, offset: float) -> Plane:
    """A plane whose normal points to the side of the origin."""
    return Plane(normal, offset) if offset >= 0 else Plane(-normal, -offset)
