"""Desks and shelves with small objects, seen in posed depth frames: what is true of every pixel and point is known."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects.lifting import DepthView, voxel_first
from tasks.furniture import generate
from tasks.furniture.tops.sizes import SMALL, surface, typical_size
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import look_at, yaw_pose
from tasks.scanner import ScannerConfig
from tasks.scanner.scenery import Paint
from tasks.scanner.sensor import depth_camera, drift, shoot

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

SupportWord = Literal["desk", "bookshelf"]

COUNTS = (6, 15)
"""Fewest and most objects on a support."""

APART_M = 0.04
"""Least distance in plan between objects that stand apart [m]."""

CONTACT_M = 0.001
"""Largest distance between objects that touch [m]: less than a sensor tells."""

TOUCHING_SHARE = 0.7
"""Share of the objects, but for the first, that are set against another one where objects touch."""

TRUE_VOXEL_M = 0.01
"""Distance of the points that an instance is held against [m]."""

LEAST_PIXELS, LEAST_VIEWS = 60, 3
"""An object counts when so many views show so many pixels of it: less cannot be known from these frames."""

_TRIES = 60

_CARRIED = {"cushion", "pillow", "tv", "computer tower", "blanket", "clothes", "towel"}
"""Not drawn: too large for a desk, or cloth that lies where it falls."""


@dataclasses.dataclass(frozen=True)
class Tabletop:
    """A support with what stands on it. views: Frames with poses as a tracker believes them, world frame, floor at z = 0.

    owner: Of each frame, the object of each pixel, shape (h, w), -1 for the support and -2 for the rest. points: True points of each
    object, and of the support as the last one [m], shapes (n, 3), no noise. words: Of the objects. box_pose, box_size: The support's.
    support_points: What an instance of the support has, at 2 cm, its objects not among them [m], shape (n, 3).
    """

    word: SupportWord
    views: tuple[DepthView, ...]
    owner: tuple[NDArray[np.int64], ...]
    points: tuple[Array, ...]
    words: tuple[str, ...]
    box_pose: Array
    box_size: Array
    support_points: Array
    extents: tuple[tuple[float, float, float], ...]

    @property
    def counted(self) -> list[int]:
        """Objects that enough views show."""
        pixels = np.array([[(owner == i).sum() for owner in self.owner] for i in range(len(self.words))])
        return [i for i in range(len(self.words)) if (pixels[i] >= LEAST_PIXELS).sum() >= LEAST_VIEWS]

    def masks(self, frame: int) -> tuple[Bools, list[int]]:
        """True masks of a frame, shape (n, h, w), and the objects that they are of."""
        own = [i for i in range(len(self.words)) if (self.owner[frame] == i).any()]
        return np.array([self.owner[frame] == i for i in own]).reshape(len(own), *self.owner[frame].shape), own


@dataclasses.dataclass(frozen=True)
class _Place:
    """Where an object stands in the support's frame: middle, yaw, level, extents [m]."""

    word: str
    x: float
    y: float
    yaw: float
    bottom: float
    size: tuple[float, float, float]

    def polygon(self, margin: float = 0.0) -> object:
        from shapely.geometry import Polygon

        a, b = 0.5 * self.size[0] + margin, 0.5 * self.size[1] + margin
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Polygon([(self.x + c * u - s * v, self.y + s * u + c * v) for u, v in ((-a, -b), (a, -b), (a, b), (-a, b))])


def tabletop(word: SupportWord, touching: bool, seed: int, views: int = 12, config: ScannerConfig | None = None) -> Tabletop:
    """A desk or shelf with 6 to 15 objects that stand apart, or of which most touch another one."""
    config = config or ScannerConfig()
    rng = np.random.default_rng([seed, int(touching), len(word)])
    size = typical_size(word, rng)
    places = _placed(word, size, touching, rng)
    pose = yaw_pose(float(rng.uniform(-math.pi, math.pi)), [*rng.uniform(1.0, 3.0, 2), 0.0])
    parts: list[trimesh.Trimesh] = []
    owner: list[int] = []
    for index, (name, at, extents) in enumerate(
        [(word, np.eye(4), size), *((p.word, yaw_pose(p.yaw, [p.x, p.y, p.bottom]), p.size) for p in places)]
    ):
        for part in generate(name, extents, rng).parts:
            part.apply_transform(pose @ at)
            parts.append(part)
            owner.append(index - 1)
    for part in _surroundings(size, rng):
        part.apply_transform(pose)
        parts.append(part)
        owner.append(-2)
    scene = RayScene(parts)
    paint, of_part = Paint(scene), np.array([*owner, -2])
    frames, owners, clouds = [], [], []
    offs = drift(views, config, rng)
    for number in range(views):
        eye, target = _eye(word, size, number / max(views - 1, 1), rng)
        camera = pose @ look_at(eye, target)
        shot = shoot(scene, paint, camera, camera @ offs[number], config, rng)
        lens = depth_camera(camera, config)
        hits = scene.cast(lens.rays())
        hit = np.isfinite(hits["t_hit"])
        mine = of_part[np.where(hit, hits["geometry_ids"].astype(np.int64), len(owner))]
        depth = (shot.depth / 1000.0).astype(np.float32)
        frames.append(DepthView(f"{number:06d}", depth, shot.color, (lens.fx, lens.fy, lens.cx, lens.cy), shot.pose))
        owners.append(np.where(depth > 0, mine, -2))
        exact = DepthView("", np.where(hit, hits["t_hit"], 0).astype(np.float32), shot.color, frames[-1].intrinsics, camera)
        clouds.append((exact.points()[owners[-1] > -2], owners[-1][owners[-1] > -2]))
    everything, whose = np.concatenate([c for c, _ in clouds]), np.concatenate([w for _, w in clouds])
    true = [_thinned(everything[whose == index], TRUE_VOXEL_M) for index in (*range(len(places)), -1)]
    box = pose @ yaw_pose(0.0, [0.0, 0.0, 0.5 * size[2]])
    return Tabletop(
        word, tuple(frames), tuple(owners), tuple(true), tuple(p.word for p in places), box, np.array(size), _thinned(true[-1], 0.02),
        tuple(p.size for p in places),
    )  # fmt: skip


