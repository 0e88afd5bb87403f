"""Real frames whose objects were drawn by hand: the tables in them as supports, found where the drawing has them."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.capture.drawn import IGNORED, Drawing, drawings, read_drawing
from bench.models.trained.scoring import FrameTruth
from schemas.errors import InputError
from tasks.capture.files.documents import read_json
from tasks.capture.files.images import read_color, read_depth
from tasks.capture.small_objects.lifting import DepthView
from tasks.capture.small_objects.supports import BELOW_M, DILATION_M, SupportSlab, support_kind
from tasks.geometry.transforms import yaw_pose

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FOLDERS = ("rgbd_tum_desk_pair", "rgbd_slambook_dining")
"""Of real frames with images of color and depth."""

LEAST_PIXELS = 150
"""With depth, of an object that has to be found."""

LEAST_BOARD = 1500
"""Pixels with depth of a support: a smaller one does not say where its plane is."""

OVER_SHARE = 0.6
"""Of an object's pixels above the support itself, for it to stand there."""

TALL_M = 0.6
"""Above a support, where things are looked for: as `supports.csv` has it for tables and desks."""

_INLIER_M = 0.012
_TRIES = 300


@dataclasses.dataclass(frozen=True)
class PhotographedTable:
    """A support in a real frame, in a world whose z is its normal. slab: Where things on it can be."""

    name: str
    view: DepthView
    slab: SupportSlab
    truth: FrameTruth


def photographed_tables(root: Path) -> list[PhotographedTable]:
    """Supports with objects on them in the drawn frames below the folder of real data, by frame.

    Raises:
        InputError: an image or a drawing cannot be read.
    """
    tables = []
    for path in drawings():
        drawing = read_drawing(path)
        if drawing.frame.split("/")[0] in FOLDERS:
            tables += _tables(root, drawing)
    return tables


def _tables(root: Path, drawing: Drawing) -> list[PhotographedTable]:
    view, labels = _view(root, drawing), drawing.labels()
    made = []
    for number, region in enumerate(drawing.objects, 1):
        board = (labels == number) & (view.depth > 0)
        if region.is_support and support_kind(region.category) is not None and board.sum() >= LEAST_BOARD:
            table = _table(drawing, view, labels, board, f"{drawing.frame}, {region.category}")
            if table.truth.counted.any():
                made.append(table)
    return made


def _table(drawing: Drawing, view: DepthView, labels: NDArray[np.int32], board: Bools, name: str) -> PhotographedTable:
    import shapely

    normal, middle = plane_of(view.points()[board])
    up = -normal if normal @ middle > 0 else normal  # towards the camera
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    ahead /= np.linalg.norm(ahead)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([ahead, np.cross(up, ahead), up])
    pose[:3, 3] = -pose[:3, :3] @ middle
    posed = dataclasses.replace(view, pose=pose)
    points, measured = posed.points(), view.depth > 0
    flat = points[board & (np.abs(points[..., 2]) <= BELOW_M)][:, :2]
    corners = np.array(shapely.MultiPoint(flat[::7]).minimum_rotated_rectangle.exterior.coords)[:4]
    side = corners[1] - corners[0]
    half = 0.5 * np.array([np.linalg.norm(side), np.linalg.norm(corners[2] - corners[1])])
    x, y = (float(value) for value in corners.mean(axis=0))
    low, high = np.array([*(-half - DILATION_M), -BELOW_M]), np.array([*(half + DILATION_M), TALL_M])
    slab = SupportSlab(yaw_pose(math.atan2(side[1], side[0]), [x, y, 0.0]), low, high, half)
    above = slab.holds(points) & (slab.inset(slab.local(points)) >= 0) & measured  # chairs at a table reach over its edge
    numbers = [number for number, region in enumerate(drawing.objects, 1) if not region.is_support and (labels == number).any()]
    masks = np.array([labels == number for number in numbers]).reshape(-1, *labels.shape)
    own = [(mask & measured).sum() for mask in masks]
    counted = [pixels >= LEAST_PIXELS and (mask & above).sum() >= OVER_SHARE * pixels for mask, pixels in zip(masks, own, strict=True)]
    words = tuple(drawing.objects[number - 1].category for number in numbers)
    truth = FrameTruth(masks, words, np.array(counted, dtype=bool), measured & (labels != IGNORED), drawing.frame)
    return PhotographedTable(name, posed, slab, truth)


def _view(root: Path, drawing: Drawing) -> DepthView:
    """A frame in its camera's own axes."""
    image = root / drawing.frame
    folder = image.parent.parent
    lens = read_json(folder / "intrinsics.json", f"{folder.name}/intrinsics.json")
    depths = [path for path in sorted((folder / "depth").glob("*")) if path.stem == image.stem]
    if not depths:
        raise InputError(drawing.frame, "depth", "is missing", f"put {image.stem}.png or .pgm into {folder.name}/depth")
    depth = read_depth(depths[0], f"{folder.name}/depth/{depths[0].name}", drawing.size, float(lens["depth_scale"]))
    intrinsics = (float(lens["fx"]), float(lens["fy"]), float(lens["cx"]), float(lens["cy"]))
    return DepthView("", depth, read_color(image, drawing.frame, drawing.size), intrinsics, np.eye(4))


def plane_of(points: Array, seed: int = 0) -> tuple[Array, Array]:
    """Unit normal and a point of the plane that most of some points lie on, shapes (3,), by random samples and least squares.

    points: [m], shape (n, 3)."""
    rng = np.random.default_rng(seed)
    most, best = -1, (np.zeros(3), np.zeros(3))
    for _ in range(_TRIES):
        a, b, c = points[rng.integers(len(points), size=3)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            continue
        inliers = int((np.abs((points - a) @ (normal / length)) < _INLIER_M).sum())
        if inliers > most:
            most, best = inliers, (normal / length, a)
    for _ in range(3):
        near = points[np.abs((points - best[1]) @ best[0]) < _INLIER_M]
        middle = near.mean(axis=0)
        best = (np.linalg.svd(near - middle, full_matrices=False)[2][2], middle)
    return best
