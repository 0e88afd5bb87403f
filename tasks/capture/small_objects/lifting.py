"""Masks of posed depth frames as points in the world: specs of MaskClustering and ConceptGraphs, thresholds that follow depth noise.

Pixel centers are integers, as everywhere in the project: intrinsics whose pixel centers lie at halves have 0.5 subtracted from cx and cy
when a scan is read.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.files.lenses import Intrinsics
from tasks.capture.reading import FrameSource
from tasks.settings import Config, Count, NonNegative, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

_EROSION_WIDTH = 640
"""Width of the images for which erosion is stated [px]: that of the sensors that the values were found with."""

_LEAST_KEPT = 0.4
"""Share of a mask that erosion leaves at least: a pen is all edge."""

_THINNING = 0.3
"""Edge of the cells that points are thinned to before their neighbors are counted, as a share of the reach."""


@dataclasses.dataclass(frozen=True)
class LiftingConfig(Config):
    """Which pixels of a mask are lifted, and which masks are kept."""

    nearest_m: Positive = 0.1  # sensors of depth see nothing nearer
    farthest_m: Positive = 8.0  # beyond, noise of structured light is larger than a small object
    flying_share: Positive = 0.05  # a step of more than 5 % of the depth between neighbors is an edge, where a sensor mixes two surfaces
    flying_sigmas: Positive = 4.0  # nor is a step that noise alone makes an edge
    erosion_px: NonNegative = 2.0  # masks of networks reach so far over an object's outline, at 640 px of width
    voxel_m: Positive = 0.005  # small objects have details of a centimeter
    least_points: Count = 25  # of 5 mm: a patch of 2.5 cm, less than a mouse shows
    reach_m: Positive = 0.05  # parts of one object that an occluder divides lie nearer than this, other objects' pixels mostly farther
    reach_sigmas: Positive = 4.0  # or than noise throws points
    reach_points: Count = 10  # fewer neighbors within the reach are stray pixels
    same_mask: Share = 0.7  # masks of one frame that overlap by more are one object under two names


@dataclasses.dataclass(frozen=True)
class DepthView:
    """A posed frame at the resolution of its depth.

    depth: Along the viewing direction [m], shape (h, w), 0 where there is none. color: RGB, shape (h, w, 3).
    intrinsics: fx, fy, cx, cy [px], pixel centers are integers. pose: OpenCV camera to world frame, 4x4 [m].
    """

    frame_id: str
    depth: NDArray[np.float32]
    color: NDArray[np.uint8]
    intrinsics: Intrinsics
    pose: Array

    def points(self) -> Array:
        """Every pixel's point in the world frame [m], shape (h, w, 3); the camera's own where there is no depth."""
        fx, fy, cx, cy = self.intrinsics
        height, width = self.depth.shape
        local = np.empty((height, width, 3))
        depth = local[..., 2]
        depth[:] = self.depth
        np.multiply((np.arange(width) - cx) / fx, depth, out=local[..., 0])
        np.multiply(((np.arange(height) - cy) / fy)[:, None], depth, out=local[..., 1])
        points = local @ self.pose[:3, :3].T
        points += self.pose[:3, 3]
        return np.asarray(points)

    def thinned(self, every: int) -> DepthView:
        """The frame with every so manieth pixel along each axis; pixel centers stay integers."""
        if every == 1:
            return self
        fx, fy, cx, cy = (value / every for value in self.intrinsics)
        depth, color = self.depth[::every, ::every], self.color[::every, ::every]
        return dataclasses.replace(self, depth=np.ascontiguousarray(depth), color=np.ascontiguousarray(color), intrinsics=(fx, fy, cx, cy))

    def pixels(self, points: Array) -> tuple[Indices, Indices, Array, Bools]:
        """Row and column of points in the world frame, their depth [m], and which of them lie inside the image; each of shape (n,)."""
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        depth = local[:, 2]
        fx, fy, cx, cy = self.intrinsics
        safe = np.where(depth > 1e-6, depth, np.inf)
        column = np.rint(np.clip(fx * local[:, 0] / safe + cx, -9, 1e6)).astype(np.int64)
        row = np.rint(np.clip(fy * local[:, 1] / safe + cy, -9, 1e6)).astype(np.int64)
        height, width = self.depth.shape
        inside = (depth > 1e-6) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
        return row, column, depth, inside


@dataclasses.dataclass(frozen=True)
class FrameMasks:
    """What somebody saw in one frame: n masks at the resolution of its depth, shape (n, h, w), a name for each ('' where it is not
    known), and how sure each is, 0 to 1, shape (n,)."""

    masks: Bools
    labels: tuple[str, ...]
    scores: Array

    def __post_init__(self) -> None:
        if not len(self.masks) == len(self.labels) == len(self.scores):
            raise ValueError(f"{len(self.masks)} masks, {len(self.labels)} labels and {len(self.scores)} scores must be as many")


@dataclasses.dataclass(frozen=True)
class LiftedFrame:
    """Masks of a frame in the world.

    owner: Mask of each pixel, shape (h, w); -1 for none, for two at once, and where there is no depth. masks: The masks that were kept,
    shape (n, h, w). points: The certain points of each in the world frame [m], shapes (k, 3). colors: Their colors, shapes (k, 3).
    """

    view: DepthView
    owner: NDArray[np.int32]
    masks: Bools
    points: tuple[Array, ...]
    colors: tuple[NDArray[np.uint8], ...]
    labels: tuple[str, ...]
    scores: Array


def depth_noise(depth: NDArray[np.floating]) -> Array:
    """Standard deviation of a structured-light sensor's depth [m] at a depth [m]: Nguyen, Izadi and Lovell, "Modeling Kinect Sensor
    Noise for Improved 3D Reconstruction and Tracking", 3DIMPVT 2012."""
    return 0.0012 + 0.0019 * np.maximum(np.asarray(depth, dtype=np.float64) - 0.4, 0.0) ** 2


