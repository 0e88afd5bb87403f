"""Objects in known poses, as a scan shows them: what a few frames from one side saw, with a depth sensor's noise."""

from __future__ import annotations

import dataclasses
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.realdata import MODELS
from tasks.alignment import AlignmentConfig, Fit, Sample, ScannedInstance, make_target, sample_of, sight_of
from tasks.alignment.distances import disc_distances
from tasks.alignment.samples import turned
from tasks.capture.instances.boxes import oriented_box
from tasks.furniture import CATEGORIES, generate
from tasks.geometry.meshes import Surface, canonical, load_glb, sample_surface, surface_of
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import inverse, look_at, transform_points, yaw_of, yaw_pose
from tasks.scanner import ScannerConfig
from tasks.scanner.scenery import Paint
from tasks.scanner.sensor import depth_camera, shoot

if TYPE_CHECKING:
    from tasks.scanner.sensor import Shot

Array = NDArray[np.float64]

STRETCH = 1.25
"""The truth's scales are drawn from its inverse to it, on each axis."""

ASIDE_RADIANS = 0.45
"""Frames are taken from the middle and this much to both sides: what looks away from all of them is not seen."""

FLOOR_M = 0.05
"""A scan that ends this near the floor stands on it, as selection has it."""

LEAST_POINTS = 40
"""Of an object that counts: a scan's instance with fewer is not annotated."""

YAWS = 72
"""Turns at which an object is held against itself: every 5 degrees."""

ALIKE_MEAN, ALIKE_MOST = 0.005, 0.02
"""Of the diagonal: two surfaces nearer to each other than this, on average and at 98 of 100 points, are the same to a scan."""


@dataclasses.dataclass(frozen=True)
class PosedObject:
    """An object and where it is. surface: The asset, canonical; yaw, offset, scale: asset to world [rad, m]."""

    name: str
    surface: Surface
    yaw: float
    offset: Array
    scale: Array

    @property
    def placed(self) -> Surface:
        """Its surface in the world frame [m]."""
        return self.surface.transformed(yaw_pose(self.yaw, self.offset), self.scale)

    @property
    def diagonal(self) -> float:
        """Of its box as it stands [m]."""
        return float(np.linalg.norm(np.ptp(self.surface.vertices, axis=0) * self.scale))


@dataclasses.dataclass(frozen=True)
class Seen:
    """What a scan has of an object. frame: Instance to world, 4x4 [m]; target: as alignment takes it."""

    frame: Array
    target: ScannedInstance


def generated(index: int, seed: int) -> PosedObject:
    """A model of the generator in a random pose; indices go round the categories."""
    category = CATEGORIES[index % len(CATEGORIES)]
    rng = np.random.default_rng([seed, index, zlib.crc32(category.encode())])
    return in_some_pose(f"{category} {index // len(CATEGORIES)}", surface_of(canonical(generate(category, None, rng).parts)), rng)


def by_others(folder: Path) -> list[Path]:
    """Files of the models below a folder of real data; none where it has none."""
    return sorted((folder / MODELS).glob("*.glb"))


def of_file(file: Path, seed: int) -> PosedObject:
    """A model by others in a random pose."""
    rng = np.random.default_rng([seed, zlib.crc32(file.stem.encode())])
    return in_some_pose(file.stem, surface_of(canonical(load_glb(file.read_bytes(), file.name))), rng)


def in_some_pose(name: str, surface: Surface, rng: np.random.Generator) -> PosedObject:
    """A surface in a random yaw, place and scale, stretched along its axes."""
    scale = np.exp(rng.uniform(-np.log(STRETCH), np.log(STRETCH), 3))
    return PosedObject(name, surface, float(rng.uniform(-np.pi, np.pi)), np.array([*rng.uniform(-3, 3, 2), 0.0]), scale)


def scanned(posed: PosedObject, rng: np.random.Generator, config: AlignmentConfig) -> Seen | None:
    """The object as three frames from one side saw it; None where they saw next to nothing of it."""
    placed = posed.placed
    scene = RayScene([placed.to_trimesh()])
    middle, sensor = placed.bounds.mean(axis=0), ScannerConfig()
    away = float(np.clip(1.6 * posed.diagonal, 0.7, 0.9 * sensor.max_range_m))
    azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(0.25, 0.7)
    paint, clouds, cameras = Paint(scene), [], []
    for turn in (0.0, -ASIDE_RADIANS, ASIDE_RADIANS):
        around = [np.cos(azimuth + turn) * np.cos(elevation), np.sin(azimuth + turn) * np.cos(elevation), np.sin(elevation)]
        camera = look_at(middle + away * np.array(around), middle)
        cameras.append(camera)
        clouds.append(_points(shoot(scene, paint, camera, camera, sensor, rng), sensor))
    points = _thinned(np.concatenate(clouds), min(sensor.voxel_m, posed.diagonal / 30))
    if len(points) < LEAST_POINTS:
        return None
    return instance(points, rng, config, cameras[0])


