"""Training frames: supports with things that stand apart, touch or lie on each other, seen without noise from many places.

Depth, colors and owners are exact and noise is drawn whenever a frame is learned from, so that one frame is many. Seeds begin at
`FIRST_SEED`: what is measured on desks and shelves of lower seeds was never seen.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.models.trained.things import NAMELESS, Thing, drawn_thing
from tasks.furniture import generate
from tasks.furniture.tops.sizes import surface, typical_size
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at, yaw_pose
from tasks.scanner.scenery import Paint

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

FIRST_SEED = 10_000
"""Of scenes that are learned from."""

WIDTH, HEIGHT = 320, 240
"""Of a frame [px], as the virtual scanner's."""

SUPPORT, REST = -1, -2
"""Owners of pixels that are no thing's: the support's, and everything else's."""

TALL_M = 0.6
"""How far above a board without another one over it things are looked for [m]."""

_WORDS = (
    "desk", "desk", "desk", "table", "table", "table", "coffee table", "nightstand", "side table", "kitchen counter", "dresser",
    "tv stand", "cabinet", "bookshelf", "bookshelf", "bookshelf", "bookshelf", "floor",
)  # fmt: skip
_LARGEST_M = 0.9
_LEAST_PIXELS = 300
_NEAREST_M = 0.3
_TRIES = 25


@dataclasses.dataclass(frozen=True)
class TrainingFrame:
    """A frame without noise, in the support's frame: +Z up, the floor at z = 0.

    depth: [m], shape (h, w), 0 where nothing is. facing: Cosine of the angle under which a surface is seen, shape (h, w). color: RGB, shape
    (h, w, 3). owner: Thing of each pixel, `SUPPORT` or `REST`, shape (h, w). pose: OpenCV camera to that frame, 4x4 [m]. intrinsics: fx,
    fy, cx, cy [px]. boards: Heights and what is clear above them [m], shape (n, 2). half: Half extents of the support [m], shape (2,).
    categories: Of the things, see `Thing`.
    """

    depth: NDArray[np.float32]
    facing: NDArray[np.float32]
    color: NDArray[np.uint8]
    owner: NDArray[np.int16]
    pose: Array
    intrinsics: tuple[float, float, float, float]
    boards: Array
    half: Array
    categories: NDArray[np.int64]


@dataclasses.dataclass
class _Standing:
    """What stands on a board. top: Its height [m]. size: In plan [m]. carries: Whether something may lie on it."""

    level: float
    outline: object
    top: float
    size: tuple[float, float]
    carries: bool
    yaw: float