def depth_view(frame: FrameSource, alignment: Array) -> DepthView | None:
    """A frame of a scan at the resolution of its depth; None without depth or pose. What the color image does not show has no depth.

    alignment: Scan frame to world frame, 4x4 [m].

    Raises:
        InputError: its images cannot be read.
    """
    if frame.depth is None or frame.depth_size is None or frame.pose is None:
        return None
    row, column, inside = _color_pixels(frame)
    depth, color = np.where(inside, frame.depth(), np.float32(0)), frame.color()
    return DepthView(frame.frame_id, depth, color[row[:, None], column[None, :]], frame.depth_intrinsics, alignment @ frame.pose)


def at_depth(mask: Bools, frame: FrameSource) -> Bools:
    """A mask of a frame's color image, shape (height, width), at the resolution of its depth."""
    row, column, inside = _color_pixels(frame)
    return inside & mask[row[:, None], column[None, :]]


def at_color(mask: Bools, frame: FrameSource) -> Bools:
    """A mask at the resolution of a frame's depth, for its color image, shape (height, width)."""
    fx, fy, cx, cy = frame.intrinsics
    dfx, dfy, dcx, dcy = frame.depth_intrinsics
    columns = np.rint((np.arange(frame.width) - cx) / fx * dfx + dcx).astype(np.int64)
    rows = np.rint((np.arange(frame.height) - cy) / fy * dfy + dcy).astype(np.int64)
    height, width = mask.shape
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
    return inside & mask[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)[None, :]]


def _color_pixels(frame: FrameSource) -> tuple[Indices, Indices, Bools]:
    """Rows and columns of the color image that the rows and columns of the depth image show, both cameras at one center, clipped to it; and
    which pixels of the depth image it shows, shape (h, w)."""
    assert frame.depth_size is not None
    fx, fy, cx, cy = frame.intrinsics
    dfx, dfy, dcx, dcy = frame.depth_intrinsics
    columns = np.rint((np.arange(frame.depth_size[0]) - dcx) / dfx * fx + cx).astype(np.int64)
    rows = np.rint((np.arange(frame.depth_size[1]) - dcy) / dfy * fy + cy).astype(np.int64)
    inside = ((rows >= 0) & (rows < frame.height))[:, None] & ((columns >= 0) & (columns < frame.width))[None, :]
    return np.clip(rows, 0, frame.height - 1), np.clip(columns, 0, frame.width - 1), inside