def whole(posed: PosedObject, rng: np.random.Generator, config: AlignmentConfig) -> Seen:
    """The object seen from everywhere, without noise."""
    points, _, _ = sample_surface(posed.placed, 20_000, rng)
    return instance(points, rng, config, None, is_noisy=False)


def instance(points: Array, rng: np.random.Generator, config: AlignmentConfig, camera: Array | None, is_noisy: bool = True) -> Seen:
    """Points in the world, shape (n, 3) [m], as capture boxes them and selection hands them to alignment."""
    box, size = oriented_box(points, is_noisy)
    bottom, top = box[2, 3] - 0.5 * size[2], box[2, 3] + 0.5 * size[2]
    hidden = max(bottom, 0.0) if bottom > FLOOR_M else 0.0  # capture sees that nothing stands in the air
    frame = yaw_pose(yaw_of(box), [box[0, 3], box[1, 3], 0.0])
    local = transform_points(points, inverse(frame))
    colors = np.full((len(points), 3), 128, dtype=np.uint8)
    extent = np.array([size[0], size[1], top])
    target = make_target(local, colors, extent, config, rng, (0, 0, 0, 0, hidden, 0) if hidden else None)
    return Seen(frame, dataclasses.replace(target, sight=None if camera is None else sight_of(camera, frame, float(extent[2]))))


def same_turns(posed: PosedObject, rng: np.random.Generator) -> tuple[float, ...] | None:
    """Turns about its axis after which the object, with the scale that its box asks for then, is where it was [rad], 0 among them;
    None where nearly all are: it is round.

    Of turns beside each other the best stands for all, so that what is nearly round at one place is not right a little aside.
    """
    sample = sample_of(posed.surface, AlignmentConfig(samples=2048), rng)
    other = sample_of(posed.surface, AlignmentConfig(samples=1024), rng)
    truth = Fit(0.0, np.zeros(3), posed.scale)
    still, normals, radius = sample.placed(truth)
    apart = np.full(YAWS, np.inf)
    for index in range(YAWS):
        yaw = 2 * np.pi * index / YAWS
        around = turned(yaw)
        scale = np.ptp(still @ around, axis=0) / np.maximum(np.ptp(sample.points, axis=0), 1e-6)
        moved, tilted, wide = other.placed(Fit(yaw, np.zeros(3), scale))
        if disc_distances(moved[:128], still, normals, radius).mean() > 2 * ALIKE_MEAN * posed.diagonal:
            continue  # a look at few points settles most turns
        out = disc_distances(moved, still, normals, radius)
        back = disc_distances(still[:1024], moved, tilted, wide)
        both = np.concatenate([out, np.maximum(back - 0.5 * wide, 0.0)]) / posed.diagonal
        if both.mean() <= ALIKE_MEAN and np.quantile(both, 0.98) <= ALIKE_MOST:
            apart[index] = both.mean()
    alike = np.isfinite(apart)
    alike[0] = True
    if alike.mean() > 0.9:
        return None
    apart[0] = 0.0
    best = []
    starts = [i for i in range(YAWS) if alike[i] and not alike[i - 1]]
    for start in starts:
        run = [start]
        while alike[(run[-1] + 1) % YAWS]:
            run.append((run[-1] + 1) % YAWS)
        best.append(min(run, key=lambda i: (apart[i], i)))
    return tuple(2 * np.pi * index / YAWS for index in sorted(best))


def camera_made(posed: PosedObject, seen: Seen) -> PosedObject:
    """The same object as an image-to-3D model makes it: its front is what the camera saw, its proportions are right, its size is not."""
    assert seen.target.sight is not None
    facing = yaw_of(seen.frame) + seen.target.sight.azimuth
    size = float(np.prod(posed.scale)) ** (1 / 3)
    surface = posed.surface.transformed(yaw_pose(posed.yaw - facing), posed.scale / size)
    low, high = surface.bounds
    shift = np.array([*(0.5 * (low + high)[:2]), low[2]])
    moved = surface.transformed(yaw_pose(0.0, -shift))
    return PosedObject(posed.name, moved, facing, posed.offset + size * turned(facing) @ shift, np.full(3, size))


def sampled(posed: PosedObject, config: AlignmentConfig, rng: np.random.Generator) -> Sample:
    """Samples of the asset, as selection takes them."""
    return sample_of(posed.surface, config, rng)


def _points(shot: Shot, sensor: ScannerConfig) -> Array:
    """Points in the world of a frame's depths [m], shape (n, 3)."""
    rays = depth_camera(shot.pose, sensor).rays().astype(np.float64)
    seen = shot.depth > 0
    return rays[seen][:, :3] + rays[seen][:, 3:] * (shot.depth[seen] / 1000.0)[:, None]


def _thinned(points: Array, cell: float) -> Array:
    """Means of the points in each cube of a grid, shape (n, 3): what fusing frames leaves of their noise."""
    _, where, counts = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(where.ravel(), weights=points[:, axis]) for axis in range(3)], axis=1)
    return sums / counts[:, None]
