"""One depth frame without labels as regions: what carries things, what the room is, and what stands there.

No gravity and no pose are needed, and no color edges: printed boxes would fall apart.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tasks.capture.segmentation.convexity import ConvexityConfig, contacts_of, joined_patches
from tasks.capture.segmentation.organized import OrganizedFrame, organized_frame
from tasks.capture.segmentation.patches import SurfacePatchConfig, patches_of
from tasks.capture.segmentation.planes import FramePlanes, Plane, PlaneConfig, frame_planes, on_plane
from tasks.capture.segmentation.strips import StripConfig, flush_with, with_strips
from tasks.capture.segmentation.vessels import VesselConfig, bridged, outlines, without_parts
from tasks.capture.small_objects.lifting import DepthView
from tasks.settings import Config, Count, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]


_LOWEST_PERCENT = 0.2
"""Of the pixels may lie below the lowest level: flying ones."""


@dataclasses.dataclass(frozen=True)
class FrameConfig(Config):
    """How a frame is segmented."""

    farthest_m: Positive = 6.0  # beyond, noise of structured light is six centimeters
    window_m: Positive = 0.01  # radius of the window of normals: the rim of a mug still has two sides
    window_sigmas: Positive = 5.0  # or so many times the noise: of less, normals are off by twenty degrees
    gate_sigmas: Positive = 4.0  # what is that much nearer or farther is another surface
    least_px: Count = 400  # smaller regions are noise; 3.4 cm square at 1 m and 640 px of width
    apron_share: Share = 0.6  # of a region's pixels below the support that it touches: its apron and legs
    island_share: Share = 0.5  # of the largest part of a support that is seen: a smaller one may be the bottom of a vessel ...
    island_outline: Share = 0.6  # ... whose rim is so much of its outline
    planes: PlaneConfig = dataclasses.field(default_factory=PlaneConfig)  # see there
    patches: SurfacePatchConfig = dataclasses.field(default_factory=SurfacePatchConfig)  # see there
    convexity: ConvexityConfig = dataclasses.field(default_factory=ConvexityConfig)  # see there
    vessels: VesselConfig = dataclasses.field(default_factory=VesselConfig)  # see there
    strips: StripConfig = dataclasses.field(default_factory=StripConfig)  # see there


@dataclasses.dataclass(frozen=True)
class FrameSegments:
    """A frame in regions.

    region: Of each pixel from 0, -1 for none, shape (h, w). support: The plane that carries them, in the camera's frame; None where there
    is no plane. on_support: Its pixels. room: Pixels of floors and walls. Both of shape (h, w); what is below a table's edge is the table.
    """

    region: Indices
    support: Plane | None
    on_support: Bools
    room: Bools


def segmented_frame(view: DepthView, config: FrameConfig, up: Array | None = None, known_room: Bools | None = None) -> FrameSegments:
    """The regions of a frame.

    up: Up in the camera's frame, shape (3,), where it is known. known_room: Pixels that are known to be of floors and walls, shape (h, w).
    """
    frame = organized_frame(view, config.farthest_m, config.window_m, config.window_sigmas, config.gate_sigmas)
    planes = frame_planes(frame, config.planes, up)
    support, room = _planes_of(frame, planes, config)
    if known_room is not None:
        room = (room | known_room) & ~support
    heights = None if planes.support is None else planes.support.plane.heights(frame.points)
    region = _regions(frame, np.where(support, 0, np.where(room, 1, -1)), heights, config)
    if planes.support is not None:
        region, support = _with_islands(region, support, config)
        region, support = _with_aprons(region, support, planes.support.plane, frame, config)
        region, room = _with_ground(region, room, planes.support.plane, frame, config)
        region = with_strips(_sizable(region, 1), planes.support.plane, frame, config.vessels.bridge_px, config.strips)
    flush = flush_with(region, planes.walls, frame, config.strips)
    region, room = np.where(flush, -1, region), room | flush
    least = config.least_px * (view.depth.shape[1] / 640) ** 2
    region = _sizable(region, least)
    return FrameSegments(region, None if planes.support is None else planes.support.plane, support, room)


def _planes_of(frame: OrganizedFrame, planes: FramePlanes, config: FrameConfig) -> tuple[Bools, Bools]:
    """Pixels of the support, and those of other levels and of walls."""
    support, room = np.zeros(frame.valid.shape, dtype=bool), np.zeros(frame.valid.shape, dtype=bool)
    if planes.support is not None:
        support = on_plane(frame, planes.support.plane, config.planes)
    for each in (*planes.lower, *planes.walls):
        room |= on_plane(frame, each.plane, config.planes)
    return support, room & ~support


def _regions(frame: OrganizedFrame, background: Indices, heights: Array | None, config: FrameConfig) -> Indices:
    """Regions of the pixels that no plane has. background: Plane of each pixel, -1 for none, shape (h, w)."""
    patches = patches_of(frame, frame.valid & (background < 0), config.patches)
    step, depth = config.patches.step(frame), np.ascontiguousarray(frame.points[..., 2])
    contacts = contacts_of(patches.label, depth, step, config.convexity.reach_px)
    owner = joined_patches(patches, contacts, config.convexity)
    region = np.where(patches.label >= 0, owner[patches.label], -1) if len(owner) else patches.label
    return without_parts(region, background, frame, step, heights, config.vessels)


def _with_aprons(
    region: Indices, support: Bools, plane: Plane, frame: OrganizedFrame, config: FrameConfig
) -> tuple[Indices, Bools]:  # fmt: skip
    """Regions that lie below the support, and touch it or are under it, are a part of it."""
    count = int(region.max(initial=-1)) + 1
    below = plane.heights(frame.points) < -config.planes.remove_sigmas * frame.noise
    marked = np.where(support, count, region)
    contacts = contacts_of(marked, np.ascontiguousarray(frame.points[..., 2]), config.patches.step(frame), config.convexity.reach_px)
    touching = np.zeros(count, dtype=bool)
    touching[contacts.first[(contacts.second == count) & (contacts.passing > 0)]] = True
    sizes = np.bincount(region[region >= 0], minlength=count)
    low = np.bincount(region[(region >= 0) & below], minlength=count) >= config.apron_share * np.maximum(sizes, 1)
    if low.any():
        under = np.bincount(region[region >= 0], under_plane(frame.points[region >= 0], frame.points[support], plane), count)
        touching |= under >= config.apron_share * np.maximum(sizes, 1)
    member = (region >= 0) & np.append(low & touching, False)[region]
    return np.where(member, -1, region), support | member


def _with_ground(
    region: Indices, room: Bools, plane: Plane, frame: OrganizedFrame, config: FrameConfig
) -> tuple[Indices, Bools]:  # fmt: skip
    """Regions that are as low as anything is, far below the support, are floor: strips of it that are no plane by themselves."""
    member = region >= 0
    heights = plane.heights(frame.points)
    lowest = float(np.percentile(heights[frame.valid], _LOWEST_PERCENT)) if member.any() else 0.0
    if lowest > -config.planes.storey_m:
        return region, room
    limit = lowest + config.planes.storey_m + config.planes.remove_sigmas * frame.noise
    count = int(region.max(initial=-1)) + 1
    low = np.bincount(region[member & (heights < limit)], minlength=count)
    ground = low >= config.apron_share * np.maximum(np.bincount(region[member], minlength=count), 1)
    is_ground = member & np.append(ground, False)[region]
    return np.where(is_ground, -1, region), room | is_ground


def under_plane(points: Array, top: Array, plane: Plane) -> Bools:
    """Whether points, shape (n, 3), lie within the hull of a plane's own, shape (m, 3), seen along its normal, shape (n,)."""
    from scipy.spatial import ConvexHull, QhullError

    first = np.cross(plane.normal, np.eye(3)[int(np.abs(plane.normal).argmin())])
    axes = np.stack([first, np.cross(plane.normal, first)], axis=1)
    try:
        lines = ConvexHull(top @ axes).equations
    except (QhullError, ValueError):
        return np.zeros(len(points), dtype=bool)
    return np.asarray((points @ axes @ lines[:, :2].T + lines[:, 2] <= 0).all(axis=1))


