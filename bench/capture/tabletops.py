"""Single depth frames of a table with things that stand apart, touch, are stacked and lie in one another: every pixel's owner is known."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects.lifting import DepthView
from tasks.furniture import generate
from tasks.furniture.tops.sizes import SMALL, typical_size
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import look_at, yaw_pose
from tasks.scanner import ScannerConfig
from tasks.scanner.scenery import Paint
from tasks.scanner.sensor import depth_camera, shoot

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

SENSOR = ScannerConfig(depth_width=640, depth_height=480, color_width=640, color_height=480, depth_noise_per_m=0.0019)
"""A structured-light sensor's full frame with the noise of a single one: 1.2 mm + 1.9 mm (z - 0.4 m)^2."""

PITCHES_DEGREES = (20.0, 70.0)
"""How far cameras look down, least and most."""

AWAY_M = (0.65, 1.2)
"""From the camera to the middle of what stands on the table, least and most [m]."""

COUNTS = (4, 12)
"""Fewest and most objects of a frame."""

KINDS = {"apart": 0.15, "touching": 0.3, "stacked": 0.3, "nested": 0.25}
"""How objects come to the table, and how often."""

FLAT = ("box", "book", "tissue box", "speaker")
"""What things are stacked on."""

VESSELS = ("bowl", "storage bin", "basket", "pot", "plate", "tray", "pan")
"""What things lie in."""

CONTENTS = ("ball", "box", "can", "mouse", "cup", "candle", "remote control", "toilet paper")
"""What lies in them."""

OTHERS = ("bottle", "camera", "clock", "jar", "kettle", "mug", "soap dispenser", "telephone", "toaster", "vase")
"""What stands alone or against another thing."""

CLEAR_M = 0.02
"""Least distance in plan between things that do not touch [m]."""

SPREAD_M = (0.24, 0.34)
"""Half the depth and width of the part of the table that things stand on [m]."""

SUPPORT, REST = -1, -2
"""Owners of pixels that are no object's: the table's top, and everything else."""

_TRIES = 80
_RAYS = 28
"""Rays along a side of a plan, by which a thing is let down on others."""


@dataclasses.dataclass(frozen=True)
class TabletopFrame:
    """A frame and its truth.

    view: Its pose is the true one, world frame, +Z up, floor at z = 0. owner: Object of each pixel, `SUPPORT` or `REST`, shape (h, w).
    words: Of the objects. kinds: How each came to the table. height_m: Of the table's top in the world frame.
    """

    view: DepthView
    owner: NDArray[np.int64]
    words: tuple[str, ...]
    kinds: tuple[str, ...]
    height_m: float
    pitch: float


@dataclasses.dataclass(frozen=True)
class _Thing:
    """Parts in the world frame, their outline in plan as a shapely polygon, and what it came on, -1 for the table."""

    word: str
    kind: str
    parts: tuple[trimesh.Trimesh, ...]
    outline: object
    yaw: float
    middle: tuple[float, float]
    size: tuple[float, float, float]
    base: int