def _thinned(points: Array, voxel: float) -> Array:
    return points[voxel_first(points, voxel)]


def _placed(word: SupportWord, size: tuple[float, float, float], touching: bool, rng: np.random.Generator) -> list[_Place]:
    """Objects on the levels of a support."""
    from shapely.geometry import box

    top = surface(word, size)
    wanted, area = int(rng.integers(COUNTS[0], COUNTS[1] + 1)), box(top.x[0] + 0.004, top.y[0] + 0.004, top.x[1] - 0.004, top.y[1] - 0.004)
    words = sorted(set(SMALL) - _CARRIED)
    places: list[_Place] = []
    for _ in range(40 * wanted):
        if len(places) == wanted:
            break
        name = str(rng.choice(words))
        extents = tuple(float(v) for v in np.array(SMALL[name].extents) * rng.uniform(0.93, 1.07, 3))
        fits = [level for level, clear in top.levels if 0.35 < level < 1.6 and extents[2] + 0.02 < clear]
        if not fits or min(extents[:2]) > top.x[1] - top.x[0] - 0.01:
            continue
        for _ in range(_TRIES):
            place = _somewhere(name, extents, float(rng.choice(fits)), top.x, top.y, places, touching, rng)
            neighbors = [p for p in places if p.bottom == place.bottom]
            shape = place.polygon()
            clear = 1e-4 if touching else APART_M
            if area.contains(shape) and all(shape.distance(p.polygon()) >= clear for p in neighbors):  # type: ignore[attr-defined]
                places.append(place)
                break
    return places


def _somewhere(
    word: str, size: tuple[float, ...], bottom: float, x: tuple[float, float], y: tuple[float, float], places: list[_Place], touching: bool,
    rng: np.random.Generator,
) -> _Place:  # fmt: skip
    """A place by chance, or against an object that stands on the same level."""
    extents = (size[0], size[1], size[2])
    anchors = [p for p in places if p.bottom == bottom]
    if touching and anchors and rng.random() < TOUCHING_SHARE:
        anchor = anchors[int(rng.integers(len(anchors)))]
        side = int(rng.integers(4))
        axis, sign = side // 2, 1 - 2 * (side % 2)
        offset = np.zeros(2)
        offset[axis] = sign * (0.5 * (anchor.size[axis] + extents[axis]) + float(rng.uniform(2e-4, CONTACT_M)))
        offset[1 - axis] = float(rng.uniform(-0.25, 0.25)) * min(anchor.size[1 - axis], extents[1 - axis])
        c, s = math.cos(anchor.yaw), math.sin(anchor.yaw)
        return _Place(word, anchor.x + c * offset[0] - s * offset[1], anchor.y + s * offset[0] + c * offset[1], anchor.yaw, bottom, extents)
    turn = float(rng.choice(SMALL[word].bases)) + float(rng.uniform(-1, 1)) * min(SMALL[word].spread, 0.5)
    return _Place(word, float(rng.uniform(*x)), float(rng.uniform(*y)), turn, bottom, extents)


def _surroundings(size: tuple[float, float, float], rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A floor, and a wall behind the support."""
    import trimesh

    floor = trimesh.creation.box((6.0, 6.0, 0.02))
    floor.apply_translation([0.0, 0.0, -0.01])
    wall = trimesh.creation.box((0.02, 6.0, 2.6))
    wall.apply_translation([-0.5 * size[0] - 0.03, 0.0, 1.3])
    for part in (floor, wall):
        part.visual.vertex_colors = np.array([*rng.integers(120, 240, 3), 255], dtype=np.uint8)
    return [floor, wall]


def _eye(word: SupportWord, size: tuple[float, float, float], share: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Where a camera stands and what it looks at, in the support's frame: a person walks by and looks down, or from shelf to shelf."""
    if word == "desk":
        azimuth = math.radians(-75 + 150 * share + float(rng.uniform(-5, 5)))
        away, up = float(rng.uniform(0.85, 1.3)), float(rng.uniform(0.45, 0.9))
        target = np.array([0.0, float(rng.uniform(-0.25, 0.25)) * size[1], size[2] + 0.05])
    else:
        azimuth = math.radians(-45 + 90 * share + float(rng.uniform(-5, 5)))
        away, up = float(rng.uniform(1.1, 1.5)), float(rng.uniform(0.1, 0.6))
        target = np.array([0.0, 0.0, float(rng.uniform(0.45, 1.35))])
    return target + np.array([away * math.cos(azimuth), away * math.sin(azimuth), up]), target
