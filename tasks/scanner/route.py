"""Where a person with a scanner goes and looks: viewpoints over the free floor, chosen one after another for what they add.

Next-best-view planning: points are spread over all surfaces; of many candidate views the one that adds most is taken,
again and again. A point asks for several good looks, so that fusion can average noise.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.geometry.meshes import sample_surface, surface_of
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at
from tasks.geometry.triangles import surface_area
from tasks.scanner.scenery import STRUCTURE, Scenery

if TYPE_CHECKING:
    from tasks.scanner import ScannerConfig

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Targets:
    """Points to be seen: position (n, 3), normal (n, 3), object (n,), and how much a look at each is worth (n,)."""

    points: Array
    normals: Array
    obj: NDArray[np.int64]
    worth: Array


def targets_of(scenery: Scenery, spacing_m: float, least: int, rng: np.random.Generator) -> Targets:
    """Points spread over the parts about `spacing_m` apart, at least `least` on every object; all objects count for something."""
    points, normals, objects, worth = [], [], [], []
    for obj in range(len(scenery.objects)):
        surface = surface_of([part for part, owner in zip(scenery.parts, scenery.object_of, strict=True) if owner == obj])
        area = surface_area(surface.vertices, surface.faces)
        if area <= 0:
            continue
        structure = scenery.objects[obj].category in STRUCTURE
        count = int(np.clip(area / spacing_m**2 * (0.35 if structure else 1.0), 12 if structure else least, 3000))
        at, _, normal = sample_surface(surface, count, rng)
        points.append(at)
        normals.append(normal)
        objects.append(np.full(count, obj))
        worth.append(np.full(count, 0.6 if structure else 1.0 + 20.0 / count))
    return Targets(np.concatenate(points), np.concatenate(normals), np.concatenate(objects), np.concatenate(worth))


def standpoints(scene: RayScene, scenery: Scenery, config: ScannerConfig, rng: np.random.Generator) -> Array:
    """Where one can stand: free floor, an arm's length from anything at eye height, about `standpoint_spacing_m` apart.

    Returns:
        Eye positions in the world frame [m], shape (n, 3), thinned to `standpoint_limit`.

    Raises:
        InputError: no floor is free.
    """
    bounds = np.array([[part.bounds[0] for part in scenery.parts], [part.bounds[1] for part in scenery.parts]])
    low, high = bounds[0].min(axis=0), bounds[1].max(axis=0)
    step = 0.2
    xs, ys = np.arange(low[0] + 0.5 * step, high[0], step), np.arange(low[1] + 0.5 * step, high[1], step)
    grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1)
    eye = 1.5
    down = np.zeros((*grid.shape[:2], 6), dtype=np.float32)
    down[..., :2], down[..., 2], down[..., 5] = grid, eye, -1.0
    ground = eye - scene.cast(down)["t_hit"]
    free = np.isfinite(ground) & (ground > -0.05) & (ground < 0.1)
    clear = _erode(free, int(np.ceil(config.body_radius_m / step)))
    if not clear.any():
        clear = _erode(free, 1) if _erode(free, 1).any() else free
    cells = grid[clear]
    if not len(cells):
        raise InputError("scene", "floor", "nowhere in it can one stand", "the floor must lie at z = 0, +Z up, in metres")
    chosen: list[int] = []
    spacing = config.standpoint_spacing_m
    for index in rng.permutation(len(cells)):
        if all((cells[index] - cells[other]) @ (cells[index] - cells[other]) > spacing**2 for other in chosen):
            chosen.append(int(index))
        if len(chosen) == config.standpoint_limit:
            break
    heights = rng.uniform(config.eye_low_m, config.eye_high_m, len(chosen))
    return np.column_stack([cells[chosen], heights])


def plan_views(scene: RayScene, scenery: Scenery, targets: Targets, config: ScannerConfig, rng: np.random.Generator) -> list[Array]:
    """Camera poses (camera to world, 4x4, OpenCV axes) in the order of a walk, at most `view_limit` of them."""
    from scipy.sparse import csr_matrix

    eyes = standpoints(scene, scenery, config, rng)
    poses: list[Array] = []
    rows, columns, values = [], [], []
    for eye in eyes:
        index, quality = looks(scene, targets, eye, config)
        if not len(index):
            continue
        for pose in directions(eye, config, rng):
            camera = Camera.with_fov(pose, config.depth_width, config.depth_height, config.fov_radians)
            pixel, depth = camera.project(targets.points[index])
            inside = (depth > 0) & (pixel >= 4).all(axis=1) & (pixel[:, 0] < camera.width - 4) & (pixel[:, 1] < camera.height - 4)
            columns.append(index[inside])
            values.append(quality[inside])
            rows.append(np.full(int(inside.sum()), len(poses)))
            poses.append(pose)
    if not poses:
        raise InputError("scene", "surfaces", "nothing can be seen from its free floor", "is it in metres?")
    shape = (len(poses), len(targets.points))
    seen = csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    chosen = _greedy(seen, targets.worth, config)
    return [poses[i] for i in walk(np.array([poses[i][:3, 3] for i in chosen]), chosen)]


def directions(eye: Array, config: ScannerConfig, rng: np.random.Generator) -> list[Array]:
    """Looks around from one place: all the way round at three pitches, a little irregular as hands are."""
    directions = []
    for pitch in np.radians(config.pitches_degrees):
        offset = rng.uniform(0, 2 * np.pi)
        for k in range(config.yaws):
            yaw = offset + 2 * np.pi * k / config.yaws + rng.normal(0, 0.05)
            tilt = pitch + rng.normal(0, 0.05)
            ahead = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), np.sin(tilt)])
            directions.append(look_at(eye, eye + ahead))
    return directions


def looks(scene: RayScene, targets: Targets, eye: Array, config: ScannerConfig) -> tuple[NDArray[np.int64], Array]:
    """Targets that an eye sees within the sensor's range, and how well, 0..1."""
    ray = targets.points - eye
    distance = np.linalg.norm(ray, axis=1)
    cosine = np.abs(np.einsum("nd,nd->n", ray, targets.normals)) / np.maximum(distance, 1e-9)
    near = np.flatnonzero((distance > config.min_range_m) & (distance < config.max_range_m) & (cosine > 0.15))
    if not len(near):
        return near, np.zeros(0)
    rays = np.column_stack([np.tile(eye, (len(near), 1)), ray[near] / distance[near, None]]).astype(np.float32)
    hit = scene.cast(rays)["t_hit"]
    visible = near[hit > distance[near] - 0.02]
    quality = np.minimum(1.0, 1.6 * cosine[visible]) * np.minimum(1.0, 2.2 / distance[visible])
    return visible, quality