def tabletop_frame(number: int, of: int, seed: int) -> TabletopFrame:
    """One of `of` frames; their pitches are spread evenly over `PITCHES_DEGREES`."""
    rng = np.random.default_rng([seed, number, 22])
    size = typical_size("table", rng)
    table = tuple(generate("table", size, rng).parts)
    objects = _things(int(rng.integers(COUNTS[0], COUNTS[1] + 1)), size[2], size, rng)
    parts, owner = [*table, *_surroundings(size, rng)], []
    for index, item in enumerate(objects):
        parts += item.parts
        owner += [index] * len(item.parts)
    owner = [SUPPORT] * len(table) + [REST] * (len(parts) - len(table) - len(owner)) + owner
    low, high = (math.radians(value) for value in PITCHES_DEGREES)
    pitch = low + (high - low) * (number + float(rng.uniform())) / of
    turn, away = float(rng.uniform(-0.6, 0.6)), float(rng.uniform(*AWAY_M))
    target = np.array([*rng.uniform(-0.05, 0.05, 2), size[2] + 0.05])
    back = np.array([math.cos(pitch) * math.cos(turn), math.cos(pitch) * math.sin(turn), math.sin(pitch)])
    camera = look_at(target + away * back, target)
    scene = RayScene(parts)
    shot = shoot(scene, Paint(scene), camera, camera, SENSOR, rng)
    lens = depth_camera(camera, SENSOR)
    hits = scene.cast(lens.rays())
    hit = np.isfinite(hits["t_hit"])
    mine = np.array([*owner, REST])[np.where(hit, hits["geometry_ids"].astype(np.int64), len(owner))]
    points = camera[:3, 3] + hits["t_hit"][..., None].astype(np.float64) * lens.rays()[..., 3:]
    is_top = (mine == SUPPORT) & (np.abs(np.where(hit, points[..., 2], 0.0) - size[2]) < 0.001)
    mine = np.where((mine == SUPPORT) & ~is_top, REST, mine)
    view = DepthView(f"{number:06d}", (shot.depth / 1000.0).astype(np.float32), shot.color, (lens.fx, lens.fy, lens.cx, lens.cy), camera)
    words, kinds = tuple(item.word for item in objects), tuple(item.kind for item in objects)
    return TabletopFrame(view, mine, words, kinds, size[2], pitch)


def _things(wanted: int, top: float, size: tuple[float, float, float], rng: np.random.Generator) -> list[_Thing]:
    """Objects on the table, in its frame."""
    objects: list[_Thing] = []
    for _ in range(20 * wanted):
        if len(objects) == wanted:
            break
        kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
        item = _next(kind, objects, top, size, rng)
        if item is not None:
            objects.append(item)
    return objects


def _next(
    kind: str, objects: list[_Thing], top: float, size: tuple[float, float, float], rng: np.random.Generator
) -> _Thing | None:  # fmt: skip
    """Another thing, where there is room for it; what is to carry one comes first."""
    carried = {item.base for item in objects}
    carriers = {"stacked": FLAT, "nested": VESSELS}.get(kind)
    bases = [i for i, item in enumerate(objects) if carriers and item.word in carriers and i not in carried]
    words = {"nested": CONTENTS, "stacked": (*FLAT, *CONTENTS)}.get(kind, (*FLAT, *VESSELS, *CONTENTS, *OTHERS))
    base = int(rng.choice(bases)) if bases else -1
    if carriers and not bases:
        kind, words = "apart", carriers
    word = str(rng.choice(words))
    extents = np.array(SMALL[word].extents) * rng.uniform(0.85, 1.15, 3)
    if kind == "nested":
        extents *= min(1.0, 0.5 * min(objects[base].size[:2]) / max(extents[:2]))
    made = (float(extents[0]), float(extents[1]), float(extents[2]))
    parts = generate(word, made, rng).parts
    for _ in range(_TRIES):
        yaw, x, y = _spot(kind, objects, base, made, rng)
        outline = _outline(made, x, y, yaw)
        if not _has_room(kind, outline, objects, base, size):
            continue
        placed = []
        for part in parts:
            moved = part.copy()
            moved.apply_transform(yaw_pose(yaw, [x, y, 0.0]))
            placed.append(moved)
        rest = top if base < 0 else _rest(placed, objects[base].parts, top)
        if rest is None or (kind == "nested" and rest > top + objects[base].size[2] - 0.004):
            return None
        for part in placed:
            part.apply_translation([0.0, 0.0, rest])
        return _Thing(word, kind, tuple(placed), outline, yaw, (x, y), made, base)
    return None