def sound_pixels(depth: NDArray[np.float32], config: LiftingConfig) -> Bools:
    """Pixels with a depth that is in range and not between two surfaces, shape (h, w)."""
    usable = (depth > config.nearest_m) & (depth <= config.farthest_m)
    limit = np.maximum(config.flying_share * depth, config.flying_sigmas * depth_noise(depth))
    flying = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        here, there = (slice(None, -1), slice(1, None)) if axis == 0 else ((slice(None), slice(None, -1)), (slice(None), slice(1, None)))
        step = np.abs(depth[here] - depth[there])
        both = usable[here] & usable[there]
        # the nearer one of the two is the object's own edge, the farther one what the sensor may have drawn behind it
        jump = both & (step > np.minimum(limit[here], limit[there]))
        flying[here] |= jump & (depth[here] > depth[there])
        flying[there] |= jump & (depth[there] > depth[here])
    return np.asarray(usable & ~flying)


def eroded(mask: Bools, pixels: int) -> Bools:
    """A mask without its outermost pixels; thin ones lose fewer."""
    from scipy.ndimage import binary_erosion

    least, kept = _LEAST_KEPT * mask.sum(), mask
    for _ in range(pixels):
        smaller = binary_erosion(kept, border_value=1)
        if smaller.sum() < least:
            break
        kept = smaller
    return np.asarray(kept)


def distinct(seen: FrameMasks, same_mask: float) -> FrameMasks:
    """Masks of a frame without those that another, surer one covers as well: one object that was asked for under two names."""
    flat = seen.masks.reshape(len(seen.masks), seen.masks[0].size if len(seen.masks) else 0).astype(np.float32)
    shared, sizes = flat @ flat.T, flat.sum(axis=1)
    overlap = shared / np.maximum(sizes[:, None] + sizes[None, :] - shared, 1)
    kept: list[int] = []
    for index in np.lexsort((np.arange(len(sizes)), -seen.scores)):
        if all(overlap[index, other] <= same_mask for other in kept):
            kept.append(int(index))
    kept.sort()
    return FrameMasks(seen.masks[kept], tuple(seen.labels[i] for i in kept), seen.scores[kept])


def voxel_first(points: Array, voxel_m: float) -> Indices:
    """Indices of one point per voxel, the first of each, in the order of the points."""
    _, first = np.unique(voxel_keys(points, voxel_m), return_index=True)
    return np.sort(first)


def voxel_keys(points: Array, voxel_m: float) -> Indices:
    """A number for the voxel of each point, shape (n,): the same for points of one voxel."""
    cells = np.floor(points / voxel_m).astype(np.int64) + (1 << 20)
    return np.asarray((cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2])