def _greedy(seen: object, worth: Array, config: ScannerConfig) -> list[int]:
    """Views that add most, one after another, until little is to be gained."""
    wanted = config.looks_wanted
    have = np.zeros(len(worth))
    chosen: list[int] = []
    indptr, indices, data = seen.indptr, seen.indices, seen.data  # type: ignore[attr-defined]
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    first = None
    while len(chosen) < config.view_limit:
        gain = np.minimum(data, np.maximum(wanted - have[indices], 0.0)) * worth[indices]
        totals = np.bincount(rows, gain, minlength=len(indptr) - 1)
        totals[chosen] = 0.0
        best = int(totals.argmax())
        first = first or float(totals[best])
        if totals[best] < config.least_gain * first or totals[best] <= 0:
            break
        chosen.append(best)
        span = slice(indptr[best], indptr[best + 1])
        have[indices[span]] += data[span]
    return chosen


def walk(eyes: Array, chosen: list[int]) -> list[int]:
    """The chosen views in the order of a walk: always on to the nearest place that is left."""
    left = list(range(len(chosen)))
    order = [left.pop(0)]
    while left:
        distance = np.linalg.norm(eyes[left] - eyes[order[-1]], axis=1)
        order.append(left.pop(int(distance.argmin())))
    return [chosen[i] for i in order]


def _erode(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    from scipy.ndimage import binary_erosion

    reach = np.arange(-radius, radius + 1)
    disc = reach[:, None] ** 2 + reach[None] ** 2 <= radius**2
    return np.asarray(binary_erosion(mask, disc, border_value=0), dtype=np.bool_)