class _Scene:
    """A support being filled. parts, owner: Meshes and whose they are."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.word = rng, str(rng.choice(_WORDS))
        self.parts: list[trimesh.Trimesh] = []
        self.owner: list[int] = []
        self.standing: list[_Standing] = []
        self.categories: list[int] = []
        if self.word == "floor":
            self.size = (float(rng.uniform(1, 2)), float(rng.uniform(1, 2)), 0.0)
            x, y = 0.5 * self.size[0], 0.5 * self.size[1]
            self.x, self.y, self.levels = (-x, x), (-y, y), [(0.0, math.inf)]
        else:
            self.size = typical_size(self.word, rng)
            top = surface(self.word, self.size)
            self.x, self.y, self.levels = top.x, top.y, [level for level in top.levels if level[0] < 1.7]
            self.put(generate(self.word, self.size, rng).parts, np.eye(4), SUPPORT)

    def put(self, parts: Sequence[trimesh.Trimesh], pose: Array, owner: int) -> None:
        for part in parts:
            part.apply_transform(pose)
            self.parts.append(part)
            self.owner.append(owner)

    def fill(self) -> None:
        """Things by chance, crowded or not."""
        rng = self.rng
        fewest, most = {"bookshelf": (8, 28), "nightstand": (2, 7)}.get(self.word, (3, 20))
        wanted, crowd = int(rng.integers(fewest, most)), float(rng.random())
        focus = rng.uniform([self.x[0], self.y[0]], [self.x[1], self.y[1]])
        for _ in range(3 * wanted):
            if len(self.categories) == wanted:
                break
            new = drawn_thing(rng)
            level, clear = self.levels[int(rng.integers(len(self.levels)))]
            if new.size[2] + 0.01 > clear or max(new.size[:2]) > _LARGEST_M:
                continue
            touches = rng.random() < crowd
            pose = self._stacked(new, level, clear) if touches and rng.random() < 0.25 else None
            if pose is None:
                pose = self._beside(new, level, focus, touches)
            if pose is not None:
                self.put(new.parts, pose, len(self.categories))
                self.categories.append(new.category)

    def _stacked(self, new: Thing, level: float, clear: float) -> Array | None:
        """A place on something that carries it."""
        rng = self.rng
        bases = [each for each in self.standing if each.level == level and each.carries]
        if not bases:
            return None
        base = bases[int(rng.integers(len(bases)))]
        fits = new.size[0] * new.size[1] < 1.1 * base.size[0] * base.size[1] and base.top + new.size[2] - level < min(clear, TALL_M)
        if not fits:
            return None
        x, y = (float(value) for value in np.array(base.outline.centroid.coords[0]) + rng.uniform(-0.02, 0.02, 2))  # type: ignore[attr-defined]
        pose = yaw_pose(base.yaw + float(rng.choice([0, 0.5 * math.pi])) + float(rng.uniform(-0.2, 0.2)), [x, y, base.top + 0.0005])
        base.top, base.size, base.carries = base.top + new.size[2], (new.size[0], new.size[1]), new.size[2] < 0.2
        return pose

    def _beside(self, new: Thing, level: float, focus: Array, touches: bool) -> Array | None:
        """A free place on a board, or one against what stands there."""
        from shapely import affinity
        from shapely.geometry import box

        rng = self.rng
        neighbors = [each for each in self.standing if each.level == level]
        area = box(self.x[0] - 0.02, self.y[0] - 0.02, self.x[1] + 0.02, self.y[1] + 0.02)
        plain = box(-0.5 * new.size[0], -0.5 * new.size[1], 0.5 * new.size[0], 0.5 * new.size[1])
        for _ in range(_TRIES):
            straight = 0.5 * math.pi * float(rng.integers(4)) + float(rng.normal(0, 0.1))
            yaw = float(rng.uniform(-math.pi, math.pi)) if rng.random() < 0.5 else straight
            anchor = neighbors[int(rng.integers(len(neighbors)))] if touches and neighbors else None
            if anchor is not None and rng.random() < 0.7:
                yaw = anchor.yaw + float(rng.choice([0, 0.5 * math.pi]))
            turned = affinity.rotate(plain, yaw, use_radians=True, origin=(0, 0))
            if anchor is not None:
                at = _slid(turned, anchor, rng)
            elif rng.random() < 0.5:
                at = rng.uniform([self.x[0], self.y[0]], [self.x[1], self.y[1]])
            else:
                at = focus + rng.normal(0, 0.25, 2)
            outline = affinity.translate(turned, *at)
            apart = 1e-4 if touches else 0.01
            if area.contains(outline) and all(outline.distance(each.outline) >= apart for each in neighbors):
                top = level + new.size[2]
                self.standing.append(_Standing(level, outline, top, (new.size[0], new.size[1]), new.size[2] < 0.25, yaw))
                return yaw_pose(yaw, [float(at[0]), float(at[1]), level])
        return None

    def surround(self) -> None:
        """Floor and walls, and furniture that stands about."""
        import trimesh

        rng, x, y = self.rng, 0.5 * self.size[0], 0.5 * self.size[1]
        slabs = [((8.0, 8.0, 0.02), (0.0, 0.0, -0.0101), SUPPORT if self.word == "floor" else REST)]
        if rng.random() < 0.6:
            slabs.append(((0.02, 8.0, 2.6), (-x - float(rng.choice([0.02, 0.03, rng.uniform(0.05, 1)])), 0.0, 1.3), REST))
        if rng.random() < 0.3:
            slabs.append(((8.0, 0.02, 2.6), (0.0, float(rng.choice([-1, 1])) * (y + rng.uniform(0.02, 1)), 1.3), REST))
        for size, at, owner in slabs:
            slab = trimesh.creation.box(size)
            slab.visual.vertex_colors = np.tile(np.array([*rng.integers(60, 245, 3), 255], dtype=np.uint8), (len(slab.vertices), 1))
            slab.apply_translation(at)
            self.put([slab], np.eye(4), owner)
        if self.word == "floor" or rng.random() > 0.6:
            return
        for _ in range(int(rng.integers(1, 4))):
            word = str(rng.choice(["chair", "office chair", "trash can", "lamp", "box"]))
            size = (float(rng.uniform(0.35, 0.6)), float(rng.uniform(0.35, 0.6)), float(rng.uniform(0.3, 1.0)))
            place = [x + 0.3 + float(rng.uniform(0, 0.3)), float(rng.uniform(-y, y)), 0.0]
            self.put(generate(word, size, rng).parts, yaw_pose(float(rng.uniform(-3, 3)), place), REST)

    def camera(self) -> Camera:
        """Where somebody looks from: mostly down, at what stands there."""
        rng = self.rng
        pitch, distance, azimuth = float(rng.uniform(18, 70)), float(rng.uniform(0.6, 1.9)), float(rng.uniform(-1.4, 1.4))
        if self.word == "bookshelf":
            pitch, distance, azimuth = float(rng.uniform(-5, 50)), float(rng.uniform(0.8, 1.8)), float(rng.uniform(-0.9, 0.9))
        elif self.word == "floor":
            pitch, distance = float(rng.uniform(25, 70)), float(rng.uniform(0.9, 2.2))
        if self.word in ("table", "coffee table", "floor"):
            azimuth = float(rng.uniform(-math.pi, math.pi))
        seen = self.standing[int(rng.integers(len(self.standing)))]
        x, y = 0.7 * np.array(seen.outline.centroid.coords[0]) + rng.normal(0, 0.1, 2)  # type: ignore[attr-defined]
        target, slope = np.array([x, y, seen.level + 0.05]), math.radians(pitch)
        way = np.array([math.cos(azimuth) * math.cos(slope), math.sin(azimuth) * math.cos(slope), math.sin(slope)])
        pose, roll = look_at(target + distance * way, target), float(rng.normal(0, 0.08))
        turn = np.eye(4)
        turn[:2, :2] = [[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]]
        return Camera.with_fov(pose @ turn, WIDTH, HEIGHT, float(rng.uniform(0.9, 1.15)))


def training_frames(seed: int, views: int) -> list[TrainingFrame]:
    """Frames of a scene: as many as asked for, but for those that show hardly anything."""
    rng = np.random.default_rng([seed, 77])
    scene = _Scene(rng)
    scene.fill()
    scene.surround()
    if not scene.standing:
        return []
    rays = RayScene(scene.parts)
    look = _Look(rays, rng)
    owner = np.array([*scene.owner, REST])
    boards = np.array([(level, clear if math.isfinite(clear) else TALL_M) for level, clear in scene.levels])
    frames = []
    for _ in range(views):
        camera = scene.camera()
        hits = rays.cast(camera.rays())
        seen = np.isfinite(hits["t_hit"])
        mine = owner[np.where(seen, hits["geometry_ids"].astype(np.int64), len(scene.parts))]
        depth = np.where(seen, hits["t_hit"], 0).astype(np.float32)
        if (mine >= 0).sum() < _LEAST_PIXELS or (depth[seen] < _NEAREST_M).mean() > 0.2:
            continue
        facing = np.abs(hits["primitive_normals"] @ camera.pose[:3, 2].astype(np.float32))
        frames.append(
            TrainingFrame(
                depth, facing.astype(np.float32), look.colors(hits, camera), mine.astype(np.int16), camera.pose,
                (camera.fx, camera.fy, camera.cx, camera.cy), boards, 0.5 * np.array(scene.size[:2]),
                np.array(scene.categories or [NAMELESS]),
            )
        )  # fmt: skip
    return frames


class _Look:
    """Colors of a scene's parts, some of which have a pattern, under a light of its own."""

    def __init__(self, scene: RayScene, rng: np.random.Generator) -> None:
        count = len(scene.parts)
        self._paint = Paint(scene)
        self._waves = rng.uniform(8, 80, (count, 3)) * (rng.random((count, 3)) < 0.6)
        self._phase, self._is_hard = rng.uniform(0, 6, count), rng.random(count) < 0.5
        self._strength = np.where(rng.random(count) < 0.45, rng.uniform(0.05, 0.6, count), 0.0)
        self._tint = 0.5 + 0.5 * rng.uniform(-1, 1, (count, 3))
        light = rng.normal(size=3)
        light[2] = abs(light[2]) + 0.6
        self._light, self._ambient = light / np.linalg.norm(light), float(rng.uniform(0.4, 0.8))

    def colors(self, hits: dict[str, NDArray[np.generic]], camera: Camera) -> NDArray[np.uint8]:
        seen = np.isfinite(hits["t_hit"])
        part = hits["geometry_ids"][seen].astype(np.int64)
        base = self._paint.at(part, hits["primitive_ids"][seen].astype(np.int64), hits["primitive_uvs"][seen]).astype(np.float64)
        rays = camera.rays()[seen].astype(np.float64)
        at = rays[:, :3] + hits["t_hit"][seen].astype(np.float64)[:, None] * rays[:, 3:]
        wave = np.sin((at * self._waves[part]).sum(axis=1) + self._phase[part])
        wave = np.where(self._is_hard[part], np.sign(wave), wave) * self._strength[part]
        normal = hits["primitive_normals"][seen].astype(np.float64)
        normal *= np.where(normal @ camera.pose[:3, 2] > 0, -1.0, 1.0)[:, None]
        light = self._ambient + (1 - self._ambient) * np.maximum(normal @ self._light, 0)
        color = np.full((*seen.shape, 3), 220.0)
        color[seen] = base * (1 + wave[:, None] * self._tint[part]) * light[:, None]
        return np.clip(color, 0, 255).astype(np.uint8)


def _slid(outline: object, anchor: _Standing, rng: np.random.Generator) -> Array:
    """Where an outline at the origin comes to stand when it is slid away from an anchor until it is free of it, or a little further."""
    from shapely import affinity

    side = 0.5 * math.pi * float(rng.integers(4))
    angle = float(rng.uniform(0, 2 * math.pi)) if rng.random() < 0.4 else anchor.yaw + side
    start, way = np.array(anchor.outline.centroid.coords[0]), np.array([math.cos(angle), math.sin(angle)])  # type: ignore[attr-defined]
    low, high = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        if affinity.translate(outline, *(start + middle * way)).distance(anchor.outline) > 0:
            high = middle
        else:
            low = middle
    gap = float(rng.choice([0.0005, 0.0005, rng.uniform(0, 0.02)]))
    return np.asarray(start + (high + gap) * way)