def density_clusters(points: Array, reach: float, least: int) -> Indices:
    """Cluster of each point, shape (n,), -1 for stray ones: DBSCAN on cells of a third of the reach, each of the weight of its points."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(points):
        return np.zeros(0, dtype=np.int64)
    _, first, cell, weight = np.unique(voxel_keys(points, _THINNING * reach), return_index=True, return_inverse=True, return_counts=True)
    tree = cKDTree(points[first])
    pairs = tree.query_pairs(reach, output_type="ndarray")
    count = len(first)
    near = weight + np.bincount(pairs[:, 0], weight[pairs[:, 1]], count) + np.bincount(pairs[:, 1], weight[pairs[:, 0]], count)
    core = near >= least
    joined = pairs[core[pairs].all(axis=1)]
    _, component = connected_components(coo_array((np.ones(len(joined)), joined.T), shape=(count, count)), directed=False)
    label = np.where(core, component, -1)
    if core.any() and not core.all():
        distance, index = cKDTree(points[first[core]]).query(points[first[~core]], distance_upper_bound=reach)
        label[~core] = np.where(np.isfinite(distance), label[core][np.minimum(index, core.sum() - 1)], -1)
    named, dense = np.unique(label, return_inverse=True)
    return np.asarray((dense - (named[0] < 0))[cell], dtype=np.int64)


def largest_cluster(points: Array, config: LiftingConfig, depth: float) -> Bools:
    """Which points belong to the largest cluster, shape (n,). depth: How far they are from the camera [m]."""
    reach = max(config.reach_m, config.reach_sigmas * float(depth_noise(np.array(depth))))
    label = density_clusters(points, reach, config.reach_points)
    if not (label >= 0).any():
        return np.zeros(len(points), dtype=bool)
    return np.asarray(label == np.bincount(label[label >= 0]).argmax())


def lift(view: DepthView, seen: FrameMasks, config: LiftingConfig, allowed: Bools | None = None) -> LiftedFrame:
    """Masks of a frame as points in the world frame; those without enough points are left out. Source: specs/models.md A.4.

    allowed: Pixels whose points may belong to small objects, shape (h, w): those in the slab of a support.
    """
    sound = sound_pixels(view.depth, config)
    if allowed is not None:
        sound &= allowed
    world = view.points()
    pixels = round(config.erosion_px * view.depth.shape[1] / _EROSION_WIDTH)
    seen = distinct(seen, config.same_mask)
    kept, points, colors = [], [], []
    for index, mask in enumerate(seen.masks):
        certain = eroded(mask, pixels) & sound
        if certain.sum() < config.least_points:
            continue
        own = world[certain]
        thin = voxel_first(own, config.voxel_m)
        whole = largest_cluster(own[thin], config, float(np.median(view.depth[certain])))
        if whole.sum() < config.least_points:
            continue
        kept.append(index)
        points.append(own[thin][whole])
        colors.append(view.color[certain][thin][whole])
    masks = seen.masks[kept].reshape(len(kept), *view.depth.shape)
    return LiftedFrame(
        view, _owner(masks, sound), masks, tuple(points), tuple(colors), tuple(seen.labels[i] for i in kept), seen.scores[kept]
    )


def _owner(masks: Bools, sound: Bools) -> NDArray[np.int32]:
    """Mask of each pixel, -1 for none; what lies in two masks is a boundary, and nobody's."""
    count, owner = np.zeros(sound.shape, dtype=np.int32), np.full(sound.shape, -1, dtype=np.int32)
    for number, mask in enumerate(masks):  # one after another: a reduction over the first axis costs several times that
        count += mask
        owner[mask] = number
    owner[(count != 1) | ~sound] = -1
    return owner


def visible_points(view: DepthView, points: Array, tolerance: Array) -> tuple[Bools, Indices, Indices]:
    """Which points in the world frame, shape (n, 3), a frame sees: its depth there is theirs, give or take `tolerance` [m] of shape (n,);
    and their rows and columns, clipped to the image."""
    row, column, depth, inside = view.pixels(points)
    height, width = view.depth.shape
    row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    measured = view.depth[row, column]
    return inside & (measured > 0) & (np.abs(measured - depth) <= tolerance), row, column


def depths(view: DepthView, points: Array) -> Array:
    """How far points in the world frame, shape (n, 3), lie along a frame's viewing direction [m], shape (n,)."""
    return np.asarray((points - view.pose[:3, 3]) @ view.pose[:3, 2])


def lifted(
    views: Sequence[DepthView], seen: Sequence[FrameMasks], config: LiftingConfig, allowed: Sequence[Bools] | None = None
) -> list[LiftedFrame]:
    """Masks of several frames as points in the world frame, see `lift`."""
    slabs = allowed if allowed is not None else [None] * len(views)
    return [lift(view, masks, config, slab) for view, masks, slab in zip(views, seen, slabs, strict=True)]