def _with_islands(region: Indices, support: Bools, config: FrameConfig) -> tuple[Indices, Bools]:
    """Islands of the support within a region are a part of it: plates and trays are as low as what they stand on."""
    from scipy.ndimage import label

    island, count = label(support)
    sizes = np.bincount(island.ravel(), minlength=count + 1)[1:]
    regions = int(region.max(initial=-1)) + 1
    marked = np.where(support, regions + island - 1, region)
    outline = outlines(bridged(marked, config.vessels.bridge_px)[0], regions + count)[regions:]
    total = np.maximum(outline.sum(axis=1), 1)
    best = outline[:, :regions].argmax(axis=1) if regions else np.zeros(count, dtype=np.int64)
    lies = (sizes < config.island_share * sizes.max(initial=0)) & (
        outline[np.arange(count), best] >= config.island_outline * total if regions else False
    )
    member = support & np.append(lies, False)[island - 1]
    return np.where(member, best[island - 1] if count else -1, region), support & ~member


def _sizable(region: Indices, least: float) -> Indices:
    """Regions of enough pixels, numbered anew."""
    sizes = np.bincount(region[region >= 0], minlength=1)
    kept = sizes >= least
    numbers = np.where(kept, np.cumsum(kept) - 1, -1)
    return np.asarray(np.where(region >= 0, numbers[region], -1))