def _spot(
    kind: str, objects: list[_Thing], base: int, size: tuple[float, float, float], rng: np.random.Generator
) -> tuple[float, float, float]:  # fmt: skip
    """Yaw and place in plan, on the table where base is -1."""
    if base >= 0:
        off = 0.0 if kind == "nested" else 0.1
        x, y = (m + off * float(rng.uniform(-1, 1)) * min(objects[base].size[:2]) for m in objects[base].middle)
        return objects[base].yaw + float(rng.uniform(-0.4, 0.4)), x, y
    standing = [item for item in objects if item.base < 0]
    if kind == "touching" and standing:
        anchor = standing[int(rng.integers(len(standing)))]
        axis, sign = int(rng.integers(2)), int(rng.choice((-1, 1)))
        offset = np.zeros(2)
        offset[axis] = sign * (0.5 * (anchor.size[axis] + size[axis]) + float(rng.uniform(2e-4, 1e-3)))
        offset[1 - axis] = float(rng.uniform(-0.3, 0.3)) * min(anchor.size[1 - axis], size[1 - axis])
        c, s = math.cos(anchor.yaw), math.sin(anchor.yaw)
        return anchor.yaw, anchor.middle[0] + c * offset[0] - s * offset[1], anchor.middle[1] + s * offset[0] + c * offset[1]
    x, y = (float(rng.uniform(-limit, limit)) for limit in SPREAD_M)
    return float(rng.uniform(-math.pi, math.pi)), x, y


def _outline(size: tuple[float, float, float], x: float, y: float, yaw: float) -> object:
    from shapely.geometry import Polygon

    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 0.5 * np.array(size[:2])
    c, s = math.cos(yaw), math.sin(yaw)
    return Polygon(corners @ np.array([[c, s], [-s, c]]) + [x, y])


def _has_room(kind: str, outline: object, objects: list[_Thing], base: int, size: tuple[float, float, float]) -> bool:
    """Whether a plan lies on the table, or within what carries it, clear of the others there."""
    from shapely.geometry import box

    if base >= 0:
        return bool(objects[base].outline.buffer(0.005).contains(outline))  # type: ignore[attr-defined]
    if not box(-0.5 * size[0], -0.5 * size[1], 0.5 * size[0], 0.5 * size[1]).contains(outline):
        return False
    clear = 1e-4 if kind == "touching" else CLEAR_M
    return all(outline.distance(item.outline) >= clear for item in objects if item.base < 0)  # type: ignore[attr-defined]


def _rest(parts: list[trimesh.Trimesh], below: tuple[trimesh.Trimesh, ...], top: float) -> float | None:
    """Level of the bottom of parts, which have it at z = 0, when they are let down on others or the table; None where they would tip."""
    low = np.min([part.bounds[0] for part in parts], axis=0)
    high = np.max([part.bounds[1] for part in parts], axis=0)
    x, y = np.meshgrid(np.linspace(low[0], high[0], _RAYS), np.linspace(low[1], high[1], _RAYS))
    start = np.stack([x.ravel(), y.ravel(), np.full(x.size, -1.0)], axis=1)
    under = RayScene(parts).cast(np.hstack([start, np.tile([0.0, 0.0, 1.0], (x.size, 1))]).astype(np.float32))["t_hit"] - 1.0
    start[:, 2] = top + 2.0
    over = top + 2.0 - RayScene(below).cast(np.hstack([start, np.tile([0.0, 0.0, -1.0], (x.size, 1))]).astype(np.float32))["t_hit"]
    level = np.where(np.isfinite(over), over, top) - under
    level = level[np.isfinite(under)]
    if not len(level):
        return None
    rest = float(level.max())
    touched = start[np.isfinite(under), :2][level > rest - 0.003]
    middle = 0.5 * (low + high)[:2]
    balanced = (touched.min(axis=0) < middle).all() and (touched.max(axis=0) > middle).all()
    return rest + 2e-4 if balanced or len(touched) < 4 else None


def _surroundings(size: tuple[float, float, float], rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A floor, and a wall some way behind the table."""
    import trimesh

    floor = trimesh.creation.box((8.0, 8.0, 0.02))
    floor.apply_translation([0.0, 0.0, -0.01])
    wall = trimesh.creation.box((0.02, 8.0, 2.6))
    wall.apply_translation([-0.5 * size[0] - float(rng.uniform(0.05, 1.5)), 0.0, 1.3])
    for part in (floor, wall):
        part.visual.vertex_colors = np.array([*rng.integers(120, 240, 3), 255], dtype=np.uint8)
    return [floor, wall]
