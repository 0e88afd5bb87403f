"""Pictures of scans beside their replicas, as a person sees a room who stands in it."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import shapely
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from flows.stats.scenes import SceneModel
from schemas.capture import Frame
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at, matrix
from tasks.shell import floor_ring
from tasks.stats.scenes import PictureConfig, render
from warehouse.lake import Lake

LOOK = PictureConfig(width=560, height=400, jpeg_quality=95)
SMALL = PictureConfig(width=112, height=80, oversampling=1)
FOV_RADIANS = 1.1
EYES_M = 1.6
"""Height of a person's eyes [m]."""

FROM_WALLS_M = 0.5
"""A person stands so far from the walls."""

NEAR_M = 0.6
"""Distance below which a surface stands in a person's way."""

PLACES = 24
COLUMNS = 2
INK, PAPER = (38, 42, 51), (255, 255, 255)


def eye_level_sheet(lake: Lake, scenes: Sequence[str]) -> bytes:
    """A JPEG of scenes of a lake, two in a row: each scan on the left, its replica on the right, from the same eyes."""
    return sheet([(scene.rpartition("/")[2], *eye_level_pair(lake, scene)) for scene in scenes])


def sheet(pairs: Sequence[tuple[str, Image.Image, Image.Image]]) -> bytes:
    """A JPEG of named pairs of pictures, two in a row."""
    line, gap = 26, 12
    width, height = 2 * LOOK.width + 4, LOOK.height + line
    columns, rows = min(COLUMNS, len(pairs)), -(-len(pairs) // COLUMNS)
    image = Image.new("RGB", (columns * width + (columns - 1) * gap, rows * height + (rows - 1) * gap), PAPER)
    brush, font = ImageDraw.Draw(image), ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 15)
    for index, (name, scan, replica) in enumerate(pairs):
        left, top = (index % COLUMNS) * (width + gap), (index // COLUMNS) * (height + gap)
        brush.text((left + 2, top + line / 2), f"{name}: scan", INK, font, "lm")
        brush.text((left + LOOK.width + 6, top + line / 2), "replica", INK, font, "lm")
        image.paste(scan, (left, top + line))
        image.paste(replica, (left + LOOK.width + 4, top + line))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=85, optimize=True)
    return file.getvalue()


def eye_level_pair(lake: Lake, scene: str) -> tuple[Image.Image, Image.Image]:
    """A scan and its replica from the place in the room from which most of its objects are seen: that of a frame, where it has frames."""
    model = SceneModel.of(lake, lake.snapshot(), scene)
    if model.room is None:
        raise SystemExit(f"{scene}: has no room to stand in")
    objects = [part for parts in model.objects.values() for part in parts]
    room = [part for name, parts in model.shell.items() if name != "ceiling" for part in parts]
    numbers = np.array([k for k, parts in enumerate(model.objects.values()) for _ in parts], dtype=np.int64)
    replica_rays, scan_rays = RayScene([*objects, *room]), RayScene(model.scan)
    carried = [matrix(frame.pose) for frame in lake.snapshot().rows(Frame, scene) if frame.pose is not None]
    poses = carried[:: max(1, len(carried) // PLACES)] or _poses(floor_ring(model.room))
    pose = max(poses, key=lambda pose: _seen(replica_rays, scan_rays, numbers, pose), default=None)
    if pose is None or _seen(replica_rays, scan_rays, numbers, pose) < 0.0:
        raise SystemExit(f"{scene}: no place in it from which more than a wall or the nearest thing is seen")
    camera = Camera.with_fov(pose, LOOK.width, LOOK.height, FOV_RADIANS)
    parts = (model.scan, [*objects, *room])
    scan, replica = (Image.open(io.BytesIO(render(part, camera, LOOK))).convert("RGB") for part in parts)
    return scan, replica


def _poses(ring: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Cameras of people that stand along the walls of a room and look to its middle. ring: corners of its floor [m], shape (n, 2)."""
    floor = shapely.Polygon(ring)
    inner = floor.buffer(-FROM_WALLS_M)
    inner = floor if inner.is_empty else max(getattr(inner, "geoms", [inner]), key=lambda part: part.area)
    middle = np.array([*inner.representative_point().coords[0], 0.8])
    places = [inner.exterior.interpolate(share, normalized=True).coords[0] for share in np.linspace(0.0, 1.0, PLACES, endpoint=False)]
    return [look_at(np.array([*place, EYES_M]), middle) for place in places if np.hypot(*(np.array(place) - middle[:2])) > NEAR_M]


def _seen(replica: RayScene, scan: RayScene, numbers: NDArray[np.int64], pose: NDArray[np.float64]) -> float:
    """Score of a view: pixels of each object weigh by their square root, all by the share of the picture that the scan has. A place
    with something right before it is none. numbers: of the objects that the replica's first meshes are parts of."""
    rays = Camera.with_fov(pose, SMALL.width, SMALL.height, FOV_RADIANS).rays()
    hits, depth = replica.cast(rays), scan.cast(rays)["t_hit"]
    if max((hits["t_hit"] < NEAR_M).mean(), (depth < NEAR_M).mean()) > 0.1:
        return -1.0
    part = hits["geometry_ids"].reshape(-1).astype(np.int64)
    return float(np.isfinite(depth).mean() * np.sqrt(np.bincount(numbers[part[part < len(numbers)]], minlength=1)).sum())
